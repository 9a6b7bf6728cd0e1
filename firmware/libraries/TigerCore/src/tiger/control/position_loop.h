// Position loop of an actuator, on its stop point: the stroke at which it would come to rest with the drive off.
//
// Seen so, the lagging actuator is a plain integrator: the reference moves by the commanded rate, the stop point by the
// drive, and a proportional law neither overshoots nor has to brake. Inside the deadband it asks for nothing, so that the
// self-locking actuator rests with its drive off; outside, it adds what breaks the stiction.
#pragma once

#include <stdint.h>

#include "fixed.h"

namespace tiger {

class PositionLoop {
 public:
  static constexpr int32_t kLeash = 3 * kUnitsPerMm / 10;  // farthest that a rate command runs ahead

  void start(int32_t stop_point) {
    reference_ = stop_point;
    correcting_ = false;
  }

  // A command that stops, or turns away from the lag.
  bool turns_from(int16_t rate, int32_t stop_point) const {
    const int32_t lag = reference_ - stop_point;
    return (rate >= 0 && lag < 0) || (rate <= 0 && lag > 0);
  }

  // Moves the reference by a commanded rate, no farther than the soft limits (inwards from beyond them is fine).
  // Returns the rate that is left of it.
  int16_t advance(int16_t rate, int32_t low, int32_t high) {
    const int32_t wanted = reference_ + rate;
    int32_t next = wanted;
    if (rate > 0 && wanted > high) next = reference_ > high ? reference_ : high;
    if (rate < 0 && wanted < low) next = reference_ < low ? reference_ : low;
    const int16_t moved = static_cast<int16_t>(next - reference_);
    reference_ = next;
    return moved;
  }

  // Keeps the reference within the leash of the stop point; true when it had to.
  bool hold_leash(int32_t stop_point) {
    const int32_t ahead = reference_ - stop_point;
    const int32_t kept = clamp32(ahead, kLeash);
    reference_ = stop_point + kept;
    return kept != ahead;
  }

  // Target rate of the rate loop. `moving`: the reference moves by `rate`.
  int16_t step(int16_t rate, int32_t stop_point) {
    const int32_t error = reference_ - stop_point;
    const int32_t size = magnitude(error);
    const bool helps = (rate > 0 && error > 0) || (rate < 0 && error < 0);
    if (size > (helps ? kWakeMoving : kWakeResting)) correcting_ = true;
    if (size < kSleep) correcting_ = false;
    if (!correcting_) return rate;
    const int32_t push = (error >> kGainShift) + (error > 0 ? kBreakaway : -kBreakaway);
    return saturate16(rate + push);
  }

  int32_t reference() const { return reference_; }
  int32_t error(int32_t stop_point) const { return reference_ - stop_point; }
  bool correcting() const { return correcting_; }

 private:
  static constexpr uint8_t kGainShift = 3;                       // 12.5 1/s
  static constexpr int32_t kWakeMoving = 6 * kUnitsPerMm / 100;  // lagging behind the command
  static constexpr int32_t kWakeResting = 12 * kUnitsPerMm / 100;
  static constexpr int32_t kSleep = 3 * kUnitsPerMm / 100;
  static constexpr int16_t kBreakaway = 2000;  // um/s of drive, a fifth of it: stiction

  int32_t reference_ = 0;
  bool correcting_ = false;
};

}  // namespace tiger
