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
    running_ = left_ != 0;
    for (uint8_t i = 0; i < kCorners; ++i) {
      // Shares of the longest way, Q15: both lengths lose eight bits first to stay within 32.
      const int32_t way = (to[i] - from[i]) >> 8;
      share_[i] = static_cast<int16_t>(way * INT16_MAX / ((left_ >> 8) + 1));
    }
  }

  void cancel() { running_ = false; }
  bool running() const { return running_; }

  // Rates of this tick. `lag`: the largest error of a position loop.
  void step(const int32_t reference[kCorners], int16_t full_speed, int32_t lag, int16_t rates[kCorners]) {
    int32_t way = full_speed;
    if (lag > kLagFree) way -= (lag - kLagFree) >> 1;
    if (way < 0) way = 0;
    const bool arrives = way >= left_;
    left_ = arrives ? 0 : left_ - way;
    running_ = !arrives;
    for (uint8_t i = 0; i < kCorners; ++i) {
      const int32_t rest = target_[i] - reference[i];
      const int16_t part = static_cast<int16_t>((way * share_[i]) >> 15);
      const bool is_last = arrives || magnitude(rest) < magnitude(part);
      rates[i] = is_last ? static_cast<int16_t>(clamp32(rest, full_speed)) : part;
      if (rates[i] != rest && is_last) running_ = true;  // a reference was held back on the way
    }
  }

 private:
  static constexpr int32_t kLagFree = 8 * kUnitsPerMm / 100;

  int32_t target_[kCorners] = {};
  int16_t share_[kCorners] = {};
  int32_t left_ = 0;  // of the longest way
  bool running_ = false;
};

}  // namespace tiger
