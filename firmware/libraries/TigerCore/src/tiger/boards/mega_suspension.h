// mega_suspension: four linear actuators, and the Nano behind it.
//
// Each tick of 10 ms: read the potentiometers, correct the observers, look for faults, turn setpoints into references,
// run the loops, drive, report. In between: serve the wires, watch the e-stop.
#pragma once

#include <stdint.h>

#include "../control/actuator.h"
#include "../control/setpoint_age.h"
#include "../control/sync_move.h"
#include "../frame.h"
#include "../hal.h"
#include "../link.h"
#include "../protocol.h"
#include "../task.h"
#include "mega_suspension_config.h"

namespace tiger {

// What the Nano says; its limits are checked by the host.
struct FromNano {
  static uint8_t payload_size(uint8_t id) {
    return wire::payload_size_from_board(wire::BoardKind::kNanoImu, id);
  }
  static bool payload_in_range(uint8_t, const uint8_t*) { return true; }
};

template <class Hal>
class MegaSuspension : public BoardHooks {
 public:
  explicit MegaSuspension(Hal& hal) : hal_(hal), link_(hal, *this), control_(kControlPeriodUs) {}

  void begin() {
    hal_.outputs_off();
    link_.begin();
    load_parameters();
    control_.start(hal_.micros());
  }

  void poll() {
    const uint32_t now_us = hal_.micros();
    link_.poll(now_us);
    serve_peer();
    watch_estop();
    if (control_.due(now_us)) {
      tick(now_us);
      link_.task_done(control_, now_us);
    }
    if (!link_.supervisor().is_armed()) outputs_off();
    if (state_pending_) state_pending_ = !link_.send(state_);
    if (raw_pending_) raw_pending_ = !send_raw();
  }

  // --------------------------------------------------------------------------------- hooks of the link

  bool ready() const { return curves_valid_ && settle_ticks_ == 0 && !estop_pressed_; }

  bool fault_present(wire::Fault fault) const {
    if (fault == wire::Fault::kEstop) return estop_pressed_;
    if (fault == wire::Fault::kPotOpen && readings_lost_ >= suspension::kReadingsLostTicks) return true;
    for (uint8_t i = 0; i < kCorners; ++i) {
      if (actuators_[i].fault_present(fault)) return true;
    }
    return false;
  }

  void armed() {
    age_.restart();
    accepted_ms_ = static_cast<uint16_t>(hal_.millis());
    neutral_seen_ = false;
    move_.cancel();
    for (uint8_t i = 0; i < kCorners; ++i) {
      setpoint_[i] = 0;
      actuators_[i].take_over();
    }
  }

  void disarmed() {
    move_.cancel();
    outputs_off();
  }

  void parameters_changed() { load_parameters(); }

  void stream(const Frame& frame) {
    if (frame.id() != wire::SuspensionSetpoint::kId) return;
    const wire::SuspensionSetpoint setpoint = frame.as<wire::SuspensionSetpoint>();
    if (!link_.supervisor().is_armed()) return;
    if (setpoint.engaged == 0) {
      link_.disarm();
      return;
    }
    const uint16_t now_ms = static_cast<uint16_t>(hal_.millis());
    if (age_.of(setpoint.host_ms, now_ms) > suspension::kSetpointMaxAgeMs) {
      if (setpoint_rejects_ != UINT16_MAX) ++setpoint_rejects_;
      return;
    }
    accept(setpoint, now_ms);
  }

  wire::AckStatus config(const Frame& frame, int32_t&) {
    if (frame.id() != wire::SuspensionMove::kId) return wire::AckStatus::kOk;
    return begin_move(frame.as<wire::SuspensionMove>());
  }

  void forward(const Frame& frame) {
    uint8_t bytes[kMaxFrame];
    const uint8_t n = frame_body(frame.body, frame.body_size, bytes);
    if (hal_.peer_write_space() >= n)
      hal_.peer_write(bytes, n);  // else lost, as on any wire: the host asks again
  }

  uint16_t peer_rejects(wire::RejectCause cause) const { return peer_.rejects(cause); }
  uint16_t setpoint_rejects() const { return setpoint_rejects_; }

 private:
  using Link =
      BoardLink<Hal, MegaSuspension, wire::BoardKind::kMegaSuspension, wire::kParamCountMegaSuspension>;

  // ---------------------------------------------------------------------------------------- the wires

  // Passes whole, checked frames of the Nano on; bytes wait in its UART while there is no room for one.
  void serve_peer() {
    uint8_t byte;
    for (uint8_t n = 0; n < suspension::kForwardBytesPerTurn; ++n) {
      if (hal_.host_write_space() < kMaxFrame || !hal_.peer_read(byte)) return;
      if (!peer_.take(byte)) continue;
      uint8_t bytes[kMaxFrame];
      hal_.host_write(bytes, frame_body(peer_.frame().body, peer_.frame().body_size, bytes));
    }
  }

  void watch_estop() {
    const uint16_t now_ms = static_cast<uint16_t>(hal_.millis());
    estop_pressed_ = hal_.estop_pressed();
    if (!estop_pressed_) estop_free_ms_ = now_ms;
    if (static_cast<uint16_t>(now_ms - estop_free_ms_) >= suspension::kEstopDebounceMs) {
      estop_free_ms_ =
          static_cast<uint16_t>(now_ms - suspension::kEstopDebounceMs);  // held for long: no wrap
      link_.raise(wire::Fault::kEstop);
    }
  }

  // ------------------------------------------------------------------------------------------ setpoints

  void accept(const wire::SuspensionSetpoint& setpoint, uint16_t now_ms) {
    accepted_ms_ = now_ms;
    bool is_neutral = true;
    for (uint8_t i = 0; i < kCorners; ++i) {
      setpoint_[i] = setpoint.rate_mmps[i];
      if (setpoint_[i] != 0) is_neutral = false;
    }
    if (is_neutral) neutral_seen_ = true;
    if (!is_neutral) move_.cancel();
    link_.supervisor().handle(Event::SetpointsFlow);
  }

  wire::AckStatus begin_move(const wire::SuspensionMove& move) {
    if (link_.supervisor().state() != wire::BoardState::kArmed || !neutral_seen_)
      return wire::AckStatus::kNotArmed;
    int32_t from[kCorners];
    int32_t to[kCorners];
    for (uint8_t i = 0; i < kCorners; ++i) {
      if (move.stroke_mm[i] < parameter(wire::kParamStrokeLowMm) ||
          move.stroke_mm[i] > parameter(wire::kParamStrokeHighMm)) {
        return wire::AckStatus::kOutOfRange;
      }
      from[i] = actuators_[i].reference();
      to[i] = move.stroke_mm[i] * kUnitsPerWireCount;
    }
    move_.start(from, to);
    return wire::AckStatus::kOk;
  }

  void watch_setpoints() {
    silent_ms_ = static_cast<uint16_t>(static_cast<uint16_t>(hal_.millis()) - accepted_ms_);
    if (!link_.supervisor().is_armed()) {
      accepted_ms_ =
          static_cast<uint16_t>(static_cast<uint16_t>(hal_.millis()) - 255);  // keeps the age from wrapping
      return;
    }
    if (silent_ms_ >= suspension::kLinkLostAfterMs) {
      link_.raise(wire::Fault::kLinkLost);
    } else if (silent_ms_ >= suspension::kHoldAfterMs) {
      link_.supervisor().handle(Event::SetpointsLate);
      move_.cancel();
    }
  }

  // ------------------------------------------------------------------------------------------- control

  void tick(uint32_t now_us) {
    read_strokes(now_us);
    find_faults();
    watch_setpoints();
    if (link_.supervisor().is_armed()) {
      command();
    } else {
      outputs_off();
    }
    report();
  }

  void read_strokes(uint32_t now_us) {
    state_.t_us = now_us;
    if (hal_.pots_read(readings_)) {
      readings_lost_ = 0;
    } else if (readings_lost_ < UINT8_MAX) {
      ++readings_lost_;
    }
    const bool is_fresh = readings_lost_ == 0;
    for (uint8_t i = 0; i < kCorners; ++i) {
      if (is_fresh && settle_ticks_ > suspension::kObserveTicks) actuators_[i].start(readings_[i]);
      actuators_[i].observe(readings_[i], is_fresh);
    }
    has_readings_ = has_readings_ || is_fresh;
    if (!has_readings_ || settle_ticks_ == 0) return;
    if (--settle_ticks_ == 0) link_.started();
  }

  void find_faults() {
    if (readings_lost_ >= suspension::kReadingsLostTicks) link_.raise(wire::Fault::kPotOpen);
    if (!has_readings_) return;
    const uint8_t lower = hal_.lower_switches();
    const uint8_t upper = hal_.upper_switches();
    for (uint8_t i = 0; i < kCorners; ++i) {
      const uint8_t bit = static_cast<uint8_t>(1 << i);
      const wire::Fault fault = actuators_[i].diagnose((lower & bit) != 0, (upper & bit) != 0);
      if (fault != wire::Fault::kNone) link_.raise(fault, i);
    }
  }

  void command() {
    int16_t rates[kCorners];
    if (move_.running()) {
      common_move(rates);
    } else {
      slewed_setpoints(rates);
    }
    const bool holds = link_.supervisor().state() == wire::BoardState::kHolding;
    for (uint8_t i = 0; i < kCorners; ++i) {
      const int16_t duty_permille = holds ? actuators_[i].brake() : actuators_[i].follow(rates[i]);
      hal_.drive(i, duty_permille);
    }
  }

  void common_move(int16_t rates[kCorners]) {
    int32_t references[kCorners];
    int32_t lag = 0;
    for (uint8_t i = 0; i < kCorners; ++i) {
      references[i] = actuators_[i].reference();
      if (actuators_[i].lag() > lag) lag = actuators_[i].lag();
    }
    move_.step(references, full_speed_, lag, rates);
    for (uint8_t i = 0; i < kCorners; ++i) slewed_[i] = rates[i];  // a setpoint takes over from here
  }

  void slewed_setpoints(int16_t rates[kCorners]) {
    for (uint8_t i = 0; i < kCorners; ++i) {
      const int16_t target = neutral_seen_ ? clamp16(setpoint_[i], full_speed_) : int16_t{0};
      slewed_[i] = slew(slewed_[i], target);
      rates[i] = slewed_[i];
    }
  }

  // A rate grows step by step; it falls, stops and turns at once.
  static int16_t slew(int16_t from, int16_t to) {
    const bool same_way = (from > 0 && to > 0) || (from < 0 && to < 0);
    const int16_t start = !same_way ? int16_t{0} : magnitude(to) < magnitude(from) ? to : from;
    return static_cast<int16_t>(start + clamp16(minus(to, start), suspension::kSlewPerTick));
  }

  void outputs_off() {
    hal_.outputs_off();
    for (uint8_t i = 0; i < kCorners; ++i) {
      actuators_[i].release();
      slewed_[i] = 0;
    }
  }

  // ----------------------------------------------------------------------------------------- parameters

  int32_t parameter(uint8_t index) const { return link_.parameters().get(index); }

  // What a potentiometer reads above the straight line at this quarter of the stroke.
  int32_t bow(uint8_t quarter, uint8_t corner) {
    static_assert(PotCurve::kSegments == 4, "the parameters are those of the quarters");
    switch (quarter) {
      case 1:
        return parameter(static_cast<uint8_t>(wire::kParamPotQuarterCounts + corner));
      case 2:
        return parameter(static_cast<uint8_t>(wire::kParamPotHalfCounts + corner));
      case 3:
        return parameter(static_cast<uint8_t>(wire::kParamPotThreeQuartersCounts + corner));
      default:
        return 0;  // the ends
    }
  }

  void load_parameters() {
    full_speed_ = static_cast<int16_t>(parameter(wire::kParamFullSpeedMmps));
    Actuator::Limits limits;
    limits.low = parameter(wire::kParamStrokeLowMm) * kUnitsPerWireCount;
    limits.high = parameter(wire::kParamStrokeHighMm) * kUnitsPerWireCount;
    limits.full = parameter(wire::kParamStrokeFullMm) * kUnitsPerWireCount;
    limits.full_speed = full_speed_;
    curves_valid_ = limits.low < limits.high && limits.high <= limits.full;
    for (uint8_t i = 0; i < kCorners; ++i) {
      const int32_t low = parameter(static_cast<uint8_t>(wire::kParamPotLowCounts + i));
      const int32_t high = parameter(static_cast<uint8_t>(wire::kParamPotHighCounts + i));
      uint16_t points[PotCurve::kPoints];
      for (uint8_t k = 0; k < PotCurve::kPoints; ++k) {
        const int32_t reading = low + (high - low) * k / PotCurve::kSegments + bow(k, i);
        points[k] =
            static_cast<uint16_t>(reading < 0 ? 0 : reading);  // too large a one is refused by the curve
      }
      const uint16_t full = static_cast<uint16_t>(parameter(wire::kParamStrokeFullMm));
      curves_valid_ = actuators_[i].configure(points, full, limits) && curves_valid_;
    }
    if (!curves_valid_) link_.log(wire::LogLevel::kError, TIGER_TEXT("stroke calibration is not plausible"));
    has_readings_ = false;  // the next reading starts the observers afresh
    settle_ticks_ = suspension::kSettleTicks;
  }

  // ------------------------------------------------------------------------------------------ telemetry

  void report() {
    uint16_t flags = 0;
    for (uint8_t i = 0; i < kCorners; ++i) {
      const Actuator& actuator = actuators_[i];
      state_.stroke_mm[i] = actuator.stroke_counts();
      state_.rate_mmps[i] = clamp16(actuator.rate(), wire::SuspensionState::kRateMmpsMax);
      state_.duty_permille[i] = actuator.duty_permille();
      if (actuator.rate_limited())
        flags |= static_cast<uint16_t>(1u << (wire::kSuspensionFlagRateLimited + i));
      if (actuator.stroke_limited())
        flags |= static_cast<uint16_t>(1u << (wire::kSuspensionFlagStrokeLimited + i));
      if (actuator.duty_permille() != 0)
        flags |= static_cast<uint16_t>(1u << (wire::kSuspensionFlagDriveOn + i));
    }
    const bool is_armed = link_.supervisor().is_armed();
    if (link_.supervisor().state() == wire::BoardState::kHolding)
      flags |= 1u << wire::kSuspensionFlagSetpointLate;
    if (is_armed && neutral_seen_) flags |= 1u << wire::kSuspensionFlagNeutralSeen;
    if (move_.running()) flags |= 1u << wire::kSuspensionFlagMovingTo;
    if (link_.parameters().state() == StoreState::Loaded) flags |= 1u << wire::kSuspensionFlagCalibrated;
    state_.flags = flags;
    state_.state = static_cast<uint8_t>(link_.supervisor().state());
    state_.setpoint_age_ms = static_cast<uint8_t>(silent_ms_ < UINT8_MAX ? silent_ms_ : UINT8_MAX);
    state_pending_ = has_readings_;
    if (++raw_ticks_ < suspension::kRawEveryTicks) return;
    raw_ticks_ = 0;
    raw_pending_ = has_readings_;
  }

  bool send_raw() {
    wire::SuspensionRaw raw;
    raw.t_us = state_.t_us;
    for (uint8_t i = 0; i < kCorners; ++i) raw.pot_counts[i] = readings_[i];
    raw.switches = static_cast<uint16_t>((hal_.lower_switches() & 0x0F) |
                                         (hal_.upper_switches() & 0x0F) << 4 | (estop_pressed_ ? 0x100 : 0));
    return link_.send(raw);
  }

  Hal& hal_;
  Link link_;
  PeriodicTask control_;
  FrameReceiver<FromNano> peer_;
  Actuator actuators_[kCorners];
  SyncMove move_;
  SetpointAge age_;
  wire::SuspensionState state_ = {};

  uint16_t readings_[kCorners] = {};
  int16_t setpoint_[kCorners] = {};  // latest accepted, um/s
  int16_t slewed_[kCorners] = {};
  int16_t full_speed_ = 0;
  uint16_t accepted_ms_ = 0;
  uint16_t silent_ms_ = UINT16_MAX;  // since then
  uint16_t setpoint_rejects_ = 0;
  uint16_t estop_free_ms_ = 0;
  uint8_t readings_lost_ = 0;
  uint8_t settle_ticks_ = suspension::kSettleTicks;
  uint8_t raw_ticks_ = 0;
  bool curves_valid_ = false;
  bool has_readings_ = false;
  bool neutral_seen_ = false;
  bool estop_pressed_ = false;
  bool state_pending_ = false;
  bool raw_pending_ = false;
};

}  // namespace tiger
