"""The controller in closed loop on the emulated world: what a person on the shaking plate would see."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.control.reachable import Suspension, rate_bound_s
from tiger.daemon import controller
from tiger.emulation.scenarios import PlateSegment
from tiger.record import STILL, Command, ImuSample, Inputs, Mode, StrokeSample

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig

MID = (35.0, 35.0, 35.0, 35.0)
LEAST_RESIDUAL = {1.2: 0.0530, 1.5: 0.1826, 2.0: 0.3714, 3.0: 0.5778}
"""RMS that a rate-limited motion leaves of a sine so much too fast (test_rhythm.py finds it again)."""
LEVEL_IMU = ImuSample(0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0)
MID_STROKES = StrokeSample(0.0, MID, STILL, (0, 0, 0, 0), 0)


def step_of(axis: str, to_deg: float, at_s: float = 2.0, over_s: float = 0.3) -> PlateSegment:
    return PlateSegment(axis=axis, at_s=at_s, to_deg=to_deg, over_s=over_s)


def harmonic(axis: str, amplitude_deg: float, frequency_hz: float) -> PlateSegment:
    return PlateSegment(axis=axis, at_s=0.0, amplitude_deg=amplitude_deg, frequency_hz=frequency_hz)


# ---- levelling ----------------------------------------------


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("angle_deg", [5.0, -5.0])
def test_a_step_of_the_plate_is_levelled_within_a_tenth_over_the_rate_bound(bench, axis, angle_deg) -> None:
    run = bench.run(14.0, (step_of(axis, angle_deg),))
    turn = math.radians(4.5)
    suspension = Suspension.from_config(bench.robot)
    bound_s = rate_bound_s(suspension, MID, *((turn, 0.0) if axis == "roll" else (0.0, turn)))
    assert run.time_to_level_s(2.0) <= 1.1 * bound_s
    index = 0 if axis == "roll" else 1
    beyond = (-np.sign(angle_deg) * run.attitude_deg[run.after(2.0), index]).max()
    assert beyond < 0.5
    assert np.abs(run.attitude_deg[run.after(8.0)].mean(axis=0)).max() < 0.05


def test_a_combined_step_is_levelled_in_both_axes_at_once(bench) -> None:
    run = bench.run(12.0, (step_of("roll", 3.0), step_of("pitch", -3.0)))
    bound_s = rate_bound_s(Suspension.from_config(bench.robot), MID, math.radians(2.5), math.radians(-2.5))
    assert run.time_to_level_s(2.0) <= 1.1 * bound_s


def test_the_way_back_is_as_good_and_leaves_the_strokes_centred(bench) -> None:
    run = bench.run(22.0, (step_of("roll", 5.0), step_of("roll", 0.0, at_s=12.0)))
    assert run.time_to_level_s(12.0) <= 1.1 * 2.64
    assert run.stroke_mm[-1] == pytest.approx(MID, abs=0.5)


def test_once_level_the_command_is_exactly_zero(bench) -> None:
    run = bench.run(14.0, (step_of("roll", 5.0),))
    assert np.all(run.command_mmps[run.after(8.0)] == 0.0)
    assert run.outputs[-1].settled


def test_at_rest_nothing_moves(bench) -> None:
    run = bench.run(20.0)
    assert np.all(run.command_mmps == 0.0)


@pytest.mark.parametrize(
    "plate",
    [
        (step_of("roll", 0.19),),
        (step_of("pitch", -0.19),),
        (harmonic("roll", 0.19, 0.05),),
        (step_of("roll", 0.19, over_s=5.0), step_of("pitch", 0.19, over_s=5.0)),
    ],
)
def test_a_disturbance_inside_the_dead_zone_moves_nothing(bench, plate) -> None:
    run = bench.run(20.0, plate)
    assert np.all(run.command_mmps == 0.0)


def test_a_tilt_just_outside_the_dead_zone_is_taken_out_to_nearly_zero(bench) -> None:
    run = bench.run(12.0, (step_of("roll", 0.35),))
    assert np.abs(run.attitude_deg[run.after(8.0)].mean(axis=0)).max() < 0.1
    assert np.all(run.command_mmps[run.after(8.0)] == 0.0)


@pytest.mark.parametrize(
    ("axis", "amplitude_deg", "frequency_hz"), [("roll", 2.0, 0.05), ("pitch", 3.0, 0.08)]
)
def test_a_slow_harmonic_leaves_little(bench, axis, amplitude_deg, frequency_hz) -> None:
    run = bench.run(25.0, (harmonic(axis, amplitude_deg, frequency_hz),))
    residual = run.attitude_deg[run.after(10.0)]
    assert np.abs(residual).max() <= 0.05 * amplitude_deg
    assert residual.std(axis=0).max() <= 0.02 * amplitude_deg


def test_a_small_slow_harmonic_is_followed_once_it_has_shown_that_it_comes_back(bench) -> None:
    run = bench.run(45.0, (harmonic("roll", 0.5, 0.05),))
    residual = np.abs(run.attitude_deg)
    assert residual.max() <= bench.robot.leveling.dead_zone_deg + 0.07
    assert residual[run.after(30.0)].max() <= 0.05


@pytest.mark.parametrize(("axis", "overspeed"), [("roll", 1.2), ("pitch", 1.5), ("roll", 3.0)])
def test_a_harmonic_too_fast_to_follow_leaves_little_more_than_it_must(bench, axis, overspeed) -> None:
    """After five periods: within 1.15 of the least residual that any rate-limited motion can leave."""
    index = 0 if axis == "roll" else 1
    limit = math.degrees(controller.design_controller(bench.robot).leveling.turn_limits_radps[index])
    amplitude_deg = 2.0
    frequency_hz = overspeed * limit / (2.0 * math.pi * amplitude_deg)
    period_s = 1.0 / frequency_hz
    run = bench.run(8.0 * period_s, (harmonic(axis, amplitude_deg, frequency_hz),))
    residual = run.attitude_deg[run.after(5.0 * period_s), index]
    ratio = residual.std() / (amplitude_deg / math.sqrt(2.0))
    assert ratio <= 1.15 * LEAST_RESIDUAL[overspeed]


def test_levelling_stands_an_imu_at_the_edge_of_its_calibration(bench) -> None:
    # 0.02 m/s2 of accelerometer offset tilts the measured vertical by 0.117 degrees.
    tilted = replace(bench, imu_tilt_deg=0.117, gyro_bias_degps=0.02)
    run = tilted.run(14.0, (step_of("roll", 5.0),))
    assert run.time_to_level_s(2.0) <= 3.3
    assert np.abs(run.attitude_deg[run.after(8.0)].mean(axis=0)).max() < 0.2
    assert np.all(run.command_mmps[run.after(9.0)] == 0.0)


def test_a_gyro_bias_left_by_the_board_is_found_and_moves_nothing(bench) -> None:
    run = replace(bench, gyro_bias_degps=0.1).run(40.0)
    found = run.outputs[-1].estimate.gyro_bias_radps
    assert np.degrees(found) == pytest.approx([0.1, 0.1], abs=0.04)
    assert np.all(run.command_mmps == 0.0)


def test_a_plate_beyond_the_strokes_is_met_as_far_as_they_go_and_said(bench) -> None:
    run = bench.run(14.0, (step_of("roll", 9.0),))
    low, high = bench.robot.stroke_range_mm
    assert run.outputs[-1].unreachable
    assert "out of reach" in run.outputs[-1].reason
    assert all(run.outputs[-1].at_limit)
    assert run.stroke_mm.min() >= low - 0.3
    assert run.stroke_mm.max() <= high + 0.3
    most = math.degrees(Suspension.from_config(bench.robot).limits()[0])
    assert run.attitude_deg[-1, 0] == pytest.approx(9.0 - most, abs=0.2)
    assert np.all(run.command_mmps[-100:] == 0.0)


def test_a_roll_setpoint_is_reached_against_gravity(bench) -> None:
    wanted = Command(roll_rad=math.radians(2.0), pitch_rad=math.radians(-1.0))
    run = bench.run(10.0, (step_of("roll", 2.0),), command=lambda _: wanted)
    assert run.attitude_deg[-1] == pytest.approx([2.0, -1.0], abs=0.1)


# ---- modes --------------------------------------------------


def test_pose_is_relative_to_the_wheels_and_takes_the_ride_height(bench) -> None:
    wanted = Command(Mode.POSE, roll_rad=math.radians(2.0), pitch_rad=0.0, ride_stroke_mm=45.0)
    run = bench.run(12.0, (step_of("pitch", 3.0),), command=lambda _: wanted)
    suspension = Suspension.from_config(bench.robot)
    pose = suspension.pose(tuple(suspension.curve.at(s)[0] for s in run.stroke_mm[-1]))
    assert math.degrees(pose.roll_rad) == pytest.approx(2.0, abs=0.1)
    assert math.degrees(pose.pitch_rad) == pytest.approx(0.0, abs=0.1)
    assert pose.ride_mm == pytest.approx(suspension.curve.at(45.0)[0], abs=0.5)
    assert run.attitude_deg[-1] == pytest.approx([2.0, 3.0], abs=0.15)


def test_stow_goes_to_the_low_end_of_all_four_strokes(bench) -> None:
    run = bench.run(10.0, stroke_mm=(20.0, 35.0, 50.0, 35.0), command=lambda _: Command(Mode.STOW))
    assert run.stroke_mm[-1] == pytest.approx([bench.robot.stroke_range_mm[0]] * 4, abs=0.7)
    assert np.all(run.command_mmps[-100:] == 0.0)


def test_hold_moves_nothing_whatever_the_plate_does(bench) -> None:
    run = bench.run(6.0, (step_of("roll", 5.0),), command=lambda _: Command(Mode.HOLD))
    assert np.all(run.command_mmps == 0.0)


def test_a_pose_beyond_the_strokes_is_refused_where_the_config_says_so(robot: RobotConfig) -> None:
    strict = robot.model_copy(
        update={"leveling": robot.leveling.model_copy(update={"out_of_reach": "refuse"})}
    )
    asked = Command(Mode.POSE, roll_rad=math.radians(8.0))
    _, refused = one_tick(strict, asked)
    _, clipped = one_tick(robot, asked)
    assert refused.stroke_rate_mmps == STILL
    assert "refused" in refused.reason
    assert clipped.unreachable
    assert clipped.stroke_rate_mmps != STILL


@pytest.mark.parametrize(("first", "second"), tuple(permutations(Mode, 2)))
def test_a_change_of_mode_is_bumpless(bench, first: Mode, second: Mode) -> None:
    rng = np.random.default_rng(list(Mode).index(first) * 10 + list(Mode).index(second))
    assert_gentle(bench, random_change(bench, rng, first, second))


@pytest.mark.proof
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("first", "second"), tuple(permutations(Mode, 2)))
def test_a_change_of_mode_is_bumpless_from_100_poses(bench, first: Mode, second: Mode) -> None:
    rng = np.random.default_rng(list(Mode).index(first) * 10 + list(Mode).index(second) + 100)
    for _ in range(100):
        assert_gentle(bench, random_change(bench, rng, first, second))


def random_change(bench, rng: np.random.Generator, first: Mode, second: Mode):
    """Start anywhere, change from one mode to another in the middle of a move."""
    low, high = bench.robot.stroke_range_mm
    at, roll, pitch, ride = rng.uniform(0.2, 1.5), *rng.uniform(-0.1, 0.1, 2), rng.uniform(low, high)

    def command(now: float) -> Command:
        mode = first if now < at else second
        return Command(mode, roll, pitch, ride if mode is Mode.POSE else None)

    start = tuple(rng.uniform(low, high, 4))
    tilt_deg = rng.uniform(-4.0, 4.0, 2)
    plate = (step_of("roll", tilt_deg[0], at_s=0.5), step_of("pitch", tilt_deg[1], at_s=0.7))
    return bench.run(3.0, plate, command=command, stroke_mm=start)


def assert_gentle(bench, run) -> None:
    low, high = bench.robot.stroke_range_mm
    limit = bench.robot.leveling.acceleration_mmps2
    change = np.diff(run.command_mmps, axis=0, prepend=0.0) / 0.005
    assert np.abs(change).max() <= limit * (1 + 1e-9)
    assert np.abs(run.command_mmps).max() <= bench.robot.actuator.max_rate_mmps * (1 + 1e-9)
    assert run.stroke_mm.min() >= min(low, run.stroke_mm[0].min()) - 0.4
    assert run.stroke_mm.max() <= max(high, run.stroke_mm[0].max()) + 0.4


# ---- the step itself ----------------------------------------


def one_tick(robot: RobotConfig, command: Command, armed: bool = True):
    design = controller.design_controller(robot)
    inputs = Inputs(0.01, armed, command, strokes=MID_STROKES, imu=LEVEL_IMU)
    return controller.step(design, controller.initial_state(design), inputs, 0.005)


def test_a_tick_is_a_pure_function(robot: RobotConfig) -> None:
    design = controller.design_controller(robot)
    state = controller.initial_state(design)
    asked = Command(Mode.POSE, roll_rad=0.05, speed_mps=0.5)
    trail = []
    for tick in range(60):
        imu = ImuSample(0.01 * (tick // 2), *[getattr(LEVEL_IMU, n) for n in LEVEL_IMU.__slots__[1:]])
        inputs = Inputs(0.005 * tick + 0.01, True, asked, strokes=MID_STROKES, imu=imu)
        before = (state.observer.x.copy(), [row.copy() for row in state.observer.predicted])
        new, outputs = controller.step(design, state, inputs, 0.005)
        _, again = controller.step(design, state, inputs, 0.005)
        assert outputs == again
        assert np.array_equal(before[0], state.observer.x)
        assert np.array_equal(before[1], state.observer.predicted)
        state = new
        trail.append(outputs)
    assert trail[-1].stroke_rate_mmps != STILL


def test_nothing_is_commanded_before_arming(robot: RobotConfig) -> None:
    _, outputs = one_tick(robot, Command(Mode.STOW, speed_mps=1.0), armed=False)
    assert outputs.stroke_rate_mmps == STILL
    assert outputs.wheel_rpm == STILL
    assert outputs.estimate.ready


@pytest.mark.parametrize("missing", ["strokes", "imu"])
def test_nothing_is_commanded_without_strokes_or_estimate(robot: RobotConfig, missing: str) -> None:
    design = controller.design_controller(robot)
    samples = {"strokes": MID_STROKES, "imu": LEVEL_IMU}
    samples[missing] = None
    inputs = Inputs(0.01, True, Command(Mode.STOW, speed_mps=1.0), **samples)
    _, outputs = controller.step(design, controller.initial_state(design), inputs, 0.005)
    assert outputs.stroke_rate_mmps == STILL
    assert outputs.wheel_rpm == STILL
    assert not outputs.estimate.ready


def test_a_fresh_arm_starts_from_zero_rate(bench) -> None:
    robot = bench.robot
    design = controller.design_controller(robot)
    state, asked = controller.initial_state(design), Command(Mode.STOW, speed_mps=1.0)
    for armed in [True] * 100 + [False]:
        inputs = Inputs(0.01, armed, asked, strokes=MID_STROKES, imu=LEVEL_IMU)
        state, outputs = controller.step(design, state, inputs, 0.005)
    assert outputs.stroke_rate_mmps == STILL
    again = Inputs(0.01, True, asked, strokes=MID_STROKES, imu=LEVEL_IMU)
    _, outputs = controller.step(design, state, again, 0.005)
    assert max(map(abs, outputs.stroke_rate_mmps)) <= robot.leveling.acceleration_mmps2 * 0.005 + 1e-9
    assert max(map(abs, outputs.wheel_rpm)) < 0.1


def test_a_tick_costs_less_than_five_hundred_products_of_its_state(bench) -> None:
    """Some 80 us where the product of a 14 x 14 matrix takes 1; both get slower together."""
    design = controller.design_controller(bench.robot)
    state = controller.initial_state(design)
    asked = Command(Mode.POSE, roll_rad=0.05, speed_mps=0.5)
    matrix, vector = np.eye(14), np.ones(14)
    costs = []
    for batch in range(10):
        start = time.process_time()
        for _ in range(10_000):
            matrix @ vector
        product_s = (time.process_time() - start) / 10_000
        start = time.process_time()
        for tick in range(100):
            t = batch + tick * 0.005
            imu = ImuSample(t, *[getattr(LEVEL_IMU, n) for n in LEVEL_IMU.__slots__[1:]])
            inputs = Inputs(t + 0.01, True, asked, strokes=MID_STROKES, imu=imu)
            state, _ = controller.step(design, state, inputs, 0.005)
        costs.append((time.process_time() - start) / 100 / product_s)
    assert min(costs) < 500
