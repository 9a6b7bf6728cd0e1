// nano_imu: reads the BNO055 at 100 Hz, keeps the body's attitude, and sends both to the Mega.
//
// It moves nothing: ARM only tells that the host relies on it. Faults latch and are reported, but the messages go
// on; their flags say what they are worth.
#pragma once

#include <stdint.h>

#include "../fusion/attitude_filter.h"
#include "../link.h"
#include "../protocol.h"
#include "../sensing/bno055.h"
#include "../task.h"
#include "nano_imu_config.h"

namespace tiger {

template <class Hal>
class NanoImu : public BoardHooks {
 public:
  explicit NanoImu(Hal& hal)
      : hal_(hal),
        link_(hal, *this),
        sensor_(hal),
        filter_(nano_imu_config::kAttitude),
        task_(nano_imu_config::kTickUs) {}

  void begin() {
    link_.begin();
    const uint32_t now_us = hal_.micros();
    apply_parameters();
    sensor_.begin(now_us);
    task_.start(now_us);
    sampled_us_ = mag_us_ = now_us;
  }

  void poll() {
    const uint32_t now_us = hal_.micros();
    talk(now_us);
    if (has_new_parameters_) apply_parameters();
    measure(now_us);
    watch_sensor();
    if (task_.due(now_us)) {
      if (now_us - sampled_us_ > nano_imu_config::kLateUs) report_stale(now_us);
      link_.task_done(task_, now_us);
    }
  }

  // ---- hooks of the link

  bool ready() const { return sensor_.working() && settled_ >= nano_imu_config::kSettleSamples; }

  bool fault_present(wire::Fault fault) const {
    return fault >= wire::Fault::kImuAbsent && fault <= wire::Fault::kImuData && !sensor_.working();
  }

  void parameters_changed() { has_new_parameters_ = true; }

  const fusion::AttitudeFilter& filter() const { return filter_; }

 private:
  using Link = BoardLink<Hal, NanoImu, wire::BoardKind::kNanoImu, wire::kParamCountNanoImu>;
  friend Link;

  static fusion::Vec3 triple(const typename Link::Values& p, uint8_t first, float scale) {
    float v[3];
    for (uint8_t i = 0; i < 3; i++) v[i] = scale * static_cast<float>(p.get(static_cast<uint8_t>(first + i)));
    return fusion::Vec3{v[0], v[1], v[2]};
  }

  // Physical value to counts of the wire, held inside its limits.
  TIGER_OUTLINE static int16_t counts(float value, float per_unit, int16_t limit) {
    const float x = value * per_unit;
    return held(static_cast<int32_t>(x < 0.0f ? x - 0.5f : x + 0.5f), limit);
  }

  // Three counts of a packed message are written and read as bytes: they need not be aligned.
  TIGER_OUTLINE static void put(void* out, const fusion::Vec3& v, float per_unit, int16_t limit) {
    const int16_t c[3] = {counts(v.x, per_unit, limit), counts(v.y, per_unit, limit),
                          counts(v.z, per_unit, limit)};
    memcpy(out, c, sizeof(c));
  }

  TIGER_OUTLINE static fusion::Vec3 as_vec(const void* counts_of_three) {
    int16_t c[3];
    memcpy(c, counts_of_three, sizeof(c));
    return fusion::Vec3{static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])};
  }

  static int16_t held(int32_t n, int16_t limit) {
    return n > limit ? limit : static_cast<int16_t>(n < -limit ? -limit : n);
  }

  // Register counts to counts of imu_raw, which have the same scales: only turned into the robot's axes.
  TIGER_OUTLINE void turn(const int16_t* sensor, int16_t limit, void* body) const {
    if (is_turned_) {
      put(body, mounting_ * as_vec(sensor), 1.0f, limit);
      return;
    }
    const int16_t c[3] = {held(sensor[0], limit), held(sensor[1], limit), held(sensor[2], limit)};
    memcpy(body, c, sizeof(c));
  }

  void set_flag(uint8_t bit, bool on) {
    const uint16_t mask = static_cast<uint16_t>(1u << bit);
    flags_ = static_cast<uint16_t>(on ? flags_ | mask : flags_ & ~mask);
  }

  // ---- the two halves of a turn, apart so that their stack frames do not add up

  TIGER_OUTLINE void talk(uint32_t now_us) {
    link_.poll(now_us);
    if (raw_pending_ && link_.send(raw_)) raw_pending_ = false;
  }

  TIGER_OUTLINE void measure(uint32_t now_us) {
    ImuReading reading;
    if (!sensor_.poll(now_us, reading)) return;
    sampled_us_ = now_us;
    take(reading);
    report(now_us);
  }

  TIGER_OUTLINE void apply_parameters() {
    has_new_parameters_ = false;
    const auto& p = link_.parameters();
    gyro_bias_ = triple(p, wire::kParamGyroBiasRadps, 1e-6f);
    accel_offset_ = triple(p, wire::kParamAccelOffsetMps2, 1e-4f);
    accel_scale_ = triple(p, wire::kParamAccelScalePermille, 1e-6f);
    const fusion::Vec3 v = triple(p, wire::kParamMountingQuaternion + 1, 1e-6f);
    const float w = 1e-6f * static_cast<float>(p.get(wire::kParamMountingQuaternion));
    mounting_ = fusion::matrix(fusion::normalised(fusion::Quat{w, v}));
    is_turned_ = fusion::dot(v, v) > 0.0f;
    is_calibrated_ = p.get(wire::kParamCalibrated) != 0;
    // What the filter learned with other corrections would be wrong now: it settles afresh.
    filter_.reset();
    turning_.reset();
    settled_ = 0;
    has_fused_ = false;
  }

  // ---- one sample

  TIGER_OUTLINE void take(const ImuReading& reading) {
    using namespace wire;
    const ImuVerdict& verdict = reading.verdict;
    raw_.t_us = reading.t_us;
    turn(reading.counts.accel, ImuRaw::kAccelMps2Max, raw_.accel_mps2);
    turn(reading.counts.gyro, ImuRaw::kGyroRadpsMax, raw_.gyro_radps);
    if (verdict.mag_fresh) {
      turn(reading.counts.mag, ImuRaw::kMagUtMax, raw_.mag_ut);
      mag_us_ = reading.t_us;
    }
    raw_.temperature_celsius = sensor_.temperature_celsius();
    set_flag(kImuFlagAccelOk, verdict.accel_ok);
    set_flag(kImuFlagGyroOk, verdict.gyro_ok);
    set_flag(kImuFlagMagOk, verdict.mag_ok);
    set_flag(kImuFlagMagFresh, verdict.mag_fresh);
    set_flag(kImuFlagSaturated, verdict.saturated);
    set_flag(kImuFlagStale, verdict.repeated);
    if (!verdict.gyro_ok) return;
    fusion::Vec3 accel_mps2;
    fuse(reading, accel_mps2);
    filter_.think();
    describe_attitude();
    describe_acceleration(accel_mps2);
  }

  // Without a usable rate nothing is done: the next good sample bridges the gap, or starts anew after it.
  TIGER_OUTLINE void fuse(const ImuReading& reading, fusion::Vec3& accel_mps2) {
    using namespace fusion;
    const ImuVerdict& verdict = reading.verdict;
    const uint32_t since_us = reading.t_us - fused_us_;
    const bool bridged = has_fused_ && since_us <= nano_imu_config::kBridgeUs;
    if (has_fused_ && !bridged) {
      filter_.resume();
      turning_.reset();
      settled_ = 0;
    }
    fused_us_ = reading.t_us;
    has_fused_ = true;

    ImuSample sample;
    calibrate(sample);
    sample.accel_usable = verdict.accel_ok;
    sample.may_rest = may_rest();
    filter_.sense(sample, bridged ? 1e-6f * static_cast<float>(since_us) : 0.0f);
    if (verdict.mag_fresh && verdict.mag_ok) {
      filter_.add_magnetometer(wire::ImuRaw::kMagUtScale * as_vec(raw_.mag_ut));
    }
    if (verdict.accel_ok && settled_ < nano_imu_config::kSettleSamples) settled_++;
    accel_mps2 = sample.accel_mps2;
  }

  // The body turns slowly and steadily while it levels itself, which looks like rest with a larger bias. Once the
  // bias is known, such a turn is told from rest by its rate.
  bool may_rest() const {
    const fusion::Vec3 rate = filter_.mean_rate_radps();
    constexpr float kMost2 = nano_imu_config::kRestRateRadps * nano_imu_config::kRestRateRadps;
    return !is_calibrated_ || fusion::dot(rate, rate) < kMost2;
  }

  TIGER_OUTLINE void calibrate(fusion::ImuSample& sample) const {
    using namespace fusion;
    const Vec3 accel = wire::ImuRaw::kAccelMps2Scale * as_vec(raw_.accel_mps2) - accel_offset_;
    sample.accel_mps2 = Vec3{accel_scale_.x * accel.x, accel_scale_.y * accel.y, accel_scale_.z * accel.z};
    sample.gyro_radps = wire::ImuRaw::kGyroRadpsScale * as_vec(raw_.gyro_radps) - gyro_bias_;
    sample.vehicle_accel_mps2 = Vec3{0.0f, 0.0f, 0.0f};
  }

  TIGER_OUTLINE void describe_attitude() {
    using wire::ImuAttitude;
    const fusion::Quat q = filter_.attitude();
    constexpr int16_t kUnit = ImuAttitude::kQuaternionMax;
    attitude_.quaternion[0] = counts(q.w, kUnit, kUnit);
    put(attitude_.quaternion + 1, q.v, kUnit, kUnit);
    const fusion::Vec3& rate = filter_.rate_radps();
    put(attitude_.rate_radps, rate, 1.0f / ImuAttitude::kRateRadpsScale, ImuAttitude::kRateRadpsMax);
  }

  TIGER_OUTLINE void describe_acceleration(const fusion::Vec3& accel_mps2) {
    using namespace fusion;
    using wire::ImuAttitude;
    const Vec3& rate = filter_.rate_radps();
    float smooth[3] = {rate.x, rate.y, rate.z};
    float steps[3];
    turning_.update(nano_imu_config::kAngularAccel, smooth, smooth, steps);
    constexpr float kPerStep = 2.0f / nano_imu_config::kTickS / ImuAttitude::kAngularAccelRadps2Scale;
    put(attitude_.angular_accel_radps2, Vec3{steps[0], steps[1], steps[2]}, kPerStep,
        ImuAttitude::kAngularAccelRadps2Max);
    const Vec3 gravity = rotate(conjugate(filter_.attitude()), Vec3{0.0f, 0.0f, kGravityMps2});
    put(attitude_.linear_accel_mps2, accel_mps2 - gravity, 1.0f / ImuAttitude::kLinearAccelMps2Scale,
        ImuAttitude::kLinearAccelMps2Max);
  }

  // ---- what is sent

  TIGER_OUTLINE void report(uint32_t now_us) {
    using namespace wire;
    set_flag(kImuFlagFilterReady, settled_ >= nano_imu_config::kSettleSamples);
    set_flag(kImuFlagRest, filter_.resting());
    set_flag(kImuFlagMagDisturbed, filter_.magnetically_disturbed());
    set_flag(kImuFlagCalibrated, is_calibrated_);
    const uint32_t mag_age_ms = (now_us - mag_us_) / 1000;
    raw_.mag_age_ms = mag_age_ms < 255 ? static_cast<uint8_t>(mag_age_ms) : 255;
    attitude_.t_us = raw_.t_us;
    attitude_.flags = flags_;
    link_.send(attitude_);
    raw_pending_ = true;  // goes in a turn in which there is room for it
  }

  TIGER_OUTLINE void report_stale(uint32_t now_us) {
    using namespace wire;
    set_flag(kImuFlagStale, true);
    set_flag(kImuFlagMagFresh, false);
    set_flag(kImuFlagAccelOk, false);
    set_flag(kImuFlagGyroOk, false);
    report(now_us);
  }

  TIGER_OUTLINE void watch_sensor() {
    switch (sensor_.fault()) {
      case ImuFault::None:
        break;
      case ImuFault::Absent:
        link_.raise(wire::Fault::kImuAbsent);
        break;
      case ImuFault::Bus:
        link_.raise(wire::Fault::kImuBus);
        break;
      case ImuFault::SelfTest:
        link_.raise(wire::Fault::kImuSelfTest);
        break;
      case ImuFault::Data:
        link_.raise(wire::Fault::kImuData);
        break;
    }
    sensor_.clear_fault();
    if (!started_ && sensor_.working()) {
      started_ = true;
      link_.started();
    }
  }

  Hal& hal_;
  Link link_;
  Bno055<Hal> sensor_;
  fusion::AttitudeFilter filter_;
  fusion::LowPass<3> turning_;
  fusion::Mat3 mounting_;
  fusion::Vec3 gyro_bias_, accel_offset_, accel_scale_;
  PeriodicTask task_;
  wire::ImuAttitude attitude_ = {0, {wire::ImuAttitude::kQuaternionMax, 0, 0, 0}, {}, {}, {}, 0};
  wire::ImuRaw raw_ = {};
  uint32_t fused_us_ = 0, mag_us_ = 0, sampled_us_ = 0;
  uint16_t settled_ = 0, flags_ = 0;
  bool has_fused_ = false, started_ = false, raw_pending_ = false, is_turned_ = false,
       has_new_parameters_ = false, is_calibrated_ = false;
};

}  // namespace tiger
