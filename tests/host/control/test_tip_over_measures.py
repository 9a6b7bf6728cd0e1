"""Margin, load transfer and time to the balance point of a box on four wheels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tiger.control import tip_over
from tiger.control.tip_over import LEFT, Stance
from tiger.devices.imu import specific_force_mps2
from tiger.models.full_car import GRAVITY_MPS2 as G
from tiger.record import ImuSample

RIGID = Stance(height_m=0.5, reach_m=(0.6, 0.6, 0.5, 0.5))
STILL = (0.0, 0.0)


def margin(stance: Stance, force: tuple[float, float, float], edge: int) -> float:
    """Energy left to an edge, over the least at rest."""
    reach, depth = tip_over.contacts(stance, STILL)[edge]
    push = (-force[1], force[1], -force[0], force[0])[edge]
    _, energy = tip_over.force_angle(reach, depth, push, 0.0, force[2])
    return energy / stance.least_energy


def leaning(angle: float) -> tuple[float, float, float]:
    """Reaction to gravity on a side slope, left side up."""
    return 0.0, G * math.sin(angle), G * math.cos(angle)


def test_the_gravity_comes_back_into_the_specific_force() -> None:
    half, none = math.radians(10.0) / 2.0, (0.0, 0.0, 0.0)
    nose_down = ImuSample(0.0, (math.cos(half), 0.0, math.sin(half), 0.0), none, none, none, 0)
    force = specific_force_mps2(nose_down)
    assert force == pytest.approx((-G * math.sin(2.0 * half), 0.0, G * math.cos(2.0 * half)))


def test_at_rest_on_level_ground_the_margin_is_one() -> None:
    margins = [margin(RIGID, (0.0, 0.0, G), edge) for edge in range(4)]
    assert min(margins) == pytest.approx(1.0)
    assert min(range(4), key=margins.__getitem__) in (2, 3)  # the wheelbase is shorter than the track


def test_energy_is_the_height_that_the_com_must_rise() -> None:
    """Messuri and Klein: m g times how much higher the COM is above the edge."""
    for angle in (0.0, 0.2, 0.5):
        reach, depth = 0.6, 0.5
        now = depth * math.cos(angle) + reach * math.sin(angle)
        left = G * (math.hypot(reach, depth) - now)
        _, energy = tip_over.force_angle(reach, depth, G * math.sin(angle), 0.0, G * math.cos(angle))
        assert energy == pytest.approx(left)


@given(st.floats(0.0, 1.4))
def test_the_margin_is_gone_when_the_com_stands_over_the_edge(angle: float) -> None:
    critical = math.atan2(0.6, 0.5)
    value = margin(RIGID, leaning(angle), 1)
    assert (value > 0.0) == (angle < critical) or abs(angle - critical) < 1e-9


def test_a_moment_that_holds_the_weight_s_own_about_the_edge_leaves_nothing() -> None:
    """Papadopoulos and Rey: f* = f + (l x n)/l2, so that the angle is gone where the moments balance."""
    reach, depth = 0.6, 0.5
    none, energy = tip_over.force_angle(reach, depth, 0.0, G * reach, G)
    assert none == pytest.approx(0.0)
    assert energy == pytest.approx(0.0)
    some, _ = tip_over.force_angle(reach, depth, 0.0, 0.5 * G * reach, G)
    assert 0.0 < some < tip_over.force_angle(reach, depth, 0.0, 0.0, G)[0]


@pytest.mark.parametrize(("axis", "sign"), [(1, -1.0), (0, -1.0)])
@pytest.mark.parametrize("push", [-3.0, 0.0, 2.0])
def test_load_transfer_of_a_rigid_robot_is_h_f_over_g_w(axis: int, sign: float, push: float) -> None:
    force = (push, 0.0, G) if axis == 0 else (0.0, push, G)
    half = (0.5, 0.6)[axis]
    transfers = tip_over.load_transfer(RIGID, tip_over.contacts(RIGID, STILL), force, STILL)
    assert transfers[1 - axis] == pytest.approx(sign * 0.5 * push / G / half)
    assert transfers[axis] == pytest.approx(0.0)


def test_wheels_that_are_sped_up_and_rolling_resistance_load_the_rear() -> None:
    """Their moments are the ground's: I omega' of the wheels, and a load ahead of each hub."""
    places = tip_over.contacts(RIGID, STILL)
    none = tip_over.load_transfer(RIGID, places, (2.0, 0.0, G), STILL)[1]
    moment = 0.3
    assert tip_over.load_transfer(RIGID, places, (2.0, 0.0, G), (0.0, moment))[1] == pytest.approx(
        none - moment / (0.5 * G)
    )


def test_loads_follow_a_com_off_the_middle_and_end_at_one_side() -> None:
    off = replace(RIGID, reach_m=(0.5, 0.7, 0.5, 0.5))  # 0.1 m to the left of 0.6
    lateral, _ = tip_over.load_transfer(off, tip_over.contacts(off, STILL), (0.0, 0.0, G), STILL)
    assert lateral == pytest.approx(0.1 / 0.6)
    flat, _ = tip_over.load_transfer(off, tip_over.contacts(off, STILL), (0.0, -30.0, G), STILL)
    assert flat == 1.0


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_contacts_lie_on_one_plane_that_the_body_leans_on(roll: float, pitch: float) -> None:
    stance = replace(RIGID, wheel_radius_m=0.16)
    (left, below_left), (right, below_right), (front, below_front), (rear, below_rear) = tip_over.contacts(
        stance, (roll, pitch)
    )
    # Seen in the body, ground under a body with its left side up falls away to the left.
    assert (below_left - below_right) / (left + right) == pytest.approx(math.tan(roll), rel=1e-6, abs=1e-9)
    assert (below_rear - below_front) / (front + rear) == pytest.approx(math.tan(pitch), rel=1e-6, abs=1e-9)


def test_an_imu_high_above_the_com_is_brought_down_to_it() -> None:
    high = replace(RIGID, imu_m=(0.0, 0.0, 0.4))
    alpha = 2.0  # left side up: the top moves to the right
    felt = tip_over.at_com(high, (0.0, -0.4 * alpha, G), (0.0, 0.0, 0.0), (alpha, 0.0, 0.0))
    assert felt == pytest.approx((0.0, 0.0, G))
    spinning = tip_over.at_com(
        replace(RIGID, imu_m=(0.3, 0.0, 0.0)), (-0.3 * 4.0, 0.0, G), (0, 0, 2.0), (0,) * 3
    )
    assert spinning == pytest.approx((0.0, 0.0, G))


_VECTOR = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


@settings(deadline=None)
@given(place=_VECTOR, force=_VECTOR, rate=_VECTOR, turn=_VECTOR)
def test_a_force_is_brought_to_the_com_as_a_rigid_body_carries_it(place, force, rate, turn) -> None:
    felt = tip_over.at_com(replace(RIGID, imu_m=place), force, rate, turn)
    expected = np.array(force) - np.cross(turn, place) - np.cross(rate, np.cross(rate, place))
    assert felt == pytest.approx(expected.tolist(), abs=1e-9)


@pytest.mark.parametrize(
    ("upright", "push", "rate"),
    [(0.8, 0.0, 5.0), (0.5, 0.6, 0.0), (0.5, 0.5, 0.4), (0.3, 0.1, 2.0), (0.9, 1.2, -0.3)],
)
def test_time_to_the_balance_point_is_that_of_the_pendulum(upright: float, push: float, rate: float) -> None:
    lever, gyration = 0.7, 0.2
    speed2 = G * lever / (lever**2 + gyration)
    found = tip_over.time_to_balance(lever, gyration, upright, upright - push, rate)

    def over(_: float, state: np.ndarray) -> float:
        return float(state[0])

    over.terminal = True  # type: ignore[attr-defined]
    swing = solve_ivp(
        lambda _, s: [s[1], speed2 * (s[0] - push)],
        (0.0, 20.0),
        [upright, -rate],
        events=over,
        rtol=1e-9,
        atol=1e-12,
    )
    assert found == pytest.approx(float(swing.t_events[0][0]), rel=1e-5)


def test_a_robot_that_falls_back_never_gets_there() -> None:
    assert tip_over.time_to_balance(0.7, 0.2, 0.8, 0.8, 0.5) == math.inf
    assert tip_over.time_to_balance(0.7, 0.2, 0.8, 0.8, -1.0) == math.inf
    assert tip_over.time_to_balance(0.7, 0.2, -0.1, 0.0, 0.0) == 0.0


def test_springs_lean_outward_in_a_turn_and_nose_down_when_braking() -> None:
    soft = replace(RIGID, roll_sway_s2pm=0.02, pitch_sway_s2pm=0.03)
    roll, pitch = tip_over.spring_lean(soft, (-2.0, 3.0, G), STILL)
    assert roll == pytest.approx(0.06)  # turning left: left side up
    assert pitch == pytest.approx(0.06)  # braking: nose down
    falling = 3.0 * RIGID.height_m  # what turns the body is not carried by the springs
    heavy = replace(soft, roll_gyration_m2=1.0, pitch_gyration_m2=1.0)
    assert tip_over.spring_lean(heavy, (0.0, 3.0, G), (falling, 0.0)) == pytest.approx((0.0, 0.0))
    assert tip_over.spring_lean(heavy, (-3.0, 0.0, G), (0.0, falling)) == pytest.approx((0.0, 0.0))
    most, _ = tip_over.spring_lean(soft, (0.0, 50.0, G), STILL)
    assert most == pytest.approx(0.02 * 0.6 * G / 0.5)  # all weight on one side
    assert LEFT == 0


def test_a_robot_that_fades_towards_its_balance_gets_there_only_if_that_lies_beyond_the_edge() -> None:
    """At the rate at which nothing grows any more: psi = psi_a + (psi - psi_a) exp(-w t)."""
    lever, gyration, upright = 0.7, 0.2, 0.5
    speed = math.sqrt(G * lever / (lever**2 + gyration))
    beyond, before = 2.0 * upright, 0.5 * upright
    time_s = tip_over.time_to_balance(lever, gyration, upright, beyond, beyond * speed)
    assert time_s == pytest.approx(math.log(2.0) / speed)
    assert tip_over.time_to_balance(lever, gyration, upright, before, before * speed) == math.inf
