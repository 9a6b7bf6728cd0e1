#include <math.h>
#include <string.h>

#include "native_robot_api.h"

namespace {

constexpr int kStates = 14;
constexpr int kInputs = 6;
constexpr int kOutputs = 7;
constexpr int kColumns = kStates + 2 * kInputs;
constexpr double kRadpsPerRpm = 3.14159265358979323846 / 30.0;

// Each wheel turns freely and follows its drive with a first-order lag, as fast as the motor's torque lets it.
void turn_wheels(const tiger_linear_body& b, const double wheel_rpm[4], tiger_body_felt& felt) {
  for (int i = 0; i < 4; ++i) {
    const double speed = felt.wheel_radps[i];
    if (wheel_rpm[i] == 0.0 && -1e-9 < speed && speed < 1e-9) {
      felt.wheel_radps[i] = felt.wheel_torque_nm[i] = 0.0;
      continue;
    }
    const double wanted = b.wheel_gain * (wheel_rpm[i] * kRadpsPerRpm - speed);
    const double most = b.most_change_radps;
    const double change = wanted > most ? most : wanted < -most ? -most : wanted;
    felt.wheel_torque_nm[i] = b.spin_inertia_kgm2 * change / b.dt_s;
    felt.wheel_angle_rad[i] += (speed + 0.5 * change) * b.dt_s;
    felt.wheel_radps[i] = speed + change;
  }
}

// The exact step: inputs are straight lines over it.
void move(tiger_linear_body& b, const double inputs[kInputs]) {
  double* const held = b.z + kStates;
  double* const change = held + kInputs;
  for (int i = 0; i < kInputs; ++i) change[i] = inputs[i] - held[i];
  double result[kStates + kOutputs];
  for (int row = 0; row < kStates + kOutputs; ++row) {
    double sum = 0.0;
    for (int column = 0; column < kColumns; ++column) sum += b.matrix[row * kColumns + column] * b.z[column];
    result[row] = sum;
  }
  memcpy(b.z, result, kStates * sizeof(double));
  memcpy(b.outputs, result + kStates, sizeof(b.outputs));
  for (int i = 0; i < kInputs; ++i) held[i] += change[i];
}

}  // namespace

// The motion of the point where the IMU sits, in body axes, for yaw-pitch-roll angles without yaw.
void tiger_linear_feel(const tiger_linear_body* body, tiger_body_felt* felt) {
  const tiger_linear_body& b = *body;
  const double pitch = b.z[2], pitch_rate = b.z[3], roll = b.z[4], roll_rate = b.z[5];
  const double pushed = b.outputs[0] + b.gravity_mps2, pitch_accel = b.outputs[1], roll_accel = b.outputs[2];
  const double sin_roll = sin(roll), cos_roll = cos(roll), level = cos(pitch);
  const double p = roll_rate, q = pitch_rate * cos_roll, r = -pitch_rate * sin_roll;
  const double pp = roll_accel, qq = pitch_accel * cos_roll + roll_rate * r;
  const double rr = -pitch_accel * sin_roll - roll_rate * q;
  const double x = b.imu_offset_m[0], y = b.imu_offset_m[1], z = b.imu_offset_m[2];
  const double along = p * x + q * y + r * z;
  const double square = p * p + q * q + r * r;
  felt->accel_mps2[0] = pushed * -sin(pitch) + qq * z - rr * y + along * p - square * x;
  felt->accel_mps2[1] = pushed * (sin_roll * level) + rr * x - pp * z + along * q - square * y;
  felt->accel_mps2[2] = pushed * (cos_roll * level) + pp * y - qq * x + along * r - square * z;
  felt->rate_radps[0] = p;
  felt->rate_radps[1] = q;
  felt->rate_radps[2] = r;
  memcpy(felt->spring_n, b.outputs + 3, sizeof(felt->spring_n));
}

void tiger_linear_step(void* body, const tiger_body_command* command, tiger_body_felt* felt) {
  tiger_linear_body& b = *static_cast<tiger_linear_body*>(body);
  turn_wheels(b, command->wheel_rpm, *felt);
  const double* lift = command->lift_m;
  const double inputs[kInputs] = {
      command->plate_rad[0], command->plate_rad[1], lift[0], lift[1], lift[2], lift[3]};
  move(b, inputs);
  tiger_linear_feel(&b, felt);
}
