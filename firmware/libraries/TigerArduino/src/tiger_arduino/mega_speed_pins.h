// Wiring of mega_speed (Arduino Mega 2560): one board a side, two wheel sensors each, with 5 V pull-ups.
#pragma once

#include <avr/io.h>
#include <stdint.h>

namespace tiger {
namespace arduino {
namespace speed_pins {

// Front wheel: A on D2 (PE4, INT4), B on D3 (PE5, INT5). Rear wheel: A on D18 (PD3, INT3), B on D19 (PD2, INT2).
// A leads B when the wheel turns forwards; swap the two wires where it does not.
constexpr uint8_t kFrontShiftPortE = 4;
constexpr uint8_t kRearShiftPortD = 2;

// Side strap: D30 (PC7). Open: left board; to ground: right board.
constexpr uint8_t kStrapPortC = _BV(7);

// Host: USB.

}  // namespace speed_pins
}  // namespace arduino
}  // namespace tiger
