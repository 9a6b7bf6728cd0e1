"""Reads and checks the description of the wire (`tiger.toml`).

`load(path)` returns a `Spec` or raises a `SpecError` that lists everything wrong, each with file, message and
field. Numbers are exact (`Fraction`) until a template writes them, so that a limit is a whole number of
counts or refused.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

FRAME_OVERHEAD_BYTES = 7  # two delimiters, COBS code byte, id, seq, CRC-16
BITS_PER_BYTE = 10  # start, eight data, stop

# struct code, smallest and largest count of each type
TYPES: dict[str, tuple[str, int, int]] = {
    "u8": ("B", 0, 0xFF),
    "i8": ("b", -0x80, 0x7F),
    "u16": ("H", 0, 0xFFFF),
    "i16": ("h", -0x8000, 0x7FFF),
    "u32": ("I", 0, 0xFFFF_FFFF),
    "i32": ("i", -0x8000_0000, 0x7FFF_FFFF),
    "char": ("s", 0x00, 0x7F),
}
BYTES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4, "char": 1}
PERMANENCES = ("until_disarm", "until_cleared", "until_reset")
SAFE_WORDS = ("any", "hold")  # any value is safe; the value measured now is safe
EVERY_BOARD = "all"


class SpecError(Exception):
    """A spec that cannot be generated from; `problems` holds one line per fault found."""

    def __init__(self, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))


@dataclass(frozen=True)
class Member:
    """One value of an enum."""

    name: str
    value: int
    doc: str


@dataclass(frozen=True)
class Enum:
    """Named values; an enum whose name ends in `_flag` holds bit numbers."""

    name: str
    members: tuple[Member, ...]

    @property
    def is_flags(self) -> bool:
        return self.name.endswith("_flag")


@dataclass(frozen=True)
class Fault:
    """One latched fault: when it goes away and what to do about it."""

    name: str
    code: int
    boards: tuple[str, ...]
    permanence: str
    text: str
    remedy: str


@dataclass(frozen=True)
class Field:
    """One field: `count` numbers of `type`; physical value = counts * scale."""

    name: str
    type: str
    count: int
    is_array: bool
    scale: Fraction
    low: int  # smallest and largest counts a receiver accepts
    high: int
    safe: int | str | None  # counts, one of SAFE_WORDS, or nothing
    enum: str | None  # names the values
    index: str | None  # names the places of an array
    doc: str

    @property
    def size(self) -> int:
        return BYTES[self.type] * self.count

    @property
    def struct_code(self) -> str:
        code = TYPES[self.type][0]
        return f"{self.count}s" if self.type == "char" else code * self.count

    @property
    def is_scaled(self) -> bool:
        return self.scale != 1

    @property
    def is_limited(self) -> bool:
        """Whether the limits are narrower than the type, so that a receiver has something to check."""
        return (self.low, self.high) != TYPES[self.type][1:]

    @property
    def unit(self) -> str:
        return self.name.rsplit("_", 1)[-1]


@dataclass(frozen=True)
class Message:
    """One message; `board` names its board or EVERY_BOARD."""

    name: str
    id: int
    board: str
    sender: str
    delivery: str
    actuator: bool
    frozen: bool
    rate_hz: Fraction
    fields: tuple[Field, ...]
    doc: str

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def frame_bytes(self) -> int:
        return self.size + FRAME_OVERHEAD_BYTES

    @property
    def node_offset(self) -> int | None:
        """Where the `node` of a message that every board speaks stands in its payload."""
        offset = 0
        for field in self.fields:
            if field.name == "node":
                return offset
            offset += field.size
        return None


@dataclass(frozen=True)
class Param:
    """One stored parameter, or `count` of them with consecutive indices."""

    name: str
    index: int
    count: int
    scale: Fraction
    low: int
    high: int
    defaults: tuple[int, ...]
    doc: str

    @property
    def unit(self) -> str:
        return self.name.rsplit("_", 1)[-1]


@dataclass(frozen=True)
class Board:
    """One kind of board; `node` is its place behind the wire it is reached through."""

    name: str
    kind: int
    node: int
    instances: tuple[str, ...]
    params: tuple[Param, ...]
    doc: str


@dataclass(frozen=True)
class Link:
    """One serial line and the boards whose messages run over it."""

    name: str
    baud: int
    boards: tuple[str, ...]
    budget: Fraction
    doc: str


@dataclass(frozen=True)
class Load:
    """What one message takes of one direction of a link."""

    link: Link
    board: str
    message: Message

    @property
    def share(self) -> Fraction:
        return self.message.rate_hz * self.message.frame_bytes * BITS_PER_BYTE / self.link.baud


@dataclass(frozen=True)
class Spec:
    """The whole wire."""

    proto: int
    max_payload_bytes: int
    boards: tuple[Board, ...]
    links: tuple[Link, ...]
    units: dict[str, str]
    enums: tuple[Enum, ...]
    faults: tuple[Fault, ...]
    messages: tuple[Message, ...]  # in the order of their ids

    def of_board(self, board: str, sender: str | None = None) -> tuple[Message, ...]:
        """The messages `board` speaks, the common ones included, perhaps only those from one sender."""
        return tuple(
            message
            for message in self.messages
            if message.board in (EVERY_BOARD, board) and sender in (None, message.sender)
        )

    def enum(self, name: str) -> Enum:
        return next(enum for enum in self.enums if enum.name == name)

    def loads(self, link: Link, sender: str) -> list[Load]:
        """Every message on one direction of a link, once for each board that speaks it."""
        return [Load(link, board, m) for board in link.boards for m in self.of_board(board, sender)]

    def share(self, link: Link, sender: str) -> Fraction:
        """Part of one direction of `link` that its messages take at their rates."""
        return sum((load.share for load in self.loads(link, sender)), Fraction(0))

    @cached_property
    def schema_hashes(self) -> dict[str, int]:
        """The schema hash of each board: the first four bytes of SHA-256 over its canonical JSON."""
        return {board.name: _schema_hash(self, board) for board in self.boards}


def _schema_hash(spec: Spec, board: Board) -> int:
    messages = spec.of_board(board.name)
    mine = {name for message in messages for field in message.fields for name in (field.enum, field.index)}
    described = {
        "proto": spec.proto,
        "max_payload_bytes": spec.max_payload_bytes,
        "board": [board.name, board.kind, board.node, board.instances],
        "messages": [
            [
                *(m.name, m.id, m.sender, m.delivery, m.actuator, m.frozen),
                [
                    [
                        *(f.name, f.type, f.count, f.is_array, str(f.scale), f.low, f.high),
                        *(f.safe, f.enum, f.index),
                    ]
                    for f in m.fields
                ],
            ]
            for m in messages
        ],
        "enums": [
            [enum.name, [[member.name, member.value] for member in enum.members]]
            for enum in spec.enums
            if enum.name in mine
        ],
        "faults": [[f.name, f.code, f.permanence] for f in spec.faults if board.name in f.boards],
        "params": [[p.name, p.index, p.count, str(p.scale), p.low, p.high, p.defaults] for p in board.params],
    }
    canonical = json.dumps(described, sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(canonical.encode()).digest()[:4], "little")


def load(path: Path) -> Spec:
    """Read and check the spec at `path`; raises SpecError with every problem found."""
    return parse(path.read_text(encoding="utf-8"), path.name)


def parse(text: str, file: str) -> Spec:
    """Read and check a spec given as text; `file` is the name that its problems begin with."""
    try:
        table = tomllib.loads(text, parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise SpecError([f"{file}: not valid TOML: {error}"]) from None
    reader = _Reader(file)
    spec = reader.spec(table)
    if reader.problems:
        raise SpecError(reader.problems)
    return spec


_TOP_KEYS = {
    "proto": int,
    "max_payload_bytes": int,
    "board": dict,
    "link": dict,
    "units": dict,
    "plain_names": dict,
    "enum": dict,
    "fault": dict,
    "message": dict,
    "param": dict,
}
_NUMBER = (int, Decimal, Fraction)
_BOARD_KEYS = {"kind": int, "node": int, "instances": list, "doc": str}
_LINK_KEYS = {"baud": int, "boards": list, "budget": _NUMBER, "doc": str}
_MEMBER_KEYS = {"value": int, "doc": str}
_FAULT_KEYS = {"code": int, "boards": list, "permanence": str, "text": str, "remedy": str}
_MESSAGE_KEYS = {
    "id": int,
    "board": str,
    "from": str,
    "class": str,
    "rate_hz": _NUMBER,
    "doc": str,
    "fields": list,
    "actuator": bool,
    "frozen": bool,
}
_FIELD_KEYS = {
    "name": str,
    "type": str,
    "doc": str,
    "count": int,
    "scale": (*_NUMBER, str),
    "min": _NUMBER,
    "max": _NUMBER,
    "safe": (*_NUMBER, str),
    "enum": str,
    "index": str,
}
_PARAM_KEYS = {
    "name": str,
    "count": int,
    "scale": (*_NUMBER, str),
    "min": _NUMBER,
    "max": _NUMBER,
    "default": (*_NUMBER, list),
    "doc": str,
}
_OPTIONAL = {"actuator", "frozen", "safe", "enum", "index"}


class _Reader:
    """Walks the TOML table once, building the spec and noting every problem on the way."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.problems: list[str] = []

    def problem(self, where: str, what: str) -> None:
        self.problems.append(f"{self.file}: {where}: {what}")

    def checked(self, table: Any, keys: dict[str, Any], where: str, optional: set[str] = _OPTIONAL) -> bool:
        """Whether `table` has exactly `keys`, of their types; notes what is missing, unknown or wrong."""
        before = len(self.problems)
        if not isinstance(table, dict):
            self.problem(where, "is not a table")
            return False
        for key in table.keys() - keys.keys():
            self.problem(where, f"unknown key '{key}'; known are {', '.join(keys)}")
        for key, kind in keys.items():
            if key not in table:
                if key not in optional:
                    self.problem(where, f"key '{key}' is missing")
            elif not isinstance(table[key], kind) or (isinstance(table[key], bool) and kind is not bool):
                self.problem(where, f"'{key}' = {table[key]!r} has the wrong type")
        return len(self.problems) == before

    def spec(self, table: dict[str, Any]) -> Spec:
        if not self.checked(table, _TOP_KEYS, "top level"):
            raise SpecError(self.problems)
        self.units: dict[str, str] = table["units"]
        self.plain_names = set(table["plain_names"].get("names", []))
        self.board_names = tuple(table["board"])
        params = {board: self.params(board, entry) for board, entry in table["param"].items()}
        self.unique_params(params)
        boards = tuple(
            Board(
                name,
                entry["kind"],
                entry["node"],
                tuple(entry["instances"]),
                params.get(name, ()),
                entry["doc"],
            )
            for name, entry in table["board"].items()
            if self.checked(entry, _BOARD_KEYS, f"board.{name}")
        )
        self.unique(((f"board.{board.name}", board.kind) for board in boards), "kind")
        self.enums = {name: self.enum(name, entry) for name, entry in table["enum"].items()}
        faults = tuple(fault for name, entry in table["fault"].items() for fault in self.fault(name, entry))
        self.unique(((f"fault.{fault.name}", fault.code) for fault in faults), "code")
        self.max_payload = table["max_payload_bytes"]
        messages = [m for name, entry in table["message"].items() for m in self.message(name, entry)]
        self.unique(((f"message.{message.name}", message.id) for message in messages), "id")
        links = tuple(link for name, entry in table["link"].items() for link in self.link(name, entry))
        spec = Spec(
            proto=table["proto"],
            max_payload_bytes=self.max_payload,
            boards=boards,
            links=links,
            units=self.units,
            enums=tuple(self.enums.values()),
            faults=faults,
            messages=tuple(sorted(messages, key=lambda message: message.id)),
        )
        self.budgets(spec)
        self.used_enums(spec)
        return spec

    def unique(self, values: Iterable[tuple[str, int]], what: str) -> None:
        seen: dict[int, str] = {}
        for where, value in values:
            if value in seen:
                self.problem(where, f"{what} {value:#04x} is already the one of {seen[value]}")
            seen.setdefault(value, where)

    def unique_params(self, params: dict[str, tuple[Param, ...]]) -> None:
        """C++ names parameters without their board, so no two boards may share a name."""
        owner: dict[str, str] = {}
        for board, entries in params.items():
            for param in entries:
                if param.name in owner:
                    what = f"is already a parameter of {owner[param.name]}"
                    self.problem(f"param.{board}.{param.name}", what)
                owner.setdefault(param.name, board)

    def known_boards(self, boards: list[Any], where: str) -> None:
        for board in boards:
            if board not in self.board_names:
                self.problem(where, f"unknown board '{board}'; known are {', '.join(self.board_names)}")

    def link(self, name: str, entry: Any) -> Iterator[Link]:
        where = f"link.{name}"
        if self.checked(entry, _LINK_KEYS, where):
            self.known_boards(entry["boards"], where)
            budget = Fraction(entry["budget"])
            yield Link(name, entry["baud"], tuple(entry["boards"]), budget, entry["doc"])

    def budgets(self, spec: Spec) -> None:
        for link in spec.links:
            for sender in ("host", "board"):
                share = spec.share(link, sender)
                if share > link.budget:
                    worst = max(spec.loads(link, sender), key=lambda load: load.share).message.name
                    self.problem(
                        f"link.{link.name}",
                        f"messages from the {sender} take {float(share):.1%} of {link.baud} baud, over the "
                        f"budget of {float(link.budget):.0%}; the largest share is message.{worst}",
                    )

    def used_enums(self, spec: Spec) -> None:
        fields = [field for message in spec.messages for field in message.fields]
        used = {name for field in fields for name in (field.enum, field.index)}
        for enum in spec.enums:
            if enum.name not in used:
                self.problem(f"enum.{enum.name}", "no field uses it, so no schema hash would feel it change")

    def enum(self, name: str, entry: Any) -> Enum:
        members: list[Member] = []
        for member, value in entry.items():
            if self.checked(value, _MEMBER_KEYS, f"enum.{name}.{member}"):
                members.append(Member(member, value["value"], value["doc"]))
        self.unique(((f"enum.{name}.{member.name}", member.value) for member in members), "value")
        highest = 31 if name.endswith("_flag") else 0xFF
        for member in members:
            if not 0 <= member.value <= highest:
                self.problem(f"enum.{name}.{member.name}", f"value {member.value} is outside 0 to {highest}")
        return Enum(name, tuple(members))

    def fault(self, name: str, entry: Any) -> Iterator[Fault]:
        where = f"fault.{name}"
        if not self.checked(entry, _FAULT_KEYS, where):
            return
        self.known_boards(entry["boards"], where)
        if entry["permanence"] not in PERMANENCES:
            self.problem(where, f"permanence '{entry['permanence']}' is none of {', '.join(PERMANENCES)}")
        if not 1 <= entry["code"] <= 31:
            self.problem(where, f"code {entry['code']} is outside 1 to 31, the bits of health.faults")
        for key in ("text", "remedy"):
            if not entry[key].strip():
                self.problem(where, f"'{key}' is empty")
        yield Fault(
            name, entry["code"], tuple(entry["boards"]), entry["permanence"], entry["text"], entry["remedy"]
        )

    def message(self, name: str, entry: Any) -> Iterator[Message]:
        where = f"message.{name}"
        if not self.checked(entry, _MESSAGE_KEYS, where):
            return
        if entry["board"] != EVERY_BOARD:
            self.known_boards([entry["board"]], where)
        for key, choices in (("from", ("host", "board")), ("class", ("stream", "config"))):
            if entry[key] not in choices:
                self.problem(where, f"'{key}' = '{entry[key]}' is neither {choices[0]} nor {choices[1]}")
        if not 0 <= entry["id"] <= 0xFE:
            self.problem(where, f"id {entry['id']} is outside 0 to 0xfe")
        actuator = entry.get("actuator", False)
        fields = tuple(
            field
            for number, raw in enumerate(entry["fields"])
            for field in self.field(raw, where, number, actuator)
        )
        message = Message(
            name=name,
            id=entry["id"],
            board=entry["board"],
            sender=entry["from"],
            delivery=entry["class"],
            actuator=actuator,
            frozen=entry.get("frozen", False),
            rate_hz=Fraction(entry["rate_hz"]),
            fields=fields,
            doc=entry["doc"],
        )
        names = [field.name for field in fields]
        for twice in sorted({field for field in names if names.count(field) > 1}):
            self.problem(f"{where}.{twice}", "is named twice")
        if message.size > self.max_payload:
            self.problem(where, f"payload of {message.size} bytes is over the {self.max_payload} that fit")
        if entry["board"] == EVERY_BOARD and "node" not in names:
            self.problem(where, "every board speaks it, so it needs a field 'node' of type u8")
        if entry["class"] == "config" and entry["from"] != "host":
            self.problem(where, "only the host sends config messages")
        yield message

    def name_has_unit(self, name: str, where: str) -> None:
        if name not in self.plain_names and name.rsplit("_", 1)[-1] not in self.units:
            self.problem(
                where, "name ends in no known unit; add the unit to [units] or the name to [plain_names]"
            )

    def scale(self, value: int | Decimal | str, where: str) -> Fraction:
        try:
            scale = Fraction(value)
        except (ValueError, ZeroDivisionError):
            scale = Fraction(0)
        if scale <= 0:
            self.problem(where, f'scale {value!r} is not a positive number or a fraction "a/b"')
            return Fraction(1)
        return scale

    def counts(self, value: int | Decimal, scale: Fraction, where: str, what: str) -> int:
        counts = Fraction(value) / scale
        if counts.denominator != 1:
            self.problem(where, f"{what} {value} is not a whole number of counts of {scale}")
        return round(counts)

    def limits(self, entry: Any, type_name: str, scale: Fraction, where: str) -> tuple[int, int]:
        """Smallest and largest count of a field; without min or max, the end of its type."""
        _, smallest, largest = TYPES[type_name]
        low = self.counts(entry["min"], scale, where, "min") if "min" in entry else smallest
        high = self.counts(entry["max"], scale, where, "max") if "max" in entry else largest
        for what, counts in (("min", low), ("max", high)):
            if not smallest <= counts <= largest:
                self.problem(
                    where,
                    f"{what} is {counts} counts of {scale}, outside {smallest} to {largest} of {type_name}",
                )
        if low > high:
            self.problem(where, "min is above max")
        return low, high

    def field(self, entry: Any, message: str, number: int, actuator: bool) -> Iterator[Field]:
        named = isinstance(entry, dict) and isinstance(entry.get("name"), str)
        where = f"{message}.{entry['name']}" if named else f"{message}: field {number}"
        optional = _OPTIONAL | {"count", "scale", "min", "max"}
        if not self.checked(entry, _FIELD_KEYS, where, optional):
            return
        if entry["type"] not in TYPES:
            self.problem(where, f"type '{entry['type']}' is none of {', '.join(TYPES)}")
            return
        self.name_has_unit(entry["name"], where)
        if not entry["name"].isidentifier() or not entry["name"].islower():
            self.problem(where, "name is not a lower-case identifier")
        if not 1 <= entry.get("count", 1) <= self.max_payload:
            self.problem(where, f"count {entry['count']} is outside 1 to {self.max_payload}")
        scale = self.scale(entry.get("scale", 1), where)
        low, high = self.limits(entry, entry["type"], scale, where)
        enum, index = entry.get("enum"), entry.get("index")
        for name in (enum, index):
            if name is not None and name not in self.enums:
                self.problem(where, f"unknown enum '{name}'; known are {', '.join(self.enums)}")
        if index in self.enums and len(self.enums[index].members) != entry.get("count"):
            self.problem(where, f"count is not the {len(self.enums[index].members)} members of '{index}'")
        safe = entry.get("safe")
        if safe is None and actuator:
            what = "commands an actuator, so it needs 'safe': the value that stops motion, or any, or hold"
            self.problem(where, what)
        if isinstance(safe, str):
            if safe not in SAFE_WORDS:
                self.problem(where, f"safe '{safe}' is neither a number nor {' nor '.join(SAFE_WORDS)}")
        elif safe is not None:
            safe = self.counts(safe, scale, where, "safe")
            if not low <= safe <= high:
                self.problem(where, f"safe is {safe} counts, outside its limits {low} to {high}")
        yield Field(
            name=entry["name"],
            type=entry["type"],
            count=entry.get("count", 1),
            is_array="count" in entry and entry["type"] != "char",
            scale=scale,
            low=low,
            high=high,
            safe=safe,
            enum=enum,
            index=index,
            doc=entry["doc"],
        )

    def params(self, board: str, entry: Any) -> tuple[Param, ...]:
        where = f"param.{board}"
        self.known_boards([board], where)
        if not self.checked(entry, {"fields": list}, where):
            return ()
        params: list[Param] = []
        index = 0
        for number, raw in enumerate(entry["fields"]):
            named = isinstance(raw, dict) and isinstance(raw.get("name"), str)
            here = f"{where}.{raw['name']}" if named else f"{where}: parameter {number}"
            if not self.checked(raw, _PARAM_KEYS, here):
                continue
            self.name_has_unit(raw["name"], here)
            scale = self.scale(raw["scale"], here)
            low, high = self.limits(raw, "i32", scale, here)
            values = raw["default"] if isinstance(raw["default"], list) else [raw["default"]] * raw["count"]
            if len(values) != raw["count"]:
                self.problem(here, f"{len(values)} defaults for {raw['count']} values")
            defaults = tuple(self.counts(value, scale, here, "default") for value in values)
            if any(not low <= default <= high for default in defaults):
                self.problem(here, f"default is outside its limits {raw['min']} to {raw['max']}")
            params.append(Param(raw["name"], index, raw["count"], scale, low, high, defaults, raw["doc"]))
            index += raw["count"]
        if index > 0xFE:
            self.problem(where, f"{index} parameters are over the 254 that an index can name")
        return tuple(params)
