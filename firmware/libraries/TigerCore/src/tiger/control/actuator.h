// One actuator: its reading, observer, loops, limits and watch, put together. No pin, no clock: one call of observe,
// diagnose and then follow, brake or release per control tick.
#pragma once

#include <stdint.h>

#include "diagnosis.h"
#include "fixed.h"
#include "position_loop.h"
#include "pot_curve.h"
#include "rate_loop.h"
#include "stroke_observer.h"
#include "thermal.h"

namespace tiger {

class Actuator {
 public:
  struct Limits {
    int32_t low;   // soft limits, 10 nm
    int32_t high;  //
    int32_t full;  // whole stroke
    int16_t full_speed;
  };

  // Readings at the five points of the curve; false when they make no curve.
  bool configure(const uint16_t readings[PotCurve::kPoints], uint16_t full_stroke_counts,
                 const Limits& limits) {
    limits_ = limits;
    rate_loop_.set_full_speed(limits.full_speed);
    return curve_.set(readings, full_stroke_counts);
  }

  // At rest, where the reading says.
  void start(uint16_t reading) {
    const int32_t stroke = curve_.stroke(reading);
    observer_.start(stroke);
    diagnosis_.start(stroke);
    position_loop_.start(stroke);
    rate_loop_.rest(0);
    fault_ = wire::Fault::kNone;
  }

  // The tick begins: what the past one's drive did, and what the potentiometer says of it.
  void observe(uint16_t reading, bool is_fresh) {
    observer_.predict(drive_);
    thermal_.tick(duty_permille_);
    if (!is_fresh) return;
    reading_ = curve_.stroke(reading);
    const int32_t surprise = observer_.surprise(reading_);
    fault_ = diagnosis_.check_reading(curve_.in_range(reading), reading_, surprise);
    if (diagnosis_.trusted()) observer_.correct(surprise);
  }

  wire::Fault diagnose(bool lower, bool upper) {
    lower_ = lower;
    upper_ = upper;
    const wire::Fault motion = diagnosis_.check_motion(reading_, drive_, limits_.full_speed);
    const wire::Fault ends = diagnosis_.check_switches(lower, upper, observer_.stroke(), limits_.full);
    if (fault_ != wire::Fault::kNone) return fault_;
    if (motion != wire::Fault::kNone) return motion;
    if (ends != wire::Fault::kNone) return ends;
    return thermal_.too_hot() ? wire::Fault::kOverheat : wire::Fault::kNone;
  }

  bool fault_present(wire::Fault fault) const {
    switch (fault) {
      case wire::Fault::kPotOpen:
        return fault_ == fault;
      case wire::Fault::kPotNoisy:
        return !diagnosis_.reading_settled();
      case wire::Fault::kLimitSwitch:
        return !diagnosis_.switches_agree();
      case wire::Fault::kOverheat:
        return !thermal_.cooled();
      default:
        return false;
    }
  }

  // Follows a stroke rate; the duty to drive with.
  int16_t follow(int16_t rate) {
    const int32_t stop_point = observer_.stop_point();
    // A lag that could not be made up is forgiven as soon as the command no longer asks for it.
    const bool is_new = (rate > 0) != (last_rate_ > 0) || (rate < 0) != (last_rate_ < 0);
    last_rate_ = rate;
    if (is_new && rate_limited_ && position_loop_.turns_from(rate, stop_point)) take_over();
    const int16_t moved = position_loop_.advance(rate, limits_.low, limits_.high);
    stroke_limited_ = moved != rate;
    rate_limited_ = position_loop_.hold_leash(stop_point);
    const int16_t target = position_loop_.step(moved, stop_point);
    if (target == 0) {
      rate_loop_.rest(observer_.rate());
      return drive(0);
    }
    const int16_t duty_permille = drive(rate_loop_.step(target, observer_.rate()));
    if (barred_) take_over();  // nothing to make up for later
    return duty_permille;
  }

  // Stops the motion as fast as it can, then rests there.
  int16_t brake() {
    const int16_t rate = observer_.rate();
    position_loop_.start(observer_.stop_point());
    rate_loop_.rest(rate);
    stroke_limited_ = rate_limited_ = false;
    if (magnitude(rate) < kBrakeDoneRate) return drive(0);
    return drive(static_cast<int16_t>(clamp32(-static_cast<int32_t>(rate) * kBrakeGain, limits_.full_speed)));
  }

  // The drive was switched off from outside.
  void release() {
    drive(0);
    take_over();
  }

  // The reference begins where the actuator is about to rest.
  void take_over() {
    position_loop_.start(observer_.stop_point());
    rate_loop_.rest(observer_.rate());
    stroke_limited_ = rate_limited_ = false;
  }

  int32_t reference() const { return position_loop_.reference(); }
  int32_t lag() const { return magnitude(position_loop_.error(observer_.stop_point())); }
  int16_t rate() const { return observer_.rate(); }
  int16_t duty_permille() const { return duty_permille_; }
  bool rate_limited() const { return rate_limited_; }
  bool stroke_limited() const { return stroke_limited_; }

  // In counts of the wire, 2 um: x / 200 as x / 16 * 5243 / 65536.
  uint16_t stroke_counts() const {
    const int32_t stroke = clamp32(observer_.stroke(), kMaxStroke);
    return stroke <= 0 ? 0 : static_cast<uint16_t>((static_cast<uint32_t>(stroke >> 4) * 5243u) >> 16);
  }

 private:
  static constexpr int32_t kMaxStroke = 100 * kUnitsPerMm;
  static constexpr uint8_t kBrakeGain = 3;
  static constexpr int16_t kBrakeDoneRate = 300;

  // A pressed limit switch bars the way it stands in.
  int16_t drive(int16_t wanted) {
    barred_ = (upper_ && wanted > 0) || (lower_ && wanted < 0);
    drive_ = barred_ ? int16_t{0} : wanted;
    duty_permille_ = rate_loop_.duty_permille(drive_);
    if (duty_permille_ == 0) drive_ = 0;
    return duty_permille_;
  }

  PotCurve curve_;
  StrokeObserver observer_;
  PositionLoop position_loop_;
  RateLoop rate_loop_;
  Diagnosis diagnosis_;
  Thermal thermal_;
  Limits limits_ = {};
  int32_t reading_ = 0;
  int16_t last_rate_ = 0;
  int16_t drive_ = 0;  // of the past tick: the rate it settles at
  int16_t duty_permille_ = 0;
  wire::Fault fault_ = wire::Fault::kNone;  // of the reading
  bool lower_ = false;
  bool upper_ = false;
  bool barred_ = false;
  bool rate_limited_ = false;
  bool stroke_limited_ = false;
};

}  // namespace tiger
