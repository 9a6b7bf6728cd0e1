"""From speed and yaw rate to wheel speeds: signs, track, limits and ramps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control import drive
from tiger.control.drive import DriveState, Ramp, design_drive, ramp, wheel_speeds_rpm
from tiger.models.track import half_tracks_m, track_of
from tiger.record import STILL, Command, ImuSample, Inputs, StrokeSample, WheelSample

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig

ROBOT = load_robot()
DESIGN = design_drive(ROBOT)
DT = 0.005
MID = (35.0, 35.0, 35.0, 35.0)
STROKES = StrokeSample(0.0, MID, STILL, (0, 0, 0, 0), 0)


def gyro(yaw_rate: float) -> ImuSample:
    return ImuSample(0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, yaw_rate), (0.0,) * 3, (0.0,) * 3, 0)


def tuned(**keys: object) -> RobotConfig:
    return ROBOT.model_copy(update={"drive": ROBOT.drive.model_copy(update=keys)})


# ---- kinematics ---------------------------------------------


def test_forward_turns_all_wheels_alike() -> None:
    rpm = 60.0 / (2.0 * math.pi * ROBOT.vehicle.tire.rolling_radius_m)
    assert wheel_speeds_rpm(DESIGN, 1.0, 0.0, MID) == pytest.approx((rpm,) * 4)


def test_a_left_turn_slows_the_left_wheels() -> None:
    fl, fr, rl, rr = wheel_speeds_rpm(DESIGN, 1.0, 0.5, MID)
    assert fl == rl < fr == rr
    assert fl + fr == pytest.approx(2.0 * wheel_speeds_rpm(DESIGN, 1.0, 0.0, MID)[0])


def test_every_wheel_turns_on_its_own_half_of_the_track() -> None:
    strokes = (70.0, 10.0, 35.0, 0.0)
    at = [DESIGN.rpm_per_mps * half for half in half_tracks_m(track_of(ROBOT.vehicle), strokes)]
    assert wheel_speeds_rpm(DESIGN, 0.0, 1.0, strokes) == pytest.approx((-at[0], at[1], -at[2], at[3]))


@settings(deadline=None)
@given(speed=st.floats(-30, 30), yaw=st.floats(-30, 30), strokes=st.tuples(*[st.floats(0, 70)] * 4))
def test_beyond_the_limit_the_curvature_stays(speed: float, yaw: float, strokes: tuple) -> None:
    wheels = wheel_speeds_rpm(DESIGN, speed, yaw, strokes)
    assert max(map(abs, wheels)) <= DESIGN.rpm_max * (1 + 1e-9)
    unlimited = [
        DESIGN.rpm_per_mps * (speed - yaw * side * half)
        for side, half in zip((1, -1, 1, -1), half_tracks_m(DESIGN.track, strokes), strict=True)
    ]
    assert np.outer(wheels, unlimited) == pytest.approx(np.outer(unlimited, wheels), abs=1e-6)


def test_wheel_speeds_stay_below_the_safety_limit() -> None:
    assert DESIGN.rpm_max < ROBOT.safety.max_wheel_speed_rpm


# ---- ramps --------------------------------------------------


@settings(deadline=None)
@given(start=st.floats(-3, 3), wanted=st.floats(-3, 3), acceleration=st.floats(0.5, 5), jerk=st.floats(1, 50))
def test_a_ramp_arrives_in_time_within_its_limits(
    start: float, wanted: float, acceleration: float, jerk: float
) -> None:
    now, steps, side = Ramp(start), 0, math.copysign(1.0, wanted - start)
    while now != Ramp(wanted):
        after = ramp(now, wanted, acceleration, jerk, DT)
        assert abs(after.rate) <= acceleration * (1 + 1e-9)
        assert abs(after.rate - now.rate) <= 2.0 * jerk * DT * (1 + 1e-9)
        assert side * (after.value - wanted) <= 1e-12
        now, steps = after, steps + 1
        assert steps < 4_000
    way = abs(wanted - start)
    least = way / acceleration + acceleration / jerk
    if way < acceleration**2 / jerk:
        least = 2.0 * math.sqrt(way / jerk)
    assert steps * DT <= least + 4 * DT


@settings(deadline=None)
@given(value=st.floats(-3, 3), rate=st.floats(-2, 2), wanted=st.floats(-3, 3))
def test_a_ramp_down_mirrors_a_ramp_up(value: float, rate: float, wanted: float) -> None:
    for _ in range(50):
        up = ramp(Ramp(value, rate), wanted, 1.0, 5.0, DT)
        assert ramp(Ramp(-value, -rate), -wanted, 1.0, 5.0, DT) == Ramp(-up.value, -up.rate)
        value, rate = up.value, up.rate


def test_a_setpoint_taken_back_at_speed_is_still_smooth() -> None:
    now, trail = Ramp(), []
    for step in range(3000):
        after = ramp(now, 2.0 if step < 300 else -1.0, 1.0, 5.0, DT)
        assert abs(after.rate - now.rate) <= 2.0 * 5.0 * DT * (1 + 1e-9)
        now = after
        trail.append(now.value)
    assert now == Ramp(-1.0)
    assert min(trail) >= -1.0 - 1e-12


# ---- the step -----------------------------------------------


def drive_for(robot: RobotConfig, command: Command, inputs: Inputs, seconds: float = 5.0):
    design, state, wheels = design_drive(robot), DriveState(), STILL
    for _ in range(round(seconds / DT)):
        state, wheels = drive.step(design, state, command, inputs, DT)
    return state, wheels


def test_the_step_reaches_the_commanded_motion() -> None:
    inputs = Inputs(0.0, True, strokes=STROKES)
    state, wheels = drive_for(ROBOT, Command(speed_mps=0.8, yaw_rate_radps=0.4), inputs)
    assert state.speed_mps == Ramp(0.8)
    assert wheels == pytest.approx(wheel_speeds_rpm(DESIGN, 0.8, 0.4, MID))


def test_a_command_beyond_the_limits_is_held_to_them() -> None:
    inputs = Inputs(0.0, True, strokes=STROKES)
    state, _ = drive_for(ROBOT, Command(speed_mps=99.0, yaw_rate_radps=-99.0), inputs, 20.0)
    assert state.speed_mps.value == ROBOT.drive.max_speed_mps
    assert state.yaw_rate_radps.value == -math.radians(ROBOT.drive.max_yaw_rate_degps)


def test_missing_yaw_rate_is_made_up_for_up_to_its_limit() -> None:
    inputs = Inputs(0.0, True, strokes=STROKES, imu=gyro(0.2))
    state, wheels = drive_for(ROBOT, Command(yaw_rate_radps=0.4), inputs, 10.0)
    assert state.yaw_trim_radps == pytest.approx(math.radians(ROBOT.drive.yaw_rate_trim_max_degps))
    assert wheels[1] > wheel_speeds_rpm(DESIGN, 0.0, 0.4, MID)[1]


def test_at_a_standstill_the_trims_are_forgotten() -> None:
    inputs = Inputs(0.0, True, strokes=STROKES, imu=gyro(0.2))
    state, _ = drive_for(ROBOT, Command(yaw_rate_radps=0.4), inputs)
    for _ in range(2000):
        state, wheels = drive.step(DESIGN, state, Command(), inputs, DT)
    assert state == DriveState()
    assert wheels == STILL


def test_by_choice_mega_speed_closes_the_wheel_speed_loop() -> None:
    slow = WheelSample(0.0, (0, 0), (5.0, 5.0), 0)
    inputs = Inputs(0.0, True, strokes=STROKES, wheels_left=slow, wheels_right=slow)
    state, wheels = drive_for(tuned(speed_source="mega_speed"), Command(speed_mps=1.0), inputs)
    nominal = wheel_speeds_rpm(DESIGN, 1.0, 0.0, MID)
    assert wheels == pytest.approx([rpm + ROBOT.drive.wheel_trim_max_rpm for rpm in nominal])
    assert drive_for(ROBOT, Command(speed_mps=1.0), inputs)[1] == pytest.approx(nominal)
    assert state.wheel_trim_rpm == (ROBOT.drive.wheel_trim_max_rpm,) * 4


def test_each_wheel_is_trimmed_by_its_own_sensor() -> None:
    robot = tuned(speed_source="mega_speed", wheel_trim_max_rpm=1e3)
    behind_radps = (0.1, 0.2, 0.3, 0.4)
    command = Command(speed_mps=0.5)
    nominal = wheel_speeds_rpm(design_drive(robot), 0.5, 0.0, MID)
    fl, fr, rl, rr = (math.pi / 30.0 * nominal[0] - missing for missing in behind_radps)
    inputs = Inputs(
        0.0,
        True,
        strokes=STROKES,
        wheels_left=WheelSample(0.0, (0, 0), (fl, rl), 0),
        wheels_right=WheelSample(0.0, (0, 0), (fr, rr), 0),
    )
    steady = DriveState(Ramp(0.5), Ramp(0.0))
    state, _ = drive.step(design_drive(robot), steady, command, inputs, DT)
    gain = ROBOT.drive.wheel_speed_gain_per_s * DT
    assert state.wheel_trim_rpm == pytest.approx(
        [30.0 / math.pi * gain * missing for missing in behind_radps]
    )


def test_a_robot_that_only_levels_never_turns_a_wheel() -> None:
    inputs = Inputs(0.0, True, strokes=STROKES)
    assert drive_for(tuned(enabled=False), Command(speed_mps=1.0), inputs)[1] == STILL
