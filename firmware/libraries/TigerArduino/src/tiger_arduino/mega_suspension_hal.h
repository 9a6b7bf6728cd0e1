// Hal of mega_suspension on the Arduino Mega 2560, with its interrupts.
#pragma once

#include <tiger/protocol.h>

#include "hal_common.h"
#include "motors.h"
#include "pots.h"

namespace tiger {
namespace arduino {

constexpr uint16_t kPeerReceiveBytes = 128;
constexpr uint16_t kPeerSendBytes = 128;

static Uart<Uart0Port, kHostReceiveBytes, kHostSendBytes> host_uart;
static Uart<Uart1Port, kPeerReceiveBytes, kPeerSendBytes> peer_uart;

class MegaSuspensionHal : public HalCommon {
 public:
  void begin() {
    Motors::begin();
    PORTA |= suspension_pins::kLowerPortA;  // pull-ups of the switches
    PORTC |= suspension_pins::kUpperPortC;
    PORTE |= suspension_pins::kEstopPortE;
    board_clock.begin();
    host_uart.begin(wire::kBaudSuspensionUsb);
    peer_uart.begin(wire::kBaudNanoSerial);
    pot_sampler.begin();
    start_watching();
  }

  bool host_read(uint8_t& byte) { return host_uart.read(byte); }
  uint8_t host_write_space() { return host_uart.write_space(); }
  void host_write(const uint8_t* bytes, uint8_t n) { host_uart.write(bytes, n); }
  bool peer_read(uint8_t& byte) { return peer_uart.read(byte); }
  uint8_t peer_write_space() { return peer_uart.write_space(); }
  void peer_write(const uint8_t* bytes, uint8_t n) { peer_uart.write(bytes, n); }

  uint16_t supply_mv() { return pot_sampler.supply_mv(); }
  uint8_t instance() { return 0; }

  bool pots_read(uint16_t sums[kCorners]) { return pot_sampler.read(sums); }
  void drive(uint8_t corner, int16_t duty_permille) { Motors::drive(corner, duty_permille); }
  void outputs_off() { Motors::off(); }
  uint8_t lower_switches() { return static_cast<uint8_t>(PINA >> 4); }
  uint8_t upper_switches() {  // D30 is PC7: the corners run downwards in this port
    uint8_t pins = PINC;
    uint8_t pressed = 0;
    for (uint8_t corner = 0; corner < kCorners; ++corner) {
      if ((pins & _BV(7)) != 0) pressed = static_cast<uint8_t>(pressed | (1u << corner));
      pins = static_cast<uint8_t>(pins << 1);
    }
    return pressed;
  }
  bool estop_pressed() { return PINE & suspension_pins::kEstopPortE; }
};

}  // namespace arduino
}  // namespace tiger

ISR(USART0_RX_vect) { tiger::arduino::host_uart.on_receive(); }
ISR(USART0_UDRE_vect) { tiger::arduino::host_uart.on_data_register_empty(); }
ISR(USART1_RX_vect) { tiger::arduino::peer_uart.on_receive(); }
ISR(USART1_UDRE_vect) { tiger::arduino::peer_uart.on_data_register_empty(); }

// The program hangs: outputs off first.
ISR(WDT_vect) {
  tiger::arduino::Motors::off();
  tiger::arduino::watchdog_expire();
}
