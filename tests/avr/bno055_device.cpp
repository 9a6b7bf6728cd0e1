// SPDX-License-Identifier: GPL-3.0-or-later
// The BNO055 model of the native boards (firmware/native), on the simulated AVR's bus.
#include "bno055_device.h"

namespace {
constexpr uint32_t kSeed = 55;
}

Bno055Device::Bno055Device(uint8_t address) : address_(address), chip_(kSeed) {}

bool Bno055Device::start(bool is_read, uint64_t now_us) {
  chip_.advance(now_us);
  if (!is_read) stretch_us_ = chip_.stretch_us();
  return chip_.start(address_, is_read);
}

bool Bno055Device::write(uint8_t value, uint64_t now_us) {
  chip_.advance(now_us);
  return chip_.write(value);
}

uint8_t Bno055Device::read(uint64_t now_us) {
  chip_.advance(now_us);
  return chip_.read();
}

void Bno055Device::stop(uint64_t now_us) {
  chip_.advance(now_us);
  chip_.stop();
}

bool Bno055Device::holds_bus() { return chip_.holds_sda(); }
void Bno055Device::clock_pulse() { chip_.clock_pulses(1); }

uint32_t Bno055Device::take_stretch_us() {
  const uint32_t stretch_us = stretch_us_;
  stretch_us_ = 0;
  return stretch_us;
}
