// The Hal: everything a board template needs from the chip, resolved at compile time.
//
// A board is `template <class Hal> class Board { explicit Board(Hal&); void begin(); void poll(); }`. Two
// kinds of Hal exist: one on the AVR (library TigerArduino) and one on the PC (firmware/native). No call of a
// Hal may block for longer than 50 us, and none allocates. Interrupt handlers live in the Hal; what they
// share with the board is handed over by value, so no board code needs to know about atomic sections.
//
// Every Hal
//   uint32_t micros();  uint32_t millis();     wrap; differences are taken in the same unsigned type
//   bool host_read(uint8_t& byte);             UART towards the host (on the Nano: towards the Mega); false:
//   nothing there uint8_t host_write_space();                bytes that host_write takes now; at most 255 is
//   reported. The buffer holds
//                                              at least one whole frame (kMaxFrame of frame.h)
//   void host_write(const uint8_t* bytes, uint8_t n);       the caller has checked the space
//   uint8_t eeprom_read(uint16_t address);     waits for a write that runs (only used before the first poll)
//   bool eeprom_ready();                       no write runs
//   void eeprom_write(uint16_t address, uint8_t value);     starts one write; the caller has checked
//   eeprom_ready void watchdog_feed();                      the watchdog was started by the Hal: kWatchdogMs,
//   interrupt, then reset uint8_t reset_cause();                     MCUSR as saved in .init3 FaultRecord&
//   fault_record();               in .noinit: outlives every reset but power loss uint16_t ram_free_bytes();
//   stack bytes never touched since boot uint16_t supply_mv();                      against the bandgap; 0
//   while not measured uint8_t instance();                        strap: which of two boards of a kind; 0
//   where there is only one
//
// mega_suspension adds (corners FL FR RL RR)
//   bool pots_read(uint16_t sums[4]);          true once for each new set: sums of 16 conversions, 0..16368,
//   all four of
//                                              one sweep, at least 100 sets a second
//   void drive(uint8_t corner, int16_t duty_permille);      -1000..1000, positive raises the body; 0 is PWM
//   off void outputs_off();                        all four off at once; they stay off until the next drive()
//   uint8_t lower_switches();  uint8_t upper_switches();    bit n: the limit switch of corner n is pressed
//   bool estop_pressed();                      an open or cut wire reads as pressed
//   bool peer_read(uint8_t&);  uint8_t peer_write_space();  void peer_write(const uint8_t*, uint8_t);   UART
//   to the Nano
//
// nano_imu adds an interrupt-driven two-wire bus, one transaction at a time
//   bool twi_start(uint8_t address, const uint8_t* out, uint8_t n_out, uint8_t n_in);   writes n_out bytes,
//   then (repeated
//                                              start) reads n_in; `out` is copied; false: one still runs, or
//                                              too long (at most kTwiMaxOut and kTwiMaxIn)
//   TwiStatus twi_status();                    of the latest transaction
//   const uint8_t* twi_data();                 its n_in bytes, valid once Done and until the next start
//   void twi_reset();                          gives up, frees the bus by nine clocks and a stop, starts the
//   unit afresh
//
// mega_speed adds
//   EdgeSnapshot edges(uint8_t channel);       atomic copy of what the edge interrupt keeps
//   (sensing/quadrature.h)
#pragma once

#include <stdint.h>

namespace tiger {

constexpr uint8_t kWatchdogMs = 32;  // first time-out: interrupt, outputs off; the second one resets the chip
constexpr uint8_t kCorners = 4;      // FL FR RL RR
constexpr uint8_t kConversionsPerSum =
    16;  // a potentiometer reading is the sum of this many 10-bit conversions

// What is left of the run before a reset. The program writes every fault it latches; the watchdog's interrupt
// writes Fault::Watchdog. Contents count only while `magic` is kFaultRecordMagic: RAM is random after
// power-on.
struct FaultRecord {
  uint16_t magic;
  uint8_t fault;   // wire::Fault of the latest fault, 0 none
  uint8_t detail;  // corner or channel it was seen on, 255 none
};
constexpr uint16_t kFaultRecordMagic = 0x71E5;

constexpr uint8_t kTwiMaxOut = 8;
constexpr uint8_t kTwiMaxIn = 24;

enum class TwiStatus : uint8_t {
  Idle,  // nothing was started since the bus was reset
  Busy,  // running; the caller watches the time
  Done,
  AddressNack,  // nobody answers at this address
  DataNack,     // the chip refused a byte
  BusError,     // arbitration lost or an illegal start or stop
};

}  // namespace tiger
