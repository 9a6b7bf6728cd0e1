#include "native_suspension.h"

#include "native_suspension_api.h"

using tiger::hal_of;
using tiger::SuspensionHal;

void tiger_suspension_set(tiger_board* board, const double adc_counts[4], uint8_t lower, uint8_t upper,
                          uint8_t estop) {
  hal_of<SuspensionHal>(board).set_inputs(adc_counts, lower, upper, estop != 0);
}

void tiger_suspension_noise(tiger_board* board, double rms_counts) {
  hal_of<SuspensionHal>(board).set_noise(rms_counts);
}

void tiger_suspension_drive(tiger_board* board, double duty[4]) {
  for (uint8_t corner = 0; corner < tiger::kCorners; ++corner) {
    duty[corner] = hal_of<SuspensionHal>(board).duty(corner);
  }
}
