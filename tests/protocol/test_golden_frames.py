"""The golden frames: C++ and Python each encode and decode every one, to the bit."""

from __future__ import annotations

import json
import subprocess
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import generate
import spec
from tiger.protocol import messages
from tiger.protocol.frame import FrameDecoder, crc16, encode_message
from tiger.protocol.messages import FROM_BOARD, TO_BOARD, Message

ROOT = Path(__file__).parents[2]
GOLDEN = json.loads((ROOT / "protocol" / "vectors.json").read_text(encoding="utf-8"))
VECTORS: list[dict[str, Any]] = GOLDEN["vectors"]
SPEC = spec.load(ROOT / "protocol" / "tiger.toml")
CLASSES: dict[int, type[Message]] = {
    message_id: message
    for direction in (TO_BOARD, FROM_BOARD)
    for known in direction.values()
    for message_id, message in known.items()
}


def physical(vector: dict[str, Any]) -> Message:
    """The message of a vector, from its counts and the scales of the spec."""
    described = next(m for m in SPEC.messages if m.name == vector["message"])
    values: dict[str, Any] = {}
    for field in described.fields:
        counts = vector["counts"][field.name]
        if field.type == "char":
            values[field.name] = bytes(counts).rstrip(b"\0").decode("ascii")
            continue
        numbers = [float(Fraction(c) * field.scale) if field.is_scaled else c for c in counts]
        values[field.name] = tuple(numbers) if field.is_array else numbers[0]
    return CLASSES[vector["id"]](**values)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: f"{v['message']}-{v['case']}")
def test_python_encodes_and_decodes_every_golden_frame(vector: dict[str, Any]) -> None:
    message = physical(vector)
    frame = bytes.fromhex(vector["frame"])
    assert encode_message(message, vector["seq"]) == frame
    decoder = FrameDecoder(CLASSES)
    ((seq, decoded),) = decoder.feed(frame)
    assert (seq, decoded.pack()) == (vector["seq"], bytes.fromhex(vector["payload"]))
    assert decoded == message


def test_every_message_has_its_golden_frames() -> None:
    cases = {(vector["message"], vector["case"]) for vector in VECTORS}
    for message in SPEC.messages:
        wanted = {"min", "max", "typical"} | ({"safe"} if message.actuator else set())
        assert wanted == {case for name, case in cases if name == message.name}


def test_the_checksum_is_the_catalogued_crc_16_x_25() -> None:
    assert crc16(b"123456789") == generate.crc16_x25(b"123456789") == 0x906E


def test_both_sides_were_generated_from_one_spec() -> None:
    hashes = {kind.name.lower(): f"{value:#010x}" for kind, value in messages.SCHEMA_HASH.items()}
    assert hashes == GOLDEN["schema_hashes"]


def cpp_case(vector: dict[str, Any]) -> str:
    """C++ that encodes one vector from its counts, and decodes it back to them."""
    described = next(m for m in SPEC.messages if m.name == vector["message"])
    name = generate.camel(vector["message"])
    sent, checks = [], []
    for field in described.fields:
        array = field.count > 1 or field.is_array
        for place, count in enumerate(vector["counts"][field.name]):
            variable = f"{field.name}[{place}]" if array else field.name
            literal = f"static_cast<{generate.c_type(field)}>({count}LL)"
            sent.append(f"    sent.{variable} = {literal};")
            checks.append(f"got.{variable} == {literal}")
    frame = ", ".join(f"0x{byte:02x}" for byte in bytes.fromhex(vector["frame"]))
    direction = "to" if described.sender == "host" else "from"
    owner = "MegaSuspension" if described.board == spec.EVERY_BOARD else generate.camel(described.board)
    return f"""
  {{
    const uint8_t golden[] = {{{frame}}};
    {name} sent;
{chr(10).join(sent)}
    uint8_t out[tiger::kMaxFrame];
    const uint8_t n = tiger::encode_frame({name}::kId, {vector["seq"]},
        reinterpret_cast<const uint8_t*>(&sent), {name}::kSize, out);
    bool good = n == sizeof(golden) && memcmp(out, golden, n) == 0 && in_range(sent);
    good = good && payload_size_{direction}_board(BoardKind::k{owner}, {name}::kId) == {name}::kSize;
    uint8_t chunk[sizeof(golden)];
    memcpy(chunk, golden + 1, sizeof(golden) - 2);
    const uint8_t body = tiger::cobs_decode(chunk, sizeof(golden) - 2);
    good = good && body == {name}::kSize + 4 && chunk[0] == {name}::kId && chunk[1] == {vector["seq"]};
    {name} got;
    memcpy(&got, chunk + 2, sizeof(got));
    good = good && {" && ".join(checks)};
    printf("%s {vector["message"]} {vector["case"]}\\n", good ? "ok" : "WRONG");
  }}"""


def test_cpp_encodes_and_decodes_every_golden_frame(tmp_path: Path) -> None:
    source = tmp_path / "golden.cpp"
    source.write_text(
        '#include <stdio.h>\n#include "tiger/frame.h"\nusing namespace tiger::wire;\nint main() {'
        + "".join(cpp_case(vector) for vector in VECTORS)
        + "\n  return 0;\n}\n"
    )
    program = tmp_path / "golden"
    include = ROOT / "firmware/libraries/TigerCore/src"
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wshadow", "-Wconversion"]
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover"]
    subprocess.run(
        ["g++", "-std=gnu++11", *warnings, *sanitizers, f"-I{include}", str(source), "-o", str(program)],
        check=True,
    )
    lines = subprocess.run([program], check=True, capture_output=True, text=True).stdout.splitlines()
    assert lines == [f"ok {vector['message']} {vector['case']}" for vector in VECTORS]


@pytest.mark.parametrize(
    "message", [m for m in SPEC.messages if any(f.is_limited for f in m.fields)], ids=lambda m: m.name
)
def test_one_count_beyond_a_limit_is_refused_by_python(message: spec.Message) -> None:
    vector = next(v for v in VECTORS if v["message"] == message.name and v["case"] == "typical")
    payload, offset = bytes.fromhex(vector["payload"]), 0
    for field in message.fields:
        size = spec.BYTES[field.type]
        signed = field.type.startswith("i")
        _, smallest, largest = spec.TYPES[field.type]
        for count in (field.low - 1, field.high + 1):
            if smallest <= count <= largest and field.type != "char":
                wrong = count.to_bytes(size, "little", signed=signed)
                damaged = payload[:offset] + wrong + payload[offset + size :]
                with pytest.raises(
                    messages.RangeError, match=rf"{message.name}\.{field.name}.* = {count} counts"
                ):
                    CLASSES[message.id].unpack(damaged)
        offset += field.size
