"""One corner against its closed forms (Table 5.1 quarter: 302.5 kg, 50 kg, 20 kN/m, 3 kNs/m, 220 kN/m)."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.models.linear import modes
from tiger.models.quarter_car import QuarterCarParameters, quarter_car

CORNER = QuarterCarParameters.from_config(load_vehicle("table-5-1"))


def test_corner_of_table_5_1_carries_a_quarter_of_the_body() -> None:
    expected = QuarterCarParameters(302.5, 50.0, 20000.0, 3000.0, 220000.0)
    assert expected == CORNER


def test_modes() -> None:
    expected = np.array([[1.320, 0.562], [10.354, 0.466]])
    assert modes(quarter_car(CORNER).poles()) == pytest.approx(expected, rel=1e-3)


def test_ten_centimetre_step() -> None:
    step = np.zeros((30000, 4))
    step[:, 1] = 0.1
    y, _ = quarter_car(CORNER).discretise(1e-4).simulate(step)
    accel, body, wheel = y[:, 0], y[:, 1], y[:, 2]
    assert body.max() == pytest.approx(0.1307, rel=1e-3)
    assert body.argmax() * 1e-4 == pytest.approx(0.284, abs=1e-3)
    assert accel.max() == pytest.approx(36.47, rel=1e-3)
    assert wheel.max() == pytest.approx(0.1256, rel=1e-3)


def test_a_push_of_100_n_raises_the_body_by_the_spring_alone() -> None:
    gain = quarter_car(CORNER).static_gain()
    assert gain[1, 0] * 100 == pytest.approx(0.005)
    assert gain[2, 0] == pytest.approx(0, abs=1e-15)


def test_a_stroke_in_series_raises_the_body_by_itself() -> None:
    assert quarter_car(CORNER).static_gain()[1, 2] == pytest.approx(1.0)


def test_axle_must_be_front_or_rear() -> None:
    with pytest.raises(ValueError, match="front or rear"):
        QuarterCarParameters.from_config(load_vehicle("table-5-1"), "middle")
