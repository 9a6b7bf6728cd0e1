"""Wheels that slip are told from wheels that scrub, in time, and not believed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.estimation import slip
from tiger.estimation.slip import SlipState, Wheels
from tiger.record import Four

CONFIG = load_robot(None).odometry
TRACK: Four = (0.6, 0.6, 0.6, 0.6)
DT = 0.02
ALL = (True, True, True, True)


def rolling(speed: float, yaw_rate: float = 0.0, scrub: float = 1.0, ratio: Four = (0.0,) * 4) -> Four:
    """Surface speeds of wheels that scrub in a turn and slip by a ratio on top."""
    a, b, c, d = (
        (speed - side * scrub * 0.6 * yaw_rate) * (1.0 + extra)
        for side, extra in zip((1, -1, 1, -1), ratio, strict=True)
    )
    return a, b, c, d


def follow(speed: float, surface: Four, seconds: float, state: SlipState | None = None) -> SlipState:
    state = state or SlipState()
    for _ in range(round(seconds / DT)):
        wheels = slip.told(surface, TRACK, 0.0, 0.0, 1.0)
        state = slip.step(CONFIG, state, wheels, ALL, speed, 0.01, 0.0, DT)
    return state


@given(
    st.floats(-2.0, 2.0),
    st.floats(-0.6, 0.6),
    st.floats(1.0, 2.0),
    st.lists(st.booleans(), min_size=4, max_size=4).filter(any),
)
def test_any_wheels_that_hold_tell_the_speed_of_the_body(
    speed: float, yaw_rate: float, scrub: float, good: list[bool]
) -> None:
    wheels = slip.told(rolling(speed, yaw_rate, scrub), TRACK, 0.0, yaw_rate, scrub)
    fl, fr, rl, rr = good
    told, both = slip.mean_of(wheels.told_mps, (fl, fr, rl, rr))
    assert told == pytest.approx(speed, abs=1e-9)
    assert both == ((fl or rl) and (fr or rr))


@given(st.floats(-2.0, 2.0), st.floats(-0.6, 0.6), st.floats(1.0, 2.0), st.floats(1.0, 2.0))
def test_the_mean_of_both_sides_needs_no_scrub(
    speed: float, yaw_rate: float, scrub: float, believed: float
) -> None:
    wheels = slip.told(rolling(speed, yaw_rate, scrub), TRACK, 0.0, yaw_rate, believed)
    assert slip.mean_of(wheels.told_mps, ALL)[0] == pytest.approx(speed, abs=1e-9)


@pytest.mark.parametrize("speed", [0.6, 1.0, 2.0, -1.0])
def test_a_wheel_is_trusted_until_it_is_too_far_off(speed: float) -> None:
    def good(ratio: float, sigma: float = 0.01) -> bool:
        wheels = slip.told(rolling(speed, ratio=(ratio, 0.0, ratio, 0.0)), TRACK, 0.0, 0.0, 1.0)
        fl, fr, rl, rr = slip.trusted(CONFIG, SlipState(), wheels, speed, sigma, 0.0)
        assert fr
        assert rr
        assert fl == rl
        return fl

    assert good(0.02)
    assert not good(0.15)
    assert not good(-0.15)
    assert good(0.15, sigma=2.0)  # after a minute without wheels nothing better is known


def test_of_two_wheels_of_a_side_that_disagree_the_one_further_off_slips() -> None:
    """Even where a bend excuses either of them: scrub is common to both."""
    wheels = slip.told(rolling(1.0, 0.4, 1.5, ratio=(0.0, 0.0, 0.0, 0.1)), TRACK, 0.0, 0.4, 1.5)
    assert slip.trusted(CONFIG, SlipState(), wheels, 1.0, 0.01, 0.4) == (True, True, True, False)


def test_a_wheel_that_slipped_must_come_closer_to_be_believed() -> None:
    wheels = slip.told(rolling(1.0, ratio=(0.06, 0.06, 0.06, 0.06)), TRACK, 0.0, 0.0, 1.0)
    state = SlipState(slipping=(True, False, False, False))
    assert slip.trusted(CONFIG, state, wheels, 1.0, 0.01, 0.0) == (False, True, True, True)


def test_a_turn_is_no_slip_of_the_sides_that_scrub() -> None:
    wheels = slip.told(rolling(1.0, 0.4, 1.8), TRACK, 0.0, 0.4, 1.5)
    assert slip.trusted(CONFIG, SlipState(), wheels, 1.0, 0.01, 0.4) == ALL


@pytest.mark.parametrize("ratio", [0.1, 0.15, 0.5, -0.15, -0.9])
def test_slip_is_flagged_within_150_ms_and_over_when_it_is(ratio: float) -> None:
    surface = rolling(1.0, ratio=(0.0, ratio, 0.0, 0.0))
    assert follow(1.0, surface, 0.02).slipping == slip.NONE  # one sample proves nothing
    state = follow(1.0, surface, 0.12)
    assert state.slipping == (False, True, False, False)
    assert state.ratio == pytest.approx((0.0, ratio, 0.0, 0.0))
    assert follow(1.0, rolling(1.0), 0.06, state).slipping == (False, True, False, False)
    assert follow(1.0, rolling(1.0), 0.2, state).slipping == slip.NONE


def test_a_ratio_between_the_thresholds_changes_nothing() -> None:
    surface = rolling(1.0, ratio=(0.065,) * 4)
    assert follow(1.0, surface, 2.0).slipping == slip.NONE
    flagged = follow(1.0, rolling(1.0, ratio=(0.15,) * 4), 0.2)
    assert follow(1.0, surface, 2.0, flagged).slipping == ALL


def test_an_uncertain_speed_flags_no_small_slip() -> None:
    wheels = slip.told(rolling(1.0, ratio=(0.15,) * 4), TRACK, 0.0, 0.0, 1.0)
    state = SlipState()
    for _ in range(20):
        state = slip.step(CONFIG, state, wheels, ALL, 1.0, 0.1, 0.0, DT)
    assert state.slipping == slip.NONE


def test_a_spinning_wheel_of_a_standing_robot_slips() -> None:
    state = follow(0.0, (1.0, 0.0, 0.0, 0.0), 0.2)
    assert state.slipping == (True, False, False, False)
    assert state.ratio[0] == pytest.approx(1.0 / CONFIG.least_speed_mps)


def test_each_wheel_is_judged_by_the_track_that_its_stroke_gives() -> None:
    wheels = Wheels((1.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0), (0.56, 0.6, 0.62, 0.635))
    state = slip.step(CONFIG, SlipState(), wheels, ALL, 1.0, 0.01, 0.5, DT)
    assert state.ratio == pytest.approx((0.28 / 0.72, -0.3 / 1.3, 0.31 / 0.69, -0.3175 / 1.3175))


@pytest.mark.parametrize("scrub", [1.2, 1.8])
def test_the_scrub_is_learned_from_turns(scrub: float) -> None:
    state = SlipState(scrub=1.5)
    for step in range(2000):
        yaw_rate = 0.3 if step % 400 < 200 else -0.3
        wheels = slip.told(rolling(1.0, yaw_rate, scrub), TRACK, 0.0, yaw_rate, state.scrub)
        state = slip.step(CONFIG, state, wheels, ALL, 1.0, 0.01, yaw_rate, DT)
    assert state.scrub == pytest.approx(scrub, abs=0.05)


def test_wheels_that_slip_teach_no_scrub() -> None:
    wheels = slip.told(rolling(1.0, 0.3, 2.5), TRACK, 0.0, 0.3, 1.5)
    state = SlipState(scrub=1.5)
    for _ in range(500):
        state = slip.step(CONFIG, state, wheels, (False, True, True, True), 1.0, 0.01, 0.3, DT)
    assert state.scrub == 1.5


def test_wheels_that_parted_and_agree_again_hold() -> None:
    """Whatever inertia has come to think of the speed meanwhile."""
    apart, together = rolling(1.0, ratio=(0.0, 0.0, 0.3, -0.3)), rolling(1.0)
    state = follow(0.8, apart, 1.0)
    assert state.parted
    wheels = slip.told(together, TRACK, 0.0, 0.0, 1.0)
    assert slip.trusted(CONFIG, state, wheels, 0.8, 0.01, 0.0) == slip.NONE
    state = follow(0.8, together, CONFIG.agree_s + 2 * DT, state)
    assert slip.trusted(CONFIG, state, wheels, 0.8, 0.01, 0.0) == ALL
    assert slip.plausible(CONFIG, state, 1.0, 0.8, 0.01, 0.0)
    assert not follow(1.0, together, DT, state).parted


def test_wheels_that_slip_alike_from_the_start_are_not_believed_for_their_number() -> None:
    surface = rolling(1.0, ratio=(0.15,) * 4)
    state = follow(1.0, surface, 2.0, follow(1.0, rolling(1.0), 1.0))
    assert not state.parted
    wheels = slip.told(surface, TRACK, 0.0, 0.0, 1.0)
    assert slip.trusted(CONFIG, state, wheels, 1.0, 0.01, 0.0) == slip.NONE


@pytest.mark.parametrize(("scrub", "believed"), [(1.0, True), (1.9, True), (0.6, False), (2.6, False)])
def test_an_axle_that_scrubs_its_own_way_in_a_turn_is_believed(scrub: float, believed: bool) -> None:
    """Rear wheels that slide about in a bend, one ahead and one back, still tell the speed together."""
    front, rear = rolling(1.0, 0.5, 1.4), rolling(1.0, 0.5, scrub)
    wheels = slip.told((front[0], front[1], rear[2], rear[3]), TRACK, 0.0, 0.5, 1.4)
    assert slip.trusted(CONFIG, SlipState(slipping=(False, False, True, True)), wheels, 1.0, 0.01, 0.5) == (
        *(True, True),
        *(believed, believed),
    )


@settings(deadline=None)
@given(
    surface=st.tuples(*[st.floats(-2.0, 2.0)] * 4),
    speed=st.floats(-2.0, 2.0),
    yaw_rate=st.floats(-0.6, 0.6),
    parted=st.booleans(),
)
def test_backwards_it_judges_as_forwards(surface: Four, speed: float, yaw_rate: float, parted: bool) -> None:
    def judged(sign: float) -> SlipState:
        state = SlipState(parted=parted)
        a, b, c, d = (sign * each for each in surface)
        for _ in range(10):
            wheels = slip.told((a, b, c, d), TRACK, 0.0, sign * yaw_rate, state.scrub)
            state = slip.step(CONFIG, state, wheels, ALL, sign * speed, 0.01, sign * yaw_rate, DT)
        return state

    ahead, back = judged(1.0), judged(-1.0)
    assert (ahead.slipping, ahead.parted) == (back.slipping, back.parted)
    assert ahead.scrub == pytest.approx(back.scrub)
    assert ahead.ratio == pytest.approx([-ratio for ratio in back.ratio])


@settings(deadline=None, max_examples=50)
@given(st.floats(0.0, 3.0), st.floats(0.0, 0.6), st.floats(0.01, 1.0))
def test_the_faster_it_drives_or_turns_the_farther_off_a_mean_is_still_plausible(
    speed: float, yaw_rate: float, more: float
) -> None:
    def farthest(speed: float, yaw_rate: float) -> float:
        off = np.arange(0.0, 1.0, 1e-3)
        return max(x for x in off if slip.plausible(CONFIG, SlipState(), speed + x, speed, 0.01, yaw_rate))

    here = farthest(speed, yaw_rate)
    for faster in ((speed + more, yaw_rate), (speed, yaw_rate + more)):
        assert farthest(*faster) >= here
    assert farthest(-speed, -yaw_rate) == pytest.approx(here, abs=2e-3)
