// The Hal of nano_imu on the PC: a two-wire bus with a BNO055 on it.
#pragma once

#include <stdint.h>
#include <string.h>

#include "bno055_model.h"
#include "native_board.h"
#include "tiger/boards/nano_imu.h"

namespace tiger {

class ImuHal : public NativeHal {
 public:
  static constexpr uint64_t kBusByteNs = 22500;  // nine bits at 400 kHz

  ImuHal(uint8_t instance, uint32_t uid)
      : NativeHal(instance, uid, wire::kBaudNanoSerial, 1024), chip_(uid) {}

  // ------------------------------------------------------------------------- what the program calls (hal.h)

  bool twi_start(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in) {
    if (status_ == TwiStatus::Busy || n_out > kTwiMaxOut || n_in > kTwiMaxIn) return false;
    status_ = TwiStatus::Busy;
    if (chip_.holds_sda()) {
      done_ns_ = UINT64_MAX;  // the start condition never gets through
      return true;
    }
    outcome_ = transact(address, out, n_out, n_in);
    const unsigned bytes = outcome_ == TwiStatus::Done ? 1u + n_out + (n_in != 0 ? 1u + n_in : 0u) : 1u;
    const uint64_t stretch_us = outcome_ == TwiStatus::Done ? chip_.stretch_us() : 0;
    done_ns_ = now_ns_ + bytes * kBusByteNs + stretch_us * 1000;
    return true;
  }
  TwiStatus twi_status() const { return status_; }
  const uint8_t* twi_data() const { return in_; }
  void twi_reset() {
    chip_.stop();
    chip_.clock_pulses(9);
    status_ = TwiStatus::Idle;
  }

  // ------------------------------------------------------------------ what the world and NativeBoard call

  void advance(uint64_t now_ns) {
    NativeHal::advance(now_ns);
    chip_.advance(now_ns / 1000);
    if (status_ != TwiStatus::Busy) return;
    if (chip_.holds_sda()) done_ns_ = UINT64_MAX;  // hung in the middle
    if (now_ns >= done_ns_) status_ = outcome_;
  }

  void reset(uint8_t mcusr) {
    NativeHal::reset(mcusr);
    if ((mcusr & (kPowerOn | kBrownOut)) != 0) chip_.power_on();  // one supply feeds both
    status_ = TwiStatus::Idle;
  }

  Bno055Model& chip() { return chip_; }

 private:
  TwiStatus transact(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in) {
    if (!chip_.start(address, false)) return TwiStatus::AddressNack;
    for (uint8_t i = 0; i < n_out; ++i) {
      if (!chip_.write(out[i])) return TwiStatus::DataNack;
    }
    if (n_in != 0 && !chip_.start(address, true)) return TwiStatus::AddressNack;
    for (uint8_t i = 0; i < n_in; ++i) in_[i] = chip_.read();
    chip_.stop();
    return TwiStatus::Done;
  }

  Bno055Model chip_;
  uint8_t in_[kTwiMaxIn] = {};
  uint64_t done_ns_ = 0;
  TwiStatus status_ = TwiStatus::Idle;
  TwiStatus outcome_ = TwiStatus::Idle;
};

inline tiger_board* new_imu(uint8_t instance, uint32_t uid) {
  return new NativeBoard<ImuHal, NanoImu>(instance, uid);
}

}  // namespace tiger
