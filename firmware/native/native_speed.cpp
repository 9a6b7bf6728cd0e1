#include "native_speed.h"

#include "native_speed_api.h"

using tiger::hal_of;
using tiger::SpeedHal;

void tiger_wheel_set(tiger_board* board, uint8_t channel, double tooth_phase) {
  hal_of<SpeedHal>(board).set_phase(channel, tooth_phase);
}

void tiger_wheel_fault(tiger_board* board, uint8_t channel, uint8_t faults) {
  hal_of<SpeedHal>(board).set_faults(channel, faults);
}

void tiger_wheel_interrupt(tiger_board* board, uint8_t channel, uint8_t pins) {
  hal_of<SpeedHal>(board).interrupt(channel, pins);
}
