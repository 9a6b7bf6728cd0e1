"""The picture of a run: everything in it can be read on a terminal of 80 columns and 24 lines."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from tiger.cli.live import Page, _short, whole_terminal
from tiger.daemon.overview import Overview
from tiger.record import (
    DaemonState,
    DriveSample,
    Estimate,
    Inputs,
    LinkStatus,
    Outputs,
    Problem,
    ProblemKind,
    Record,
    StrokeSample,
    WheelSample,
)

# A robot after a long day: every number is as long as it gets.
BOARD = LinkStatus(
    "mega_speed (right)", "disarmed", True, 98_765_432, 4321, 0, 12_345, 12.3, 1877.0, -1092.0, supply_v=5.04
)
DRIVE = LinkStatus("roboteq (right)", "configuring", True, 45_678_901, 9999, 12, 3456, supply_v=24.13)
WHEELS = WheelSample(0.0, (0, 0), (-41.8, -41.8), 0)
SAMPLE = DriveSample(0.0, (-399.0, -399.0), (-29.9, -29.9), (9.9, 9.9), 24.0, 61.0, 0, 0)
RECORD = Record(
    tick=1,
    state=DaemonState.ARMED,
    reason="armed",
    inputs=Inputs(
        0.0,
        armed=True,
        strokes=StrokeSample(0.0, (68.25,) * 4, (-9.41,) * 4, (-1000,) * 4, 0),
        wheels_left=WHEELS,
        wheels_right=WHEELS,
        drive_left=SAMPLE,
        drive_right=SAMPLE,
    ),
    outputs=Outputs(
        (-9.41,) * 4, (-399.5,) * 4, Estimate(ready=True, roll_rad=-0.4, pitch_rad=-0.4), "level"
    ),
    links=(
        replace(BOARD, name="mega_suspension", state="emergency"),
        replace(BOARD, name="nano_imu"),
        replace(BOARD, name="mega_speed (left)"),
        BOARD,
        replace(DRIVE, name="roboteq (left)"),
        DRIVE,
    ),
)
OVERVIEW = Overview(
    (-29.9,) * 4, (-16.87,) * 4, (-349.0,) * 4, (350.0,) * 4, (99_900.0,) * 4, 0.87, (0.11, 0.133)
)


def lines(record: Record, width: int = 80, height: int | None = None) -> list[str]:
    console = Console(width=width, file=io.StringIO())
    page = Page(record, OVERVIEW, ["one", "two"], "TIGER, emulated", keys=True)
    with console.capture() as capture:
        console.print(page, height=height)
    return [line.rstrip() for line in capture.get().splitlines()]


def test_nothing_is_cut_at_80_columns() -> None:
    drawn = lines(RECORD)
    assert not any("…" in line for line in drawn)
    assert all(len(line) <= 80 for line in drawn)


def problems(count: int) -> tuple[Problem, ...]:
    step = "Check its cable, its line in the table of links, and whatever else may be wrong with it."
    return tuple(
        Problem(ProblemKind.LIMIT, f"device {k}", "newest sample is 256 ms old, the limit is 240", step)
        for k in range(count)
    )


@pytest.mark.parametrize("count", range(5))
def test_a_screen_of_24_lines_holds_all_links_with_up_to_four_problems(count: int) -> None:
    drawn = lines(replace(RECORD, problems=problems(count)), height=24)
    assert len(drawn) <= 24
    assert drawn[0].startswith("TIGER")
    assert sum(line.startswith("! device") for line in drawn) == count
    assert sum(line.startswith(("mega_", "nano_", "roboteq")) for line in drawn) == 6


def test_what_is_left_out_first_is_the_log_then_figures_and_advice_then_the_end() -> None:
    two = replace(RECORD, problems=problems(2))
    whole = len(lines(two))
    assert lines(two, height=whole)[-2:] == ["one", "two"]
    assert lines(two, height=whole - 1)[-1] == "two"
    without_log = lines(two, height=whole - 2)
    assert without_log == lines(two)[:-2]
    brief = lines(two, height=whole - 3)
    assert not any("torque" in line or "Check" in line for line in brief)
    assert brief[-2:] == ["one", "two"]  # in the room that is left
    assert [line for line in lines(two, height=5) if line.startswith("! device")]


def test_the_page_keeps_to_the_height_of_the_terminal_it_fills(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    console = Console(width=80, height=24, file=terminal, force_terminal=True, color_system=None)
    monkeypatch.setattr("tiger.cli.live.Console", lambda: console)
    crowded = replace(RECORD, problems=problems(4))
    with whole_terminal() as live:
        live.update(Page(crowded, OVERVIEW, ["one"], "TIGER", keys=True), refresh=True)
    assert terminal.getvalue().count("roboteq (right)") == 1


def test_a_screen_with_room_has_everything() -> None:
    assert lines(RECORD, height=60) == lines(RECORD)


def test_every_link_is_told_with_its_health() -> None:
    (line,) = [line for line in lines(RECORD) if line.startswith("mega_speed (right)")]
    assert line.split() == [
        "mega_speed",
        "(right)",
        "running",
        "98M",
        "4321",
        "12k",
        "12.3",
        "-1092",
        "1877",
        "5.0",
    ]
    (line,) = [line for line in lines(RECORD) if line.startswith("roboteq (right)")]
    assert line.split() == ["roboteq", "(right)", "configuring", "45M", "9999+12", "3456", "24.1"]


def test_only_what_can_be_armed_is_disarmed() -> None:
    links = [replace(BOARD, name=name) for name in ("mega_suspension", "nano_imu", "mega_speed (left)")]
    drawn = lines(replace(RECORD, links=tuple(links)))[-5:-2]
    assert [line.split()[-8] for line in drawn] == ["disarmed", "running", "running"]


def test_battery_and_reach_are_told() -> None:
    (line,) = [line for line in lines(RECORD) if line.startswith("battery")]
    assert line.startswith("battery 24.0 V, 1400 W, 111 Wh taken; reach ±6.3° roll")
    assert "87 %" in line


def test_problems_come_before_everything_that_may_be_below_the_screen() -> None:
    problem = Problem(ProblemKind.FAULT, "roboteq (left) on /dev/left", "undervoltage", "Charge the battery.")
    drawn = lines(replace(RECORD, problems=(problem,)))
    (place,) = [k for k, line in enumerate(drawn) if line.startswith("! roboteq")]
    assert place <= 3


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0"), (9_999, "9999"), (10_000, "10k"), (9_999_999, "9999k"), (10_000_000, "10M"), (10**13, "many")],
)
def test_counts_are_short(count: int, text: str) -> None:
    assert _short(count) == text
