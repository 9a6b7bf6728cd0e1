// Stroke and rate of an actuator from its potentiometer and the drive it was given.
//
// One potentiometer count per tick is full speed, so a differenced reading says nothing about the rate. The actuator's
// model does: rate' = (drive - rate) / 50 ms, exactly discretised; the reading corrects it gently (Luenberger).
#pragma once

#include <stdint.h>

#include "fixed.h"

namespace tiger {

class StrokeObserver {
 public:
  void start(int32_t stroke) {
    stroke_ = stroke;
    rate_ = 0;
  }

  // One tick under `drive`, the rate that the duty of the past tick settles at.
  void predict(int16_t drive) {
    const int16_t gap = minus(drive, rate_);
    stroke_ += rate_ + scale(gap, kLagTravel);
    rate_ = saturate16(static_cast<int32_t>(rate_) + scale(gap, kLagShare));
  }

  // What the reading differs by from the stroke that stood at the middle of its conversions.
  int32_t surprise(int32_t reading) const { return reading - (stroke_ - scale(rate_, kReadingAge)); }

  void correct(int32_t surprise) {
    stroke_ += part(surprise, kStrokeGain);
    rate_ = saturate16(rate_ + part(surprise, kRateGain));
  }

  int32_t stroke() const { return stroke_; }
  int16_t rate() const { return rate_; }

  // Where it comes to rest with the drive off. Under a drive it moves by exactly the drive, without lag.
  int32_t stop_point() const { return stroke_ + static_cast<int32_t>(rate_) * kLagTicks; }

 private:
  static int32_t part(int32_t x, uint8_t shift) { return (x + (int32_t{1} << (shift - 1))) >> shift; }

  static constexpr uint16_t kReadingAge = q16(0.67);  // ticks: half a sweep, and the wait for the tick
  static constexpr uint8_t kStrokeGain = 2;           // a quarter per tick
  static constexpr uint8_t kRateGain = 6;             // a 64th per tick

  int32_t stroke_ = 0;
  int16_t rate_ = 0;
};

}  // namespace tiger
