// Constants that stay in flash on the AVR, which copies its constants to RAM unless told otherwise.
//
// Whoever takes a reference to such a constant hands it on as it is; whoever needs the value takes it by load(),
// as late as possible, so that the copy is on the stack for as short as possible.
#pragma once

#ifdef __AVR__
#include <avr/pgmspace.h>
#define TIGER_FLASH PROGMEM
#else
#define TIGER_FLASH
#endif

#include <string.h>

namespace tiger {

// A copy of a constant that was declared TIGER_FLASH.
template <class T>
inline T load(const T& stored) {
#ifdef __AVR__
  T copy;
  memcpy_P(&copy, &stored, sizeof(copy));
  return copy;
#else
  return stored;
#endif
}

}  // namespace tiger
