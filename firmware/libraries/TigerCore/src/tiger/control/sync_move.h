// A common move: four references travel so that all arrive together, and wait for an actuator that lags.
#pragma once

#include <stdint.h>

#include "../hal.h"
#include "fixed.h"

namespace tiger {

class SyncMove {
 public:
  void start(const int32_t from[kCorners], const int32_t to[kCorners]) {
    left_ = 0;
    for (uint8_t i = 0; i < kCorners; ++i) {
      target_[i] = to[i];
      const int32_t way = magnitude(to[i] - from[i]);
      if (way > left_) left_ = way;
    }
    if (left_ == 0) return;
    for (uint8_t i = 0; i < kCorners; ++i) {
      // Shares of the longest way, Q15: both lengths lose eight bits first to stay within 32.
      const int32_t way = (to[i] - from[i]) >> 8;
      share_[i] = static_cast<int16_t>(way * INT16_MAX / ((left_ >> 8) + 1));
    }
  }

  void cancel() { left_ = 0; }
  bool running() const { return left_ != 0; }

  // Rates of this tick. `lag`: the largest error of a position loop.
  void step(const int32_t reference[kCorners], int16_t full_speed, int32_t lag, int16_t rates[kCorners]) {
    int32_t way = full_speed;
    if (lag > kLagFree) way -= (lag - kLagFree) >> 1;
    if (way < 0) way = 0;
    const bool arrives = way >= left_;
    for (uint8_t i = 0; i < kCorners; ++i) {
      const int32_t rest = target_[i] - reference[i];
      const int16_t part = static_cast<int16_t>((way * share_[i]) >> 15);
      rates[i] = arrives || magnitude(rest) < magnitude(part) ? clamp16(saturate16(rest), full_speed) : part;
    }
    left_ = arrives ? 0 : left_ - way;
  }

 private:
  static constexpr int32_t kLagFree = kUnitsPerMm / 10;

  int32_t target_[kCorners] = {};
  int16_t share_[kCorners] = {};
  int32_t left_ = 0;  // of the longest way
};

}  // namespace tiger
