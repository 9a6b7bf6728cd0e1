// Is the sensor at rest? Gyroscope and accelerometer must stay close to their own recent mean for a while.
#pragma once

#include <stdint.h>

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

class RestDetector {
 public:
  void begin(const RestTuning& tuning, float period_s) {
    weight_ = period_s / (tuning.mean_tau_s + period_s);
    gyro_limit2_ = tuning.gyro_limit_radps * tuning.gyro_limit_radps;
    accel_limit2_ = tuning.accel_limit_mps2 * tuning.accel_limit_mps2;
    bias_limit_ = tuning.bias_limit_radps;
    settle_ticks_ = static_cast<uint16_t>(tuning.settle_s / period_s);
    quiet_ticks_ = 0;
    started_ = false;
  }

  void step(const Vec3& gyro, const Vec3& accel, bool may_rest) {
    if (!started_) {
      gyro_mean_ = gyro;
      accel_mean_ = accel;
      started_ = true;
    }
    const Vec3 gyro_dev = gyro - gyro_mean_;
    const Vec3 accel_dev = accel - accel_mean_;
    gyro_mean_ = gyro_mean_ + weight_ * gyro_dev;
    accel_mean_ = accel_mean_ + weight_ * accel_dev;
    const bool quiet = may_rest && dot(gyro_dev, gyro_dev) < gyro_limit2_ &&
                       dot(accel_dev, accel_dev) < accel_limit2_ && fabsf(gyro_mean_.x) < bias_limit_ &&
                       fabsf(gyro_mean_.y) < bias_limit_ && fabsf(gyro_mean_.z) < bias_limit_;
    if (!quiet) {
      quiet_ticks_ = 0;
    } else if (quiet_ticks_ < settle_ticks_) {
      quiet_ticks_++;
    }
  }

  bool resting() const { return started_ && quiet_ticks_ >= settle_ticks_; }
  const Vec3& gyro_mean() const { return gyro_mean_; }

 private:
  Vec3 gyro_mean_, accel_mean_;
  float weight_, gyro_limit2_, accel_limit2_, bias_limit_;
  uint16_t settle_ticks_, quiet_ticks_ = 0;
  bool started_ = false;
};

}  // namespace fusion
}  // namespace tiger
