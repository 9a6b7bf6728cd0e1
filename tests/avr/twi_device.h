// SPDX-License-Identifier: GPL-3.0-or-later
// A chip on the simulated two-wire bus.
#pragma once

#include <stdint.h>

class TwiDevice {
 public:
  virtual ~TwiDevice() = default;
  virtual bool start(bool is_read, uint64_t now_us) = 0;   // addressed; false: does not acknowledge
  virtual bool write(uint8_t value, uint64_t now_us) = 0;  // a byte from the master; false: refused
  virtual uint8_t read(uint64_t now_us) = 0;               // a byte to the master
  virtual void stop(uint64_t now_us) = 0;                  // the transaction ended
  virtual bool holds_bus() = 0;                            // SDA is kept low: nothing gets through
  virtual void clock_pulse() = 0;                          // the master clocks by hand to free the bus
  virtual uint32_t take_stretch_us() = 0;                  // SCL is kept low from now on for so long
};
