"""What the control loop hands to the log's process: packets of entries, each with a time and a topic.

The first packet says what the log is about. Later ones carry messages that are encoded already, so the log's
process writes what it gets.
"""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

_HEAD = struct.Struct("<QBI")  # time in ns, bytes of the topic, bytes of the data


class Entry(NamedTuple):
    """One message, or bytes of the wire."""

    t_ns: int
    topic: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Start:
    """What a log is about, and where it goes."""

    folder: str
    name: str  # of the session: files are called after it
    epoch_ns: int  # when the host's monotonic clock was zero, since 1970
    metadata: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, str] = field(default_factory=dict)  # name -> text
    part_bytes: int = 64_000_000
    total_bytes: int = 4_000_000_000
    free_bytes: int = 500_000_000

    def pack(self) -> bytes:
        """As a packet."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpack(cls, data: bytes) -> Start:
        """From a packet."""
        return cls(**json.loads(data))


def parts(t_ns: int, topic: bytes, data: bytes) -> tuple[bytes, bytes, bytes]:
    """One entry; a packet is the parts of its entries, one after the other."""
    return _HEAD.pack(t_ns, len(topic), len(data)), topic, data


def unpack(packet: bytes) -> list[Entry]:
    """The entries of a packet."""
    entries, at = [], 0
    while at < len(packet):
        t_ns, name_size, size = _HEAD.unpack_from(packet, at)
        at += _HEAD.size
        topic = packet[at : at + name_size].decode()
        at += name_size
        entries.append(Entry(t_ns, topic, packet[at : at + size]))
        at += size
    return entries
