// Potentiometers: the ADC runs freely (9615 conversions a second); sixteen of each channel are added up, channel
// after channel, and the four sums of a sweep are handed over together, 133 times a second. Now and then a sweep
// also measures the bandgap, for the supply voltage.
#pragma once

#include <avr/io.h>
#include <stdint.h>
#include <tiger/hal.h>
#include <util/atomic.h>

#include "mega_suspension_pins.h"
#include "supply.h"

namespace tiger {
namespace arduino {

class PotSampler {
 public:
  void begin() {
    slot_ = 0;
    bank_ = 0;
    sweeps_ = kSweepsPerSupply - 1;  // the first sweep measures the supply
    fresh_ = false;
    supply_sum_ = 0;
    start_slot(suspension_pins::kPotChannel[0], kSettleConversions);
    ADCSRB = 0;
    DIDR0 = 0x0F;  // the digital input buffers of A0-A3 only draw current here
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
  }

  // Budget 80 cycles on average (5 % of the CPU), 200 at the end of a channel.
  __attribute__((always_inline)) void on_conversion() {
    const uint16_t reading = ADC;
    if (settling_ != 0) {
      settling_ = static_cast<uint8_t>(settling_ - 1);
      return;
    }
    sum_ = static_cast<uint16_t>(sum_ + reading);
    left_ = static_cast<uint8_t>(left_ - 1);
    if (left_ == 0) finish_slot();
  }

  // True once for each new sweep.
  bool read(uint16_t sums[kCorners]) {
    if (!fresh_) return false;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      const volatile uint16_t* const done = sums_[bank_ ^ 1];
      for (uint8_t corner = 0; corner < kCorners; ++corner) sums[corner] = done[corner];
      fresh_ = false;
    }
    return true;
  }

  uint16_t supply_mv() const {
    uint16_t sum;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { sum = supply_sum_; }
    return supply_from_bandgap(sum, kConversionsPerSum);
  }

 private:
  static constexpr uint8_t kSettleConversions = 2;  // one is already running on the old channel, one settles
  static constexpr uint8_t kBandgapSettleConversions = 10;  // the bandgap is weak: a millisecond
  static constexpr uint8_t kSweepsPerSupply = 64;
  static constexpr uint8_t kSupplySlot = kCorners;

  void start_slot(uint8_t channel, uint8_t settling) {
    ADMUX = static_cast<uint8_t>(_BV(REFS0) | channel);
    settling_ = settling;
    sum_ = 0;
    left_ = kConversionsPerSum;
  }

  void finish_slot() {
    if (slot_ < kCorners) {
      sums_[bank_][slot_] = sum_;
    } else {
      supply_sum_ = sum_;
    }
    slot_ = static_cast<uint8_t>(slot_ + 1);
    if (slot_ == kSupplySlot) {
      bank_ ^= 1;
      fresh_ = true;
      sweeps_ = static_cast<uint8_t>(sweeps_ + 1);
      if (sweeps_ == kSweepsPerSupply) {
        sweeps_ = 0;
        start_slot(kBandgapChannel, kBandgapSettleConversions);
        return;
      }
    }
    if (slot_ >= kSupplySlot) slot_ = 0;
    start_slot(suspension_pins::kPotChannel[slot_], kSettleConversions);
  }

  volatile uint16_t sums_[2][kCorners];
  volatile uint16_t supply_sum_;
  volatile uint16_t sum_;
  volatile uint8_t settling_;
  volatile uint8_t left_;
  volatile uint8_t slot_;
  volatile uint8_t sweeps_;
  volatile uint8_t bank_;
  volatile bool fresh_;
};

}  // namespace arduino
}  // namespace tiger
