// Version of the firmware; the build passes the revision it was made from.
#pragma once

#include <stdint.h>

#ifndef TIGER_GIT
#define TIGER_GIT 0  // first four bytes of the revision; 0: built by the Arduino IDE, which does not know it
#endif
#ifndef TIGER_DIRTY
#define TIGER_DIRTY 1  // 1 when the sources differ from that revision
#endif

namespace tiger {

constexpr uint8_t kVersionMajor = 0;
constexpr uint8_t kVersionMinor = 1;
constexpr uint8_t kVersionPatch = 0;

}  // namespace tiger
