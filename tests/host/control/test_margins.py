"""Margins: a margin must be where the loop really breaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tiger.control import ride_designs
from tiger.control.margins import closed_loop, is_stable, margins
from tiger.control.ride import PERIOD_S, ImuNoise
from tiger.studies import ride_cases

CAR = ride_cases.load_case("table-6-1").car
ROBUST = ride_designs.ROBUST.controller(CAR, ImuNoise(), delay_samples=1)
FRAGILE = ride_designs.BUMPY_PREVIEW.controller(CAR, ImuNoise().scaled(0.1), 0.102)


@pytest.mark.parametrize("controller", [ROBUST, FRAGILE], ids=["robust", "bumpy"])
def test_delay_margin_is_where_the_loop_turns_unstable(controller) -> None:  # type: ignore[no-untyped-def]
    own = margins(CAR, controller)
    designed = controller.delay_samples * PERIOD_S
    assert is_stable(CAR, controller, designed + 0.95 * own.delay_margin_s)
    assert not is_stable(CAR, controller, designed + own.delay_margin_s + 5e-5)


def test_gain_inside_the_guaranteed_margin_keeps_the_loop_stable() -> None:
    own = margins(CAR, ROBUST)
    factor = 10 ** (0.98 * own.gain_margin_db / 20)
    loop = closed_loop(CAR, ROBUST, PERIOD_S)
    # push = (factor - 1) x the force that acts, of one actuator: a gain error behind the controller's back.
    state = loop.states.index("force_fl_1_ago_n")
    changed = loop.a.copy()
    changed[:, state] += (factor - 1) * loop.b[:, loop.inputs.index("push_fl_n")]
    assert np.abs(np.linalg.eigvals(changed)).max() < 1


def test_robust_design_has_more_margin_than_the_one_for_the_table() -> None:
    robust, fragile = margins(CAR, ROBUST), margins(CAR, FRAGILE)
    assert robust.disk_margin > fragile.disk_margin
    assert robust.delay_margin_s > 0.005
    assert robust.multiloop_disk_margin <= robust.disk_margin + 1e-9


def test_unstable_loop_has_no_margins() -> None:
    inverted = replace(ROBUST, feedback=-20 * ROBUST.feedback)
    with pytest.raises(ValueError, match="unstable as designed"):
        margins(CAR, inverted)
