// Four motor drivers by PWM and direction: 20 kHz from timers 1 and 3 in fast PWM with ICR as top (mode 14).
// Zero duty disconnects the pin from its timer, because a compare value of 0 still gives a spike each period.
#pragma once

#include <avr/io.h>
#include <stdint.h>

#include "mega_suspension_pins.h"

namespace tiger {
namespace arduino {

class Motors {
 public:
  static constexpr uint16_t kPwmTop = static_cast<uint16_t>(F_CPU / 20000 - 1);

  // First thing after a reset: pins low, then outputs, then the timers.
  static void begin() {
    off();
    DDRB |= suspension_pins::kPwmPortB;
    DDRE |= suspension_pins::kPwmPortE;
    PORTA &= static_cast<uint8_t>(~suspension_pins::kDirectionPortA);
    DDRA |= suspension_pins::kDirectionPortA;
    ICR1 = kPwmTop;
    ICR3 = kPwmTop;
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);
    TCCR3B = _BV(WGM33) | _BV(WGM32) | _BV(CS30);
  }

  // All four off at once; safe in an interrupt.
  __attribute__((always_inline)) static void off() {
    TCCR1A = _BV(WGM11);
    TCCR3A = _BV(WGM31);
    PORTB &= static_cast<uint8_t>(~suspension_pins::kPwmPortB);
    PORTE &= static_cast<uint8_t>(~suspension_pins::kPwmPortE);
  }

  // Duty -1000..1000; positive raises the body.
  static void drive(uint8_t corner, int16_t duty_permille) {
    if (duty_permille == 0) {
      disconnect(corner);
      return;
    }
    const bool raise = duty_permille > 0;
    const uint16_t magnitude = static_cast<uint16_t>(raise ? duty_permille : -duty_permille);
    uint16_t compare = static_cast<uint16_t>(magnitude * 4u / 5u);
    if (compare > kPwmTop) compare = kPwmTop;
    const uint8_t direction = static_cast<uint8_t>(_BV(0) << corner);
    if (raise) {
      PORTA |= direction;
    } else {
      PORTA &= static_cast<uint8_t>(~direction);
    }
    connect(corner, compare);
  }

 private:
  static_assert(kPwmTop == 799, "drive() scales permille by 4/5");

  static void connect(uint8_t corner, uint16_t compare) {
    switch (corner) {
      case 0:
        OCR1A = compare;
        TCCR1A |= _BV(COM1A1);
        break;
      case 1:
        OCR1B = compare;
        TCCR1A |= _BV(COM1B1);
        break;
      case 2:
        OCR3A = compare;
        TCCR3A |= _BV(COM3A1);
        break;
      case 3:
        OCR3B = compare;
        TCCR3A |= _BV(COM3B1);
        break;
      default:
        break;
    }
  }

  static void disconnect(uint8_t corner) {
    switch (corner) {
      case 0:
        TCCR1A &= static_cast<uint8_t>(~_BV(COM1A1));
        break;
      case 1:
        TCCR1A &= static_cast<uint8_t>(~_BV(COM1B1));
        break;
      case 2:
        TCCR3A &= static_cast<uint8_t>(~_BV(COM3A1));
        break;
      case 3:
        TCCR3A &= static_cast<uint8_t>(~_BV(COM3B1));
        break;
      default:
        break;
    }
  }
};

constexpr uint16_t Motors::kPwmTop;

}  // namespace arduino
}  // namespace tiger
