// Real age of a setpoint: how much later it came than the quickest one since ARM.
//
// Host and board clocks differ by an unknown offset; the smallest difference seen is the quickest way through the line,
// and what exceeds it is time spent waiting. Resonators differ by up to 0.5 %, so the smallest difference is let go by
// 1 ms in 128: that follows any drift and still calls a burst old that a stalled host lets go.
#pragma once

#include <stdint.h>

namespace tiger {

class SetpointAge {
 public:
  void restart() { has_least_ = false; }

  // Age in ms of a setpoint that was made at `host_ms` and came at `own_ms`.
  uint16_t of(uint16_t host_ms, uint16_t own_ms) {
    const uint16_t difference = static_cast<uint16_t>(own_ms - host_ms);
    if (!has_least_) {
      least_ = difference;
      let_go_ms_ = own_ms;
      has_least_ = true;
    }
    while (static_cast<uint16_t>(own_ms - let_go_ms_) >= kLetGoMs) {
      let_go_ms_ = static_cast<uint16_t>(let_go_ms_ + kLetGoMs);
      ++least_;
    }
    const int16_t age = static_cast<int16_t>(difference - least_);
    if (age >= 0) return static_cast<uint16_t>(age);
    least_ = difference;
    return 0;
  }

 private:
  static constexpr uint16_t kLetGoMs = 128;

  uint16_t least_ = 0;
  uint16_t let_go_ms_ = 0;
  bool has_least_ = false;
};

}  // namespace tiger
