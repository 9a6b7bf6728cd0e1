"""How fast frames become messages and messages frames, beside pymavlink where that is installed.

    python bench/codec.py

One IMU message each: ours with 14 numbers and a time (imu_attitude, 32 bytes), MAVLink's ATTITUDE (28 bytes).
Best of several runs on one core. A live robot sends about 650 frames a second, so this matters for logs and
emulation.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from tiger.protocol.frame import FrameDecoder, encode_message
from tiger.protocol.messages import FROM_BOARD, BoardKind, ImuAttitude

FRAMES = 20_000
CHUNK_BYTES = 4096
RUNS = 5

MESSAGE = ImuAttitude(
    1_000_000, (1.0, 0.0, 0.0, 0.0), (0.1, -0.2, 0.3), (1.0, 2.0, -3.0), (0.01, 0.02, 9.8), 0x1F
)


def best_rate(work: Callable[[], object]) -> float:
    """Frames per second of the quickest of several runs over FRAMES of them."""
    quickest_s = float("inf")
    for _ in range(RUNS):
        start_s = time.process_time()
        work()
        quickest_s = min(quickest_s, time.process_time() - start_s)
    return FRAMES / quickest_s


def chunks(stream: bytes) -> list[bytes]:
    """The stream in pieces as a port hands them over."""
    return [stream[start : start + CHUNK_BYTES] for start in range(0, len(stream), CHUNK_BYTES)]


def ours() -> tuple[float, float]:
    """Encode and decode rates of this project."""
    stream = b"".join(encode_message(MESSAGE, seq) for seq in range(FRAMES))

    def encode() -> None:
        for seq in range(FRAMES):
            encode_message(MESSAGE, seq)

    def decode() -> None:
        decoder = FrameDecoder(FROM_BOARD[BoardKind.NANO_IMU])
        assert sum(len(decoder.feed(chunk)) for chunk in chunks(stream)) == FRAMES

    return best_rate(encode), best_rate(decode)


def mavlink() -> tuple[float, float] | None:
    """The same of pymavlink; None when it is not installed."""
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        return None
    sender = common.MAVLink(None, srcSystem=1)
    message = common.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.1, -0.2, 0.3)
    stream = b"".join(message.pack(sender) for _ in range(FRAMES))

    def encode() -> None:
        for _ in range(FRAMES):
            message.pack(sender)

    def decode() -> None:
        parser = common.MAVLink(None)
        parser.robust_parsing = True
        assert sum(len(parser.parse_buffer(chunk) or ()) for chunk in chunks(stream)) == FRAMES

    return best_rate(encode), best_rate(decode)


def main() -> None:
    """Print the table."""
    encode, decode = ours()
    print(f"{'':12}{'encode':>14}{'decode':>14}")
    print(f"{'tiger':12}{encode / 1e3:10.0f} k/s{decode / 1e3:10.0f} k/s")
    peer = mavlink()
    if peer is None:
        print("pymavlink is not installed (pip install pymavlink): no ratio")
        return
    print(f"{'pymavlink':12}{peer[0] / 1e3:10.0f} k/s{peer[1] / 1e3:10.0f} k/s")
    print(f"{'ratio':12}{encode / peer[0]:14.1f}{decode / peer[1]:14.1f}")


if __name__ == "__main__":
    main()
