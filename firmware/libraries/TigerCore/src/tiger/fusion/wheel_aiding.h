// What the wheels say about the body's acceleration, to be taken off the accelerometer before it is averaged.
//
// A body that rolls forward at v and turns at w accelerates by [v', w_z v, -w_y v] in its own axes. Left in the
// specific force this reads as tilt for as long as it lasts; taken off, gravity remains. While the wheels slip
// their speed means nothing: the accelerometer then rests for some seconds and the gyroscope carries the attitude;
// after that it is used as it is.
#pragma once

#include <stdint.h>

#include "low_pass.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct AidingTuning {
  float speed_tau_s = 0.05f;   // corner 4.5 Hz; the averaging of the filter does the rest
  float coast_s = 5.0f;        // slipping: so long without the accelerometer
  float standing_mps = 0.02f;  // below it the body may be at rest
};

struct AidingGains {
  LowPassGains speed;
  float changes_per_s;  // of the low-pass steps
  float standing_mps;
  uint16_t coast_ticks;
};

constexpr AidingGains aiding_gains(const AidingTuning& t, float tick_s) {
  return AidingGains{low_pass_gains(t.speed_tau_s, tick_s), 2.0f / tick_s, t.standing_mps,
                     static_cast<uint16_t>(t.coast_s / tick_s)};
}

class WheelAiding {
 public:
  struct Advice {
    Vec3 vehicle_accel_mps2;
    bool accel_usable;
    bool may_rest;
  };

  // One tick. `rate_radps`: of the body, bias removed.
  Advice step(const AidingGains& gains, float speed_mps, bool slipping, const Vec3& rate_radps) {
    if (slipping) {
      speed_.reset();
      if (slipping_ticks_ < UINT16_MAX) slipping_ticks_++;
      return Advice{Vec3{0.0f, 0.0f, 0.0f}, slipping_ticks_ > gains.coast_ticks, false};
    }
    slipping_ticks_ = 0;
    float v = speed_mps;
    float change;
    speed_.update(gains.speed, &v, &v, &change);
    const Vec3 accel = {change * gains.changes_per_s, rate_radps.z * v, -rate_radps.y * v};
    return Advice{accel, true, fabsf(v) < gains.standing_mps};
  }

 private:
  LowPass<1> speed_;
  uint16_t slipping_ticks_ = 0;
};

}  // namespace fusion
}  // namespace tiger
