// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <stdint.h>

#include "bno055_model.h"
#include "twi_device.h"

class Bno055Device : public TwiDevice {
 public:
  explicit Bno055Device(uint8_t address);

  bool start(bool is_read, uint64_t now_us) override;
  bool write(uint8_t value, uint64_t now_us) override;
  uint8_t read(uint64_t now_us) override;
  void stop(uint64_t now_us) override;
  bool holds_bus() override;
  void clock_pulse() override;
  uint32_t take_stretch_us() override;

  tiger::Bno055Model& chip() { return chip_; }

 private:
  uint8_t address_;
  tiger::Bno055Model chip_;
  uint32_t stretch_us_ = 0;
};
