"""The generator refuses a wrong spec by file, message and field; its hashes change with all but words."""

from __future__ import annotations

import copy
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

import generate
import spec

FILE = Path(__file__).parents[2] / "protocol" / "tiger.toml"
TEXT = FILE.read_text(encoding="utf-8")


def read(table: dict[str, Any]) -> spec.Spec:
    """The spec in a TOML table."""
    reader = spec._Reader("tiger.toml")
    result = reader.spec(table)
    if reader.problems:
        raise spec.SpecError(reader.problems)
    return result


@pytest.fixture
def table() -> dict[str, Any]:
    return tomllib.loads(TEXT, parse_float=Decimal)


def field(table: dict[str, Any], message: str, name: str) -> dict[str, Any]:
    return next(entry for entry in table["message"][message]["fields"] if entry["name"] == name)


def refused(table: dict[str, Any]) -> str:
    with pytest.raises(spec.SpecError) as error:
        read(table)
    return str(error.value)


def test_the_spec_of_the_robot_is_accepted() -> None:
    assert len(spec.load(FILE).messages) == 21


def test_generated_files_are_up_to_date() -> None:
    for path, text in generate.render(spec.load(FILE)).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run make generate"


# ------------------------------------------------------------------------------------------------- refusals


def test_a_duplicate_id_is_refused_naming_both_messages(table: dict[str, Any]) -> None:
    table["message"]["wheel_speed"]["id"] = table["message"]["imu_raw"]["id"]
    assert refused(table) == "tiger.toml: message.wheel_speed: id 0x41 is already the one of message.imu_raw"


def test_a_payload_over_48_bytes_is_refused(table: dict[str, Any]) -> None:
    field(table, "imu_raw", "gyro_radps")["count"] = 16
    assert "message.imu_raw: payload of 50 bytes is over the 48 that fit" in refused(table)


def test_a_payload_of_48_bytes_is_accepted(table: dict[str, Any]) -> None:
    field(table, "imu_raw", "gyro_radps")["count"] = 15
    table["message"]["imu_raw"]["rate_hz"] = 50
    read(table)


@pytest.mark.parametrize(("key", "value"), [("min", Decimal("-33")), ("max", Decimal("33"))])
def test_limits_beyond_the_type_are_refused(table: dict[str, Any], key: str, value: Decimal) -> None:
    field(table, "suspension_state", "rate_mmps")[key] = value
    message = refused(table)
    assert f"message.suspension_state.rate_mmps: {key} is {value * 1000} counts of 1/1000" in message
    assert "outside -32768 to 32767 of i16" in message


def test_a_limit_between_two_counts_is_refused(table: dict[str, Any]) -> None:
    field(table, "suspension_setpoint", "rate_mmps")["max"] = Decimal("11.9995")
    assert "rate_mmps: max 11.9995 is not a whole number of counts of 1/1000" in refused(table)


def test_a_name_without_a_known_unit_is_refused(table: dict[str, Any]) -> None:
    field(table, "suspension_setpoint", "rate_mmps")["name"] = "rate"
    assert "message.suspension_setpoint.rate: name ends in no known unit" in refused(table)


def test_an_actuator_field_without_safe_is_refused(table: dict[str, Any]) -> None:
    del field(table, "suspension_setpoint", "rate_mmps")["safe"]
    assert "message.suspension_setpoint.rate_mmps: commands an actuator, so it needs 'safe'" in refused(table)


def test_a_safe_value_outside_its_limits_is_refused(table: dict[str, Any]) -> None:
    field(table, "suspension_setpoint", "engaged")["safe"] = 2
    assert "engaged: safe is 2 counts, outside its limits 0 to 1" in refused(table)


def test_a_link_over_its_budget_is_refused_naming_the_largest_message(table: dict[str, Any]) -> None:
    table["message"]["imu_attitude"]["rate_hz"] = 200
    message = refused(table)
    assert "link.nano_serial: messages from the board take 4" in message
    assert "over the budget of 40%; the largest share is message.imu_attitude" in message


@pytest.mark.parametrize(
    ("path", "where"),
    [
        ((), "top level"),
        (("message", "arm"), "message.arm"),
        (("message", "arm", "fields", 0), "message.arm.node"),
        (("board", "nano_imu"), "board.nano_imu"),
        (("link", "speed_usb"), "link.speed_usb"),
        (("fault", "JAM"), "fault.JAM"),
        (("enum", "ack_status", "OK"), "enum.ack_status.OK"),
        (("param", "mega_speed", "fields", 0), "param.mega_speed.teeth_counts"),
    ],
)
def test_an_unknown_key_is_refused_where_it_stands(
    table: dict[str, Any], path: tuple[Any, ...], where: str
) -> None:
    entry: Any = table
    for key in path:
        entry = entry[key]
    entry["colour"] = "red"
    assert f"tiger.toml: {where}: unknown key 'colour'" in refused(table)


@pytest.mark.parametrize(
    ("message", "key", "value", "expected"),
    [
        ("arm", "board", "mega", "unknown board 'mega'"),
        ("arm", "from", "sky", "'from' = 'sky' is neither host nor board"),
        ("arm", "class", "batch", "'class' = 'batch' is neither stream nor config"),
        ("arm", "id", 255, "id 255 is outside 0 to 0xfe"),
        ("arm", "id", "5", "'id' = '5' has the wrong type"),
        ("arm", "actuator", 1, "'actuator' = 1 has the wrong type"),
        ("ack", "class", "config", "only the host sends config messages"),
        ("health", "fields", [], "every board speaks it, so it needs a field 'node'"),
    ],
)
def test_a_wrong_message_key_is_refused(
    table: dict[str, Any], message: str, key: str, value: Any, expected: str
) -> None:
    table["message"][message][key] = value
    assert f"tiger.toml: message.{message}: {expected}" in refused(table)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("type", "f32", "type 'f32' is none of u8"),
        ("scale", 0, "scale 0 is not a positive number"),
        ("scale", "1/0", "scale '1/0' is not a positive number"),
        ("scale", "fast", "scale 'fast' is not a positive number"),
        ("count", 0, "count 0 is outside 1 to 48"),
        ("enum", "colours", "unknown enum 'colours'"),
        ("index", "reject_cause", "count is not the 6 members of 'reject_cause'"),
        ("safe", "zero", "safe 'zero' is neither a number nor any nor hold"),
        ("min", Decimal("20"), "min is above max"),
    ],
)
def test_a_wrong_field_key_is_refused(table: dict[str, Any], key: str, value: Any, expected: str) -> None:
    field(table, "suspension_setpoint", "rate_mmps")[key] = value
    assert f"message.suspension_setpoint.rate_mmps: {expected}" in refused(table)


def test_a_field_named_twice_is_refused(table: dict[str, Any]) -> None:
    field(table, "arm", "session")["name"] = "node"
    assert "message.arm.node: is named twice" in refused(table)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("code", 1, "code 0x01 is already the one of fault.LINK_LOST"),
        ("code", 32, "code 32 is outside 1 to 31"),
        ("permanence", "forever", "permanence 'forever' is none of until_disarm"),
        ("remedy", " ", "'remedy' is empty"),
        ("boards", ["mega"], "unknown board 'mega'"),
    ],
)
def test_a_wrong_fault_is_refused(table: dict[str, Any], key: str, value: Any, expected: str) -> None:
    table["fault"]["JAM"][key] = value
    assert f"tiger.toml: fault.JAM: {expected}" in refused(table)


def test_a_parameter_default_outside_its_limits_is_refused(table: dict[str, Any]) -> None:
    table["param"]["mega_speed"]["fields"][0]["default"] = 7
    assert "param.mega_speed.teeth_counts: default is outside its limits 8 to 200" in refused(table)


def test_a_parameter_with_the_wrong_number_of_defaults_is_refused(table: dict[str, Any]) -> None:
    table["param"]["mega_speed"]["fields"][0]["default"] = [60, 60]
    assert "param.mega_speed.teeth_counts: 2 defaults for 1 values" in refused(table)


def test_a_parameter_named_on_two_boards_is_refused(table: dict[str, Any]) -> None:
    table["param"]["mega_speed"]["fields"][0]["name"] = "calibrated"
    assert "param.mega_speed.calibrated: is already a parameter of nano_imu" in refused(table)


def test_an_enum_that_no_field_uses_is_refused(table: dict[str, Any]) -> None:
    table["enum"]["colour"] = {"RED": {"value": 0, "doc": "red"}}
    assert "tiger.toml: enum.colour: no field uses it" in refused(table)


def test_text_that_is_not_toml_is_refused_with_its_line() -> None:
    with pytest.raises(spec.SpecError, match=r"tiger\.toml: not valid TOML: .*line 1"):
        spec.parse("proto = = 1", "tiger.toml")


def test_all_problems_are_named_at_once(table: dict[str, Any]) -> None:
    table["message"]["arm"]["id"] = 300
    table["fault"]["JAM"]["code"] = 77
    assert len(refused(table).splitlines()) == 2


# ------------------------------------------------------------------------------------------ schema evolution


def hashes(table: dict[str, Any]) -> dict[str, int]:
    return read(table).schema_hashes


def test_no_word_of_documentation_changes_a_hash(table: dict[str, Any]) -> None:
    def reworded(entry: Any) -> None:
        if isinstance(entry, dict):
            for key, value in entry.items():
                if key in ("doc", "text", "remedy"):
                    entry[key] = f"{value} (reworded)"
                reworded(value)
        elif isinstance(entry, list):
            for value in entry:
                reworded(value)

    before = hashes(copy.deepcopy(table))
    reworded(table)
    table["units"]["mm"] = "a thousandth of a metre"
    assert hashes(table) == before


def edits(entry: dict[str, Any]) -> list[dict[str, Any]]:
    """Every single edit of one field that the wire can feel."""
    scale = spec._Reader("").scale(entry.get("scale", 1), "")
    low, high = spec._Reader("").limits(entry, entry["type"], scale, "")
    other_type = {
        "u8": "i8",
        "u16": "i16",
        "u32": "i32",
        "i8": "u8",
        "i16": "u16",
        "i32": "u32",
        "char": "u8",
    }
    changed: list[dict[str, Any]] = [
        {**entry, "name": f"other_{entry['name']}"},
        {**entry, "count": entry.get("count", 1) + 1},
        {**entry, "type": other_type[entry["type"]], "min": 0, "max": 0},
        {**entry, "scale": str(scale / 2)},
        {**entry, "min": _physical(low + 1, scale)},
        {**entry, "max": _physical(high - 1, scale)},
    ]
    changed.append({**entry, "enum": "log_level" if entry.get("enum") != "log_level" else "ack_status"})
    changed.append({**entry, "index": "log_level", "count": 4})
    if "safe" in entry:
        changed.append({**entry, "safe": "hold" if entry["safe"] != "hold" else "any"})
    return changed


def _physical(counts: int, scale: Any) -> Any:
    """A limit of so many counts as the TOML reader would hand it over."""
    return counts * scale


def owners(parsed: spec.Spec, message: str) -> set[str]:
    board = next(m.board for m in parsed.messages if m.name == message)
    return {b.name for b in parsed.boards} if board == spec.EVERY_BOARD else {board}


MESSAGES = list(tomllib.loads(TEXT)["message"])


@pytest.mark.parametrize("message", MESSAGES)
def test_every_single_edit_of_a_message_changes_the_hashes_of_its_boards_and_no_other(message: str) -> None:
    original = spec.load(FILE)
    index = next(i for i, m in enumerate(original.messages) if m.name == message)
    table = tomllib.loads(TEXT, parse_float=Decimal)["message"][message]
    reader = spec._Reader("tiger.toml")
    plain = tomllib.loads(TEXT)
    reader.units, reader.plain_names = plain["units"], set(plain["plain_names"]["names"])
    reader.enums = {enum.name: enum for enum in original.enums}
    reader.board_names, reader.max_payload = tuple(plain["board"]), 48

    variants = [
        {**table, "fields": [*table["fields"][:i], edit, *table["fields"][i + 1 :]]}
        for i, entry in enumerate(table["fields"])
        for edit in edits(entry)
    ]
    variants += [{**table, "fields": table["fields"][::-1]}] if len(table["fields"]) > 1 else []
    variants += [
        {**table, "id": 0x70},
        {**table, "class": "config" if table["class"] == "stream" else "stream"},
        {**table, "from": "host" if table["from"] == "board" else "board"},
        {**table, "fields": table["fields"][:-1]},
        {**table, "actuator": not table.get("actuator", False)},
    ]
    seen = {tuple(sorted(original.schema_hashes.items()))}
    for variant in variants:
        (edited,) = reader.message(message, variant)
        assert len(edited.fields) == len(variant["fields"]), reader.problems
        messages = list(original.messages)
        messages[index] = edited
        changed = spec.Spec(
            **{**vars_of(original), "messages": tuple(sorted(messages, key=lambda m: m.id))}
        ).schema_hashes
        different = {name for name, value in changed.items() if value != original.schema_hashes[name]}
        assert different == owners(original, message), variant
        key = tuple(sorted(changed.items()))
        assert key not in seen, f"two edits with one hash: {variant}"
        seen.add(key)


def vars_of(parsed: spec.Spec) -> dict[str, Any]:
    names = ("proto", "max_payload_bytes", "boards", "links", "units", "enums", "faults", "messages")
    return {name: getattr(parsed, name) for name in names}


@pytest.mark.parametrize(
    ("path", "value", "boards"),
    [
        (("enum", "imu_flag", "REST", "value"), 12, {"nano_imu"}),
        (("enum", "ack_status", "OK", "value"), 100, {"mega_suspension", "nano_imu", "mega_speed"}),
        (("enum", "reject_cause", "CRC", "value"), 9, {"mega_suspension", "nano_imu", "mega_speed"}),
        (("fault", "JAM", "code"), 30, {"mega_suspension"}),
        (("fault", "IMU_BUS", "permanence"), "until_reset", {"nano_imu"}),
        (("param", "mega_speed", "fields", 0, "default"), 61, {"mega_speed"}),
        (("proto",), 2, {"mega_suspension", "nano_imu", "mega_speed"}),
        (("link", "speed_usb", "baud"), 500000, set()),
        (("message", "health", "rate_hz"), 5, set()),
    ],
)
def test_an_edit_elsewhere_changes_the_boards_it_concerns(
    table: dict[str, Any], path: tuple[Any, ...], value: Any, boards: set[str]
) -> None:
    before = hashes(copy.deepcopy(table))
    entry: Any = table
    for key in path[:-1]:
        entry = entry[key]
    entry[path[-1]] = value
    after = hashes(table)
    assert {name for name in before if before[name] != after[name]} == boards


def test_the_frozen_messages_have_the_layout_that_never_changes() -> None:
    frozen = {
        m.name: (m.id, m.sender, "".join(f.struct_code for f in m.fields), [f.name for f in m.fields])
        for m in spec.load(FILE).messages
        if m.frozen
    }
    assert frozen == {
        "hello": (0, "host", "BBIH", ["proto", "node", "schema_hash", "host_nonce"]),
        "hello_reply": (
            1,
            "board",
            "BBBBIIBBBIBBHBIHB",
            [
                *("proto", "node", "board_kind", "instance", "board_uid", "schema_hash", "fw_version", "git"),
                *("dirty", "reset_cause", "boot_count", "last_fault", "uptime_ms", "host_nonce", "session"),
            ],
        ),
        "ping": (2, "host", "BI", ["node", "host_us"]),
        "pong": (3, "board", "BIII", ["node", "host_us", "rx_us", "tx_us"]),
        "ack": (4, "board", "BBBBi", ["node", "id", "seq", "status", "value"]),
    }
