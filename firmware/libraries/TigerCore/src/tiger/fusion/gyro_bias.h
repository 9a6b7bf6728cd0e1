// Gyroscope bias: a Kalman filter with three random-walk states and two kinds of measurement.
//
// At rest the mean rate is the bias. In motion the rate at which the inclination needs correcting is what the
// bias does, seen through the rotation: that measures its horizontal part. The vertical part is measured by the
// rate at which the heading needs correcting; without a magnetometer to trust, a weak wish for zero bounds the drift
// of what cannot be observed. (Laidig & Seel, Information Fusion 91, 2023, except for the use of the heading.)
// The measurement noises are independent, so each row is taken on its own: three scalar updates need no matrix
// inverse and a third of the cycles.
#pragma once

#include <string.h>

#include "flash.h"
#include "low_pass.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct BiasTuning {
  float sigma_init_radps = 0.00873f;     // 0.5 degrees/s
  float growth_radps = 0.001745f;        // the uncertainty grows to 0.1 degrees/s
  float forgetting_s = 100.0f;           // in this time
  float limit_radps = 0.0349f;           // 2 degrees/s: the estimate never leaves +- this
  float sigma_motion_radps = 0.001745f;  // 0.1 degrees/s, where it settles in motion
  float sigma_heading_radps = 0.00175f;  // 0.1 degrees/s, where the vertical part settles
  float sigma_rest_radps = 0.000524f;    // 0.03 degrees/s, where it settles at rest
  float vertical_factor = 1e-4f;         // how much the unobservable direction counts
};

struct BiasGains {
  LowPassGains lag;
  float growth, variance_init, noise_motion, noise_heading, noise_vertical, noise_rest, limit, updates_per_s;
};

namespace detail {
// Measurement noise for which the variance settles at `v` when it grows by `growth` an update.
constexpr float settled_noise(float v, float growth) { return v * v / growth + v; }
constexpr float square(float x) { return x * x; }

constexpr BiasGains bias_gains(const BiasTuning& t, const LowPassGains& lag, float growth, float period_s) {
  return BiasGains{lag,
                   growth,
                   square(t.sigma_init_radps),
                   settled_noise(square(t.sigma_motion_radps), growth),
                   settled_noise(square(t.sigma_heading_radps), growth),
                   settled_noise(square(t.sigma_motion_radps), growth) / t.vertical_factor,
                   settled_noise(square(t.sigma_rest_radps), growth),
                   t.limit_radps,
                   1.0f / period_s};
}
}  // namespace detail

// `period_s` is the time between two updates, `tau_s` that of the accelerometer's low-pass.
constexpr BiasGains bias_gains(const BiasTuning& t, float tau_s, float period_s) {
  return detail::bias_gains(t, low_pass_gains(tau_s, period_s),
                            detail::square(t.growth_radps) * period_s / t.forgetting_s, period_s);
}

class GyroBias {
 public:
  void reset(const BiasGains& gains) {
    const float variance = load(gains.variance_init);
    bias_ = Vec3{0.0f, 0.0f, 0.0f};
    lag_.reset();
    vertical_ = vertical_lag_ = 0.0f;
    sees_vertical_ = false;
    covariance_[0] = Vec3{variance, 0.0f, 0.0f};
    covariance_[1] = Vec3{0.0f, variance, 0.0f};
    covariance_[2] = Vec3{0.0f, 0.0f, variance};
  }

  void start_from(const Vec3& bias) { bias_ = bias; }
  const Vec3& value() const { return bias_; }

  // The accelerometer sees a tilt error late, through its low-pass: the rotation and the bias already taken out
  // must pass through the same filter to be comparable. Once before every update.
  TIGER_OUTLINE void track(const BiasGains& gains, const Quat& body_to_inclined) {
    struct {
      Mat3 rotation;
      float bias[2];
    } now = {matrix(body_to_inclined), {}};
    static_assert(sizeof(now) == kLagged * sizeof(float), "a row of floats");
    now.bias[0] = dot(now.rotation.row[0], bias_);
    now.bias[1] = dot(now.rotation.row[1], bias_);
    float* const floats = reinterpret_cast<float*>(&now);
    lag_.update(gains.lag, floats, floats);
  }

  // The heading, a first-order follower of the field by `share` a step, was corrected at this rate. What it shows
  // of the bias is late by its time constant, and so is the bias already taken out.
  void see_heading(bool shows_drift, float correction_radps, float share) {
    vertical_lag_ += share * (dot(lagged_row(2), bias_) - vertical_lag_);
    sees_vertical_ = shows_drift;
    vertical_ = shows_drift ? vertical_lag_ - correction_radps : 0.0f;
  }

  // Rest: `mean_rate` is a measurement of the bias.
  TIGER_OUTLINE void update_at_rest(const BiasGains& gains, const Vec3& mean_rate) {
    grow(gains);
    absorb(gains, Vec3{1.0f, 0.0f, 0.0f}, mean_rate.x, load(gains.noise_rest));
    absorb(gains, Vec3{0.0f, 1.0f, 0.0f}, mean_rate.y, load(gains.noise_rest));
    absorb(gains, Vec3{0.0f, 0.0f, 1.0f}, mean_rate.z, load(gains.noise_rest));
  }

  // Motion: `tilt_x`, `tilt_y` are the horizontal parts of the unit vector that should have pointed up when
  // the inclination was corrected.
  TIGER_OUTLINE void update_in_motion(const BiasGains& gains, float tilt_x, float tilt_y) {
    grow(gains);
    absorb(gains, lagged_row(0), lag_.ahead(9) - tilt_y * load(gains.updates_per_s),
           load(gains.noise_motion));
    absorb(gains, lagged_row(1), lag_.ahead(10) + tilt_x * load(gains.updates_per_s),
           load(gains.noise_motion));
    absorb(gains, lagged_row(2), vertical_,
           load(sees_vertical_ ? gains.noise_heading : gains.noise_vertical));
  }

 private:
  static constexpr uint8_t kLagged = 11;  // the rotation's nine entries, and two of the bias it carries

  Vec3 lagged_row(uint8_t i) const {
    const uint8_t first = static_cast<uint8_t>(3 * i);
    return Vec3{lag_.ahead(first), lag_.ahead(static_cast<uint8_t>(first + 1)),
                lag_.ahead(static_cast<uint8_t>(first + 2))};
  }

  TIGER_OUTLINE void grow(const BiasGains& gains) {
    float* const diagonal[3] = {&covariance_[0].x, &covariance_[1].y, &covariance_[2].z};
    for (uint8_t i = 0; i < 3; i++) {
      if (*diagonal[i] < load(gains.variance_init)) *diagonal[i] += load(gains.growth);
    }
  }

  // One scalar measurement of row . bias.
  TIGER_OUTLINE void absorb(const BiasGains& gains, const Vec3& row, float measured, float noise) {
    const float limit = load(gains.limit);
    const Vec3 s = {dot(covariance_[0], row), dot(covariance_[1], row), dot(covariance_[2], row)};
    const Vec3 gain = (1.0f / (dot(row, s) + noise)) * s;
    bias_ = bias_ + clamp(measured - dot(row, bias_), limit) * gain;
    bias_ = Vec3{clamp(bias_.x, limit), clamp(bias_.y, limit), clamp(bias_.z, limit)};
    covariance_[0] = covariance_[0] - gain.x * s;
    covariance_[1] = covariance_[1] - gain.y * s;
    covariance_[2] = covariance_[2] - gain.z * s;
  }

  LowPass<kLagged> lag_;
  Vec3 bias_ = {};
  float vertical_ = 0.0f, vertical_lag_ = 0.0f;
  bool sees_vertical_ = false;
  Vec3 covariance_[3] = {};
};

}  // namespace fusion
}  // namespace tiger
