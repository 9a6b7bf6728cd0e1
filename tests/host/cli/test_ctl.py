"""`tiger ctl`: one word, one answer, a status for scripts."""

from __future__ import annotations

import json
import math
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from tiger.cli.ctl import app
from tiger.daemon import client
from tiger.daemon.client import Robot
from tiger.record import Mode


def ctl(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


@pytest.fixture
def disarmed(running: Any) -> Any:
    """The running robot, disarmed and without faults."""
    for words in (("disarm",), ("clear",)):
        ctl(*words)
    return running


@pytest.mark.parametrize("words", [("status",), ("arm",), ("estop",), ("drive", "--speed", "1")])
def test_without_a_daemon_it_says_what_to_do(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TIGER_SOCKET", str(tmp_path / "none.sock"))
    result = ctl(*words)
    assert result.exit_code == 2
    assert result.output.strip() == f"no daemon listens on {tmp_path}/none.sock; start it: tiger run"


def test_arm_waits_until_the_robot_is_armed_and_disarm_until_it_is_not(disarmed: Any) -> None:
    armed = ctl("arm")
    assert (armed.exit_code, armed.output.splitlines()[0]) == (0, "ARMED: armed; mode level")
    again = ctl("disarm")
    assert again.exit_code == 0
    assert again.output.startswith("DISARMED: ")


def test_status_shows_the_robot_and_what_can_be_asked_of_it(disarmed: Any) -> None:
    text = ctl("status").output
    assert "DISARMED" in text
    assert "within the strokes: roll ±" in text
    assert "ride height 1.5 to 68.5 mm" in text
    answer = json.loads(ctl("status", "--json").output)
    assert answer["ok"]
    assert len(answer["status"]["record"]["inputs"]["strokes"]["stroke_mm"]) == 4


def test_modes_poses_and_heights_reach_the_daemon(disarmed: Any) -> None:
    daemon = disarmed.rig.daemon
    assert ctl("mode", "hold").output == "mode hold\n"
    assert daemon.command.mode is Mode.HOLD
    assert ctl("pose", "--roll", "3", "--pitch", "-2", "--height", "40").output == "mode pose\n"
    command = daemon.command
    assert (command.mode, command.ride_stroke_mm) == (Mode.POSE, 40.0)
    assert (command.roll_rad, command.pitch_rad) == pytest.approx((math.radians(3.0), math.radians(-2.0)))
    assert ctl("height", "20").output == "ride height: mean stroke 20 mm\n"
    assert daemon.command.ride_stroke_mm == 20.0
    ctl("height")
    assert daemon.command.ride_stroke_mm is None


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("pose", "--roll", "40"), "roll = 40 is outside -15 to 15 degrees (leveling.max_angle_deg)"),
        (("height", "500"), "ride_stroke_mm = 500 is outside 1.5 to 68.5"),
        (("drive", "--speed", "0.2"), "Arm it first."),
    ],
)
def test_a_refusal_is_one_line_and_status_1(disarmed: Any, words: tuple[str, ...], reason: str) -> None:
    before = disarmed.rig.daemon.command
    result = ctl(*words)
    assert result.exit_code == 1
    assert result.output.startswith("refused: ")
    assert reason in result.output
    assert result.output.count("\n") == 1
    assert disarmed.rig.daemon.command == before


def test_a_mode_that_does_not_exist_is_answered_with_those_that_do() -> None:
    result = ctl("mode", "jump")
    assert result.exit_code == 2
    assert result.output == "jump: is no mode; choose one of hold, level, balance, pose, stow\n"


def test_drive_drives_for_so_long_and_then_stands(disarmed: Any) -> None:
    ctl("mode", "hold")
    assert ctl("arm").exit_code == 0
    disarmed.fastest_radps = 0.0
    result = ctl("drive", "--speed", "0.4", "--for", "1.5")
    assert (result.exit_code, result.output) == (0, "drove for 1.5 s; it slows down and stands still\n")
    assert disarmed.fastest_radps > 1.0
    assert disarmed.rig.daemon.command.speed_mps == 0.0
    assert disarmed.api.desk.helm is None


def test_clear_does_not_stop_an_armed_robot(disarmed: Any) -> None:
    assert ctl("arm").exit_code == 0
    assert ctl("clear").output.startswith("ARMED")
    disarmed.rig.daemon.clear()  # as the key c of `tiger run` does
    assert ctl("status").output.startswith("ARMED")
    assert "nothing to clear" in disarmed.rig.daemon.log_lines[-1]


def test_estop_stops_whoever_drives_and_arm_is_refused_until_clear(disarmed: Any) -> None:
    assert ctl("arm").exit_code == 0
    with Robot() as driver:
        driver.ask("drive", speed_mps=0.3)
        assert "emergency stop" in ctl("estop").output
        assert disarmed.rig.daemon.command.speed_mps == 0.0
    refused = ctl("arm")
    assert (refused.exit_code, "ESTOP" in refused.output) == (1, True)
    assert ".." not in refused.output
    cleared = ctl("clear", "--json")
    assert cleared.exit_code == 0
    assert json.loads(cleared.output)["state"] == "DISARMED"


def test_the_example_of_the_page_drives_the_robot(disarmed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[3] / "docs" / "api.md").read_text()
    example = text[text.index("    import time\n") :].partition("\n## ")[0]
    monkeypatch.setitem(sys.modules, "client", client)
    disarmed.fastest_radps = 0.0
    exec(textwrap.dedent(example))
    assert disarmed.fastest_radps > 1.0
    assert disarmed.rig.daemon.command.speed_mps == 0.0
