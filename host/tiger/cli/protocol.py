"""`tiger protocol`: what goes over the wire, as text."""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.cli.answers import JsonFile, refuse_unwritable, write_json
from tiger.protocol.frame import FrameDecoder
from tiger.protocol.messages import (
    FAULT_INFO,
    FROM_BOARD,
    TO_BOARD,
    AckStatus,
    BoardKind,
    Fault,
    ImuFlag,
    Message,
    RejectCause,
    SuspensionFlag,
    WheelFlag,
    node_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from enum import IntEnum

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Read frames and captures of the wire as text.",
)

EVERY_MESSAGE: dict[int, type[Message]] = {
    message_id: message
    for direction in (FROM_BOARD, TO_BOARD)
    for known in direction.values()
    for message_id, message in known.items()
}
_FLAGS: dict[str, type[IntEnum]] = {
    "suspension_state": SuspensionFlag,
    "imu_attitude": ImuFlag,
    "wheel_speed": WheelFlag,
}
CHUNK_BYTES = 65_536


def describe(message: Message) -> list[str]:
    """One line per field: name and value, with names for codes and flags."""
    lines = []
    for field in fields(message):  # type: ignore[arg-type]
        value = getattr(message, field.name)
        lines.append(f"  {field.name} = {_value(message, field.name, value)}")
    return lines


def one_line(seq: int, message: Message) -> str:
    """A frame on one line."""
    values = ", ".join(line.strip() for line in describe(message))
    return f"seq {seq:3} node {node_of(message)} {message.NAME}: {values}"


def _value(message: Message, name: str, value: Any) -> str:
    if name == "flags":
        return f"{value:#06x} ({', '.join(_flag_names(value, _FLAGS[message.NAME])) or 'none'})"
    if name == "faults":
        named = [Fault(code).name for code in range(32) if value >> code & 1 and code in set(Fault)]
        return f"{value:#010x} ({', '.join(named) or 'none'})"
    if name in ("schema_hash", "git", "board_uid"):
        return f"{value:#010x}"
    if name == "board_kind" and value in set(BoardKind):
        return f"{value} ({BoardKind(value).name.lower()})"
    if name == "status" and value in set(AckStatus):
        return f"{value} ({AckStatus(value).name})"
    if name == "last_fault" and value in set(Fault):
        return f"{value} ({Fault(value).name}: {FAULT_INFO[Fault(value)].text})"
    if name == "rejects":
        counts = zip(RejectCause, value, strict=True)
        return ", ".join(f"{cause.name} {count}" for cause, count in counts)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return " ".join(f"{part:g}" for part in value)
    return repr(value) if isinstance(value, str) else getattr(value, "name", str(value))


def _flag_names(bits: int, flags: type[IntEnum]) -> list[str]:
    """Names of the bits that are set; a bit of a group carries its place in the group."""
    starts = sorted(flags, key=lambda flag: flag.value)
    names = []
    for bit in range(16):
        if bits >> bit & 1:
            owner = [flag for flag in starts if flag.value <= bit]
            place = bit - owner[-1].value if owner else 0
            name = owner[-1].name if owner else f"bit {bit}"
            names.append(name if place == 0 else f"{name}+{place}")
    return names


@app.command()
def frame(
    text: Annotated[
        list[str], typer.Argument(metavar="HEX", help="The frame's bytes in hexadecimal, spaces allowed.")
    ],
) -> None:
    """Decode the frames in a line of hexadecimal bytes."""
    digits = "".join(text).replace("0x", "").replace(",", "")
    try:
        data = bytes.fromhex(digits)
    except ValueError:
        typer.echo(f"'{' '.join(text)}' is not a row of hexadecimal bytes, such as 00 02 05 ... 00", err=True)
        raise typer.Exit(2) from None
    decoder = FrameDecoder(EVERY_MESSAGE)
    received = decoder.feed(b"\0" + data + b"\0")
    for seq, message in received:
        typer.echo(f"{message.NAME} (id {message.ID:#04x}), seq {seq}, node {node_of(message)}")
        typer.echo("\n".join(describe(message)))
    refused = _refusals(decoder)
    if refused:
        typer.echo(f"refused: {refused}", err=True)
    if not received:
        typer.echo("no valid frame", err=True)
        raise typer.Exit(1)


@app.command()
def capture(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Bytes as they came over the line; - reads standard input.")
    ],
    summary: Annotated[bool, typer.Option("--summary", help="Only count the messages.")] = False,
    json_file: JsonFile = None,
) -> None:
    """Decode a file of raw bytes, frame by frame."""
    refuse_unwritable(json_file)
    summary = summary or str(json_file) == "-"
    decoder = FrameDecoder(EVERY_MESSAGE)
    counts: dict[str, int] = {}
    for data in _chunks(file):
        for seq, message in decoder.feed(data):
            counts[message.NAME] = counts.get(message.NAME, 0) + 1
            if not summary:
                typer.echo(one_line(seq, message))
    if json_file is not None:
        refused = {cause.name: count for cause, count in zip(RejectCause, decoder.rejects, strict=True)}
        write_json(json_file, {"messages": counts, "refused": refused})
    if str(json_file) == "-":
        return
    for name, count in sorted(counts.items(), key=lambda item: -item[1]):
        typer.echo(f"{count:8} {name}", err=not summary)
    typer.echo(f"{sum(decoder.rejects):8} refused ({_refusals(decoder) or 'none'})", err=not summary)


def _chunks(file: Path) -> Iterator[bytes]:
    """A file or standard input, piece by piece."""
    try:
        with sys.stdin.buffer if str(file) == "-" else file.open("rb") as stream:
            while data := stream.read(CHUNK_BYTES):
                yield data
    except OSError as error:  # of reading: what goes wrong with a chunk in hand is not raised here
        typer.echo(f"{file}: cannot be read ({error.strerror}); check the path", err=True)
        raise typer.Exit(2) from None


def _refusals(decoder: FrameDecoder) -> str:
    counts = zip(RejectCause, decoder.rejects, strict=True)
    return ", ".join(f"{cause.name} {count}" for cause, count in counts if count)
