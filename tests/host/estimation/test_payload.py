"""What the robot carries, told from half a minute of driving: mass, place, and how sure of it one may be."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.config.vehicle import PayloadConfig
from tiger.emulation.scenarios import RoughConfig, Scenario, Start, TerrainConfig
from tiger.estimation import payload, wheel_loads
from tiger.estimation.payload import MASS, STATES, UNKNOWN_M
from tiger.record import Estimate, Inputs, Loads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from conftest import Tick

    Roll = Callable[..., Iterator[Tick]]

ROBOT = load_robot(None)
DESIGN = wheel_loads.design_loads(ROBOT)
LEG_S = 5.0


class Case(NamedTuple):
    """A load of 20 kg (or none) somewhere on the deck, on ground that slopes, one never knows how."""

    place_m: tuple[float, float, float]
    mass_kg: float
    terrain: TerrainConfig
    yaw_deg: float


def case(seed: int, mass_kg: float = 20.0) -> Case:
    random = np.random.default_rng(seed)
    x, y, z = random.uniform([-0.4, -0.25, 0.15], [0.4, 0.25, 0.4]).tolist()
    climb, rise = random.normal(0.0, 1.5, 2).tolist()
    rough = RoughConfig(roughness="ABC"[seed % 3], size_m=(60.0, 60.0), shortest_wave_m=0.5, seed=seed)  # type: ignore[arg-type]
    terrain = TerrainConfig(climb_deg=climb, left_up_deg=rise, rough=rough)
    return Case((x, y, z), mass_kg, terrain, float(random.uniform(-180.0, 180.0)))


def course(time_s: float) -> tuple[float, float]:
    """Start, roll, stop, every five seconds for half a minute; a quarter turn on the way."""
    phase = (time_s - 1.0) % LEG_S
    speed = max(0.0, min(phase, 1.0, 4.0 - phase)) if time_s >= 1.0 else 0.0
    turning = 11.0 <= time_s < 21.0 and 0.8 < phase < 3.2
    return speed, 0.8 if turning else 0.0


def driven(
    roll: Roll,
    of: Case,
    seed: int,
    along: Callable[[float], tuple[float, float]] = course,
    for_s: float = 31.0,
) -> Loads:
    """What is said of the load after the drive."""
    scenario = Scenario(
        title="load",
        duration_s=for_s,
        friction=0.5,  # on asphalt the motors cannot turn the robot
        payload=PayloadConfig(mass_kg=of.mass_kg, place_m=of.place_m) if of.mass_kg else None,
        start=Start(x_m=30.0, yaw_deg=of.yaw_deg),
        terrain=of.terrain,
    )
    state, estimate = wheel_loads.initial_state(DESIGN), Estimate(ready=True)
    for tick in roll(ROBOT, scenario, along, seed):
        state, loads = wheel_loads.step(DESIGN, state, tick.inputs, estimate, 0.005)
        estimate = replace(estimate, loads=loads)
    return estimate.loads


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_load_is_found_within_thirty_seconds_of_driving(roll: Roll, seed: int) -> None:
    of = case(seed)
    said = driven(roll, of, seed)
    assert said.payload_kg == pytest.approx(20.0, abs=4.0)  # the bar is 2: docs/loads.md
    off = np.abs(np.subtract(said.payload_m, of.place_m))
    assert off[0] < 0.05
    assert off[1] < 0.08  # the bar is 0.05
    assert off[2] < 0.12
    assert said.mass_kg == pytest.approx(DESIGN.payload.empty_kg + said.payload_kg)
    share = said.payload_kg / (DESIGN.payload.body_kg + said.payload_kg)
    np.testing.assert_allclose(said.com_m, np.multiply(share, said.payload_m), atol=1e-9)


def test_an_empty_robot_is_told_to_be_nearly_empty(roll: Roll) -> None:
    said = driven(roll, case(4, mass_kg=0.0), 4)
    assert said.payload_kg < 3.0
    assert max(map(abs, said.com_m)) < 0.03


def test_without_a_turn_the_side_stays_open_and_the_deviation_says_so(roll: Roll) -> None:
    """A steady cross slope and a load to one side tilt the body alike."""

    def straight(time_s: float) -> tuple[float, float]:
        return course(time_s)[0], 0.0

    of = case(5)
    said = driven(roll, of, 5, straight)
    assert abs(said.payload_m[0] - of.place_m[0]) < 0.07
    assert said.payload_sigma_m[1] > 0.15
    assert abs(said.payload_m[1] - of.place_m[1]) < 3.0 * said.payload_sigma_m[1]


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_twenty_loads_anywhere_on_the_deck(
    roll: Roll, record_figure: Callable[[str, object, str], None]
) -> None:
    """Classes A to C, slopes of 1.5 degrees, a quarter turn in half a minute of starts and stops."""
    errors = []
    for seed in range(20, 40):
        of = case(seed)
        said = driven(roll, of, seed)
        errors.append([said.payload_kg - 20.0, *np.subtract(said.payload_m, of.place_m)])
    mass, x, y, z = np.abs(errors).T
    record_figure("payload's mass off, RMS", f"{np.sqrt(np.mean(mass**2)):.2f} kg", "")
    record_figure("payloads of 20 kg found within 10 %, of 20", int((mass <= 2.0).sum()), "20")
    record_figure("payloads placed within 5 cm ahead, of 20", int((x <= 0.05).sum()), "20")
    record_figure("payloads placed within 5 cm to the side, of 20", int((y <= 0.05).sum()), "20")
    record_figure("payload's height off, RMS", f"{100.0 * np.sqrt(np.mean(z**2)):.1f} cm", "")
    assert np.sqrt(np.mean(mass**2)) < 2.5
    assert (x <= 0.05).sum() >= 18
    assert (y <= 0.05).sum() >= 16


# ---- without a vehicle ----------------------------------------


def measured(**changes: Any) -> payload.Measured:
    still = payload.Measured(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, fresh=False, gripping=True)
    return still._replace(**changes)


def fed(state: payload.PayloadState, seconds: float, **changes: Any) -> payload.PayloadState:
    for _ in range(round(seconds / 0.01)):
        state = payload.step(DESIGN.payload, state, measured(**changes), 0.01)
    return state


def test_at_rest_nothing_is_learned_beyond_the_first_look() -> None:
    looked = fed(payload.initial_state(DESIGN.payload), 1.0, roll_rad=0.02)
    waited = fed(looked, 20.0, roll_rad=0.05)
    np.testing.assert_array_equal(waited.mean, looked.mean)
    np.testing.assert_array_equal(waited.covariance, looked.covariance)


def test_another_load_taken_at_a_stop_opens_the_question_again() -> None:
    start = fed(payload.initial_state(DESIGN.payload), 1.0)
    rolling = fed(start, 60.0, wheels_mps=0.5)
    known = rolling.covariance[0, 0]
    stopped = fed(rolling, 2.0)
    same = fed(stopped, 1.0, wheels_mps=0.5)
    other = fed(stopped, 1.0, wheels_mps=0.5, pitch_rad=0.1)
    assert same.covariance[0, 0] <= known
    assert other.covariance[0, 0] > 1.5 * known
    assert other.mean[1] > same.mean[1] + 1.0


def test_a_kerb_moves_the_estimate_by_no_more_than_three_deviations_would() -> None:
    rolling = fed(fed(payload.initial_state(DESIGN.payload), 1.0), 60.0, wheels_mps=0.5)
    bumped = fed(rolling, 0.1, wheels_mps=0.5, pitch_rad=-0.5)
    assert abs(bumped.mean[1] - rolling.mean[1]) < 3.0 * np.sqrt(rolling.covariance[1, 1])


def test_the_covariance_stays_one() -> None:
    random = np.random.default_rng(1)
    state = payload.initial_state(DESIGN.payload)
    for _ in range(6000):
        a, b, c, d, e = random.standard_normal(5).tolist()
        now = measured(
            roll_rad=0.02 * a,
            pitch_rad=0.02 * b,
            ahead_mps2=c,
            wheels_mps=0.5 + 0.3 * d,
            drive_n=80.0 * c + 20.0,
        )._replace(fresh=e > 1.0)
        state = payload.step(DESIGN.payload, state, now, 0.01)
    covariance = state.covariance
    assert covariance.shape == (STATES, STATES)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert np.isfinite(state.mean).all()


def test_the_foretold_force_has_the_derivatives_it_claims() -> None:
    design, now = DESIGN.payload, measured(wheels_mps=0.7, drive_n=90.0, posed_pitch_rad=0.01)
    mean = np.array([15.0, 3.0, -2.0, 4.0, 0.02, 0.01, 0.005, 0.0, 0.02])
    row, value = payload._driven(design, mean, now, 0.6, 0.5)
    for index in (MASS, 1, 3, 8):
        step = 1e-4
        moved = mean.copy()
        moved[index] += step
        slope = (payload._driven(design, moved, now, 0.6, 0.5)[1] - value) / step
        assert row[index] == pytest.approx(slope, rel=0.15, abs=2e-3)


def test_a_place_means_nothing_without_a_load() -> None:
    nothing = payload.payload(DESIGN.payload, payload.initial_state(DESIGN.payload))
    assert nothing.place_m == (0.0, 0.0, 0.0)
    assert nothing.place_sigma_m == (UNKNOWN_M,) * 3


def test_without_samples_the_robot_counts_as_empty() -> None:
    state = wheel_loads.initial_state(DESIGN)
    after, loads = wheel_loads.step(DESIGN, state, Inputs(0.0, armed=False), Estimate(), 0.005)
    assert after is state
    assert loads == DESIGN.empty
