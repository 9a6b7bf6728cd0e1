// The part of the Hal that is the same on every board; see tiger/hal.h for what each function promises.
#pragma once

#include <avr/interrupt.h>
#include <avr/wdt.h>
#include <stdint.h>
#include <tiger/hal.h>

#include "clock.h"
#include "eeprom.h"
#include "reset.h"
#include "uart.h"

namespace tiger {
namespace arduino {

constexpr uint16_t kHostReceiveBytes = 128;
constexpr uint16_t kHostSendBytes = 256;

static Clock board_clock;

class HalCommon {
 public:
  // First thing in a turn of the main loop: one cycle, by which the simulator measures turns.
  void mark_turn() { GPIOR0 = 0; }

  uint32_t micros() { return board_clock.micros(); }
  uint32_t millis() { return board_clock.millis(); }

  uint8_t eeprom_read(uint16_t address) { return Eeprom::read(address); }
  bool eeprom_ready() { return Eeprom::ready(); }
  void eeprom_write(uint16_t address, uint8_t value) { Eeprom::write(address, value); }

  void watchdog_feed() {
    wdt_reset();
    board_clock.millis();
  }
  uint8_t reset_cause() { return saved_mcusr; }
  FaultRecord& fault_record() { return arduino::fault_record; }
  uint16_t ram_free_bytes() { return stack_.free_bytes(); }

 protected:
  // Last thing in a board's begin(): the first look at the stack takes some milliseconds.
  void start_watching() {
    stack_.free_bytes();
    watchdog_start();
  }

 private:
  StackMargin stack_;
};

}  // namespace arduino
}  // namespace tiger

ISR(TIGER_CLOCK_OVERFLOW_vect) { tiger::arduino::board_clock.on_overflow(); }
