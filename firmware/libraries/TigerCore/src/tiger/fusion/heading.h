// Heading from the magnetometer, kept apart from the inclination: one angle about the vertical.
//
// The magnetic field is believed while its strength and dip match a reference that follows them slowly. Where
// they do not, the heading runs on the gyroscope alone for up to a minute, and then gives way slowly. A
// foreign field becomes the new reference once it has been steady for a while in motion.
// (Laidig & Seel, Information Fusion 91, 2023, sections 3.4 and 3.6.)
#pragma once

#include "rotation.h"

namespace tiger {
namespace fusion {

struct HeadingTuning {
  float tau_s = 9.0f;
  float current_tau_s = 0.05f;    // smoothing of strength and dip before the comparison
  float reference_tau_s = 20.0f;  // how fast the reference follows
  float norm_limit = 0.1f;        // of the reference strength
  float dip_limit_rad = 0.1745f;  // 10 degrees
  float quiet_s = 0.5f;           // undisturbed this long before the field is believed again
  float reject_max_s = 60.0f;
  float reject_factor = 2.0f;
  float new_field_s = 20.0f;            // a foreign field steady this long, in motion, is the new reference
  float first_field_s = 5.0f;           // the very first one
  float new_field_rate_radps = 0.349f;  // 20 degrees/s: what counts as motion
};

class Heading {
 public:
  void begin(const HeadingTuning& tuning, float period_s) {
    tuning_ = tuning;
    period_s_ = period_s;
    angle_ = 0.0f;
    reference_norm_ = 0.0f;
    candidate_norm_ = -1.0f;
    smooth_norm_ = -1.0f;
    quiet_s_ = candidate_s_ = 0.0f;
    rejected_s_ = tuning.reject_max_s;
    samples_ = 0;
    disturbed_ = true;
  }

  // `field`: magnetic field in the inclined frame (z up, heading free). `rate_radps`: how fast the body turns.
  void step(const Vec3& field, float rate_radps) {
    judge(field, rate_radps);
    const float error = wrapped(atan2f(field.x, field.y) - angle_);
    angle_ = wrapped(angle_ + gain() * error);
  }

  // Angle about the vertical that turns the inclined frame into east-north-up.
  float angle() const { return angle_; }
  bool disturbed() const { return disturbed_; }

 private:
  static float share(float period_s, float tau_s) { return period_s / (tau_s + period_s); }

  void judge(const Vec3& field, float rate_radps) {
    const float horizontal2 = field.x * field.x + field.y * field.y;
    float norm = sqrtf(horizontal2 + field.z * field.z);
    float dip = atan2f(-field.z, sqrtf(horizontal2));
    if (smooth_norm_ < 0.0f) {
      smooth_norm_ = norm;
      smooth_dip_ = dip;
    }
    const float k = share(period_s_, tuning_.current_tau_s);
    norm = smooth_norm_ += k * (norm - smooth_norm_);
    dip = smooth_dip_ += k * (dip - smooth_dip_);

    const float follow = period_s_ / tuning_.reference_tau_s;
    if (matches(norm, dip, reference_norm_, reference_dip_)) {
      quiet_s_ += period_s_;
      if (quiet_s_ >= tuning_.quiet_s) {
        disturbed_ = false;
        reference_norm_ += follow * (norm - reference_norm_);
        reference_dip_ += follow * (dip - reference_dip_);
      }
    } else {
      quiet_s_ = 0.0f;
      disturbed_ = true;
    }
    consider_new_field(norm, dip, rate_radps, follow);
  }

  bool matches(float norm, float dip, float norm_of, float dip_of) const {
    return fabsf(norm - norm_of) < tuning_.norm_limit * norm_of &&
           fabsf(dip - dip_of) < tuning_.dip_limit_rad;
  }

  void consider_new_field(float norm, float dip, float rate_radps, float follow) {
    if (!matches(norm, dip, candidate_norm_, candidate_dip_)) {
      candidate_s_ = 0.0f;
      candidate_norm_ = norm;
      candidate_dip_ = dip;
      return;
    }
    if (rate_radps >= tuning_.new_field_rate_radps) candidate_s_ += period_s_;
    candidate_norm_ += follow * (norm - candidate_norm_);
    candidate_dip_ += follow * (dip - candidate_dip_);
    const bool first = reference_norm_ == 0.0f;
    if (disturbed_ && candidate_s_ >= (first ? tuning_.first_field_s : tuning_.new_field_s)) {
      reference_norm_ = candidate_norm_;
      reference_dip_ = candidate_dip_;
      disturbed_ = false;
      quiet_s_ = tuning_.quiet_s;
    }
  }

  // The share of the heading error to correct now: a running mean at first, then first order with tau_s.
  float gain() {
    float k = share(period_s_, tuning_.tau_s);
    if (samples_ < 255) {
      samples_++;
      const float mean = 1.0f / static_cast<float>(samples_);
      if (mean > k) return mean;
    }
    if (!disturbed_) {
      rejected_s_ -= tuning_.reject_factor * period_s_;
      if (rejected_s_ < 0.0f) rejected_s_ = 0.0f;
      return k;
    }
    if (rejected_s_ <= tuning_.reject_max_s) {
      rejected_s_ += period_s_;
      return 0.0f;
    }
    return k / tuning_.reject_factor;
  }

  HeadingTuning tuning_;
  float period_s_, angle_;
  float smooth_norm_, smooth_dip_;
  float reference_norm_, reference_dip_ = 0.0f;
  float candidate_norm_, candidate_dip_ = 0.0f;
  float quiet_s_, candidate_s_, rejected_s_;
  uint8_t samples_;
  bool disturbed_;
};

}  // namespace fusion
}  // namespace tiger
