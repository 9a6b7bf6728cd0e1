"""A potentiometer that is not straight: the stored readings at the quarters of the stroke undo its bow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from tiger.protocol.messages import PARAMS, AckStatus, BoardKind, ParamSet

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import SuspensionRig

INDEX = {parameter.name: parameter.index for parameter in PARAMS[BoardKind.MEGA_SUSPENSION]}
QUARTERS = ("pot_quarter_counts", "pot_half_counts", "pot_three_quarters_counts")
BOW_SUMS = 900.0  # greatest deviation from the straight line, of 14 732 between the ends


def bow_sums(stroke_mm: float) -> float:
    """What the wiper reads above the straight line, in sums of 16 conversions."""
    return BOW_SUMS * math.sin(math.pi * stroke_mm / 70.0)


def bowed_rig(make_rig: Callable[..., SuspensionRig], stroke_mm: float) -> SuspensionRig:
    """A booted board whose four actuators stand at a stroke and whose potentiometers are bowed."""
    rig = make_rig(read_pot=lambda _, counts: counts + bow_sums(stroke_mm) / 16.0)
    for actuator in rig.actuators:
        actuator.motor_mm = actuator.stroke_mm = stroke_mm
    rig.boot()
    return rig


def set_bow(rig: SuspensionRig, scale: float = 1.0) -> None:
    for quarter, name in enumerate(QUARTERS, start=1):
        for corner in range(4):
            value = round(scale * bow_sums(17.5 * quarter))
            assert rig.request(ParamSet(0, INDEX[name] + corner, value)).status == AckStatus.OK
    rig.run_ms(400)


@pytest.mark.parametrize("stroke_mm", [0.0, 17.5, 35.0, 52.5, 70.0])
def test_bow_is_undone_exactly_at_the_calibrated_strokes(
    make_rig: Callable[..., SuspensionRig], stroke_mm: float
) -> None:
    rig = bowed_rig(make_rig, stroke_mm)
    set_bow(rig)
    assert rig.state.stroke_mm == pytest.approx((stroke_mm,) * 4, abs=0.1)


@pytest.mark.parametrize("stroke_mm", [8.0, 26.0, 44.0, 62.0])
def test_between_them_less_than_a_tenth_of_the_bow_remains(
    make_rig: Callable[..., SuspensionRig], stroke_mm: float
) -> None:
    rig = bowed_rig(make_rig, stroke_mm)
    bow_mm = bow_sums(stroke_mm) * 70.0 / 14732.0
    assert rig.state.stroke_mm[0] == pytest.approx(stroke_mm + bow_mm, abs=0.1)  # before
    set_bow(rig)
    assert rig.state.stroke_mm == pytest.approx((stroke_mm,) * 4, abs=0.1 * BOW_SUMS * 70.0 / 14732.0 + 0.05)


def test_a_curve_that_turns_back_is_refused_and_the_board_cannot_be_armed(
    make_rig: Callable[..., SuspensionRig],
) -> None:
    rig = bowed_rig(make_rig, 35.0)
    half, quarter = INDEX["pot_half_counts"], INDEX["pot_quarter_counts"]
    assert rig.request(ParamSet(0, quarter, 3000)).status == AckStatus.OK
    assert rig.request(ParamSet(0, half, -3000)).status == AckStatus.OK
    rig.run_ms(400)
    with pytest.raises(AssertionError, match="NOT_READY"):
        rig.arm()
