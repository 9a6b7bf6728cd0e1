// Time base: a 16-bit timer at 2 MHz (Timer 5 on the Mega, Timer 1 on the Nano), extended in software.
//
// The Arduino core's own clock counts in steps of 4 us and interrupts a thousand times a second for about 100
// cycles. This one resolves 0.5 us, interrupts 31 times a second, and the same counter stamps the wheel edges.
#pragma once

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdint.h>
#include <util/atomic.h>

namespace tiger {
namespace arduino {

#if defined(__AVR_ATmega2560__)
#define TIGER_CLOCK_OVERFLOW_vect TIMER5_OVF_vect
struct ClockTimer {
  static volatile uint16_t& count() { return TCNT5; }
  static bool overflow_pending() { return TIFR5 & _BV(TOV5); }
  static void start() {
    TCCR5A = 0;
    TCCR5B = _BV(CS51);  // clock / 8
    TCNT5 = 0;
    TIFR5 = _BV(TOV5);
    TIMSK5 = _BV(TOIE5);
  }
};
#elif defined(__AVR_ATmega328P__)
#define TIGER_CLOCK_OVERFLOW_vect TIMER1_OVF_vect
struct ClockTimer {
  static volatile uint16_t& count() { return TCNT1; }
  static bool overflow_pending() { return TIFR1 & _BV(TOV1); }
  static void start() {
    TCCR1A = 0;
    TCCR1B = _BV(CS11);
    TCNT1 = 0;
    TIFR1 = _BV(TOV1);
    TIMSK1 = _BV(TOIE1);
  }
};
#else
#error "TigerArduino knows the ATmega2560 (Mega 2560) and the ATmega328P (Nano): select one of these boards."
#endif

class Clock {
 public:
  // Takes the chip over from the Arduino core: its Timer 0 interrupt would only add jitter.
  void begin() {
    TIMSK0 = 0;
    overflows_ = 0;
    last_us_ = 0;
    millis_ = 0;
    ClockTimer::start();
  }

  // Budget 60 cycles, every 32.768 ms.
  __attribute__((always_inline)) void on_overflow() { overflows_ = overflows_ + 1; }

  // The bare counter, 0.5 us. The chip hands its high byte over in a register that the interrupts use too.
  uint16_t ticks() const {
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = ClockTimer::count(); }
    return count;
  }

  uint32_t micros() {
    uint32_t overflows;
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      overflows = overflows_;
      count = ClockTimer::count();
      if (count < 0x8000 && ClockTimer::overflow_pending()) ++overflows;
    }
    return (overflows << 15) + (count >> 1);  // one overflow is 2^15 us, so this wraps at 2^32 as it should
  }

  // Counts whole milliseconds of micros(), so that it wraps at 2^32 ms and not when micros() does. Must be called
  // at least once an hour: the feeding of the watchdog does.
  uint32_t millis() {
    const uint32_t whole_ms = (micros() - last_us_) / 1000;
    last_us_ += whole_ms * 1000;
    millis_ += whole_ms;
    return millis_;
  }

 private:
  volatile uint32_t overflows_;
  uint32_t last_us_;
  uint32_t millis_;
};

}  // namespace arduino
}  // namespace tiger
