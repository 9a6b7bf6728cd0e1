"""The daemon on the emulated robot: it arms when all is well, and stops and stays stopped when it is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from tiger.config.robot import RobotConfig, load_robot
from tiger.emulation.scenarios import Scenario
from tiger.protocol import link as link_module
from tiger.protocol.messages import SCHEMA_HASH, BoardKind
from tiger.record import Command, DaemonState, Problem, ProblemKind, Record
from tiger.rig.ports import PATHS
from tiger.rig.virtual import Rig

STANDING = Scenario(title="standing, wheels on stands", duration_s=60.0, model="linear")
ARMED_BY_S = 4.5


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot(None)


@pytest.fixture(scope="module")
def leveler(robot: RobotConfig) -> RobotConfig:
    """A robot without drives, which starts faster."""
    return robot.model_copy(update={"drive": robot.drive.model_copy(update={"enabled": False})})


def run(rig: Rig, seconds: float) -> Record:
    *_, record = rig.run(seconds)
    return record


def armed(rig: Rig) -> Rig:
    rig.daemon.arm(10.0)
    for record in rig.run(ARMED_BY_S):
        if record.state is DaemonState.ARMED:
            run(rig, 0.1)
            return rig
    raise AssertionError(f"not armed: {record.state.name}, {[str(p) for p in record.problems]}")


def one(record: Record, kind: ProblemKind) -> Problem:
    """The one problem of a kind; each problem must say what, where and what to do."""
    assert all(problem.where and problem.text and problem.next_step for problem in record.problems)
    (problem,) = {problem for problem in record.problems if problem.kind is kind}
    return problem


def nothing_moved(rig: Rig) -> bool:
    truth = rig.robot.truth()
    still = max(map(abs, truth.stroke_rate_mmps)) < 1e-9 and max(map(abs, truth.wheel_speed_rpm)) < 1e-9
    return still and not any(rig.robot.suspension.drive())


# ------------------------------------------------------------------------------------------------ all is well


def test_it_finds_its_boards_and_stays_disarmed_until_told(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    record = run(rig, 4.0)
    assert record.state is DaemonState.DISARMED
    assert record.problems == ()
    assert all(link.connected for link in record.links)
    assert nothing_moved(rig)


def test_it_arms_when_told_and_disarms_when_told(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.disarm()
    assert run(rig, 0.3).state is DaemonState.DISARMED
    rig.daemon.arm()
    assert run(rig, 0.5).state is DaemonState.ARMED


def test_the_gyros_bias_is_measured_before_arming(leveler: RobotConfig) -> None:
    rig = armed(Rig(leveler, STANDING))
    assert any("gyro bias at rest" in line for line in rig.daemon.log_lines)
    record = run(rig, 0.5)
    assert record.inputs.imu is not None
    assert max(map(abs, record.inputs.imu.rate_radps)) < 0.01


def test_boards_clocks_are_followed(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    record = run(rig, 9.0)
    drifts = {link.name: link.drift_ppm for link in record.links}
    assert drifts["mega_suspension"] == pytest.approx(800.0, abs=150.0)
    assert drifts["mega_speed (right)"] == pytest.approx(-500.0, abs=150.0)


def test_wheels_turn_after_the_check_and_stop_on_disarm(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.command = Command(speed_mps=0.3)
    run(rig, 3.0)
    assert rig.robot.truth().wheel_speed_rpm == pytest.approx((18.0,) * 4, abs=1.0)
    rig.daemon.disarm()
    run(rig, 1.0)
    assert rig.robot.truth().wheel_speed_rpm == pytest.approx((0.0,) * 4, abs=0.5)


def test_at_the_first_motion_one_side_turns_before_the_other(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.command = Command(speed_mps=0.3)
    seen = set()
    for _ in rig.run(2.0):
        fl, fr, rl, rr = rig.robot.truth().wheel_speed_rpm
        if max(map(abs, (fl, fr, rl, rr))) < 16.0:
            seen.add((fl > 8.0 and rl > 8.0, fr > 8.0 and rr > 8.0))
    assert {(True, False), (False, True)} <= seen


def test_after_the_check_the_wheels_start_from_zero(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.command = Command(speed_mps=0.5)
    commands = [0.0, *(max(record.outputs.wheel_rpm) for record in rig.run(3.0))]
    steps = [abs(b - a) for a, b in pairwise(commands)]
    assert max(commands) == pytest.approx(30.0, abs=1.0)
    assert sum(step > 5.0 for step in steps) == 4  # the check itself: left on, off, right on, off


# ---------------------------------------------------------------------------------------- wrong before arming


def refused_to_start(rig: Rig, seconds: float = 8.0) -> Record:
    """Run a robot that was told to arm; it must neither arm nor move."""
    rig.daemon.arm(30.0)
    for record in rig.run(seconds):
        assert record.state is not DaemonState.ARMED
    assert nothing_moved(rig)
    return record


@pytest.mark.parametrize("kind", list(BoardKind))
def test_a_board_with_another_schema_is_named_with_both_hashes(
    robot: RobotConfig, kind: BoardKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "SCHEMA_HASH", {**SCHEMA_HASH, kind: 0x12345678})
    record = refused_to_start(Rig(robot, STANDING), 2.0)
    problem = next(p for p in record.problems if p.kind is ProblemKind.SCHEMA)
    assert kind.name.lower() in problem.where
    assert f"{SCHEMA_HASH[kind]:#010x}" in problem.text
    assert "0x12345678" in problem.text
    assert f"make flash BOARD={kind.name.lower()}" in problem.next_step


def test_a_silent_port_says_that_nothing_answers(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    rig.robot.cables["speed_left"].is_silent = True
    problem = one(refused_to_start(rig), ProblemKind.NO_ANSWER)
    assert problem.where == PATHS["speed_left"]
    assert "nothing here answers HELLO" in problem.text


def test_a_silent_roboteq_is_named(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    rig.robot.drives["right"].silent = True
    problem = one(refused_to_start(rig, 3.0), ProblemKind.NO_ANSWER)
    assert problem.where == f"roboteq (right) on {PATHS['roboteq_right']}"


def test_a_wish_to_arm_that_cannot_be_fulfilled_ends_with_the_reason(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    rig.robot.estop_pressed = True
    rig.daemon.arm(3.0)
    record = run(rig, 4.0)
    assert record.state is DaemonState.ESTOP
    assert any(problem.where == "not armed" for problem in record.problems)
    rig.robot.estop_pressed = False
    run(rig, 1.0)
    rig.daemon.clear()
    record = run(rig, 3.0)
    assert record.state is DaemonState.DISARMED  # the wish to arm is gone
    assert nothing_moved(rig)


# ------------------------------------------------------------------------------------------ wrong while armed


def _change_commands(robot: Any) -> None:
    """Let every speed of the left front wheel arrive as another one."""
    drive = robot.drives["left"]
    hear = drive.receive
    drive.receive = lambda data: hear(data.replace(b"!S 1 1", b"!S 1 9"))


@pytest.mark.parametrize(
    ("break_it", "state", "words"),
    [
        (lambda r: setattr(r.cables["suspension"], "is_silent", True), DaemonState.FAULT, "ms old"),
        (lambda r: setattr(r.drives["left"], "silent", True), DaemonState.FAULT, "roboteq (left)"),
        (lambda r: setattr(r.drives["left"], "fault_flags", 4), DaemonState.FAULT, "undervoltage"),
        (lambda r: setattr(r, "nano_wire_cut", True), DaemonState.FAULT, "nano_imu"),
        (
            _change_commands,
            DaemonState.FAULT,
            "roboteq (left) on /emulated/roboteq-left: commands arrived as",
        ),
    ],
    ids=["suspension silent", "roboteq silent", "roboteq fault", "nano wire", "roboteq line"],
)
def test_what_breaks_while_armed_stops_and_stays_stopped(
    robot: RobotConfig, break_it: Callable[[object], None], state: DaemonState, words: str
) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.command = Command(speed_mps=0.3)
    run(rig, 2.5)
    break_it(rig.robot)
    record = run(rig, 1.0)
    assert record.state is state
    assert any(words in str(problem) for problem in record.problems) or not words
    assert record.outputs.wheel_rpm == record.outputs.stroke_rate_mmps == (0.0,) * 4
    assert max(map(abs, rig.robot.truth().wheel_speed_rpm)) < 1.0
    for cable in rig.robot.cables.values():
        cable.mend()
        cable.is_silent = False
    rig.robot.nano_wire_cut = rig.robot.drives["left"].silent = False
    rig.robot.drives["left"].fault_flags = 0
    vars(rig.robot.drives["left"]).pop("receive", None)
    assert run(rig, 1.0).state is state
    assert max(map(abs, rig.robot.truth().wheel_speed_rpm)) < 1.0
    # Cleared and armed again it works as before, from zero.
    rig.daemon.command = Command()
    rig.daemon.clear()
    assert run(rig, 1.5).state is DaemonState.DISARMED
    rig.daemon.arm(8.0)
    assert any(record.state is DaemonState.ARMED for record in rig.run(5.0))


def test_a_board_that_stops_by_itself_is_shown_with_its_reason(leveler: RobotConfig) -> None:
    rig = armed(Rig(leveler, STANDING))
    rig.hung = True
    for _ in range(70):  # 350 ms without a setpoint
        rig.tick()
    rig.hung = False
    record = run(rig, 0.5)
    assert record.state is DaemonState.FAULT
    assert "no setpoint accepted for 250 ms while armed" in str(one(record, ProblemKind.FAULT))
    rig.daemon.clear()
    assert run(rig, 1.5).state is DaemonState.DISARMED


def test_an_emergency_stop_by_command_stops_everything(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.command = Command(speed_mps=0.3)
    run(rig, 2.5)
    rig.daemon.estop()
    record = run(rig, 1.0)
    assert record.state is DaemonState.ESTOP
    assert nothing_moved(rig) or max(map(abs, rig.robot.truth().wheel_speed_rpm)) < 1.0
    assert all(drive.stage_off for drive in rig.robot.drives.values())
    rig.daemon.command = Command()
    rig.daemon.clear()
    assert run(rig, 3.0).state is DaemonState.DISARMED


def test_a_motor_that_turns_backwards_stops_the_drive(robot: RobotConfig) -> None:
    rig = Rig(robot, STANDING)
    rig.robot.motor_signs = (1.0, -1.0, 1.0, -1.0)
    armed(rig)
    rig.daemon.command = Command(speed_mps=0.5)
    record = run(rig, 2.5)
    assert record.state is DaemonState.FAULT
    assert "turns backwards" in str(one(record, ProblemKind.WIRING))


def test_a_daemon_that_ends_leaves_the_robot_disarmed(robot: RobotConfig) -> None:
    rig = armed(Rig(robot, STANDING))
    rig.daemon.close()
    rig.hung = True
    list(rig.run(0.5))
    rig.robot.run()
    assert nothing_moved(rig)


def test_a_late_imu_holds_the_strokes_still(leveler: RobotConfig) -> None:
    rig = armed(Rig(leveler, STANDING))
    rig.daemon.command = replace(Command(), roll_rad=0.1)
    assert max(map(abs, run(rig, 0.5).outputs.stroke_rate_mmps)) > 5.0
    rig.robot.nano_wire_cut = True
    record = run(rig, 0.15)
    assert record.state is DaemonState.ARMED
    assert record.outputs.stroke_rate_mmps == (0.0,) * 4
    rig.robot.nano_wire_cut = False
    assert max(map(abs, run(rig, 0.3).outputs.stroke_rate_mmps)) > 5.0
