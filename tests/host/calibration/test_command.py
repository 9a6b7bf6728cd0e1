"""`tiger calibrate`: asks before it stores, refuses in one clear line, writes what it is asked to write."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import pytest
import typer
from typer.testing import CliRunner, Result

from tiger.calibration import driving, station
from tiger.cli.commands import app
from tiger.daemon import discovery

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def standing(tmp_path: Path) -> str:
    """A scenario in which nothing happens."""
    file = tmp_path / "standing.toml"
    file.write_text('title = "stands"\nduration_s = 60.0\n')
    return str(file)


@pytest.fixture
def tiger(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    def run(*words: str, typed: str = "") -> Result:
        monkeypatch.setattr(sys, "argv", ["tiger", *words])
        return CliRunner().invoke(app, list(words), input=typed)

    return run


def test_the_result_is_shown_written_and_stored(tiger, standing, tmp_path) -> None:
    file = tmp_path / "imu.json"
    result = tiger("calibrate", "imu", "--emulate", standing, "--seconds", "3", "--yes", "--json", str(file))
    assert result.exit_code == 0, result.output
    assert "gyro bias x" in result.output
    assert "Stored on nano_imu, read back and compared." in result.output
    report = json.loads(file.read_text())
    assert report["calibration"] == "imu"
    assert len(report["parameters"]["gyro_bias_radps"]) == 3


def test_nothing_is_stored_unless_the_user_agrees(tiger, standing) -> None:
    result = tiger("calibrate", "level", "--emulate", standing, typed="n\n")
    assert result.exit_code == 1
    assert "Store this in the EEPROM of nano_imu?" in result.output
    assert "Nothing was stored." in result.output


def test_figures_to_the_screen_are_all_there_is_on_standard_output(tiger, standing) -> None:
    result = tiger("calibrate", "imu", "--emulate", standing, "--seconds", "3", "--json", "-", typed="y\n")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["calibration"] == "imu"
    assert "Stored on nano_imu" in result.stderr


def test_an_input_that_ends_stores_nothing_and_says_why(tiger, standing) -> None:
    result = tiger("calibrate", "imu", "--emulate", standing, "--seconds", "3", typed="")
    assert result.exit_code == 2
    assert "The input ended before the answer: nothing was stored" in result.stderr
    assert "Aborted" not in result.output


def test_ctrl_c_at_a_question_ends_like_anywhere_else(tiger, standing, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> bool:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise typer.Abort from None  # as typer does it

    monkeypatch.setattr(typer, "confirm", interrupted)
    result = tiger("calibrate", "imu", "--emulate", standing, "--seconds", "3")
    assert result.exit_code == 130
    assert "Ended by you: everything is disarmed, nothing was stored." in result.stderr


def test_the_strokes_are_drawn(tiger, standing, tmp_path) -> None:
    result = tiger(
        "calibrate", "strokes", "--emulate", standing, "--positions", "2", "--yes", "--plots", str(tmp_path)
    )
    assert result.exit_code == 0, result.output
    assert (tmp_path / "figure-3-9.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("wheels",), "give --arm"),
        (("wheels", "--arm", "--turns", "0"), "--turns 0"),
        (("imu", "--emulate", "no-such-thing"), "no-such-thing"),
        (("imu", "--config", "/no/such.toml"), "check the path"),
    ],
)
def test_what_cannot_be_is_refused_in_words(tiger, words, reason) -> None:
    result = tiger("calibrate", *words)
    assert result.exit_code == 2
    assert reason in result.output
    assert "Traceback" not in result.output


@pytest.mark.parametrize("words", [["imu"], ["wheels", "--arm"]])
def test_without_a_robot_it_says_what_to_connect(tiger, tmp_path, monkeypatch, words) -> None:
    monkeypatch.setattr(discovery, "GRACE_S", 0.1)
    monkeypatch.setattr(station, "CONNECT_PATIENCE_S", 0.3)
    monkeypatch.setattr(driving, "CONNECT_PATIENCE_S", 0.3)
    config = tmp_path / "robot.toml"
    config.write_text('[ports]\nboards = ["/nowhere/board-*"]\n')
    result = tiger("calibrate", *words, "--config", str(config))
    assert result.exit_code == 1
    assert "was not found on /nowhere/board-*" in result.output
    assert "Connect it" in result.output
