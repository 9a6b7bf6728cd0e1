"""Numbers and names on the pages are those of the programs: keys, constants, bits, frames, code shown."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.config.robot import load_robot
from tiger.devices import roboteq
from tiger.protocol.frame import encode_message
from tiger.protocol.messages import SuspensionSetpoint

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
DEFAULTS = tomllib.loads((ROOT / "host" / "tiger" / "config" / "robot.toml").read_text(encoding="utf-8"))
CORE = ROOT / "firmware" / "libraries" / "TigerCore" / "src" / "tiger"


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def rows_of(page: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its two first lines."""
    below = text_of(page).split(f"## {heading}\n", 1)[1]
    lines = re.search(r"(?:^\|.*\n)+", below, re.MULTILINE)[0].splitlines()  # type: ignore[index]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


# ---------------------------------------------------------------------------------------- configuration


def test_the_configuration_page_lists_every_table_there_is() -> None:
    listed = set(re.findall(r"^\| `\[?(\w+)\]?` \|", text_of("configuration.md"), re.MULTILINE))
    assert listed == set(DEFAULTS)


def test_every_key_that_a_page_names_with_its_table_is_one_of_the_configuration() -> None:
    tables = "|".join(name for name, value in DEFAULTS.items() if isinstance(value, dict))
    named = {
        (page.name, table, key)
        for page in [*DOCS.glob("*.md"), ROOT / "README.md"]
        for table, key in re.findall(rf"`(?:tiger\.)?({tables})\.(\w+)`?", page.read_text(encoding="utf-8"))
        if not (CORE.parents[4] / "host" / "tiger" / table / f"{key}.py").exists()
    }
    assert len(named) > 20
    assert not [name for name in named if name[2] not in DEFAULTS[name[1]]]


@pytest.mark.parametrize(
    "wrong",
    [
        "[loop]\nrate_hz = 5000.0\n[drive]\nmax_sped_mps = 1.0\n",
        "[leveling]\nride_stroke_mm = 69.5\n",
    ],
)
def test_the_messages_on_the_configuration_page_are_those_that_a_user_gets(
    wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(wrong, encoding="utf-8")
    with pytest.raises(ConfigError) as told:
        load_robot("mine.toml")
    assert f"```\n{told.value}\n```\n" in text_of("configuration.md")


QUOTED = [  # the page, its words, and the key whose value, times a factor, stands for {}
    ("stability.md", "That must stay within {} % of the way", "stability.load_transfer_max", 100),
    ("stability.md", "margin below {}, balance point", "stability.warning_margin", 1),
    ("stability.md", "balance point nearer than {} s, or a command", "stability.warning_time_s", 1),
    ("stability.md", "accelerations are told {} ms ahead (`late_s`)", "stability.late_s", 1000),
    ("stability.md", "stays near its mean of the last {} s.", "stability.trip_mean_s", 1),
    ("stability.md", "A blow of more than {} m/s within", "stability.trip_blow_mps", 1),
    ("stability.md", "m/s within {} s, beyond what", "stability.trip_blow_s", 1),
    ("stability.md", "braking never below {} m/s2", "stability.brake_min_mps2", 1),
    ("control.md", "has left the zone ({} degrees on still ground", "leveling.wake_deg", 1),
    ("control.md", "{} on turning ground", "leveling.dead_zone_deg", 1),
    ("control.md", "from {} % of the limit on the rate", "leveling.heat_slow", 100),
    ("control.md", "to nothing at {} %", "leveling.heat_stop", 100),
    ("control.md", "over the last {} m is believed", "leveling.ahead_learn_m", 1),
    ("control.md", "It changes by {} degrees a second at most", "observer.tilt_rate_degps", 1),
    ("decisions.md", "what is left under {} degrees/s", "safety.max_rest_gyro_bias_degps", 1),
]


@pytest.mark.parametrize(("page", "words", "key", "factor"), QUOTED, ids=[words for _, words, *_ in QUOTED])
def test_a_page_quotes_the_configuration_as_it_is(page: str, words: str, key: str, factor: int) -> None:
    table, name = key.split(".")
    value = round(DEFAULTS[table][name] * factor, 6)
    assert words.format(f"{value:g}") in re.sub(r"\s+", " ", text_of(page))


# ---------------------------------------------------------------------------------------------------- Roboteq


def test_the_bound_of_a_wrong_speed_adds_up_on_the_roboteq_page_as_in_the_driver() -> None:
    watchdog_ms = DEFAULTS["safety"]["roboteq_watchdog_ms"]
    driver = roboteq.Roboteq("left", "/dev/left", watchdog_ms, DEFAULTS["loop"]["drive_rate_hz"], 20.0)
    parts_ms = [roboteq.PATIENCE_S * 1e3, roboteq.DEADLINE_S * 1e3, watchdog_ms, driver.wrong_speed_s * 1e3]
    shown = [
        int(re.sub(r"\D", "", row[-1])) for row in rows_of("roboteq.md", "How long a wrong speed may last")
    ]
    assert shown == [round(part) for part in parts_ms]
    assert f"before {driver.silence_s * 1e3:.0f} ms\nhave passed" in text_of("roboteq.md").replace(
        " have", "\nhave"
    )


def test_the_other_numbers_of_the_roboteq_page_are_those_of_the_driver() -> None:
    page = re.sub(r"\s+", " ", text_of("roboteq.md"))
    watchdog_ms = DEFAULTS["safety"]["roboteq_watchdog_ms"]
    blind_ms = (roboteq.GAP_SHARE + 1.0) * watchdog_ms + roboteq.DEADLINE_S * 1e3
    for words in (
        f"abandoned after {roboteq.DEADLINE_S * 1e3:.0f} ms; commands are repeated at once, "
        f"for {roboteq.PATIENCE_S * 1e3:.0f} ms",
        f"jumps by more than {roboteq.SPEED_JUMP_RPM} rpm",
        f"a gap is {roboteq.GAP_SHARE} of the watchdog's time",
        f"the bound is {roboteq.GAP_SHARE} + 1 times the watchdog's time and a deadline, {blind_ms:.0f} ms",
        f"`RWD` as under `[safety]`, {watchdog_ms} |",
    ):
        assert words in page


def test_the_bits_on_the_roboteq_page_are_those_that_the_driver_names() -> None:
    kinds = (roboteq.FaultFlag, roboteq.StatusFlag, roboteq.MotorFlag)
    for bit, *shown in rows_of("roboteq.md", "Bits"):
        for words, kind in zip(shown, kinds, strict=True):
            (name,) = roboteq.decode_flags(1 << int(bit), kind)
            plain = re.sub(r"\(.*\)|[`*]", "", words).strip().lower()
            assert plain.replace("default configuration loaded", "default config") == name


# --------------------------------------------------------------------------------------- boards, the wire


def test_the_reaction_times_of_mega_suspension_are_those_of_its_header() -> None:
    header = (CORE / "boards" / "mega_suspension_config.h").read_text(encoding="utf-8")
    value = {name: int(number) for name, number in re.findall(r"constexpr \w+ (k\w+) = (\d+);", header)}
    events = [row[0] for row in rows_of("mega_suspension.md", "Reaction times (safety)")]
    assert events[:3] == [
        f"setpoint more than {value['kSetpointMaxAgeMs']} ms old",
        f"no setpoint accepted for {value['kHoldAfterMs']} ms",
        f"none for {value['kLinkLostAfterMs']} ms",
    ]
    assert f"e-stop input for {value['kEstopDebounceMs']} ms, or ESTOP message" in events
    head = text_of("safety.md")
    assert f"| no setpoint accepted for {value['kHoldAfterMs']} ms, or only ones older than" in head
    assert f"| none accepted for {value['kLinkLostAfterMs']} ms |" in head


def test_the_example_of_a_frame_is_what_the_codec_sends() -> None:
    page = (ROOT / "protocol" / "README.md").read_text(encoding="utf-8")
    table = page.split("as the host's frame 42:")[1].split("\n\n")[1]
    shown = "".join(re.findall(r"`([0-9a-f ]+)`", table)).replace(" ", "")
    message = SuspensionSetpoint(host_ms=1000, engaged=1, rate_mmps=(1.5, 0.0, 0.0, -1.5))
    assert bytes.fromhex(shown) == encode_message(message, 42)


# ------------------------------------------------------------------------------------------------------- code


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", text_of(page), re.DOTALL)


@pytest.mark.parametrize("page", sorted(page.name for page in DOCS.glob("*.md") if blocks(page.name)))
def test_the_python_that_a_page_shows_runs_and_gives_what_it_says(page: str) -> None:
    """`value   # 1.5: words`: what a comment begins with, if it is a number or several, comes out."""
    for block in blocks(page):
        names: dict[str, Any] = {}
        exec(compile(block, page, "exec"), names)
        for expression, said in re.findall(r"^(\w+\.\w+\(.*\)(?:\.\w+)?) +# (.*)$", block, re.MULTILINE):
            numbers = [float(number) for number in re.findall(r"-?\d+\.\d*", said)]
            if numbers:
                got = np.ravel(np.asarray(eval(expression, names), dtype=float))
                assert got == pytest.approx(numbers, abs=0.006), expression


def test_the_errata_with_a_demand_are_those_that_the_page_says() -> None:
    tests = (ROOT / "tests" / "host" / "models" / "test_vehicle_errata.py").read_text(encoding="utf-8")
    demanded = set(re.findall(r'^ +"(\d+): ', tests, re.MULTILINE))
    listed = {row[0] for row in rows_of("vehicle-model.md", "Errata")}
    words = re.search(r"All but ([\d, and]+) have a demand", text_of("vehicle-model.md"))
    assert words is not None
    assert demanded == listed - set(re.findall(r"\d+", words[1]))


# ------------------------------------------------------------------------------------------------------ names

SOURCES = ("host", "firmware", "protocol", "tests", "bench", "scripts")
SUFFIXES = (".py", ".toml", ".h", ".cpp", ".ino", ".j2")
OTHERS = {"sched_rt_runtime_us", "crc_ccitt_update"}  # Linux, avr-libc
NAME = re.compile(r"\b[a-z][a-z0-9]+(?:_[a-z0-9]{2,})+\b")


def test_every_name_that_a_page_sets_as_code_is_in_the_sources() -> None:
    files = [path for top in SOURCES for path in (ROOT / top).rglob("*") if path.suffix in SUFFIXES]
    known = OTHERS | {path.stem for path in files}
    for path in files:
        if path.parent != Path(__file__).parent:
            known |= set(re.findall(r"\w+", path.read_text(encoding="utf-8")))
    unknown = []
    for page in [*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "protocol" / "README.md"]:
        spans = re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8"))
        for name in NAME.findall(" ".join(spans)) if page.name != "proof.md" else ():
            stem = re.sub("(fl|fr|rl|rr)$", "", name)  # a corner's name is put together
            if not known & {name, stem, stem.rstrip("_")}:
                unknown.append(f"{page.name}: {name}")
    assert not unknown
