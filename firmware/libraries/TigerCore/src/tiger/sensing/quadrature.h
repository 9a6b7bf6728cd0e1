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

// What the program sees of a decoder, copied in one piece.
struct EdgeSnapshot {
  uint16_t now_ticks;                     // clock of the stamps, 0.5 us; wraps after 32.768 ms
  uint16_t count;                         // wraps; forward counts up
  uint16_t illegal_counts;                // transitions that skipped a state
  uint16_t stamps_ticks[kEdgesPerTooth];  // when the edge of each phase (position & 3) was last crossed
  uint8_t positions[kEdgesPerTooth];      // where: the low byte of its position
  uint8_t latest;                         // phase of the last edge
  uint8_t pins;                           // A in bit 0, B in bit 1
};

class Quadrature {
 public:
  void begin(uint8_t pins) {
    seen_ = EdgeSnapshot{};
    seen_.pins = pins;
  }

  // Budget 160 cycles on the AVR with entry and exit of the interrupt. `pins`: A in bit 0, B in bit 1.
  __attribute__((always_inline)) inline void on_edge(uint8_t pins, uint16_t now_ticks) {
    const uint8_t step = step_of(seen_.pins, pins);
    seen_.pins = pins;
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
    seen_.stamps_ticks[phase] = now_ticks;
    seen_.positions[phase] = position;
    seen_.latest = phase;
  }

  // The caller keeps on_edge() from running meanwhile.
  EdgeSnapshot snapshot(uint16_t now_ticks) const {
    EdgeSnapshot copy = seen_;
    copy.now_ticks = now_ticks;
    return copy;
  }

 private:
  enum : uint8_t { kNone, kForward, kReverse, kSkipped };

  // A leads B: 00, A, AB, B, 00.
  __attribute__((always_inline)) static inline uint8_t step_of(uint8_t before, uint8_t after) {
    static const uint8_t kSteps[16] = {
        kNone,    kForward, kReverse, kSkipped,  // from 00 to 00, A, B, AB
        kReverse, kNone,    kSkipped, kForward,  // from A
        kForward, kSkipped, kNone,    kReverse,  // from B
        kSkipped, kReverse, kForward, kNone,     // from AB
    };
    return kSteps[(before << 2 | after) & 15];
  }

  EdgeSnapshot seen_;
};

}  // namespace tiger
