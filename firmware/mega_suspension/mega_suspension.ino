#include <TigerArduino.h>
#include <TigerCore.h>
#include <tiger/boards/mega_suspension.h>
#include <tiger_arduino/mega_suspension_hal.h>

static tiger::arduino::MegaSuspensionHal hal;
static tiger::MegaSuspension<tiger::arduino::MegaSuspensionHal> board(hal);

void setup() {
  hal.begin();  // outputs off before anything else
  board.begin();
}

void loop() {
  hal.mark_turn();
  board.poll();
}
