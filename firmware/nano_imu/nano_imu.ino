#include <TigerArduino.h>
#include <TigerCore.h>
#include <tiger/boards/nano_imu.h>
#include <tiger_arduino/nano_imu_hal.h>

static tiger::arduino::NanoImuHal hal;
static tiger::NanoImu<tiger::arduino::NanoImuHal> board(hal);

void setup() {
  hal.begin();  // outputs off before anything else
  board.begin();
}

void loop() {
  hal.mark_turn();
  board.poll();
}
