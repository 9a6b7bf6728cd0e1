"""Frames on a serial line: `00 | COBS(id, seq, payload, crc16) | 00`.

The receiver checks in a fixed order and counts each refusal by its cause: length of the chunk, COBS, id known
in this direction, exact payload length of that id, CRC, limits of the fields. Nothing that fails a check is
looked at further.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import crcmod.predefined
from cobs import cobs

from tiger.protocol.messages import MAX_PAYLOAD_BYTES, Message, RangeError, RejectCause

DELIMITER = b"\0"
HEADER_BYTES = 2  # id, seq
CRC_BYTES = 2
OVERHEAD_BYTES = HEADER_BYTES + CRC_BYTES + 3  # and two delimiters and the COBS code byte
MIN_CHUNK_BYTES = HEADER_BYTES + CRC_BYTES + 1
MAX_CHUNK_BYTES = MAX_PAYLOAD_BYTES + MIN_CHUNK_BYTES

crc16 = crcmod.predefined.mkCrcFun("x-25")


class Received(NamedTuple):
    """One valid frame."""

    seq: int
    message: Message


def encode(message_id: int, seq: int, payload: bytes) -> bytes:
    """One frame with both delimiters; `seq` is taken modulo 256."""
    body = bytes((message_id, seq & 0xFF)) + payload
    stuffed: bytes = cobs.encode(body + crc16(body).to_bytes(CRC_BYTES, "little"))
    return DELIMITER + stuffed + DELIMITER


def encode_message(message: Message, seq: int) -> bytes:
    """`message` as a frame; raises RangeError when one of its fields is outside the limits of the spec."""
    return encode(message.ID, seq, message.pack())


class FrameDecoder:
    """Turns bytes, in pieces of any size, into messages; counts what it refuses in `rejects`."""

    def __init__(self, known: Mapping[int, type[Message]]) -> None:
        """`known` are the messages that may come from this direction, by id."""
        self.known = dict(known)
        self.frames = 0
        self.rejects = [0] * len(RejectCause)
        self._partial = b""

    def feed(self, data: bytes) -> list[Received]:
        """The messages that `data` completes, in order."""
        return list(self.each(data))

    def each(self, data: bytes) -> Iterator[Received]:
        """As `feed`, one by one: what a message adds to `known` holds for those that come after it."""
        *chunks, rest = (self._partial + data).split(DELIMITER)
        # Of a chunk that is already too long, keep just enough to know that at its end.
        self._partial = rest[: MAX_CHUNK_BYTES + 1]
        for chunk in chunks:
            if chunk:  # the delimiters of two frames stand side by side
                outcome = self._check(chunk)
                if isinstance(outcome, Received):
                    self.frames += 1
                    yield outcome
                else:
                    self.rejects[outcome] += 1

    def _check(self, chunk: bytes) -> Received | RejectCause:
        if not MIN_CHUNK_BYTES <= len(chunk) <= MAX_CHUNK_BYTES:
            return RejectCause.LENGTH
        try:
            body = cobs.decode(chunk)
        except cobs.DecodeError:
            return RejectCause.DECODE
        kind = self.known.get(body[0])
        if kind is None:
            return RejectCause.UNKNOWN_ID
        if len(body) != kind.SIZE + HEADER_BYTES + CRC_BYTES:
            return RejectCause.SIZE
        if crc16(body[:-CRC_BYTES]) != int.from_bytes(body[-CRC_BYTES:], "little"):
            return RejectCause.CRC
        try:
            return Received(body[1], kind.unpack(body[HEADER_BYTES:-CRC_BYTES]))
        except RangeError:
            return RejectCause.RANGE
