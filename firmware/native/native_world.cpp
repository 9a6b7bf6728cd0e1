#include <stdint.h>
#include <string.h>

#include "native_robot_api.h"

namespace {

constexpr int kCorners = 4;
constexpr int kAxes = 3;

double within(double value, double most) { return value > most ? most : value < -most ? -most : value; }

// A first-order lag follows the duty; an actuator locks itself, stops at the ends of its stroke, and cannot push more
// than its force.
void move_actuators(tiger_world& w, const double duty[kCorners]) {
  for (uint8_t i = 0; i < kCorners; ++i) {
    double rate = w.rate_mmps[i];
    if (duty[i] == 0.0 && -1e-9 < rate && rate < 1e-9) {
      w.rate_mmps[i] = 0.0;
      continue;
    }
    rate += w.rate_gain * (within(duty[i], 1.0) * w.max_rate_mmps - rate);
    const bool stalls = rate > 0.0 && tiger_world_actuator_force_n(&w, i) > w.max_force_n;
    if (stalls) rate = 0.0;
    double stroke = w.stroke_mm[i] + rate * w.dt_s;
    if (!(0.0 < stroke && stroke < w.stroke_max_mm)) {
      stroke = stroke <= 0.0 ? 0.0 : w.stroke_max_mm;
      rate = 0.0;
    }
    w.rate_mmps[i] = rate;
    tiger_world_place(&w, i, stroke);
  }
}

void follow(double low_passed[kAxes], const double truth[kAxes], double gain) {
  for (int i = 0; i < kAxes; ++i) low_passed[i] += gain * (truth[i] - low_passed[i]);
}

}  // namespace

void tiger_world_place(tiger_world* world, uint8_t corner, double stroke_mm) {
  tiger_world& w = *world;
  int32_t piece = static_cast<int32_t>(stroke_mm * w.pieces_per_mm);
  if (piece > w.pieces - 1) piece = w.pieces - 1;
  const double* c = w.curve + 4 * piece;
  const double x = stroke_mm - piece / w.pieces_per_mm;
  w.stroke_mm[corner] = stroke_mm;
  w.rise_mm[corner] = ((c[0] * x + c[1]) * x + c[2]) * x + c[3];
  w.motion_ratio[corner] = (3.0 * c[0] * x + 2.0 * c[1]) * x + c[2];
}

double tiger_world_actuator_force_n(const tiger_world* world, uint8_t corner) {
  return (world->preload_n[corner] + world->felt->spring_n[corner]) * world->motion_ratio[corner];
}

void tiger_world_step(tiger_world* world, const double duty[4], const double wheel_rpm[4],
                      const double plate_rad[2]) {
  tiger_world& w = *world;
  move_actuators(w, duty);
  w.time_us += w.dt_us;
  tiger_body_command command;
  memcpy(command.plate_rad, plate_rad, sizeof(command.plate_rad));
  memcpy(command.wheel_rpm, wheel_rpm, sizeof(command.wheel_rpm));
  for (int i = 0; i < kCorners; ++i) command.lift_m[i] = (w.rise_mm[i] - w.mid_rise_mm) * 1e-3;
  w.step_body(w.body, &command, w.felt);
  follow(w.accel_mps2, w.felt->accel_mps2, w.accel_gain);
  follow(w.gyro_radps, w.felt->rate_radps, w.gyro_gain);
}
