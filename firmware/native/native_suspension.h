// The Hal of mega_suspension on the PC.
#pragma once

#include <math.h>
#include <stdint.h>

#include "native_board.h"
#include "tiger/boards/mega_suspension.h"

namespace tiger {

class SuspensionHal : public NativeHal {
 public:
  static constexpr uint64_t kConversionNs = 104000;  // 13 cycles of a 125 kHz ADC clock

  SuspensionHal(uint8_t instance, uint32_t uid)
      : NativeHal(instance, uid, wire::kBaudSuspensionUsb, 4096),
        peer_(wire::kBaudNanoSerial),
        chance_(uid) {}

  // ------------------------------------------------------------------------- what the program calls (hal.h)

  bool pots_read(uint16_t sums[kCorners]) {
    if (!has_sums_) return false;
    memcpy(sums, sums_, sizeof(sums_));
    has_sums_ = false;
    return true;
  }
  void drive(uint8_t corner, int16_t duty_permille) { duty_permille_[corner] = duty_permille; }
  void outputs_off() { memset(duty_permille_, 0, sizeof(duty_permille_)); }
  uint8_t lower_switches() const { return lower_; }
  uint8_t upper_switches() const { return upper_; }
  bool estop_pressed() const { return estop_; }
  bool peer_read(uint8_t& byte) { return peer_.read(byte); }
  uint8_t peer_write_space() const { return peer_.write_space(now_ns_); }
  void peer_write(const uint8_t* bytes, uint8_t n) { peer_.write(bytes, n, now_ns_); }

  // ------------------------------------------------------------------ what the world and NativeBoard call

  void advance(uint64_t now_ns) {
    NativeHal::advance(now_ns);
    peer_.advance(now_ns);
    convert();
  }

  void reset(uint8_t mcusr) {
    NativeHal::reset(mcusr);
    peer_.reset(now_ns_);
    outputs_off();
    has_sums_ = false;
    conversions_ = 0;
    memset(running_, 0, sizeof(running_));
    next_conversion_ns_ = now_ns_ + kConversionNs;
  }

  void watchdog_interrupt() {
    NativeHal::watchdog_interrupt();
    outputs_off();
  }

  VirtualUart* uart(uint8_t port) { return port == 1 ? &peer_ : NativeHal::uart(port); }

  void set_inputs(const double adc_counts[kCorners], uint8_t lower, uint8_t upper, bool estop) {
    memcpy(target_, adc_counts, sizeof(target_));
    if (!has_inputs_) memcpy(level_, adc_counts, sizeof(level_));
    has_inputs_ = true;
    lower_ = lower;
    upper_ = upper;
    estop_ = estop;
  }
  void set_noise(double rms_counts) { noise_counts_ = rms_counts; }
  double duty(uint8_t corner) const { return duty_permille_[corner] / 1000.0; }

  void begin_run(uint32_t us) {
    for (uint8_t i = 0; i < kCorners; ++i) {
      slope_[i] = us != 0 ? (target_[i] - level_[i]) / (1000.0 * us) : 0.0;
    }
    level_at_ns_ = now_ns_;
  }
  void end_run() {
    memcpy(level_, target_, sizeof(level_));
    memset(slope_, 0, sizeof(slope_));
    level_at_ns_ = now_ns_;
  }

 private:
  // Free-running ADC: the four channels in turn, sixteen sweeps to a set.
  void convert() {
    for (; next_conversion_ns_ <= now_ns_; next_conversion_ns_ += kConversionNs) {
      const uint8_t corner = conversions_ % kCorners;
      const double since_ns = static_cast<double>(next_conversion_ns_) - static_cast<double>(level_at_ns_);
      const double level = level_[corner] + slope_[corner] * since_ns;
      const double read = floor(level + noise_counts_ * gaussian() + 0.5);
      running_[corner] = static_cast<uint16_t>(running_[corner] + (read < 0 ? 0 : read > 1023 ? 1023 : read));
      if (++conversions_ < kCorners * kConversionsPerSum) continue;
      memcpy(sums_, running_, sizeof(sums_));
      memset(running_, 0, sizeof(running_));
      conversions_ = 0;
      has_sums_ = true;
    }
  }

  // Sum of four uniform numbers: near enough to a bell, repeatable on every machine.
  double gaussian() {
    double sum = 0.0;
    for (int i = 0; i < 4; ++i) {
      chance_ = chance_ * 6364136223846793005ull + 1442695040888963407ull;
      sum += static_cast<double>(chance_ >> 40) * (1.0 / 16777216.0) - 0.5;
    }
    return sum * 1.7320508075688772;
  }

  VirtualUart peer_;
  double level_[kCorners] = {512, 512, 512, 512};
  double target_[kCorners] = {512, 512, 512, 512};
  double slope_[kCorners] = {};
  double noise_counts_ = 0.5;
  uint64_t level_at_ns_ = 0;
  uint64_t next_conversion_ns_ = kConversionNs;
  uint64_t chance_;
  int16_t duty_permille_[kCorners] = {};
  uint16_t running_[kCorners] = {};
  uint16_t sums_[kCorners] = {};
  uint8_t conversions_ = 0;
  uint8_t lower_ = 0;
  uint8_t upper_ = 0;
  bool estop_ = false;
  bool has_sums_ = false;
  bool has_inputs_ = false;
};

inline tiger_board* new_suspension(uint8_t instance, uint32_t uid) {
  return new NativeBoard<SuspensionHal, MegaSuspension>(instance, uid);
}

}  // namespace tiger
