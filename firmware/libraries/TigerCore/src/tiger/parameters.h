// Parameters of a board: values in RAM, two copies in EEPROM.
//
// EEPROM, little-endian:
//   0   identity (identity.h)
//   16  copy A       16 + kSlotBytes  copy B
// A copy is: format u8, count u8, generation u16, values i32[count], CRC-32 of all that. Saving overwrites the older
// copy, a byte at a time, so that a loss of power at any moment leaves the newer one whole; loading takes the newest
// good copy. Only when there is none, and the EEPROM is not blank either, are the parameters damaged.
#pragma once

#include <stdint.h>

#include "protocol.h"

namespace tiger {

constexpr uint16_t kEepromSlots = 16;
constexpr uint8_t kParameterFormat = 1;  // one more when indices change their meaning

// CRC-32 (IEEE 802.3), bit by bit: it runs only at boot and, a byte per EEPROM write, while saving.
constexpr uint32_t kCrc32Start = 0xFFFFFFFF;
inline uint32_t crc32_update(uint32_t crc, uint8_t byte) {
  crc ^= byte;
  for (uint8_t k = 0; k < 8; ++k) crc = (crc & 1) != 0 ? (crc >> 1) ^ 0xEDB88320 : crc >> 1;
  return crc;
}

enum class StoreState : uint8_t {
  Blank,    // never saved: defaults are in force
  Loaded,   // a stored copy is in force
  Damaged,  // copies are there but none is good: defaults are in force; or the last save failed
};

template <wire::BoardKind kKind, uint8_t kCount>
class Parameters {
 public:
  static constexpr uint8_t kHeadBytes = 4;
  static constexpr uint16_t kDataBytes = kHeadBytes + 4 * kCount;
  static constexpr uint16_t kSlotBytes = kDataBytes + 4;

  template <class Hal>
  void load(Hal& hal) {
    const SlotState a = inspect(hal, 0);
    const SlotState b = inspect(hal, 1);
    state_ = a.good || b.good     ? StoreState::Loaded
             : a.blank && b.blank ? StoreState::Blank
                                  : StoreState::Damaged;
    slot_ = b.good && (!a.good || static_cast<int16_t>(b.generation - a.generation) > 0) ? 1 : 0;
    generation_ = slot_ == 1 ? b.generation : a.good ? a.generation : 0;
    for (uint8_t i = 0; i < kCount; ++i) {
      const int32_t stored =
          state_ == StoreState::Loaded ? read_value(hal, i) : wire::param_default(kKind, i);
      values_[i] = in_limits(i, stored) ? stored : wire::param_default(kKind, i);
    }
  }

  int32_t get(uint8_t index) const { return values_[index]; }
  StoreState state() const { return state_; }
  bool saving() const { return cursor_ < kSaved; }

  wire::AckStatus set(uint8_t index, int32_t value) {
    if (index >= kCount) return wire::AckStatus::kBadIndex;
    if (saving()) return wire::AckStatus::kBusy;
    if (!in_limits(index, value)) return wire::AckStatus::kOutOfRange;
    values_[index] = value;
    return wire::AckStatus::kOk;
  }

  // Begins to store; poll() does the rest, about 0.2 s.
  wire::AckStatus save() {
    if (saving()) return wire::AckStatus::kBusy;
    slot_ ^= 1;
    ++generation_;
    cursor_ = 0;
    crc_ = kCrc32Start;
    return wire::AckStatus::kOk;
  }

  // Writes at most one byte; reads the copy back after the last. True in the one call in which a save ends.
  template <class Hal>
  bool poll(Hal& hal) {
    if (!saving() || !hal.eeprom_ready()) return false;
    if (cursor_ == kSlotBytes) {
      state_ = inspect(hal, slot_).good ? StoreState::Loaded : StoreState::Damaged;
      cursor_ = kSaved;
      return true;
    }
    const uint8_t byte = byte_at(cursor_);
    if (cursor_ < kDataBytes) crc_ = crc32_update(crc_, byte);
    const uint16_t address = static_cast<uint16_t>(slot_address(slot_) + cursor_);
    if (hal.eeprom_read(address) != byte) hal.eeprom_write(address, byte);  // spares cells that are right
    ++cursor_;
    return false;
  }

 private:
  static constexpr uint16_t kSaved = kSlotBytes + 1;

  struct SlotState {
    bool good;
    bool blank;
    uint16_t generation;
  };

  static bool in_limits(uint8_t index, int32_t value) {
    return value >= wire::param_min(kKind, index) && value <= wire::param_max(kKind, index);
  }

  static uint16_t slot_address(uint8_t slot) {
    return static_cast<uint16_t>(kEepromSlots + slot * kSlotBytes);
  }

  uint8_t byte_at(uint16_t at) const {
    if (at == 0) return kParameterFormat;
    if (at == 1) return kCount;
    if (at < kHeadBytes) return static_cast<uint8_t>(generation_ >> (8 * (at - 2)));
    const uint32_t word = at < kDataBytes ? static_cast<uint32_t>(values_[(at - kHeadBytes) / 4]) : ~crc_;
    return static_cast<uint8_t>(word >> (8 * (at % 4)));
  }
  static_assert(kHeadBytes % 4 == 0, "byte_at relies on aligned words");

  template <class Hal>
  SlotState inspect(Hal& hal, uint8_t slot) const {
    const uint16_t base = slot_address(slot);
    uint32_t crc = kCrc32Start;
    uint32_t stored = 0;
    bool blank = true;
    for (uint16_t at = 0; at < kSlotBytes; ++at) {
      const uint8_t byte = hal.eeprom_read(static_cast<uint16_t>(base + at));
      blank = blank && byte == 0xFF;
      if (at < kDataBytes) {
        crc = crc32_update(crc, byte);
      } else {
        stored |= static_cast<uint32_t>(byte) << (8 * (at - kDataBytes));
      }
    }
    SlotState found;
    found.blank = blank;
    found.good = stored == ~crc && hal.eeprom_read(base) == kParameterFormat &&
                 hal.eeprom_read(static_cast<uint16_t>(base + 1)) == kCount;
    found.generation = static_cast<uint16_t>(hal.eeprom_read(static_cast<uint16_t>(base + 2)) |
                                             hal.eeprom_read(static_cast<uint16_t>(base + 3)) << 8);
    return found;
  }

  template <class Hal>
  int32_t read_value(Hal& hal, uint8_t index) const {
    const uint16_t address = static_cast<uint16_t>(slot_address(slot_) + kHeadBytes + 4 * index);
    uint32_t word = 0;
    for (uint8_t k = 0; k < 4; ++k) {
      word |= static_cast<uint32_t>(hal.eeprom_read(static_cast<uint16_t>(address + k))) << (8 * k);
    }
    return static_cast<int32_t>(word);
  }

  int32_t values_[kCount];
  uint32_t crc_ = 0;
  uint16_t generation_ = 0;
  uint16_t cursor_ = kSaved;
  uint8_t slot_ = 0;  // the copy in force; while saving, the one being written
  StoreState state_ = StoreState::Blank;
};

}  // namespace tiger
