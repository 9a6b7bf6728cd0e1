#include <math.h>
#include <stdint.h>

#include <algorithm>

#include "native_imu.h"
#include "native_robot_api.h"
#include "native_speed.h"
#include "native_suspension.h"

namespace {

using tiger::hal_of;
using tiger::kCorners;
using tiger::SpeedHal;
using tiger::SuspensionHal;
using tiger::VirtualUart;

constexpr uint8_t kSides = 2;
constexpr double kTurn = 2.0 * 3.14159265358979323846;

void show_strokes(tiger_robot& r) {
  const tiger_world& w = *r.world;
  uint8_t lower = 0, upper = 0;
  for (uint8_t i = 0; i < kCorners; ++i) {
    const double stroke = w.stroke_mm[i];
    const double forced = r.forced_counts[i];
    r.shown_counts[i] = isnan(forced) ? r.zero_counts + stroke * r.counts_per_mm : forced;
    if (stroke <= r.switch_margin_mm) lower = static_cast<uint8_t>(lower | 1u << i);
    if (stroke >= w.stroke_max_mm - r.switch_margin_mm) upper = static_cast<uint8_t>(upper | 1u << i);
  }
  hal_of<SuspensionHal>(r.suspension).set_inputs(r.shown_counts, lower, upper, r.estop_pressed != 0);
}

bool wheels_stand(const tiger_robot& r) {
  const double* speed = r.world->felt->wheel_radps;
  return std::all_of(speed, speed + kCorners, [&](double v) { return fabs(v) < r.standing_radps; });
}

// The sensors see what has passed beyond their hysteresis. A board has the front and the rear wheel of its side.
void show_wheels(tiger_robot& r) {
  if (r.steps != 0 && wheels_stand(r)) return;
  for (uint8_t i = 0; i < kCorners; ++i) {
    const double phase = tiger_robot_tooth_phase(&r, i);
    const double behind = phase - r.shown_phase[i];
    if (fabs(behind) <= r.gear_play) continue;
    r.shown_phase[i] = phase - (behind > 0.0 ? r.gear_play : -r.gear_play);
    hal_of<SpeedHal>(r.speed[i % kSides]).set_phase(i / kSides, r.shown_phase[i]);
  }
}

void carry(tiger_board* from, uint8_t from_port, tiger_board* to, uint8_t to_port) {
  uint8_t bytes[256];
  const uint64_t now_ns = from->hal().now_ns();
  while (const uint32_t n = from->uart(from_port)->leave(bytes, sizeof(bytes), now_ns)) {
    to->uart(to_port)->arrive(bytes, n, to->hal().now_ns());
  }
}

}  // namespace

double tiger_robot_tooth_phase(const tiger_robot* robot, uint8_t corner) {
  const double angle = robot->world->felt->wheel_angle_rad[corner];
  const double* starts = robot->teeth_rad + corner * (robot->teeth + 1);
  double rest = fmod(angle, kTurn);
  if (rest < 0.0) rest += kTurn;
  const double turns = nearbyint((angle - rest) / kTurn);
  const double* next = std::upper_bound(starts + 1, starts + robot->teeth, rest);
  const double share = (rest - next[-1]) * (1.0 / (next[0] - next[-1]));
  return turns * robot->teeth + static_cast<double>(next - 1 - starts) + share;
}

void tiger_robot_run(tiger_robot* robot, uint32_t steps, const double* plate_rad, const double* wheel_rpm) {
  tiger_robot& r = *robot;
  SuspensionHal& suspension = hal_of<SuspensionHal>(r.suspension);
  for (uint32_t step = 0; step < steps; ++step) {
    if (step != 0) {
      double duty[kCorners];
      for (uint8_t i = 0; i < kCorners; ++i) duty[i] = suspension.duty(i);
      tiger_world_step(r.world, duty, wheel_rpm + 4 * step, plate_rad + 2 * step);
    }
    show_strokes(r);
    show_wheels(r);
    for (tiger_board* board : {r.suspension, r.imu, r.speed[0], r.speed[1]}) board->run(r.world->dt_us);
    if (r.carries_nano != 0) {
      carry(r.imu, 0, r.suspension, 1);
      carry(r.suspension, 1, r.imu, 0);
    }
    ++r.steps;
  }
}
