// Constants of mega_speed. What a user may change is a parameter (protocol/tiger.toml) instead.
#pragma once

#include <stdint.h>

namespace tiger {
namespace speed_config {

constexpr uint8_t kWheels = 2;                // front, rear
constexpr uint32_t kObservePeriod_us = 1000;  // edges are taken over from the interrupt
constexpr uint32_t kReportPeriod_us = 10000;  // speed, diagnosis, telemetry, watchdog

// One of the two signals does not change: so many crossings of one and the same edge in a row. A wheel that
// trembles at rest does that too, for as long as it stands, so the other wheel of the side decides: it has moved on
// by two teeth meanwhile.
constexpr uint8_t kDeadCrossings = 12;
constexpr uint8_t kDeadOtherEdges = 8;

// The two wheels of a side turn opposite ways for so many edges, both faster than a crawl: one pair of signals is
// swapped or one motor reversed.
constexpr uint8_t kOppositeEdges = 16;
constexpr float kCrawl_radps = 1.0f;

// Skipped states: so many since the last report in which the count of them stood still for a second.
constexpr uint8_t kIllegalLimit = 8;
constexpr uint8_t kCleanReports = 100;

}  // namespace speed_config
}  // namespace tiger
