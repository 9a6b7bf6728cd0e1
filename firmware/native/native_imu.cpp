#include "native_imu.h"

#include "native_imu_api.h"

using tiger::hal_of;
using tiger::ImuHal;

void tiger_imu_set(tiger_board* board, const double accel_mps2[3], const double gyro_radps[3],
                   const double mag_ut[3], double temperature_celsius) {
  hal_of<ImuHal>(board).chip().set_motion(accel_mps2, gyro_radps, mag_ut, temperature_celsius);
}

void tiger_imu_fault(tiger_board* board, uint32_t faults) { hal_of<ImuHal>(board).chip().set_faults(faults); }
uint32_t tiger_imu_faults(tiger_board* board) { return hal_of<ImuHal>(board).chip().faults(); }
uint8_t tiger_imu_register(tiger_board* board, uint8_t page, uint8_t reg) {
  return hal_of<ImuHal>(board).chip().register_value(page, reg);
}
void tiger_imu_power_cycle(tiger_board* board) { hal_of<ImuHal>(board).chip().power_on(); }

void tiger_imu_dither(tiger_board* board, double counts_rms) {
  hal_of<ImuHal>(board).chip().set_dither(counts_rms);
}

void tiger_imu_stretch(tiger_board* board, double probability, uint32_t longest_us) {
  hal_of<ImuHal>(board).chip().set_stretch(probability, longest_us);
}
