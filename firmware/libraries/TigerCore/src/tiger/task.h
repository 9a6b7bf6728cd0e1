// Periodic work with its deadline, and what the main loop's timing was.
#pragma once

#include <stdint.h>

#include "hal.h"

namespace tiger {

// Comes due once per period, without drift. Starting a whole period late is a missed deadline: it is counted, and
// the missed turns are skipped instead of run in a burst.
class PeriodicTask {
 public:
  explicit PeriodicTask(uint32_t period_us) : period_us_(period_us) {}

  void start(uint32_t now_us) { next_us_ = now_us + period_us_; }

  bool due(uint32_t now_us) {
    const uint32_t late_us = now_us - next_us_;
    if (late_us > INT32_MAX) return false;  // still ahead
    next_us_ += period_us_;
    if (late_us < period_us_) {
      missed_in_a_row_ = 0;
      return true;
    }
    if (missed_ != UINT16_MAX) ++missed_;
    if (missed_in_a_row_ != UINT8_MAX) ++missed_in_a_row_;
    next_us_ = now_us + period_us_;
    return true;
  }

  uint16_t missed() const { return missed_; }
  uint8_t missed_in_a_row() const { return missed_in_a_row_; }

 private:
  uint32_t period_us_;
  uint32_t next_us_ = 0;
  uint16_t missed_ = 0;
  uint8_t missed_in_a_row_ = 0;
};

// Shortest and longest turn of the main loop since the last report, and how close the watchdog came.
class LoopTimes {
 public:
  void start(uint32_t now_us) { turn_us_ = fed_us_ = now_us; }

  void turn(uint32_t now_us) {
    const uint16_t took_us = clip(now_us - turn_us_);
    turn_us_ = now_us;
    if (took_us < min_us_) min_us_ = took_us;
    if (took_us > max_us_) max_us_ = took_us;
  }

  void fed(uint32_t now_us) {
    const uint16_t took_us = clip(now_us - fed_us_);
    fed_us_ = now_us;
    if (took_us > longest_hunger_us_) longest_hunger_us_ = took_us;
  }

  uint16_t min_us() const { return min_us_; }
  uint16_t max_us() const { return max_us_; }
  uint8_t watchdog_margin_ms() const {
    const uint8_t hunger_ms = static_cast<uint8_t>(longest_hunger_us_ >> 10);  // 2 % short of the millisecond
    return hunger_ms < kWatchdogMs ? static_cast<uint8_t>(kWatchdogMs - hunger_ms) : 0;
  }
  void clear_turns() {
    min_us_ = UINT16_MAX;
    max_us_ = 0;
  }

 private:
  static uint16_t clip(uint32_t us) { return us < UINT16_MAX ? static_cast<uint16_t>(us) : UINT16_MAX; }

  uint32_t turn_us_ = 0;
  uint32_t fed_us_ = 0;
  uint16_t min_us_ = UINT16_MAX;
  uint16_t max_us_ = 0;
  uint16_t longest_hunger_us_ = 0;
};

}  // namespace tiger
