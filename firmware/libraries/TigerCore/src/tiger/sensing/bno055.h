// BNO055 inertial sensor over the Hal's two-wire bus: raw accelerometer, magnetometer and gyroscope at 100 Hz.
//
// The chip's own fusion is not used: its Euler registers jump beyond 20 degrees of tilt (firmware 0x0311) and
// its background calibration moves the heading. In AMG mode its registers 0x08 to 0x19 hold the three sensors,
// one burst of 18 bytes. It stretches the clock by milliseconds at times, so a transaction is waited for in
// poll() and given up after 9 ms; then nine clocks free the bus.
//
// Register addresses and values: BNO055 data sheet BST-BNO055-DS000, sections 3.5 (sensor configuration),
// 3.6 (output data) and 4 (register map).
#pragma once

#include <stdint.h>

#include "../hal.h"
#include "imu_checks.h"
#ifdef __AVR__
#include <avr/pgmspace.h>
#endif

namespace tiger {

namespace bno055 {

constexpr uint8_t kAddress = 0x28;  // COM3 low
constexpr uint8_t kChipId = 0xA0;

// Page 0.
constexpr uint8_t kRegChipId = 0x00;
constexpr uint8_t kRegPage = 0x07;
constexpr uint8_t kRegData =
    0x08;  // accelerometer 0x08, magnetometer 0x0E, gyroscope 0x14: x y z, low byte first
constexpr uint8_t kDataBytes = 18;
constexpr uint8_t kRegTemperature = 0x34;
constexpr uint8_t kRegSelfTest = 0x36;
constexpr uint8_t kRegUnits = 0x3B;
constexpr uint8_t kRegMode = 0x3D;
constexpr uint8_t kStatusBytes = kRegMode - kRegTemperature + 1;  // temperature first, mode last
constexpr uint8_t kRegPower = 0x3E;
constexpr uint8_t kRegTrigger = 0x3F;
constexpr uint8_t kRegAxisMap = 0x41;
constexpr uint8_t kRegAxisSign = 0x42;
// Page 1.
constexpr uint8_t kRegAccelConfig = 0x08;
constexpr uint8_t kRegMagConfig = 0x09;
constexpr uint8_t kRegGyroConfig0 = 0x0A;
constexpr uint8_t kRegGyroConfig1 = 0x0B;

constexpr uint8_t kModeConfig = 0x00;
constexpr uint8_t kModeAmg = 0x07;
constexpr uint8_t kSelfTestPassed = 0x0F;  // accelerometer, magnetometer, gyroscope, processor
constexpr uint8_t kTriggerReset = 0x20;
constexpr uint8_t kUnits = 0x02;        // m/s2, rad/s, degrees Celsius
constexpr uint8_t kAccelConfig = 0x0D;  // normal power, 62.5 Hz, 4 g
constexpr uint8_t kMagConfig = 0x0D;    // normal power, regular, 20 Hz
constexpr uint8_t kGyroConfig0 = 0x1A;  // 47 Hz, 500 degrees/s
constexpr uint8_t kGyroConfig1 = 0x00;  // normal power

constexpr uint16_t kBootMs = 650;      // from reset to configuration mode
constexpr uint16_t kToConfigMs = 19;   // from any mode
constexpr uint16_t kFromConfigMs = 7;  // to any mode

// How the chip is found and brought up, step by step; a step that gets no answer starts it all over.
enum class StepKind : uint8_t {
  Write,
  Expect,          // another value: start over
  ExpectSelfTest,  // another value: a fault, but go on; what still works is used
  ResumeIf,        // this value: the chip kept what was set before and only the bus was away: measure at once
};
struct Step {
  StepKind kind;
  uint8_t reg;
  uint8_t value;
  uint8_t wait_ms;  // afterwards
};

#ifndef __AVR__
#define TIGER_BNO055_FLASH
#else
#define TIGER_BNO055_FLASH PROGMEM
#endif
// Waits are two milliseconds longer than the data sheet's.
static const Step kBringUp[] TIGER_BNO055_FLASH = {
    {StepKind::Write, kRegPage, 0, 0},
    {StepKind::Expect, kRegChipId, kChipId, 0},
    {StepKind::ResumeIf, kRegMode, kModeAmg, 0},
    {StepKind::Write, kRegMode, kModeConfig, kToConfigMs + 2},
    {StepKind::ExpectSelfTest, kRegSelfTest, kSelfTestPassed, 0},
    {StepKind::Write, kRegPower, 0x00, 0},
    {StepKind::Write, kRegTrigger, 0x00, 0},
    {StepKind::Write, kRegUnits, kUnits, 0},
    {StepKind::Write, kRegAxisMap, 0x24, 0},  // the chip's own axes: the mounting quaternion turns them
    {StepKind::Write, kRegAxisSign, 0x00, 0},
    {StepKind::Write, kRegPage, 1, 0},
    {StepKind::Write, kRegAccelConfig, kAccelConfig, 0},
    {StepKind::Write, kRegMagConfig, kMagConfig, 0},
    {StepKind::Write, kRegGyroConfig0, kGyroConfig0, 0},
    {StepKind::Write, kRegGyroConfig1, kGyroConfig1, 0},
    {StepKind::Expect, kRegAccelConfig, kAccelConfig, 0},
    {StepKind::Expect, kRegMagConfig, kMagConfig, 0},
    {StepKind::Expect, kRegGyroConfig0, kGyroConfig0, 0},
    {StepKind::Write, kRegPage, 0, 0},
    {StepKind::Expect, kRegUnits, kUnits, 0},
    {StepKind::Write, kRegMode, kModeAmg, kFromConfigMs + 2},
};
#undef TIGER_BNO055_FLASH
constexpr uint8_t kBringUpSteps = sizeof(kBringUp) / sizeof(kBringUp[0]);

inline Step bring_up_step(uint8_t i) {
#ifdef __AVR__
  Step step;
  memcpy_P(&step, &kBringUp[i], sizeof(step));
  return step;
#else
  return kBringUp[i];
#endif
}

}  // namespace bno055

enum class ImuFault : uint8_t { None, Absent, Bus, SelfTest, Data };

struct ImuReading {
  uint32_t t_us;  // when the burst was started
  ImuCounts counts;
  ImuVerdict verdict;
};

template <class Hal>
class Bno055 {
 public:
  static constexpr uint32_t kPeriodUs = 10000;
  static constexpr uint32_t kTimeoutUs = 9000;        // longest stretch 6 ms, burst 0.5 ms
  static constexpr uint32_t kRetryUs = 20000;         // between two attempts to bring the chip up
  static constexpr uint32_t kBootLimitUs = 1000000;   // no answer for longer after power-on: absent
  static constexpr uint32_t kFirstDataUs = 60000;     // registers stay zero until the sensors have run
  static constexpr uint32_t kResetEveryUs = 5000000;  // at most: each reset costs 0.65 s without data
  static constexpr uint8_t kFailures = 2;             // transactions in a row before it is a fault
  static constexpr uint8_t kGoodSamples = 10;         // in a row before the sensor counts as working
  static constexpr uint8_t kStatusEvery = 25;         // bursts between two looks at temperature and mode

  explicit Bno055(Hal& hal) : hal_(hal) {}

  void begin(uint32_t now_us) {
    hal_.twi_reset();
    expect_boot(now_us);
    last_reset_us_ = now_us - kResetEveryUs;
  }

  // Call as often as possible; it never waits. True when `reading` is new.
  bool poll(uint32_t now_us, ImuReading& reading) {
    if (busy_) return finish(now_us, reading);
    if (static_cast<int32_t>(now_us - next_us_) >= 0) start(now_us);
    return false;
  }

  ImuFault fault() const { return fault_; }  // the first one since it was cleared
  void clear_fault() { fault_ = ImuFault::None; }
  bool working() const { return job_ != Job::BringUp && good_samples_ >= kGoodSamples; }
  int8_t temperature_celsius() const { return temperature_; }

 private:
  enum class Job : uint8_t { BringUp, Burst, Status, Reset };

  void latch(ImuFault fault) {
    if (fault_ == ImuFault::None) fault_ = fault;
  }

  // ---- the next transaction

  void bring_up(uint32_t at_us) {
    job_ = Job::BringUp;
    step_ = 0;
    next_us_ = at_us;
    good_samples_ = 0;
  }

  void expect_boot(uint32_t now_us) {
    configured_ = false;
    booting_ = true;
    boot_us_ = now_us;
    bring_up(now_us + kRetryUs);
  }

  void measure(uint32_t at_us) {
    job_ = Job::Burst;
    next_us_ = burst_us_ = first_burst_us_ = at_us;
    until_status_ = kStatusEvery;
    checks_.reset();
  }

  void start(uint32_t now_us) {
    started_us_ = now_us;
    bool started = false;
    switch (job_) {
      case Job::BringUp: {
        const bno055::Step step = bno055::bring_up_step(step_);
        started = step.kind == bno055::StepKind::Write ? write(step.reg, step.value) : read(step.reg, 1);
        break;
      }
      case Job::Burst:
        started = read(bno055::kRegData, bno055::kDataBytes);
        break;
      case Job::Status:
        started = read(bno055::kRegTemperature, bno055::kStatusBytes);
        break;
      case Job::Reset:
        started = write(bno055::kRegTrigger, bno055::kTriggerReset);
        break;
    }
    busy_ = started;
    if (!started) bus_failed(now_us);
  }

  bool read(uint8_t reg, uint8_t n) { return hal_.twi_start(bno055::kAddress, &reg, 1, n); }

  bool write(uint8_t reg, uint8_t value) {
    const uint8_t out[2] = {reg, value};
    return hal_.twi_start(bno055::kAddress, out, 2, 0);
  }

  // ---- what came of it

  bool finish(uint32_t now_us, ImuReading& reading) {
    const TwiStatus status = hal_.twi_status();
    if (status == TwiStatus::Busy && now_us - started_us_ < kTimeoutUs) return false;
    busy_ = false;
    if (status == TwiStatus::Done) return done(now_us, reading);
    if (status == TwiStatus::Busy || status == TwiStatus::BusError) {
      bus_failed(now_us);
    } else if (job_ == Job::Reset) {
      expect_boot(now_us);  // it may be gone before it acknowledges
    } else {
      failed(now_us, ImuFault::Absent);
    }
    return false;
  }

  void bus_failed(uint32_t now_us) {
    hal_.twi_reset();
    failed(now_us, ImuFault::Bus);
  }

  void failed(uint32_t now_us, ImuFault cause) {
    if (booting_ && now_us - boot_us_ > kBootLimitUs) booting_ = false;
    if (failures_ < kFailures) failures_++;
    const bool lost = failures_ == kFailures;
    if (lost && !(booting_ && cause == ImuFault::Absent)) latch(cause);
    if (job_ == Job::BringUp) {
      bring_up(now_us + kRetryUs);
    } else if (lost) {
      bring_up(now_us);
    } else {
      if (job_ == Job::Burst) next_burst(now_us);
      job_ = Job::Burst;
      next_us_ = burst_us_;
    }
  }

  bool done(uint32_t now_us, ImuReading& reading) {
    failures_ = 0;
    const uint8_t* data = hal_.twi_data();
    switch (job_) {
      case Job::BringUp:
        finish_step(now_us, data[0]);
        return false;
      case Job::Burst:
        return finish_burst(now_us, data, reading);
      case Job::Status:
        finish_status(now_us, data);
        return false;
      case Job::Reset:
        expect_boot(now_us);
        return false;
    }
    return false;
  }

  void finish_step(uint32_t now_us, uint8_t value) {
    using bno055::StepKind;
    const bno055::Step step = bno055::bring_up_step(step_);
    const bool as_expected = value == step.value;
    if (step.kind == StepKind::ResumeIf && as_expected && configured_) {
      measure(now_us);
      return;
    }
    if (step.kind == StepKind::Expect && !as_expected) {
      failed(now_us, ImuFault::Absent);  // something answers, but not the chip we know
      return;
    }
    if (step.kind == StepKind::ExpectSelfTest && !as_expected) latch(ImuFault::SelfTest);
    booting_ = false;
    next_us_ = now_us + uint32_t{1000} * step.wait_ms;
    if (++step_ < bno055::kBringUpSteps) return;
    configured_ = true;
    measure(next_us_);
  }

  void finish_status(uint32_t now_us, const uint8_t* data) {
    temperature_ = static_cast<int8_t>(data[0]);
    if (data[bno055::kStatusBytes - 1] != bno055::kModeAmg) {
      latch(ImuFault::Data);
      bring_up(now_us);
      return;
    }
    job_ = Job::Burst;
    next_us_ = burst_us_;
  }

  bool finish_burst(uint32_t now_us, const uint8_t* data, ImuReading& reading) {
    reading.t_us = started_us_;
    take_words(data, reading.counts.accel);
    take_words(data + 6, reading.counts.mag);
    take_words(data + 12, reading.counts.gyro);
    reading.verdict = checks_.step(reading.counts);
    next_burst(now_us);
    const ImuVerdict& verdict = reading.verdict;
    if (!verdict.accel_ok && now_us - first_burst_us_ < kFirstDataUs) {
      checks_.reset();
      return false;
    }
    if (verdict.faulty) {
      data_fault(now_us, verdict.saturated && !verdict.repeated);
    } else if (verdict.accel_ok && verdict.gyro_ok && good_samples_ < kGoodSamples) {
      if (++good_samples_ == kGoodSamples) asked_ = false;
    }
    if (job_ == Job::Burst && --until_status_ == 0) {
      until_status_ = kStatusEvery;
      job_ = Job::Status;
      next_us_ = now_us;
    }
    return true;
  }

  // A chip that has reset itself reads zero: asking it for its mode on the way through the bring-up finds out,
  // and mends it in 40 ms. If it claims to measure, only its own reset can help. A hard knock helps itself.
  void data_fault(uint32_t now_us, bool knock) {
    latch(ImuFault::Data);
    good_samples_ = 0;
    if (knock) return;
    if (!asked_) {
      asked_ = true;
      bring_up(now_us);
    } else if (now_us - last_reset_us_ >= kResetEveryUs) {
      last_reset_us_ = now_us;
      job_ = Job::Reset;
      next_us_ = now_us;
    }
  }

  // Bursts keep their raster whatever happens between them.
  void next_burst(uint32_t now_us) {
    burst_us_ += kPeriodUs;
    if (static_cast<int32_t>(burst_us_ - now_us) <= 0) burst_us_ = now_us;
    next_us_ = burst_us_;
  }

  static void take_words(const uint8_t* bytes, int16_t* words) {
    for (uint8_t i = 0; i < 3; i++) {
      words[i] = static_cast<int16_t>(bytes[2 * i] | static_cast<uint16_t>(bytes[2 * i + 1] << 8));
    }
  }

  Hal& hal_;
  ImuChecks checks_;
  uint32_t next_us_ = 0, started_us_ = 0, burst_us_ = 0, first_burst_us_ = 0, boot_us_ = 0,
           last_reset_us_ = 0;
  ImuFault fault_ = ImuFault::None;
  Job job_ = Job::BringUp;
  uint8_t step_ = 0, failures_ = 0, good_samples_ = 0, until_status_ = 0;
  int8_t temperature_ = 0;
  bool busy_ = false, booting_ = true, configured_ = false, asked_ = false;
};

}  // namespace tiger
