// What the Arduino IDE includes to find this library. A sketch then includes the header of its own board.
#pragma once

#include "tiger/hal.h"
