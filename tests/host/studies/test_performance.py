"""The performance index against its definition, and the simulation against the closed loop it must agree
with."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.control import ride_designs
from tiger.control.margins import closed_loop
from tiger.control.ride import ImuNoise
from tiger.models.full_car import IMU, ROAD, SUSPENSION, TIRE, full_car
from tiger.studies import ride_cases
from tiger.studies.performance import (
    FINE_PER_PERIOD,
    RideRun,
    fine_time_s,
    performance_index,
    simulate,
)

CASE = ride_cases.load_case("table-6-1")
NOISE = ImuNoise()


def test_index_takes_peaks_rms_tire_load_over_static_load_and_travel_over_rattle_space() -> None:
    outputs = np.zeros((1, 4, 11))
    outputs[0, :, 0] = [1, -3, 1, 1]
    outputs[0, :, 3] = [0.02, -0.04, 0, 0]
    outputs[0, :, 7] = 0.01
    run = RideRun(outputs, np.zeros((1, 1, 4)), np.zeros((1, 1, 3)))
    index = performance_index(CASE.car, 0.08, run)[0]
    assert index[:2] == pytest.approx([3, np.sqrt(3)])
    front_load = 9.80665 * (1.156 * 2160 / (2 * 2.68) + 85)
    assert index[6] == pytest.approx(200000 * 0.01 / front_load)
    assert index[10:] == pytest.approx([0.5, 0, 0, 0])


def test_passive_bumpy_columns_of_table_6_2() -> None:
    run = simulate(CASE.car, ride_cases.bumpy_road())
    error = performance_index(CASE.car, CASE.rattle_space_m, run)[0] / ride_cases.PRINTED["bumpy passive"] - 1
    assert np.sqrt(np.mean(error**2)) <= 0.010
    assert np.abs(error).max() <= 0.022


def test_passive_iso_road_of_the_stated_recipe() -> None:
    seeds = range(40)
    run = simulate(CASE.car, ride_cases.iso_roads(CASE.car, seeds), seeds=tuple(seeds))
    rms = performance_index(CASE.car, CASE.rattle_space_m, run).mean(axis=0)[[1, 3, 5]]
    assert rms == pytest.approx([0.544, 0.511, 0.701], rel=0.05)


def test_passive_simulation_is_that_of_the_sampled_model() -> None:
    road = ride_cases.bumpy_road()[:2001]
    outputs = (IMU[0], "pitch_accel_radps2", "roll_accel_radps2", *SUSPENSION, *TIRE)
    model = full_car(CASE.car, (0.2, -0.1)).select(inputs=ROAD, outputs=outputs).discretise(0.001, "foh")
    x = np.zeros(14)
    exact, _ = model.simulate(road[:-1], x)
    ours = simulate(CASE.car, road, imu_offset_m=(0.2, -0.1)).outputs[0]
    assert ours == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("delay_ms", "designed"), [(0, 0), (3, 0), (5, 1), (7, 1), (10, 1)])
def test_closed_loop_system_agrees_with_the_simulation(delay_ms: int, designed: int) -> None:
    """(6.28)-(6.29), from an initial state on a flat road, at every delay."""
    tuning = ride_designs.ROBUST
    controller = tuning.controller(CASE.car, NOISE, delay_samples=designed)
    x0 = np.zeros(14)
    x0[[0, 2, 4]] = 0.02, 0.01, -0.02
    steps = 300
    run = simulate(
        CASE.car, np.zeros((steps * FINE_PER_PERIOD + 1, 4)), controller, delay_s=delay_ms * 1e-3, x0=x0
    )
    loop = closed_loop(CASE.car, controller, delay_ms * 1e-3)
    start = np.zeros(len(loop.states))
    start[:14] = x0
    y, _ = loop.simulate(np.zeros((steps, 11)), start)
    deflections = run.outputs[0, ::FINE_PER_PERIOD, 3:]
    assert y[:, 3:11] == pytest.approx(deflections, rel=1e-6, abs=1e-9 + 1e-9 * np.abs(deflections).max())


def test_same_seed_gives_the_same_run_and_runs_side_by_side_do_not_mix() -> None:
    controller = ride_designs.HOLDING_PLAIN.controller(CASE.car, NOISE)
    road = ride_cases.bumpy_road()[:1001]
    together = simulate(CASE.car, road, controller, NOISE, (4, 5))
    alone = simulate(CASE.car, road, controller, NOISE, (5,))
    assert together.outputs[1] == pytest.approx(alone.outputs[0], rel=1e-9, abs=1e-9)
    assert np.abs(together.force_n[0] - together.force_n[1]).max() > 0.1


def test_force_is_limited() -> None:
    controller = ride_designs.HOLDING_PLAIN.controller(CASE.car, NOISE, max_force_n=500.0)
    run = simulate(CASE.car, ride_cases.bumpy_road(), controller, NOISE)
    assert np.abs(run.force_n).max() == pytest.approx(500.0)


def test_fine_time_includes_the_end() -> None:
    assert fine_time_s(0.01) == pytest.approx(np.arange(11) * 1e-3)
