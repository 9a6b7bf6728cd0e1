// SPDX-License-Identifier: GPL-3.0-or-later
// AVR boards in libsimavr: several in one process, in lock-step, with the wires between them. A test tool only:
// simavr is GPL-3, so nothing outside tests/avr links this.
//
// Where simavr 1.6 differs from the chip, this file makes up for it (measured against the data sheet):
//   interrupt entry costs nothing            -> 4 or 5 cycles are added
//   a UART byte lasts 11 bits                -> 10, from UBRR and U2X
//   the receiver holds 64 bytes              -> a byte that finds 2 waiting and one shifting in is lost (overrun)
//   a TWI byte lasts 9 us whatever TWBR says -> 9 bits of TWBR
//   the ADC scales by 1023                   -> avr_adc_code() gives the millivolts that read as the wanted code
//   the watchdog only interrupts while the interrupt waits -> it resets at the second time-out, as the chip does
//   an EEPROM write is done at once          -> EEPE stays set for 3.4 ms
//   a reset keeps MCUSR at 0                 -> power-on and external reset set their bits
#include <simavr/avr_adc.h>
#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_twi.h>
#include <simavr/avr_uart.h>
#include <simavr/avr_watchdog.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_cycle_timers.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_interrupts.h>
#include <simavr/sim_io.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <deque>
#include <memory>
#include <vector>

extern "C" {
#include "avr_board.h"
}
#include "bno055_device.h"

namespace {

constexpr uint32_t kHz = 16000000;
constexpr int kUarts = 2;
constexpr int kVectors = 64;
constexpr uint16_t kMcusr = 0x54;
constexpr uint16_t kTwcr = 0xBC;
constexpr uint8_t kTwsta = 0x20;
constexpr uint16_t kEecr = 0x3F;
constexpr uint8_t kEepe = 0x02;
constexpr uint32_t kEepromWriteCycles = kHz / 10000 * 34;
constexpr uint16_t kWdtcsr = 0x60;
constexpr uint8_t kWdie = 0x40;
constexpr uint16_t kTurnRegister = 0x3E;  // GPIOR0: a sketch writes it once per turn of its main loop

struct Byte {
  uint8_t value;
  uint64_t at;
};

struct Uart {
  avr_board* board = nullptr;
  int port = 0;
  avr_uart_t* unit = nullptr;
  avr_irq_t* input = nullptr;
  std::deque<Byte> sent;    // by the program, at the start of their frames
  std::deque<Byte> coming;  // to the program, at the start of their frames
  uint64_t line_free_at = 0;
  bool timer_set = false;
  uint32_t overruns = 0;
  Uart* peer = nullptr;
};

struct Pending {
  avr_board* board = nullptr;
  uint64_t since = 0;
  uint32_t pc = 0;
};

struct PinEvent {
  uint64_t at;
  char port;
  int bit;
  int level;
};

struct Watch {
  avr_board* board;
  avr_pin pin;
  uint64_t rose_at;
};

void be_quiet(avr_t*, const int, const char*, va_list) {}
void do_not_sleep(avr_t*, avr_cycle_count_t) {}

}  // namespace

struct avr_board {
  avr_t* avr = nullptr;
  Uart uarts[kUarts];
  std::deque<PinEvent> pin_events;
  bool pin_timer_set = false;
  uint8_t driven[16] = {};  // pins that something outside drives, by port
  uint8_t levels[16] = {};
  std::deque<Watch> watches;
  avr_isr isrs[kVectors] = {};
  Pending pending[kVectors];
  int running_vector = 0;
  uint64_t entered_at = 0;
  std::vector<uint32_t> turns;  // cycles of each turn of the main loop
  uint64_t turn_at = 0;
  avr_watchdog_t* watchdog = nullptr;
  avr_twi_t* twi = nullptr;
  avr_irq_t* twi_input = nullptr;
  std::unique_ptr<Bno055Device> device;
  int device_address = 0;
  bool addressed = false;
  uint64_t twi_held_until = 0;
  uint32_t twi_clocks = 0;
  uint8_t twi_direction = 0;
  uint32_t resets = 0;
  uint64_t last_reset = 0;
  void (*core_reset)(avr_t*) = nullptr;
  uint32_t hung_pc = 0;
  uint8_t hung_code[2] = {};
  bool hung = false;
  bool stop = false;
  uint8_t next_mcusr = 0x01;
};

namespace {

std::vector<avr_board*> all_boards;  // simavr's reset hook has no user pointer

avr_board* board_of(avr_t* avr) {
  for (avr_board* board : all_boards)
    if (board->avr == avr) return board;
  return nullptr;
}

// ---------------------------------------------------------------------------------------------------------- UART

uint64_t byte_cycles(const Uart& uart) {
  const uint8_t* data = uart.board->avr->data;
  const uint16_t base = static_cast<uint16_t>(0xC0 + 8 * uart.port);
  const uint32_t divisor = (data[base + 4] | ((data[base + 5] & 15u) << 8)) + 1;
  return divisor * ((data[base] & 2) != 0 ? 8u : 16u) * 10u;
}

avr_cycle_count_t deliver_byte(avr_t*, avr_cycle_count_t when, void* param);

void arm_receiver(Uart& uart) {
  if (uart.timer_set || uart.coming.empty()) return;
  const uint64_t now = uart.board->avr->cycle;
  uint64_t at = uart.coming.front().at > uart.line_free_at ? uart.coming.front().at : uart.line_free_at;
  if (at <= now) at = now + 1;
  uart.timer_set = true;
  avr_cycle_timer_register(uart.board->avr, at - now, deliver_byte, &uart);
}

avr_cycle_count_t deliver_byte(avr_t*, avr_cycle_count_t when, void* param) {
  Uart& uart = *static_cast<Uart*>(param);
  uart.timer_set = false;
  const Byte byte = uart.coming.front();
  uart.coming.pop_front();
  uart.unit->cycles_per_byte = byte_cycles(uart);
  uart.line_free_at = when + byte_cycles(uart);
  if (static_cast<uint32_t>(uart.unit->input.write - uart.unit->input.read) % uart_fifo_fifo_size >= 3) {
    ++uart.overruns;
  } else {
    avr_raise_irq(uart.input, byte.value);
  }
  arm_receiver(uart);
  return 0;
}

void byte_sent(avr_irq_t*, uint32_t value, void* param) {
  Uart& uart = *static_cast<Uart*>(param);
  uart.unit->cycles_per_byte = byte_cycles(uart);
  const Byte byte = {static_cast<uint8_t>(value), uart.board->avr->cycle};
  if (uart.peer == nullptr) {
    uart.sent.push_back(byte);
  } else {
    uart.peer->coming.push_back(byte);
    arm_receiver(*uart.peer);
  }
}

// ---------------------------------------------------------------------------------------------------------- pins

avr_cycle_count_t apply_pins(avr_t* avr, avr_cycle_count_t, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  while (!board.pin_events.empty() && board.pin_events.front().at <= avr->cycle) {
    const PinEvent event = board.pin_events.front();
    board.pin_events.pop_front();
    avr_pin_set(&board, event.port, event.bit, event.level);
  }
  board.pin_timer_set = !board.pin_events.empty();
  return board.pin_timer_set ? board.pin_events.front().at : 0;
}

void pin_changed(avr_irq_t*, uint32_t value, void* param) {
  Watch& watch = *static_cast<Watch*>(param);
  const int level = value & 1;
  if (level == watch.pin.level) return;
  const uint64_t now = watch.board->avr->cycle;
  watch.pin.level = level;
  watch.pin.last_change = now;
  if (level != 0) {
    ++watch.pin.rises;
    watch.rose_at = now;
  } else {
    ++watch.pin.falls;
    watch.pin.high_cycles += now - watch.rose_at;
  }
}

// ---------------------------------------------------------------------------------------- interrupts and the loop

void interrupt_pending(avr_irq_t*, uint32_t is_pending, void* param) {
  Pending& pending = *static_cast<Pending*>(param);
  if (is_pending == 0) return;
  pending.since = pending.board->avr->cycle;
  pending.pc = pending.board->avr->pc;
}

void interrupt_running(avr_irq_t*, uint32_t vector, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  avr_t* avr = board.avr;
  const uint32_t entry = 2u + avr->address_size;
  if (vector != 0) {
    board.running_vector = static_cast<int>(vector);
    board.entered_at = avr->cycle;
    avr_isr& isr = board.isrs[vector & (kVectors - 1)];
    const Pending& pending = board.pending[vector & (kVectors - 1)];
    const uint32_t wait = static_cast<uint32_t>(avr->cycle - pending.since);
    if (wait > isr.max_wait_cycles) {
      isr.max_wait_cycles = wait;
      isr.wait_pc = pending.pc;
    }
    avr->cycle += entry;
  } else if (board.running_vector != 0) {
    avr_isr& isr = board.isrs[board.running_vector & (kVectors - 1)];
    const uint32_t cycles =
        static_cast<uint32_t>(avr->cycle - board.entered_at) + entry;  // RETI takes as long
    ++isr.count;
    isr.total_cycles += cycles;
    if (cycles > isr.max_cycles) isr.max_cycles = cycles;
    board.running_vector = 0;
  }
}

void turn_begins(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  avr->data[address] = value;
  if (board.turn_at != 0) board.turns.push_back(static_cast<uint32_t>(avr->cycle - board.turn_at));
  board.turn_at = avr->cycle;
}

avr_cycle_count_t eeprom_ready(avr_t* avr, avr_cycle_count_t, void*) {
  avr->data[kEecr] &= static_cast<uint8_t>(~kEepe);
  return 0;
}

void eeprom_control(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  if ((value & kEepe) == 0) return;
  avr->data[address] |= kEepe;
  avr_cycle_timer_register(avr, kEepromWriteCycles, eeprom_ready, param);
}

// ---------------------------------------------------------------------------------------------- watchdog and reset

// One cycle before the second time-out: an interrupt that still waits gives way to the reset.
avr_cycle_count_t watchdog_second(avr_t* avr, avr_cycle_count_t, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  if (board.watchdog->watchdog.pending) avr->data[kWdtcsr] &= static_cast<uint8_t>(~kWdie);
  return 0;
}

void watchdog_first(avr_irq_t*, uint32_t value, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  if (value != 0)
    avr_cycle_timer_register(board.avr, board.watchdog->cycle_count - 1, watchdog_second, &board);
}

void heal(avr_board& board) {
  if (!board.hung) return;
  memcpy(board.avr->flash + board.hung_pc, board.hung_code, sizeof(board.hung_code));
  board.hung = false;
}

void board_resets(avr_t* avr) {
  avr_board& board = *board_of(avr);
  board.core_reset(avr);
  heal(board);
  ++board.resets;
  board.last_reset = avr->cycle;
  board.turn_at = 0;
  board.running_vector = 0;
  avr->data[kMcusr] |= board.next_mcusr;
  board.next_mcusr = 0;
}

// ----------------------------------------------------------------------------------------------------------- TWI

// Called after simavr's own handler: moves the event it has put into its queue to the time the bus really takes.
void twi_control(avr_t* avr, avr_io_addr_t, uint8_t value, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  for (avr_cycle_timer_slot_p slot = avr->cycle_timers.timer; slot != nullptr; slot = slot->next) {
    if (slot->param != board.twi) continue;
    const uint8_t* data = avr->data;
    const uint32_t bit = 16u + 2u * data[board.twi->r_twbr] * (1u << (2 * (data[board.twi->r_twsr] & 3)));
    uint64_t cycles = (value & kTwsta) != 0 ? bit : 9u * bit;
    if (board.twi_held_until > avr->cycle) cycles += board.twi_held_until - avr->cycle;
    if (board.device != nullptr && board.device->holds_bus()) {
      avr_cycle_timer_cancel(avr, slot->timer, slot->param);
    } else {
      avr_cycle_timer_register(avr, cycles, slot->timer, slot->param);
    }
    return;
  }
}

void twi_message(avr_irq_t*, uint32_t value, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  avr_twi_msg_irq_t message;
  message.u.v = value;
  const uint8_t what = message.u.twi.msg;
  if (board.device == nullptr || board.device->holds_bus()) return;
  const uint64_t now_us = board.avr->cycle / (kHz / 1000000);
  const auto acknowledge = [&](bool yes) {
    avr_raise_irq(board.twi_input, avr_twi_irq_msg(TWI_COND_ACK, message.u.twi.addr, yes));
  };
  if ((what & TWI_COND_STOP) != 0) {
    if (board.addressed) board.device->stop(now_us);
    board.addressed = false;
  } else if ((what & TWI_COND_START) != 0) {
    const bool is_read = (message.u.twi.addr & 1) != 0;
    board.addressed =
        (message.u.twi.addr >> 1) == board.device_address && board.device->start(is_read, now_us);
    if (board.addressed) acknowledge(true);
  } else if (board.addressed && (what & TWI_COND_WRITE) != 0) {
    acknowledge(board.device->write(message.u.twi.data, now_us));
  } else if (board.addressed && (what & TWI_COND_READ) != 0) {
    avr_raise_irq(board.twi_input,
                  avr_twi_irq_msg(TWI_COND_READ, message.u.twi.addr, board.device->read(now_us)));
  }
  const uint32_t stretch_us = board.device->take_stretch_us();
  if (stretch_us != 0) board.twi_held_until = board.avr->cycle + stretch_us * (kHz / 1000000);
}

// The program drives SCL (PC5) by hand while the unit is off: nine pulses free a hung bus.
void port_c_direction(avr_irq_t*, uint32_t value, void* param) {
  avr_board& board = *static_cast<avr_board*>(param);
  const bool was_low = (board.twi_direction & 0x20) != 0;
  const bool is_low = (value & 0x20) != 0;
  board.twi_direction = static_cast<uint8_t>(value);
  if (!was_low || is_low) return;
  ++board.twi_clocks;
  if (board.device != nullptr) board.device->clock_pulse();
}

avr_cycle_count_t stop_here(avr_t* avr, avr_cycle_count_t, void* param) {
  (void)avr;
  static_cast<avr_board*>(param)->stop = true;
  return 0;
}

int run_one(avr_board& board, uint64_t until) {
  avr_t* avr = board.avr;
  if (avr->cycle >= until) return avr->state;
  board.stop = false;
  avr_cycle_timer_register(avr, until - avr->cycle, stop_here, &board);
  int state = avr->state;
  while (!board.stop && avr->cycle < until) {
    state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) break;
  }
  avr_cycle_timer_cancel(avr, stop_here, &board);
  return state;
}

}  // namespace

extern "C" {

avr_board* avr_board_new(const char* mcu, const char* elf_path) {
  avr_global_logger_set(be_quiet);
  avr_t* avr = avr_make_mcu_by_name(mcu);
  if (avr == nullptr) return nullptr;
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof(firmware));
  if (elf_read_firmware(elf_path, &firmware) != 0) return nullptr;
  avr_init(avr);
  firmware.frequency = kHz;
  snprintf(firmware.mmcu, sizeof(firmware.mmcu), "%s", mcu);
  avr_load_firmware(avr, &firmware);
  avr->frequency = kHz;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr->sleep = do_not_sleep;
  avr->run_cycle_limit = 50;

  avr_board* board = new avr_board;
  board->avr = avr;
  all_boards.push_back(board);
  for (avr_io_t* io = avr->io_port; io != nullptr; io = io->next) {
    if (strcmp(io->kind, "twi") == 0) board->twi = reinterpret_cast<avr_twi_t*>(io);
    if (strcmp(io->kind, "watchdog") == 0) board->watchdog = reinterpret_cast<avr_watchdog_t*>(io);
    if (strcmp(io->kind, "uart") != 0) continue;
    avr_uart_t* unit = reinterpret_cast<avr_uart_t*>(io);
    const int port = unit->name - '0';
    if (port < kUarts) board->uarts[port].unit = unit;
  }
  for (int port = 0; port < kUarts; ++port) {
    Uart& uart = board->uarts[port];
    uart.board = board;
    uart.port = port;
    if (uart.unit == nullptr) continue;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0' + port), &flags);
    flags &= ~static_cast<uint32_t>(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0' + port), &flags);
    uart.input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0' + port), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0' + port), UART_IRQ_OUTPUT), byte_sent,
                            &uart);
  }
  board->twi_input = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT), twi_message, board);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('C'), IOPORT_IRQ_DIRECTION_ALL),
                          port_c_direction, board);
  avr_irq_register_notify(avr_get_interrupt_irq(avr, AVR_INT_ANY) + AVR_INT_IRQ_RUNNING, interrupt_running,
                          board);
  for (int vector = 1; vector < kVectors; ++vector) {
    avr_irq_t* irq = avr_get_interrupt_irq(avr, static_cast<uint8_t>(vector));
    if (irq == nullptr) continue;
    board->pending[vector].board = board;
    avr_irq_register_notify(irq + AVR_INT_IRQ_PENDING, interrupt_pending, &board->pending[vector]);
  }
  avr_irq_register_notify(board->watchdog->watchdog.irq + AVR_INT_IRQ_PENDING, watchdog_first, board);
  avr_register_io_write(avr, kTurnRegister, turn_begins, board);
  avr_register_io_write(avr, kEecr, eeprom_control, board);
  avr_register_io_write(avr, kTwcr, twi_control, board);
  board->core_reset = avr->reset;
  avr->reset = board_resets;
  avr_board_reset(board, 1);
  board->resets = 0;
  return board;
}

void avr_board_free(avr_board* board) {
  for (size_t i = 0; i < all_boards.size(); ++i)
    if (all_boards[i] == board) all_boards.erase(all_boards.begin() + static_cast<long>(i));
  avr_terminate(board->avr);
  delete board;
}

// Runs n boards to `until`, none ever more than `quantum` cycles ahead of another.
int avr_board_run(avr_board** boards, int n, uint64_t until, uint32_t quantum) {
  for (;;) {
    uint64_t slowest = UINT64_MAX;
    for (int i = 0; i < n; ++i)
      if (boards[i]->avr->cycle < slowest) slowest = boards[i]->avr->cycle;
    if (slowest >= until) return 0;
    const uint64_t next = n == 1 || slowest + quantum > until ? until : slowest + quantum;
    for (int i = 0; i < n; ++i) {
      const int state = run_one(*boards[i], next);
      if (state == cpu_Done || state == cpu_Crashed) return state;
    }
  }
}

uint64_t avr_board_cycle(const avr_board* board) { return board->avr->cycle; }
uint32_t avr_board_resets(const avr_board* board) { return board->resets; }
uint64_t avr_board_last_reset(const avr_board* board) { return board->last_reset; }

// Power-on leaves random RAM, as the chip does; otherwise this is the reset button.
void avr_board_reset(avr_board* board, int power_on) {
  avr_t* avr = board->avr;
  if (power_on != 0) {
    uint32_t noise = 0x1234567;
    for (uint32_t address = avr->ioend + 1u; address <= avr->ramend; ++address) {
      noise = noise * 1664525 + 1013904223;
      avr->data[address] = static_cast<uint8_t>(noise >> 24);
    }
  }
  board->next_mcusr = power_on != 0 ? 0x01 : 0x02;
  avr_reset(avr);
}

// The program stops here: in a loop of one instruction, where its interrupts still run or not.
void avr_board_hang(avr_board* board, int interrupts_off) {
  avr_t* avr = board->avr;
  while (avr->sreg[S_I] == 0 || board->running_vector != 0) run_one(*board, avr->cycle + 1);
  heal(*board);
  board->hung_pc = avr->pc;
  memcpy(board->hung_code, avr->flash + avr->pc, sizeof(board->hung_code));
  avr->flash[avr->pc] = 0xFF;
  avr->flash[avr->pc + 1] = 0xCF;
  board->hung = true;
  if (interrupts_off != 0) avr->sreg[S_I] = 0;
}

void avr_uart_connect(avr_board* a, int a_port, avr_board* b, int b_port) {
  a->uarts[a_port].peer = &b->uarts[b_port];
  b->uarts[b_port].peer = &a->uarts[a_port];
}

void avr_uart_send(avr_board* board, int port, const uint8_t* bytes, uint32_t n, uint64_t at) {
  Uart& uart = board->uarts[port];
  for (uint32_t i = 0; i < n; ++i) uart.coming.push_back(Byte{bytes[i], at});
  arm_receiver(uart);
}

uint32_t avr_uart_receive(avr_board* board, int port, uint8_t* bytes, uint64_t* stamps, uint32_t capacity) {
  std::deque<Byte>& sent = board->uarts[port].sent;
  uint32_t n = 0;
  for (; n < capacity && !sent.empty(); ++n) {
    bytes[n] = sent.front().value;
    stamps[n] = sent.front().at;
    sent.pop_front();
  }
  return n;
}

uint32_t avr_uart_overruns(const avr_board* board, int port) { return board->uarts[port].overruns; }

void avr_adc_code(avr_board* board, int channel, uint32_t code) {
  const uint32_t millivolts = (code * 5000 + 1022) / 1023;
  avr_raise_irq(avr_io_getirq(board->avr, AVR_IOCTL_ADC_GETIRQ, channel), millivolts);
}

// Also told to simavr as the level from outside, or it would put its own there whenever a pull-up is switched.
void avr_pin_set(avr_board* board, char port, int bit, int level) {
  uint8_t& mask = board->driven[port - 'A'];
  uint8_t& levels = board->levels[port - 'A'];
  mask = static_cast<uint8_t>(mask | 1u << bit);
  levels = static_cast<uint8_t>(level != 0 ? levels | 1u << bit : levels & ~(1u << bit));
  avr_ioport_external_t external = {};
  external.name = static_cast<unsigned long>(port) & 0x7F;
  external.mask = mask;
  external.value = levels;
  avr_ioctl(board->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &external);
  avr_raise_irq(avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), static_cast<uint32_t>(level));
}

// Events must be added in the order of their times.
void avr_pin_at(avr_board* board, uint64_t cycle, char port, int bit, int level) {
  board->pin_events.push_back(PinEvent{cycle, port, bit, level});
  if (board->pin_timer_set) return;
  board->pin_timer_set = true;
  const uint64_t now = board->avr->cycle;
  avr_cycle_timer_register(board->avr, cycle > now ? cycle - now : 1, apply_pins, board);
}

int avr_pin_watch(avr_board* board, char port, int bit) {
  board->watches.push_back(Watch{board, {}, 0});
  avr_irq_register_notify(avr_io_getirq(board->avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), pin_changed,
                          &board->watches.back());
  return static_cast<int>(board->watches.size()) - 1;
}

avr_pin avr_pin_read(const avr_board* board, int watch) {
  return board->watches[static_cast<size_t>(watch)].pin;
}

int avr_eeprom(avr_board* board, int write, uint32_t offset, uint8_t* bytes, uint32_t n) {
  avr_eeprom_desc_t request = {};
  request.ee = bytes;
  request.offset = static_cast<uint16_t>(offset);
  request.size = n;
  return avr_ioctl(board->avr, write != 0 ? AVR_IOCTL_EEPROM_SET : AVR_IOCTL_EEPROM_GET, &request);
}

uint8_t avr_peek(const avr_board* board, uint16_t address) { return board->avr->data[address]; }
void avr_poke(avr_board* board, uint16_t address, uint8_t value) { board->avr->data[address] = value; }
avr_isr avr_isr_read(const avr_board* board, int vector) { return board->isrs[vector & (kVectors - 1)]; }
void avr_isr_clear(avr_board* board) { memset(board->isrs, 0, sizeof(board->isrs)); }
void avr_turns_clear(avr_board* board) { board->turns.clear(); }

// The latest ones; returns how many.
uint32_t avr_turns_read(const avr_board* board, uint32_t* cycles, uint32_t capacity) {
  const std::vector<uint32_t>& turns = board->turns;
  const size_t n = turns.size() < capacity ? turns.size() : capacity;
  memcpy(cycles, turns.data() + (turns.size() - n), n * sizeof(uint32_t));
  return static_cast<uint32_t>(n);
}

void avr_bno055_add(avr_board* board, int address) {
  board->device.reset(new Bno055Device(static_cast<uint8_t>(address)));
  board->device_address = address;
}

void avr_bno055_motion(avr_board* board, const double* accel_mps2, const double* gyro_radps,
                       const double* mag_ut) {
  board->device->chip().set_motion(accel_mps2, gyro_radps, mag_ut, 25.0);
}

void avr_bno055_faults(avr_board* board, uint32_t faults) { board->device->chip().set_faults(faults); }

void avr_bno055_stretch(avr_board* board, double probability, uint32_t longest_us) {
  board->device->chip().set_stretch(probability, longest_us);
}

void avr_bno055_dither(avr_board* board, double counts_rms) { board->device->chip().set_dither(counts_rms); }

uint32_t avr_twi_clocks(const avr_board* board) { return board->twi_clocks; }

}  // extern "C"
