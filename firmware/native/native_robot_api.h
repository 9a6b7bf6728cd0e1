// The emulated robot: the four boards wired as on the robot, and the world between their outputs and their pins.
//
// Plain data that Python fills in and looks at (host/tiger/emulation says what it means); no memory is owned. Corners
// are FL FR RL RR, sides left and right, units in the names.
#pragma once

#include <stdint.h>

#include "tiger_native.h"

#ifdef __cplusplus
extern "C" {
#endif

// ------------------------------------------------------------------------------------------------------ the world

// What a body is told for a step: where plate (roll, pitch) and mechanisms shall be at its end, and the wheels' speeds.
typedef struct {
  double plate_rad[2];
  double lift_m[4];
  double wheel_rpm[4];
} tiger_body_command;

// What is felt of a body after a step: where the IMU sits, in the springs beyond the body's weight, at the wheels.
typedef struct {
  double accel_mps2[3];
  double rate_radps[3];
  double spring_n[4];
  double wheel_radps[4];
  double wheel_angle_rad[4];
  double wheel_torque_nm[4];
} tiger_body_felt;

// Moves a body by one step of the length that it was prepared for; `body` is its own.
typedef void (*tiger_body_step)(void* body, const tiger_body_command* command, tiger_body_felt* felt);

typedef struct {
  // The vehicle.
  double stroke_max_mm, max_rate_mmps, max_force_n;
  double mid_rise_mm;
  double preload_n[4];
  const double* curve;  // (pieces, 4): the rise in mm as a cubic of the stroke within each piece, c3 first
  double pieces_per_mm;
  int32_t pieces;

  // For steps of one length.
  uint32_t dt_us;
  double dt_s;
  double rate_gain, accel_gain, gyro_gain;

  // The state.
  uint64_t time_us;
  double stroke_mm[4], rate_mmps[4];
  double rise_mm[4], motion_ratio[4];
  double* accel_mps2;  // (3,) as the accelerometer's and the gyroscope's low-pass let it through
  double* gyro_radps;

  tiger_body_step step_body;
  void* body;
  tiger_body_felt* felt;
} tiger_world;

// One step with duties -1..1 (+ raises the body) and wheel speeds, at whose end the plate has (roll, pitch).
void tiger_world_step(tiger_world* world, const double duty[4], const double wheel_rpm[4],
                      const double plate_rad[2]);
void tiger_world_place(tiger_world* world, uint8_t corner, double stroke_mm);
double tiger_world_actuator_force_n(const tiger_world* world, uint8_t corner);

// The 7-DOF body on stands (host/tiger/emulation/linear_body.py): (state, inputs, change) to (state, outputs).
typedef struct {
  const double* matrix;  // (21, 26)
  double z[26];          // state (14), inputs at the start of a step (6), their change over it (6)
  double outputs[7];     // accelerations of heave, pitch, roll; forces of the springs
  double imu_offset_m[3];
  double gravity_mps2;
  double dt_s, wheel_gain, most_change_radps, spin_inertia_kgm2;
} tiger_linear_body;

void tiger_linear_step(void* body, const tiger_body_command* command, tiger_body_felt* felt);
void tiger_linear_feel(const tiger_linear_body* body, tiger_body_felt* felt);  // at rest, before any step

// ------------------------------------------------------------------------------------------------------ the robot

typedef struct {
  tiger_world* world;
  tiger_board* suspension;
  tiger_board* imu;
  tiger_board* speed[2];

  // A potentiometer's converter shows zero_counts + stroke * counts_per_mm, or what `forced_counts` says if not NaN.
  double zero_counts, counts_per_mm;
  double forced_counts[4];
  double shown_counts[4];
  double switch_margin_mm;  // the switches are pressed so near the ends of the stroke
  uint8_t estop_pressed;

  const double* teeth_rad;  // (4, teeth + 1): where each tooth of each wheel starts, a full turn last
  int32_t teeth;
  double gear_play;       // teeth that pass before a sensor sees them
  double standing_radps;  // wheels that are all slower stand
  double shown_phase[4];  // teeth that the sensors have seen

  uint8_t carries_nano;  // bytes pass between mega_suspension and the Nano
  uint64_t steps;
} tiger_robot;

// Teeth that have passed the sensor of a wheel since the start, with their fraction.
double tiger_robot_tooth_phase(const tiger_robot* robot, uint8_t corner);

// `steps` steps of the world's length, each with its row of `plate_rad` (steps, 2) and `wheel_rpm` (steps, 4). The
// world has made the first of them already: what Python shows the boards of it comes in between.
void tiger_robot_run(tiger_robot* robot, uint32_t steps, const double* plate_rad, const double* wheel_rpm);

#ifdef __cplusplus
}
#endif
