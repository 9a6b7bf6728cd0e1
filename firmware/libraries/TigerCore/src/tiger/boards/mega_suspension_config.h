// Numbers of mega_suspension that are not parameters. Reaction times follow the table in docs/mega_suspension.md.
#pragma once

#include <stdint.h>

namespace tiger {
namespace suspension {

// SAFETY: reaction times.
constexpr uint16_t kSetpointMaxAgeMs = 50;  // an older one is dropped
constexpr uint16_t kHoldAfterMs = 60;       // without an accepted setpoint: motion stopped
constexpr uint16_t kLinkLostAfterMs = 250;  // likewise: outputs off
constexpr uint8_t kEstopDebounceMs = 2;     // e-stop input steady this long
constexpr uint8_t kReadingsLostTicks = 5;   // control ticks without potentiometers

constexpr int16_t kSlewPerTick = 4700;        // um/s: a rate setpoint reaches full speed in two ticks
constexpr uint8_t kObserveTicks = 15;         // of the next, the observers run; before, they start afresh
constexpr uint8_t kSettleTicks = 20;          // the observers settle after boot
constexpr uint8_t kRawEveryTicks = 10;        // suspension_raw at 10 Hz
constexpr uint8_t kForwardBytesPerTurn = 64;  // bytes taken from the Nano in one turn of the main loop

}  // namespace suspension
}  // namespace tiger
