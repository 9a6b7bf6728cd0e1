// Who this very board is: an identity it keeps for life, and how often it has booted.
//
// EEPROM, little-endian: 0 board_uid u32, 4 boot_count u16. Written a byte at a time while the board runs.
#pragma once

#include <stdint.h>

namespace tiger {

constexpr uint32_t kBlankUid = 0xFFFFFFFF;

class Identity {
 public:
  template <class Hal>
  void load(Hal& hal) {
    for (uint8_t at = 0; at < kBytes; ++at) bytes_[at] = hal.eeprom_read(at);
    const uint16_t boots = static_cast<uint16_t>(boot_count() + 1);  // a blank EEPROM counts from 0
    bytes_[4] = static_cast<uint8_t>(boots & 0xFF);
    bytes_[5] = static_cast<uint8_t>(boots >> 8);
    cursor_ = 0;
  }

  // A new board draws its identity from the moment it is first spoken to, which no two boards share.
  void name(uint32_t chance) {
    if (uid() != kBlankUid) return;
    for (uint8_t at = 0; at < 4; ++at) {
      chance = chance * 1664525 + 1013904223;
      bytes_[at] = static_cast<uint8_t>(chance >> 24);
    }
    cursor_ = 0;
  }

  template <class Hal>
  void poll(Hal& hal) {
    if (cursor_ == kBytes || !hal.eeprom_ready()) return;
    if (hal.eeprom_read(cursor_) != bytes_[cursor_]) hal.eeprom_write(cursor_, bytes_[cursor_]);
    ++cursor_;
  }

  uint32_t uid() const {
    uint32_t uid = 0;
    for (uint8_t at = 4; at > 0; --at) uid = uid << 8 | bytes_[at - 1];
    return uid;
  }
  uint16_t boot_count() const { return static_cast<uint16_t>(bytes_[4] | bytes_[5] << 8); }
  bool storing() const { return cursor_ != kBytes; }

 private:
  static constexpr uint8_t kBytes = 6;

  uint8_t bytes_[kBytes] = {};
  uint8_t cursor_ = kBytes;
};

}  // namespace tiger
