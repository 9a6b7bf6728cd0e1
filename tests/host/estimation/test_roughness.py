"""The class of the ground's roughness: right over classes and speeds, silent until it is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.config.vehicle import PayloadConfig
from tiger.emulation.scenarios import RoadConfig, Scenario, Start, TerrainConfig
from tiger.estimation import roughness
from tiger.estimation.roughness import CLASSES, RoughnessState, design_roughness, step
from tiger.models.road import ISO_ROUGHNESS_M3
from tiger.record import Estimate, ImuSample, Inputs, Loads, Odometry, Roughness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from conftest import Tick

    Roll = Callable[..., Iterator[Tick]]

ROBOT = load_robot(None)
DESIGN = design_roughness(ROBOT)


def found(
    roll: Roll,
    road: str,
    speed_mps: float,
    seed: int,
    duration_s: float = 60.0,
    payload: PayloadConfig | None = None,
) -> Roughness:
    """What is said of a road at the end of a run along it."""
    scenario = Scenario(
        title="road",
        duration_s=duration_s,
        start=Start(x_m=2.0, speed_mps=speed_mps),
        payload=payload,
        terrain=TerrainConfig(
            road=RoadConfig(roughness=road, length_m=speed_mps * duration_s + 20.0, seed=seed)  # type: ignore[arg-type]
        ),
    )
    state, said = RoughnessState(), Roughness()
    loads = Loads(payload_kg=0.0 if payload is None else payload.mass_kg)
    estimate = Estimate(ready=True, loads=loads)
    for tick in roll(ROBOT, scenario, lambda _: (speed_mps, 0.0), seed, along_x=True):
        estimate = replace(estimate, odometry=Odometry(speed_mps=tick.truth.speed_mps))
        state, said = step(DESIGN, state, tick.inputs, estimate, 0.005)
    return said


@pytest.mark.parametrize(("road", "speed_mps"), [("A", 3.0), ("B", 8.0), ("C", 5.0), ("D", 2.0), ("E", 4.0)])
def test_the_class_of_a_road_is_told_within_twenty_seconds(roll: Roll, road: str, speed_mps: float) -> None:
    said = found(roll, road, speed_mps, seed=11, duration_s=20.0)
    assert CLASSES[said.class_number] == road
    assert 0.5 < said.index_m3 / ISO_ROUGHNESS_M3[road] < 2.0


def test_a_payload_makes_the_ground_no_smoother(roll: Roll) -> None:
    payload = PayloadConfig(mass_kg=20.0, place_m=(0.0, 0.0, 0.2))
    loaded = found(roll, "C", 3.0, seed=4, duration_s=25.0, payload=payload)
    empty = found(roll, "C", 3.0, seed=4, duration_s=25.0)
    assert loaded.index_m3 == pytest.approx(empty.index_m3, rel=0.3)


@pytest.mark.proof
@pytest.mark.timeout(1800)
def test_a_hundred_one_minute_runs(roll: Roll, record_figure: Callable[[str, object, str], None]) -> None:
    """Classes A to E, any speed from 2 to 8 m/s."""
    random = np.random.default_rng(7)
    right = 0
    for run in range(100):
        said = found(roll, "ABCDE"[run % 5], float(random.uniform(2.0, 8.0)), seed=100 + run)
        right += said.class_number == run % 5
    record_figure("roughness class right, of 100 one-minute runs over A-E at 2-8 m/s", right, ">= 95")
    assert right >= 95


# ---- without a vehicle ----------------------------------------


def sample(t_s: float, up_mps2: float) -> Inputs:
    still = (0.0, 0.0, 0.0)
    return Inputs(
        t_s, armed=True, imu=ImuSample(t_s, (1.0, 0.0, 0.0, 0.0), still, still, (0.0, 0.0, up_mps2), 0)
    )


def fed(values: np.ndarray, speed_mps: float, start: RoughnessState = RoughnessState()) -> RoughnessState:  # noqa: B008
    """State after IMU samples at 100 Hz, each seen by two ticks."""
    state, estimate = start, Estimate(ready=True, odometry=Odometry(speed_mps=speed_mps))
    first = 0.0 if start.imu_t_s < 0.0 else start.imu_t_s
    for index, value in enumerate(values.tolist()):
        inputs = sample(first + 0.01 * (index + 1), value)
        for _ in range(2):
            state, _ = step(DESIGN, state, inputs, estimate, 0.005)
    return state


def test_nothing_is_said_before_enough_ground_has_passed() -> None:
    noise = np.random.default_rng(1).standard_normal(1000)
    assert fed(noise[:700], 2.0).found.class_number == -1
    assert fed(noise[:800], 2.0).found.class_number >= 0


def test_a_standing_robot_learns_nothing_and_forgets_nothing() -> None:
    noise = np.random.default_rng(1).standard_normal(2000)
    before = fed(noise, 3.0)
    after = fed(10.0 * noise, 0.1, before)
    assert after.found == before.found
    assert (after.measured, after.expected, after.distance_m) == (
        before.measured,
        before.expected,
        before.distance_m,
    )


def test_four_times_the_power_is_the_next_class_on_ground_that_keeps_its_wheels() -> None:
    noise = 0.4 * np.random.default_rng(2).standard_normal(4000)
    quiet, loud = fed(noise, 3.0).found, fed(2.0 * noise, 3.0).found
    assert loud.index_m3 / quiet.index_m3 == pytest.approx(4.0, rel=0.02)
    assert loud.class_number == quiet.class_number + 1


def test_new_ground_replaces_the_old_within_its_memory() -> None:
    noise = np.random.default_rng(3).standard_normal(12000)
    rough = fed(1.2 * noise[:6000], 5.0)
    smooth = fed(0.05 * noise[6000:], 5.0, rough)  # 300 m on
    assert smooth.found.class_number <= rough.found.class_number - 2


def test_only_what_is_in_the_band_counts() -> None:
    time = 0.01 * np.arange(6000)
    inside, below, above = (fed(np.sin(2 * np.pi * f * time), 3.0).measured for f in (1.8, 0.2, 12.0))
    assert below < 0.02 * inside
    assert above < 0.02 * inside


@pytest.mark.parametrize(("factor", "number"), [(1.0, 2), (0.51, 2), (1.99, 2), (0.49, 1), (2.01, 3)])
def test_a_class_ends_a_factor_of_two_from_its_mean(factor: float, number: int) -> None:
    assert roughness._roughness(factor * ISO_ROUGHNESS_M3["C"]).class_number == number


def test_what_is_smoother_than_a_or_rougher_than_h_is_a_or_h() -> None:
    assert roughness._roughness(1e-9).class_number == 0
    assert roughness._roughness(0.0).class_number == 0
    assert roughness._roughness(10.0).class_number == 7


def test_wheels_that_take_off_are_reckoned_with_where_they_do() -> None:
    config = ROBOT.roughness
    assert roughness._on_the_ground(config, 1e-4, 100.0) == 1e-4
    flying = roughness._on_the_ground(config, 1e-2, 1000.0)
    variation = (flying * 1000.0) ** 0.5
    swing = 1.0 + config.flight_gain * (variation - config.flight_from)
    assert flying * swing == pytest.approx(1e-2, rel=1e-2)


@pytest.mark.parametrize("payload_kg", [0.0, 3.0, 10.0, 17.5, 20.0])
@pytest.mark.parametrize("speed_mps", [1.0, 1.3, 2.5, 3.0])
def test_between_the_rows_and_columns_of_its_table_it_interpolates(
    payload_kg: float, speed_mps: float
) -> None:
    speeds = roughness._SPEED_STEP_MPS * np.arange(1, 20)
    payloads = roughness._PAYLOAD_STEP_KG * np.arange(8)
    table = tuple(tuple((3.0 * kg + 5.0 * speeds + 2.0 * kg * speeds).tolist()) for kg in payloads)
    exact = 3.0 * payload_kg + 5.0 * speed_mps + 2.0 * payload_kg * speed_mps
    assert roughness._looked_up(table, speed_mps, payload_kg) == pytest.approx(exact)
    assert roughness._looked_up(table, 1e3, -5.0) == table[0][-1]


def test_the_first_sample_tells_of_no_ground() -> None:
    estimate = Estimate(ready=True, odometry=Odometry(speed_mps=2.0))
    first, _ = step(DESIGN, RoughnessState(), sample(1.0, 0.5), estimate, 0.005)
    assert (first.distance_m, first.measured, first.expected) == (0.0, 0.0, 0.0)
    second, _ = step(DESIGN, first, sample(1.01, 0.5), estimate, 0.005)
    assert second.distance_m == pytest.approx(0.02)
