// Is the sensor at rest? Gyroscope and accelerometer must stay close to their own recent mean for a while.
#pragma once

#include <stdint.h>

#include "flash.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct RestTuning {
  float mean_tau_s = 0.5f;
  float settle_s = 1.5f;            // quiet this long before it counts as rest
  float gyro_limit_radps = 0.035f;  // 2 degrees/s from the mean
  float accel_limit_mps2 = 0.5f;
  float bias_limit_radps = 0.035f;  // a mean rate beyond what a bias can be is a turn, not rest
};

struct RestGains {
  float mean_share, gyro_limit2, accel_limit2, bias_limit;
  uint16_t settle_ticks;
};

constexpr RestGains rest_gains(const RestTuning& t, float period_s) {
  return RestGains{period_s / (t.mean_tau_s + period_s), t.gyro_limit_radps * t.gyro_limit_radps,
                   t.accel_limit_mps2 * t.accel_limit_mps2, t.bias_limit_radps,
                   static_cast<uint16_t>(t.settle_s / period_s)};
}

class RestDetector {
 public:
  void reset() {
    quiet_ticks_ = 0;
    started_ = false;
  }

  TIGER_OUTLINE void step(const RestGains& stored, const Vec3& gyro, const Vec3& accel, bool may_rest) {
    if (!started_) {
      gyro_mean_ = gyro;
      accel_mean_ = accel;
      started_ = true;
    }
    const RestGains gains = load(stored);
    const Vec3 gyro_dev = gyro - gyro_mean_;
    const Vec3 accel_dev = accel - accel_mean_;
    gyro_mean_ = gyro_mean_ + gains.mean_share * gyro_dev;
    accel_mean_ = accel_mean_ + gains.mean_share * accel_dev;
    const bool quiet = may_rest && dot(gyro_dev, gyro_dev) < gains.gyro_limit2 &&
                       dot(accel_dev, accel_dev) < gains.accel_limit2 && may_be_bias(gains.bias_limit);
    if (!quiet) {
      quiet_ticks_ = 0;
    } else if (quiet_ticks_ < gains.settle_ticks) {
      quiet_ticks_++;
    }
    resting_ = quiet_ticks_ >= gains.settle_ticks;
  }

  bool resting() const { return resting_; }
  const Vec3& gyro_mean() const { return gyro_mean_; }

 private:
  bool may_be_bias(float limit) const {
    return fabsf(gyro_mean_.x) < limit && fabsf(gyro_mean_.y) < limit && fabsf(gyro_mean_.z) < limit;
  }

  Vec3 gyro_mean_ = {}, accel_mean_ = {};
  uint16_t quiet_ticks_ = 0;
  bool started_ = false, resting_ = false;
};

}  // namespace fusion
}  // namespace tiger
