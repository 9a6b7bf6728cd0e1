// Heading from the magnetometer, kept apart from the inclination: one angle about the vertical.
//
// The magnetic field is believed while its strength and dip match a reference that follows them slowly. Where
// they do not, the heading runs on the gyroscope alone for up to a minute, and then gives way slowly. A
// foreign field becomes the new reference once it has been steady for a while in motion.
// (Laidig & Seel, Information Fusion 91, 2023.) Beyond the paper: a field that turns away from the gyroscope's
// heading by more than the gyroscope can drift is disturbed too, however right its strength and dip; and what the
// heading needs correcting while the field is good is handed to the bias estimate, as only it can see the bias
// about the vertical of a body that is never turned over.
#pragma once

#include "flash.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct HeadingTuning {
  float tau_s = 9.0f;
  float current_tau_s = 0.05f;    // smoothing of strength and dip before the comparison
  float reference_tau_s = 20.0f;  // how fast the reference follows
  float norm_limit = 0.1f;        // of the reference strength
  float dip_limit_rad = 0.1745f;  // 10 degrees
  float jump_limit_rad = 0.17f;   // 10 degrees between field and gyroscope
  float jump_tau_s = 0.5f;        // smoothing of that angle
  float quiet_s = 0.5f;           // undisturbed this long before the field is believed again
  float reject_max_s = 60.0f;
  float reject_factor = 2.0f;
  float new_field_s = 60.0f;          // a foreign field steady this long, in motion, is the new reference
  float first_field_s = 5.0f;         // the very first one, in motion or not
  float new_field_rate_radps = 0.1f;  // 6 degrees/s: what counts as motion
};

struct HeadingGains {
  float period_s, updates_per_s, share, share_current, share_reference, share_jump;
  float norm_limit, dip_limit_rad, jump_limit_rad, quiet_s, reject_max_s, reject_factor, new_field_s,
      first_field_s, new_field_rate2;
};

constexpr HeadingGains heading_gains(const HeadingTuning& t, float period_s) {
  return HeadingGains{period_s,
                      1.0f / period_s,
                      period_s / (t.tau_s + period_s),
                      period_s / (t.current_tau_s + period_s),
                      period_s / (t.reference_tau_s + period_s),
                      period_s / (t.jump_tau_s + period_s),
                      t.norm_limit,
                      t.dip_limit_rad,
                      t.jump_limit_rad,
                      t.quiet_s,
                      t.reject_max_s,
                      t.reject_factor,
                      t.new_field_s,
                      t.first_field_s,
                      t.new_field_rate_radps * t.new_field_rate_radps};
}

class Heading {
 public:
  void reset() {
    angle_ = jump_ = correction_ = 0.0f;
    smooth_.norm = reference_.norm = candidate_.norm = 0.0f;
    quiet_s_ = candidate_s_ = 0.0f;
    rejected_s_ = 1e9f;
    samples_ = 0;
    disturbed_ = true;
  }

  // `field`: magnetic field in the inclined frame (z up, heading free). `rate`: how fast the body turns, averaged.
  TIGER_OUTLINE void step(const HeadingGains& stored, const Vec3& field, const Vec3& rate) {
    const HeadingGains gains = load(stored);
    const float error = wrapped(atan2f(field.x, field.y) - angle_);
    jump_ += gains.share_jump * (error - jump_);
    judge(gains, field, dot(rate, rate) >= gains.new_field_rate2);
    correction_ = gain(gains) * error;
    angle_ = wrapped(angle_ + correction_);
  }

  // Angle about the vertical that turns the inclined frame into east-north-up.
  float angle() const { return angle_; }
  bool disturbed() const { return disturbed_; }
  // What the latest step added to the angle, and whether it tells of the gyroscope's drift alone.
  float correction_rad() const { return correction_; }
  bool shows_drift() const { return settled() && !disturbed_; }

 private:
  struct Field {  // what of the field does not depend on the heading
    float norm, dip;
  };

  static constexpr uint8_t kSettled = 255;  // samples: 13 s
  bool settled() const { return samples_ == kSettled; }

  static bool match(const HeadingGains& gains, const Field& a, const Field& reference) {
    return fabsf(a.norm - reference.norm) < gains.norm_limit * reference.norm &&
           fabsf(a.dip - reference.dip) < gains.dip_limit_rad;
  }

  TIGER_OUTLINE static void follow(Field& field, const Field& target, float share) {
    field.norm += share * (target.norm - field.norm);
    field.dip += share * (target.dip - field.dip);
  }

  TIGER_OUTLINE void judge(const HeadingGains& gains, const Vec3& field, bool turning) {
    const float horizontal = sqrtf(field.x * field.x + field.y * field.y);
    const Field now = {sqrtf(dot(field, field)), atan2f(-field.z, horizontal)};
    follow(smooth_, now, smooth_.norm > 0.0f ? gains.share_current : 1.0f);

    const bool jumped = settled() && fabsf(jump_) > gains.jump_limit_rad;
    if (!jumped && match(gains, smooth_, reference_)) {
      quiet_s_ += gains.period_s;
      if (quiet_s_ >= gains.quiet_s) {
        disturbed_ = false;
        follow(reference_, smooth_, gains.share_reference);
      }
    } else {
      quiet_s_ = 0.0f;
      disturbed_ = true;
    }
    consider_new_field(gains, turning);
  }

  void consider_new_field(const HeadingGains& gains, bool turning) {
    if (!disturbed_ || !match(gains, smooth_, candidate_)) {
      candidate_s_ = 0.0f;
      candidate_ = smooth_;
      return;
    }
    const bool first = reference_.norm <= 0.0f;
    if (turning || first) candidate_s_ += gains.period_s;
    follow(candidate_, smooth_, gains.share_reference);
    if (candidate_s_ >= (first ? gains.first_field_s : gains.new_field_s)) {
      reference_ = candidate_;
      disturbed_ = false;
      quiet_s_ = gains.quiet_s;
    }
  }

  // The share of the heading error to correct now: a running mean at first, then first order.
  float gain(const HeadingGains& gains) {
    if (!settled()) {
      samples_++;
      const float mean = 1.0f / static_cast<float>(samples_);
      if (mean > gains.share) return mean;
    }
    if (!disturbed_) {
      rejected_s_ -= gains.reject_factor * gains.period_s;
      if (rejected_s_ > gains.reject_max_s) rejected_s_ = gains.reject_max_s;
      if (rejected_s_ < 0.0f) rejected_s_ = 0.0f;
      return gains.share;
    }
    if (rejected_s_ <= gains.reject_max_s) {
      rejected_s_ += gains.period_s;
      return 0.0f;
    }
    return gains.share / gains.reject_factor;
  }

  float angle_ = 0.0f, jump_ = 0.0f, correction_ = 0.0f;
  Field smooth_ = {}, reference_ = {}, candidate_ = {};
  float quiet_s_ = 0.0f, candidate_s_ = 0.0f, rejected_s_ = 0.0f;
  uint8_t samples_ = 0;
  bool disturbed_ = true;
};

}  // namespace fusion
}  // namespace tiger
