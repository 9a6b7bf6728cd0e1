"""One track for all who ask: the vehicle's at half stroke, the mechanism's change beside it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.config.vehicle import load_vehicle
from tiger.control.drive import design_drive
from tiger.control.stability import design_stability
from tiger.estimation.odometry import design_odometry
from tiger.models.eam import Eam, MechanismError
from tiger.models.track import half_tracks_m, track_of

TIGER = load_vehicle("tiger")
TRACK = track_of(TIGER)


def test_at_half_stroke_the_track_is_the_vehicles() -> None:
    assert TRACK.half_at(35.0) == pytest.approx(TIGER.body.half_track_m, abs=1e-12)


@given(st.floats(0.0, 70.0), st.floats(0.0, 70.0))
def test_between_two_strokes_it_changes_as_the_mechanism_does(one: float, other: float) -> None:
    low, high = Eam.from_vehicle(TIGER).pose([one, other]).track_mm
    change = TRACK.half_at(one) - TRACK.half_at(other)
    assert change == pytest.approx((low - high) / 2000.0, abs=1e-4)


def test_beyond_the_stroke_it_stays_as_at_the_end() -> None:
    assert (TRACK.half_at(-3.0), TRACK.half_at(90.0)) == (TRACK.half_at(0.0), TRACK.half_at(70.0))


def test_each_wheel_has_its_own() -> None:
    strokes = (0.0, 20.0, 40.0, 70.0)
    np.testing.assert_array_equal(half_tracks_m(TRACK, strokes), [TRACK.half_at(mm) for mm in strokes])


def test_all_who_ask_share_one() -> None:
    robot = load_robot()
    designs = design_drive(robot), design_odometry(robot), design_stability(robot)
    assert {id(design.track) for design in designs} == {id(track_of(robot.vehicle))}


def test_a_car_has_no_strokes_that_could_change_it() -> None:
    with pytest.raises(MechanismError, match="no strokes"):
        track_of(load_vehicle("table-5-1"))
