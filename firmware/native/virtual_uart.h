// One serial line as the chip sees it: bytes take their time, buffers are finite.
#pragma once

#include <stdint.h>

#include <deque>

namespace tiger {

class VirtualUart {
 public:
  static constexpr unsigned kReceiveBuffer = 128;  // of the receive interrupt; what comes on top is lost
  static constexpr unsigned kSendBuffer = 128;

  explicit VirtualUart(uint32_t baud) : byte_ns_(10000000000ull / baud) {}

  // ------------------------------------------------------------------------------- the far end of the line

  void arrive(const uint8_t* bytes, uint32_t n, uint64_t now_ns) {
    for (uint32_t i = 0; i < n; ++i) {
      line_in_ns_ = (line_in_ns_ > now_ns ? line_in_ns_ : now_ns) + byte_ns_;
      in_.push_back({line_in_ns_, bytes[i]});
    }
  }

  uint32_t leave(uint8_t* buffer, uint32_t capacity, uint64_t now_ns) {
    uint32_t n = 0;
    while (n < capacity && !out_.empty() && out_.front().at_ns <= now_ns) {
      buffer[n++] = out_.front().byte;
      out_.pop_front();
    }
    return n;
  }

  // ------------------------------------------------------------------------------------------ the program

  // The receive interrupt: moves what has arrived into the buffer, loses what does not fit.
  void advance(uint64_t now_ns) {
    while (!in_.empty() && in_.front().at_ns <= now_ns) {
      if (received_.size() < kReceiveBuffer) received_.push_back(in_.front().byte);
      in_.pop_front();
    }
  }

  bool read(uint8_t& byte) {
    if (received_.empty()) return false;
    byte = received_.front();
    received_.pop_front();
    return true;
  }

  uint8_t write_space(uint64_t now_ns) const {
    unsigned waiting = 0;
    for (auto it = out_.rbegin(); it != out_.rend() && it->at_ns > now_ns; ++it) ++waiting;
    return static_cast<uint8_t>(waiting < kSendBuffer ? kSendBuffer - waiting : 0);
  }

  void write(const uint8_t* bytes, uint8_t n, uint64_t now_ns) {
    for (uint8_t i = 0; i < n; ++i) {
      line_out_ns_ = (line_out_ns_ > now_ns ? line_out_ns_ : now_ns) + byte_ns_;
      out_.push_back({line_out_ns_, bytes[i]});
    }
  }

  // A reset of the chip: its buffers are lost, and bytes that had not left yet.
  void reset(uint64_t now_ns) {
    received_.clear();
    while (!out_.empty() && out_.back().at_ns > now_ns) out_.pop_back();
    line_out_ns_ = now_ns;
  }

 private:
  struct TimedByte {
    uint64_t at_ns;
    uint8_t byte;
  };

  uint64_t byte_ns_;
  uint64_t line_in_ns_ = 0;
  uint64_t line_out_ns_ = 0;
  std::deque<TimedByte> in_;
  std::deque<uint8_t> received_;
  std::deque<TimedByte> out_;
};

}  // namespace tiger
