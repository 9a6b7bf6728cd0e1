"""The bank of ride controllers: it finds out which lane leads, and notices when neither does."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tiger.control import ride_bank, ride_designs
from tiger.control.ride import ImuNoise
from tiger.studies import ride_cases
from tiger.studies.performance import performance_index, simulate

CASE = ride_cases.load_case("table-6-1")
NOISE = ImuNoise()
ROAD = ride_cases.bumpy_road()
MIRRORED = ROAD[:, [1, 0, 3, 2]]
TUNING = ride_designs.BUMPY_PLAIN
PEAK_ROLL = 4
SEEDS = tuple(range(70, 82))


def bank(lag_s: float = ride_cases.BUMPY_LANE_LAG_S) -> ride_bank.RideBank:
    return ride_bank.oblique(TUNING, CASE.car, NOISE, lag_s)


class Watched:
    """Runs a bank and keeps the share of each controller."""

    def __init__(self, watched: ride_bank.RideBank) -> None:
        self.bank, self.shares = watched, []

    def start(self, runs: int | None = None) -> ride_bank.BankState:
        return self.bank.start(runs)

    def step(self, state, imu):
        state, force = self.bank.step(state, imu)
        self.shares.append(ride_bank.shares(state.evidence))
        return state, force


def index(controller, road=ROAD, seeds=SEEDS) -> np.ndarray:
    return performance_index(
        CASE.car, CASE.rattle_space_m, simulate(CASE.car, road, controller, NOISE, seeds)
    ).mean(axis=0)


@pytest.mark.parametrize(
    ("road", "lag_s", "right_one"), [(ROAD, 0.049, 0), (MIRRORED, 0.049, 1), (ROAD, 0.03, 2)]
)
def test_the_likeliest_controller_steers_within_a_tenth_of_a_second(
    road: np.ndarray, lag_s: float, right_one: int
) -> None:
    watched = Watched(bank(lag_s))
    simulate(CASE.car, road, watched, NOISE, SEEDS)
    shares = np.array(watched.shares)[20:60]  # while the wheels are on the first wave
    assert np.median(shares[:, right_one]) > 0.9


def test_a_road_and_its_mirror_image_are_driven_alike() -> None:
    either = [simulate(CASE.car, road, bank()).force_n[0] for road in (ROAD, MIRRORED)]
    assert either[1][:, [1, 0, 3, 2]] == pytest.approx(either[0], abs=1e-3)


def test_worst_mean_row_is_below_the_limit_of_linear_controllers_without_preview() -> None:
    """About 1.58 x the printed row, on either side."""
    printed = np.array(ride_cases.PRINTED["bumpy active"])
    assert (index(bank()) / printed).max() <= 1.55
    mirrored = index(bank(), MIRRORED)[[0, 1, 2, 3, 4, 5, 7, 6, 9, 8, 11, 10, 13, 12]]
    assert (mirrored / printed).max() <= 1.55


@pytest.mark.parametrize("lag_s", [0.03, 0.07])
def test_a_wrong_lag_costs_little_for_four_roads_take_over(lag_s: float) -> None:
    """The design that trusts a wrong lag alone has several times the peak roll acceleration."""
    alone = TUNING.controller(CASE.car, NOISE, lane_lag_s=lag_s)
    four_roads = TUNING.controller(CASE.car, NOISE)
    assert index(bank(lag_s))[PEAK_ROLL] <= 1.15 * index(four_roads)[PEAK_ROLL]
    assert index(alone)[PEAK_ROLL] >= 3 * index(four_roads)[PEAK_ROLL]


def test_a_tick_of_three_filters_takes_60_microseconds_at_most() -> None:
    controller, spent = bank(), []
    state = controller.start()
    for _ in range(2000):
        begin = time.thread_time()
        state, _ = controller.step(state, np.zeros(3))
        spent.append(time.thread_time() - begin)
    assert np.median(spent) <= 60e-6


def test_shares_add_up_to_one_and_stay_finite() -> None:
    evidence = np.array([[0.0, -5000.0], [0.0, -1.0], [0.0, -6000.0]])
    assert ride_bank.shares(evidence) == pytest.approx(np.array([[1 / 3, 0], [1 / 3, 1], [1 / 3, 0]]))


def test_force_stays_within_the_limit() -> None:
    limited = ride_bank.oblique(TUNING, CASE.car, NOISE, 0.049, max_force_n=2000.0)
    run = simulate(CASE.car, ROAD, limited, NOISE)
    assert np.abs(run.force_n).max() == pytest.approx(2000.0)


def test_controllers_with_late_forces_are_refused() -> None:
    late = TUNING.controller(CASE.car, NOISE, delay_samples=1)
    with pytest.raises(ValueError, match="acts at once"):
        ride_bank.RideBank((late, late))
