// Whole-number arithmetic of the stroke control.
//
// Rates are int16 in um/s. Lengths are int32 in units of 10 nm: what 1 um/s covers in one control tick of 10 ms, so that
// integrating a rate is a bare addition. Gains are Q16 fractions or powers of two. No division on the way.
#pragma once

#include <stdint.h>

namespace tiger {

constexpr uint32_t kControlPeriodUs = 10000;
constexpr int32_t kUnitsPerMm = 100000;      // 10 nm
constexpr int32_t kUnitsPerWireCount = 200;  // wire::...::stroke_mm counts 2 um
constexpr uint8_t kLagTicks = 5;             // first-order lag of an actuator, 50 ms

// A fraction of one as Q16, rounded; for constants.
constexpr uint16_t q16(double fraction) { return static_cast<uint16_t>(fraction * 65536.0 + 0.5); }

// exp(-T/lag) = exp(-0.2): what is left of a rate after one tick.
constexpr double kLagDecay = 0.8187307530779818;
constexpr uint16_t kLagShare = q16(1.0 - kLagDecay);  // share of the way to the drive's rate in one tick
constexpr uint16_t kLagTravel =
    q16(1.0 - kLagTicks * (1.0 - kLagDecay));  // of the difference, already travelled in it

inline int16_t saturate16(int32_t x) {
  return static_cast<int16_t>(x > INT16_MAX ? INT16_MAX : x < -INT16_MAX ? -INT16_MAX : x);
}

inline int16_t clamp16(int16_t x, int16_t limit) {
  return x > limit ? limit : x < -limit ? static_cast<int16_t>(-limit) : x;
}

inline int32_t clamp32(int32_t x, int32_t limit) { return x > limit ? limit : x < -limit ? -limit : x; }

// What x exceeds a dead zone by.
inline int16_t beyond(int16_t x, int16_t zone) { return static_cast<int16_t>(x - clamp16(x, zone)); }

inline int32_t magnitude(int32_t x) { return x < 0 ? -x : x; }

// x times a Q16 fraction, rounded to nearest.
inline int16_t scale(int16_t x, uint16_t fraction) {
  return static_cast<int16_t>((static_cast<int32_t>(x) * fraction + 0x8000) >> 16);
}

// Difference of two rates as int16.
inline int16_t minus(int16_t a, int16_t b) { return saturate16(static_cast<int32_t>(a) - b); }

}  // namespace tiger
