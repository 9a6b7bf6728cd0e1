// Wiring of nano_imu (Arduino Nano, ATmega328P, 16 MHz).
#pragma once

#include <avr/io.h>
#include <stdint.h>

namespace tiger {
namespace arduino {
namespace imu_pins {

// BNO055: SDA on A4 (PC4), SCL on A5 (PC5), pull-ups of 2 to 5 kilohm on the sensor's board.
constexpr uint8_t kSdaPortC = _BV(4);
constexpr uint8_t kSclPortC = _BV(5);

// Mega: D0 (RX) and D1 (TX), the pins the USB adapter uses too: unplug D0 before flashing.

}  // namespace imu_pins
}  // namespace arduino
}  // namespace tiger
