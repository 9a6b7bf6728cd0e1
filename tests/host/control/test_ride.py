"""The chapter 6 controller: what its filter knows, what its regulator minimises, and how fast it is."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tiger.control import ride, ride_designs
from tiger.control.lqr import dlqr, output_weights
from tiger.control.ride import ImuNoise, RoadPrior, design, regulate, ride_model
from tiger.models.full_car import FORCE, IMU, full_car
from tiger.studies import ride_cases
from tiger.studies.performance import simulate

CAR = ride_cases.load_case("table-6-1").car
PRIOR = RoadPrior(0.02, 0.05, 30.0, 0.3)
WEIGHTS = ride_designs.BUMPY_PREVIEW.weights
NOISE = ImuNoise()


def test_gain_and_cost_are_those_of_the_whole_riccati_equation() -> None:
    """The road's block is solved apart because no force reaches it; the whole equation must agree."""
    model = ride_model(CAR, PRIOR, 0.03)
    q, r, n = output_weights(model.h, model.j, WEIGHTS.of_outputs(), np.eye(4) * WEIGHTS.force)
    whole = dlqr(model.a, model.b, q, r, n)
    ours = regulate(model, WEIGHTS)
    assert ours.gain == pytest.approx(whole.gain, rel=1e-6, abs=1e-6 * np.abs(whole.gain).max())
    assert ours.cost == pytest.approx(whole.cost, rel=1e-6, abs=1e-6 * np.abs(whole.cost).max())


@pytest.mark.parametrize("preview_s", [0.102, 0.1, 0.0051])
def test_preview_gives_the_rear_wheels_the_front_road_after_the_delay(preview_s: float) -> None:
    """A step of the front roads in the model moves the car as the same step does in the car's own model."""
    model = ride_model(CAR, RoadPrior(1.0, 1e-6, 10.0), preview_s)
    start = np.zeros(len(model.a))
    start[[14, 16]] = 0.05
    steps = 200
    s, heights = start, []
    accelerations = np.empty((steps, 3))
    for k in range(steps):
        accelerations[k] = model.h[:3] @ s
        heights.append(s[6:14:2] - model.h[-4:] @ s)  # wheel - (wheel - road)
        s = model.a @ s
    road = np.array(heights)
    assert road[:, :2] == pytest.approx(np.full((steps, 2), 0.05), rel=1e-3)
    before = np.arange(steps) * ride.PERIOD_S < preview_s - ride.PERIOD_S
    after = np.arange(steps) * ride.PERIOD_S > preview_s + ride.PERIOD_S
    assert road[before, 2:] == pytest.approx(np.zeros((before.sum(), 2)), abs=1e-12)
    assert road[after, 2:] == pytest.approx(np.full((after.sum(), 2), 0.05), rel=1e-3)
    fine = np.array([np.interp(np.arange(996) / 5, np.arange(steps), column) for column in road.T]).T
    car = simulate(CAR, fine).accelerations[0, ::5]
    assert accelerations[:199] == pytest.approx(car, abs=2e-3 * np.abs(car).max())


def wheel_heights(model: ride.RideModel, sources: int, steps: int) -> np.ndarray:
    """Return what the wheels meet when the first source steps to 1 and all others stay at 0."""
    s, heights = np.zeros(len(model.a)), []
    s[14] = 1.0
    for _ in range(steps):
        heights.append(s[6:14:2] - model.h[-4:] @ s)
        s = model.a @ s
    return np.array(heights)


@pytest.mark.parametrize(("lag_s", "first", "later"), [(0.049, 0, 1), (-0.049, 1, 0)])
def test_one_lane_gives_the_other_its_road_after_the_lag(lag_s: float, first: int, later: int) -> None:
    model = ride_model(CAR, RoadPrior(1.0, 1e-6, 10.0), lane_lag_s=lag_s)
    road = wheel_heights(model, 2, 20)
    assert road[:, first] == pytest.approx(np.ones(20), rel=1e-3)
    assert road[:9, later] == pytest.approx(np.zeros(9), abs=1e-12)
    assert road[9, later] == pytest.approx(0.2, rel=1e-3)  # 49 ms lie a fifth of a sample before the tenth
    assert road[10:, later] == pytest.approx(np.ones(10), rel=1e-3)
    assert road[:, 2:] == pytest.approx(np.zeros((20, 2)), abs=1e-12)


def test_preview_and_lane_lag_together_leave_one_road_for_all_wheels() -> None:
    model = ride_model(CAR, RoadPrior(1.0, 1e-6, 10.0), 0.1, lane_lag_s=0.05)
    road = wheel_heights(model, 1, 40)
    arrival = [int(np.flatnonzero(column > 0.5)[0]) for column in road.T]
    assert arrival == [0, 10, 20, 30]


@pytest.mark.parametrize("delays", [{"preview_s": 0.004}, {"lane_lag_s": -0.004}])
def test_delay_shorter_than_a_period_is_refused(delays: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="shorter than one period"):
        ride_model(CAR, PRIOR, **delays)


def test_delay_must_be_none_or_one_sample() -> None:
    with pytest.raises(ValueError, match="0 or 1 samples"):
        design(ride_model(CAR, PRIOR), WEIGHTS, NOISE, delay_samples=2)


def test_road_prior_has_the_stated_density_of_road_rate() -> None:
    """Well below the bandwidth the road rate has the two-sided density noise^2 per (rad/s) / 2 pi."""
    a, b = PRIOR.dynamics()
    omega = 1.0
    response = np.linalg.solve(1j * omega * np.eye(2) - a, b)
    assert abs(response[1]) == pytest.approx(PRIOR.noise, rel=1e-3)


def test_swell_has_its_density_at_rest_and_resonates_at_its_frequency() -> None:
    a, b = RoadPrior(0.02, 0.05, 6.0, damping=0.1).dynamics()
    rate = [abs(np.linalg.solve(1j * omega * np.eye(3) - a, b)[1]) for omega in (0.01, 6.0, 60.0)]
    assert rate[0] == pytest.approx(0.02, rel=1e-3)
    assert rate[1] == pytest.approx(0.02 / (2 * 0.1), rel=1e-3)
    assert rate[2] == pytest.approx(0.02 / 99, rel=1e-2)


def test_axles_are_correlated_as_asked() -> None:
    model = ride_model(CAR, RoadPrior(0.02, 0.05, 30.0, axle_correlation=0.6))
    slopes = [15, 17, 19, 21]  # FL, FR, RL, RR
    covariance = model.process[np.ix_(slopes, slopes)]
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    expected = np.kron([[1, 0.6], [0.6, 1]], np.eye(2))
    assert correlation == pytest.approx(expected, abs=1e-6)


def test_lanes_are_correlated_as_asked() -> None:
    model = ride_model(CAR, PRIOR, 0.1)
    left, right = 15, 17  # slopes of the two tracks
    covariance = model.process[np.ix_([left, right], [left, right])]
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation == pytest.approx(PRIOR.lane_correlation, rel=1e-6)


def test_filter_follows_a_force_it_knows_without_innovation() -> None:
    controller = design(ride_model(CAR, PRIOR), WEIGHTS, NOISE)
    model = controller.model
    car = full_car(CAR).select(inputs=FORCE, outputs=IMU).discretise(ride.PERIOD_S)
    x, state = np.zeros(14), controller.start()
    state = ride.RideState(state.predicted, state.acting_n, state.pending_n)
    x[0] = 0.01
    state.predicted[0] = 0.01
    for _ in range(100):
        imu = car.c @ x + car.d @ state.acting_n
        assert imu == pytest.approx(model.c @ state.predicted + model.d @ state.acting_n, abs=1e-9)
        state, force = ride.step(controller, state, imu)
        x = car.a @ x + car.b @ force


def test_a_tick_of_filter_and_regulator_takes_60_microseconds_at_most() -> None:
    controller = ride_designs.BUMPY_PREVIEW.controller(CAR, NOISE, 0.102)
    state, spent = controller.start(), []
    for _ in range(2000):
        begin = time.thread_time()
        state, _ = controller.step(state, np.zeros(3))
        spent.append(time.thread_time() - begin)
    assert np.median(spent) <= 60e-6


def test_all_gains_are_designed_within_a_second() -> None:
    begin = time.thread_time()
    ride_designs.HOLDING_PREVIEW.controller(CAR, NOISE, 0.268)
    ride_designs.BUMPY_PREVIEW.controller(CAR, NOISE, 0.102)
    assert time.thread_time() - begin <= 1.0
