// The supply voltage of a board that needs the ADC for nothing else: the bandgap, measured against the supply,
// over and over without an interrupt.
#pragma once

#include <avr/io.h>
#include <stdint.h>

namespace tiger {
namespace arduino {

constexpr uint16_t kBandgapMv = 1100;      // typical; +-10 % from chip to chip, so this watches changes
constexpr uint8_t kBandgapChannel = 0x1E;  // of both chips

// `conversions` added up to `sum`.
static inline uint16_t supply_from_bandgap(uint16_t sum, uint8_t conversions) {
  if (sum == 0) return 0;
  return static_cast<uint16_t>(static_cast<uint32_t>(kBandgapMv) * 1024 * conversions / sum);
}

class SupplyMonitor {
 public:
  void begin() {
    ADMUX = _BV(REFS0) | kBandgapChannel;
    ADCSRB = 0;
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
  }
  uint16_t millivolts() const { return supply_from_bandgap(ADC, 1); }
};

}  // namespace arduino
}  // namespace tiger
