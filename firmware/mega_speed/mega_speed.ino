#include <TigerArduino.h>
#include <TigerCore.h>
#include <tiger/boards/mega_speed.h>
#include <tiger_arduino/mega_speed_hal.h>

static tiger::arduino::MegaSpeedHal hal;
static tiger::MegaSpeed<tiger::arduino::MegaSpeedHal> board(hal);

void setup() {
  hal.begin();  // outputs off before anything else
  board.begin();
}

void loop() {
  hal.mark_turn();
  board.poll();
}
