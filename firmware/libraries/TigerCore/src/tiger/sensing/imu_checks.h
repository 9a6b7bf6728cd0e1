// Can this reading be true? Checks of raw inertial samples, one after the other.
//
// A healthy sensor is never exactly still: noise moves its last bits, so readings that repeat are the sign of a
// frozen chip. One repeat is normal, because the chip's clock and ours drift past each other.
#pragma once

#include <stdint.h>

namespace tiger {

// Register counts: 100 per m/s2, 900 per rad/s, 16 per microtesla.
struct ImuCounts {
  int16_t accel[3];
  int16_t mag[3];
  int16_t gyro[3];
};

struct ImuVerdict {
  bool accel_ok;  // of this sample: may be used
  bool gyro_ok;
  bool mag_ok;
  bool mag_fresh;  // differs from the sample before
  bool repeated;   // accelerometer and gyroscope both: nothing new
  bool saturated;
  bool faulty;  // wrong for so long that the sensor must be called broken
};

class ImuChecks {
 public:
  static constexpr int16_t kAccelRail = 3900;  // 4 g is 3922 counts
  static constexpr int16_t kAccelImpossible = 4000;
  static constexpr int16_t kAccelLeast = 100;  // sum of magnitudes: free fall is no state of this robot
  static constexpr int16_t kGyroRail = 7800;   // 500 degrees/s is 7854 counts
  static constexpr int16_t kGyroImpossible = 8000;
  static constexpr int16_t kGyroJump = 2880;       // 320 rad/s2 over 10 ms
  static constexpr int16_t kMagLeast = 80;         // sum of magnitudes, 5 uT; the earth's field is 25 to 65
  static constexpr int16_t kMagImpossible = 8000;  // 500 uT on one axis
  static constexpr uint8_t kBadSamples = 2;        // zero or impossible
  static constexpr uint8_t kRailSamples = 3;
  // Repetitions in a row from which a sample is not used, and from which the sensor is broken. Both sensors repeat
  // by chance three times once in 1e9 samples, one alone far more often.
  static constexpr uint8_t kSuspectBoth = 2;
  static constexpr uint8_t kStuckBoth = 3;
  static constexpr uint8_t kSuspectOne = 3;
  static constexpr uint8_t kStuckOne = 10;

  void reset() { *this = ImuChecks(); }

  ImuVerdict step(const ImuCounts& now) {
    const bool zero = all_zero(now.accel) && all_zero(now.gyro);
    const bool accel_impossible = zero || beyond(now.accel, kAccelImpossible) || sum(now.accel) < kAccelLeast;
    const bool gyro_impossible = zero || beyond(now.gyro, kGyroImpossible) || jumped(now.gyro);
    const bool accel_rail = beyond(now.accel, kAccelRail);
    const bool gyro_rail = beyond(now.gyro, kGyroRail);
    count(accel_repeats_, started_ && same(now.accel, last_.accel));
    count(gyro_repeats_, started_ && same(now.gyro, last_.gyro));
    count(bad_samples_, accel_impossible || gyro_impossible);
    count(rail_samples_, accel_rail || gyro_rail);
    const uint8_t both = accel_repeats_ < gyro_repeats_ ? accel_repeats_ : gyro_repeats_;

    ImuVerdict v;
    v.repeated = both > 0;
    v.saturated = accel_rail || gyro_rail;
    v.accel_ok = !accel_impossible && !accel_rail && both < kSuspectBoth && accel_repeats_ < kSuspectOne;
    v.gyro_ok = !gyro_impossible && !gyro_rail && both < kSuspectBoth && gyro_repeats_ < kSuspectOne;
    v.mag_fresh = !started_ || !same(now.mag, last_.mag);
    v.mag_ok = sum(now.mag) >= kMagLeast && !beyond(now.mag, kMagImpossible);
    v.faulty = bad_samples_ >= kBadSamples || rail_samples_ >= kRailSamples || both >= kStuckBoth ||
               accel_repeats_ >= kStuckOne || gyro_repeats_ >= kStuckOne;

    if (!gyro_impossible || bad_samples_ >= kBadSamples) copy(good_gyro_, now.gyro);
    last_ = now;
    started_ = true;
    return v;
  }

 private:
  static void count(uint8_t& counter, bool again) {
    if (!again) counter = 0;
    if (again && counter < UINT8_MAX) ++counter;
  }
  static bool all_zero(const int16_t* v) { return v[0] == 0 && v[1] == 0 && v[2] == 0; }
  static bool same(const int16_t* a, const int16_t* b) {
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
  }
  static void copy(int16_t* to, const int16_t* from) {
    for (uint8_t i = 0; i < 3; i++) to[i] = from[i];
  }
  static bool beyond(const int16_t* v, int16_t limit) {
    for (uint8_t i = 0; i < 3; i++) {
      if (v[i] >= limit || v[i] <= -limit) return true;
    }
    return false;
  }
  static int32_t sum(const int16_t* v) {
    int32_t s = 0;
    for (uint8_t i = 0; i < 3; i++) s += v[i] < 0 ? -static_cast<int32_t>(v[i]) : v[i];
    return s;
  }
  bool jumped(const int16_t* gyro) const {
    if (!started_) return false;
    for (uint8_t i = 0; i < 3; i++) {
      const int32_t d = static_cast<int32_t>(gyro[i]) - good_gyro_[i];
      if (d > kGyroJump || d < -kGyroJump) return true;
    }
    return false;
  }

  ImuCounts last_ = {};
  int16_t good_gyro_[3] = {};
  uint8_t accel_repeats_ = 0, gyro_repeats_ = 0, bad_samples_ = 0, rail_samples_ = 0;
  bool started_ = false;
};

}  // namespace tiger
