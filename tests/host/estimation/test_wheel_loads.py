"""Loads of the four wheels against the world's true ones, and against statics where those are known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.config.vehicle import PayloadConfig
from tiger.devices.imu import specific_force_mps2
from tiger.emulation.scenarios import RoughConfig, Scenario, Start, TerrainConfig
from tiger.estimation import wheel_loads
from tiger.estimation.tilt_error import TiltError
from tiger.record import Estimate, Loads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from conftest import Tick

    from tiger.record import Four, ImuSample

    Roll = Callable[..., Iterator[Tick]]

ROBOT = load_robot(None)
EXACT = TiltError()
"""The IMU's attitude is off by nothing here."""
DESIGN = wheel_loads.design_loads(ROBOT)
CORNER_NPM = DESIGN.corner_npm
WARP = np.array([1.0, -1.0, -1.0, 1.0])


def course(time_s: float) -> tuple[float, float]:
    """Starts and stops of 1 m/s2."""
    phase = time_s % 5.0
    return max(0.0, min(phase - 1.0, 1.0, 4.5 - phase)), 0.0


def errors_n(roll: Roll, scenario: Scenario, seed: int, warp_m: float = 0.0, **more: object) -> np.ndarray:
    """Estimated less true loads (n, 4), after the first seconds; contact knows the ground's warp."""
    state = wheel_loads.initial_state(DESIGN)
    estimate = Estimate(ready=True, loads=Loads(ground_warp_m=warp_m))
    errors = []
    for tick in roll(ROBOT, scenario, course, seed, **more):
        state, loads = wheel_loads.step(DESIGN, state, tick.inputs, estimate, EXACT, 0.005)
        estimate = replace(estimate, loads=loads)
        if tick.inputs.now_s > 0.3 * scenario.duration_s:
            errors.append(np.subtract(loads.wheel_load_n, tick.truth.wheel_load_n))
    return np.array(errors)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_on_level_ground_starts_and_stops_are_followed(roll: Roll) -> None:
    """The body's weight goes to the rear and the front by some 30 N."""
    off = errors_n(roll, Scenario(title="level", duration_s=15.0), seed=1)
    assert rms(off) < 6.0


@pytest.mark.parametrize("yaw_rate", [1.5, -1.5])
def test_in_a_steady_turn_the_loads_are_the_true_ones(roll: Roll, yaw_rate: float) -> None:
    """An eighth of the weight more is on the outer wheels; each wheel's load is told to 2 N of 200 N."""

    def circle(time_s: float) -> tuple[float, float]:
        return min(2.0, max(0.0, time_s - 1.0)), yaw_rate if time_s > 3.5 else 0.0

    state, estimate, loads_n = wheel_loads.initial_state(DESIGN), Estimate(ready=True), []
    for tick in roll(ROBOT, Scenario(title="circle", duration_s=10.0, friction=0.5), circle, 1):
        state, loads = wheel_loads.step(DESIGN, state, tick.inputs, estimate, EXACT, 0.005)
        estimate = replace(estimate, loads=loads)
        loads_n.append((loads.wheel_load_n, tick.truth.wheel_load_n))
    told, true = np.mean(loads_n[-400:], axis=0)
    assert abs(true @ np.array([1.0, -1.0, 1.0, -1.0])) > 80.0  # so much leans on the outer wheels
    np.testing.assert_allclose(told, true, atol=2.0)


def test_wheels_that_roll_and_spin_up_press_the_tail_down() -> None:
    """By the motors' torque that no force on the ground comes of; and what they carry stays the same."""
    state = wheel_loads.initial_state(DESIGN)
    level = DESIGN.payload.suspension.pose((0.0,) * 4)
    free = np.array(wheel_loads._three_equations(DESIGN, state, level))
    driven = np.array(wheel_loads._three_equations(DESIGN, replace(state, wheels_nm=(5.0, 0.0)), level))
    turned = np.array(wheel_loads._three_equations(DESIGN, replace(state, wheels_nm=(0.0, 5.0)), level))
    upright, payload = state.load.upright_nmprad, DESIGN.payload
    half_base, half_track = ROBOT.vehicle.body.wheelbase_m / 2.0, ROBOT.vehicle.body.half_track_m
    down = 5.0 / (4.0 * half_base) * payload.pitch_nmprad / (payload.pitch_nmprad + upright)
    out = 5.0 / (4.0 * half_track) * payload.roll_nmprad / (payload.roll_nmprad + upright)
    np.testing.assert_allclose(driven - free, [-down, -down, down, down], atol=1e-9)
    np.testing.assert_allclose(turned - free, [-out, out, -out, out], atol=1e-9)


def test_on_rough_ground_with_a_load_they_are_within_a_tenth_of_the_weight(roll: Roll) -> None:
    rough = TerrainConfig(rough=RoughConfig(roughness="B", size_m=(60.0, 60.0), shortest_wave_m=0.5, seed=3))
    scenario = Scenario(
        title="rough",
        duration_s=25.0,
        start=Start(x_m=20.0),
        payload=PayloadConfig(mass_kg=20.0, place_m=(0.3, 0.0, 0.3)),
        terrain=rough,
    )
    assert rms(errors_n(roll, scenario, seed=2)) < 25.0


def test_a_twist_of_the_strokes_loads_one_diagonal(roll: Roll) -> None:
    def twisted(time_s: float) -> Four:
        return (40.0, 30.0, 30.0, 40.0)

    off = errors_n(roll, Scenario(title="twist", duration_s=8.0), seed=1, strokes=twisted)
    assert rms(off) < 8.0
    untwisted = errors_n(roll, Scenario(title="level", duration_s=8.0), seed=1)
    assert rms(off) < rms(untwisted) + 4.0


def test_a_known_twist_of_the_ground_loads_one_diagonal(roll: Roll) -> None:
    """z = w x y: heights under the wheels are w/4 L B apart, and the loads follow spring and tyre."""
    terrain = TerrainConfig(twist_deg_per_m=2.0)
    warp_m = 4.0 * np.tan(np.radians(2.0)) * 0.5 * 0.6
    scenario = Scenario(title="twist", duration_s=4.0, terrain=terrain)
    state, still = wheel_loads.initial_state(DESIGN), lambda _: (0.0, 0.0)
    estimate = Estimate(ready=True, loads=Loads(ground_warp_m=float(warp_m)))
    for tick in roll(ROBOT, scenario, still, 1):
        state, loads = wheel_loads.step(DESIGN, state, tick.inputs, estimate, EXACT, 0.005)
        estimate = replace(estimate, loads=loads)
    diagonal = WARP @ np.array(loads.wheel_load_n)
    assert diagonal == pytest.approx(WARP @ np.array(tick.truth.wheel_load_n), rel=0.1)
    assert abs(diagonal) > 50.0


loads_n = st.tuples(*(st.floats(20.0, 400.0) for _ in range(4)))


@given(loads_n, st.floats(-1000.0, 1000.0))
def test_a_twist_changes_no_sum_and_pulls_at_no_wheel(carried: Four, twist_n: float) -> None:
    twisted = np.array(wheel_loads._twisted(carried, twist_n))
    assert (twisted >= 0.0).all()
    assert twisted.sum() == pytest.approx(sum(carried))
    fl, fr, rl, _ = twisted - np.array(carried)
    assert (fl + fr, fl + rl) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert abs(fl) <= abs(twist_n) + 1e-9


@given(loads_n)
def test_a_great_twist_leaves_a_wheel_in_the_air_and_three_that_carry(carried: Four) -> None:
    for twist in (1e4, -1e4):
        twisted = wheel_loads._twisted(carried, twist)
        assert min(twisted) == pytest.approx(0.0, abs=1e-9)


def test_what_is_not_known_of_mass_place_and_twist_widens_the_deviation(roll: Roll) -> None:
    state = wheel_loads.initial_state(DESIGN)
    tick = next(roll(ROBOT, Scenario(title="one", duration_s=0.01), lambda _: (0.0, 0.0), 0))
    for sigma_m, least in ((0.0, 0.0), (0.1, CORNER_NPM * 0.025)):
        known = Estimate(ready=True, loads=Loads(ground_warp_sigma_m=sigma_m))
        _, loads = wheel_loads.step(DESIGN, state, tick.inputs, known, EXACT, 0.005)
        assert min(loads.wheel_load_sigma_n) > max(least, ROBOT.loads.load_noise_n)


def test_what_the_attitude_is_known_to_be_off_by_is_no_tilt(roll: Roll) -> None:
    """A tilt that the board alone sees, and with it gravity where there is none."""
    wrong, pitch_wrong = 0.03, -0.02
    state = wheel_loads.initial_state(DESIGN)
    *_, tick = roll(ROBOT, Scenario(title="one", duration_s=0.02), lambda _: (0.0, 0.0), 0)
    imu = tick.inputs.imu
    assert imu is not None
    force = specific_force_mps2(imu)
    (w, x, y, z), (a, b) = imu.quaternion, (0.5 * wrong, 0.5 * pitch_wrong)
    tilted = (w - a * x - b * y, x + a * w + b * z, y + b * w - a * z, z + a * y - b * x)
    misled = replace(imu, quaternion=tilted, linear_accel_mps2=(0.0, 0.0, 0.0))
    felt = specific_force_mps2(misled)
    misled = replace(misled, linear_accel_mps2=tuple(np.subtract(force, felt).tolist()))

    def shown(sample: ImuSample, off: TiltError) -> tuple[float, float]:
        inputs = replace(tick.inputs, imu=sample)
        once, _ = wheel_loads.step(DESIGN, state, inputs, Estimate(ready=True), off, 0.005)
        later = replace(inputs, imu=replace(sample, t_s=sample.t_s + 0.02))
        span = wheel_loads.step(DESIGN, once, later, Estimate(ready=True), off, 0.005)[0].payload.span
        return span.roll_rad, span.pitch_rad

    true = shown(imu, EXACT)
    assert shown(misled, TiltError(-wrong, -pitch_wrong)) == pytest.approx(true, abs=1e-3)
    assert shown(misled, EXACT) == pytest.approx((true[0] + wrong, true[1] + pitch_wrong), abs=1e-3)


def test_only_a_new_sample_of_the_imu_changes_anything(roll: Roll) -> None:
    state, estimate = wheel_loads.initial_state(DESIGN), Estimate(ready=True)
    ticks = list(roll(ROBOT, Scenario(title="two", duration_s=0.02), lambda _: (0.0, 0.0), 0))
    after, loads = wheel_loads.step(DESIGN, state, ticks[0].inputs, estimate, EXACT, 0.005)
    same, kept = wheel_loads.step(
        DESIGN, after, ticks[1].inputs, replace(estimate, loads=loads), EXACT, 0.005
    )
    assert same is after
    assert kept is loads


def test_an_empty_robot_at_rest_carries_its_weight() -> None:
    assert sum(DESIGN.empty.wheel_load_n) == pytest.approx(9.80665 * DESIGN.payload.empty_kg)
