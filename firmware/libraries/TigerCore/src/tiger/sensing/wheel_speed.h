// Speed of one wheel by the M/T method: travelled angle over the exact time between two edges.
//
// Both edges have the same phase, so a measurement spans whole teeth and the sensor's duty and phase errors drop
// out; the table of tooth pitches removes the gear's. At low speed that is one tooth, renewed at each quarter of
// it; at high speed all the teeth since the last update. No edge says that the wheel is slower than one pitch
// over the time since the last one; 1.5 times the expected time without an edge says that it stands.
#pragma once

#include <stdint.h>

#include "quadrature.h"
#include "tooth_pitch.h"

namespace tiger {

struct WheelSpeedConfig {
  uint8_t teeth;
  uint16_t zero_speed_ms;  // longest wait for an edge before the wheel counts as standing
};

class WheelSpeed {
 public:
  static constexpr uint32_t kTicksPerMs = 2000;

  void begin(const WheelSpeedConfig& config, const EdgeSnapshot& first) {
    config_ = config;
    edges_per_turn_ = static_cast<uint16_t>(config.teeth * kEdgesPerTooth);
    pitch_.begin(edges_per_turn_);
    seen_ = first;
    count_ = static_cast<int16_t>(first.count);
    now_ = first.now_ticks;
    age_ticks_ = kAgeLimit_ticks;
    measured_edges_per_tick_ = 0.0f;
    latest_ = Crossing{0, 0, false};
    start_ = latest_;
    halt();
    same_edge_count_ = 0;
  }

  // Takes in what the interrupt has seen: at least every 30 ms (the stamps wrap), once a millisecond to learn.
  void observe(const EdgeSnapshot& snapshot) {
    const uint16_t passed_ticks = static_cast<uint16_t>(snapshot.now_ticks - seen_.now_ticks);
    now_ += passed_ticks;
    age_ticks_ = age_ticks_ > kAgeLimit_ticks - passed_ticks ? kAgeLimit_ticks : age_ticks_ + passed_ticks;
    count_ += static_cast<int16_t>(snapshot.count - seen_.count);
    if (snapshot.illegal_counts != seen_.illegal_counts) pitch_.forget();
    uint8_t crossed = 0;
    for (uint8_t phase = 0; phase < kEdgesPerTooth; ++phase) {
      if (snapshot.crossings[phase] == seen_.crossings[phase]) continue;
      crossed = static_cast<uint8_t>(crossed + 1);
      crossings_[phase] = crossing_of(snapshot, phase);
    }
    seen_ = snapshot;
    if (crossed == 0) return;
    take_in(crossed);
  }

  // Once a period of the telemetry, after observe().
  void update() {
    if (has_news_) {
      has_news_ = false;
      measure();
    } else {
      coast();
    }
  }

  int32_t count() const { return count_; }
  uint16_t illegal_counts() const { return seen_.illegal_counts; }
  bool stopped() const { return stopped_; }
  bool pitch_learned() const { return pitch_.learned(); }
  uint16_t edge_age_ms() const { return static_cast<uint16_t>(age_ticks_ / kTicksPerMs); }

  // How often in a row the same edge was crossed to and fro: one signal changes, the other does not.
  uint8_t same_edge_count() const { return same_edge_count_; }
  void clear_same_edge_count() { same_edge_count_ = 0; }

  // Forward positive.
  float speed_radps() const {
    constexpr float kTwoPi = 6.2831853f;
    constexpr float kTicksPerSecond = 1000.0f * static_cast<float>(kTicksPerMs);
    return speed_edges_per_tick_ * (kTwoPi * kTicksPerSecond) / static_cast<float>(edges_per_turn_);
  }

 private:
  struct Crossing {
    int32_t position;
    uint32_t time_ticks;
    bool valid;
  };

  static constexpr uint32_t kAgeLimit_ticks = 65535 * kTicksPerMs;

  Crossing crossing_of(const EdgeSnapshot& snapshot, uint8_t phase) const {
    const int8_t offset =
        static_cast<int8_t>(snapshot.crossings[phase].position - static_cast<uint8_t>(count_));
    const uint16_t age = static_cast<uint16_t>(snapshot.now_ticks - snapshot.crossings[phase].stamp_ticks);
    return Crossing{count_ + offset, now_ - age, true};
  }

  void take_in(uint8_t crossed) {
    const Crossing before = latest_;
    latest_ = crossings_[seen_.latest];
    age_ticks_ = now_ - latest_.time_ticks;
    if (!start_.valid) start_ = latest_;
    const bool same_edge = crossed == 1 && before.valid && latest_.position == before.position;
    same_edge_count_ = static_cast<uint8_t>(!same_edge               ? 0
                                            : same_edge_count_ < 255 ? same_edge_count_ + 1
                                                                     : 255);
    learn_from(before);
    has_news_ = true;
  }

  // Hands every interval between `before` and the latest edge to the pitch table, if none is missing.
  void learn_from(const Crossing& before) {
    const int32_t edges = latest_.position - before.position;
    if (!before.valid || edges < 1 || edges > kEdgesPerTooth) {
      pitch_.restart();
      return;
    }
    uint32_t previous_ticks = before.time_ticks;
    for (int32_t position = before.position + 1; position <= latest_.position; ++position) {
      const Crossing& c = crossings_[position & (kEdgesPerTooth - 1)];
      if (c.position != position) {
        pitch_.restart();
        return;
      }
      pitch_.learn(position, c.time_ticks - previous_ticks);
      previous_ticks = c.time_ticks;
    }
  }

  void measure() {
    const uint8_t phase = static_cast<uint8_t>(latest_.position & (kEdgesPerTooth - 1));
    const Crossing& same_phase = references_[phase];
    const Crossing from = same_phase.valid ? same_phase : start_;
    const uint32_t ticks = latest_.time_ticks - from.time_ticks;
    if (ticks != 0) {
      const float travel = static_cast<float>(pitch_.travel(from.position, latest_.position));
      measured_edges_per_tick_ = travel / (static_cast<float>(ToothPitch::kOne) * static_cast<float>(ticks));
      speed_edges_per_tick_ = measured_edges_per_tick_;
      stopped_ = false;
    }
    start_ = latest_;
    for (uint8_t i = 0; i < kEdgesPerTooth; ++i)
      if (crossings_[i].valid) references_[i] = crossings_[i];
  }

  void coast() {
    if (stopped_) {
      if (age_ticks_ > config_.zero_speed_ms * kTicksPerMs) forget_edges();
      return;
    }
    const bool forward = measured_edges_per_tick_ > 0.0f;
    const int32_t next = forward ? latest_.position : latest_.position - 1;
    const float pitch =
        static_cast<float>(pitch_.travel(next, next + 1)) / static_cast<float>(ToothPitch::kOne);
    const float age = static_cast<float>(age_ticks_);
    const float expected = (forward ? age : -age) * measured_edges_per_tick_;  // travel since the last edge
    if (expected > 1.5f * pitch || age_ticks_ > config_.zero_speed_ms * kTicksPerMs) {
      halt();
    } else if (expected > pitch) {
      speed_edges_per_tick_ = (forward ? pitch : -pitch) / age;
    }
  }

  // Standing: the first edge after it is measured from the last one before it, unless that is long ago.
  void halt() {
    speed_edges_per_tick_ = 0.0f;
    stopped_ = true;
    forget_edges();
    start_ = latest_;
  }

  void forget_edges() {
    start_.valid = false;
    for (uint8_t phase = 0; phase < kEdgesPerTooth; ++phase) {
      references_[phase].valid = false;
      crossings_[phase].valid = false;
    }
  }

  WheelSpeedConfig config_;
  uint16_t edges_per_turn_;
  ToothPitch pitch_;
  EdgeSnapshot seen_;
  uint32_t now_;
  uint32_t age_ticks_;
  int32_t count_;
  float measured_edges_per_tick_;  // at the last edge
  float speed_edges_per_tick_;     // now
  Crossing latest_;
  Crossing start_;                       // where to measure from while no edge of the same phase is known
  Crossing crossings_[kEdgesPerTooth];   // newest of each phase
  Crossing references_[kEdgesPerTooth];  // the same at the last update
  uint8_t same_edge_count_;
  bool has_news_;
  bool stopped_;
};

}  // namespace tiger
