// The Hal: everything a board template needs from the chip, resolved at compile time.
//
// A board is `template <class Hal> class Board { explicit Board(Hal&); void begin(); void poll(); }`. Two
// kinds of Hal exist: on the AVR (library TigerArduino) and on the PC (firmware/native). No call of a Hal may
// block for longer than 50 us, none allocates. Interrupt handlers live in the Hal; what they share with the
// board is handed over by value, so that no board code needs to know about atomic sections.
//
// Every Hal
//   uint32_t micros();  uint32_t millis();
//       Wrap around; differences are taken in the same unsigned type.
//   bool host_read(uint8_t& byte);
//       UART towards the host (on the Nano: towards the Mega). False: nothing there.
//   uint8_t host_write_space();  void host_write(const uint8_t* bytes, uint8_t n);
//       Bytes that host_write takes now (255 stands for more); the caller has checked. The buffer holds at
//       least one whole frame (kMaxFrame of frame.h).
//   uint8_t eeprom_read(uint16_t address);
//       Called only when eeprom_ready, or before the first poll.
//   bool eeprom_ready();  void eeprom_write(uint16_t address, uint8_t value);
//       Starts the write of one byte; ready again once it is done (3.4 ms).
//   void watchdog_feed();
//       The Hal has started the watchdog: kWatchdogMs, first the interrupt, then the reset.
//   uint8_t reset_cause();
//       MCUSR as saved in .init3.
//   FaultRecord& fault_record();
//       In .noinit: outlives every reset but the loss of power.
//   uint16_t ram_free_bytes();
//       Stack bytes never touched since boot.
//   uint16_t supply_mv();
//       Measured against the bandgap; 0 while not measured.
//   uint8_t instance();
//       Strap: which of two boards of a kind; 0 where there is only one.
//
// mega_suspension adds (corners FL FR RL RR)
//   bool pots_read(uint16_t sums[4]);
//       True once for each new set: sums of 16 conversions, 0..16368, all four of one sweep, at least 100 sets
//       a second.
//   void drive(uint8_t corner, int16_t duty_permille);
//       -1000..1000, positive raises the body; 0 is PWM off.
//   void outputs_off();
//       All four off at once, and off they stay until the next drive().
//   uint8_t lower_switches();  uint8_t upper_switches();
//       Bit n: the limit switch of corner n is pressed. Normally closed: a cut wire reads as pressed.
//   bool estop_pressed();
//       Normally closed as well.
//   bool peer_read(uint8_t&);  uint8_t peer_write_space();  void peer_write(const uint8_t*, uint8_t);
//       UART to the Nano.
//
// nano_imu adds an interrupt-driven two-wire bus, one transaction at a time
//   bool twi_start(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in);
//       Writes n_out bytes, then after a repeated start reads n_in. `out` is copied. False: one still runs, or
//       it is longer than kTwiMaxOut or kTwiMaxIn.
//   TwiStatus twi_status();  const uint8_t* twi_data();
//       Of the latest transaction; the data are valid once Done and until the next start.
//   void twi_reset();
//       Gives up, frees the bus by nine clocks and a stop, and starts the unit afresh.
//
// mega_speed adds
//   EdgeSnapshot edges(uint8_t channel);
//       Atomic copy of what the edge interrupt keeps (sensing/quadrature.h).
#pragma once

#include <stdint.h>

namespace tiger {

constexpr uint8_t kWatchdogMs = 32;         // first time-out: outputs off; the second one resets the chip
constexpr uint8_t kCorners = 4;             // FL FR RL RR
constexpr uint8_t kConversionsPerSum = 16;  // 10-bit conversions in one potentiometer reading

// What is left of the run before a reset. The program writes every fault it latches, the watchdog's interrupt
// writes Fault WATCHDOG. It counts only while `magic` is right: RAM is random after power-on.
struct FaultRecord {
  uint16_t magic;
  uint8_t fault;   // wire::Fault of the latest fault, 0 none
  uint8_t detail;  // corner or channel it was seen on, 255 none
};
constexpr uint16_t kFaultRecordMagic = 0x71E5;

constexpr uint8_t kTwiMaxOut = 8;
constexpr uint8_t kTwiMaxIn = 24;

enum class TwiStatus : uint8_t {
  Idle,         // nothing was started since the bus was reset
  Busy,         // running; the caller watches the time
  Done,         //
  AddressNack,  // nobody answers at this address
  DataNack,     // the chip refused a byte
  BusError,     // arbitration lost or an illegal start or stop
};

}  // namespace tiger
