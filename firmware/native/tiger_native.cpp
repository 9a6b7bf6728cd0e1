#include "tiger_native.h"

#include "native_suspension.h"
#if __has_include("native_imu.h")
#include "native_imu.h"
#define TIGER_HAS_IMU
#endif
#if __has_include("native_speed.h")
#include "native_speed.h"
#define TIGER_HAS_SPEED
#endif

using tiger::wire::BoardKind;

tiger_board* tiger_board_new(uint8_t kind, uint8_t instance, uint32_t uid) {
  switch (static_cast<BoardKind>(kind)) {
    case BoardKind::kMegaSuspension:
      return tiger::new_suspension(instance, uid);
#ifdef TIGER_HAS_IMU
    case BoardKind::kNanoImu:
      return tiger::new_imu(instance, uid);
#endif
#ifdef TIGER_HAS_SPEED
    case BoardKind::kMegaSpeed:
      return tiger::new_speed(instance, uid);
#endif
    default:
      return nullptr;
  }
}

void tiger_board_free(tiger_board* board) { delete board; }
void tiger_board_reset(tiger_board* board, uint8_t mcusr) { board->reset(mcusr); }
void tiger_board_run(tiger_board* board, uint32_t us) { board->run(us); }
void tiger_board_turn(tiger_board* board, uint32_t us) { board->set_turn(us); }
void tiger_board_hang(tiger_board* board, uint8_t interrupts_off) { board->hang(interrupts_off != 0); }

void tiger_uart_write(tiger_board* board, uint8_t port, const uint8_t* bytes, uint32_t n, uint32_t delay_us) {
  tiger::VirtualUart* uart = board->uart(port);
  if (uart != nullptr) uart->arrive(bytes, n, board->hal().now_ns() + uint64_t{delay_us} * 1000);
}

uint32_t tiger_uart_read(tiger_board* board, uint8_t port, uint8_t* buffer, uint32_t capacity) {
  tiger::VirtualUart* uart = board->uart(port);
  return uart != nullptr ? uart->leave(buffer, capacity, board->hal().now_ns()) : 0;
}

void tiger_clock_ppm(tiger_board* board, double ppm) { board->hal().set_clock_ppm(ppm); }
void tiger_clock_start(tiger_board* board, uint32_t us) { board->hal().set_clock_start(us); }
uint32_t tiger_clock_micros(tiger_board* board) { return board->hal().micros(); }
uint8_t* tiger_eeprom(tiger_board* board) { return board->hal().eeprom().data(); }
uint32_t tiger_eeprom_size(tiger_board* board) { return static_cast<uint32_t>(board->hal().eeprom().size()); }
