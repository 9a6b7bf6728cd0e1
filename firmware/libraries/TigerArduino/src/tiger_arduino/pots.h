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

  // The last conversion of a channel; the interrupt's short path has dealt with the others. Budget 200 cycles.
  __attribute__((always_inline)) void on_last_conversion() {
    sum_ = static_cast<uint16_t>(sum_ + ADC);
    finish_slot();
  }

  // Of the running channel; the interrupt's short path works on them.
  static volatile uint16_t sum_;
  static volatile uint8_t left_;  // conversions still to come, the settling ones first

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
    sum_ = 0;
    left_ = static_cast<uint8_t>(settling + kConversionsPerSum);
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
  volatile uint8_t slot_;
  volatile uint8_t sweeps_;
  volatile uint8_t bank_;
  volatile bool fresh_;
};

volatile uint16_t PotSampler::sum_;
volatile uint8_t PotSampler::left_;

static PotSampler pot_sampler;

}  // namespace arduino
}  // namespace tiger

// 17 of 18 conversions only add up or settle. By hand, because the compiler saves every register that the eighteenth
// needs at each of them: 60 cycles instead of 94, and this interrupt comes 9615 times a second (budget 5 % of the CPU).
ISR(ADC_vect, ISR_NAKED) {
  __asm__ __volatile__(
      "    push r24\n"
      "    in r24, __SREG__\n"
      "    push r24\n"
      "    lds r24, %[left]\n"
      "    dec r24\n"
      "    sts %[left], r24\n"
      "    breq 2f\n"
      "    cpi r24, %[conversions]\n"
      "    brsh 1f\n"
      "    push r25\n"
      "    lds r24, %[sum]\n"
      "    lds r25, %[low]\n"
      "    add r24, r25\n"
      "    sts %[sum], r24\n"
      "    lds r24, %[sum] + 1\n"
      "    lds r25, %[high]\n"
      "    adc r24, r25\n"
      "    sts %[sum] + 1, r24\n"
      "    pop r25\n"
      "1:  pop r24\n"
      "    out __SREG__, r24\n"
      "    pop r24\n"
      "    reti\n"
      "2:  pop r24\n"
      "    out __SREG__, r24\n"
      "    pop r24\n"
      "    jmp __vector_last_conversion\n"
      :
      : [left] "i"(&tiger::arduino::PotSampler::left_), [sum] "i"(&tiger::arduino::PotSampler::sum_),
        [conversions] "M"(16), [low] "n"(_SFR_MEM_ADDR(ADCL)), [high] "n"(_SFR_MEM_ADDR(ADCH)));
  static_assert(tiger::kConversionsPerSum == 16, "the short path adds up the last 16 conversions");
}

extern "C" void __vector_last_conversion() __attribute__((signal, used, externally_visible));
extern "C" void __vector_last_conversion() { tiger::arduino::pot_sampler.on_last_conversion(); }
