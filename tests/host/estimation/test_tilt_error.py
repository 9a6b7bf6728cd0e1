"""What the Nano's attitude is off by: followed while the odometry knows better, else forgotten."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.estimation import tilt_error
from tiger.estimation.inertial import PITCH, ROLL, Motion, N
from tiger.estimation.odometry import Held, OdometryState
from tiger.estimation.tilt_error import HELD_WITHIN_S, PAIRED_WITHIN_S, TiltError
from tiger.record import ImuSample

CONFIG = load_robot().observer
PERIOD_S = 1.0 / CONFIG.imu_rate_hz
WRONG = radians(3.0)


def nano(t_s: float, roll: float = 0.0, pitch: float = 0.0) -> ImuSample:
    a, b, c, d = cos(roll / 2), sin(roll / 2), cos(pitch / 2), sin(pitch / 2)
    none = (0.0, 0.0, 0.0)
    return ImuSample(t_s, (a * c, b * c, a * d, -b * d), none, none, none, 0)


def odometry(
    t_s: float, roll: float = 0.0, pitch: float = 0.0, sigma_deg: float = 0.1, held_s: float = 0.0
) -> OdometryState:
    covariance = np.zeros((N, N))
    covariance[ROLL, ROLL] = covariance[PITCH, PITCH] = radians(sigma_deg) ** 2
    return OdometryState(
        motion=Motion(roll_rad=roll, pitch_rad=pitch),
        imu_t_s=t_s,
        held=Held(covariance=covariance, imu_t_s=t_s - held_s),
        begun=True,
    )


def after(seconds: float, error: TiltError, **known: float) -> TiltError:
    """The Nano says level; the odometry what `known` says."""
    begin = max(error.t_s, 0.0)
    for step in range(1, round(seconds / PERIOD_S) + 1):
        t_s = begin + step * PERIOD_S
        error = tilt_error.step(CONFIG, error, nano(t_s), odometry(t_s, **known))
    return error


def test_what_a_start_bent_is_put_right_as_fast_as_it_comes() -> None:
    error = after(1.5, TiltError(), roll=radians(-0.5), pitch=WRONG)
    assert error.roll_rad == pytest.approx(radians(-0.5), abs=radians(0.02))
    assert error.pitch_rad == pytest.approx(WRONG, abs=radians(0.02))


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_it_never_jumps(roll: float, pitch: float, before: float) -> None:
    begun = TiltError(before, -before, 1.0)
    error = tilt_error.step(CONFIG, begun, nano(1.01), odometry(1.01, roll, pitch))
    most = radians(CONFIG.tilt_rate_degps) * 0.01 + 1e-12
    assert abs(error.roll_rad - before) <= most
    assert abs(error.pitch_rad + before) <= most


def test_a_late_sample_is_followed_all_the_way_and_no_farther() -> None:
    way = 0.5 * radians(CONFIG.tilt_rate_degps) * PAIRED_WITHIN_S
    late = 1.0 + PAIRED_WITHIN_S
    error = tilt_error.step(CONFIG, TiltError(t_s=1.0), nano(late), odometry(late, way, -way))
    assert (error.roll_rad, error.pitch_rad) == pytest.approx((way, -way))


@pytest.mark.parametrize("unknown", [{"sigma_deg": 1.0}, {"held_s": 2.0 * HELD_WITHIN_S}])
def test_without_wheels_or_certainty_it_is_forgotten_as_slowly_as_the_nano_forgets(unknown: dict) -> None:
    begun = TiltError(0.0, WRONG, 0.0)
    error = after(CONFIG.tilt_forget_s, begun, pitch=radians(-20.0), **unknown)
    assert error.pitch_rad == pytest.approx(WRONG / np.e, rel=0.01)


def test_readings_of_two_moments_are_not_compared() -> None:
    begun = TiltError(0.0, WRONG, 1.0)
    assert tilt_error.step(CONFIG, begun, nano(1.01), odometry(1.0, pitch=-WRONG)) is begun
    late = 1.0 + 1.5 * PAIRED_WITHIN_S
    silent = tilt_error.step(CONFIG, begun, nano(late), odometry(1.0, pitch=-WRONG))
    assert 0.9 * WRONG < silent.pitch_rad < WRONG


def test_a_sample_counts_once() -> None:
    once = tilt_error.step(CONFIG, TiltError(), nano(1.0), odometry(1.0, pitch=WRONG))
    assert once.pitch_rad > 0.0
    assert tilt_error.step(CONFIG, once, nano(1.0), odometry(1.0, pitch=WRONG)) is once
