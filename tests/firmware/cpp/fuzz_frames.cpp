// Damaged frames into the receivers and into a whole mega_suspension, under the sanitizers.
//
// Every frame is damaged as lines damage them: flipped bits, bursts, lost, doubled and inserted bytes, two frames
// spliced. Prints how many were sent, damaged, and accepted although their body is not one that was sent.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <vector>

#include "native_suspension.h"
#include "tiger/frame.h"
#include "tiger/link.h"

using namespace tiger;
using Bytes = std::vector<uint8_t>;

namespace {

uint64_t seed = 1;
uint32_t below(uint32_t n) {
  seed = seed * 6364136223846793005ull + 1442695040888963407ull;
  return static_cast<uint32_t>((seed >> 33) % n);
}

const uint8_t kIds[] = {0x00, 0x02, 0x05, 0x06, 0x07, 0x09, 0x0A, 0x0B, 0x20, 0x23};

Bytes frame_of(Bytes& body) {
  const uint8_t id = kIds[below(sizeof(kIds))];
  const uint8_t size = wire::payload_size_to_board(wire::BoardKind::kMegaSuspension, id);
  uint8_t payload[wire::kMaxPayload];
  for (uint8_t i = 0; i < size; ++i) payload[i] = static_cast<uint8_t>(below(3) == 0 ? 0 : below(256));
  const uint8_t node_at = wire::node_offset(id);
  if (node_at != wire::kNoNode) payload[node_at] = static_cast<uint8_t>(below(2));
  const uint8_t seq = static_cast<uint8_t>(below(256));
  body = {id, seq};
  body.insert(body.end(), payload, payload + size);
  uint8_t bytes[kMaxFrame];
  const uint8_t n = encode_frame(id, seq, payload, size, bytes);
  return Bytes(bytes, bytes + n);
}

// `recent`: bodies that were sent; a splice sends a second one.
void damage(Bytes& frame, std::vector<Bytes>& recent) {
  const uint32_t at = below(static_cast<uint32_t>(frame.size()));
  switch (below(6)) {
    case 0:  // one to four bits
      for (uint32_t k = below(4) + 1; k > 0; --k)
        frame[below(static_cast<uint32_t>(frame.size()))] ^= 1 << below(8);
      break;
    case 1:  // a burst
      for (uint32_t i = at; i < frame.size() && i < at + 2 + below(5); ++i)
        frame[i] = static_cast<uint8_t>(below(256));
      break;
    case 2:  // lost bytes
      frame.erase(frame.begin() + at,
                  frame.begin() + at + below(static_cast<uint32_t>(frame.size() - at)) / 4 + 1);
      break;
    case 3:  // a doubled byte
      frame.insert(frame.begin() + at, frame[at]);
      break;
    case 4:  // an inserted byte
      frame.insert(frame.begin() + at, static_cast<uint8_t>(below(256)));
      break;
    default: {  // the rest of another frame
      Bytes other_body;
      const Bytes other = frame_of(other_body);
      frame.resize(at);
      recent.push_back(other_body);
      frame.insert(frame.end(), other.begin() + below(static_cast<uint32_t>(other.size())), other.end());
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  const long frames = argc > 1 ? atol(argv[1]) : 100000;
  FrameReceiver<FromHost<wire::BoardKind::kMegaSuspension>> receiver;
  NativeBoard<SuspensionHal, MegaSuspension> board(0, 7);
  SuspensionHal& pins = hal_of<SuspensionHal>(&board);
  const double pots[kCorners] = {500, 500, 500, 500};
  pins.set_inputs(pots, 0, 0, false);
  board.run(400000);
  long damaged = 0, good = 0, wrong = 0, moved = 0;
  uint8_t drain[4096];
  std::vector<Bytes> recent;
  for (long n = 0; n < frames; ++n) {
    Bytes body;
    Bytes frame = frame_of(body);
    const bool in_range =
        wire::payload_in_range_to_board(wire::BoardKind::kMegaSuspension, body[0], body.data() + kFrameHead);
    const bool is_damaged = below(10) != 0;
    recent.push_back(body);
    while (recent.size() > 8) recent.erase(recent.begin());
    if (is_damaged) {
      damage(frame, recent);
      ++damaged;
    }
    for (const uint8_t byte : frame) {
      if (!receiver.take(byte)) continue;
      const Frame& taken = receiver.frame();
      const Bytes seen(taken.body, taken.body + taken.body_size - kFrameCrc);
      bool known = false;
      for (const Bytes& sent : recent) known = known || sent == seen;
      known ? ++good : ++wrong;
    }
    if (!is_damaged && !in_range && receiver.rejects(wire::RejectCause::kRange) == 0) return 2;
    board.uart(n % 3 == 0)->arrive(frame.data(), static_cast<uint32_t>(frame.size()), pins.now_ns());
    board.run(1000);
    board.uart(0)->leave(drain, sizeof(drain), pins.now_ns());
    board.uart(1)->leave(drain, sizeof(drain), pins.now_ns());
    for (uint8_t corner = 0; corner < kCorners; ++corner) moved += pins.duty(corner) != 0.0;
  }
  printf("frames %ld\ndamaged %ld\ngood %ld\nwrong %ld\nmoved %ld\n", frames, damaged, good, wrong, moved);
  return 0;
}
