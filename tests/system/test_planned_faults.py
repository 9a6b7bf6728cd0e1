"""Planned faults of a scenario file, end to end: `tiger run` breaks the robot as told and says what to do."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tiger.cli.commands import app

HEAD = 'title = "Faults"\nduration_s = 7.0\nmodel = "linear"\n'


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Return run(fault): the output of `tiger run` on a standing robot with one fault."""

    def command(fault: str) -> str:
        scenario = tmp_path / "faults.toml"
        scenario.write_text(HEAD + "[[fault]]\n" + fault, encoding="utf-8")
        words = ["run", "--emulate", str(scenario), "--virtual-time"]
        monkeypatch.setenv("TIGER_SOCKET", str(tmp_path / "robot.sock"))
        monkeypatch.setattr(sys, "argv", ["tiger", *words])
        return " ".join(CliRunner().invoke(app, words).output.split())

    return command


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (
            'at_s = 5.0\ntarget = "potentiometer_fl"\nkind = "open"\n',
            "front left: potentiometer reads beyond its range",
        ),
        ('at_s = 5.0\ntarget = "suspension"\nkind = "cut"\n', "suspension"),
        ('at_s = 5.0\ntarget = "roboteq_left"\nkind = "silent"\n', "! roboteq"),
        ('at_s = 5.0\ntarget = "nano_imu"\nkind = "brown_out"\n', "nano_imu"),
    ],
)
def test_a_planned_fault_stops_the_robot_which_says_what_is_broken(
    run: Callable[[str], str], fault: str, said: str
) -> None:
    output = run(fault)
    assert "ARMED: armed" in output
    assert said in output.split("ARMED: armed")[1]
    assert "Stopped at 5" in output


def test_a_pressed_e_stop_is_latched(run: Callable[[str], str]) -> None:
    output = run('at_s = 5.0\ntarget = "estop"\nkind = "press"\nfor_s = 0.5\n')
    assert "ESTOP" in output
    assert "ended ESTOP" in output or "ended FAULT" in output


def test_a_fault_that_the_robot_cannot_have_is_refused_before_the_start(
    run: Callable[[str], str],
) -> None:
    output = run('at_s = 5.0\ntarget = "antenna"\nkind = "cut"\n')
    assert "no 'cut' of 'antenna'" in output
    assert "ARMED" not in output
