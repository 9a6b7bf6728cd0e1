// Heat of a motor from its duty: the square of the duty, kept with a time constant of 5.6 minutes.
#pragma once

#include <stdint.h>

namespace tiger {

class Thermal {
 public:
  // One control tick of 10 ms at this duty.
  void tick(int16_t duty_permille) {
    const uint16_t size = static_cast<uint16_t>(duty_permille < 0 ? -duty_permille : duty_permille);
    const uint8_t drive = static_cast<uint8_t>(size >= 1000 ? 250 : size >> 2);
    heat_ += static_cast<uint16_t>(drive * drive);
    if (++ticks_ == 0) heat_ -= heat_ >> kDecayShift;
  }

  bool too_hot() const { return heat_ > kLimit; }
  bool cooled() const { return heat_ < kLimit - kLimit / 4; }
  // Of the limit, for diagnosis.
  uint8_t percent() const {
    return static_cast<uint8_t>(heat_ / (kLimit / 100) > 255 ? 255 : heat_ / (kLimit / 100));
  }

 private:
  static constexpr uint8_t kDecayShift = 7;  // every 256 ticks: 128 x 2.56 s = 328 s
  // Heat of full duty that lasts for ever, and the quarter of it that a 25 % duty-cycle motor stands.
  static constexpr uint32_t kFull = 62500ul * 256 * (1u << kDecayShift);
  static constexpr uint32_t kLimit = kFull / 4;
  static_assert(kFull < 0xF0000000, "heat must fit");

  uint32_t heat_ = 0;
  uint8_t ticks_ = 0;
};

}  // namespace tiger
