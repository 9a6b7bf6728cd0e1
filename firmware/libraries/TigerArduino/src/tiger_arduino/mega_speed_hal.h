// Hal of mega_speed on the Arduino Mega 2560, with its interrupts.
#pragma once

#include <tiger/protocol.h>
#include <tiger/sensing/quadrature.h>

#include "hal_common.h"
#include "mega_speed_pins.h"
#include "supply.h"

namespace tiger {
namespace arduino {

static Uart<Uart0Port, kHostReceiveBytes, kHostSendBytes> host_uart;
static Quadrature front_wheel;
static Quadrature rear_wheel;

class MegaSpeedHal : public HalCommon {
 public:
  void begin() {
    PORTC |= speed_pins::kStrapPortC;  // pull-up; the sensors have their own
    board_clock.begin();
    host_uart.begin(wire::kBaudSpeedUsb);
    supply_.begin();
    front_wheel.begin(front_pins());
    rear_wheel.begin(rear_pins());
    EICRA = _BV(ISC20) | _BV(ISC30);  // any change
    EICRB = _BV(ISC40) | _BV(ISC50);
    EIFR = _BV(INTF2) | _BV(INTF3) | _BV(INTF4) | _BV(INTF5);
    EIMSK = _BV(INT2) | _BV(INT3) | _BV(INT4) | _BV(INT5);
    start_watching();
  }

  bool host_read(uint8_t& byte) { return host_uart.read(byte); }
  uint8_t host_write_space() { return host_uart.write_space(); }
  void host_write(const uint8_t* bytes, uint8_t n) { host_uart.write(bytes, n); }

  uint16_t supply_mv() { return supply_.millivolts(); }
  uint8_t instance() { return (PINC & speed_pins::kStrapPortC) ? 0 : 1; }

  // Copies while the edges come, and again if one came meanwhile: at high speed a copy with interrupts off would
  // make the other wheel miss an edge.
  EdgeSnapshot edges(uint8_t channel) {
    const Quadrature& wheel = channel == 0 ? front_wheel : rear_wheel;
    EdgeSnapshot snapshot;
    for (uint8_t tries = 0; tries < kCopyTries; ++tries) {
      const uint8_t generation = wheel.generation();
      copy(wheel, snapshot);
      snapshot.now_ticks = board_clock.ticks();
      if (wheel.generation() == generation) return snapshot;
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      copy(wheel, snapshot);
      snapshot.now_ticks = ClockTimer::count();
    }
    return snapshot;
  }

  // The states of the two signals in an order that the decoder takes for A in bit 0, B in bit 1.
  static uint8_t front_pins() {
    static_assert(speed_pins::kFrontShiftPortE == 4, "a swap of nibbles is the shift");
    return __builtin_avr_swap(PINE) & 3;
  }
  // Here A is the upper of the two bits. Exchanging the signals turns the order of the states round, inverting one of
  // them turns it back.
  static uint8_t rear_pins() {
    uint8_t pins = PIND;
    pins = static_cast<uint8_t>(pins >> speed_pins::kRearShiftPortD);
    return static_cast<uint8_t>((pins & 3) ^ 1);
  }

 private:
  static constexpr uint8_t kCopyTries = 3;

  __attribute__((always_inline)) static void copy(const Quadrature& wheel, EdgeSnapshot& snapshot) {
    __asm__ __volatile__("" ::: "memory");  // what the interrupt wrote counts, not what was read before
    wheel.copy_to(snapshot);
    __asm__ __volatile__("" ::: "memory");
  }

  SupplyMonitor supply_;
};

}  // namespace arduino
}  // namespace tiger

ISR(USART0_RX_vect) { tiger::arduino::host_uart.on_receive(); }
ISR(USART0_UDRE_vect) { tiger::arduino::host_uart.on_data_register_empty(); }

// One handler a wheel, for both of its signals. Budget 130 cycles with entry and exit.
ISR(INT4_vect) {
  using namespace tiger::arduino;
  front_wheel.on_edge(MegaSpeedHal::front_pins(), [] { return ClockTimer::count(); });
}
ISR(INT5_vect, ISR_ALIASOF(INT4_vect));
ISR(INT2_vect) {
  using namespace tiger::arduino;
  rear_wheel.on_edge(MegaSpeedHal::rear_pins(), [] { return ClockTimer::count(); });
}
ISR(INT3_vect, ISR_ALIASOF(INT2_vect));

ISR(WDT_vect) { tiger::arduino::watchdog_expire(); }
