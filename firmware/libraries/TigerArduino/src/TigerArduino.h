// What the Arduino IDE includes to find this library; a sketch includes it first, then the Hal of its board:
//   tiger_arduino/mega_suspension_hal.h, tiger_arduino/nano_imu_hal.h or tiger_arduino/mega_speed_hal.h.
// A Hal defines interrupt handlers, so exactly one of them belongs in a program, in one source file.
#pragma once

// The IDE puts Arduino.h before every sketch; these of its macros would replace ordinary names in our headers.
#undef abs
#undef bit
#undef constrain
#undef degrees
#undef max
#undef min
#undef radians
#undef round
#undef sq
