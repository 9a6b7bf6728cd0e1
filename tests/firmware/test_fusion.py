"""The attitude filter by itself, as the host runs it: what it must get right whatever its tuning."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiger.native.attitude import AttitudeFilter, AttitudeTuning, ImuCalibration
from tiger.protocol.messages import ImuRaw

Array = NDArray[np.float64]
GRAVITY = 9.80665
FIELD_UT = np.array([0.0, 20.0, -45.0])
HZ = 100


def as_rotation(quaternion: Array) -> Rotation:
    return Rotation.from_quat(np.roll(np.atleast_2d(quaternion), -1, axis=1))


def tilt_deg(estimate: Array, truth: Rotation) -> Array:
    """Angle between the estimated and the true vertical, per sample."""
    up, true_up = as_rotation(estimate).inv().apply([0, 0, 1]), truth.inv().apply([0, 0, 1])
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(up, true_up), axis=1), np.sum(up * true_up, axis=1)))


def heading_deg(estimate: Array, truth: Rotation) -> Array:
    off = (as_rotation(estimate) * truth.inv()).as_quat()
    return np.degrees(2 * np.arctan2(off[:, 2], off[:, 3]) + np.pi) % 360 - 180


def readings(
    body: Rotation, accel: Array | None = None, field: Array = FIELD_UT
) -> tuple[Array, Array, Array]:
    """What ideal sensors read at 100 Hz (the field at 20) on a body that turns and accelerates so."""
    n = len(body)
    rate = np.zeros((n, 3))
    rate[1:] = (body[:-1].inv() * body[1:]).as_rotvec() * HZ
    force = body.inv().apply((np.zeros((n, 3)) if accel is None else accel) + np.array([0, 0, GRAVITY]))
    mag = body.inv().apply(np.broadcast_to(field, (n, 3)).copy())
    mag[np.arange(n) % 5 != 0] = np.nan
    return rate, force, mag


def about_z(degrees: Array) -> Rotation:
    return Rotation.from_euler("z", degrees[:, None], degrees=True)


def seconds(duration_s: float) -> Array:
    return np.arange(int(duration_s * HZ)) / HZ


def wander(t: Array, rates: bool = True) -> Rotation:
    """A lively body: all axes, not periodic together."""
    roll = 20 * np.sin(1.1 * t) + 8 * np.sin(2.9 * t)
    pitch = 15 * np.sin(0.7 * t + 1) + 6 * np.sin(3.7 * t)
    yaw = 40 * np.sin(0.23 * t) + 25 * t * rates
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]), degrees=True)


angles = st.floats(-179, 179)


# ---- inclination


@settings(max_examples=40, deadline=None)
@given(roll=angles, pitch=st.floats(-89, 89), yaw=angles)
def test_a_body_at_rest_is_seen_as_it_is(roll: float, pitch: float, yaw: float) -> None:
    truth = Rotation.from_euler("ZYX", [[yaw, pitch, roll]] * 600, degrees=True)
    history = AttitudeFilter().run(*readings(truth))
    assert tilt_deg(history.quaternion[-1], truth[-1:])[0] < 0.02
    assert abs(heading_deg(history.quaternion[-1], truth[-1:])[0]) < 0.1
    assert history.resting[-1]


def test_a_lively_body_is_followed_by_the_split_schedule_as_by_the_full_one() -> None:
    truth = wander(seconds(60))
    inputs = readings(truth)
    for slow_every in (1, 4):
        history = AttitudeFilter(AttitudeTuning(slow_every=slow_every)).run(*inputs)
        assert tilt_deg(history.quaternion, truth)[500:].max() < 0.15
        assert np.abs(heading_deg(history.quaternion, truth)[500:]).max() < 0.5


def test_coning_does_not_turn_the_body() -> None:
    t = seconds(60)
    axis = np.column_stack([np.cos(2 * np.pi * 2 * t), np.sin(2 * np.pi * 2 * t), np.zeros_like(t)])
    cone = Rotation.from_rotvec(np.radians(5) * axis)
    gyro = np.zeros((len(t), 3))  # what a rate gyro samples, not the mean over the tick
    dt = 1e-4
    ahead = Rotation.from_rotvec(
        np.radians(5)
        * np.column_stack([np.cos(4 * np.pi * (t + dt)), np.sin(4 * np.pi * (t + dt)), np.zeros_like(t)])
    )
    gyro = (cone.inv() * ahead).as_rotvec() / dt
    without_help = AttitudeFilter().run(gyro, np.full((len(t), 3), np.nan))
    turned = as_rotation(without_help.level_quaternion[:: HZ // 2]).magnitude()
    assert np.degrees(turned).max() < 10.2  # twice the cone's half angle: no drift on top in a minute


def test_a_gap_is_held_and_then_walked_without_a_jump() -> None:
    f = AttitudeFilter()
    level, tilted = (
        np.array([0, 0, GRAVITY]),
        Rotation.from_euler("x", -8, degrees=True).apply([0, 0, GRAVITY]),
    )
    f.run(np.zeros((500, 3)), np.tile(level, (500, 1)))
    steps = [f.step((0, 0, 0), tuple(tilted), follows_gap=True)]
    steps += [f.step((0, 0, 0), tuple(tilted)) for _ in range(400)]
    rotations = as_rotation(np.array([s.quaternion for s in steps]))
    assert np.degrees((rotations[:-1].inv() * rotations[1:]).magnitude()).max() < 0.5
    truth = Rotation.from_euler("x", [8.0], degrees=True)
    assert tilt_deg(np.array(steps[-1].quaternion), truth)[0] < 0.05
    assert np.abs(steps[-1].bias_radps).max() < np.radians(0.01)  # the gap is not taken for bias


def test_unusable_accelerations_leave_the_gyroscope_in_charge() -> None:
    truth = wander(seconds(20), rates=False)
    gyro, accel, mag = readings(truth)
    accel[1000:] = np.nan
    history = AttitudeFilter().run(gyro, accel, mag)
    assert tilt_deg(history.quaternion, truth)[-1] < 0.3


# ---- gyroscope bias


@settings(max_examples=15, deadline=None)
@given(bias=st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_bias_is_found_at_rest(bias: tuple[float, float, float]) -> None:
    truth = Rotation.identity(30 * HZ)
    gyro, accel, mag = readings(truth)
    history = AttitudeFilter().run(gyro + np.radians(bias), accel, mag)
    assert np.degrees(history.bias_radps[-1]) == pytest.approx(bias, abs=0.02)


def test_bias_about_every_axis_is_found_in_motion() -> None:
    truth = wander(seconds(240))
    gyro, accel, mag = readings(truth)
    history = AttitudeFilter().run(gyro + np.radians([0.6, -0.4, 0.5]), accel, mag)
    assert not history.resting[1000:].any()
    assert np.degrees(history.bias_radps[-1]) == pytest.approx([0.6, -0.4, 0.5], abs=0.06)


def test_bias_about_the_vertical_is_found_on_level_ground_only_with_the_magnetometer() -> None:
    t = seconds(200)
    truth = about_z(60 * np.sin(0.5 * t))
    gyro, accel, mag = readings(truth)
    gyro = gyro + np.radians([0, 0, 0.5])
    with_field = AttitudeFilter().run(gyro, accel, mag)
    without = AttitudeFilter().run(gyro, accel)
    assert np.degrees(with_field.bias_radps[-1, 2]) == pytest.approx(0.5, abs=0.06)
    assert np.degrees(without.bias_radps[-1, 2]) == pytest.approx(0.0, abs=0.1)


def test_a_known_bias_is_where_the_filter_starts() -> None:
    f = AttitudeFilter()
    f.start_bias_from((0.01, -0.005, 0.002))
    first = f.step((0.01, -0.005, 0.002), (0, 0, GRAVITY))
    assert first.rate_radps == pytest.approx((0, 0, 0), abs=1e-6)


def test_a_steady_slow_turn_on_the_wheels_is_not_taken_for_bias() -> None:
    t = seconds(30)
    truth = about_z(np.degrees(0.03) * t)  # 1.7 degrees/s, within what a bias can be
    gyro, accel, _ = readings(truth)
    rolling = AttitudeFilter().run(gyro, accel, speed_mps=np.full(len(t), 0.5))
    assert not rolling.resting.any()
    assert np.degrees(np.abs(rolling.bias_radps[-1, 2])) < 0.1


# ---- magnetic field


@pytest.mark.parametrize(
    "foreign_ut", [(25, 0, 0), (-12, -8, 0), (0, 0, 30), (10, 10, 10), (0, -40, 0), (15, -26, 0)]
)
def test_a_foreign_field_for_half_a_minute_does_not_turn_the_heading(
    foreign_ut: tuple[float, float, float],
) -> None:
    t = seconds(150)
    truth = wander(t)
    field = np.where(((t > 60) & (t < 90))[:, None], FIELD_UT + np.array(foreign_ut), FIELD_UT)
    gyro, accel, mag = readings(truth, field=field)
    history = AttitudeFilter().run(gyro, accel, mag)
    assert np.abs(heading_deg(history.quaternion, truth)[1500:]).max() < 2.0
    assert history.disturbed[62 * HZ : 90 * HZ].mean() > 0.9
    assert not history.disturbed[-20 * HZ :].any()


def test_a_foreign_field_does_not_tilt_the_body() -> None:
    t = seconds(120)
    truth = wander(t)
    field = np.where(((t > 40) & (t < 80))[:, None], FIELD_UT + np.array([30, -20, 15]), FIELD_UT)
    gyro, accel, mag = readings(truth, field=field)
    with_field = AttitudeFilter().run(gyro, accel, mag)
    assert tilt_deg(with_field.quaternion, truth)[500:].max() < 0.15


def test_a_field_that_stays_becomes_the_new_one() -> None:
    t = seconds(400)
    truth = wander(t)
    new = Rotation.from_euler("z", 60, degrees=True).apply(FIELD_UT) * 1.3
    field = np.where((t > 60)[:, None], new, FIELD_UT)
    gyro, accel, mag = readings(truth, field=field)
    history = AttitudeFilter().run(gyro, accel, mag)
    assert not history.disturbed[-1]
    assert heading_deg(history.quaternion, truth)[-1] == pytest.approx(-60, abs=3)


def test_without_a_magnetometer_the_heading_starts_at_zero_and_only_drifts() -> None:
    t = seconds(60)
    truth = about_z(30 * np.sin(0.4 * t))
    gyro, accel, _ = readings(truth)
    history = AttitudeFilter().run(gyro, accel)
    assert np.abs(heading_deg(history.quaternion, truth)).max() < 0.5


# ---- the wheels


def speeding(t: Array) -> tuple[Array, Array]:
    """Speed and acceleration of a car that speeds up and brakes over and over at up to 2.5 m/s2."""
    return 4 + 4 * np.sin(0.6 * t - np.pi / 2), 2.4 * np.cos(0.6 * t - np.pi / 2)


def test_speeding_up_does_not_read_as_pitch_with_the_wheels() -> None:
    t = seconds(30)
    speed, change = speeding(t)
    truth = Rotation.identity(len(t))
    accel = np.column_stack([change, np.zeros_like(t), np.zeros_like(t)])
    gyro, force, _ = readings(truth, accel)
    plain = AttitudeFilter().run(gyro, force)
    aided = AttitudeFilter().run(gyro, force, speed_mps=speed)
    assert tilt_deg(plain.quaternion, truth)[500:].max() > 1.0
    assert tilt_deg(aided.quaternion, truth)[500:].max() < 0.3


def test_a_long_bend_does_not_read_as_roll_with_the_wheels() -> None:
    t = seconds(30)
    speed, turn = 5.0, 0.6
    truth = about_z(np.degrees(turn) * t)
    inward = truth.apply(np.tile([0.0, speed * turn, 0.0], (len(t), 1)))
    gyro, force, _ = readings(truth, inward)
    gyro[0] = gyro[1]
    plain = AttitudeFilter().run(gyro, force)
    aided = AttitudeFilter().run(gyro, force, speed_mps=np.full(len(t), speed))
    assert tilt_deg(plain.quaternion, truth)[-1] > 3.0
    assert tilt_deg(aided.quaternion, truth)[500:].max() < 0.3


def test_spinning_wheels_are_not_believed_and_for_five_seconds_nor_is_the_accelerometer() -> None:
    t = seconds(20)
    truth = Rotation.identity(len(t))
    slipping = t >= 10
    wheel = np.where(slipping, 12.0, 2.0)
    accel = np.column_stack([np.where(slipping, 3.0, 0.0), np.zeros_like(t), np.zeros_like(t)])
    gyro, force, _ = readings(truth, accel)
    history = AttitudeFilter().run(gyro, force, speed_mps=wheel, slipping=slipping)
    off = tilt_deg(history.quaternion, truth)
    assert off[: 15 * HZ].max() < 0.05
    assert off[-1] > 1.0  # a lasting acceleration cannot be told from a slope for ever


# ---- numbers


def test_an_hour_at_rest_neither_drifts_nor_denormalises() -> None:
    rng = np.random.default_rng(5)
    f = AttitudeFilter()
    n = 60 * HZ
    for _ in range(60):
        history = f.run(
            rng.normal(0, 0.002, (n, 3)), np.array([0, 0, GRAVITY]) + rng.normal(0, 0.015, (n, 3))
        )
    norms = np.linalg.norm(history.quaternion, axis=1)
    assert np.abs(norms - 1).max() < 1e-5
    assert tilt_deg(history.quaternion, Rotation.identity(n)).max() < 0.1


@pytest.mark.parametrize(
    ("setting", "value", "says"),
    [
        ("slow_every", 3, "slow_every is 3"),
        ("tick_s", 0.0, "tick_s is 0.0"),
        ("accel_tau_s", math.nan, "accel_tau_s is nan"),
        ("slow_every", 252, "slow_every smaller"),
    ],
)
def test_a_tuning_that_cannot_work_is_refused_by_name(setting: str, value: float, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        AttitudeTuning(**{setting: value})  # type: ignore[arg-type]


def test_readings_of_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"both must be \(N, 3\)"):
        AttitudeFilter().run(np.zeros((5, 3)), np.zeros((4, 3)))


def test_calibration_is_applied_as_on_the_nano() -> None:
    raw = ImuRaw(0, (1.0, 2.0, 10.0), (0.1, 0.2, 0.3), (0.0, 0.0, 0.0), 0, 25)
    calibration = ImuCalibration((0.1, 0.0, -0.1), (0.5, 0.0, 0.2), (1.0, 2.0, 0.5))
    gyro, accel = calibration.apply(raw)
    assert gyro == pytest.approx((0.0, 0.2, 0.4))
    assert accel == pytest.approx((0.5, 4.0, 4.9))
