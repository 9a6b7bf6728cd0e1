"""The twist of the ground from the mean slope under both axles, followed over the way driven."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.estimation import ground_track
from tiger.record import Estimate, Odometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.estimation.ground_track import TrackDesign, TrackState

HALF_TRACK_MM, HALF_BASE_M = 600.0, 0.5


@pytest.fixture(scope="module")
def design() -> TrackDesign:
    return ground_track.design_track(load_robot())


def drive(
    design: TrackDesign,
    difference_mm: Callable[[float], float],
    way_m: float,
    *,
    speed_mps: float = 0.2,
    yaw_rad_per_m: float = 0.0,
    state: TrackState | None = None,
    from_m: float = 0.0,
) -> tuple[TrackState, list[tuple[float, float, float]]]:
    """Drive over ground whose wheels stand `difference_mm` (half, left less right) apart at each place.

    Rows: place, true twist, estimated twist.
    """
    state = state or ground_track.initial_state(design)
    sign = math.copysign(1.0, speed_mps)
    rows = []
    begun = state.travelled_m
    for k in range(round(way_m / 0.01)):
        x = from_m + sign * 0.01 * k
        front, rear = difference_mm(x + HALF_BASE_M), difference_mm(x - HALF_BASE_M)
        where = Odometry(distance_m=begun + 0.01 * k, speed_mps=speed_mps, yaw_rad=yaw_rad_per_m * 0.01 * k)
        slope = 0.5 * (front + rear) / HALF_TRACK_MM
        estimate = replace(Estimate(ready=True), plate_roll_rad=slope, odometry=where)
        state = ground_track.step(design, state, estimate)
        rows.append((x, 0.5 * (front - rear), ground_track.twist(design, state)[0]))
    return state, rows


def rolling(x: float) -> float:
    return 25.0 * math.sin(2.0 * math.pi * max(0.0, x - 1.0) / 3.0)


def test_the_twist_of_rolling_ground_is_followed_from_flat_ground_on(design) -> None:
    _, rows = drive(design, rolling, 10.0)
    _, true, found = np.array(rows[300:]).T
    assert np.std(true) > 15.0
    assert np.std(found - true) < 0.4 * np.std(true)


def test_flat_and_evenly_sloping_ground_have_no_twist(design) -> None:
    for height in (0.0, 40.0):
        _, rows = drive(design, lambda _, h=height: h, 4.0)
        assert np.abs(np.array(rows)[200:, 2]).max() < 3.0


def test_backwards_over_the_same_ground_the_twist_keeps_its_sign(design) -> None:
    state, rows = drive(design, rolling, 6.0)
    back, again = drive(design, rolling, 2.0, speed_mps=-0.2, state=state, from_m=rows[-1][0])
    assert not back.forwards
    _, true, found = np.array(again[20:]).T
    assert np.corrcoef(true, found)[0, 1] > 0.8


def test_standing_changes_nothing(design) -> None:
    state, _ = drive(design, rolling, 5.0)
    where = Odometry(distance_m=state.travelled_m + 0.01, speed_mps=0.0)
    estimate = replace(Estimate(ready=True), plate_roll_rad=0.3, odometry=where)
    assert ground_track.step(design, state, estimate) is state


def test_turning_forgets_the_track(design) -> None:
    straight, _ = drive(design, rolling, 4.0)
    turned, _ = drive(design, rolling, 4.0, yaw_rad_per_m=1.5)
    assert straight.known > 0.9
    assert turned.known < 0.3
    sigma = [ground_track.twist(design, state)[1] for state in (straight, turned)]
    assert sigma[1] > 3.0 * sigma[0]


def test_before_the_first_metre_nothing_is_claimed(design) -> None:
    twist_mm, sigma_mm = ground_track.twist(design, ground_track.initial_state(design))
    assert twist_mm == 0.0
    assert sigma_mm == pytest.approx(load_robot().contact.expected_twist_mm)


def test_on_flat_ground_after_hollows_the_twist_does_not_go_on_alternating(design) -> None:
    """A twist that changes sign every wheelbase has no mean slope: only that this is unlikely tells."""

    def hollows(x: float) -> float:
        return 30.0 * math.sin(2.0 * math.pi * (x - 1.0) / 2.2) ** 3 if 1.0 < x < 4.0 else 0.0

    _, rows = drive(design, hollows, 9.0)
    place, true, found = np.array(rows).T
    assert np.abs(found[place < 5.0] - true[place < 5.0]).max() > 3.0
    flat = place > 4.0 + HALF_BASE_M + 1.6 * 2.0 * HALF_BASE_M
    assert np.abs(found[flat]).max() < 1.0


def test_a_plateau_under_one_side_keeps_its_twist_while_only_one_axle_is_on_it(design) -> None:
    """The mean stays the same there too, but not for a whole wheelbase."""
    _, rows = drive(design, lambda x: 30.0 if x > 2.0 else 0.0, 3.4)
    place, true, found = np.array(rows).T
    there = (place > 1.7) & (place < 2.4)
    assert true[there].min() == 15.0
    assert found[there].min() > 10.0


def test_mounds_that_mirror_each_other_are_not_taken_for_even_ground(design) -> None:
    """Left and right by turns, a wheelbase apart: the mean slope is none all along."""

    def mounds(x: float) -> float:
        return 30.0 * math.sin(math.pi * (x - 1.0)) if x > 1.0 else 0.0

    _, rows = drive(design, mounds, 6.0)
    _, true, found = np.array(rows[250:]).T
    assert np.std(true) > 20.0
    assert np.std(found - true) < 0.4 * np.std(true)
