// Stroke from a potentiometer reading: straight lines between points at 0, 1/4, 1/2, 3/4 and all of the stroke.
#pragma once

#include <stdint.h>

#include "../hal.h"
#include "fixed.h"

namespace tiger {

constexpr uint16_t kMaxSum = kConversionsPerSum * 1023;

class PotCurve {
 public:
  static constexpr uint8_t kSegments = 4;
  static constexpr uint8_t kPoints = kSegments + 1;
  static constexpr uint16_t kMinSegment = 700;  // sums a segment must span: keeps the slope in 16 bits

  // Readings at the five strokes and the full stroke in wire counts. Falling readings (a potentiometer wired the other
  // way round) are as good as rising ones. False, and the curve unchanged, when they do not rise or fall steadily.
  bool set(const uint16_t readings[kPoints], uint16_t full_stroke) {
    const bool falls = readings[0] > readings[kSegments];
    uint16_t points[kPoints];
    for (uint8_t i = 0; i < kPoints; ++i) {
      if (readings[i] > kMaxSum) return false;
      points[i] = falls ? static_cast<uint16_t>(kMaxSum - readings[i]) : readings[i];
    }
    for (uint8_t i = 0; i < kSegments; ++i) {
      if (points[i + 1] < points[i] + kMinSegment) return false;
    }
    falls_ = falls;
    const int32_t segment = full_stroke * kUnitsPerWireCount / kSegments;
    for (uint8_t i = 0; i < kSegments; ++i) {
      readings_[i] = points[i];
      strokes_[i] = i * segment;
      const int32_t span = points[i + 1] - points[i];
      slopes_[i] = static_cast<uint16_t>((segment * 16 + span / 2) / span);
    }
    lowest_ = points[0] / 2;
    highest_ = static_cast<uint16_t>(points[kSegments] + (kMaxSum - points[kSegments]) / 2);
    return true;
  }

  // Half-way between the calibrated range and the rail it is open or shorted.
  bool in_range(uint16_t reading) const {
    const uint16_t point = upright(reading);
    return point >= lowest_ && point <= highest_;
  }

  // In units of 10 nm; the end segments go on beyond the ends.
  int32_t stroke(uint16_t reading) const {
    const uint16_t point = upright(reading);
    uint8_t i = 0;
    while (i + 1 < kSegments && point >= readings_[i + 1]) ++i;
    const int16_t above = static_cast<int16_t>(point - readings_[i]);
    return strokes_[i] + ((static_cast<int32_t>(above) * slopes_[i]) >> 4);
  }

 private:
  uint16_t upright(uint16_t reading) const {
    return falls_ ? static_cast<uint16_t>(kMaxSum - reading) : reading;
  }

  uint16_t readings_[kSegments] = {};
  uint16_t slopes_[kSegments] = {};  // 10 nm per sum, Q4
  int32_t strokes_[kSegments] = {};
  uint16_t lowest_ = 0;
  uint16_t highest_ = 0;
  bool falls_ = false;
};

}  // namespace tiger
