// SPDX-License-Identifier: GPL-3.0-or-later
// A chip on the simulated two-wire bus.
#pragma once

#include <stdint.h>

#include <memory>

class TwiDevice {
 public:
  virtual ~TwiDevice() = default;
  virtual bool start(bool is_read, uint64_t now_us) = 0;      // addressed; false: does not acknowledge
  virtual bool write(uint8_t value, uint64_t now_us) = 0;     // a byte from the master; false: refused
  virtual uint8_t read(uint64_t now_us) = 0;                  // a byte to the master
  virtual void stop(uint64_t now_us) { (void)now_us; }        // the transaction ended
  virtual uint32_t take_stretch_us() { return 0; }            // clock held low from now on
};

// 256 bytes behind a register pointer.
class RegisterFile : public TwiDevice {
 public:
  uint8_t registers[256] = {};

  bool start(bool is_read, uint64_t) override {
    expects_pointer_ = !is_read;
    return true;
  }
  bool write(uint8_t value, uint64_t) override {
    if (expects_pointer_) {
      pointer_ = value;
      expects_pointer_ = false;
    } else {
      registers[pointer_++] = value;
    }
    return true;
  }
  uint8_t read(uint64_t) override { return registers[pointer_++]; }

 private:
  uint8_t pointer_ = 0;
  bool expects_pointer_ = false;
};

std::unique_ptr<TwiDevice> make_bno055();
