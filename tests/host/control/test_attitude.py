"""The levelling law in parts: gains, allocation, limits, and when it moves at all."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control import attitude
from tiger.control.attitude import LevelingState, Target, design_leveling
from tiger.control.rate_limited import in_rhombus
from tiger.control.reachable import Pose
from tiger.frozen import replace
from tiger.record import STILL

if TYPE_CHECKING:
    from tiger.record import Four

ROBOT = load_robot()
DESIGN = design_leveling(ROBOT)
SUSPENSION = DESIGN.suspension
DT = 0.005
MID: Four = (35.0, 35.0, 35.0, 35.0)
TOP = SUSPENSION.rate_mmps

rate = st.floats(-0.2, 0.2)
ratio = st.floats(1.2, 2.2)
room = st.tuples(st.floats(-9.4, 0.0), st.floats(0.0, 9.4))
four = st.tuples


def level_target(roll_deg: float = 0.0, pitch_deg: float = 0.0, **kwargs: float) -> Target:
    return Target(Pose(math.radians(roll_deg), math.radians(pitch_deg), DESIGN.ride_mm), **kwargs)


def follow(target: Target, seconds: float, strokes: Four = MID, lag_s: float = 0.05):
    """Run the law on ideal actuators with a lag; return the last decision, strokes, and all commands."""
    state, speed, at, commands = LevelingState(), list(STILL), list(strokes), []
    decision = None
    for _ in range(round(seconds / DT)):
        state, decision = attitude.step(DESIGN, state, target, tuple(at), DT)
        commands.append(decision.command_mmps)
        for i, command in enumerate(decision.command_mmps):
            speed[i] += (command - speed[i]) * (1.0 - math.exp(-DT / lag_s))
            at[i] += speed[i] * DT
    return decision, tuple(at), commands


# ---- design -------------------------------------------------


def test_the_gains_are_stable_and_as_quick_as_the_weights_ask() -> None:
    leveling = ROBOT.leveling
    assert DESIGN.error_gain_per_s == pytest.approx(
        leveling.rate_weight_degps / leveling.angle_weight_deg, rel=0.1
    )
    assert 0.0 < DESIGN.rate_gain < 1.0


# ---- allocation ---------------------------------------------


@settings(deadline=None)
@given(
    roll=rate,
    pitch=rate,
    ride=st.floats(-40, 40),
    ratios=four(ratio, ratio, ratio, ratio),
    limits=four(room, room, room, room),
)
def test_every_actuator_stays_within_its_limits(roll, pitch, ride, ratios, limits) -> None:
    rates = attitude._allocate(SUSPENSION, Pose(roll, pitch, ride), ratios, limits)
    for value, (low, high) in zip(rates, limits, strict=True):
        assert low - 1e-9 <= value <= high + 1e-9


@settings(deadline=None)
@given(
    roll=rate,
    pitch=rate,
    ride=st.floats(-40, 40),
    ratios=four(ratio, ratio, ratio, ratio),
    limits=four(room, room, room, room),
)
def test_the_turn_keeps_its_direction_and_twists_nothing(roll, pitch, ride, ratios, limits) -> None:
    assume(math.hypot(roll, pitch) > 1e-3)
    rates = attitude._allocate(SUSPENSION, Pose(roll, pitch, ride), ratios, limits)
    got = SUSPENSION.pose(tuple(m * v for m, v in zip(ratios, rates, strict=True)))
    scale = (got.roll_rad * roll + got.pitch_rad * pitch) / (roll**2 + pitch**2)
    assert -1e-9 <= scale <= 1.0 + 1e-9
    assert (got.roll_rad, got.pitch_rad) == pytest.approx((scale * roll, scale * pitch), abs=1e-9)
    assert got.warp_mm == pytest.approx(0.0, abs=1e-6)


@settings(deadline=None)
@given(roll=rate, pitch=rate, ratios=four(ratio, ratio, ratio, ratio))
def test_a_saturated_turn_uses_two_actuators_at_full_speed(roll, pitch, ratios) -> None:
    assume(math.hypot(roll, pitch) > 0.1)
    limits = ((-TOP, TOP),) * 4
    rates = attitude._allocate(SUSPENSION, Pose(roll, pitch, 0.0), ratios, limits)
    assert sorted(map(abs, rates))[2:] == pytest.approx([TOP, TOP], rel=1e-6)


def test_ride_gives_way_to_the_turn() -> None:
    limits = ((-TOP, TOP),) * 4
    turning = Pose(0.2, 0.0, 0.0)
    with_ride = attitude._allocate(SUSPENSION, Pose(0.2, 0.0, 30.0), (2.0,) * 4, limits)
    assert with_ride == pytest.approx(attitude._allocate(SUSPENSION, turning, (2.0,) * 4, limits))


def test_a_corner_at_its_end_leaves_its_work_to_the_others() -> None:
    """The left may not rise any more: the right goes down at full speed, and the ride with it."""
    limits = ((-TOP, 0.0), (-TOP, TOP), (-TOP, 0.0), (-TOP, TOP))
    fl, fr, rl, rr = attitude._allocate(SUSPENSION, Pose(0.2, 0.0, 0.0), (2.0,) * 4, limits)
    assert (fl, rl) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert (fr, rr) == pytest.approx((-TOP, -TOP))


def test_an_error_inside_the_dead_zone_waits_while_the_other_axis_needs_all_there_is() -> None:
    small, large = math.radians(0.1), math.radians(3.0)
    assert attitude._pressing(DESIGN, (large, small), (0.0, 0.0)) == (large, 0.0)
    assert attitude._pressing(DESIGN, (small, large), (0.0, 0.0)) == (0.0, large)
    assert attitude._pressing(DESIGN, (small, small), (0.0, 0.0)) == (small, small)
    fast = (1.1 * DESIGN.turn_limits_radps[0], 0.0)
    assert attitude._pressing(DESIGN, (small, small), fast) == (small, 0.0)


# ---- moves --------------------------------------------------


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(4.0, 0.0), (0.0, -5.0), (2.0, 3.0), (-3.0, 2.0)])
def test_a_move_arrives_and_then_rests(roll_deg: float, pitch_deg: float) -> None:
    decision, strokes, commands = follow(level_target(roll_deg, pitch_deg), 8.0)
    pose = SUSPENSION.pose(tuple(SUSPENSION.curve.at(s)[0] for s in strokes))
    assert math.degrees(pose.roll_rad) == pytest.approx(roll_deg, abs=0.02)
    assert math.degrees(pose.pitch_rad) == pytest.approx(pitch_deg, abs=0.02)
    assert pose.ride_mm == pytest.approx(DESIGN.ride_mm, abs=0.3)
    assert decision.settled
    assert commands[-1] == STILL


def test_a_move_does_not_overshoot() -> None:
    state, speed, at, rolls = LevelingState(), list(STILL), list(MID), []
    for _ in range(800):
        state, decision = attitude.step(DESIGN, state, level_target(4.0), tuple(at), DT)
        for i, command in enumerate(decision.command_mmps):
            speed[i] += (command - speed[i]) * (1.0 - math.exp(-DT / 0.05))
            at[i] += speed[i] * DT
        rolls.append(math.degrees(SUSPENSION.pose(tuple(SUSPENSION.curve.at(s)[0] for s in at)).roll_rad))
    assert max(rolls) <= 4.02


@settings(deadline=None)
@given(roll=st.floats(-9, 9), pitch=st.floats(-9, 9), strokes=four(*[st.floats(1.5, 68.5)] * 4))
def test_no_command_changes_faster_than_the_acceleration_limit(roll, pitch, strokes) -> None:
    state, last = LevelingState(), STILL
    for _ in range(40):
        state, decision = attitude.step(DESIGN, state, level_target(roll, pitch), strokes, DT)
        change = max(abs(a - b) for a, b in zip(decision.command_mmps, last, strict=True))
        assert change <= ROBOT.leveling.acceleration_mmps2 * DT * (1 + 1e-9)
        assert max(map(abs, decision.command_mmps)) <= TOP * (1 + 1e-9)
        last = decision.command_mmps


def test_a_twist_of_the_strokes_is_taken_out_in_a_move() -> None:
    _, strokes, _ = follow(level_target(1.0), 8.0, (38.0, 32.0, 32.0, 38.0))
    pose = SUSPENSION.pose(tuple(SUSPENSION.curve.at(s)[0] for s in strokes))
    assert abs(pose.warp_mm) < 0.5


def test_without_a_target_a_running_move_slows_to_a_stop() -> None:
    state = LevelingState()
    for _ in range(60):
        state, decision = attitude.step(DESIGN, state, level_target(4.0), MID, DT)
    assert max(map(abs, decision.command_mmps)) > 0.9 * TOP
    steps = 0
    while decision.command_mmps != STILL:
        state, decision = attitude.step(DESIGN, state, None, MID, DT)
        steps += 1
    assert steps * DT == pytest.approx(TOP / ROBOT.leveling.acceleration_mmps2, abs=2 * DT)


# ---- when it moves ------------------------------------------


def moves(target: Target, seconds: float = 2.0) -> bool:
    state = LevelingState()
    for _ in range(round(seconds / DT)):
        state, decision = attitude.step(DESIGN, state, target, MID, DT)
        if decision.command_mmps != STILL:
            return True
    return False


@pytest.mark.parametrize(
    ("error_deg", "expected"), [(0.0, False), (0.19, False), (0.29, False), (0.31, True), (-0.4, True)]
)
def test_on_still_ground_the_dead_zone_decides(error_deg: float, expected: bool) -> None:
    assert moves(level_target(error_deg)) is expected
    assert moves(level_target(0.0, error_deg)) is expected


def test_on_turning_ground_it_moves_at_the_smaller_error() -> None:
    assert moves(level_target(0.29, roll_rate_radps=math.radians(0.3)))
    assert not moves(level_target(0.26, roll_rate_radps=math.radians(0.3)))


def test_a_large_error_wakes_it_within_two_hundredths_of_a_second() -> None:
    assert moves(level_target(2.0), seconds=0.02)


def test_a_ride_height_off_by_more_than_its_zone_moves() -> None:
    assert moves(Target(Pose(0.0, 0.0, DESIGN.ride_mm + 2.5)))
    assert not moves(Target(Pose(0.0, 0.0, DESIGN.ride_mm + 1.5)))


def test_at_limit_names_the_corners_at_their_end() -> None:
    low, high = ROBOT.stroke_range_mm
    _, decision = attitude.step(DESIGN, LevelingState(), None, (low, 35.0, high, low + 1.0), DT)
    assert decision.at_limit == (True, False, True, False)


# ---- two axes, one speed ------------------------------------


@given(roll=st.floats(-0.2, 0.2), pitch=st.floats(-0.2, 0.2), share=st.floats(0.1, 1.0))
def test_rates_beyond_the_actuators_become_the_nearest_that_they_have(
    roll: float, pitch: float, share: float
) -> None:
    wanted = Pose(roll, pitch, 3.0, 2.0)
    got = attitude._nearest(DESIGN, wanted, share)
    limits = tuple(share * limit for limit in DESIGN.turn_limits_radps)
    assert (got.roll_rad, got.pitch_rad) == pytest.approx(
        in_rhombus(np.array([[roll, pitch]]), limits)[0], abs=1e-12
    )
    assert (got.ride_mm, got.warp_mm) == (3.0, 2.0)


# ---- rolling ------------------------------------------------


@given(roll=st.floats(-0.25, 0.25), pitch=st.floats(-0.25, 0.25))
def test_a_rolling_robot_leaves_no_error_to_rest_and_a_standing_one_does(roll: float, pitch: float) -> None:
    assume(max(abs(roll), abs(pitch)) > 0.01)
    target = level_target(roll, pitch)
    _, _, commands = follow(target, 0.5)
    assert all(command == STILL for command in commands)
    decision, _, _ = follow(replace(target, rolling=True), 2.0)
    assert max(map(abs, decision.error_rad)) < math.radians(0.005)


def test_a_robot_that_has_stopped_rests_after_the_still_time() -> None:
    target = level_target(0.2)
    state, commands = LevelingState(), []
    for tick in range(600):
        now = replace(target, rolling=True) if tick < 200 else level_target(0.0)
        state, decision = attitude.step(DESIGN, state, now, MID, DT)
        commands.append(decision.command_mmps)
    assert commands[199] != STILL
    assert commands[-1] == STILL
    assert not state.phase.moving
