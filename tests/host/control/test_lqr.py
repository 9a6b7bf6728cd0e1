"""The discrete regulator against the `control` package and against the cost it promises to minimise."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.control.lqr import dlqr, output_weights, sampled_cost
from tiger.models.full_car import BODY_ACCELERATION, FORCE, SUSPENSION, TIRE, FullCarParameters, full_car

CAR = full_car(FullCarParameters.from_config(load_vehicle("table-6-1"))).select(
    inputs=FORCE, outputs=(*BODY_ACCELERATION, *SUSPENSION, *TIRE)
)
SAMPLED = CAR.discretise(0.005)
OUTPUT = np.r_[1.0, 1.0, 2.0, np.full(4, 5.0), np.full(4, 3.0)]
COST = output_weights(SAMPLED.c, SAMPLED.d, OUTPUT, np.eye(4) * 1e-8)


def test_gain_is_that_of_control_with_the_cross_term() -> None:
    import control

    q, r, n = COST
    theirs, cost, _ = control.dlqr(SAMPLED.a, SAMPLED.b, q, r, n)
    ours = dlqr(SAMPLED.a, SAMPLED.b, q, r, n)
    assert ours.gain == pytest.approx(theirs, rel=1e-6, abs=1e-6)
    assert ours.cost == pytest.approx(cost, rel=1e-6, abs=1e-6)


def test_cost_to_go_is_the_cost_paid_and_no_neighbour_pays_less() -> None:
    best = dlqr(SAMPLED.a, SAMPLED.b, *COST)
    x0 = np.linspace(-1, 1, 14) * 0.01

    def paid(gain: np.ndarray) -> float:
        x, total = x0, 0.0
        for _ in range(6000):
            u = -gain @ x
            y = SAMPLED.c @ x + SAMPLED.d @ u
            total += float(y @ (OUTPUT * y) + 1e-8 * u @ u)
            x = SAMPLED.a @ x + SAMPLED.b @ u
        return total

    least = paid(best.gain)
    assert least == pytest.approx(float(x0 @ best.cost @ x0), rel=1e-6)
    assert paid(best.gain * 1.02) > least
    assert paid(best.gain * 0.98) > least


def test_sampled_cost_is_the_integral_between_the_samples() -> None:
    q, r, n = output_weights(CAR.c, CAR.d, OUTPUT, np.eye(4) * 1e-8)
    a, b, qd, rd, nd = sampled_cost(CAR.a, CAR.b, q, r, n, 0.005)
    assert a == pytest.approx(SAMPLED.a)
    assert b == pytest.approx(SAMPLED.b)
    x, u = np.linspace(-1, 1, 14) * 0.01, np.array([100.0, -50.0, 20.0, 10.0])
    fine = CAR.discretise(0.005 / 2000)
    y, _ = fine.simulate(np.tile(u, (2000, 1)), x)
    running = (y**2 @ OUTPUT + 1e-8 * u @ u) * 0.005 / 2000
    promised = x @ qd @ x + u @ rd @ u + 2 * x @ nd @ u
    assert promised == pytest.approx(running.sum(), rel=2e-3)


def test_mode_out_of_reach_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="no stabilising regulator"):
        dlqr(np.diag([1.0, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))
