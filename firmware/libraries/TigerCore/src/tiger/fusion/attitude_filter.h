// Attitude of the body from gyroscope, accelerometer and magnetometer.
//
// Structure after Laidig & Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and
// magnetic disturbance rejection", Information Fusion 91 (2023), doi 10.1016/j.inffus.2022.10.014:
//
//   body --gyro--> almost inertial frame --inclination--> inclined frame --heading--> earth (east north up)
//
// The gyroscope alone turns body into a frame that drifts slowly; there the accelerometer can be averaged over
// seconds, which leaves gravity however the body moved; a correction makes that average vertical; one angle
// about the vertical makes north north. Errors of the magnetometer cannot reach roll and pitch.
//
// The work is split over ticks so that it fits a 16 MHz AVR: every tick integrates the gyroscope and averages
// the accelerometer; a quarter of the rest is done in each of four ticks: correct the inclination, correct the
// heading (a magnetometer sample waits for its turn, already carried into the inertial frame), follow the rotation,
// update the bias. The full structure at every sample costs 177 k cycles, this 57 k.
#pragma once

#include <stdint.h>

#include "flash.h"
#include "gyro_bias.h"
#include "heading.h"
#include "low_pass.h"
#include "rest_detector.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct AttitudeTuning {
  float tick_s = 0.01f;
  float mag_period_s = 0.05f;
  uint8_t slow_every =
      4;  // ticks between two corrections: a multiple of four, or 1: everything in every tick
  float accel_tau_s = 3.0f;
  RestTuning rest;
  BiasTuning bias;
  HeadingTuning heading;
};

struct AttitudeGains {
  uint8_t slow_every;
  uint8_t recovery;  // slow steps after a gap in which the attitude walks and no bias is learnt
  LowPassGains accel;
  RestGains rest;
  BiasGains bias;
  HeadingGains heading;
};

// A compile-time constant for a constant tuning, so that the AVR computes none of it.
constexpr AttitudeGains attitude_gains(const AttitudeTuning& t) {
  return AttitudeGains{
      t.slow_every,
      static_cast<uint8_t>(2.0f * t.accel_tau_s / (t.tick_s * static_cast<float>(t.slow_every)) < 254.0f
                               ? 2.0f * t.accel_tau_s / (t.tick_s * static_cast<float>(t.slow_every))
                               : 254.0f),
      low_pass_gains(t.accel_tau_s, t.tick_s),
      rest_gains(t.rest, t.tick_s),
      bias_gains(t.bias, t.accel_tau_s, t.tick_s * static_cast<float>(t.slow_every)),
      heading_gains(t.heading, t.mag_period_s)};
}

// One sample of the inertial sensor in body axes. `vehicle_accel` is what odometry says the body accelerates,
// zero without odometry: it is taken off the specific force before the averaging.
struct ImuSample {
  Vec3 gyro_radps;
  Vec3 accel_mps2;
  Vec3 vehicle_accel_mps2;
  bool accel_usable;
  bool may_rest;
};

class AttitudeFilter {
 public:
  // `gains` must outlive the filter, and be declared TIGER_FLASH on the AVR.
  explicit AttitudeFilter(const AttitudeGains& gains) : gains_(gains) { reset(); }

  void reset() {
    rest_.reset();
    bias_.reset(gains_.bias);
    heading_.reset();
    accel_low_pass_.reset();
    inertial_ = inclination_ = earth_ = identity();
    up_ = Vec3{0.0f, 0.0f, 0.0f};
    tilt_x_ = tilt_y_ = 0.0f;
    phase_ = recovery_ = 0;
    mag_waiting_ = started_ = has_up_ = false;
  }

  void start_bias_from(const Vec3& bias_radps) { bias_.start_from(bias_radps); }

  // One tick is sense(), add_magnetometer() if there is a new sample, think(). `dt_s` is the time since the sample
  // before; zero for a sample that follows a gap too long to bridge: the attitude is then held across the gap.
  TIGER_OUTLINE void sense(const ImuSample& sample, float dt_s) {
    rest_.step(gains_.rest, sample.gyro_radps, sample.accel_mps2, sample.may_rest);
    integrate(sample.gyro_radps, dt_s);
    has_up_ = sample.accel_usable;
    if (has_up_) average(sample);
  }

  // A new magnetometer sample, of the instant of the latest sense().
  TIGER_OUTLINE void add_magnetometer(const Vec3& field_ut) {
    field_ = rotate(inertial_, field_ut);
    mag_waiting_ = true;
  }

  // This tick's quarter of the slow work.
  TIGER_OUTLINE void think() {
    const uint8_t slow_every = load(gains_.slow_every);
    const uint8_t quarter = slow_every / 4;
    if (phase_ == 0 && has_up_) correct_inclination();
    if (phase_ == quarter && mag_waiting_) update_heading();
    if (phase_ == 2 * quarter) bias_.track(gains_.bias, inclination_ * inertial_);
    if (phase_ == 3 * quarter) update_bias();
    if (++phase_ >= slow_every) phase_ = 0;
  }

  // Call before the first sample after a gap. The body may have turned meanwhile: gravity is averaged afresh and
  // the attitude walks to it, without a jump, until the average has settled; what the gap did is not taken for
  // gyroscope bias.
  void resume() {
    accel_low_pass_.reset();
    recovery_ = load(gains_.recovery);
  }

  // Body to earth.
  Quat attitude() const { return earth_ * inertial_; }
  // Body to a frame that is level but whose heading only drifts: no magnetometer in it.
  Quat attitude_without_heading() const { return inclination_ * inertial_; }
  const Vec3& rate_radps() const { return rate_; }
  const Vec3& bias_radps() const { return bias_.value(); }
  bool resting() const { return rest_.resting(); }
  // Mean rate over the last half second, bias removed: what tells a slow steady turn from rest.
  Vec3 mean_rate_radps() const { return rest_.gyro_mean() - bias_.value(); }
  bool magnetically_disturbed() const { return heading_.disturbed(); }
  float heading_rad() const { return heading_.angle(); }

 private:
  // The rate is held over the tick, which leads the sample by half a tick: about the delay of the sensor's own
  // low-pass (5 ms at 47 Hz). The second term is what a turning axis adds within a tick (coning).
  TIGER_OUTLINE void integrate(const Vec3& gyro, float dt_s) {
    const Vec3 rate = gyro - bias_.value();
    if (!started_) {
      rate_ = rate;
      started_ = true;
    }
    const Vec3 coned = rate + (dt_s * (1.0f / 12.0f)) * cross(rate_, rate);
    rate_ = rate;
    inertial_ = inertial_ * small_turn(dt_s * coned);
  }

  TIGER_OUTLINE void average(const ImuSample& sample) {
    const Vec3 a = rotate(inertial_, sample.accel_mps2 - sample.vehicle_accel_mps2);
    const float in[3] = {a.x, a.y, a.z};
    float out[3];
    accel_low_pass_.update(gains_.accel, in, out);
    up_ = Vec3{out[0], out[1], out[2]};
  }

  // The shortest turn that makes the averaged specific force point up.
  TIGER_OUTLINE void correct_inclination() {
    inertial_ = renormalised(inertial_);
    const Vec3 up = rotate(inclination_, up_);
    const float norm = sqrtf(dot(up, up));
    if (!(norm > 1e-3f)) return;
    const float scale = 1.0f / norm;
    tilt_x_ = scale * up.x;
    tilt_y_ = scale * up.y;
    inclination_ = normalised(turn_upright(scale * up.z) * inclination_);
    combine();
  }

  // The turn that takes (tilt_x_, tilt_y_, up_z) upright, or one step of the walk towards it; any length.
  Quat turn_upright(float up_z) {
    const float twice = recovery_ > 0 && limit_tilt() ? 2.0f : 1.0f + up_z;
    if (twice > 1e-6f) return Quat{twice, {tilt_y_, -tilt_x_, 0.0f}};
    return Quat{0.0f, {1.0f, 0.0f, 0.0f}};  // upside down: about any horizontal axis
  }

  // Shortens the tilt to one step of the walk; false when it was that short already.
  bool limit_tilt() {
    const float tilt2 = tilt_x_ * tilt_x_ + tilt_y_ * tilt_y_;
    if (tilt2 <= kWalkStepRad * kWalkStepRad) return false;
    recovery_++;  // the walk takes its time; the average settles only after it
    const float shorten = kWalkStepRad / sqrtf(tilt2);
    tilt_x_ *= shorten;
    tilt_y_ *= shorten;
    return true;
  }

  TIGER_OUTLINE void update_bias() {
    if (recovery_ > 0) {
      recovery_--;
    } else if (rest_.resting()) {
      bias_.update_at_rest(gains_.bias, rest_.gyro_mean());
    } else {
      bias_.update_in_motion(gains_.bias, tilt_x_, tilt_y_);
    }
  }

  TIGER_OUTLINE void update_heading() {
    heading_.step(gains_.heading, rotate(inclination_, field_), rest_.gyro_mean());
    bias_.see_heading(heading_.shows_drift(), heading_.correction_rad() * load(gains_.heading.updates_per_s),
                      load(gains_.heading.share));
    mag_waiting_ = false;
    combine();
  }

  TIGER_OUTLINE void combine() {
    const float half = 0.5f * heading_.angle();
    earth_ = Quat{cosf(half), {0.0f, 0.0f, sinf(half)}} * inclination_;
  }

  static constexpr float kWalkStepRad = 0.0035f;  // 0.2 degrees a correction: 5 degrees/s at 25 Hz

  const AttitudeGains& gains_;
  Quat inertial_;     // body -> almost inertial
  Quat inclination_;  // almost inertial -> inclined
  Quat earth_;        // almost inertial -> earth
  Vec3 rate_;         // bias removed
  Vec3 up_;           // averaged specific force, almost inertial frame
  Vec3 field_;        // magnetic field waiting, almost inertial frame
  float tilt_x_, tilt_y_;
  LowPass<3> accel_low_pass_;
  RestDetector rest_;
  GyroBias bias_;
  Heading heading_;
  uint8_t phase_, recovery_;
  bool mag_waiting_, started_, has_up_;
};

}  // namespace fusion
}  // namespace tiger
