// Frames: 00 | COBS(id, seq, payload, crc16) | 00, with CRC-16/X-25 sent low byte first.
//
// The receiver checks in the order of wire::RejectCause and counts every refusal by its cause. A delimiter stands
// before and after each frame, so a damaged frame never takes its neighbour along.
#pragma once

#include <stdint.h>
#include <string.h>

#ifdef __AVR__
#include <util/crc16.h>
#endif

#include "protocol.h"

namespace tiger {

constexpr uint8_t kFrameHead = 2;  // id, seq
constexpr uint8_t kFrameCrc = 2;   // low byte first
constexpr uint8_t kMaxBody = kFrameHead + wire::kMaxPayload + kFrameCrc;
constexpr uint8_t kMaxChunk = kMaxBody + 1;  // COBS adds one byte below 255
constexpr uint8_t kMinChunk = kFrameHead + kFrameCrc + 1;
constexpr uint8_t kMaxFrame = kMaxChunk + 2;  // and the two delimiters
static_assert(kMaxFrame <= 64, "a frame must fit into a 64-byte UART buffer");

// One byte more of CRC-16/X-25 before its final inversion; start with kCrcStart.
constexpr uint16_t kCrcStart = 0xFFFF;
#ifdef __AVR__
inline uint16_t crc_update(uint16_t crc, uint8_t byte) { return _crc_ccitt_update(crc, byte); }
#else
inline uint16_t crc_update(uint16_t crc, uint8_t byte) {
  uint16_t t = static_cast<uint16_t>(byte ^ (crc & 0xFF));
  t = static_cast<uint16_t>((t ^ (t << 4)) & 0xFF);
  return static_cast<uint16_t>(((t << 8) | (crc >> 8)) ^ (t >> 4) ^ (t << 3));
}
#endif

inline uint16_t crc16_x25(const uint8_t* bytes, uint8_t n) {
  uint16_t crc = kCrcStart;
  for (uint8_t i = 0; i < n; ++i) crc = crc_update(crc, bytes[i]);
  return static_cast<uint16_t>(~crc);
}

// COBS of `body` between two delimiters; returns the length of the frame.
inline uint8_t frame_body(const uint8_t* body, uint8_t n, uint8_t out[kMaxFrame]) {
  uint8_t code_at = 1;
  uint8_t at = 2;
  out[0] = 0;
  for (uint8_t i = 0; i < n; ++i) {
    if (body[i] != 0) {
      out[at] = body[i];
    } else {
      out[code_at] = static_cast<uint8_t>(at - code_at);
      code_at = at;
    }
    ++at;
  }
  out[code_at] = static_cast<uint8_t>(at - code_at);
  out[at++] = 0;
  return at;
}

inline uint8_t encode_frame(uint8_t id, uint8_t seq, const uint8_t* payload, uint8_t size,
                            uint8_t out[kMaxFrame]) {
  uint8_t body[kMaxBody];
  body[0] = id;
  body[1] = seq;
  memcpy(body + kFrameHead, payload, size);
  const uint8_t n = static_cast<uint8_t>(kFrameHead + size);
  const uint16_t crc = crc16_x25(body, n);
  body[n] = static_cast<uint8_t>(crc & 0xFF);
  body[n + 1] = static_cast<uint8_t>(crc >> 8);
  return frame_body(body, static_cast<uint8_t>(n + kFrameCrc), out);
}

// Decodes COBS in place; returns the length of the body, 0 when it is not COBS.
inline uint8_t cobs_decode(uint8_t* chunk, uint8_t n) {
  uint8_t read = 0;
  uint8_t written = 0;
  while (read < n) {
    const uint8_t code = chunk[read++];
    if (code == 0 || code - 1 > n - read) return 0;
    for (uint8_t k = 1; k < code; ++k) {
      if (chunk[read] == 0) return 0;
      chunk[written++] = chunk[read++];
    }
    if (read < n && code != 0xFF) chunk[written++] = 0;
  }
  return written;
}

// A frame that passed every check. It lives in its receiver until the next byte is taken.
struct Frame {
  const uint8_t* body;  // id, seq, payload, crc
  uint8_t body_size;

  uint8_t id() const { return body[0]; }
  uint8_t seq() const { return body[1]; }
  const uint8_t* payload() const { return body + kFrameHead; }

  // Copies the payload; only for the message whose id the frame has.
  template <class Message>
  Message as() const {
    Message message;
    memcpy(&message, payload(), sizeof(message));
    return message;
  }
};

// Bytes in, checked frames out. `Dictionary` knows one direction of one wire:
//   static uint8_t payload_size(uint8_t id);                        wire::kNoSuchId when unknown
//   static bool payload_in_range(uint8_t id, const uint8_t*);
template <class Dictionary>
class FrameReceiver {
 public:
  // Takes one byte; true when it completed a good frame, which frame() then holds.
  bool take(uint8_t byte) {
    if (byte != 0) {
      if (length_ < kMaxChunk) chunk_[length_] = byte;
      if (length_ <= kMaxChunk) ++length_;  // kMaxChunk + 1 stands for "too long"
      return false;
    }
    const uint8_t length = length_;
    length_ = 0;
    return length != 0 && check(length);
  }

  const Frame& frame() const { return frame_; }
  uint16_t rejects(wire::RejectCause cause) const { return rejects_[static_cast<uint8_t>(cause)]; }

 private:
  bool check(uint8_t length) {
    if (length < kMinChunk || length > kMaxChunk) return reject(wire::RejectCause::kLength);
    const uint8_t n = cobs_decode(chunk_, length);
    if (n < kFrameHead + kFrameCrc) return reject(wire::RejectCause::kDecode);
    const uint8_t size = Dictionary::payload_size(chunk_[0]);
    if (size == wire::kNoSuchId) return reject(wire::RejectCause::kUnknownId);
    if (n != kFrameHead + size + kFrameCrc) return reject(wire::RejectCause::kSize);
    const uint16_t crc = crc16_x25(chunk_, static_cast<uint8_t>(n - kFrameCrc));
    if (chunk_[n - 2] != (crc & 0xFF) || chunk_[n - 1] != crc >> 8) return reject(wire::RejectCause::kCrc);
    if (!Dictionary::payload_in_range(chunk_[0], chunk_ + kFrameHead))
      return reject(wire::RejectCause::kRange);
    frame_.body = chunk_;
    frame_.body_size = n;
    return true;
  }

  bool reject(wire::RejectCause cause) {
    uint16_t& count = rejects_[static_cast<uint8_t>(cause)];
    if (count != UINT16_MAX) ++count;
    return false;
  }

  uint8_t chunk_[kMaxChunk];
  uint8_t length_ = 0;
  Frame frame_ = {chunk_, 0};
  uint16_t rejects_[wire::kRejectCauseCount] = {};
};

}  // namespace tiger
