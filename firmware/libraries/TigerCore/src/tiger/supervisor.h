// What a board may do: a table of states, and the faults it has latched.
//
// Nothing here knows a clock or a pin. Outputs may move in ARMED only, hold in HOLDING, and are off otherwise.
#pragma once

#include <stdint.h>

#include "protocol.h"

namespace tiger {

enum class Event : uint8_t {
  Started,        // sensors are up
  Arm,            // an ARM was accepted
  Disarm,         // by command, or the host no longer engages
  SetpointsLate,  // no setpoint in time
  SetpointsFlow,  // they come again
  FaultLatched,   //
  EstopLatched,   //
  FaultsCleared,  // the last one is gone
  EstopCleared,   // other faults are left
};
constexpr uint8_t kEventCount = 9;

namespace detail {
constexpr uint8_t kBooting = static_cast<uint8_t>(wire::BoardState::kBooting);
constexpr uint8_t kDisarmed = static_cast<uint8_t>(wire::BoardState::kDisarmed);
constexpr uint8_t kArmed = static_cast<uint8_t>(wire::BoardState::kArmed);
constexpr uint8_t kHolding = static_cast<uint8_t>(wire::BoardState::kHolding);
constexpr uint8_t kFault = static_cast<uint8_t>(wire::BoardState::kFault);
constexpr uint8_t kEstop = static_cast<uint8_t>(wire::BoardState::kEstop);

// Next state by present state (rows) and event (columns).
// clang-format off
constexpr uint8_t kNextState[wire::kBoardStateCount][kEventCount] = {
    // Started    Arm        Disarm     Late       Flow       Fault   Estop   Cleared    EstopCleared
    {kDisarmed,  kBooting,  kBooting,  kBooting,  kBooting,  kFault, kEstop, kBooting,  kBooting},   // BOOTING
    {kDisarmed,  kArmed,    kDisarmed, kDisarmed, kDisarmed, kFault, kEstop, kDisarmed, kDisarmed},  // DISARMED
    {kArmed,     kArmed,    kDisarmed, kHolding,  kArmed,    kFault, kEstop, kArmed,    kArmed},     // ARMED
    {kHolding,   kArmed,    kDisarmed, kHolding,  kArmed,    kFault, kEstop, kHolding,  kHolding},   // HOLDING
    {kFault,     kFault,    kFault,    kFault,    kFault,    kFault, kEstop, kDisarmed, kFault},     // FAULT
    {kEstop,     kEstop,    kEstop,    kEstop,    kEstop,    kEstop, kEstop, kDisarmed, kFault},     // ESTOP
};
// clang-format on
}  // namespace detail

class Supervisor {
 public:
  wire::BoardState state() const { return state_; }
  uint32_t faults() const { return faults_; }
  uint8_t fault_detail() const { return detail_; }
  bool has(wire::Fault fault) const { return (faults_ & bit(fault)) != 0; }
  bool is_armed() const { return state_ == wire::BoardState::kArmed || state_ == wire::BoardState::kHolding; }

  void handle(Event event) {
    const uint8_t next = detail::kNextState[static_cast<uint8_t>(state_)][static_cast<uint8_t>(event)];
    state_ = static_cast<wire::BoardState>(next);
  }

  // Latches a fault; `where` is the corner or channel, kNowhere when it has none. False: it was latched already.
  static constexpr uint8_t kNowhere = 255;
  bool latch(wire::Fault fault, uint8_t where) {
    if (has(fault)) return false;
    faults_ |= bit(fault);
    detail_ = where;
    handle(fault == wire::Fault::kEstop ? Event::EstopLatched : Event::FaultLatched);
    return true;
  }

  // Clears every latched fault of this permanence for which `is_gone` holds; false when one had to stay.
  template <class IsGone>
  bool clear(wire::Permanence permanence, IsGone is_gone) {
    const uint32_t before = faults_;
    bool all = true;
    for (uint8_t code = 1; code < 32; ++code) {
      const wire::Fault fault = static_cast<wire::Fault>(code);
      if (!has(fault) || wire::permanence(fault) != permanence) continue;
      if (is_gone(fault)) {
        faults_ &= ~bit(fault);
      } else {
        all = false;
      }
    }
    if (faults_ == before) return all;
    if (faults_ == 0) {
      detail_ = kNowhere;
      handle(Event::FaultsCleared);
    } else if ((before & ~faults_ & bit(wire::Fault::kEstop)) != 0) {
      handle(Event::EstopCleared);
    }
    return all;
  }

 private:
  static uint32_t bit(wire::Fault fault) { return uint32_t{1} << static_cast<uint8_t>(fault); }

  wire::BoardState state_ = wire::BoardState::kBooting;
  uint8_t detail_ = kNowhere;
  uint32_t faults_ = 0;
};

}  // namespace tiger
