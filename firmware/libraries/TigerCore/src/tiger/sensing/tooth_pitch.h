// Learns the true pitch of every quarter tooth of a gear, so that speed does not inherit its errors.
//
// While the wheel turns steadily, the time of an interval over the mean time of the revolution centred on it is
// its pitch. A steady acceleration cancels in a centred mean. One full revolution later every interval is known;
// further revolutions are averaged in. The table belongs to the position count since boot: whatever loses a count
// must make the table forget.
#pragma once

#include <stdint.h>

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
  void restart() { run_ = 0; }

  // The interval that ends at edge `position`, crossed forwards right after its predecessor. About 2000 cycles.
  void learn(int32_t position, uint32_t interval_ticks) {
    if (intervals_ > kMaxIntervals) return;
    if (interval_ticks < kShortest_ticks || interval_ticks > 0xFFFF) {
      restart();
      return;
    }
    const uint16_t newest = run_ > 0 ? wrap(static_cast<uint16_t>(newest_ + 1)) : index_of(position);
    newest_ = newest;
    const uint16_t opposite = wrap(static_cast<uint16_t>(newest + intervals_ / 2));
    const uint16_t interval = static_cast<uint16_t>(interval_ticks);
    if (run_ == 0) {
      revolution_ticks_ = 0;
      half_ticks_ = 0;
    }
    const uint16_t half_ago = run_ >= intervals_ / 2 ? ticks_[opposite] : 0;
    const uint16_t turn_ago = run_ >= intervals_ ? ticks_[newest] : 0;
    half_ticks_ += interval;
    half_ticks_ -= half_ago;
    if (run_ >= intervals_ && steady()) {
      const float mean_ticks = static_cast<float>(revolution_ticks_) / static_cast<float>(intervals_);
      blend(opposite, static_cast<float>(half_ago) / mean_ticks);
    }
    revolution_ticks_ += interval;
    revolution_ticks_ -= turn_ago;
    ticks_[newest] = interval;
    count_run();
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

  // Speed may change by an eighth over a revolution: what a centred mean leaves of that is under 0.1 %.
  bool steady() const {
    const uint32_t other_half = revolution_ticks_ > half_ticks_ ? revolution_ticks_ - half_ticks_ : 0;
    const uint32_t difference =
        half_ticks_ > other_half ? half_ticks_ - other_half : other_half - half_ticks_;
    return difference < revolution_ticks_ / 16;
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

  // A revolution fills the ring, each further one in a row teaches every interval once.
  void count_run() {
    ++run_;
    if (run_ < 2 * intervals_) return;
    run_ = intervals_;
    if (revolutions_ < kMostRevolutions - 1) ++revolutions_;
  }

  uint16_t wrap(uint16_t i) const { return i < intervals_ ? i : static_cast<uint16_t>(i - intervals_); }
  uint16_t index_of(int32_t position) const {
    const int32_t rest = position % static_cast<int32_t>(intervals_);
    return static_cast<uint16_t>(rest < 0 ? rest + intervals_ : rest);
  }

  uint16_t intervals_;
  uint16_t run_;
  uint16_t newest_;  // index of the last interval
  uint8_t revolutions_;
  uint32_t revolution_ticks_;  // of the last `intervals_` intervals
  uint32_t half_ticks_;        // of the last half of them
  uint16_t ticks_[kMaxIntervals];
  uint16_t pitch_[kMaxIntervals];
};

}  // namespace tiger
