// Learns the true pitch of every quarter tooth of a gear, so that speed does not inherit its errors.
//
// While the wheel turns steadily, the time of an interval over the mean time of the revolution centred on it is
// its pitch. A steady acceleration cancels in a centred mean. After three steady revolutions every interval is known;
// further ones are averaged in. The table belongs to the position count since boot: whatever loses a count
// must make the table forget.
#pragma once

#include <stdint.h>

#include "quadrature.h"

namespace tiger {

class ToothPitch {
 public:
  static constexpr uint16_t kMaxIntervals = 320;     // 80 teeth; a finer gear is measured by whole teeth only
  static constexpr uint16_t kOne = 1u << 14;         // the nominal pitch, one quarter tooth
  static constexpr uint16_t kShortest_ticks = 1600;  // 0.8 ms: faster, learning would cost too much time

  void begin(uint16_t intervals) {
    intervals_ = intervals;
    forget();
  }

  // All pitches nominal again.
  void forget() {
    for (uint16_t i = 0; i < kMaxIntervals; ++i) pitch_[i] = kOne;
    revolutions_ = 0;
    restart();
  }

  // The chain of intervals broke: a pause, a reversal, a speed beyond the limits.
  void restart() { run_ = steady_ = taught_ = 0; }

  // The interval that ends at edge `position`, crossed forwards right after its predecessor. About 2000 cycles.
  void learn(int32_t position, uint32_t interval_ticks) {
    if (intervals_ > kMaxIntervals) return;
    if (interval_ticks < kShortest_ticks || interval_ticks > 0xFFFF) {
      restart();
      return;
    }
    const uint16_t newest = run_ > 0 ? wrap(static_cast<uint16_t>(newest_ + 1)) : index_of(position);
    newest_ = newest;
    const uint16_t interval = static_cast<uint16_t>(interval_ticks);
    if (run_ == 0) revolution_ticks_ = tooth_ticks_ = 0;
    const uint16_t tooth_before = wrap(static_cast<uint16_t>(newest + intervals_ - kEdgesPerTooth));
    tooth_ticks_ += interval;
    if (run_ >= kEdgesPerTooth) tooth_ticks_ -= ticks_[tooth_before];
    if (run_ >= intervals_) {
      judge_steadiness();
      if (steady_ >= intervals_) {
        const uint16_t opposite = wrap(static_cast<uint16_t>(newest + intervals_ / 2));
        const float mean_ticks = static_cast<float>(revolution_ticks_) / static_cast<float>(intervals_);
        blend(opposite, static_cast<float>(ticks_[opposite]) / mean_ticks);
      }
      revolution_ticks_ -= ticks_[newest];
    }
    revolution_ticks_ += interval;
    ticks_[newest] = interval;
    if (run_ < intervals_) ++run_;
  }

  bool learned() const { return revolutions_ > 0; }

  // Travel from edge `from` to edge `to` in quarter teeth times kOne.
  int32_t travel(int32_t from, int32_t to) const {
    if (from > to) return -travel(to, from);
    int32_t edges = to - from;
    if (!learned()) return edges * static_cast<int32_t>(kOne);
    int32_t sum = 0;
    while (edges >= static_cast<int32_t>(intervals_)) {  // a whole revolution has no pitch error
      edges -= intervals_;
      sum += static_cast<int32_t>(intervals_) * kOne;
    }
    uint16_t i = index_of(to);
    while (edges-- > 0) {
      sum += pitch_[i];
      i = i == 0 ? static_cast<uint16_t>(intervals_ - 1) : static_cast<uint16_t>(i - 1);
    }
    return sum;
  }

 private:
  static constexpr uint8_t kMostRevolutions = 16;  // from then on older ones fade

  // Steady is a whole revolution in which no tooth took a tenth longer or shorter than the mean one: what a change of
  // speed leaves of itself in a centred mean is then small, and the errors of a usable gear are within it.
  void judge_steadiness() {
    const int32_t revolution = static_cast<int32_t>(revolution_ticks_);
    const int32_t off = static_cast<int32_t>(tooth_ticks_ * (intervals_ / kEdgesPerTooth)) - revolution;
    const int32_t most = (revolution >> 3) - (revolution >> 5);
    if (off > most || off < -most) {
      steady_ = 0;
      taught_ = 0;
    } else if (steady_ < intervals_) {
      ++steady_;
    } else if (++taught_ == intervals_) {  // every interval was taught once more
      taught_ = 0;
      if (revolutions_ < kMostRevolutions - 1) ++revolutions_;
    }
  }

  // A mean over the first revolutions that then fades: weight 1, 1/2, 1/4, 1/4, 1/8 ...
  void blend(uint16_t index, float pitch) {
    if (pitch < 0.1f || pitch > 3.9f) return;
    uint8_t shift = 0;
    while ((revolutions_ >> shift) != 0) ++shift;
    const int32_t difference = static_cast<int32_t>(pitch * kOne) - pitch_[index];
    const int32_t half = (int32_t{1} << shift) >> 1;
    pitch_[index] = static_cast<uint16_t>(pitch_[index] + ((difference + half) >> shift));
  }

  uint16_t wrap(uint16_t i) const { return i < intervals_ ? i : static_cast<uint16_t>(i - intervals_); }
  uint16_t index_of(int32_t position) const {
    const int32_t rest = position % static_cast<int32_t>(intervals_);
    return static_cast<uint16_t>(rest < 0 ? rest + intervals_ : rest);
  }

  uint16_t intervals_;
  uint16_t run_;     // intervals since the chain began, up to a revolution
  uint16_t steady_;  // steady ones in a row, likewise
  uint16_t taught_;  // intervals taught in this revolution
  uint16_t newest_;  // index of the last interval
  uint8_t revolutions_;
  uint32_t revolution_ticks_;  // of the last `intervals_` intervals
  uint32_t tooth_ticks_;       // of the last tooth
  uint16_t ticks_[kMaxIntervals];
  uint16_t pitch_[kMaxIntervals];
};

}  // namespace tiger
