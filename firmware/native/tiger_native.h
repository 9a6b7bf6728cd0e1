// Boards on the PC: the firmware's own templates over virtual pins, as C functions.
//
// Time only passes in tiger_board_run. All state is in the board: any number of them may run side by side. The
// particular pins of each board are in native_<board>_api.h. Every header here holds plain C declarations and is read
// by host/tiger/native/build.py as well as by the compiler.
#pragma once

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct tiger_board tiger_board;

// kind: wire::BoardKind; instance: strap; uid: written into the blank EEPROM. Null for a kind that is not built in.
tiger_board* tiger_board_new(uint8_t kind, uint8_t instance, uint32_t uid);
void tiger_board_free(tiger_board* board);

// Reset with this MCUSR (1 power-on, 2 external, 4 brown-out, 8 watchdog): RAM and outputs are lost, EEPROM is kept,
// .noinit too except at power-on. A byte being written to EEPROM is lost at power-on and brown-out.
void tiger_board_reset(tiger_board* board, uint8_t mcusr);

// Lets this much time pass. The program's main loop takes 250 us for each turn, or what tiger_board_turn says.
void tiger_board_run(tiger_board* board, uint32_t us);
void tiger_board_turn(tiger_board* board, uint32_t us);

// The program stops in its tracks, until the watchdog resets the board.
void tiger_board_hang(tiger_board* board, uint8_t interrupts_off);

// Port 0 leads to the host (on the Nano: to the Mega), port 1 on mega_suspension to the Nano. Bytes travel at the baud
// rate of the line: written ones arrive one after the other, the first not before `delay_us` and its time on the line
// have passed; read ones have had their stop bit.
void tiger_uart_write(tiger_board* board, uint8_t port, const uint8_t* bytes, uint32_t n, uint32_t delay_us);
uint32_t tiger_uart_read(tiger_board* board, uint8_t port, uint8_t* buffer, uint32_t capacity);

// The board's resonator is off by this much; and its clock starts at this reading after the next reset.
void tiger_clock_ppm(tiger_board* board, double ppm);
void tiger_clock_start(tiger_board* board, uint32_t us);
uint32_t tiger_clock_micros(tiger_board* board);

uint8_t* tiger_eeprom(tiger_board* board);
uint32_t tiger_eeprom_size(tiger_board* board);

#ifdef __cplusplus
}
#endif
