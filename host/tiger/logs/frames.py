"""The last frames of every link, kept for the moment something goes wrong."""

from __future__ import annotations

from collections import deque

from tiger.logs.topics import WireFrame

KEPT = 100  # frames of each link and direction
LONGEST_BYTES = 256  # of what never ends: a device that is none of ours
BOARD_END, DRIVE_END = b"\x00", b"\r"


class LastFrames:
    """Splits the bytes of every link into frames and remembers the last ones."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, bool], deque[WireFrame]] = {}
        self._partial: dict[tuple[str, bool], bytes] = {}
        self._boards: set[str] = set()  # ports where a zero byte was seen: lines of a Roboteq have none

    def feed(self, port: str, data: bytes, t_ns: int, *, sent: bool) -> None:
        """Take bytes in the order they went over the wire."""
        if port not in self._boards and BOARD_END in data:
            self._boards.add(port)
        end = BOARD_END if port in self._boards else DRIVE_END
        key = (port, sent)
        *whole, rest = (self._partial.get(key, b"") + data).split(end)
        kept = self._frames.setdefault(key, deque(maxlen=KEPT))
        kept.extend(WireFrame(port, sent, t_ns, frame + end) for frame in whole if frame)
        self._partial[key] = rest[-LONGEST_BYTES:]

    def report(self) -> tuple[WireFrame, ...]:
        """The last frames of all links, in the order of time."""
        frames = [frame for kept in self._frames.values() for frame in kept]
        return tuple(sorted(frames, key=lambda frame: frame.t_ns))
