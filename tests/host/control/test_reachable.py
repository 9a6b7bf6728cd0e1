"""What the strokes reach and how fast: closed forms, laws, and brute force."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control.reachable import Pose, Suspension, rate_bound_s

SUSPENSION = Suspension.from_config(load_robot())
MID = (35.0, 35.0, 35.0, 35.0)

angle = st.floats(-0.3, 0.3)
lift = st.floats(0.0, 139.0)
stroke = st.floats(0.0, 70.0)


@settings(deadline=None)
@given(lifts=st.tuples(lift, lift, lift, lift))
def test_four_lifts_are_a_plane_and_a_warp(lifts: tuple[float, float, float, float]) -> None:
    assert SUSPENSION.lifts_mm(SUSPENSION.pose(lifts)) == pytest.approx(lifts, abs=1e-9)


@settings(deadline=None)
@given(roll=angle, pitch=angle, ride=lift)
def test_a_pose_comes_back_from_its_lifts(roll: float, pitch: float, ride: float) -> None:
    pose = SUSPENSION.pose(SUSPENSION.lifts_mm(Pose(roll, pitch, ride)))
    assert (pose.roll_rad, pose.pitch_rad, pose.ride_mm, pose.warp_mm) == pytest.approx(
        (roll, pitch, ride, 0.0), abs=1e-9
    )


def test_a_positive_roll_lifts_the_left_and_a_positive_pitch_the_rear() -> None:
    fl, fr, rl, rr = SUSPENSION.lifts_mm(Pose(0.1, 0.0, 0.0))
    assert fl == rl > 0.0 > fr == rr
    fl, fr, rl, rr = SUSPENSION.lifts_mm(Pose(0.0, 0.1, 0.0))
    assert rl == rr > 0.0 > fl == fr


@settings(deadline=None)
@given(roll=angle, pitch=angle)
def test_what_is_reachable_finds_all_four_lifts_in_range(roll: float, pitch: float) -> None:
    low, high = SUSPENSION.ride_range_mm(roll, pitch)
    assert SUSPENSION.reachable(roll, pitch) == (low <= high + 1e-6)


@settings(deadline=None)
@given(roll=angle, pitch=angle)
def test_the_nearest_attitude_is_reachable_and_no_other_is_nearer(roll: float, pitch: float) -> None:
    nearest = SUSPENSION.nearest(roll, pitch)
    assert SUSPENSION.reachable(*nearest)
    distance = math.dist(nearest, (roll, pitch))
    top_roll, top_pitch = SUSPENSION.limits()
    for share in np.linspace(0.0, 1.0, 41):
        for sign_roll, sign_pitch in product((-1, 1), repeat=2):
            edge = (sign_roll * share * top_roll, sign_pitch * (1.0 - share) * top_pitch)
            inside = SUSPENSION.reachable(roll, pitch)
            assert inside or distance <= math.dist(edge, (roll, pitch)) + 1e-9


@settings(deadline=None)
@given(roll=angle, pitch=angle, warp=st.floats(-60.0, 60.0))
def test_a_twist_leaves_each_side_and_axle_its_share_of_the_lift(
    roll: float, pitch: float, warp: float
) -> None:
    span = SUSPENSION.lift_high_mm - SUSPENSION.lift_low_mm
    half_along = 0.5 * (SUSPENSION.x_mm[0] - SUSPENSION.x_mm[2])

    def fits(roll: float, pitch: float) -> bool:
        lifts = SUSPENSION.lifts_mm(Pose(roll, pitch, 0.0, warp))
        return max(lifts) - min(lifts) <= span + 1e-6

    near_roll, near_pitch = SUSPENSION.nearest(roll, pitch, warp)
    assert fits(near_roll, near_pitch)
    if fits(roll, pitch):
        assert (near_roll, near_pitch) == pytest.approx((roll, pitch))
    for alone, reach in (((roll, 0.0), SUSPENSION.y_mm[0]), ((0.0, pitch), half_along)):
        most = max(0.0, 0.5 * span - abs(warp)) / reach
        nearest = SUSPENSION.nearest(*alone, warp)
        assert sum(nearest) == pytest.approx(min(most, max(-most, sum(alone))))


def test_roll_and_pitch_share_the_stroke() -> None:
    roll, pitch = SUSPENSION.limits()
    assert math.degrees(roll) == pytest.approx(6.34, abs=0.02)
    assert math.degrees(pitch) == pytest.approx(7.60, abs=0.02)
    assert SUSPENSION.reachable(0.499 * roll, 0.499 * pitch)
    assert not SUSPENSION.reachable(0.51 * roll, 0.51 * pitch)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "seconds"), [(4.5, 0.0, 2.64), (5.0, 0.0, 2.93), (0.0, 5.0, 2.35)]
)
def test_the_rate_bound_agrees_with_the_linear_estimate(
    roll_deg: float, pitch_deg: float, seconds: float
) -> None:
    """The published figures take the widest track; ours takes the model's half-track and the true curve."""
    bound = rate_bound_s(SUSPENSION, MID, math.radians(roll_deg), math.radians(pitch_deg))
    assert bound == pytest.approx(seconds, rel=0.05)


@settings(deadline=None)
@given(
    roll=st.floats(-0.1, 0.1), pitch=st.floats(-0.1, 0.1), strokes=st.tuples(stroke, stroke, stroke, stroke)
)
def test_no_stroke_rates_beat_the_bound(roll: float, pitch: float, strokes: tuple) -> None:
    """In a shorter time the four ranges of lift have no plane with this turn in common."""
    bound = rate_bound_s(SUSPENSION, strokes, roll, pitch)
    if not math.isfinite(bound) or bound < 1e-3:
        return
    way = 0.99 * bound * SUSPENSION.rate_mmps
    corners = [
        [
            SUSPENSION.curve.at(min(70.0, max(0.0, s + sign * way)))[0] - SUSPENSION.curve.at(s)[0]
            for sign in (-1, 1)
        ]
        for s in strokes
    ]
    tilt = SUSPENSION.lifts_mm(Pose(roll, pitch, 0.0))
    # A plane of lifts t_i + ride within every [low_i, high_i] exists only if max(low - t) <= min(high - t).
    lowest = max(low - t for (low, _), t in zip(corners, tilt, strict=True))
    highest = min(high - t for (_, high), t in zip(corners, tilt, strict=True))
    assert lowest > highest


def test_what_is_out_of_reach_takes_for_ever() -> None:
    assert rate_bound_s(SUSPENSION, MID, math.radians(7.0), 0.0) == math.inf


def test_no_turn_takes_no_time() -> None:
    assert rate_bound_s(SUSPENSION, MID, 0.0, 0.0) == pytest.approx(0.0, abs=1e-5)
