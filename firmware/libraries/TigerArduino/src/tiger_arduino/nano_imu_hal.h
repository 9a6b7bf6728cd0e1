// Hal of nano_imu on the Arduino Nano, with its interrupts.
#pragma once

#include <tiger/protocol.h>

#include "hal_common.h"
#include "supply.h"
#include "twi.h"

namespace tiger {
namespace arduino {

constexpr uint16_t kMegaReceiveBytes = 64;
constexpr uint16_t kMegaSendBytes = 64;  // one frame at a time: RAM is short here

static Uart<Uart0Port, kMegaReceiveBytes, kMegaSendBytes> mega_uart;
static TwiMaster twi_master;

class NanoImuHal : public HalCommon {
 public:
  void begin() {
    board_clock.begin();
    mega_uart.begin(wire::kBaudNanoSerial);
    twi_master.begin();
    supply_.begin();
    start_watching();
  }

  bool host_read(uint8_t& byte) { return mega_uart.read(byte); }
  uint8_t host_write_space() { return mega_uart.write_space(); }
  void host_write(const uint8_t* bytes, uint8_t n) { mega_uart.write(bytes, n); }

  uint16_t supply_mv() { return supply_.millivolts(); }
  uint8_t instance() { return 0; }

  bool twi_start(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in) {
    return twi_master.start(address, out, n_out, n_in);
  }
  TwiStatus twi_status() { return twi_master.status(); }
  const uint8_t* twi_data() { return twi_master.data(); }
  void twi_reset() { twi_master.reset(); }

 private:
  SupplyMonitor supply_;
};

}  // namespace arduino
}  // namespace tiger

ISR(USART_RX_vect) { tiger::arduino::mega_uart.on_receive(); }
ISR(USART_UDRE_vect) { tiger::arduino::mega_uart.on_data_register_empty(); }
ISR(TWI_vect) { tiger::arduino::twi_master.on_event(); }
ISR(WDT_vect) { tiger::arduino::watchdog_expire(); }
