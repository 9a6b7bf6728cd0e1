// Gyroscope bias: a Kalman filter with three random-walk states and two kinds of measurement.
//
// At rest the mean rate is the bias. In motion the rate at which the inclination needs correcting is what the
// bias does, seen through the rotation: its horizontal part is a measurement, its vertical part only a weak
// wish for zero that bounds the drift of what cannot be observed. (Laidig & Seel, Information Fusion 91, 2023,
// section 3.5.) The measurement noises are independent, so each row is taken on its own: three scalar updates
// need no matrix inverse and a third of the cycles.
#pragma once

#include "low_pass.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct BiasTuning {
  float sigma_init_radps = 0.00873f;     // 0.5 degrees/s
  float forgetting_s = 100.0f;           // time in which the uncertainty grows by 0.1 degrees/s
  float limit_radps = 0.0349f;           // 2 degrees/s: the estimate never leaves +- this
  float sigma_motion_radps = 0.001745f;  // 0.1 degrees/s, where it settles in motion
  float sigma_rest_radps = 0.000524f;    // 0.03 degrees/s, where it settles at rest
  float vertical_factor = 1e-4f;         // how much the unobservable direction counts
};

class GyroBias {
 public:
  // `period_s` is the time between two updates, `tau_s` that of the accelerometer's low-pass.
  void begin(const BiasTuning& tuning, float tau_s, float period_s) {
    lag_gains_ = low_pass_gains(tau_s, period_s);
    constexpr float kGrowthRadps = 0.001745f;  // 0.1 degrees/s in forgetting_s
    growth_ = kGrowthRadps * kGrowthRadps * period_s / tuning.forgetting_s;
    variance_init_ = tuning.sigma_init_radps * tuning.sigma_init_radps;
    noise_motion_ = settled_noise(tuning.sigma_motion_radps);
    noise_rest_ = settled_noise(tuning.sigma_rest_radps);
    noise_vertical_ = noise_motion_ / tuning.vertical_factor;
    limit_ = tuning.limit_radps;
    rate_of_tilt_ = 1.0f / period_s;
    bias_ = Vec3{0.0f, 0.0f, 0.0f};
    lag_.reset();
    pxx_ = pyy_ = pzz_ = variance_init_;
    pxy_ = pxz_ = pyz_ = 0.0f;
  }

  void start_from(const Vec3& bias) { bias_ = bias; }
  const Vec3& value() const { return bias_; }

  // Rest: `mean_rate` is a measurement of the bias.
  void update_at_rest(const Mat3& body_to_inclined, const Vec3& mean_rate) {
    float lagged[kLagged];
    lag(body_to_inclined, lagged);
    grow();
    absorb(Vec3{1.0f, 0.0f, 0.0f}, mean_rate.x - bias_.x, noise_rest_);
    absorb(Vec3{0.0f, 1.0f, 0.0f}, mean_rate.y - bias_.y, noise_rest_);
    absorb(Vec3{0.0f, 0.0f, 1.0f}, mean_rate.z - bias_.z, noise_rest_);
    limit();
  }

  // Motion: `tilt_x`, `tilt_y` are the horizontal parts of the unit vector that should have pointed up when
  // the inclination was corrected.
  void update_in_motion(const Mat3& body_to_inclined, float tilt_x, float tilt_y) {
    float lagged[kLagged];
    lag(body_to_inclined, lagged);
    grow();
    const Vec3 row_x = {lagged[0], lagged[1], lagged[2]};
    const Vec3 row_y = {lagged[3], lagged[4], lagged[5]};
    const Vec3 row_z = {lagged[6], lagged[7], lagged[8]};
    absorb(row_x, lagged[9] - tilt_y * rate_of_tilt_ - dot(row_x, bias_), noise_motion_);
    absorb(row_y, lagged[10] + tilt_x * rate_of_tilt_ - dot(row_y, bias_), noise_motion_);
    absorb(row_z, -dot(row_z, bias_), noise_vertical_);
    limit();
  }

 private:
  static constexpr uint8_t kLagged = 11;

  // The accelerometer sees a tilt error late, through its low-pass: the rotation and the bias already taken out
  // must pass through the same filter to be comparable.
  void lag(const Mat3& body_to_inclined, float* lagged) {
    float* v = lagged;
    for (uint8_t i = 0; i < 3; i++) {
      *v++ = body_to_inclined.row[i].x;
      *v++ = body_to_inclined.row[i].y;
      *v++ = body_to_inclined.row[i].z;
    }
    *v++ = dot(body_to_inclined.row[0], bias_);
    *v++ = dot(body_to_inclined.row[1], bias_);
    lag_.update(lag_gains_, lagged, lagged);
  }

  // Measurement noise for which the variance settles at sigma^2 under the growth per update.
  float settled_noise(float sigma) const {
    const float variance = sigma * sigma;
    return variance * variance / growth_ + variance;
  }

  void grow() {
    if (pxx_ < variance_init_) pxx_ += growth_;
    if (pyy_ < variance_init_) pyy_ += growth_;
    if (pzz_ < variance_init_) pzz_ += growth_;
  }

  // One scalar measurement: innovation = (measured - row . bias).
  void absorb(const Vec3& row, float innovation, float noise) {
    const Vec3 s = {pxx_ * row.x + pxy_ * row.y + pxz_ * row.z, pxy_ * row.x + pyy_ * row.y + pyz_ * row.z,
                    pxz_ * row.x + pyz_ * row.y + pzz_ * row.z};
    const float inverse = 1.0f / (dot(row, s) + noise);
    const Vec3 gain = inverse * s;
    bias_ = bias_ + clamp(innovation, limit_) * gain;
    pxx_ -= gain.x * s.x;
    pxy_ -= gain.x * s.y;
    pxz_ -= gain.x * s.z;
    pyy_ -= gain.y * s.y;
    pyz_ -= gain.y * s.z;
    pzz_ -= gain.z * s.z;
  }

  void limit() {
    bias_.x = clamp(bias_.x, limit_);
    bias_.y = clamp(bias_.y, limit_);
    bias_.z = clamp(bias_.z, limit_);
  }

  LowPass<kLagged> lag_;
  LowPassGains lag_gains_;
  Vec3 bias_;
  float pxx_, pxy_, pxz_, pyy_, pyz_, pzz_;
  float growth_, variance_init_, noise_motion_, noise_rest_, noise_vertical_, limit_, rate_of_tilt_;
};

}  // namespace fusion
}  // namespace tiger
