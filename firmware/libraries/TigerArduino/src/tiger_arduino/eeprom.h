// EEPROM a byte at a time: a write is started and runs by itself for 3.4 ms.
#pragma once

#include <avr/io.h>
#include <stdint.h>
#include <util/atomic.h>

namespace tiger {
namespace arduino {

class Eeprom {
 public:
  static bool ready() { return !(EECR & _BV(EEPE)); }

  static uint8_t read(uint16_t address) {
    while (!ready()) {
    }
    EEAR = address;
    EECR |= _BV(EERE);
    return EEDR;
  }

  // The caller has checked ready().
  static void write(uint16_t address, uint8_t value) {
    EEAR = address;
    EEDR = value;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {  // the chip allows four cycles between the two bits
      EECR |= _BV(EEMPE);
      EECR |= _BV(EEPE);
    }
  }
};

}  // namespace arduino
}  // namespace tiger
