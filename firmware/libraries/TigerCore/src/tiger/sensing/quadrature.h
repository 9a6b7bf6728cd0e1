// Quadrature decoder: what the edge interrupt does, and nothing more.
//
// A wheel sensor gives two square waves, A and B, a quarter tooth apart. Every edge of either one is an
// interrupt; a table of the 16 transitions says forward, reverse, nothing, or skipped (both signals changed at
// once, so an edge was lost and the direction is unknown). Each edge keeps the time of its crossing by phase
// (four phases a tooth), because the time between two crossings of one phase is free of the duty and phase
// errors of the sensor.
//
// Words: `count` is the number of quarter teeth travelled; the edge at position p lies between counts p-1 and p.
// An edge has the same position whichever way it is crossed.
#pragma once

#include <stdint.h>

namespace tiger {

constexpr uint8_t kEdgesPerTooth = 4;

// The last crossing of the edge of one phase.
struct EdgeCrossing {
  uint16_t stamp_ticks;
  uint8_t position;  // its low byte
  uint8_t unused;    // four bytes in all: an index becomes two shifts

  bool operator==(const EdgeCrossing& other) const {
    return stamp_ticks == other.stamp_ticks && position == other.position;
  }
};

// What the program sees of a decoder.
struct EdgeSnapshot {
  uint16_t now_ticks;                      // clock of the stamps, 0.5 us; wraps after 32.768 ms
  uint16_t count;                          // wraps; forward counts up
  uint16_t illegal_counts;                 // transitions that skipped a state
  uint8_t latest;                          // phase (position & 3) of the last edge
  EdgeCrossing crossings[kEdgesPerTooth];  // by phase
};

class Quadrature {
 public:
  // `pins`: A in bit 0, B in bit 1.
  void begin(uint8_t pins) {
    seen_ = EdgeSnapshot{};
    before_ = static_cast<uint8_t>(pins << 2);
  }

  // Budget 130 cycles on the AVR with entry and exit of the interrupt. `clock()` is read last, so that its value
  // need not be kept meanwhile: the path to it is the same for every edge in one direction.
  template <class Clock>
  __attribute__((always_inline)) inline void on_edge(uint8_t pins, Clock clock) {
    const uint8_t step = step_of(before_ | pins);
    before_ = static_cast<uint8_t>(pins << 2);
    uint8_t position;
    if (step == kForward) {
      seen_.count = static_cast<uint16_t>(seen_.count + 1);
      position = static_cast<uint8_t>(seen_.count);
    } else if (step == kReverse) {
      position = static_cast<uint8_t>(seen_.count);
      seen_.count = static_cast<uint16_t>(seen_.count - 1);
    } else {
      if (step == kSkipped) seen_.illegal_counts = static_cast<uint16_t>(seen_.illegal_counts + 1);
      return;
    }
    const uint8_t phase = position & (kEdgesPerTooth - 1);
    seen_.latest = phase;
    EdgeCrossing& crossing = seen_.crossings[phase];
    crossing.position = position;
    crossing.stamp_ticks = clock();
    generation_ = static_cast<uint8_t>(generation_ + 1);
  }

  // Copies everything but now_ticks; in one piece if generation() is the same before and after. Field by field,
  // because that takes a quarter of the time of the copy loop a compiler makes.
  __attribute__((always_inline)) inline void copy_to(EdgeSnapshot& copy) const {
    copy.count = seen_.count;
    copy.illegal_counts = seen_.illegal_counts;
    copy.latest = seen_.latest;
    copy_crossing(0, copy);
    copy_crossing(1, copy);
    copy_crossing(2, copy);
    copy_crossing(3, copy);
  }
  uint8_t generation() const { return generation_; }

 private:
  __attribute__((always_inline)) inline void copy_crossing(uint8_t phase, EdgeSnapshot& copy) const {
    copy.crossings[phase].stamp_ticks = seen_.crossings[phase].stamp_ticks;
    copy.crossings[phase].position = seen_.crossings[phase].position;
  }

  enum : uint8_t { kNone, kForward, kReverse, kSkipped };

  // A leads B: 00, A, AB, B, 00.
  __attribute__((always_inline)) static inline uint8_t step_of(uint8_t before_and_after) {
    static const uint8_t kSteps[16] = {
        kNone,    kForward, kReverse, kSkipped,  // from 00 to 00, A, B, AB
        kReverse, kNone,    kSkipped, kForward,  // from A
        kForward, kSkipped, kNone,    kReverse,  // from B
        kSkipped, kReverse, kForward, kNone,     // from AB
    };
    return kSteps[before_and_after];
  }

  EdgeSnapshot seen_;
  uint8_t before_;  // the last pins, two bits up
  volatile uint8_t generation_ = 0;
};

}  // namespace tiger
