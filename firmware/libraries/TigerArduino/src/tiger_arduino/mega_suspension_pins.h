// Wiring of mega_suspension (Arduino Mega 2560). Corners are FL FR RL RR.
#pragma once

#include <avr/io.h>
#include <stdint.h>

namespace tiger {
namespace arduino {
namespace suspension_pins {

// Potentiometers: A0 A1 A2 A3, ratiometric from the board's 5 V.
constexpr uint8_t kPotChannel[4] = {0, 1, 2, 3};

// PWM: D11 (PB5, OC1A), D12 (PB6, OC1B), D5 (PE3, OC3A), D2 (PE4, OC3B), each with an external pull-down.
constexpr uint8_t kPwmPortB = _BV(5) | _BV(6);
constexpr uint8_t kPwmPortE = _BV(3) | _BV(4);

// Direction: D22 D23 D24 D25 (PA0-PA3); high raises the body.
constexpr uint8_t kDirectionPortA = 0x0F;

// Limit switches, normally closed to ground, so that pressed and cut read the same (high).
// Lower: D26 D27 D28 D29 (PA4-PA7). Upper: D30 D31 D32 D33 (PC7-PC4).
constexpr uint8_t kLowerPortA = 0xF0;
constexpr uint8_t kUpperPortC = 0xF0;

// Emergency stop: D3 (PE5), normally closed to ground.
constexpr uint8_t kEstopPortE = _BV(5);

// Nano: Serial1, D18 (TX1) and D19 (RX1). Host: USB.

}  // namespace suspension_pins
}  // namespace arduino
}  // namespace tiger
