// The Hal of mega_speed on the PC: two wheel sensors whose edges interrupt at their exact time.
#pragma once

#include <math.h>
#include <stdint.h>

#include "native_board.h"
#include "tiger/boards/mega_speed.h"

namespace tiger {

// A gear before a sensor: a phase in teeth that moves in a straight line during a run, and the pins it makes.
class VirtualWheel {
 public:
  enum Fault : uint8_t { kDeadA = 1, kDeadB = 2, kSwapped = 4 };

  void place(double phase_teeth) {
    phase_ = target_ = phase_teeth;
    quarter_ = static_cast<int64_t>(floor(phase_teeth * kEdgesPerTooth));
    is_placed_ = true;
  }
  bool is_placed() const { return is_placed_; }
  void set_target(double phase_teeth) { target_ = phase_teeth; }
  void set_faults(uint8_t faults) { faults_ = faults; }

  void begin_run(uint64_t now_ns, uint32_t us) {
    start_ns_ = now_ns;
    start_ = phase_;
    slope_ = us != 0 ? (target_ - phase_) / (1000.0 * us) : 0.0;  // teeth per nanosecond
  }
  void end_run() {
    phase_ = target_;
    slope_ = 0.0;
  }

  // Calls `edge(pins, time_ns)` for every edge up to `now_ns`.
  template <class Edge>
  void advance(uint64_t now_ns, Edge edge) {
    if (slope_ == 0.0) return;
    phase_ = start_ + slope_ * static_cast<double>(now_ns - start_ns_);
    const int64_t goal = static_cast<int64_t>(floor(phase_ * kEdgesPerTooth));
    while (quarter_ != goal) {
      const bool forward = goal > quarter_;
      const double crossed = static_cast<double>(forward ? quarter_ + 1 : quarter_) / kEdgesPerTooth;
      quarter_ += forward ? 1 : -1;
      const double since_ns = (crossed - start_) / slope_;
      edge(pins(), start_ns_ + static_cast<uint64_t>(since_ns > 0 ? since_ns : 0));
    }
  }

  uint8_t pins() const {
    static const uint8_t kPins[kEdgesPerTooth] = {0, 1, 3, 2};  // A leads B
    uint8_t pins = kPins[quarter_ & 3];
    if ((faults_ & kSwapped) != 0) pins = static_cast<uint8_t>((pins >> 1) | ((pins & 1) << 1));
    if ((faults_ & kDeadA) != 0) pins &= 2;
    if ((faults_ & kDeadB) != 0) pins &= 1;
    return pins;
  }

 private:
  double phase_ = 0.0;
  double target_ = 0.0;
  double start_ = 0.0;
  double slope_ = 0.0;
  uint64_t start_ns_ = 0;
  int64_t quarter_ = 0;
  uint8_t faults_ = 0;
  bool is_placed_ = false;
};

class SpeedHal : public NativeHal {
 public:
  static constexpr uint8_t kWheels = speed_config::kWheels;

  SpeedHal(uint8_t instance, uint32_t uid) : NativeHal(instance, uid, wire::kBaudSpeedUsb, 4096) {}

  // ------------------------------------------------------------------------- what the program calls (hal.h)

  EdgeSnapshot edges(uint8_t channel) {
    EdgeSnapshot snapshot;
    decoders_[channel].copy_to(snapshot);
    snapshot.now_ticks = ticks_at(now_ns_);
    return snapshot;
  }

  // ------------------------------------------------------------------ what the world and NativeBoard call

  void advance(uint64_t now_ns) {
    NativeHal::advance(now_ns);
    for (uint8_t i = 0; i < kWheels; ++i) {
      wheels_[i].advance(now_ns, [&](uint8_t pins, uint64_t at_ns) {
        decoders_[i].on_edge(pins, [&] { return ticks_at(at_ns); });
      });
    }
  }

  void reset(uint8_t mcusr) {
    NativeHal::reset(mcusr);
    for (uint8_t i = 0; i < kWheels; ++i) decoders_[i].begin(wheels_[i].pins());
  }

  void begin_run(uint32_t us) {
    for (VirtualWheel& wheel : wheels_) wheel.begin_run(now_ns_, us);
  }
  void end_run() {
    for (VirtualWheel& wheel : wheels_) wheel.end_run();
  }

  void set_phase(uint8_t channel, double phase_teeth) {
    VirtualWheel& wheel = wheels_[channel];
    if (wheel.is_placed()) {
      wheel.set_target(phase_teeth);
    } else {
      wheel.place(phase_teeth);
      decoders_[channel].begin(wheel.pins());
    }
  }
  void set_faults(uint8_t channel, uint8_t faults) { wheels_[channel].set_faults(faults); }

  // The interrupt with these pins, now: for edges no gear makes.
  void interrupt(uint8_t channel, uint8_t pins) {
    decoders_[channel].on_edge(pins, [this] { return ticks_at(now_ns_); });
  }

 private:
  static constexpr double kNsPerTick = 500.0;

  uint16_t ticks_at(uint64_t ns) const {
    const double ago_ticks = (static_cast<double>(now_ns_) - static_cast<double>(ns)) / kNsPerTick;
    return static_cast<uint16_t>(2 * micros() - static_cast<uint32_t>(ago_ticks));
  }

  VirtualWheel wheels_[kWheels];
  Quadrature decoders_[kWheels];
};

inline tiger_board* new_speed(uint8_t instance, uint32_t uid) {
  return new NativeBoard<SpeedHal, MegaSpeed>(instance, uid);
}

}  // namespace tiger
