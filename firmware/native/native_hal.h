// The part of the Hal that every board needs, on the PC.
#pragma once

#include <stdint.h>
#include <string.h>

#include <vector>

#include "tiger/hal.h"
#include "tiger/protocol.h"
#include "virtual_uart.h"

namespace tiger {

class NativeHal {
 public:
  static constexpr uint64_t kEepromWriteNs = 3400000;

  NativeHal(uint8_t instance, uint32_t uid, uint32_t host_baud, uint32_t eeprom_bytes)
      : host_(host_baud), instance_(instance), eeprom_(eeprom_bytes, 0xFF) {
    memcpy(eeprom_.data(), &uid, sizeof(uid));
  }

  // ------------------------------------------------------------------------- what the program calls (hal.h)

  uint32_t micros() const {
    const double own_us = static_cast<double>(now_ns_ - boot_ns_) * 1e-3 * (1.0 + ppm_ * 1e-6);
    return static_cast<uint32_t>(static_cast<uint64_t>(own_us) + clock_start_us_);
  }
  uint32_t millis() const {
    const double own_ms = static_cast<double>(now_ns_ - boot_ns_) * 1e-6 * (1.0 + ppm_ * 1e-6);
    return static_cast<uint32_t>(static_cast<uint64_t>(own_ms) + clock_start_us_ / 1000);
  }
  bool host_read(uint8_t& byte) { return host_.read(byte); }
  uint8_t host_write_space() const { return host_.write_space(now_ns_); }
  void host_write(const uint8_t* bytes, uint8_t n) { host_.write(bytes, n, now_ns_); }
  uint8_t eeprom_read(uint16_t address) const { return eeprom_[address]; }
  bool eeprom_ready() const { return now_ns_ >= eeprom_busy_until_ns_; }
  void eeprom_write(uint16_t address, uint8_t value) {
    eeprom_[address] = value;
    eeprom_address_ = address;
    eeprom_busy_until_ns_ = now_ns_ + kEepromWriteNs;
  }
  void watchdog_feed() { fed_ns_ = now_ns_; }
  uint8_t reset_cause() const { return reset_cause_; }
  FaultRecord& fault_record() { return fault_record_; }
  uint16_t ram_free_bytes() const { return 0; }  // means nothing on the PC
  uint16_t supply_mv() const { return 5000; }
  uint8_t instance() const { return instance_; }

  // ------------------------------------------------------------------ what the world and NativeBoard call

  // Time has come to `now_ns`. A board's Hal hides this, calls it, and lets its own pins follow.
  void advance(uint64_t now_ns) {
    now_ns_ = now_ns;
    host_.advance(now_ns);
  }

  // Around each run of this length: inputs that the world gives for its end move there in a straight line.
  void begin_run(uint32_t) {}
  void end_run() {}

  // A board's Hal hides this, calls it, and resets its own pins.
  void reset(uint8_t mcusr) {
    const bool lost_power = (mcusr & (kPowerOn | kBrownOut)) != 0;
    if (lost_power && !eeprom_ready()) eeprom_[eeprom_address_] = 0x5A;  // torn write
    eeprom_busy_until_ns_ = now_ns_;
    if ((mcusr & kPowerOn) != 0) memset(&fault_record_, 0x5A, sizeof(fault_record_));
    reset_cause_ = mcusr;
    boot_ns_ = now_ns_;
    fed_ns_ = now_ns_;
    host_.reset(now_ns_);
  }

  // The watchdog's interrupt. A board's Hal hides this, calls it, and switches its outputs off.
  void watchdog_interrupt() {
    fault_record_.magic = kFaultRecordMagic;
    fault_record_.fault = static_cast<uint8_t>(wire::Fault::kWatchdog);
    fault_record_.detail = 255;
  }

  VirtualUart* uart(uint8_t port) { return port == 0 ? &host_ : nullptr; }
  uint64_t now_ns() const { return now_ns_; }
  uint64_t hungry_ns() const { return now_ns_ - fed_ns_; }
  void set_clock_ppm(double ppm) { ppm_ = ppm; }
  void set_clock_start(uint32_t us) { clock_start_us_ = us; }
  std::vector<uint8_t>& eeprom() { return eeprom_; }

  static constexpr uint8_t kPowerOn = 0x01;
  static constexpr uint8_t kBrownOut = 0x04;
  static constexpr uint8_t kWatchdog = 0x08;

 protected:
  uint64_t now_ns_ = 0;
  VirtualUart host_;

 private:
  uint64_t boot_ns_ = 0;
  uint64_t fed_ns_ = 0;
  uint64_t eeprom_busy_until_ns_ = 0;
  double ppm_ = 0.0;
  uint32_t clock_start_us_ = 0;
  uint16_t eeprom_address_ = 0;
  uint8_t instance_;
  uint8_t reset_cause_ = kPowerOn;
  FaultRecord fault_record_;
  std::vector<uint8_t> eeprom_;
};

}  // namespace tiger
