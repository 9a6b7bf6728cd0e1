"""IMU: eqs. 6.5-6.8 hold as derivatives of each other, and the sensor adds what its data sheet says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.imu import (
    BNO055,
    Imu,
    Triad,
    TriadSpec,
    offset_motion,
    specific_force,
    up_in_body,
)

ANGLES = st.floats(-0.7, 0.7)
RATES = st.floats(-3.0, 3.0)
State = tuple[float, float, float, float, float, float]
STATE = st.tuples(ANGLES, ANGLES, RATES, RATES, RATES, RATES)
OFFSET = (0.3, -0.2, 0.125)


def path(state: State) -> Callable[[float], tuple[float, float]]:
    """Angles as parabolas of time through the given values at t = 0."""
    roll, pitch, roll_rate, pitch_rate, roll_acc, pitch_acc = state

    def at(t: float) -> tuple[float, float]:
        return roll + roll_rate * t + roll_acc * t * t / 2, pitch + pitch_rate * t + pitch_acc * t * t / 2

    return at


# ---- kinematics


@given(ANGLES, ANGLES)
def test_position_is_the_offset_turned_by_roll_after_pitch(roll: float, pitch: float) -> None:
    expected = Rotation.from_euler("XY", [roll, pitch]).apply(OFFSET)
    np.testing.assert_allclose(
        offset_motion(roll, pitch, 0, 0, 0, 0, OFFSET).position_m, expected, atol=1e-12
    )


@given(STATE)
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(state: State) -> None:
    at, step = path(state), 1e-4

    def position(t: float) -> np.ndarray:
        return offset_motion(*at(t), 0, 0, 0, 0, OFFSET).position_m

    motion = offset_motion(*state, OFFSET)
    velocity = (position(step) - position(-step)) / (2 * step)
    acceleration = (position(step) - 2 * position(0.0) + position(-step)) / step**2
    np.testing.assert_allclose(motion.velocity_mps, velocity, atol=1e-6)
    np.testing.assert_allclose(motion.acceleration_mps2, acceleration, atol=1e-5)


@given(STATE)
def test_specific_force_is_the_same_acceleration_seen_from_the_body(state: State) -> None:
    roll, pitch, roll_rate, pitch_rate, roll_acc, pitch_acc = state
    turn = Rotation.from_euler("XY", [roll, pitch])
    # Rx(roll) Ry(pitch): the body's rate is the roll rate turned back by pitch, plus the pitch rate.
    back = Rotation.from_euler("Y", pitch).inv()
    pitch_axis = np.array([0.0, 1.0, 0.0])
    rolling = back.apply([roll_rate, 0.0, 0.0])
    rate = rolling + pitch_rate * pitch_axis
    angular_acc = (
        back.apply([roll_acc, 0.0, 0.0]) + pitch_acc * pitch_axis - np.cross(pitch_rate * pitch_axis, rolling)
    )
    up = turn.inv().apply([0.0, 0.0, 1.0])
    felt = specific_force([0.0, 0.0, 0.0], rate, angular_acc, up, OFFSET)
    world = offset_motion(*state, OFFSET).acceleration_mps2 + np.array([0.0, 0.0, GRAVITY_MPS2])
    np.testing.assert_allclose(turn.apply(felt), world, atol=1e-9)


def test_kinematics_are_vectorised() -> None:
    rng = np.random.default_rng(0)
    states = rng.uniform(-0.5, 0.5, (6, 20))
    together = offset_motion(*states, OFFSET)
    one = offset_motion(*states[:, 7], OFFSET)
    np.testing.assert_allclose(together.acceleration_mps2[7], one.acceleration_mps2, atol=1e-15)
    assert together.velocity_mps.shape == (20, 3)


def test_small_motion_lifts_the_imu_by_roll_times_y_minus_pitch_times_x() -> None:
    # The linear reading of eq. 6.7 that the 7-DOF model uses.
    acc = offset_motion(0.0, 0.0, 0.0, 0.0, 0.4, 0.7, OFFSET).acceleration_mps2
    assert acc[2] == pytest.approx(0.4 * OFFSET[1] - 0.7 * OFFSET[0])


@given(ANGLES, ANGLES)
def test_up_in_body_is_the_third_row_of_the_attitude(roll: float, pitch: float) -> None:
    expected = Rotation.from_euler("ZYX", [0.3, pitch, roll]).as_matrix()[2]
    np.testing.assert_allclose(up_in_body(roll, pitch), expected, atol=1e-12)


def test_at_rest_an_accelerometer_reads_plus_g_upwards_wherever_it_sits() -> None:
    zero = np.zeros(3)
    felt = specific_force(zero, zero, zero, up_in_body(0.0, 0.0), OFFSET)
    assert felt.tolist() == [0.0, 0.0, GRAVITY_MPS2]
    # Left side up: the left axis has a part that points up.
    assert specific_force(zero, zero, zero, up_in_body(0.1, 0.0), OFFSET)[1] > 0.9
    # Nose down: the forward axis has a part that points down.
    assert specific_force(zero, zero, zero, up_in_body(0.0, 0.1), OFFSET)[0] < -0.9


# ---- the sensor

CLEAN = TriadSpec(noise_density=0.0, bandwidth_hz=50.0, bias=0.0, bias_walk=0.0, step=0.0, limit=1e9)


def triad(spec: TriadSpec, seed: int = 0) -> Triad:
    return Triad(spec, np.random.default_rng(seed))


def test_bandwidth_is_where_the_gain_falls_by_3_db() -> None:
    sensor, dt = triad(CLEAN), 1e-5
    times = np.arange(0.0, 0.2, dt)
    heard = []
    for t in times:
        sensor.advance(np.full(3, np.sin(2 * np.pi * 50.0 * t)), dt)
        heard.append(sensor.read()[0])
    assert max(heard[len(heard) // 2 :]) == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_noise_of_a_reading_is_density_times_root_of_bandwidth() -> None:
    sensor = triad(replace(CLEAN, noise_density=0.02))
    readings = np.array([sensor.read() for _ in range(20000)])
    np.testing.assert_allclose(readings.std(axis=0), 0.02 * np.sqrt(50.0), rtol=0.03)
    assert np.abs(np.corrcoef(readings.T) - np.eye(3)).max() < 0.03


def test_bias_is_constant_for_a_sensor_and_even_over_sensors() -> None:
    spec = replace(CLEAN, bias=2.0)
    one = triad(spec, 3)
    assert one.read() == one.read() == tuple(one.bias.tolist())
    many = np.concatenate([triad(spec, seed).bias for seed in range(500)])
    assert np.abs(many).max() <= 2.0
    assert many.std() == pytest.approx(2.0 / np.sqrt(3.0), rel=0.05)


@pytest.mark.parametrize("reads", [1, 10, 100])
def test_bias_walk_grows_with_the_root_of_time_however_often_it_is_read(reads: int) -> None:
    spread = []
    for seed in range(300):
        sensor = triad(replace(CLEAN, bias_walk=0.5), seed)
        for _ in range(reads):
            sensor.advance(np.zeros(3), 4.0 / reads)
            sensor.read()
        spread.append(sensor.bias)
    assert np.std(spread) == pytest.approx(0.5 * 2.0, rel=0.08)


def test_readings_are_rounded_and_saturate() -> None:
    sensor = triad(replace(CLEAN, step=0.25, limit=3.0))
    sensor.advance(np.array([0.3, -10.0, 10.0]), 1000.0)
    assert sensor.read() == (0.25, -3.0, 3.0)


def test_an_imu_is_reproducible_and_its_triads_independent() -> None:
    def readings(seed: int) -> list[float]:
        imu = Imu(BNO055, np.random.default_rng(seed))
        imu.advance(np.array([0.0, 0.0, 9.8]), np.zeros(3), np.array([20.0, 0.0, -43.0]), 0.01)
        return [float(v) for part in imu.read() for v in part]

    assert readings(4) == readings(4)
    assert readings(4) != readings(5)


def test_bno055_has_the_figures_of_its_data_sheet() -> None:
    sample_sd = BNO055.gyroscope.noise_density * np.sqrt(BNO055.gyroscope.bandwidth_hz)
    assert np.degrees(sample_sd) == pytest.approx(0.1, rel=0.05)  # 0.1 deg/s RMS at 47 Hz
    assert np.degrees(BNO055.gyroscope.step) == pytest.approx(1 / 16)
    assert BNO055.accelerometer.step == 0.01
    assert BNO055.accelerometer.bias == pytest.approx(0.785, rel=0.01)
