// Pins of nano_imu: the BNO055 on its two-wire bus.
#pragma once

#include <stdint.h>

#include "tiger_native.h"

#ifdef __cplusplus
extern "C" {
#endif

// What the sensor feels, in its own axes; holds until the next call. At rest the accelerometer shows +g upwards.
void tiger_imu_set(tiger_board* board, const double accel_mps2[3], const double gyro_radps[3],
                   const double mag_ut[3], double temperature_celsius);

// Faults of the chip that are on, as bits of Bno055Model::FaultBit: 1 absent, 2 bus hung, 4 bus shorted, 8 zero
// data, 16 stuck data, 32 saturated, 64 self-test failed, 128 bit flips, 256 free fall, 512 accelerometer stuck, 1024
// gyroscope stuck. A hung bus frees itself at nine clocks.
void tiger_imu_fault(tiger_board* board, uint32_t faults);
uint32_t tiger_imu_faults(tiger_board* board);

// What a register of the chip holds, on page 0 or 1.
uint8_t tiger_imu_register(tiger_board* board, uint8_t page, uint8_t reg);

// The chip alone loses its supply for a moment.
void tiger_imu_power_cycle(tiger_board* board);

// Noise of the output registers in counts, 1 unless told: a real chip never repeats itself.
void tiger_imu_dither(tiger_board* board, double counts_rms);

// Clock stretching: how often per transaction, 0..1, and how long at most; 0.02 and 6000 us unless told.
void tiger_imu_stretch(tiger_board* board, double probability, uint32_t longest_us);

#ifdef __cplusplus
}
#endif
