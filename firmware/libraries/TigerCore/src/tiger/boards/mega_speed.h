// mega_speed: the two wheels of one side. Counts quadrature edges, measures speed, finds faults of the sensors.
// Two of these boards are on the robot; a strap tells left from right. They drive nothing.
#pragma once

#include <math.h>
#include <stdint.h>

#include "../hal.h"
#include "../link.h"
#include "../protocol.h"
#include "../sensing/wheel_speed.h"
#include "../task.h"
#include "mega_speed_config.h"

namespace tiger {

// What is wrong with the sensors of one wheel, judged once a report.
class WheelDiagnosis {
 public:
  void begin(const WheelSpeed& wheel) {
    dead_ = false;
    other_edges_ = 0;
    illegal_seen_ = wheel.illegal_counts();
    illegal_recent_ = 0;
    clean_reports_ = 0;
  }

  // `other_moved`: edges the other wheel of the side went on since the last report.
  void judge(const WheelSpeed& wheel, uint16_t other_moved) {
    judge_dead(wheel, other_moved);
    judge_illegal(wheel);
  }

  bool dead() const { return dead_; }
  bool illegal() const { return illegal_recent_ >= speed_config::kIllegalLimit; }

 private:
  void judge_dead(const WheelSpeed& wheel, uint16_t other_moved) {
    const uint8_t crossings = wheel.same_edge_count();
    if (crossings == 0) {
      other_edges_ = 0;
      if (!wheel.stopped()) dead_ = false;  // it moves on: both signals change
      return;
    }
    other_edges_ = static_cast<uint16_t>(other_edges_ + other_moved);
    const bool other_rolls = other_edges_ >= speed_config::kDeadOtherEdges;
    dead_ = dead_ || (other_rolls && crossings >= speed_config::kDeadCrossings);
  }

  void judge_illegal(const WheelSpeed& wheel) {
    const uint16_t fresh = static_cast<uint16_t>(wheel.illegal_counts() - illegal_seen_);
    illegal_seen_ = wheel.illegal_counts();
    if (fresh == 0) {
      if (clean_reports_ < speed_config::kCleanReports) ++clean_reports_;
      if (clean_reports_ == speed_config::kCleanReports) illegal_recent_ = 0;
      return;
    }
    clean_reports_ = 0;
    const uint16_t room = static_cast<uint16_t>(UINT16_MAX - illegal_recent_);
    illegal_recent_ = static_cast<uint16_t>(illegal_recent_ + (fresh < room ? fresh : room));
  }

  bool dead_;
  uint8_t clean_reports_;
  uint16_t other_edges_;
  uint16_t illegal_seen_;
  uint16_t illegal_recent_;
};

template <class Hal>
class MegaSpeed : public BoardHooks {
 public:
  explicit MegaSpeed(Hal& hal)
      : hal_(hal),
        link_(hal, *this),
        observe_(speed_config::kObservePeriod_us),
        report_(speed_config::kReportPeriod_us) {}

  void begin() {
    link_.begin();
    begin_wheels();
    const uint32_t now_us = hal_.micros();
    observe_.start(now_us);
    report_.start(now_us);
    link_.started();
  }

  void poll() {
    const uint32_t now_us = hal_.micros();
    link_.poll(now_us);
    if (observe_.due(now_us)) observe();
    if (report_.due(now_us)) {
      observe();
      report(hal_.micros());
      link_.task_done(report_, now_us);
    }
  }

  // Hooks of the link.
  void parameters_changed() { begin_wheels(); }
  bool fault_present(wire::Fault fault) {
    bool present = false;
    for (uint8_t i = 0; i < speed_config::kWheels; ++i) {
      if (fault == wire::Fault::kEncoderDead) present = present || diagnosis_[i].dead();
      if (fault == wire::Fault::kEncoderIllegal) present = present || diagnosis_[i].illegal();
    }
    return present;
  }

 private:
  static constexpr uint8_t kWheels = speed_config::kWheels;
  using Link = BoardLink<Hal, MegaSpeed, wire::BoardKind::kMegaSpeed, wire::kParamCountMegaSpeed>;

  void begin_wheels() {
    WheelSpeedConfig config;
    config.teeth = static_cast<uint8_t>(link_.parameters().get(wire::kParamTeethCounts));
    config.zero_speed_ms = static_cast<uint16_t>(link_.parameters().get(wire::kParamZeroSpeedMs));
    opposite_edges_ = 0;
    for (uint8_t i = 0; i < kWheels; ++i) {
      wheels_[i].begin(config, hal_.edges(i));
      diagnosis_[i].begin(wheels_[i]);
      count_at_report_[i] = wheels_[i].count();
    }
  }

  void observe() {
    for (uint8_t i = 0; i < kWheels; ++i) wheels_[i].observe(hal_.edges(i));
  }

  void report(uint32_t now_us) {
    uint16_t moved[kWheels];
    for (uint8_t i = 0; i < kWheels; ++i) {
      wheels_[i].update();
      const int32_t edges = wheels_[i].count() - count_at_report_[i];
      count_at_report_[i] = wheels_[i].count();
      moved[i] = static_cast<uint16_t>(edges < 0 ? -edges : edges);
    }
    diagnose(moved);
    send(now_us);
  }

  void diagnose(const uint16_t moved[kWheels]) {
    for (uint8_t i = 0; i < kWheels; ++i) {
      diagnosis_[i].judge(wheels_[i], moved[1 - i]);
      if (diagnosis_[i].dead()) link_.raise(wire::Fault::kEncoderDead, i);
      if (diagnosis_[i].illegal()) link_.raise(wire::Fault::kEncoderIllegal, i);
    }
    const float front = wheels_[0].speed_radps();
    const float rear = wheels_[1].speed_radps();
    if (fabsf(front) < speed_config::kCrawl_radps || fabsf(rear) < speed_config::kCrawl_radps) return;
    const uint16_t both = moved[0] < moved[1] ? moved[0] : moved[1];
    if ((front > 0) == (rear > 0)) {
      opposite_edges_ = 0;
    } else if (opposite_edges_ < speed_config::kOppositeEdges) {
      opposite_edges_ = static_cast<uint16_t>(opposite_edges_ + both);
    }
  }

  void send(uint32_t now_us) {
    wire::WheelSpeed message;
    message.t_us = now_us;
    uint16_t flags = 0;
    for (uint8_t i = 0; i < kWheels; ++i) {
      const WheelSpeed& wheel = wheels_[i];
      const int32_t speed = in_wire_counts(wheel.speed_radps());
      message.edge_counts[i] = wheel.count();
      message.speed_radps[i] = speed;
      message.edge_age_ms[i] = wheel.edge_age_ms();
      message.illegal_counts[i] = wheel.illegal_counts();
      set(flags, wire::kWheelFlagStopped, i, wheel.stopped());
      set(flags, wire::kWheelFlagReverse, i, speed < 0);
      set(flags, wire::kWheelFlagDeadChannel, i, diagnosis_[i].dead());
      set(flags, wire::kWheelFlagSwapped, i, opposite_edges_ >= speed_config::kOppositeEdges);
      set(flags, wire::kWheelFlagPitchLearned, i, wheel.pitch_learned());
    }
    message.flags = flags;
    link_.send(message);
  }

  static void set(uint16_t& flags, uint8_t group, uint8_t wheel, bool on) {
    if (on) flags = static_cast<uint16_t>(flags | (1u << (group + wheel)));
  }

  // Faster than the message can say is said as its limit.
  static int32_t in_wire_counts(float speed_radps) {
    constexpr float kMost = static_cast<float>(wire::WheelSpeed::kSpeedRadpsMax);
    const float counts = speed_radps / wire::WheelSpeed::kSpeedRadpsScale;
    if (counts > kMost) return wire::WheelSpeed::kSpeedRadpsMax;
    if (counts < -kMost) return wire::WheelSpeed::kSpeedRadpsMin;
    return static_cast<int32_t>(counts + (counts < 0 ? -0.5f : 0.5f));
  }

  Hal& hal_;
  Link link_;
  PeriodicTask observe_;
  PeriodicTask report_;
  WheelSpeed wheels_[kWheels];
  WheelDiagnosis diagnosis_[kWheels];
  int32_t count_at_report_[kWheels];
  uint16_t opposite_edges_;
};

}  // namespace tiger
