// Pins of mega_speed: channel 0 is the front wheel of its side, 1 the rear one.
#pragma once

#include <stdint.h>

#include "tiger_native.h"

#ifdef __cplusplus
extern "C" {
#endif

// Turn of the gear in teeth as it will be at the end of the next run: in between it moves in a straight line, and each
// quarter tooth gives an edge at its time. The first call only says where the gear stands.
void tiger_wheel_set(tiger_board* board, uint8_t channel, double tooth_phase);

// Faults of the sensor that are on: 1 signal A dead, 2 signal B dead, 4 A and B swapped.
void tiger_wheel_fault(tiger_board* board, uint8_t channel, uint8_t faults);

// The edge interrupt with these pins (A in bit 0, B in bit 1), now: for edges that no gear makes.
void tiger_wheel_interrupt(tiger_board* board, uint8_t channel, uint8_t pins);

#ifdef __cplusplus
}
#endif
