"""The learned oscillator: it locks, knows when it does not, and follows what can be followed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.control.rhythm import Rhythm, followable, learn

DT = 0.005


def sine(amplitude_deg: float, frequency_hz: float, centre_deg: float = 0.0):
    amplitude, centre, w = math.radians(amplitude_deg), math.radians(centre_deg), 2.0 * math.pi * frequency_hz
    return lambda t: (centre + amplitude * math.sin(w * t), amplitude * w * math.cos(w * t))


def taught(ground, seconds: float, state: Rhythm | None = None, start_s: float = 0.0, noise_deg: float = 0.0):
    rng = np.random.default_rng(7)
    state = state or Rhythm()
    for tick in range(round(seconds / DT)):
        angle, rate = ground(start_s + tick * DT)
        if noise_deg:
            angle += math.radians(noise_deg) * rng.standard_normal()
        state = learn(state, angle, rate, DT)
    return state


@pytest.mark.parametrize(
    ("frequency_hz", "amplitude_deg"), [(0.06, 5.0), (0.2, 2.0), (0.2, 6.0), (0.5, 1.0), (1.0, 0.7)]
)
def test_after_five_periods_it_knows_frequency_amplitude_centre_and_phase(
    frequency_hz, amplitude_deg
) -> None:
    seconds = 5.25 / frequency_hz
    state = taught(sine(amplitude_deg, frequency_hz, centre_deg=1.0), seconds, noise_deg=0.005)
    assert state.trusted
    assert state.frequency_radps == pytest.approx(2.0 * math.pi * frequency_hz, rel=0.02)
    assert state.amplitude_rad == pytest.approx(math.radians(amplitude_deg), rel=0.05)
    assert math.degrees(state.centre) == pytest.approx(1.0, abs=0.03 * amplitude_deg)
    wanted = 2.0 * math.pi * frequency_hz * seconds
    error = math.remainder(math.atan2(state.x, state.y) - wanted, 2.0 * math.pi)
    assert abs(error) < 0.05


def test_before_three_periods_it_is_not_trusted() -> None:
    assert not taught(sine(3.0, 0.2), 3.0 / 0.2).trusted


def test_ground_that_stops_is_not_trusted_for_long() -> None:
    state = taught(sine(3.0, 0.2), 8.0 / 0.2)
    assert state.trusted
    last = sine(3.0, 0.2)(8.0 / 0.2)[0]
    assert not taught(lambda _: (last, 0.0), 2.5, state).trusted


def test_ground_that_stays_still_teaches_nothing() -> None:
    assert taught(lambda _: (0.03, 0.0), 30.0).frequency_radps == 0.0


def test_a_single_tilt_is_no_rhythm() -> None:
    def tilt(t: float) -> tuple[float, float]:
        rate = math.radians(20.0) if 2.0 < t < 2.25 else 0.0
        return math.radians(20.0) * min(max(t - 2.0, 0.0), 0.25), rate

    assert not taught(tilt, 40.0).trusted


def test_random_ground_is_not_trusted() -> None:
    rng, angle, rate = np.random.default_rng(3), 0.0, 0.0
    state, trusted = Rhythm(), 0
    for _ in range(40_000):
        rate += DT * (-1.0 * rate - 2.0 * angle) + 0.1 * math.sqrt(DT) * rng.standard_normal()
        angle += DT * rate
        state = learn(state, angle, rate, DT)
        trusted += state.trusted
    assert trusted < 0.05 * 40_000


def test_a_new_frequency_is_learned_afresh() -> None:
    state = taught(sine(3.0, 0.2), 8.0 / 0.2)
    state = taught(sine(3.0, 0.5), 6.0 / 0.5, state)
    assert state.trusted
    assert state.frequency_radps == pytest.approx(2.0 * math.pi * 0.5, rel=0.02)


@settings(deadline=None)
@given(
    phase=st.floats(-math.pi, math.pi),
    overspeed=st.floats(0.5, 6.0),
    amplitude=st.floats(0.005, 0.2),
    w=st.floats(0.2, 6.0),
)
def test_what_is_followed_never_exceeds_the_rate(
    phase: float, overspeed: float, amplitude: float, w: float
) -> None:
    state = Rhythm(x=amplitude * math.sin(phase), y=amplitude * math.cos(phase), frequency_radps=w)
    limit = amplitude * w / overspeed
    angle, rate = followable(state, limit)
    assert abs(rate) <= limit * (1 + 1e-6)
    assert abs(angle) <= amplitude * (1 + 1e-9)
    if overspeed <= 1.0:
        assert (angle, rate) == pytest.approx((state.x, w * state.y), abs=1e-6)


@pytest.mark.parametrize(
    ("overspeed", "least"), [(1.2, 0.053), (1.5, 0.183), (2.0, 0.371), (3.0, 0.578), (5.0, 0.746)]
)
def test_no_rate_limited_motion_leaves_less(overspeed: float, least: float) -> None:
    """The closed form against a numerical search over all periodic motions within the rate limit."""
    from scipy.optimize import LinearConstraint, minimize

    phase = np.linspace(0.0, 2.0 * math.pi, 120, endpoint=False)
    followed = np.array(
        [
            followable(Rhythm(x=math.sin(p), y=math.cos(p), frequency_radps=1.0), 1.0 / overspeed)[0]
            for p in phase
        ]
    )
    step = (phase[1] - phase[0]) / overspeed
    differences = np.eye(120) - np.roll(np.eye(120), 1, axis=1)
    found = minimize(
        lambda x: 0.5 * float(np.sum((x - np.sin(phase)) ** 2)),
        np.zeros(120),
        jac=lambda x: x - np.sin(phase),
        constraints=LinearConstraint(differences, -step, step),
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-10},
    )
    assert found.success
    searched = math.sqrt(np.mean((found.x - np.sin(phase)) ** 2) / 0.5)
    closed = math.sqrt(np.mean((followed - np.sin(phase)) ** 2) / 0.5)
    assert closed == pytest.approx(searched, rel=0.01)
    assert closed == pytest.approx(least, abs=0.002)
