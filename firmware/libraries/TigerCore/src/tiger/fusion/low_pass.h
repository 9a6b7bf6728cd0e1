// Second-order Butterworth low-pass for several channels, in state-variable form.
//
// The state-variable form keeps its accuracy in single precision when the corner lies at a thousandth of the
// sample rate, where a direct form loses its poles to rounding. Its band-pass state times the corner is the
// derivative of the output, which the angular acceleration uses. Until one time constant of samples has come
// in, the output is their mean, so that the filter starts settled.
#pragma once

#include <stdint.h>

#include "flash.h"
#include "rotation.h"

namespace tiger {
namespace fusion {

struct LowPassGains {
  float damping;    // 1 / (1 + g (g + sqrt 2))
  float rise;       // g damping
  float g;          // tan(pi f_corner period)
  uint16_t warmup;  // samples in one time constant
};

namespace detail {
constexpr float series_tan(float x) { return x * (1.0f + x * x * (1.0f / 3.0f + x * x * (2.0f / 15.0f))); }
constexpr LowPassGains gains_of(float g, uint16_t warmup) {
  return LowPassGains{1.0f / (1.0f + g * (g + 1.41421356f)), g / (1.0f + g * (g + 1.41421356f)), g, warmup};
}
}  // namespace detail

// The corner sits at sqrt(2) / (2 pi tau), which makes the step response settle about as fast as that of a
// first-order filter of time constant tau. The tangent is its series, good to 0.1 % for period < 0.7 tau.
constexpr LowPassGains low_pass_gains(float tau_s, float period_s) {
  return detail::gains_of(detail::series_tan(period_s / (1.41421356f * tau_s)),
                          static_cast<uint16_t>(tau_s / period_s));
}

template <uint8_t N>
class LowPass {
 public:
  void reset() { count_ = 0; }

  // The output, half a period ahead: for those who do not mind, and need not keep a copy.
  float ahead(uint8_t i) const { return value_[i]; }

  // `out` may be `in`. `steps`, where given, receives half of what the output changes by in a period: its
  // derivative is that times 2 / period.
  TIGER_OUTLINE void update(const LowPassGains& stored, const float* in, float* out, float* steps = nullptr) {
    const LowPassGains gains = load(stored);
    if (count_ < gains.warmup) {
      average(in, out);
      for (uint8_t i = 0; steps != nullptr && i < N; i++) steps[i] = 0.0f;
      return;
    }
    for (uint8_t i = 0; i < N; i++) {
      const float slope = gains.damping * slope_[i] + gains.rise * (in[i] - value_[i]);
      const float step = gains.g * slope;
      if (steps != nullptr) steps[i] = step;
      out[i] = value_[i] + step;
      value_[i] = out[i] + step;
      slope_[i] = slope + slope - slope_[i];
    }
  }

 private:
  TIGER_OUTLINE void average(const float* in, float* out) {
    if (count_ == 0) {
      for (uint8_t i = 0; i < N; i++) value_[i] = slope_[i] = 0.0f;
    }
    count_++;
    const float weight = 1.0f / static_cast<float>(count_);
    for (uint8_t i = 0; i < N; i++) {
      value_[i] += weight * (in[i] - value_[i]);
      out[i] = value_[i];
    }
  }

  float value_[N], slope_[N];
  uint16_t count_ = 0;
};

}  // namespace fusion
}  // namespace tiger
