// Watches one actuator for what cannot be true, each tick of 10 ms. Finds every fault within 200 ms.
//
// Reading: beyond its range (open, shorted), or jumping farther than the actuator moves (noisy).
// Motion: the way travelled since an anchor, against the way that the drive should have brought, by the actuator's model
// without correction. Driven and not moving: jam. Driven and moving backwards: reversed. Not driven and moving: driver.
// Switches: pressed away from their end, or not pressed beyond it.
#pragma once

#include <stdint.h>

#include "../protocol.h"
#include "fixed.h"

namespace tiger {

class Diagnosis {
 public:
  using Fault = wire::Fault;

  void start(int32_t reading) {
    *this = Diagnosis();
    anchor_ = last_ = reading;
  }

  // Of the reading; first thing of a tick. `surprise`: against the observer.
  Fault check_reading(bool in_range, int32_t reading, int32_t surprise) {
    const bool jumps = magnitude(reading - last_) > kJump || magnitude(surprise) > kSurprise;
    last_ = reading;
    open_ticks_ = in_range ? 0 : count(open_ticks_);
    trusted_ = in_range && !jumps;
    if (!in_range) return open_ticks_ >= kOpenTicks ? Fault::kPotOpen : Fault::kNone;
    noise_ = jumps ? static_cast<uint8_t>(noise_ + kJumpPoints)
                   : static_cast<uint8_t>(noise_ > 0 ? noise_ - 1 : 0);
    if (noise_ < kNoisyPoints) return Fault::kNone;
    noise_ = kNoisyPoints;
    return Fault::kPotNoisy;
  }

  // The reading of this tick may correct the observer.
  bool trusted() const { return trusted_; }
  bool reading_settled() const { return trusted_ && noise_ == 0; }

  // Of the motion in the past tick under `drive` (rate it settles at), of `full_speed`.
  Fault check_motion(int32_t reading, int16_t drive, int16_t full_speed) {
    const int16_t rate_before = rate_;
    const int16_t gap = minus(drive, rate_);
    rate_ = saturate16(static_cast<int32_t>(rate_) + scale(gap, kLagShare));
    expected_way_ += rate_before + scale(gap, kLagTravel);
    const bool turned = (drive > 0) != (last_drive_ > 0) || (drive < 0) != (last_drive_ < 0);
    last_drive_ = drive;
    if (!trusted_) {
      untrusted_ = true;  // the way of this tick is unknown
      return Fault::kNone;
    }
    if (turned)
      ran_while_off_ = drive != 0 && idle_ && magnitude(reading - anchor_ - expected_way_) > kIdleHint;
    if (turned || untrusted_) anchor(reading);
    if (turned) jam_way_ = kJamWay + kBacklash;
    idle_ = drive == 0;
    untrusted_ = false;
    const int32_t way = reading - anchor_;
    if (drive == 0) return check_idle(reading, way);
    if (magnitude(drive) < full_speed / 2) {  // friction may take most of it
      anchor(reading);
      return Fault::kNone;
    }
    return drive > 0 ? check_driven(reading, way, expected_way_, coast_)
                     : check_driven(reading, -way, -expected_way_, -coast_);
  }

  // Of the limit switches, with the observed stroke and its full length.
  Fault check_switches(bool lower, bool upper, int32_t stroke, int32_t full_stroke) {
    const bool wrong = (lower && stroke > kSwitchZone) || (upper && stroke < full_stroke - kSwitchZone) ||
                       (!lower && stroke < -kBeyondEnd) || (!upper && stroke > full_stroke + kBeyondEnd);
    switch_ticks_ = wrong ? count(switch_ticks_) : 0;
    return switch_ticks_ >= kSwitchTicks ? Fault::kLimitSwitch : Fault::kNone;
  }
  bool switches_agree() const { return switch_ticks_ == 0; }

 private:
  static constexpr uint8_t kOpenTicks = 3;
  static constexpr int32_t kJump = kUnitsPerMm / 2;  // in one tick; full speed is 0.1 mm
  static constexpr int32_t kSurprise = kUnitsPerMm;  // against the observer
  static constexpr uint8_t kJumpPoints = 3;          // a jump counts three, a quiet tick takes one back
  static constexpr uint8_t kNoisyPoints = 12;
  static constexpr int32_t kIdleWay = kUnitsPerMm / 2;  // with the drive off
  static constexpr int32_t kIdleHint = 6 * kUnitsPerMm / 100;
  static constexpr uint8_t kIdleTicks = 100;  // then a new anchor: drift is not motion
  static constexpr int32_t kJamWay = 6 * kUnitsPerMm / 10;
  static constexpr int32_t kBacklash = 3 * kUnitsPerMm / 10;  // more of it after a turn
  static constexpr int32_t kReversedWay = 15 * kUnitsPerMm / 100;
  static constexpr uint8_t kReversedTicks = 2;
  static constexpr int32_t kSwitchZone = 3 * kUnitsPerMm;
  static constexpr int32_t kBeyondEnd = kUnitsPerMm / 2;
  static constexpr uint8_t kSwitchTicks = 5;

  static uint8_t count(uint8_t ticks) { return static_cast<uint8_t>(ticks < UINT8_MAX ? ticks + 1 : ticks); }

  void anchor(int32_t reading) {
    anchor_ = reading;
    expected_way_ = 0;
    coast_ = static_cast<int32_t>(rate_) * kLagTicks;
    idle_ticks_ = 0;
  }

  Fault check_idle(int32_t reading, int32_t way) {
    const int32_t excess = way - expected_way_;
    // A coast that stops early is stiction, not a fault: only motion beyond the expected, or against it, counts.
    const bool runs_on =
        magnitude(way) > magnitude(expected_way_) + kIdleWay ||
        (magnitude(excess) > kIdleWay && (way > 0) != (expected_way_ > 0) && magnitude(way) > kIdleWay);
    if (runs_on) return Fault::kDriver;
    if (++idle_ticks_ >= kIdleTicks) anchor(reading);
    return Fault::kNone;
  }

  // All count in the direction of the drive. After a reversal the way begins backwards: by the coast at most.
  Fault check_driven(int32_t reading, int32_t way, int32_t expected, int32_t coast) {
    const int32_t allowed = coast < 0 ? kReversedWay - coast : kReversedWay;
    const bool backwards = way < -allowed && way < expected - 2 * kReversedWay;
    backwards_ticks_ = backwards ? count(backwards_ticks_) : 0;
    if (backwards_ticks_ >= kReversedTicks) return ran_while_off_ ? Fault::kDriver : Fault::kReversed;
    if (backwards) return Fault::kNone;
    if (expected < jam_way_) return Fault::kNone;
    if (way < expected >> 2) return Fault::kJam;
    anchor(reading);
    jam_way_ = kJamWay;
    return Fault::kNone;
  }

  int32_t last_ = 0;
  int32_t anchor_ = 0;
  int32_t expected_way_ = 0;
  int32_t jam_way_ = kJamWay;  // expected, before the way is judged
  int32_t coast_ = 0;          // left at the anchor
  int16_t rate_ = 0;
  int16_t last_drive_ = 0;
  uint8_t open_ticks_ = 0;
  uint8_t noise_ = 0;
  uint8_t idle_ticks_ = 0;
  uint8_t switch_ticks_ = 0;
  uint8_t backwards_ticks_ = 0;
  bool idle_ = false;
  bool ran_while_off_ = false;  // before the present drive began
  bool trusted_ = true;
  bool untrusted_ = false;
};

}  // namespace tiger
