"""Writes both sides of the wire, its reference page and its golden frames from `tiger.toml`.

python protocol/generate.py            write the files that changed
python protocol/generate.py --check    write nothing; exit 1 and name the files that are not up to date
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import jinja2

from spec import BYTES, FRAME_OVERHEAD_BYTES, TYPES, Field, Message, Param, Spec, SpecError, load

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OUTPUTS = {
    "protocol.h.j2": ROOT / "firmware/libraries/TigerCore/src/tiger/protocol.h",
    "messages.py.j2": ROOT / "host/tiger/protocol/messages.py",
    "REFERENCE.md.j2": HERE / "REFERENCE.md",
}
VECTORS = HERE / "vectors.json"

# Cycles on a 16 MHz AVR, measured (the protocol's README says how).
CRC_CYCLES_PER_BYTE = 22
COBS_CYCLES_PER_BYTE = 13
CYCLES_PER_FRAME = 100
CPU_HZ = 16_000_000

C_TYPES = {
    "u8": "uint8_t",
    "i8": "int8_t",
    "u16": "uint16_t",
    "i16": "int16_t",
    "u32": "uint32_t",
    "i32": "int32_t",
    "char": "char",
}


def camel(name: str) -> str:
    """rate_mmps -> RateMmps; MEGA_SPEED -> MegaSpeed."""
    return "".join(part.capitalize() for part in name.split("_"))


def number(value: Fraction) -> str:
    """A number as a person writes it."""
    return str(value.numerator) if value.denominator == 1 else f"{float(value):.10g}"


# ---------------------------------------------------------------------------------------------------- C++


def c_type(field: Field) -> str:
    return C_TYPES[field.type]


def c_declaration(field: Field) -> str:
    array = f"[{field.count}]" if field.count > 1 or field.is_array else ""
    return f"{c_type(field)} {field.name}{array}"


def c_float(value: Fraction) -> str:
    return f"{float(value)!r}f"


def c_outside(field: Field, variable: str, message: str) -> str:
    """The comparison that is true outside the limits; a limit at the end of the type needs none."""
    name = f"{camel(message)}::k{camel(field.name)}"
    _, smallest, largest = TYPES[field.type]
    below = [f"{variable} < {name}Min"] if field.low > smallest else []
    above = [f"{variable} > {name}Max"] if field.high < largest else []
    return " || ".join(below + above)


# ------------------------------------------------------------------------------------------------- Python


def py_string(text: str) -> str:
    return json.dumps(text)


def py_float(value: Fraction) -> str:
    return repr(float(value))


def py_int(value: int) -> str:
    return f"{value:_}"


def py_enum(field: Field, spec: Spec) -> str | None:
    """The enum type of a field whose every accepted value is a member."""
    if field.enum is None or spec.enum(field.enum).is_flags or not field.is_limited:
        return None
    values = {member.value for member in spec.enum(field.enum).members}
    return camel(field.enum) if values >= set(range(field.low, field.high + 1)) else None


def py_type(field: Field, spec: Spec) -> str:
    if field.type == "char":
        return "str"
    single = py_enum(field, spec) or ("float" if field.is_scaled else "int")
    return f"tuple[{', '.join([single] * field.count)}]" if field.is_array else single


def py_pack(field: Field, message: Message) -> str:
    """The arguments of struct.pack for one field."""
    where = f'"{message.name}.{field.name}"'
    if field.type == "char":
        return f"_text(self.{field.name}, {field.count}, {where})"
    if field.is_scaled:
        check = f"_counts({{}}, {py_float(1 / field.scale)}, {field.low}, {field.high}, {where})"
    else:
        check = f"_whole({{}}, {field.low}, {field.high}, {where})"
    if field.is_array:
        return f"*[{check.format('v')} for v in {field.name}]"
    return check.format(f"self.{field.name}")


def positions(message: Message) -> Iterator[tuple[Field, int, int]]:
    """Each field with its first and last place in the tuple that struct.unpack returns."""
    first = 0
    for field in message.fields:
        size = 1 if field.type == "char" else field.count
        yield field, first, first + size
        first += size


def py_limits(message: Message) -> list[tuple[str, int, int, int]]:
    return [
        (f"{field.name}[{place - first}]" if field.is_array else field.name, place, field.low, field.high)
        for field, first, last in positions(message)
        if field.is_limited and field.type != "char"
        for place in range(first, last)
    ]


def py_guard(message: Message) -> list[str]:
    """The lines of the condition that every received count is within its limits."""
    conditions = [f"{low} <= c[{place}] <= {high}" for _, place, low, high in py_limits(message)]
    return [conditions[0], *(f"and {condition}" for condition in conditions[1:])] if conditions else []


def py_unpack(message: Message, spec: Spec) -> list[str]:
    """The constructor's arguments, from the counts `c`."""
    return [py_value(field, first, last, spec) for field, first, last in positions(message)]


def py_value(field: Field, first: int, last: int, spec: Spec) -> str:
    if field.type == "char":
        return f'c[{first}].rstrip(b"\\0").decode("ascii", "replace")'
    if field.is_scaled:
        # Dividing by whole counts per unit rounds right (0.3, not 0.30000000000000004).
        places = [f"c[{place}] / {py_float(1 / field.scale)}" for place in range(first, last)]
    elif enum := py_enum(field, spec):
        places = [f"{enum}(c[{place}])" for place in range(first, last)]
    elif field.is_array:
        return f"c[{first}:{last}]"
    else:
        places = [f"c[{first}]"]
    return f"({', '.join(places)})" if field.is_array else places[0]


# ------------------------------------------------------------------------------------------ reference page


def unit_note(field: Field | Param, spec: Spec) -> str:
    """Counts and unit, in front of a comment: `0.001 millimetre per second; `."""
    unit = spec.units.get(field.unit)
    if unit is None or field.scale == 1:
        return ""
    return f"{field.scale} {unit}; "


def limit(field: Field, end: str) -> str:
    return number(getattr(field, end) * field.scale) if field.type != "char" else ""


def safe(field: Field) -> str:
    if field.safe is None:
        return ""
    return field.safe if isinstance(field.safe, str) else number(field.safe * field.scale)


def by_node_offset(messages: tuple[Message, ...]) -> list[tuple[int, list[Message]]]:
    offsets = sorted({message.node_offset for message in messages if message.node_offset is not None})
    return [(offset, [m for m in messages if m.node_offset == offset]) for offset in offsets]


def cpu_ledger(spec: Spec) -> dict[str, Any]:
    """What framing costs each board."""
    by_board = {board.name: list(spec.of_board(board.name)) for board in spec.boards}
    by_board["mega_suspension"] += by_board["nano_imu"]
    rows = []
    for board, messages in by_board.items():
        frames = sum(message.rate_hz for message in messages)
        size = sum(message.rate_hz * message.frame_bytes for message in messages)
        cycles = size * (CRC_CYCLES_PER_BYTE + COBS_CYCLES_PER_BYTE) + frames * CYCLES_PER_FRAME
        share = cycles / CPU_HZ
        rows.append({"board": board, "frames": frames, "bytes": size, "cycles": cycles, "share": share})
    return {"crc": CRC_CYCLES_PER_BYTE, "cobs": COBS_CYCLES_PER_BYTE, "frame": CYCLES_PER_FRAME, "rows": rows}


# -------------------------------------------------------------------------------------------- golden frames


def crc16_x25(data: bytes) -> int:
    """CRC-16/X-25, bit by bit: independent of the library and of the firmware that it pins."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x8408 if crc & 1 else crc >> 1
    return crc ^ 0xFFFF


def cobs(data: bytes) -> bytes:
    """Consistent overhead byte stuffing of fewer than 254 bytes."""
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0"))


def frame(message_id: int, seq: int, payload: bytes) -> bytes:
    """One frame with both delimiters."""
    body = bytes([message_id, seq]) + payload
    return b"\0" + cobs(body + crc16_x25(body).to_bytes(2, "little")) + b"\0"


def field_counts(field: Field, case: str) -> list[int]:
    """The counts of one field in one golden case."""
    if case == "min":
        return [field.low] * field.count
    if case == "max":
        return [field.high] * field.count
    if case == "safe":
        return [field.safe if isinstance(field.safe, int) else field.low] * field.count
    # typical: different, inside the limits, of both signs where there are two
    span = field.high - field.low
    return [field.low + span * (3 + 5 * place) // (7 + 5 * field.count) for place in range(field.count)]


def vectors(spec: Spec) -> dict[str, Any]:
    """Every message at its smallest, largest, typical and (for actuators) safe values, as frames."""
    entries = []
    for seq, message in enumerate(spec.messages):
        for case in ("min", "max", "typical", *(["safe"] if message.actuator else [])):
            counts = [field_counts(field, case) for field in message.fields]
            payload = b"".join(
                count.to_bytes(BYTES[field.type], "little", signed=field.type.startswith("i"))
                for field, values in zip(message.fields, counts, strict=True)
                for count in values
            )
            entries.append(
                {
                    "message": message.name,
                    "case": case,
                    "id": message.id,
                    "seq": (seq * 37) & 0xFF,
                    "counts": {f.name: values for f, values in zip(message.fields, counts, strict=True)},
                    "payload": payload.hex(),
                    "frame": frame(message.id, (seq * 37) & 0xFF, payload).hex(),
                }
            )
    return {
        "generated": "by protocol/generate.py from protocol/tiger.toml: edit that, then make generate",
        "schema_hashes": {name: f"{value:#010x}" for name, value in spec.schema_hashes.items()},
        "crc_check": {"data": "123456789", "crc16_x25": crc16_x25(b"123456789")},
        "vectors": entries,
    }


# ---------------------------------------------------------------------------------------------------- main


def render(spec: Spec) -> dict[Path, str]:
    """The text of every output."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    filters = (camel, number, c_type, c_declaration, c_float, c_outside)
    filters += (py_string, py_float, py_int, py_type, py_pack, py_limits, py_guard, py_unpack)
    filters += (unit_note, limit, safe, by_node_offset)
    environment.filters.update({function.__name__: function for function in filters})
    environment.filters["percent"] = lambda share: f"{float(share):.1%}"
    environment.filters["scaled"] = lambda counts, scale: number(counts * scale)
    plain = {field.name for m in spec.messages for field in m.fields if field.unit not in spec.units}
    context = {"spec": spec, "cpu": cpu_ledger(spec), "overhead": FRAME_OVERHEAD_BYTES, "plain": plain}
    outputs = {path: environment.get_template(name).render(context) for name, path in OUTPUTS.items()}
    outputs[VECTORS] = json.dumps(vectors(spec), indent=1) + "\n"
    return outputs


def main() -> int:
    """Entry point; returns the exit status."""
    parser = argparse.ArgumentParser(description="Write both sides of the wire from tiger.toml.")
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a file is stale")
    check = parser.parse_args().check
    try:
        outputs = render(load(HERE / "tiger.toml"))
    except SpecError as error:
        print(error, file=sys.stderr)
        return 1
    stale = [path for path, text in outputs.items() if not path.exists() or path.read_text() != text]
    for path in stale:
        print(f"{path.relative_to(ROOT)}: {'not up to date; run make generate' if check else 'written'}")
        if not check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(outputs[path], encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
