// What happens around a reset: its cause, the watchdog, the fault that outlives it, and the stack's high-water
// mark. One copy a program: included by the Hal of the board.
#pragma once

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <stdint.h>
#include <tiger/hal.h>
#include <tiger/protocol.h>

extern "C" uint8_t __heap_start;  // the linker's name for the first byte after all variables

namespace tiger {
namespace arduino {

static FaultRecord fault_record __attribute__((section(".noinit")));
static uint8_t saved_mcusr __attribute__((section(".noinit")));
static uint16_t watchdog_mark __attribute__((section(".noinit")));

constexpr uint16_t kWatchdogMark = 0xB17E;
constexpr uint8_t kStackPaint = 0xC5;

// Runs before the variables are initialised. The watchdog stays on through its own reset and must be switched
// off first. Bootloaders clear MCUSR before the program sees it: the mark of the watchdog's interrupt then tells
// that the watchdog was the cause (its hang with interrupts disabled leaves no mark and reads as cause 0).
extern "C" void tiger_after_reset() __attribute__((naked, used, section(".init3")));
extern "C" void tiger_after_reset() {
  saved_mcusr = MCUSR;
  MCUSR = 0;
  wdt_disable();
  if (saved_mcusr == 0 && watchdog_mark == kWatchdogMark) saved_mcusr = _BV(WDRF);
  watchdog_mark = 0;
  __asm__ __volatile__(  // paint from the end of the variables up to the stack pointer
      "    ldi r30, lo8(__heap_start)\n"
      "    ldi r31, hi8(__heap_start)\n"
      "    in r24, __SP_L__\n"
      "    in r25, __SP_H__\n"
      "1:  st Z+, %0\n"
      "    cp r30, r24\n"
      "    cpc r31, r25\n"
      "    brlo 1b\n"
      :
      : "r"(kStackPaint)
      : "r24", "r25", "r30", "r31", "memory");
}

// 32 ms; the first time-out interrupts, the second one resets (also when the interrupt could not run).
static inline void watchdog_start() {
  const uint8_t sreg = SREG;
  cli();
  wdt_reset();
  WDTCSR = _BV(WDCE) | _BV(WDE);
  WDTCSR = _BV(WDIE) | _BV(WDE) | _BV(WDP0);
  SREG = sreg;
}

// The end of the watchdog's interrupt: leaves a record and waits for the reset, which the shortest time-out
// brings 16 ms later. The caller has switched the outputs off.
static inline void watchdog_expire() __attribute__((noreturn));
static inline void watchdog_expire() {
  fault_record.magic = kFaultRecordMagic;
  fault_record.fault = static_cast<uint8_t>(wire::Fault::kWatchdog);
  fault_record.detail = 255;
  watchdog_mark = kWatchdogMark;
  WDTCSR = _BV(WDCE) | _BV(WDE);
  WDTCSR = _BV(WDE);
  __asm__ __volatile__("" ::: "memory");  // the record is for the next run: the compiler must not drop it
  for (;;) {
  }
}

// Counts the stack bytes never written since boot. The first call scans all of them, later ones only look
// whether the mark moved.
class StackMargin {
 public:
  uint16_t free_bytes() {
    const uint8_t* const bottom = &__heap_start;
    if (mark_ == nullptr) {
      mark_ = bottom;
      while (*mark_ == kStackPaint) ++mark_;
    }
    // A frame may leave gaps unwritten: look a little further down than the first painted byte.
    uint8_t unpainted_below = 0;
    for (uint8_t i = 1; i <= kLookBelow && mark_ - i >= bottom; ++i)
      if (mark_[-static_cast<int8_t>(i)] != kStackPaint) unpainted_below = i;
    mark_ -= unpainted_below;
    return static_cast<uint16_t>(mark_ - bottom);
  }

 private:
  static constexpr uint8_t kLookBelow = 64;
  const uint8_t* mark_ = nullptr;
};

}  // namespace arduino
}  // namespace tiger
