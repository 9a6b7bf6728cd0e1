#include "bno055_model.h"

#include <math.h>
#include <string.h>

namespace tiger {

namespace {

constexpr uint64_t kBootUs = 650000;     // from reset to configuration mode
constexpr uint64_t kPowerOnUs = 400000;  // from supply on
constexpr uint64_t kToConfigUs = 19000;
constexpr uint64_t kFromConfigUs = 7000;
constexpr uint64_t kFirstSampleUs = 20000;
constexpr uint64_t kInertialPeriodUs = 10030;  // 100 Hz by the chip's own clock
constexpr uint64_t kMagPeriodUs = 50150;       // 20 Hz
constexpr double kGravity = 9.80665;
constexpr double kDegree = 0.017453292519943295;
constexpr double kMagRangeUt = 1300.0;

constexpr uint8_t kPage = 0x07;
constexpr uint8_t kData = 0x08;
constexpr uint8_t kTemperature = 0x34;
constexpr uint8_t kSelfTest = 0x36;
constexpr uint8_t kUnits = 0x3B;
constexpr uint8_t kMode = 0x3D;
constexpr uint8_t kTrigger = 0x3F;
constexpr uint8_t kAccelConfig = 0x08;  // page 1
constexpr uint8_t kGyroConfig0 = 0x0A;  // page 1

}  // namespace

Bno055Model::Bno055Model(uint32_t seed) : chance_(seed * 2654435761ull + 1) { boot(kPowerOnUs); }

void Bno055Model::power_on() { boot(kPowerOnUs); }

void Bno055Model::boot(uint64_t takes_us) {
  memset(pages_, 0, sizeof(pages_));
  memset(latched_, 0, sizeof(latched_));
  uint8_t* p = pages_[0];
  p[0x00] = 0xA0;  // chip, accelerometer, magnetometer, gyroscope
  p[0x01] = 0xFB;
  p[0x02] = 0x32;
  p[0x03] = 0x0F;
  p[0x04] = 0x11;  // software 3.11, bootloader
  p[0x05] = 0x03;
  p[0x06] = 0x15;
  p[kSelfTest] = 0x0F;
  p[kUnits] = 0x80;
  p[0x41] = 0x24;
  pages_[1][kAccelConfig] = 0x0D;
  pages_[1][0x09] = 0x6D;
  pages_[1][kGyroConfig0] = 0x38;
  page_ = 0;
  mode_ = 0;
  selected_ = false;
  boot_done_us_ = mode_ready_us_ = now_us_ + takes_us;
}

void Bno055Model::set_motion(const double accel_mps2[3], const double gyro_radps[3], const double mag_ut[3],
                             double temperature_celsius) {
  memcpy(accel_, accel_mps2, sizeof(accel_));
  memcpy(gyro_, gyro_radps, sizeof(gyro_));
  memcpy(mag_, mag_ut, sizeof(mag_));
  temperature_ = temperature_celsius;
}

void Bno055Model::set_faults(uint32_t bits) {
  const bool comes_back = (faults_ & kAbsent) != 0 && (bits & kAbsent) == 0;
  faults_ = bits;
  pulses_ = 0;
  if (comes_back) power_on();
}

void Bno055Model::advance(uint64_t now_us) {
  now_us_ = now_us;
  if (is_measuring()) sample();
}

// ------------------------------------------------------------------------------------------------- measuring

void Bno055Model::sample() {
  if (now_us_ >= next_inertial_us_) {
    next_inertial_us_ = now_us_ - (now_us_ - next_inertial_us_) % kInertialPeriodUs + kInertialPeriodUs;
    const bool radians = (pages_[0][kUnits] & 0x02) != 0;
    const bool milli_g = (pages_[0][kUnits] & 0x01) != 0;
    const double accel_range = 2.0 * kGravity * (1 << (pages_[1][kAccelConfig] & 0x03));
    const uint8_t gyro_code = pages_[1][kGyroConfig0] & 0x07;
    const double gyro_range = 2000.0 * kDegree / (1 << (gyro_code < 5 ? gyro_code : 4));
    double accel[3], gyro[3];
    memcpy(accel, accel_, sizeof(accel));
    memcpy(gyro, gyro_, sizeof(gyro));
    if ((faults_ & kSaturated) != 0) accel[0] = gyro[0] = 1e6;
    if ((faults_ & kImplausible) != 0) accel[0] = accel[1] = accel[2] = 0.0;
    const uint32_t stuck_accel = faults_ & (kStuckData | kStuckAccel);
    const uint32_t stuck_gyro = faults_ & (kStuckData | kStuckGyro);
    if (stuck_accel == 0) put_triple(0x08, accel, milli_g ? 1000.0 / kGravity : 100.0, accel_range);
    if (stuck_gyro == 0) put_triple(0x14, gyro, radians ? 900.0 : 16.0 / kDegree, gyro_range);
    if ((faults_ & kZeroData) != 0) {
      memset(&pages_[0][0x08], 0, 6);
      memset(&pages_[0][0x14], 0, 6);
    }
    pages_[0][kTemperature] = static_cast<uint8_t>(static_cast<int8_t>(floor(temperature_ + 0.5)));
  }
  if (now_us_ >= next_mag_us_) {
    next_mag_us_ = now_us_ - (now_us_ - next_mag_us_) % kMagPeriodUs + kMagPeriodUs;
    if ((faults_ & kStuckData) == 0) put_triple(0x0E, mag_, 16.0, kMagRangeUt);
  }
}

void Bno055Model::put_triple(uint8_t reg, const double* value, double counts_per_unit, double range) {
  for (uint8_t i = 0; i < 3; ++i) {
    const double rail = floor(range * counts_per_unit);
    double counts = floor(value[i] * counts_per_unit + dither_ * gaussian() + 0.5);
    if (counts > rail) counts = rail;
    if (counts < -rail) counts = -rail;
    const uint16_t word = static_cast<uint16_t>(static_cast<int16_t>(counts));
    pages_[0][reg + 2 * i] = static_cast<uint8_t>(word & 0xFF);
    pages_[0][reg + 2 * i + 1] = static_cast<uint8_t>(word >> 8);
  }
}

// --------------------------------------------------------------------------------------------------- the bus

bool Bno055Model::start(uint8_t address, bool read) {
  const bool answers =
      address == kAddress && (faults_ & kAbsent) == 0 && !holds_sda() && now_us_ >= boot_done_us_;
  selected_ = answers;
  pointer_next_ = !read;
  if (answers && read) memcpy(latched_, &pages_[0][kData], sizeof(latched_));
  return answers;
}

bool Bno055Model::write(uint8_t byte) {
  if (!selected_) return false;
  if (pointer_next_) {
    pointer_ = byte;
    pointer_next_ = false;
    return true;
  }
  write_register(byte);
  ++pointer_;
  return true;
}

uint8_t Bno055Model::read() {
  if (!selected_) return 0xFF;
  const uint8_t reg = pointer_++;
  uint8_t value = read_register(reg);
  if ((faults_ & kBitFlips) != 0 && reg >= kData && reg < kData + sizeof(latched_) && uniform() < 0.01) {
    value ^= 0x40;
  }
  return value;
}

void Bno055Model::stop() { selected_ = false; }

void Bno055Model::clock_pulses(uint8_t n) {
  pulses_ = static_cast<uint8_t>(pulses_ + n);
  if (pulses_ < 9) return;
  pulses_ = 0;
  faults_ &= ~static_cast<uint32_t>(kBusHung);
}

uint32_t Bno055Model::stretch_us() {
  if (uniform() >= stretch_probability_ || stretch_longest_us_ < 1000) return 0;
  return 1000 + static_cast<uint32_t>(uniform() * (stretch_longest_us_ - 1000));
}

uint8_t Bno055Model::read_register(uint8_t reg) {
  if (reg >= 128) return 0;
  if (reg == kPage) return page_;
  if (page_ == 1) return pages_[1][reg];
  if (reg >= kData && reg < kData + sizeof(latched_)) return latched_[reg - kData];
  if (reg == kMode) return mode_;
  if (reg == kSelfTest && (faults_ & kSelfTestFailed) != 0) return 0x0D;
  return pages_[0][reg];
}

// Sensor configuration, units and axis maps only take effect in CONFIG mode; the mode register always does.
void Bno055Model::write_register(uint8_t value) {
  if (pointer_ == kPage) {
    page_ = value & 0x01;
    return;
  }
  const bool in_config = mode_ == 0 && now_us_ >= mode_ready_us_;
  if (page_ == 1) {
    if (in_config && pointer_ >= 0x08 && pointer_ < 0x20) pages_[1][pointer_] = value;
    return;
  }
  if (pointer_ == kMode) {
    const uint8_t wanted = value & 0x0F;
    if (wanted == mode_) return;
    if (wanted != 0 && !in_config) return;  // from one mode to another only through CONFIG
    mode_ready_us_ = now_us_ + (wanted == 0 ? kToConfigUs : kFromConfigUs);
    mode_ = wanted;
    next_inertial_us_ = mode_ready_us_ + kFirstSampleUs;
    next_mag_us_ = mode_ready_us_ + kFirstSampleUs;
    memset(&pages_[0][kData], 0, sizeof(latched_));
  } else if (pointer_ == kTrigger) {
    if ((value & 0x20) != 0) boot(kBootUs);
  } else if (in_config && pointer_ >= kUnits && pointer_ < 0x6B) {
    pages_[0][pointer_] = value;
  }
}

// ---------------------------------------------------------------------------------------------------- chance

uint64_t Bno055Model::random() {
  chance_ = chance_ * 6364136223846793005ull + 1442695040888963407ull;
  return chance_ >> 33;
}

double Bno055Model::uniform() { return static_cast<double>(random()) * (1.0 / 2147483648.0); }

double Bno055Model::gaussian() {
  double sum = 0.0;
  for (int i = 0; i < 12; ++i) sum += uniform();
  return sum - 6.0;
}

}  // namespace tiger
