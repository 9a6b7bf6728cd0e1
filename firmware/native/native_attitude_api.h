// The attitude filter of TigerCore for the host: the same code as on the Nano, with the wheels to help it.
#pragma once

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct tiger_attitude tiger_attitude;

typedef struct {
  float tick_s;         // nominal time between two samples
  float mag_period_s;   // between two new magnetometer samples
  uint32_t slow_every;  // ticks between two corrections: a multiple of four (the Nano: 4), or 1
  float accel_tau_s;    // of the accelerometer's averaging
  float mag_tau_s;      // of the heading's correction
  float bias_sigma_init_radps;
  float bias_sigma_motion_radps;
  float bias_sigma_rest_radps;
} tiger_attitude_tuning;

enum { TIGER_WHEELS_NONE = 0, TIGER_WHEELS_GRIP = 1, TIGER_WHEELS_SLIP = 2 };

typedef struct {
  float gyro_radps[3];
  float accel_mps2[3];
  float mag_ut[3];
  float speed_mps;       // forward speed of the body by its wheels
  float dt_s;            // since the sample before; 0 after a gap too long to bridge
  uint8_t wheels;        // TIGER_WHEELS_...: what speed_mps is worth
  uint8_t has_mag;       // mag_ut is new
  uint8_t accel_usable;  // 0: skip accel_mps2
  uint8_t follows_gap;   // samples are missing before this one
} tiger_attitude_sample;

typedef struct {
  float quaternion[4];        // w x y z, body to east-north-up
  float level_quaternion[4];  // the same without the magnetometer: its heading drifts
  float rate_radps[3];        // bias removed
  float bias_radps[3];
  uint8_t resting;
  uint8_t disturbed;  // magnetically
} tiger_attitude_state;

// The tuning of the Nano.
void tiger_attitude_defaults(tiger_attitude_tuning* tuning);
tiger_attitude* tiger_attitude_new(const tiger_attitude_tuning* tuning);
void tiger_attitude_free(tiger_attitude* filter);
void tiger_attitude_start_bias(tiger_attitude* filter, const float bias_radps[3]);

// Takes in n samples one after the other and gives the state after each.
void tiger_attitude_run(tiger_attitude* filter, uint32_t n, const tiger_attitude_sample* samples,
                        tiger_attitude_state* states);

#ifdef __cplusplus
}
#endif
