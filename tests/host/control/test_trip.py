"""Impacts are told from driving, braking, turning and rough ground."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control import trip
from tiger.control.trip import TripState

CONFIG = load_robot().stability
DT = 0.01


def tripped_after(
    along: list[float], across: list[float] | None = None, wanted: list[float] | None = None
) -> float | None:
    """Seconds to the flag, None without; the drive is told to go to `wanted` with up to 6 m/s2."""
    state = TripState()
    for k, x in enumerate(along):
        state = trip.step(
            CONFIG, state, x, across[k] if across else 0.0, wanted[k] if wanted else 0.0, 6.0, DT
        )
        if state.hold_s:
            return (k + 1) * DT
    return None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_blow_of_one_metre_per_second_is_flagged_within_50_ms(sign: float) -> None:
    blow = [sign * 20.0] * 5 + [0.0] * 20
    assert (tripped_after(blow) or 1.0) <= 0.05
    assert (tripped_after([0.0] * 25, blow) or 1.0) <= 0.05


def test_starting_and_braking_as_hard_as_the_drive_may_is_no_trip() -> None:
    """To 6 m/s in a second and back, the ramps a little late and without any rounding."""
    force = [0.0] * 110 + [6.0] * 100 + [0.0] * 90 + [-6.0] * 100 + [0.0] * 100
    wanted = [0.0] * 100 + [6.0] * 190 + [0.0] * 210
    assert tripped_after(force, wanted=wanted) is None
    assert tripped_after(force) is not None


def test_a_blow_at_a_steady_speed_is_not_put_down_to_the_drive() -> None:
    wanted = [6.0] * 300
    force = [6.0] * 100 + [0.0] * 100
    assert tripped_after([*force, *[0.0] * 100], wanted=wanted) is None
    assert tripped_after([*force, *[-6.0] * 8, *[0.0] * 92], wanted=wanted) == pytest.approx(2.06, abs=0.03)


def test_a_slope_and_a_leaning_body_are_no_trip() -> None:
    ramp = [3.0 * min(1.0, k / 60) for k in range(300)]
    assert tripped_after([0.0] * 300, ramp) is None


def test_shaking_of_rough_ground_is_no_trip() -> None:
    time = np.arange(0.0, 60.0, DT)
    shaking = 2.5 * np.sin(2.0 * np.pi * 4.0 * time)
    assert tripped_after(shaking.tolist()) is None


def test_a_trip_is_shown_for_its_time_and_no_longer() -> None:
    state = TripState()
    for _ in range(5):
        state = trip.step(CONFIG, state, -30.0, 0.0, 0.0, 1.0, DT)
    assert state.hold_s > 0.0
    for _ in range(round((CONFIG.trip_hold_s + 0.6) / DT)):
        state = trip.step(CONFIG, state, 0.0, 0.0, 0.0, 1.0, DT)
    assert state.hold_s == 0.0
