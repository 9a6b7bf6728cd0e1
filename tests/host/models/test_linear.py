"""Sampling, naming and simulating linear models."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.models.full_car import BODY_ACCELERATION, FORCE, ROAD, FullCarParameters, full_car
from tiger.models.linear import LinearModel

MODEL = full_car(FullCarParameters.from_config(load_vehicle("table-6-1"))).select(
    inputs=(*ROAD, *FORCE), outputs=BODY_ACCELERATION
)


def test_select_keeps_the_order_asked_for() -> None:
    swapped = MODEL.select(inputs=[FORCE[1], ROAD[0]], outputs=BODY_ACCELERATION[::-1])
    assert swapped.d[0, 0] == MODEL.d[2, 5]


def test_select_names_what_it_does_not_know() -> None:
    with pytest.raises(KeyError, match="no output altitude_m"):
        MODEL.select(outputs=["altitude_m"])


def test_matrix_that_contradicts_its_names_is_refused() -> None:
    with pytest.raises(ValueError, match="matrix b"):
        LinearModel(np.eye(1), np.ones((1, 2)), np.eye(1), np.zeros((1, 1)), ("x",), ("u",), ("y",))


@pytest.mark.parametrize(("method", "order"), [("zoh", 1), ("foh", 2), ("tustin", 2)])
def test_sampled_response_converges_to_the_continuous_one_at_its_order(method: str, order: int) -> None:
    frequency = np.array([2.0])
    exact = MODEL.frequency_response(frequency)
    errors = []
    for period in (0.004, 0.002):
        errors.append(np.abs(MODEL.discretise(period, method).frequency_response(frequency) - exact).max())
    assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.1)


@pytest.mark.parametrize("method", ["zoh", "foh", "tustin"])
def test_sampling_keeps_the_static_gain(method: str) -> None:
    sampled = MODEL.discretise(0.005, method)
    assert sampled.static_gain() == pytest.approx(MODEL.static_gain(), abs=1e-6)


def test_straight_inputs_are_followed_exactly_by_first_order_hold() -> None:
    coarse, fine = MODEL.discretise(0.01, "foh"), MODEL.discretise(0.0005, "foh")
    ramp = np.linspace(0, 1, 401)[:, None] * np.r_[0.1, 0.02, -0.05, 0.0, 50.0, 0, 0, 20.0]
    every_20th, _ = coarse.simulate(ramp[::20])
    assert every_20th == pytest.approx(fine.simulate(ramp)[0][::20], abs=1e-9)


def test_period_must_be_positive_and_a_model_is_sampled_once() -> None:
    with pytest.raises(ValueError, match="positive"):
        MODEL.discretise(0.0)
    with pytest.raises(ValueError, match="already sampled"):
        MODEL.discretise(0.01).discretise(0.01)
    with pytest.raises(ValueError, match="zoh, foh or tustin"):
        MODEL.discretise(0.01, "euler")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="before simulating"):
        MODEL.simulate(np.zeros((1, 8)))
