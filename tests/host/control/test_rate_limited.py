"""The nearest rate-limited motion, against what is known of it without a search."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from tiger.control.rate_limited import distance_to_optimum, in_rhombus, nearest_motion

LIMITS = (1.8, 2.1)
DT = 0.02


@given(roll=st.floats(-10.0, 10.0), pitch=st.floats(-10.0, 10.0))
def test_the_projection_is_the_nearest_point_of_the_rhombus(roll: float, pitch: float) -> None:
    found = in_rhombus(np.array([[roll, pitch]]), LIMITS)[0]
    size = abs(found[0]) / LIMITS[0] + abs(found[1]) / LIMITS[1]
    assert size <= 1.0 + 1e-9
    outside = abs(roll) / LIMITS[0] + abs(pitch) / LIMITS[1] > 1.0
    if not outside:
        assert found == pytest.approx([roll, pitch])
        return
    # No point of the boundary is nearer.
    share = np.linspace(0.0, 1.0, 401)
    edge = np.column_stack([share * LIMITS[0], (1.0 - share) * LIMITS[1]])
    nearest = np.hypot(edge[:, 0] - abs(roll), edge[:, 1] - abs(pitch)).min()
    assert math.hypot(found[0] - roll, found[1] - pitch) <= nearest + 1e-6


def test_slow_ground_is_followed_to_the_end() -> None:
    time = np.arange(0.0, 4.0, DT)
    ground = np.column_stack([0.5 * np.sin(time), 0.3 * np.cos(time)])
    rate, left = nearest_motion(ground, LIMITS, DT, 4000)
    assert np.abs(left).max() < 0.02
    assert (np.abs(rate) @ (1.0 / np.array(LIMITS))).max() <= 1.0 + 1e-9


@pytest.mark.parametrize(("overspeed", "residual"), [(1.5, 0.1826), (2.0, 0.3714), (3.0, 0.5778)])
def test_of_a_fast_sine_it_leaves_what_theory_says(overspeed: float, residual: float) -> None:
    """Least residual of a rate-limited motion on a sine, vehicle-independent (test_rhythm.py has it too)."""
    period, periods = 4.0, 5
    time = np.arange(0.0, periods * period, DT)
    amplitude = overspeed * LIMITS[0] * period / (2.0 * math.pi)
    ground = np.column_stack([amplitude * np.sin(2.0 * math.pi * time / period), np.zeros_like(time)])
    _, left = nearest_motion(ground, LIMITS, DT, 3000)
    middle = slice(round(period / DT), -round(period / DT))
    share = left[middle, 0].std() / (amplitude / math.sqrt(2.0))
    assert share == pytest.approx(residual, rel=0.03)


def test_nothing_is_below_the_certified_optimum() -> None:
    rng = np.random.default_rng(1)
    ground = np.cumsum(0.2 * rng.standard_normal((40, 2)), axis=0)
    rate, left = nearest_motion(ground, LIMITS, 0.05, 300, start=np.zeros(2))
    gap = distance_to_optimum(rate, left, LIMITS, 0.05)
    total = float((left**2).sum())
    assert 0.0 <= gap < 0.01 * total

    def other(x: np.ndarray) -> float:
        tried = in_rhombus(x.reshape(-1, 2), LIMITS)
        return float(((ground - 0.05 * np.cumsum(tried, axis=0)) ** 2).sum())

    better = minimize(other, rate.ravel(), method="Powell", options={"maxiter": 2})
    assert better.fun >= total - gap - 1e-9


def test_a_guess_shortens_the_search() -> None:
    rng = np.random.default_rng(2)
    ground = np.cumsum(0.2 * rng.standard_normal((30, 2)), axis=0)
    best, left = nearest_motion(ground, LIMITS, 0.05, 2000, start=np.zeros(2))
    _, again = nearest_motion(ground, LIMITS, 0.05, 3, start=np.zeros(2), guess=best)
    _, cold = nearest_motion(ground, LIMITS, 0.05, 3, start=np.zeros(2))
    assert (again**2).sum() <= 1.001 * (left**2).sum() < (cold**2).sum()
