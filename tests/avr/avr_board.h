// SPDX-License-Identifier: GPL-3.0-or-later
// The functions Python calls (cffi reads this file). Times are CPU cycles of 16 MHz since power-on.
typedef struct avr_board avr_board;
typedef struct {
  uint32_t count;
  uint64_t total_cycles;
  uint32_t max_cycles;
  uint32_t max_wait_cycles;  // from the event to the entry
  uint32_t wait_pc;          // where the program was at that event
} avr_isr;
typedef struct {
  uint32_t rises, falls;
  uint64_t high_cycles, last_change;
  int level;
} avr_pin;

avr_board* avr_board_new(const char* mcu, const char* elf_path);
void avr_board_free(avr_board* board);
int avr_board_run(avr_board** boards, int n, uint64_t until, uint32_t quantum);
uint64_t avr_board_cycle(const avr_board* board);
uint32_t avr_board_resets(const avr_board* board);
uint64_t avr_board_last_reset(const avr_board* board);
void avr_board_reset(avr_board* board, int power_on);
void avr_board_hang(avr_board* board, int interrupts_off);

void avr_uart_connect(avr_board* a, int a_port, avr_board* b, int b_port);
void avr_uart_send(avr_board* board, int port, const uint8_t* bytes, uint32_t n, uint64_t at);
uint32_t avr_uart_receive(avr_board* board, int port, uint8_t* bytes, uint64_t* stamps, uint32_t capacity);
uint32_t avr_uart_overruns(const avr_board* board, int port);

void avr_adc_code(avr_board* board, int channel, uint32_t code);
void avr_pin_set(avr_board* board, char port, int bit, int level);
void avr_pin_at(avr_board* board, uint64_t cycle, char port, int bit, int level);
int avr_pin_watch(avr_board* board, char port, int bit);
avr_pin avr_pin_read(const avr_board* board, int watch);

int avr_eeprom(avr_board* board, int write, uint32_t offset, uint8_t* bytes, uint32_t n);
uint8_t avr_peek(const avr_board* board, uint16_t address);
void avr_poke(avr_board* board, uint16_t address, uint8_t value);
avr_isr avr_isr_read(const avr_board* board, int vector);
void avr_isr_clear(avr_board* board);
uint32_t avr_turns_read(const avr_board* board, uint32_t* cycles, uint32_t capacity);
void avr_turns_clear(avr_board* board);

void avr_bno055_add(avr_board* board, int address);
void avr_bno055_motion(avr_board* board, const double* accel_mps2, const double* gyro_radps,
                       const double* mag_ut);
void avr_bno055_faults(avr_board* board, uint32_t faults);
void avr_bno055_stretch(avr_board* board, double probability, uint32_t longest_us);
void avr_bno055_dither(avr_board* board, double counts_rms);
uint32_t avr_twi_clocks(const avr_board* board);
