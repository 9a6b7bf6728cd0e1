"""The attitude observer: exact on its own model, unbiased, quick, steady, and right about late samples."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.estimation import attitude_observer as observer
from tiger.estimation.attitude_observer import ObserverState, design_observer, initial_state, observed_car
from tiger.models.full_car import FORCE, ROAD, full_car
from tiger.record import Estimate, ImuSample

ROBOT = load_robot()
DESIGN = design_observer(ROBOT)
DT = ROBOT.loop.period_s
FLAT = np.zeros(4)
SAMPLE_EVERY = 2


def imu(
    roll: float = 0.0,
    pitch: float = 0.0,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    up: float = 0.0,
    t_s: float = 0.0,
) -> ImuSample:
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return ImuSample(t_s, (cr * cp, sr * cp, cr * sp, -sr * sp), rates, (0.0,) * 3, (0.0, 0.0, up), 0)


class Car:
    """The 7-DOF model on a plate, stepped with the observer's period: what the observer believes in."""

    def __init__(self) -> None:
        parameters = observed_car(ROBOT)
        outputs = ("roll_rad", "pitch_rad", "roll_rate_radps", "pitch_rate_radps", "imu_heave_accel_mps2")
        model = full_car(parameters, ROBOT.vehicle.imu_offset_m[:2])
        self.model = model.select(inputs=(*ROAD, *FORCE), outputs=outputs).discretise(DT, "zoh")
        self.corners = parameters.corner_positions_m()
        self.springs, self.dampers = parameters.spring_npm(), parameters.damper_nspm()
        self.x = np.zeros(14)

    def step(self, plate_roll: float, plate_pitch: float, lift=FLAT, lift_rate=FLAT) -> np.ndarray:
        road = self.corners[:, 1] * plate_roll - self.corners[:, 0] * plate_pitch
        u = np.concatenate([road, self.springs * lift + self.dampers * lift_rate])
        self.x = self.model.a @ self.x + self.model.b @ u
        return self.model.c @ self.x + self.model.d @ u


def run(
    seconds: float,
    plate=lambda t: (0.0, 0.0),
    lift=lambda t: FLAT,
    noise: float = 0.0,
    bias: tuple[float, float] = (0.0, 0.0),
    delay_ticks: int = 0,
) -> tuple[np.ndarray, list[Estimate]]:
    """Feed the observer the car; return true (time, roll, pitch, plate roll, plate pitch) and estimates."""
    car, state, rng = Car(), initial_state(DESIGN), np.random.default_rng(3)
    sigma = noise * np.array([3.5e-4, 3.5e-4, 1.7e-3, 1.7e-3, 0.05])
    rows, estimates, waiting = [], [], []
    for tick in range(round(seconds / DT)):
        t = tick * DT
        rate = (lift(t + DT / 2) - lift(t - DT / 2)) / DT
        y = car.step(*plate(t), lift(t), rate)
        roll, pitch, p, q, up = y + sigma * rng.standard_normal(5)
        if tick % SAMPLE_EVERY == 0:
            # Angular rates of the body from those of its angles, so that nothing but the filter is tested.
            p, q, r = p, q * math.cos(roll), -q * math.sin(roll)
            waiting.append((tick, imu(roll, pitch, (p + bias[0], q + bias[1], r), up)))
        sample = None
        if waiting and waiting[0][0] + delay_ticks <= tick:
            sample = waiting.pop(0)[1]
        state, estimate = observer.step(DESIGN, state, lift(t), rate, sample, delay_ticks * DT)
        rows.append((t, y[0], y[1], *plate(t)))
        estimates.append(estimate)
    return np.array(rows), estimates


def degrees(estimates: list[Estimate], *names: str) -> np.ndarray:
    return np.degrees([[getattr(e, name) for name in names] for e in estimates])


def raised_cosine(t: float, to_deg: float, at_s: float, over_s: float = 0.3) -> float:
    share = min(max((t - at_s) / over_s, 0.0), 1.0)
    return math.radians(to_deg) * 0.5 * (1.0 - math.cos(math.pi * share))


# ---- design -------------------------------------------------


def test_the_filter_is_stable_so_that_nothing_drifts() -> None:
    between = np.linalg.matrix_power(DESIGN.transition, SAMPLE_EVERY)
    n = len(between)
    error = (np.eye(n) - DESIGN.corrections[0][0] @ DESIGN.output) @ between
    slowest = np.abs(np.linalg.eigvals(error)).max()
    time_constant_s = -SAMPLE_EVERY * DT / math.log(slowest)
    assert time_constant_s < 120.0


def test_every_state_but_heave_and_warp_is_seen_by_the_imu() -> None:
    """Modes that the IMU does not see must die out by themselves."""
    values, vectors = np.linalg.eig(DESIGN.transition)
    for value, vector in zip(values, vectors.T, strict=True):
        seen = np.abs(DESIGN.output @ vector).max() > 1e-9
        assert seen or abs(value) < 0.999


# ---- estimates ----------------------------------------------


def test_it_starts_at_rest_in_the_attitude_of_the_first_sample() -> None:
    state = initial_state(DESIGN)
    state, estimate = observer.step(DESIGN, state, FLAT, FLAT, None)
    assert not estimate.ready
    lift = np.array([0.02, -0.02, 0.02, -0.02])
    state, estimate = observer.step(DESIGN, state, lift, FLAT, imu(0.05, -0.02))
    assert estimate.ready
    assert (estimate.roll_rad, estimate.pitch_rad) == pytest.approx((0.05, -0.02), abs=1e-9)
    assert estimate.plate_roll_rad == pytest.approx(0.05 - 0.02 / 0.6, abs=1e-9)
    for _ in range(200):
        state, estimate = observer.step(DESIGN, state, lift, FLAT, None)
    assert (estimate.roll_rad, estimate.plate_pitch_rad) == pytest.approx((0.05, -0.02), abs=1e-9)


def test_at_rest_the_estimate_is_unbiased_and_quiet() -> None:
    _, estimates = run(60.0, noise=1.0)
    attitude = degrees(estimates[2000:], "roll_rad", "pitch_rad")
    assert np.abs(attitude.mean(axis=0)).max() < 0.005
    assert attitude.std(axis=0).max() < 0.01
    rates = degrees(estimates[2000:], "plate_roll_rate_radps", "plate_pitch_rate_radps")
    assert rates.std(axis=0).max() < 0.1


def test_minutes_at_rest_do_not_move_it() -> None:
    _, estimates = run(150.0, noise=1.0)
    first = degrees(estimates[4000:12000], "roll_rad", "pitch_rad", "plate_roll_rad").mean(axis=0)
    last = degrees(estimates[-8000:], "roll_rad", "pitch_rad", "plate_roll_rad").mean(axis=0)
    assert last == pytest.approx(first, abs=0.003)


@pytest.mark.parametrize("delay_ticks", [0, 3])
def test_a_quick_tilt_of_the_plate_is_tracked(delay_ticks: int) -> None:
    truth, estimates = run(4.0, lambda t: (raised_cosine(t, 5.0, 2.0), 0.0), delay_ticks=delay_ticks)
    error = degrees(estimates, "roll_rad", "pitch_rad", "plate_roll_rad") - np.degrees(truth[:, [1, 2, 3]])
    body, pitch, plate = np.abs(error[10:]).max(axis=0)
    assert body < 0.5
    assert pitch < 0.01
    assert plate < 0.8
    assert np.abs(error[-100:]).max() < 0.02


def test_the_strokes_are_known_and_do_not_look_like_ground() -> None:
    """A body that rolls by its own strokes, at full speed, stands on level ground all the time."""

    def lift(t: float) -> np.ndarray:
        return np.array([1, -1, 1, -1]) * 0.018 * min(max(t - 1.0, 0.0), 2.5)

    truth, estimates = run(5.0, lift=lift)
    assert np.degrees(truth[-1, 1]) > 4.0
    plate = degrees(estimates, "plate_roll_rad", "plate_pitch_rad")
    assert np.abs(plate).max() < 0.02
    body = degrees(estimates, "roll_rad") - np.degrees(truth[:, [1]])
    assert np.abs(body).max() < 0.02


def test_a_gyro_bias_is_told_from_a_turn() -> None:
    bias = (math.radians(0.5), math.radians(-0.3))
    _, estimates = run(90.0, lambda t: (0.03 * math.sin(0.6 * t), 0.0), bias=bias)
    assert np.degrees(estimates[-1].gyro_bias_radps) == pytest.approx((0.5, -0.3), abs=0.02)


def test_a_turn_on_a_slope_is_no_roll_rate() -> None:
    """Yawing on a slope, the gyro's x axis turns although the roll angle stands."""
    pitch, yaw_rate = 0.1, 0.5
    state = initial_state(DESIGN)
    rates = (-yaw_rate * math.sin(pitch), 0.0, yaw_rate * math.cos(pitch))
    for _ in range(400):
        state, estimate = observer.step(DESIGN, state, FLAT, FLAT, imu(0.0, pitch, rates))
    assert estimate.roll_rate_radps == pytest.approx(0.0, abs=1e-6)
    assert estimate.gyro_bias_radps == pytest.approx((0.0, 0.0), abs=1e-6)


# ---- late samples -------------------------------------------


@pytest.mark.parametrize("delay_ticks", [1, 2, 5, 19])
def test_a_late_sample_does_exactly_what_it_would_have_done_in_time(delay_ticks: int) -> None:
    """Once everything has come in, a late link and a prompt one have led to the same state."""
    rng = np.random.default_rng(delay_ticks)
    samples = {
        k: imu(*rng.normal(0.0, 0.02, 2), tuple(rng.normal(0.0, 0.1, 3)), rng.normal())
        for k in range(0, 100, 2)
    }
    start, _ = observer.step(DESIGN, initial_state(DESIGN), FLAT, FLAT, imu())
    prompt = late = start
    for k in range(100 + delay_ticks):
        lift = 0.01 * np.array([math.sin(0.1 * k), 0.0, math.cos(0.2 * k), 1.0])
        prompt, _ = observer.step(DESIGN, prompt, lift, FLAT, samples.get(k))
        late, _ = observer.step(DESIGN, late, lift, FLAT, samples.get(k - delay_ticks), delay_ticks * DT)
    assert late.x == pytest.approx(prompt.x, abs=1e-12)


def test_a_sample_older_than_the_history_is_left_out() -> None:
    state, _ = observer.step(DESIGN, initial_state(DESIGN), FLAT, FLAT, imu())
    new, estimate = observer.step(DESIGN, state, FLAT, FLAT, imu(0.3), age_s=0.2)
    assert estimate.innovation == ()
    assert np.allclose(new.x, 0.0)


def test_between_samples_it_predicts() -> None:
    def plate(t: float) -> tuple[float, float]:
        return 0.05 * math.sin(2.0 * t), 0.0

    _, with_samples = run(4.0, plate)
    car, state = Car(), initial_state(DESIGN)
    for tick in range(800):
        t = tick * DT
        y = car.step(*plate(t))
        sample = imu(y[0], y[1], (y[2], y[3], 0.0), y[4]) if tick % 2 == 0 and tick < 780 else None
        state, estimate = observer.step(DESIGN, state, FLAT, FLAT, sample)
    assert estimate.roll_rad == pytest.approx(with_samples[-1].roll_rad, abs=2e-3)


# ---- cost ---------------------------------------------------


def test_a_step_changes_nothing_it_was_given() -> None:
    state, _ = observer.step(DESIGN, initial_state(DESIGN), FLAT, FLAT, imu(0.1))
    before = ObserverState(state.x.copy(), tuple(row.copy() for row in state.predicted), state.ready)
    observer.step(DESIGN, state, FLAT, FLAT, imu(0.2), 0.02)
    assert np.array_equal(state.x, before.x)
    assert np.array_equal(state.predicted, before.predicted)


def test_a_tick_costs_less_than_60_us() -> None:
    state, _ = observer.step(DESIGN, initial_state(DESIGN), FLAT, FLAT, imu())
    costs, sample = [], imu(0.01)
    for _ in range(10):
        start = time.process_time()
        for tick in range(200):
            state, _ = observer.step(DESIGN, state, FLAT, FLAT, sample if tick % 2 else None, 0.012)
        costs.append((time.process_time() - start) / 200)
    assert min(costs) < 60e-6
