"""The predictive controller: the regulator where no limit acts, and every limit where one does."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tiger.control import mpc, ride_designs
from tiger.control.ride import PERIOD_S, ImuNoise
from tiger.studies import ride_cases
from tiger.studies.performance import performance_index, simulate

pytest.importorskip("daqp")

CASE = ride_cases.load_case("table-6-1")
TUNING = ride_designs.BUMPY_PREVIEW
NOISE = ImuNoise().scaled(0.1)
CONTROLLER = TUNING.controller(CASE.car, NOISE, ride_cases.BUMPY_PREVIEW_S)
ROAD = ride_cases.bumpy_road()


def build(force_n: float, rate_nps: float, travel_m: float) -> mpc.RideMpc:
    return mpc.design(CONTROLLER, TUNING.weights, mpc.Limits(force_n, rate_nps, travel_m))


def test_without_limits_in_sight_it_is_the_regulator() -> None:
    free = build(1e6, 1e9, 1.0)
    for seed in range(5):
        state = np.random.default_rng(seed).standard_normal(len(CONTROLLER.model.a)) * 0.01
        assert free.solve(state, np.zeros(4)) == pytest.approx(-CONTROLLER.feedback @ state)


def test_force_rate_and_travel_limits_hold_over_the_bump() -> None:
    limits = (5000.0, 2e5, 0.065)
    run = simulate(CASE.car, ROAD, build(*limits), NOISE)
    assert np.abs(run.force_n).max() <= limits[0] * (1 + 1e-6)
    assert np.abs(np.diff(run.force_n, axis=1)).max() <= limits[1] * PERIOD_S * (1 + 1e-6)
    assert np.abs(run.suspension_m).max() <= limits[2] * 1.02


def test_planning_for_the_force_limit_beats_running_into_it() -> None:
    planned = simulate(CASE.car, ROAD, build(5000.0, 1e9, 1.0), NOISE)
    clipping = TUNING.controller(CASE.car, NOISE, ride_cases.BUMPY_PREVIEW_S, max_force_n=5000.0)
    clipped = simulate(CASE.car, ROAD, clipping, NOISE)
    peaks = [performance_index(CASE.car, CASE.rattle_space_m, run)[0, 0] for run in (planned, clipped)]
    assert peaks[0] < 0.8 * peaks[1]


def test_a_tick_takes_a_millisecond_and_a_half_at_the_99th_percentile() -> None:
    controller, spent = build(5000.0, 1e5, 0.065), []
    step = controller.step

    class Timed:
        start = staticmethod(controller.start)

        @staticmethod
        def step(state, imu):
            begin = time.thread_time()
            result = step(state, imu)
            spent.append(time.thread_time() - begin)
            return result

    simulate(CASE.car, ROAD, Timed(), NOISE)
    assert np.percentile(spent, 99) <= 1.5e-3


def test_runs_side_by_side_and_late_forces_are_refused() -> None:
    with pytest.raises(ValueError, match="one run at a time"):
        build(5000.0, 1e5, 0.06).start(2)
    late = TUNING.controller(CASE.car, NOISE, delay_samples=1)
    with pytest.raises(ValueError, match="acts at once"):
        mpc.design(late, TUNING.weights, mpc.Limits(5000.0, 1e5, 0.06))
