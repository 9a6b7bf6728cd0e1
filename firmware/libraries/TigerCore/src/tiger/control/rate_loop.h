// Rate loop of an actuator: feed-forward, and a PI on what the rate lacks against the actuator's own response.
#pragma once

#include <stdint.h>

#include "fixed.h"

namespace tiger {

class RateLoop {
 public:
  // The duty of `full_speed` is all of it.
  void set_full_speed(int16_t full_speed) {
    full_speed_ = full_speed;
    const uint32_t permille = 65536000ul / static_cast<uint16_t>(full_speed);
    permille_per_rate_ = static_cast<uint16_t>(permille > UINT16_MAX ? UINT16_MAX : permille);
  }
  int16_t full_speed() const { return full_speed_; }

  // Off: remembers nothing but the motion that is left.
  void rest(int16_t rate) {
    expected_ = rate;
    integral_ = 0;
  }

  // One tick towards `wish`, with the observed rate; the drive as the rate it settles at, within the full speed.
  int16_t step(int16_t wish, int16_t rate) {
    const int16_t target = clamp16(wish, full_speed_);
    const int16_t lack = beyond(minus(expected_, rate), kNoise);
    const int32_t wanted = static_cast<int32_t>(target) + lack + (integral_ >> kIntegralShift);
    const int16_t drive = static_cast<int16_t>(clamp32(wanted, full_speed_));
    integral_ = clamp32(integral_ + lack, kIntegralLimit);
    take_back(wanted - drive);
    expected_ = saturate16(static_cast<int32_t>(expected_) + scale(minus(drive, expected_), kLagShare));
    return drive;
  }

  int16_t duty_permille(int16_t drive) const {
    const int32_t permille = (static_cast<int32_t>(drive) * permille_per_rate_ + 0x8000) >> 16;
    return static_cast<int16_t>(clamp32(permille, 1000));
  }

  int16_t expected() const { return expected_; }
  int32_t integral() const { return integral_; }

 private:
  // Back-calculation: what saturation cuts off is taken out of the integral, as far as that is to blame for it.
  void take_back(int32_t excess) {
    const int32_t left = integral_ - excess * kBackGain;
    if (excess > 0 && integral_ > 0) integral_ = left > 0 ? left : 0;
    if (excess < 0 && integral_ < 0) integral_ = left < 0 ? left : 0;
  }

  static constexpr int16_t kNoise = 150;        // um/s of the observed rate at rest
  static constexpr uint8_t kIntegralShift = 5;  // 1/32 per tick
  static constexpr int32_t kBackGain = 4;       // an eighth of the excess per tick
  static constexpr int32_t kIntegralLimit = int32_t{3000} << kIntegralShift;

  int16_t full_speed_ = 9400;
  uint16_t permille_per_rate_ = 6972;
  int16_t expected_ = 0;  // rate that the drive so far should have brought
  int32_t integral_ = 0;
};

}  // namespace tiger
