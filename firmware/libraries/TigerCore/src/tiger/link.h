// A board's end of its wire: introduces itself, answers PING and config messages, arms, reports its health.
//
// Every board holds one BoardLink and hands it each turn of its main loop. What is particular to the board comes
// back through the hooks below. Nothing here waits: a reply that finds no room in the UART buffer is kept and sent
// in a later turn, telemetry that finds none is dropped (a newer one follows).
#pragma once

#include <stdint.h>
#include <string.h>

#include "frame.h"
#include "hal.h"
#include "identity.h"
#include "parameters.h"
#include "protocol.h"
#include "supervisor.h"
#include "task.h"
#include "version.h"

// A line for LOG, at most 40 characters, kept in flash on the AVR.
#ifdef __AVR__
#include <avr/pgmspace.h>
#define TIGER_TEXT(text) PSTR(text)
#else
#define TIGER_TEXT(text) (text)
#endif

namespace tiger {

constexpr uint8_t kResetByWatchdog = 0x08;  // MCUSR.WDRF
constexpr uint8_t kResetByPower = 0x01;     // MCUSR.PORF
constexpr uint32_t kHealthPeriodUs = 100000;
constexpr uint32_t kHelloPeriodUs = 1000000;
constexpr uint16_t kRepeatWindowMs = 1000;  // a config message seen again within this is a repetition
constexpr uint8_t kBytesPerTurn = 64;       // received bytes taken in one turn, so that it stays short
constexpr uint8_t kOverrunsInARow = 10;

// What a board may tell its link; a board hides those it needs.
struct BoardHooks {
  bool ready() { return true; }                      // may it be armed?
  bool fault_present(wire::Fault) { return false; }  // is the cause of a latched fault still there?
  void armed() {}                                    //
  void disarmed() {}                                 //
  void parameters_changed() {}                       //
  void stream(const Frame&) {}                       // a stream message of this board alone
  wire::AckStatus config(const Frame&, int32_t&) {
    return wire::AckStatus::kOk;
  }                                                             // a config message likewise
  void forward(const Frame&) {}                                 // a frame for another node
  uint16_t peer_rejects(wire::RejectCause) const { return 0; }  // on a second wire
  uint16_t setpoint_rejects() const { return 0; }               // too old
};

// What the host says to a board of this kind, with what it says to the boards behind it.
template <wire::BoardKind kKind>
struct FromHost {
  static uint8_t payload_size(uint8_t id) { return wire::payload_size_to_board(speaker(id), id); }
  static bool payload_in_range(uint8_t id, const uint8_t* payload) {
    return wire::payload_in_range_to_board(speaker(id), id, payload);
  }
  static bool is_for_another(uint8_t id) { return speaker(id) != kKind; }

 private:
  static wire::BoardKind speaker(uint8_t id) {
    const bool is_mine = kKind != wire::BoardKind::kMegaSuspension ||
                         wire::payload_size_to_board(kKind, id) != wire::kNoSuchId;
    return is_mine ? kKind : wire::BoardKind::kNanoImu;
  }
};

template <class Hal, class Board, wire::BoardKind kKind, uint8_t kParamCount>
class BoardLink {
 public:
  using Values = Parameters<kKind, kParamCount>;

  BoardLink(Hal& hal, Board& board)
      : hal_(hal), board_(board), health_(kHealthPeriodUs), hello_(kHelloPeriodUs) {}

  // First thing of a board's begin(), after its outputs are safe.
  void begin() {
    identity_.load(hal_);
    parameters_.load(hal_);
    session_ = static_cast<uint8_t>(identity_.boot_count() * 37 + 1);
    remember_last_run();
    if (parameters_.state() == StoreState::Damaged) raise(wire::Fault::kParameters);
    const uint32_t now_us = hal_.micros();
    health_.start(now_us);
    hello_.start(now_us);
    times_.start(now_us);
    hello_pending_ = true;
  }

  // The board's sensors are up.
  void started() { supervisor_.handle(Event::Started); }

  // Once per turn of the main loop.
  void poll(uint32_t now_us) {
    times_.turn(now_us);
    receive();
    identity_.poll(hal_);
    if (parameters_.poll(hal_) && parameters_.state() == StoreState::Damaged) raise(wire::Fault::kParameters);
    if (hello_.due(now_us) && !supervisor_.is_armed()) {
      hello_pending_ = true;
      hello_nonce_ = 0;
    }
    if (health_.due(now_us)) health_pending_ = true;
    send_pending();
  }

  // Called by the board's periodic task each time it ran: feeds the watchdog and watches the task's deadlines.
  void task_done(const PeriodicTask& task, uint32_t now_us) {
    hal_.watchdog_feed();
    times_.fed(now_us);
    overruns_ = task.missed();
    if (task.missed_in_a_row() >= kOverrunsInARow) raise(wire::Fault::kOverrun);
  }

  // Latches a fault and leaves word of it for the next boot.
  void raise(wire::Fault fault, uint8_t where = Supervisor::kNowhere) {
    if (!supervisor_.latch(fault, where)) return;
    FaultRecord& record = hal_.fault_record();
    record.magic = kFaultRecordMagic;
    record.fault = static_cast<uint8_t>(fault);
    record.detail = where;
  }

  void disarm() {
    supervisor_.handle(Event::Disarm);
    supervisor_.clear(wire::Permanence::kUntilDisarm, [](wire::Fault) { return true; });
    ++session_;
    board_.disarmed();
  }

  // Sends one message now; false when the UART has no room for it.
  template <class Message>
  bool send(const Message& message) {
    uint8_t frame[kMaxFrame];
    const uint8_t* payload = reinterpret_cast<const uint8_t*>(&message);
    const uint8_t n = encode_frame(Message::kId, seq_, payload, Message::kSize, frame);
    if (hal_.host_write_space() < n) return false;
    hal_.host_write(frame, n);
    ++seq_;
    return true;
  }

  // Sends a line of text, TIGER_TEXT("..."), as soon as there is room; the newest wins.
  void log(wire::LogLevel level, const char* text) {
    log_level_ = level;
    log_text_ = text;
  }

  Supervisor& supervisor() { return supervisor_; }
  const Supervisor& supervisor() const { return supervisor_; }
  const Values& parameters() const { return parameters_; }

 private:
  using Dictionary = FromHost<kKind>;

  void remember_last_run() {
    FaultRecord& record = hal_.fault_record();
    const bool is_kept = record.magic == kFaultRecordMagic && (hal_.reset_cause() & kResetByPower) == 0;
    last_fault_ = is_kept ? record.fault : 0;
    record.magic = kFaultRecordMagic;
    record.fault = 0;
    record.detail = Supervisor::kNowhere;
    const bool hung = (hal_.reset_cause() & kResetByWatchdog) != 0 ||
                      last_fault_ == static_cast<uint8_t>(wire::Fault::kWatchdog);
    if (!hung) return;
    last_fault_ = static_cast<uint8_t>(wire::Fault::kWatchdog);
    raise(wire::Fault::kWatchdog);
  }

  // ------------------------------------------------------------------------------------------- receiving

  void receive() {
    uint8_t byte;
    for (uint8_t n = 0; n < kBytesPerTurn && hal_.host_read(byte); ++n) {
      if (!receiver_.take(byte)) continue;
      const Frame& frame = receiver_.frame();
      if (frame.id() == wire::Hello::kId) has_seq_ = false;  // a host that starts anew
      count_gap(frame.seq());
      dispatch(frame);
    }
  }

  // A number behind the last one is a repetition: no gap, and no new place to count from.
  void count_gap(uint8_t seq) {
    const uint8_t gap = static_cast<uint8_t>(seq - last_seq_ - 1);
    if (has_seq_ && gap > INT8_MAX) return;
    if (has_seq_) seq_gaps_ = static_cast<uint16_t>(seq_gaps_ + gap);
    last_seq_ = seq;
    has_seq_ = true;
  }

  void dispatch(const Frame& frame) {
    const uint8_t node_at = wire::node_offset(frame.id());
    const bool is_other_node = node_at != wire::kNoNode && frame.payload()[node_at] != wire::node_of(kKind);
    if (is_other_node || Dictionary::is_for_another(frame.id())) {
      board_.forward(frame);
    } else if (wire::is_config(frame.id())) {
      answer(frame);
    } else if (frame.id() == wire::Hello::kId) {
      identity_.name(hal_.micros());
      hello_pending_ = true;
      hello_nonce_ = frame.as<wire::Hello>().host_nonce;
      has_answered_ = false;
    } else if (frame.id() == wire::Ping::kId) {
      pong_pending_ = true;
      pong_host_us_ = frame.as<wire::Ping>().host_us;
      pong_rx_us_ = hal_.micros();
    } else {
      board_.stream(frame);
    }
  }

  // ------------------------------------------------------------------------------------ config messages

  // Carries out a config message, once: a repetition only gets its answer again.
  void answer(const Frame& frame) {
    const uint16_t now_ms = static_cast<uint16_t>(hal_.millis());
    const bool is_repetition = has_answered_ && ack_.id == frame.id() && ack_.seq == frame.seq() &&
                               static_cast<uint16_t>(now_ms - answered_ms_) < kRepeatWindowMs;
    if (!is_repetition) {
      ack_.node = wire::node_of(kKind);
      ack_.id = frame.id();
      ack_.seq = frame.seq();
      int32_t value = 0;
      ack_.status = static_cast<uint8_t>(carry_out(frame, value));
      ack_.value = value;
      answered_ms_ = now_ms;
      has_answered_ = true;
    }
    ack_pending_ = true;
  }

  wire::AckStatus carry_out(const Frame& frame, int32_t& value) {
    switch (frame.id()) {
      case wire::Arm::kId:
        return arm(frame.as<wire::Arm>(), value);
      case wire::Disarm::kId:
        disarm();
        value = session_;
        return wire::AckStatus::kOk;
      case wire::ClearFaults::kId:
        return clear_faults();
      case wire::Estop::kId:
        raise(wire::Fault::kEstop);
        return wire::AckStatus::kOk;
      case wire::ParamGet::kId:
        return get_parameter(frame.as<wire::ParamGet>().index, value);
      case wire::ParamSet::kId:
        return set_parameter(frame.as<wire::ParamSet>(), value);
      case wire::ParamSave::kId:
        return supervisor_.is_armed() ? wire::AckStatus::kNotDisarmed : parameters_.save();
      default:
        return board_.config(frame, value);
    }
  }

  wire::AckStatus arm(const wire::Arm& request, int32_t& value) {
    value = session_;
    if (request.schema_hash != wire::schema_hash(kKind)) return wire::AckStatus::kBadSchema;
    if (request.session != session_) return wire::AckStatus::kBadSession;
    if (supervisor_.state() == wire::BoardState::kEstop) return wire::AckStatus::kEstopped;
    if (supervisor_.faults() != 0) return wire::AckStatus::kFaulted;
    if (supervisor_.state() == wire::BoardState::kBooting || !board_.ready())
      return wire::AckStatus::kNotReady;
    supervisor_.handle(Event::Arm);
    board_.armed();
    return wire::AckStatus::kOk;
  }

  wire::AckStatus clear_faults() {
    const bool all = supervisor_.clear(wire::Permanence::kUntilCleared, [this](wire::Fault fault) {
      if (fault == wire::Fault::kParameters) return parameters_.state() != StoreState::Damaged;
      return !board_.fault_present(fault);
    });
    return all ? wire::AckStatus::kOk : wire::AckStatus::kStillPresent;
  }

  wire::AckStatus get_parameter(uint8_t index, int32_t& value) {
    if (index >= kParamCount) return wire::AckStatus::kBadIndex;
    value = parameters_.get(index);
    return wire::AckStatus::kOk;
  }

  wire::AckStatus set_parameter(const wire::ParamSet& request, int32_t& value) {
    if (supervisor_.is_armed()) return wire::AckStatus::kNotDisarmed;
    const wire::AckStatus status = parameters_.set(request.index, request.value);
    if (request.index < kParamCount) value = parameters_.get(request.index);
    if (status == wire::AckStatus::kOk) board_.parameters_changed();
    return status;
  }

  // ---------------------------------------------------------------------------------------------- sending

  void send_pending() {
    if (ack_pending_) ack_pending_ = !send(ack_);
    if (hello_pending_) hello_pending_ = !send_hello();
    if (health_pending_) health_pending_ = !send_health();
    if (pong_pending_) pong_pending_ = !send_pong();
    if (log_text_ != nullptr && send_log()) log_text_ = nullptr;
  }

  bool send_pong() {
    wire::Pong pong;
    pong.node = wire::node_of(kKind);
    pong.host_us = pong_host_us_;
    pong.rx_us = pong_rx_us_;
    pong.tx_us = hal_.micros();
    return send(pong);
  }

  bool send_hello() {
    wire::HelloReply reply;
    reply.proto = wire::kProto;
    reply.node = wire::node_of(kKind);
    reply.board_kind = static_cast<uint8_t>(kKind);
    reply.instance = hal_.instance();
    reply.board_uid = identity_.uid();
    reply.schema_hash = wire::schema_hash(kKind);
    reply.fw_version[0] = kVersionMajor;
    reply.fw_version[1] = kVersionMinor;
    reply.fw_version[2] = kVersionPatch;
    reply.git = TIGER_GIT;
    reply.dirty = TIGER_DIRTY;
    reply.reset_cause = hal_.reset_cause();
    reply.boot_count = identity_.boot_count();
    reply.last_fault = last_fault_;
    reply.uptime_ms = hal_.millis();
    reply.host_nonce = hello_nonce_;
    reply.session = session_;
    return send(reply);
  }

  bool send_health() {
    wire::Health health;
    health.node = wire::node_of(kKind);
    health.state = static_cast<uint8_t>(supervisor_.state());
    health.faults = supervisor_.faults();
    health.fault_detail = supervisor_.fault_detail();
    health.loop_min_us = times_.min_us();
    health.loop_max_us = times_.max_us();
    health.overruns = overruns_;
    for (uint8_t i = 0; i < wire::kRejectCauseCount; ++i) {
      const wire::RejectCause cause = static_cast<wire::RejectCause>(i);
      health.rejects[i] = static_cast<uint16_t>(receiver_.rejects(cause) + board_.peer_rejects(cause));
    }
    health.seq_gaps = seq_gaps_;
    health.setpoint_rejects = board_.setpoint_rejects();
    health.ram_free_bytes = hal_.ram_free_bytes();
    health.supply_mv = hal_.supply_mv();
    health.watchdog_margin_ms = times_.watchdog_margin_ms();
    if (!send(health)) return false;
    times_.clear_turns();
    return true;
  }

  bool send_log() {
    wire::Log line;
    line.node = wire::node_of(kKind);
    line.level = static_cast<uint8_t>(log_level_);
#ifdef __AVR__
    strncpy_P(line.text, log_text_, sizeof(line.text));
#else
    memset(line.text, 0, sizeof(line.text));
    memcpy(line.text, log_text_, strnlen(log_text_, sizeof(line.text)));
#endif
    return send(line);
  }

  Hal& hal_;
  Board& board_;
  Supervisor supervisor_;
  Identity identity_;
  Values parameters_;
  FrameReceiver<Dictionary> receiver_;
  PeriodicTask health_;
  PeriodicTask hello_;
  LoopTimes times_;

  wire::Ack ack_ = {};
  uint16_t answered_ms_ = 0;
  uint32_t pong_host_us_ = 0;
  uint32_t pong_rx_us_ = 0;
  const char* log_text_ = nullptr;
  uint16_t hello_nonce_ = 0;
  uint16_t overruns_ = 0;
  uint16_t seq_gaps_ = 0;
  uint8_t seq_ = 0;
  uint8_t last_seq_ = 0;
  uint8_t session_ = 0;
  uint8_t last_fault_ = 0;
  wire::LogLevel log_level_ = wire::LogLevel::kInfo;
  bool has_seq_ = false;
  bool has_answered_ = false;
  bool ack_pending_ = false;
  bool pong_pending_ = false;
  bool hello_pending_ = false;
  bool health_pending_ = false;
};

}  // namespace tiger
