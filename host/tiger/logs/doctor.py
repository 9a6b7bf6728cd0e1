"""Is a log file sound? What `mcap doctor` asks, and whether the messages are what their schemas say."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from typing import TYPE_CHECKING, Any

from mcap.reader import SeekingReader

from tiger.logs import cdr
from tiger.logs.reader import UNREADABLE, LogFile
from tiger.logs.topics import message_type

if TYPE_CHECKING:
    from pathlib import Path

FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, CRC
MAGIC_BYTES = 8
CHUNK_OPCODE = 0x06
MOST_FINDINGS = 20


def examine(path: Path) -> list[str]:
    """Everything that is wrong with a file, one line each; nothing for a sound one. Raises LogError."""
    file = LogFile(path)
    counts: Counter[int] = Counter()
    findings = _messages(file, counts)
    findings += _definitions(file)
    findings += file.damage
    if not file.complete:
        findings.append("has no footer: its writer was killed, or still writes")
        return findings
    return findings + _index(path, counts)


def _messages(file: LogFile, counts: Counter[int]) -> list[str]:
    """Each message decodes; times and sequence numbers go up."""
    findings: list[str] = []
    last_ns = 0
    last_sequence: dict[int, int] = {}
    for logged in file.messages():
        counts[logged.channel] += 1
        if logged.t_ns < last_ns:
            findings.append(f"{logged.topic}: time runs backwards at {logged.t_ns} ns")
        last_ns = logged.t_ns
        if logged.sequence != last_sequence.get(logged.channel, -1) + 1:
            findings.append(f"{logged.topic}: message {logged.sequence} is out of sequence")
        last_sequence[logged.channel] = logged.sequence
        try:
            logged.value()
        except cdr.CdrError as error:
            findings.append(f"{logged.topic}: {error}")
        if len(findings) >= MOST_FINDINGS:
            return [*findings, "and so on"]
    return findings


def _definitions(file: LogFile) -> list[str]:
    """Each channel has a schema, and it is the one that this program writes."""
    findings = []
    for channel in file.channels.values():
        schema = file.schemas.get(channel.schema_id)
        cls = message_type(channel.topic)
        if schema is None:
            findings.append(f"{channel.topic}: schema {channel.schema_id} is missing")
        elif (channel.message_encoding, schema.encoding) != (cdr.ENCODING, cdr.SCHEMA_ENCODING):
            findings.append(f"{channel.topic}: is {schema.encoding} in {channel.message_encoding}")
        elif cls is None:
            findings.append(f"{channel.topic}: is no topic of this program")
        elif schema.data.decode() != cdr.message(cls).definition():
            findings.append(f"{channel.topic}: {schema.name} is defined otherwise in this version")
    return findings


def _index(path: Path, counts: Counter[int]) -> list[str]:
    """The summary has the right checksum, and counts and places agree with the data."""
    data = path.read_bytes()
    footer_at = len(data) - MAGIC_BYTES - FOOTER.size
    _, _, summary_start, _, crc = FOOTER.unpack_from(data, footer_at)
    findings = []
    if zlib.crc32(data[summary_start : footer_at + FOOTER.size - 4]) != crc:
        findings.append("the checksum of the summary is wrong")
    try:
        with path.open("rb") as file:
            summary: Any = SeekingReader(file).get_summary()
    except UNREADABLE as error:
        return [*findings, f"the summary is unreadable: {error}"]
    if summary is None or summary.statistics is None:
        return [*findings, "there is no summary"]
    if summary.statistics.channel_message_counts != dict(counts):
        findings.append("the summary counts other messages than there are")
    for index in summary.chunk_indexes:
        opcode, length = struct.unpack_from("<BQ", data, index.chunk_start_offset)
        if opcode != CHUNK_OPCODE or length + 9 != index.chunk_length:
            findings.append(f"the index names byte {index.chunk_start_offset}, where no chunk begins")
    return findings
