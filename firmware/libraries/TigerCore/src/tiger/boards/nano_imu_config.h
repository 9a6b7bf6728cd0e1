// The numbers of nano_imu that are nobody else's.
#pragma once

#include <stdint.h>

#include "../fusion/attitude_filter.h"
#include "../fusion/flash.h"

namespace tiger {
namespace nano_imu_config {

constexpr uint32_t kTickUs = 10000;  // a sample and two messages: 28 % of the line to the Mega
constexpr float kTickS = 0.01f;
constexpr uint32_t kLateUs = 15000;          // no sample for so long: the old one is sent again, marked stale
constexpr uint32_t kBridgeUs = 50000;        // a longer gap is not integrated over
constexpr uint16_t kSettleSamples = 200;     // the average starts as a plain mean: two seconds of it will do
constexpr float kRestRateRadps = 0.0035f;    // 0.2 degrees/s: a calibrated gyroscope drifts less
constexpr float kAngularAccelTauS = 0.015f;  // corner 15 Hz: 0.07 rad/s2 of noise, 15 ms of delay

constexpr fusion::AttitudeGains kAttitude TIGER_FLASH = fusion::attitude_gains(fusion::AttitudeTuning());
constexpr fusion::LowPassGains kAngularAccel TIGER_FLASH = fusion::low_pass_gains(kAngularAccelTauS, kTickS);

}  // namespace nano_imu_config
}  // namespace tiger
