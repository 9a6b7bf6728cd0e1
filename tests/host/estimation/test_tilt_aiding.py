"""Roll and pitch through starts and turns: an inclinometer is fooled by them, the wheels are not."""

from __future__ import annotations

from math import degrees, radians
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.emulation.scenarios import Scenario
from tiger.estimation import tilt_aiding
from tiger.estimation.tilt_aiding import AidedTilt
from tiger.record import ImuSample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from conftest import Tick

G = 9.80665
DT = 0.01


def held(
    pitch_rad: float,
    roll_rad: float,
    accel_mps2: np.ndarray,
    yaw_rate_radps: float = 0.0,
    slipping: bool = False,
    wheels: Callable[[float], float] = lambda v: v,
) -> AidedTilt:
    """The filter at the end of a ride with a body that keeps its tilt."""
    state, speed = AidedTilt(), 0.0
    for index, a in enumerate(np.concatenate([[0.0], accel_mps2]).tolist()):
        speed += a * DT
        turning = yaw_rate_radps if index else 0.0
        force = (a - G * pitch_rad, speed * turning + G * roll_rad, G)
        rates = 0.0, turning * np.sin(roll_rad), turning
        state = tilt_aiding.step(state, force, rates, wheels(speed), slipping, 1.0, DT)
    return state


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-2.0, 2.0), st.integers(10, 300))
def test_a_start_does_not_bend_the_pitch(pitch: float, accel: float, ticks: int) -> None:
    state = held(pitch, 0.0, np.full(ticks, accel))
    assert state.pitch_rad == pytest.approx(pitch, abs=radians(0.05) + 0.002 * abs(accel))


def test_an_accelerometer_alone_would_be_six_degrees_off() -> None:
    assert degrees(1.0 / G) > 5.8  # what 1 m/s2 looks like


def test_a_wrong_start_is_corrected_within_ten_seconds() -> None:
    state = AidedTilt(roll_rad=0.05, pitch_rad=-0.05, begun=True)
    for _ in range(1000):
        state = tilt_aiding.step(state, (0.0, 0.0, G), (0.0, 0.0, 0.0), 0.0, False, 1.0, DT)
    assert state.pitch_rad == pytest.approx(0.0, abs=0.003)
    assert state.roll_rad == pytest.approx(0.0, abs=0.005)


def test_a_turn_does_not_bend_the_roll() -> None:
    start, on = np.full(200, 1.0), np.zeros(1000)
    state = held(0.0, 0.02, np.concatenate([start, on]), yaw_rate_radps=0.3)  # 0.6 m/s2 sideways
    assert state.roll_rad == pytest.approx(0.02, abs=radians(0.05))


def test_wheels_that_slip_do_not_lead_it_astray() -> None:
    spinning = held(0.02, 0.0, np.zeros(200), wheels=lambda v: v + 3.0, slipping=True)
    assert spinning.pitch_rad == pytest.approx(0.02, abs=1e-6)
    unseen = held(0.02, 0.0, np.zeros(100), wheels=lambda v: v + 3.0)
    assert abs(unseen.pitch_rad - 0.02) < 0.02  # what is not flagged is bounded


def test_the_gravity_comes_back_into_the_specific_force() -> None:
    half = radians(10.0) / 2.0
    nose_down = ImuSample(0.0, (np.cos(half), 0.0, np.sin(half), 0.0), (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 0)
    force = tilt_aiding.specific_force_mps2(nose_down)
    assert force == pytest.approx((-G * np.sin(2 * half), 0.0, G * np.cos(2 * half)))


def test_on_the_vehicle_starts_and_stops_leave_a_tenth_of_a_degree(
    roll: Callable[..., Iterator[Tick]],
) -> None:
    robot = load_robot(None)
    scenario = Scenario(title="starts", duration_s=20.0)

    def speed(time_s: float) -> tuple[float, float]:
        """1 m/s2 up and down, every five seconds."""
        phase = time_s % 5.0
        return max(0.0, min(phase, 1.0, 4.0 - phase)), 0.0

    state, errors = AidedTilt(), []
    for tick in roll(robot, scenario, speed, seed=1):
        imu, left = tick.inputs.imu, tick.inputs.wheels_left
        assert imu is not None
        assert left is not None
        force = tilt_aiding.specific_force_mps2(imu)
        wheels_mps = robot.vehicle.tire.rolling_radius_m * left.speed_radps[0]
        state = tilt_aiding.step(state, force, imu.rate_radps, wheels_mps, False, 1.0, 0.005)
        errors.append((state.roll_rad - tick.attitude_rad[0], state.pitch_rad - tick.attitude_rad[1]))
    assert np.abs(np.degrees(errors[400:])).max() < 0.2
    assert np.degrees(np.sqrt(np.mean(np.square(errors[400:])))) < 0.1
