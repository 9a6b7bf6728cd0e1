"""`tiger teleop`: nothing drives unless something is held."""

from __future__ import annotations

import errno
import math
import os
import pty
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from tiger.cli.commands import app
from tiger.cli.teleop import (
    ABS,
    AXES,
    BUTTONS,
    CLEAR_LINE,
    DEAD_ZONE,
    DPAD_Y,
    EVENT,
    FIRST_HOLD_S,
    KEY,
    LEVELS,
    MOVES,
    REPEAT_HOLD_S,
    SELECT,
    START,
    STATUS_EVERY,
    STILL,
    SYN,
    SYN_DROPPED,
    Gamepad,
    GamepadDevice,
    Keyboard,
    Keys,
    Lines,
    Teleop,
    operate,
)
from tiger.daemon.client import Refused, Robot

if TYPE_CHECKING:
    from pathlib import Path

# ----------------------------------------------------------------------------------------- keyboard


@pytest.mark.parametrize("key", MOVES)
def test_a_key_moves_while_the_terminal_repeats_it(key: str) -> None:
    keys = Keys()
    keys.press(key, 0.0)
    assert keys.motion(0.99 * FIRST_HOLD_S) == MOVES[key]  # until the terminal begins to repeat
    for n in range(20):
        now_s = 0.5 + n * 0.033
        keys.press(key, now_s)
        assert keys.motion(now_s) == MOVES[key]
    assert keys.motion(now_s + REPEAT_HOLD_S) == STILL


def test_a_key_pressed_once_moves_no_longer_than_the_pause_before_repeats() -> None:
    keys = Keys()
    keys.press("i", 0.0)
    assert keys.motion(FIRST_HOLD_S) == STILL


@pytest.mark.parametrize("key", ["x", "a", " ", "3", "\x1b[H"])
def test_any_other_key_stops(key: str) -> None:
    keys = Keys()
    keys.press("i", 0.0)
    keys.press(key, 0.01)
    assert keys.motion(0.02) == STILL


def test_keys_ask_and_choose_the_level() -> None:
    keys = Keys()
    assert keys.press("ad c 4q", 0.0) == ["arm", "disarm", "estop", "clear", "estop", "quit"]
    assert keys.level == 4
    keys.press("0679", 0.0)
    assert keys.level == 4


def test_an_arrow_within_other_keys_is_one_key() -> None:
    keys = Keys()
    assert keys.press("2\x1b[Aa\x1b[D", 0.0) == ["arm"]
    assert keys.motion(0.1) == MOVES["\x1b[D"]


@given(st.lists(st.tuples(st.text(max_size=5), st.floats(0.0, 0.2)), max_size=50))
def test_whatever_is_typed_motion_ends_after_the_last_key(typed: list[tuple[str, float]]) -> None:
    keys, now_s = Keys(), 0.0
    for text, pause_s in typed:
        now_s += pause_s
        keys.press(text, now_s)
        assert max(map(abs, keys.motion(now_s))) <= 1.0
        assert 1 <= keys.level <= LEVELS
    assert keys.motion(now_s + FIRST_HOLD_S) == STILL


# ------------------------------------------------------------------------------------------ gamepad


def event(kind: int, code: int, value: int) -> bytes:
    return EVENT.pack(1_700_000_000, 999_999, kind, code, value) + EVENT.pack(
        1_700_000_000, 999_999, SYN, 0, 0
    )


SHOULDER = BUTTONS["left-shoulder"]
HOLD, LET_GO = event(KEY, SHOULDER, 1), event(KEY, SHOULDER, 0)
FORWARD = event(ABS, AXES["y"], -32768)


def test_a_stick_moves_only_while_the_dead_man_button_is_held() -> None:
    pad = Gamepad()
    pad.feed(FORWARD)
    assert pad.motion(0.0) == STILL
    pad.feed(HOLD)
    assert pad.motion(0.0) == (1.0, 0.0)
    pad.feed(LET_GO)
    assert pad.motion(0.0) == STILL


def test_a_button_that_repeats_is_still_held() -> None:
    pad = Gamepad()
    pad.feed(FORWARD + HOLD + event(KEY, SHOULDER, 2))
    assert pad.motion(0.0) == (1.0, 0.0)


def test_after_lost_events_the_dead_man_button_must_be_pressed_again() -> None:
    pad = Gamepad()
    pad.feed(HOLD + FORWARD + EVENT.pack(0, 0, SYN, SYN_DROPPED, 0))
    assert pad.motion(0.0) == STILL
    pad.feed(FORWARD)
    assert pad.motion(0.0) == STILL
    pad.feed(HOLD)
    assert pad.motion(0.0) == (1.0, 0.0)


def test_left_on_the_stick_turns_left_and_small_deflections_do_nothing() -> None:
    pad = Gamepad()
    pad.feed(HOLD + event(ABS, AXES["rx"], -32768) + event(ABS, AXES["y"], int(0.9 * DEAD_ZONE * 32768)))
    assert pad.motion(0.0) == (0.0, 1.0)


@pytest.mark.parametrize(("low", "high"), [(0, 255), (-32768, 32767), (0, 65535), (-128, 127)])
def test_a_stick_of_any_range_reaches_both_ends_and_rests_in_its_middle(low: int, high: int) -> None:
    pad = Gamepad(ranges={AXES["y"]: (low, high)})
    pad.feed(HOLD)
    for value, part in ((low, 1.0), (high, -1.0), ((low + high) // 2, 0.0)):
        pad.feed(event(ABS, AXES["y"], value))
        assert pad.motion(0.0) == pytest.approx((part, 0.0), abs=1e-3)


def test_buttons_ask_when_pressed_and_the_pad_steps_the_level() -> None:
    pad = Gamepad()
    pressed = b"".join(
        event(KEY, code, 1) + event(KEY, code, 0) for code in (START, SELECT, BUTTONS["b"], BUTTONS["a"])
    )
    assert pad.feed(pressed) == ["arm", "disarm", "estop"]
    up = event(ABS, DPAD_Y, -1) + event(ABS, DPAD_Y, 0)
    pad.feed(up * 9)
    assert pad.level == LEVELS
    pad.feed(event(ABS, DPAD_Y, 1))
    assert pad.level == LEVELS - 1


@given(st.lists(st.binary(max_size=30), max_size=30))
def test_no_bytes_break_the_gamepad_and_their_cutting_does_not_matter(chunks: list[bytes]) -> None:
    pad, whole = Gamepad(), Gamepad()
    asked = [what for chunk in chunks for what in pad.feed(chunk)]
    assert asked == whole.feed(b"".join(chunks))
    assert pad == whole
    assert all(math.isfinite(part) and abs(part) <= 1.0 for part in pad.motion(0.0))


# -------------------------------------------------------------------------------------- the program


def nobody(_: str) -> None:
    """Nobody listens."""


class FakeRobot:
    """Answers like a daemon in some state."""

    def __init__(self, state: str = "ARMED") -> None:
        self.state = state
        self.problems: list[dict[str, str]] = []
        self.asked: list[tuple[str, dict[str, float]]] = []

    def ask(self, do: str, **fields: float) -> dict[str, Any]:
        self.asked.append((do, fields))
        if do == "drive" and self.state != "ARMED":
            raise Refused("no")
        status = {"state": self.state, "reason": "", "record": {"problems": self.problems}}
        limits = {"speed_mps": (-3.0, 3.0), "yaw_rate_radps": (-1.5, 1.5)}
        return {"text": "", "status": status, "limits": limits}


@pytest.mark.parametrize("level", range(1, LEVELS + 1))
def test_each_level_is_a_fifth_of_what_the_config_allows(level: int) -> None:
    robot = FakeRobot()
    Teleop(robot, nobody, nobody).step((1.0, -0.5), level)  # type: ignore[arg-type]
    assert robot.asked[-1][0] == "drive"
    assert robot.asked[-1][1]["speed_mps"] == pytest.approx(0.6 * level)
    assert robot.asked[-1][1]["yaw_rate_radps"] == pytest.approx(-0.15 * level)


@pytest.mark.parametrize("state", ["DISARMED", "FAULT", "ESTOP", "HANDSHAKE"])
def test_it_tells_a_robot_that_is_not_armed_nothing(state: str) -> None:
    robot = FakeRobot(state)
    teleop = Teleop(robot, nobody, nobody)  # type: ignore[arg-type]
    for _ in range(10):
        teleop.step((1.0, 0.0), 5)
    assert {do for do, _ in robot.asked} == {"status"}


def test_it_says_and_shows_what_it_does_once() -> None:
    said: list[str] = []
    shown: list[str] = []
    teleop = Teleop(FakeRobot(), said.append, shown.append)  # type: ignore[arg-type]
    for motion in [(1.0, 0.0)] * 5 + [STILL] * 5:
        teleop.step(motion, 1)
    assert said == ["ARMED: "]
    assert shown == ["level 1: +0.60 m/s, +0 degrees/s", "level 1: +0.00 m/s, +0 degrees/s"]


def test_a_new_problem_does_not_repeat_the_state() -> None:
    said: list[str] = []
    robot = FakeRobot("FAULT")
    teleop = Teleop(robot, said.append, nobody)  # type: ignore[arg-type]
    for robot.problems in ([], [{"where": "nano_imu", "text": "is gone"}], []):
        for _ in range(STATUS_EVERY):
            teleop.step(STILL, 1)
    assert said == ["FAULT: ", "nano_imu: is gone"]


def test_the_motion_is_written_over_on_a_terminal_and_a_line_each_elsewhere(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for terminal, text in ((True, f"1{CLEAR_LINE}2{CLEAR_LINE}stop\n3\n"), (False, "1\n2\nstop\n3\n")):
        monkeypatch.setattr("sys.stdout.isatty", lambda terminal=terminal: terminal)
        lines = Lines()
        lines.show("1")
        lines.show("2")
        lines.say("stop")
        lines.show("3")
        lines.end()
        assert capsys.readouterr().out == text


class FakeDevice:
    """A named pipe in place of /dev/input/event*: what is written to it, the gamepad does."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "event7"
        os.mkfifo(self.path)
        self._end = os.open(self.path, os.O_RDWR)

    def do(self, events: bytes) -> None:
        os.write(self._end, events)

    def vanish(self) -> None:
        os.close(self._end)


def test_a_lost_gamepad_stops_the_robot(tmp_path: Path) -> None:
    device = FakeDevice(tmp_path)
    pad = GamepadDevice()
    pad.path = device.path
    robot = FakeRobot()
    with pad:
        device.do(HOLD + FORWARD)
        device.vanish()
        with pytest.raises(OSError, match="gone"):
            operate(pad, Teleop(robot, nobody, nobody))  # type: ignore[arg-type]
    assert robot.asked[-1][0] == "release"


def test_a_gamepad_that_the_kernel_takes_away_stops_the_robot(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    device = FakeDevice(tmp_path)
    pad = GamepadDevice()
    pad.path = device.path
    robot = FakeRobot()
    with pad:
        device.do(HOLD + FORWARD)

        def gone(*_: object) -> bytes:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

        monkeypatch.setattr(os, "read", gone)
        with pytest.raises(OSError, match="No such device"):
            operate(pad, Teleop(robot, nobody, nobody))  # type: ignore[arg-type]
    assert robot.asked[-1][0] == "release"
    device.vanish()


def test_a_person_with_a_gamepad_arms_drives_and_lets_go_and_the_gamepad_vanishes(
    running: Any, tmp_path: Path
) -> None:
    """Real events through a pipe and the real socket to the daemon on the emulated robot."""
    device = FakeDevice(tmp_path)
    pad = GamepadDevice(level=2)
    pad.path = device.path
    daemon = running.rig.daemon
    speeds: dict[str, float] = {}

    def drive() -> None:
        device.do(event(KEY, START, 1) + event(KEY, START, 0))
        _until(lambda: daemon.state.name == "ARMED")
        device.do(FORWARD)
        time.sleep(0.3)
        speeds["stick alone"] = daemon.command.speed_mps
        device.do(HOLD)
        _until(lambda: daemon.command.speed_mps != 0.0)
        speeds["held"] = daemon.command.speed_mps
        device.do(LET_GO)
        _until(lambda: daemon.command.speed_mps == 0.0)
        speeds["let go"] = daemon.command.speed_mps
        device.do(event(ABS, DPAD_Y, -1) + HOLD)
        _until(lambda: daemon.command.speed_mps != 0.0)
        speeds["held at level 3"] = daemon.command.speed_mps
        device.vanish()

    person = threading.Thread(target=drive)
    with Robot() as robot, pad:
        person.start()
        with pytest.raises(OSError, match="gone"):
            operate(pad, Teleop(robot, nobody, nobody))
        person.join()
    assert speeds == pytest.approx({"stick alone": 0.0, "held": 1.2, "let go": 0.0, "held at level 3": 1.8})
    _until(lambda: running.api.desk.helm is None)
    assert daemon.command.speed_mps == 0.0
    assert running.api.desk.helm is None


@pytest.mark.parametrize("options", [["--deadman", "pedal"], ["--yaw-axis", "w"]])
def test_a_button_or_stick_that_does_not_exist_is_refused_with_those_that_do(
    monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["tiger", "teleop"])
    done = CliRunner().invoke(app, ["teleop", "--gamepad", "/dev/input/event7", *options])
    assert done.exit_code == 2
    assert "is none of" in done.output


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "there is no terminal to read keys from; run it in one, or drive with --gamepad"),
        (["--gamepad", "/no/such"], "/no/such: cannot be read (No such file or directory)"),
        (["--gamepad", "/dev/null"], "/dev/null: is no gamepad; name its /dev/input/event*, or auto"),
        (["--deadman", "pedal"], "pedal is none of a, b, x"),
    ],
)
def test_hands_that_cannot_be_read_are_refused_before_the_robot_is_asked_for(
    options: list[str], reason: str
) -> None:
    command = [sys.executable, "-m", "tiger.cli.main", "teleop", *options]
    done = subprocess.run(command, capture_output=True, text=True, start_new_session=True)
    assert done.returncode == 2
    assert reason in done.stderr


def test_a_person_at_a_terminal_arms_drives_and_lets_go(running: Any) -> None:
    """Real bytes through a pseudo-terminal and the real socket to the daemon on the emulated robot."""
    ours, theirs = pty.openpty()
    speeds: list[float] = []

    def type_keys() -> None:
        os.write(ours, b"a")
        _until(lambda: running.rig.daemon.state.name == "ARMED")
        for _ in range(20):
            os.write(ours, b"i")
            time.sleep(0.05)
            speeds.append(running.rig.daemon.command.speed_mps)
        time.sleep(REPEAT_HOLD_S + 0.2)
        speeds.append(running.rig.daemon.command.speed_mps)
        os.write(ours, b"q")

    person = threading.Thread(target=type_keys)
    keyboard = Keyboard(level=2)
    keyboard.path = os.ttyname(theirs)
    with Robot() as robot, keyboard:
        person.start()
        operate(keyboard, Teleop(robot, nobody, nobody))
        person.join()
    for descriptor in (ours, theirs):
        os.close(descriptor)
    assert max(speeds) == pytest.approx(1.2)
    assert speeds[-1] == 0.0
    assert running.api.desk.helm is None


def _until(arrived: Any) -> None:
    end_s = time.monotonic() + 10.0
    while not arrived() and time.monotonic() < end_s:
        time.sleep(0.01)
