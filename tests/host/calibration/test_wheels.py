"""Wheel radius and yaw scale: a small state machine over records, and the whole on the emulated robot."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tiger.calibration.driving import Course, calibrate_wheels, virtual_ticks
from tiger.calibration.person import EmulatedPerson, measured
from tiger.calibration.procedure import CalibrationError, Measure, What
from tiger.calibration.wheels import (
    ARM_PATIENCE_S,
    Drive,
    DriveState,
    Phase,
    as_toml,
    solve,
    step,
    wrong_angle,
    wrong_distance,
)
from tiger.config.robot import load_robot
from tiger.emulation.scenarios import Scenario
from tiger.record import Command, DaemonState, Inputs, Mode, Outputs, Record
from tiger.rig.virtual import Rig

SMOOTH_FLOOR = Scenario(title="smooth floor", duration_s=99.0, friction=0.2)
ROBOT = load_robot(None)
RADIUS_M = ROBOT.vehicle.tire.rolling_radius_m
AHEAD = Drive(RADIUS_M, distance_m=2.0)


def record(now_s: float, state: DaemonState) -> Record:
    return Record(0, state, "because", Inputs(now_s, state is DaemonState.ARMED), Outputs())


def test_a_drive_waits_for_arming_and_commands_nothing_meanwhile() -> None:
    state, command = step(AHEAD, DriveState(), record(0.0, DaemonState.DISARMED))
    assert state.phase is Phase.ARM
    assert command == Command(mode=Mode.HOLD)
    with pytest.raises(CalibrationError, match="not armed after"):
        step(AHEAD, state, record(ARM_PATIENCE_S + 0.1, DaemonState.DISARMED))


def test_a_drive_that_is_stopped_ends_with_the_reason() -> None:
    with pytest.raises(CalibrationError, match=r"stopped while driving \(because\)"):
        step(AHEAD, DriveState(Phase.GO, 0.0), record(1.0, DaemonState.FAULT))


def test_a_turn_begins_gently_and_keeps_its_direction() -> None:
    right = Drive(RADIUS_M, angle_rad=-6.28)
    rates = [right.command(0.1 * k).yaw_rate_radps for k in range(40)]
    assert rates[0] == 0.0
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] < -0.3


def _travelled(wheel_rad: tuple[float, float, float, float]) -> DriveState:
    return DriveState(Phase.END, wheel_rad=wheel_rad, stroke_mm=(35.0,) * 4, yaw_rad=6.28)


def test_the_factors_follow_from_teeth_tape_and_turns() -> None:
    straight = _travelled((12.0,) * 4)
    turning = _travelled((-40.0, 40.0, -40.0, 40.0))
    one = solve(ROBOT, straight, 12.0 * RADIUS_M, turning, 2.0 * math.pi)
    bigger = solve(ROBOT, straight, 12.0 * RADIUS_M * 1.05, turning, 2.0 * math.pi)
    radius, track = (finding.value for finding in one.findings[:2])
    assert radius == pytest.approx(1.0)
    assert [finding.value for finding in bigger.findings[:2]] == pytest.approx([1.05 * radius, 1.05 * track])
    assert as_toml(one).startswith("[drive]\nwheel_radius_factor = 1.0000\neffective_track_factor = ")


@pytest.mark.parametrize(
    ("wheel_rad", "metres", "reason"),
    [((12.0,) * 4, 3.0, "measure again"), ((-12.0,) * 4, 2.0, "did not drive ahead")],
)
def test_figures_that_cannot_be_are_refused(wheel_rad, metres, reason) -> None:
    turning = _travelled((-40.0, 40.0, -40.0, 40.0))
    with pytest.raises(CalibrationError, match=reason):
        solve(ROBOT, _travelled(wheel_rad), metres, turning, 2.0 * math.pi)


def _yaw_turned_deg(robot, seconds: float = 4.0) -> float:
    """What the robot turns in that time when 20 degrees/s are asked for, the gyro's loop off."""
    rig = Rig(robot, SMOOTH_FLOOR, seed=3)
    rig.daemon.arm(10.0)
    armed = next(r for r in rig.run(20.0) if r.state is DaemonState.ARMED)
    assert armed
    rig.daemon.command = Command(mode=Mode.HOLD, yaw_rate_radps=math.radians(20.0))
    for _ in rig.run(3.0):
        pass
    start = rig.robot.truth().yaw_deg
    for _ in rig.run(seconds):
        pass
    return math.remainder(rig.robot.truth().yaw_deg - start, 360.0)


def test_with_the_factors_found_the_robot_turns_as_it_is_told() -> None:
    rig = Rig(ROBOT, SMOOTH_FLOOR, seed=3)
    result = calibrate_wheels(
        rig.config, rig.daemon, virtual_ticks(rig), EmulatedPerson(rig), Course(1.0, turns=1)
    )
    values = {finding.name: finding.value for finding in result.findings}
    assert rig.daemon.state is DaemonState.DISARMED
    assert values["wheel_radius_factor"] == pytest.approx(1.0, abs=0.03)
    assert values["effective_track_factor"] > 1.5  # without it the robot would miss that much of its turn
    assert values["gyro over what was turned"] == pytest.approx(1.0, abs=0.02)
    names = ("wheel_radius_factor", "effective_track_factor")
    blind = ROBOT.drive.model_copy(update={"yaw_rate_gain_per_s": 0.0})
    found = blind.model_copy(update={name: values[name] for name in names})
    asked_deg = 4.0 * 20.0
    after = _yaw_turned_deg(ROBOT.model_copy(update={"drive": found}))
    assert abs(after - asked_deg) < 0.02 * asked_deg


class Typist(EmulatedPerson):
    """Types what it is told to, then what it measures."""

    def __init__(self, rig: Rig, **typed: list[float]) -> None:
        super().__init__(rig)
        self.typed = typed
        self.asked: list[str] = []
        self.permitted: list[str] = []

    def permit(self, text: str) -> bool:
        self.permitted.append(text)
        return True

    def measure(self, ask: Measure) -> tuple[float, ...]:
        self.asked.append(ask.text)
        waiting = self.typed.get(ask.what.value, [])
        return (waiting.pop(0),) if waiting else super().measure(ask)


def test_a_distance_that_cannot_be_is_asked_again_and_the_robot_never_drives_on() -> None:
    rig = Rig(ROBOT, SMOOTH_FLOOR, seed=3)
    person = Typist(rig, distance=[0.0, math.nan, 100.0])
    with pytest.raises(CalibrationError, match=r"100 m is .* of the .* begin again"):
        calibrate_wheels(rig.config, rig.daemon, virtual_ticks(rig), person, Course(0.5, turns=1))
    assert "wheels: 0 m is 0.00 of the " in person.asked[1]
    assert "nan is no measured value; type a number" in person.asked[2]
    assert len(person.asked) == 3
    assert len(person.permitted) == 1
    assert rig.daemon.state is not DaemonState.ARMED


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.79, 1.21, 100.0, math.inf, math.nan])
def test_a_distance_far_from_what_the_wheels_rolled_is_not_believed(factor: float) -> None:
    rolled = _travelled((12.0,) * 4)
    wrong = wrong_distance(ROBOT, rolled, factor * 12.0 * RADIUS_M)
    assert wrong is not None
    assert "measure again" in wrong
    assert wrong_distance(ROBOT, rolled, 1.19 * 12.0 * RADIUS_M) is None


@pytest.mark.parametrize("turned_deg", [0.0, -360.0, 280.0, 440.0, math.nan])
def test_an_angle_far_from_what_the_gyro_counted_is_not_believed(turned_deg: float) -> None:
    turning = _travelled((-40.0, 40.0, -40.0, 40.0))
    wrong = wrong_angle(turning, math.radians(turned_deg))
    assert wrong is not None
    assert "count the full turns" in wrong
    assert wrong_angle(turning, math.radians(290.0)) is None


def test_a_slip_of_the_finger_is_asked_again_and_then_taken() -> None:
    class Typing:
        typed = iter([(math.nan,), (0.0,), (5.0,)])

        def measure(self, ask: Measure) -> tuple[float, ...]:
            return next(self.typed)

    ask = Measure("How far?", What.DISTANCE, lambda typed: None if typed[0] > 0.0 else "nowhere")
    assert measured(Typing(), ask) == (5.0,)


def test_nothing_is_driven_without_leave() -> None:
    rig = Rig(ROBOT, SMOOTH_FLOOR, seed=3)
    person = EmulatedPerson(rig)
    person.permit = lambda text: False
    with pytest.raises(CalibrationError, match="not permitted to move"):
        calibrate_wheels(rig.config, rig.daemon, virtual_ticks(rig), person, Course(2.0, 1))
    assert rig.daemon.state is not DaemonState.ARMED
    drive_off = ROBOT.model_copy(update={"drive": ROBOT.drive.model_copy(update={"enabled": False})})
    with pytest.raises(CalibrationError, match=r"drive.enabled = false"):
        calibrate_wheels(drive_off, rig.daemon, virtual_ticks(rig), person, Course(2.0, 1))


def test_a_drive_counts_from_where_it_was_armed() -> None:
    rig = Rig(ROBOT, SMOOTH_FLOOR, seed=3)
    rig.daemon.arm(10.0)
    last = next(r for r in rig.run(20.0) if r.state is DaemonState.ARMED)
    wheels = last.inputs.wheels_left
    assert wheels is not None
    moved = replace(wheels, edge_counts=(240, 240))
    armed = replace(last, inputs=replace(last.inputs, wheels_left=moved, wheels_right=moved))
    state, _ = step(AHEAD, DriveState(), armed)
    state, command = step(AHEAD, state, armed)
    assert state.wheel_rad == pytest.approx((0.0,) * 4)
    assert command.speed_mps > 0.0
