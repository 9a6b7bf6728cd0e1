"""The phases of mode `balance`, row by row."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control import balance
from tiger.control.balance import BalanceState, Phase, Situation
from tiger.estimation.contact import Contact

CONFIG = load_robot().balance
MOST_MM = 66.0
TOUCHING = Contact(sigma_mm=5.0)
FL_HANGS = Contact(hanging=(0.97, 0.0, 0.0, 0.0), lifted=0.97)
FR_HANGS = Contact(hanging=(0.0, 0.95, 0.02, 0.0), lifted=-0.97)


def at(warp_mm: float, contact: Contact = TOUCHING, ground_mm: float = 0.0) -> Situation:
    return Situation(replace(contact, ground_warp_mm=ground_mm), warp_mm, MOST_MM)


def been(
    phase: Phase, wanted_mm: float = 0.0, lowest_mm: float = 0.0, highest_mm: float = 0.0
) -> BalanceState:
    return BalanceState(int(phase), wanted_mm, lowest_mm, highest_mm)


def test_it_begins_by_probing_upwards() -> None:
    state = balance.step(CONFIG, BalanceState(), at(0.0))
    assert state.phase == Phase.PROBE
    assert state.wanted_mm == pytest.approx(CONFIG.probe_mm)


def test_having_been_up_it_probes_downwards_and_is_done_after_both() -> None:
    up = balance.step(CONFIG, been(Phase.PROBE, highest_mm=CONFIG.probe_mm), at(CONFIG.probe_mm))
    assert up.wanted_mm == pytest.approx(-CONFIG.probe_mm)
    done = balance.step(CONFIG, replace(up, lowest_mm=-CONFIG.probe_mm), at(-CONFIG.probe_mm))
    assert done.phase == Phase.CENTRE


def test_from_far_off_the_way_to_the_middle_is_the_probe() -> None:
    state = balance.step(CONFIG, BalanceState(), at(-60.0))
    assert (state.phase, state.wanted_mm) == (Phase.PROBE, 0.0)
    state = balance.step(CONFIG, state, at(-60.0 + 1.9 * CONFIG.probe_mm))
    assert (state.phase, state.wanted_mm) == (Phase.CENTRE, 0.0)


@pytest.mark.parametrize("phase", [Phase.PROBE, Phase.CENTRE, Phase.HOLD])
@pytest.mark.parametrize(("contact", "way"), [(FL_HANGS, 1.0), (FR_HANGS, -1.0)])
def test_a_hanging_wheel_is_twisted_down_from_any_phase(phase: Phase, contact: Contact, way: float) -> None:
    state = balance.step(CONFIG, been(phase), at(0.0, contact))
    assert (state.phase, state.wanted_mm) == (Phase.SEARCH, way * MOST_MM)


def test_a_wheel_that_touches_ends_the_search() -> None:
    state = balance.step(CONFIG, been(Phase.SEARCH, MOST_MM), at(-50.0, ground_mm=-60.0))
    assert (state.phase, state.wanted_mm) == (Phase.CENTRE, pytest.approx(60.0))


def test_a_doubtful_wheel_neither_begins_nor_ends_a_search() -> None:
    doubt = Contact(hanging=(0.5, 0.0, 0.0, 0.0), lifted=0.5)
    assert balance.step(CONFIG, been(Phase.SEARCH), at(0.0, doubt)).phase == Phase.SEARCH
    assert balance.step(CONFIG, been(Phase.HOLD), at(0.0, doubt)).phase == Phase.HOLD


def test_it_holds_once_arrived_and_wakes_when_the_ground_has_changed_enough() -> None:
    held = balance.step(CONFIG, been(Phase.CENTRE), at(-20.0 + 0.9 * CONFIG.settle_mm, ground_mm=20.0))
    assert held.phase == Phase.HOLD
    held = replace(held, wanted_mm=-20.0)
    assert balance.step(CONFIG, held, at(-20.0, ground_mm=20.0 + 0.9 * CONFIG.wake_mm)).phase == Phase.HOLD
    woken = balance.step(CONFIG, held, at(-20.0, ground_mm=20.0 + 1.1 * CONFIG.wake_mm))
    assert woken.phase == Phase.CENTRE


@given(
    phase=st.sampled_from(Phase),
    warp_mm=st.floats(-80.0, 80.0),
    ground_mm=st.floats(-160.0, 160.0),
    hanging=st.tuples(*[st.floats(0.0, 0.25)] * 4),
)
def test_no_more_twist_is_wanted_than_the_strokes_have(phase, warp_mm, ground_mm, hanging) -> None:
    now = at(warp_mm, Contact(hanging=hanging), ground_mm)
    assert abs(balance.step(CONFIG, been(phase), now).wanted_mm) <= MOST_MM


def test_it_says_what_it_does_and_what_hangs() -> None:
    assert balance.reason(been(Phase.HOLD), TOUCHING) == "balanced"
    assert balance.reason(been(Phase.SEARCH), FL_HANGS) == "lowering a wheel, FL in the air"
