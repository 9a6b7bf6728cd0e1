// Two-wire master at 400 kHz, one transaction at a time, run by its interrupt: nothing waits for the bus, so a
// chip may stretch the clock as long as it likes and the caller decides when its patience ends.
#pragma once

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdint.h>
#include <tiger/hal.h>
#include <util/delay_basic.h>

#include "nano_imu_pins.h"

namespace tiger {
namespace arduino {

class TwiMaster {
 public:
  void begin() {
    status_ = TwiStatus::Idle;
    PORTC &= static_cast<uint8_t>(~(imu_pins::kSdaPortC | imu_pins::kSclPortC));  // pull-ups are outside
    DDRC &= static_cast<uint8_t>(~(imu_pins::kSdaPortC | imu_pins::kSclPortC));
    TWSR = 0;
    TWBR = (F_CPU / 400000UL - 16) / 2;
    TWCR = _BV(TWEN);
  }

  bool start(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in) {
    if (status_ == TwiStatus::Busy || n_out > kTwiMaxOut || n_in > kTwiMaxIn) return false;
    if (TWCR & _BV(TWSTO)) return false;  // the stop of the last transaction is still on the wire
    address_ = static_cast<uint8_t>(address << 1);
    for (uint8_t i = 0; i < n_out; ++i) out_[i] = out[i];
    n_out_ = n_out;
    n_in_ = n_in;
    sent_ = 0;
    received_ = 0;
    status_ = TwiStatus::Busy;
    TWCR = kGo | _BV(TWSTA);
    return true;
  }

  TwiStatus status() const { return status_; }
  const uint8_t* data() const { return in_; }

  // Frees a bus on which a chip hangs in the middle of a byte: nine clocks let it finish, a stop ends it.
  void reset() {
    TWCR = 0;
    const uint8_t sda = imu_pins::kSdaPortC;
    const uint8_t scl = imu_pins::kSclPortC;
    for (uint8_t clock = 0; clock < 9; ++clock) {
      pull(scl);
      half_period();
      release(scl);
      half_period();
    }
    pull(scl);
    pull(sda);
    half_period();
    release(scl);
    half_period();
    release(sda);
    begin();
  }

  // Budget 130 cycles, once a byte.
  __attribute__((always_inline)) void on_event() {
    switch (TWSR & 0xF8) {
      case 0x08:  // start sent
      case 0x10:  // repeated start sent
        TWDR = static_cast<uint8_t>(address_ | ((sent_ == n_out_ && n_in_ != 0) ? 1 : 0));
        TWCR = kGo;
        break;
      case 0x18:  // address taken for writing
      case 0x28:  // byte taken
        if (sent_ < n_out_) {
          TWDR = out_[sent_];
          sent_ = static_cast<uint8_t>(sent_ + 1);
          TWCR = kGo;
        } else if (n_in_ != 0) {
          TWCR = kGo | _BV(TWSTA);
        } else {
          finish(TwiStatus::Done);
        }
        break;
      case 0x50:  // byte received and acknowledged
        in_[received_] = TWDR;
        received_ = static_cast<uint8_t>(received_ + 1);
        // fall through
      case 0x40:  // address taken for reading
        TWCR = static_cast<uint8_t>(received_ + 1 < n_in_ ? kGo | _BV(TWEA) : kGo);
        break;
      case 0x58:  // last byte received
        in_[received_] = TWDR;
        finish(TwiStatus::Done);
        break;
      case 0x20:  // address refused
      case 0x48:
        finish(TwiStatus::AddressNack);
        break;
      case 0x30:  // byte refused
        finish(TwiStatus::DataNack);
        break;
      default:  // arbitration lost, illegal start or stop
        finish(TwiStatus::BusError);
        break;
    }
  }

 private:
  static constexpr uint8_t kGo = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);

  __attribute__((always_inline)) void finish(TwiStatus status) {
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    status_ = status;
  }

  static void pull(uint8_t pin) { DDRC |= pin; }  // the port bit is 0: output means low
  static void release(uint8_t pin) { DDRC &= static_cast<uint8_t>(~pin); }
  static void half_period() { _delay_loop_1(F_CPU / 800000UL / 3); }

  volatile TwiStatus status_;
  uint8_t address_;
  uint8_t n_out_;
  uint8_t n_in_;
  volatile uint8_t sent_;
  volatile uint8_t received_;
  uint8_t out_[kTwiMaxOut];
  uint8_t in_[kTwiMaxIn];
};

}  // namespace arduino
}  // namespace tiger
