"""The robot levels itself on the shaking plate: real firmware, real daemon, virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests_system_types import Run  # noqa: F401  (for readers)

STEPS_S = (5.0, 20.0)
BAND_DEG = 0.5
SLACK = 1.25  # of the rate bound


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("step_s", STEPS_S)
def test_body_is_level_soon_after_each_step_and_stays_so(
    plate_run: Callable, rate_bound_s: float, seed: int, step_s: float, record_figure: Callable
) -> None:
    run = plate_run(seed)
    until_s = 20.0 if step_s < 20.0 else 30.0
    window = (run.time_s > step_s) & (run.time_s < until_s)
    outside = run.time_s[window][run.worst_tilt_deg[window] >= BAND_DEG]
    settled_s = outside.max() - step_s
    record_figure(f"time to {BAND_DEG} degrees, step at {step_s:g} s, seed {seed}", settled_s, "3.3 s")
    assert settled_s <= SLACK * rate_bound_s


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_body_never_tilts_more_than_half_a_degree_beyond_level(plate_run: Callable, seed: int) -> None:
    run = plate_run(seed)
    roll = run.series[:, 1]
    assert roll[(run.time_s > 5.3) & (run.time_s < 20.0)].min() > -BAND_DEG
    assert roll[(run.time_s > 20.3) & (run.time_s < 30.0)].max() < BAND_DEG
    assert np.abs(run.series[:, 2]).max() < BAND_DEG  # the plate never pitches


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mean_error_once_settled_is_within_three_tenths_of_a_degree(plate_run: Callable, seed: int) -> None:
    run = plate_run(seed)
    window = (run.time_s >= 15.0) & (run.time_s <= 20.0)
    assert np.abs(run.series[window, 1:3].mean(axis=0)).max() <= 0.3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_drives_are_off_while_the_plate_stands_still_and_the_body_is_level(
    plate_run: Callable, seed: int
) -> None:
    run = plate_run(seed)
    for begin_s, end_s in ((3.6, 4.99), (12.0, 19.99)):
        window = (run.time_s > begin_s) & (run.time_s < end_s)
        quiet = run.worst_tilt_deg[window] < 0.2
        assert quiet.mean() > 0.9, "the body should be level here"
        assert not run.duty[window][quiet].any()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slow_harmonic_is_followed_with_a_small_residual(plate_run: Callable, seed: int) -> None:
    run = plate_run(seed)
    window = run.time_s > 35.0
    assert run.worst_tilt_deg[window].max() < BAND_DEG


def test_two_runs_with_one_seed_are_identical_and_another_seed_is_not(make_plate_run: Callable) -> None:
    first, second, other = (make_plate_run(seed, 8.0) for seed in (7, 7, 8))
    assert np.array_equal(first.series, second.series)
    assert [r.outputs for r in first.records] == [r.outputs for r in second.records]
    assert not np.array_equal(first.series, other.series)


def test_robot_is_armed_before_the_plate_moves_and_stays_armed(plate_run: Callable) -> None:
    run = plate_run(0)
    states = [record.state for record in run.records]
    armed = states.index(DaemonState.ARMED)
    assert run.time_s[armed] < 5.0
    assert set(states[armed:]) == {DaemonState.ARMED}


@pytest.mark.parametrize("seed", [4])
def test_levels_over_lines_that_damage_a_byte_in_a_thousand(
    plate_run: Callable, rate_bound_s: float, seed: int
) -> None:
    run = plate_run(seed, 20.0, noise=1e-3)
    assert run.rig.robot.damaged_bytes > 100
    window = (run.time_s > 5.0 + SLACK * rate_bound_s) & (run.time_s < 20.0)
    assert run.worst_tilt_deg[window].max() < BAND_DEG
    assert run.records[-1].state is DaemonState.ARMED
