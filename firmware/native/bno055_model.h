// BNO055 inertial sensor, register for register, as far as raw measuring (AMG) uses it.
//
// Plain C++ without dependencies: the native Nano talks to it in whole transactions, a simulated AVR byte by
// byte. Time passes in advance(). Source: data sheet BST-BNO055-DS000: register map (section 4), page selection,
// boot 650 ms after reset, mode switch 19 ms to CONFIG and 7 ms from it, output units (3.6.1), ranges (3.5).
// What is not modelled: the chip's own fusion, interrupts, low-power modes.
#pragma once

#include <stdint.h>

namespace tiger {

class Bno055Model {
 public:
  enum FaultBit : uint32_t {
    kAbsent = 1u << 0,      // no supply or a cut wire: nothing is acknowledged
    kBusHung = 1u << 1,     // holds SDA low until it has seen nine clocks
    kBusShorted = 1u << 2,  // SDA stays low whatever happens
    kZeroData = 1u << 3,    // accelerometer and gyroscope read zero
    kStuckData = 1u << 4,   // registers keep their values
    kSaturated = 1u << 5,   // accelerometer x and gyroscope x at the end of their range
    kSelfTestFailed = 1u << 6,
    kBitFlips = 1u << 7,     // now and then the top bits of a byte are wrong
    kImplausible = 1u << 8,  // the accelerometer shows free fall
    kStuckAccel = 1u << 9,
    kStuckGyro = 1u << 10,
  };

  explicit Bno055Model(uint32_t seed);

  // ---- the world

  // True values in the chip's axes; they hold until the next call.
  void set_motion(const double accel_mps2[3], const double gyro_radps[3], const double mag_ut[3],
                  double temperature_celsius);
  // Noise added before rounding, in counts of the output registers: a real chip never repeats itself. 1 at first.
  void set_dither(double counts_rms) { dither_ = counts_rms; }
  void set_faults(uint32_t bits);
  uint32_t faults() const { return faults_; }
  // How often the clock is stretched (per transaction) and for how long at most; 2 % and 6 ms at first.
  void set_stretch(double probability, uint32_t longest_us) {
    stretch_probability_ = probability;
    stretch_longest_us_ = longest_us;
  }
  void advance(uint64_t now_us);
  void power_on();  // the supply comes back, or the reset pin was pulled: all registers are lost
  uint8_t register_value(uint8_t page, uint8_t reg) const {
    return page == 0 && reg == 0x3D ? mode_ : pages_[page & 1][reg & 0x7F];
  }
  bool is_measuring() const { return mode_ == 0x07 && now_us_ >= mode_ready_us_; }

  // ---- the two-wire bus, one byte at a time

  bool start(uint8_t address, bool read);  // address without the read bit; true: acknowledged
  bool write(uint8_t byte);                // true: acknowledged
  uint8_t read();
  void stop();
  bool holds_sda() const { return (faults_ & (kBusHung | kBusShorted)) != 0; }
  void clock_pulses(uint8_t n);  // from a master that finds SDA held low
  uint32_t stretch_us();         // how long the chip holds SCL in the transaction that begins now

 private:
  static constexpr uint8_t kAddress = 0x28;

  void boot(uint64_t takes_us);
  void sample();
  void write_register(uint8_t value);
  uint8_t read_register(uint8_t reg);
  void put_triple(uint8_t reg, const double* value, double counts_per_unit, double range);
  uint64_t random();
  double uniform();  // 0..1
  double gaussian();

  uint64_t now_us_ = 0;
  uint64_t boot_done_us_ = 0;
  uint64_t mode_ready_us_ = 0;
  uint64_t next_inertial_us_ = 0;
  uint64_t next_mag_us_ = 0;
  uint64_t chance_;
  double accel_[3] = {0.0, 0.0, 9.80665};
  double gyro_[3] = {};
  double mag_[3] = {0.0, 20.0, -45.0};
  double temperature_ = 25.0;
  double dither_ = 1.0;
  double stretch_probability_ = 0.02;
  uint32_t stretch_longest_us_ = 6000;
  uint32_t faults_ = 0;
  uint8_t page_ = 0;
  uint8_t pages_[2][128];
  uint8_t latched_[18];  // a burst reads one sample, never half of two
  uint8_t mode_ = 0;
  uint8_t pointer_ = 0;
  uint8_t pulses_ = 0;
  bool pointer_next_ = false;
  bool selected_ = false;
};

}  // namespace tiger
