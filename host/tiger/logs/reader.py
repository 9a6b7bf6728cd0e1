"""Reads logs, whole or broken.

A log whose writer was killed ends in the middle of a record and has no index: everything before that is read.
A chunk whose checksum is wrong is left out. Both are noted in `damage`.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from pydantic import ValidationError

from tiger.config.robot import RobotConfig
from tiger.logs import cdr
from tiger.logs.errors import LogError
from tiger.logs.store import in_order, session_of
from tiger.logs.topics import HEALTH, TICK, Health, message_type
from tiger.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

MAGIC_BYTES = 8
UNREADABLE = (McapError, struct.error, ValueError, zstandard.ZstdError)


class Logged(NamedTuple):
    """One message of a log."""

    t_ns: int  # when it was logged, since 1970
    topic: str
    data: bytes  # CDR
    sample_ns: int  # when it was measured
    sequence: int
    channel: int

    def value(self) -> Any:
        """The message itself; raises CdrError when it is damaged or none of ours."""
        cls = message_type(self.topic)
        if cls is None:
            raise cdr.CdrError(f"{self.topic} is none of this program's topics")
        return cdr.message(cls).unpack(self.data)


class LogFile:
    """One file of a log. Everything but the path is known once `messages` was read to its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.about: dict[str, str] = {}
        self.attachments: dict[str, str] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.complete = False  # ends as a file should
        self.damage: list[str] = []
        self.watch: Callable[[float], None] = lambda part: None  # told which part of the file was read

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Logged]:
        """Yield all messages in the order they were logged, or those of some topics. Raises LogError."""
        self.damage, self.complete = [], False
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read ({error.strerror}); check the path") from error
        with file:
            size = max(self.path.stat().st_size, 1)
            records = StreamReader(file, emit_chunks=True).records
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except UNREADABLE as error:
                    if file.tell() <= MAGIC_BYTES:
                        raise LogError(f"{self.path}: is no MCAP file; name a log of this program") from error
                    self.damage.append(f"ends in the middle of a record, at byte {file.tell()}")
                    return
                self.watch(file.tell() / size)
                yield from self._take(record, topics)

    def _take(self, record: Any, topics: Collection[str] | None) -> Iterator[Logged]:
        if isinstance(record, Chunk):
            yield from self._chunk(record, topics)
        elif isinstance(record, Message):
            channel = self.channels.get(record.channel_id)
            if channel is None:
                self.damage.append(f"a message is on channel {record.channel_id}, which does not exist")
            elif topics is None or channel.topic in topics:
                yield Logged(
                    t_ns=record.log_time,
                    topic=channel.topic,
                    data=record.data,
                    sample_ns=record.publish_time,
                    sequence=record.sequence,
                    channel=record.channel_id,
                )
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Metadata):
            self.about.update(record.metadata)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = record.data.decode(errors="replace")
        elif isinstance(record, Footer):
            self.complete = True

    def _chunk(self, chunk: Chunk, topics: Collection[str] | None) -> Iterator[Logged]:
        try:
            records = breakup_chunk(chunk, validate_crc=True)
        except UNREADABLE as error:
            self.damage.append(
                f"the chunk that begins at {chunk.message_start_time} ns is unreadable: {error}"
            )
            return
        for record in records:
            yield from self._take(record, topics)


class Log:
    """The files of one run, in order."""

    def __init__(self, paths: list[Path]) -> None:
        self.files = [LogFile(path) for path in paths]

    def watch(self, progress: Callable[[float], None]) -> None:
        """From now on tell `progress` which part of the log was read, each time that it is read."""
        count = len(self.files)

        def of_file(k: int) -> Callable[[float], None]:
            return lambda part: progress((k + part) / count)

        for k, file in enumerate(self.files):
            file.watch = of_file(k)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Logged]:
        """Yield all messages of all files in order, or those of some topics. Raises LogError."""
        for file in self.files:
            yield from file.messages(topics)

    def records(self) -> Iterator[tuple[int, Record]]:
        """Yield every tick with the time it was logged, in ns since 1970, with the health known by then."""
        health = Health((), ())
        for logged in self.messages((TICK, HEALTH)):
            value = logged.value()
            if isinstance(value, Health):
                health = value
                continue
            yield (
                logged.t_ns,
                Record(
                    tick=value.tick,
                    state=value.state,
                    reason=value.reason,
                    inputs=value.inputs,
                    outputs=value.outputs,
                    problems=health.problems,
                    links=health.links,
                    lateness_s=value.lateness_s,
                ),
            )

    @property
    def about(self) -> dict[str, str]:
        """Versions and circumstances of the run; known once something was read."""
        return next((file.about for file in self.files if file.about), {})

    @property
    def damage(self) -> list[str]:
        """What could not be read, and where."""
        return [f"{file.path.name}: {text}" for file in self.files for text in file.damage]

    def robot(self) -> RobotConfig:
        """The configuration that the daemon ran with. Raises LogError when the log has none."""
        for file in self.files:
            for _ in file.messages(()):
                break
            text = file.attachments.get("robot.json")
            if text is not None:
                try:
                    return RobotConfig.model_validate_json(text)
                except ValidationError as error:
                    version = file.about.get("version", "?")
                    raise LogError(
                        f"{file.path}: its robot.json does not fit this version of the program; it was "
                        f"written by {version}, {file.about.get('git_revision', '?')}: check that version out"
                    ) from error
        raise LogError("the log holds no robot.json: it was not written by this program")


def open_log(path: str | Path) -> Log:
    """Return the log in a file, or the newest one in a folder with all its parts. Raises LogError."""
    path = Path(path)
    if not path.is_dir():
        if not path.exists():
            raise LogError(f"{path}: is not there; name a log file, or a folder with logs")
        return Log([path])
    try:
        parts = in_order(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); name another folder") from error
    if not parts:
        raise LogError(f"{path}: holds no logs (tiger-*.mcap); name a log file, or a folder with logs")
    newest = session_of(parts[-1])
    return Log([part for part in parts if session_of(part) == newest])
