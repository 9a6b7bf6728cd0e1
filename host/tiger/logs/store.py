"""Log files on a disk: parts of limited size, the oldest deleted when there are too many."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiger.logs import cdr
from tiger.logs.topics import WIRE, message_type

if TYPE_CHECKING:
    from io import BufferedWriter

    from mcap.writer import Writer

    from tiger.logs.packets import Start

NAME = re.compile(r"tiger-(?P<begun>\d{8}-\d{6})(_(?P<again>\d+))?-(?P<part>\d{3,})\.mcap")
CHUNK_BYTES = 1_000_000
CHUNKS_PER_PART = 20  # at least: a part grows by whole chunks, and shall not outgrow its size by one
PROFILE = "ros2"


def part_name(session: str, number: int) -> str:
    """File name of a part."""
    return f"{session}-{number:03d}.mcap"


def in_order(folder: Path) -> list[Path]:
    """The logs in a folder from the oldest part to the newest. Raises OSError."""
    found = [(match, path) for path in folder.iterdir() if (match := NAME.fullmatch(path.name))]
    return [path for _, path in sorted((_age(match), path) for match, path in found)]


def session_of(path: Path) -> str:
    """Name of the session that a part belongs to."""
    return path.name.rpartition("-")[0]


def _age(name: re.Match[str]) -> tuple[str, int, int]:
    """Sorts as time does: as text, part 1000 would come before part 999."""
    return name["begun"], int(name["again"] or 0), int(name["part"])


class LogFiles:
    """The parts of one session. Raises OSError when the disk fails."""

    def __init__(self, start: Start) -> None:
        self._start = start
        self._folder = Path(start.folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._number = -1
        self._sequence: dict[int, int] = {}
        self._channels: dict[str, int] = {}
        self._last_ns = 0
        self._begin()

    def write(self, topic: str, t_ns: int, data: bytes, sample_ns: int | None = None) -> None:
        """Add a message; times that would run backwards are those of the message before."""
        self._last_ns = t_ns = max(t_ns, self._last_ns)
        channel = self._channels.get(topic) or self._add_channel(topic)
        sequence = self._sequence[channel] = self._sequence.get(channel, -1) + 1
        published = t_ns if sample_ns is None else sample_ns
        self._writer.add_message(channel, t_ns, data, published, sequence & 0xFFFF_FFFF)

    @property
    def size(self) -> int:
        """Bytes of this part on disk."""
        return self._file.tell()

    def flush(self) -> None:
        """Bring everything written so far to the disk, and make room for more."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fdatasync(self._file.fileno())
        self._make_room()

    def next_part(self) -> None:
        """Finish this part and begin the next one, which says again what the log is about."""
        self.close()
        self._begin()

    def close(self) -> None:
        """Finish this part."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def _begin(self) -> None:
        from mcap.writer import CompressionType, Writer

        self._number += 1
        self._path = self._folder / part_name(self._start.name, self._number)
        self._file: BufferedWriter = self._path.open("xb")
        chunk_bytes = min(CHUNK_BYTES, self._start.part_bytes // CHUNKS_PER_PART)
        self._writer: Writer = Writer(self._file, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library="tiger")
        self._channels.clear()
        self._schemas: dict[type, int] = {}
        self._sequence.clear()
        about = {**self._start.metadata, "session": self._start.name, "part": str(self._number)}
        self._writer.add_metadata("tiger", {**about, "epoch_ns": str(self._start.epoch_ns)})
        for name, text in self._start.attachments.items():
            kind = "application/json" if name.endswith(".json") else "text/plain"
            self._writer.add_attachment(self._last_ns, self._last_ns, name, kind, text.encode())
        self._make_room()

    def _add_channel(self, topic: str) -> int:
        cls = message_type(topic)
        if cls is None:
            raise ValueError(f"{topic} is no topic of a log")
        kind: cdr.Message[Any] = cdr.message(cls)
        if cls not in self._schemas:
            definition = kind.definition().encode()
            self._schemas[cls] = self._writer.register_schema(kind.name, cdr.SCHEMA_ENCODING, definition)
        about = {"direction": topic.rpartition("/")[2]} if topic.startswith(WIRE) else {}
        channel = self._writer.register_channel(topic, cdr.ENCODING, self._schemas[cls], about)
        self._channels[topic] = channel
        return channel

    def _make_room(self) -> None:
        """Delete the oldest logs above the limit, or while the disk is nearly full; never the one at hand."""
        logs = in_order(self._folder)
        sizes = {path: path.stat().st_size for path in logs if path.exists()}  # another one may tidy up too
        total = sum(sizes.values())
        for path, size in sizes.items():
            full = shutil.disk_usage(self._folder).free < self._start.free_bytes
            if not (full or total > self._start.total_bytes):
                return
            if path != self._path:
                total -= size
                path.unlink(missing_ok=True)
