// Pins of mega_suspension, corners FL FR RL RR.
#pragma once

#include <stdint.h>

#include "tiger_native.h"

#ifdef __cplusplus
extern "C" {
#endif

// Potentiometers in ADC counts (0..1023, fractions allowed) as they will be at the end of the next run: in between they
// move in a straight line. Switches: bit n = corner n pressed.
void tiger_suspension_set(tiger_board* board, const double adc_counts[4], uint8_t lower, uint8_t upper,
                          uint8_t estop);

// Noise of one conversion, root mean square; 0.5 counts unless told.
void tiger_suspension_noise(tiger_board* board, double rms_counts);

// Signed duty, -1..1, positive raises the body; 0 when the outputs are off.
void tiger_suspension_drive(tiger_board* board, double duty[4]);

#ifdef __cplusplus
}
#endif
