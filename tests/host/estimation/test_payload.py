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
from tiger.estimation.payload import MASS, ROLLING, STATES, UNKNOWN_M
from tiger.estimation.tilt_error import TiltError
from tiger.models.full_car import FullCarParameters
from tiger.record import Estimate, Inputs, Loads
from tiger.studies import side_limit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from conftest import Tick

    Roll = Callable[..., Iterator[Tick]]

ROBOT = load_robot(None)
EXACT = TiltError()
"""The IMU's attitude is off by nothing here."""
DESIGN = wheel_loads.design_loads(ROBOT)
LEG_S = 5.0
G = 9.80665


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


def half_turn(time_s: float) -> tuple[float, float]:
    """Start, roll, stop, every five seconds for half a minute; four legs are arcs, half a turn in all."""
    phase = (time_s - 1.0) % LEG_S
    speed = max(0.0, min(phase, 1.0, 4.0 - phase)) if time_s >= 1.0 else 0.0
    turning = 6.0 <= time_s < 26.0 and 0.8 < phase < 3.2
    return speed, 0.8 if turning else 0.0


def quarter_turn(time_s: float) -> tuple[float, float]:
    """The same with two arcs."""
    speed, yaw_rate = half_turn(time_s)
    return speed, yaw_rate if 11.0 <= time_s < 21.0 else 0.0


def scenario(of: Case, for_s: float = 31.0) -> Scenario:
    return Scenario(
        title="load",
        duration_s=for_s,
        friction=0.5,  # on asphalt the motors cannot turn the robot
        payload=PayloadConfig(mass_kg=of.mass_kg, place_m=of.place_m) if of.mass_kg else None,
        start=Start(x_m=30.0, yaw_deg=of.yaw_deg),
        terrain=of.terrain,
    )


def driven(
    roll: Roll,
    of: Case,
    seed: int,
    along: Callable[[float], tuple[float, float]] = half_turn,
    for_s: float = 31.0,
) -> Loads:
    """What is said of the load after the drive."""
    state, estimate = wheel_loads.initial_state(DESIGN), Estimate(ready=True)
    for tick in roll(ROBOT, scenario(of, for_s), along, seed):
        state, loads = wheel_loads.step(DESIGN, state, tick.inputs, estimate, EXACT, 0.005)
        estimate = replace(estimate, loads=loads)
    return estimate.loads


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_load_is_found_within_thirty_seconds_of_driving(roll: Roll, seed: int) -> None:
    of = case(seed)
    said = driven(roll, of, seed)
    assert said.payload_kg == pytest.approx(20.0, abs=3.0)  # the bar, of twenty: below
    off = np.abs(np.subtract(said.payload_m, of.place_m))
    assert off[0] < 0.05
    assert off[1] < 0.05
    assert off[2] < 0.1
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
        return half_turn(time_s)[0], 0.0

    of = case(5)
    said = driven(roll, of, 5, straight)
    assert abs(said.payload_m[0] - of.place_m[0]) < 0.07
    assert said.payload_sigma_m[1] > 0.15
    assert abs(said.payload_m[1] - of.place_m[1]) < 3.0 * said.payload_sigma_m[1]


def least_sigma_m(roll: Roll, of: Case, seed: int) -> float:
    """How well the place to the side could be told after the half turn, with the ground's class known."""
    terrain = of.terrain
    assert terrain.rough is not None
    path = [
        (*tick.truth.position_m[:2], tick.attitude_rad[2])
        for tick in roll(ROBOT, scenario(of), half_turn, seed)
    ]
    waves_m = (terrain.rough.shortest_wave_m, terrain.rough.size_m[0])
    corners_m = FullCarParameters.from_config(ROBOT.vehicle).corner_positions_m()
    return side_limit.least_sigma_m(
        DESIGN.payload,
        corners_m,
        np.array(path),
        terrain.rough.roughness,
        waves_m,
        np.radians(1.5),
        of.mass_kg,
    )


@pytest.mark.parametrize("seed", [1000, 1001, 1003])
def test_the_side_is_not_said_to_be_known_better_than_the_ground_lets_it(roll: Roll, seed: int) -> None:
    """Classes B, C and B: some 1.5 cm, twice as much on the rougher one, and never less in the filter."""
    of = case(seed)
    least = least_sigma_m(roll, of, seed)
    assert 0.01 < least < 0.06
    assert driven(roll, of, seed).payload_sigma_m[1] > least


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("along", "to_the_side"), [(half_turn, 20), (quarter_turn, 18)])
def test_twenty_loads_anywhere_on_the_deck(
    roll: Roll,
    record_figure: Callable[[str, object, str], None],
    along: Callable[[float], tuple[float, float]],
    to_the_side: int,
) -> None:
    """Classes A to C, slopes of 1.5 degrees, half a minute of starts and stops with half a turn on the way.

    With a quarter of a turn a load to one side is told from a slope to the side less well.
    """
    errors = []
    for seed in range(20, 40):
        of = case(seed)
        said = driven(roll, of, seed, along)
        errors.append([said.payload_kg - 20.0, *np.subtract(said.payload_m, of.place_m)])
    mass, x, y, z = np.abs(errors).T
    drive = along.__name__.replace("_", " ")
    record_figure(f"payload's mass off, RMS ({drive})", f"{np.sqrt(np.mean(mass**2)):.2f} kg", "")
    record_figure(f"payloads of 20 kg found within 10 %, of 20 ({drive})", int((mass <= 2.0).sum()), "20")
    record_figure(f"payloads placed within 5 cm ahead, of 20 ({drive})", int((x <= 0.05).sum()), "20")
    record_figure(f"payloads placed within 5 cm to the side, of 20 ({drive})", int((y <= 0.05).sum()), "20")
    record_figure(f"payload's height off, RMS ({drive})", f"{100.0 * np.sqrt(np.mean(z**2)):.1f} cm", "")
    assert (mass <= 2.0).sum() == 20
    assert (x <= 0.05).sum() == 20
    assert (y <= 0.05).sum() >= to_the_side


# ---- without a vehicle ----------------------------------------


def measured(**changes: Any) -> payload.Measured:
    still = payload.Measured(*[0.0] * 11, fresh=False, straight=True)
    return still._replace(**changes)


def seen_with(**changes: float) -> payload._Means:
    nothing = payload._Means(*[0.0] * 15, tells=True)
    return nothing._replace(**changes)  # type: ignore[arg-type]


def slopes(of: Callable[[np.ndarray], float], mean: np.ndarray) -> np.ndarray:
    """Derivatives (9,) by differences."""
    steps = 1e-4 * np.eye(STATES)
    return np.array([(of(mean + step) - of(mean - step)) / 2e-4 for step in steps])


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
    design, seen = DESIGN.payload, seen_with(drive_n=90.0, spin_mps2=0.5, direction=1.0)
    mean = np.array([15.0, 3.0, -2.0, 4.0, 0.02, 0.01, 0.005, 0.0, 0.02])
    row, value = payload._driven(design, mean, seen)
    np.testing.assert_allclose(row, slopes(lambda of: payload._driven(design, of, seen)[1], mean), atol=1e-6)
    assert value == pytest.approx((90.0 - design.spin_kg * 0.5) / 94.9 - G * (0.025 + 0.02), abs=1e-3)


def test_the_foretold_roll_has_the_derivatives_it_claims() -> None:
    design, seen = DESIGN.payload, seen_with(tilting_left_mps2=0.6)
    mean = np.array([15.0, 3.0, -2.0, 4.0, 0.02, 0.01, 0.005, 0.0, 0.02])
    row, _ = payload._rolled(design, mean, seen, 0.0)
    measured_slopes = slopes(lambda of: payload._rolled(design, of, seen, 0.0)[1], mean)
    np.testing.assert_allclose(row[1:], measured_slopes[1:], atol=1e-6)
    assert row[MASS] == pytest.approx(
        measured_slopes[MASS], rel=0.5
    )  # springs that weight makes stiffer apart


def test_side_forces_that_answer_the_motors_lean_a_pitched_body() -> None:
    """-30 Nm of yaw moment under 3 degrees of pitch: 1.6 Nm about the roll axis."""
    design, mean = DESIGN.payload, np.zeros(STATES)
    leant = payload._rolled(design, mean, seen_with(yaw_nm=-30.0, posed_pitch_rad=0.0524), 0.0)[1]
    straight = payload._rolled(design, mean, seen_with(posed_pitch_rad=0.0524), 0.0)[1]
    pitch = 0.0524 * (
        1.0 - payload._upright(design, mean) / (design.pitch_nmprad + payload._upright(design, mean))
    )
    assert leant - straight == pytest.approx(
        30.0 * pitch / (design.roll_nmprad + payload._upright(design, mean)), rel=1e-6
    )


def test_side_forces_that_answer_the_motors_pitch_a_leaning_body() -> None:
    """A turn to the left, -30 Nm of yaw moment, under 3 degrees of lean: 1.6 Nm that press the nose down."""
    design, mean = DESIGN.payload, np.zeros(STATES)
    pressed = payload._pitched(design, mean, seen_with(yaw_nm=-30.0, posed_roll_rad=0.0524), 0.0)[1]
    straight = payload._pitched(design, mean, seen_with(posed_roll_rad=0.0524), 0.0)[1]
    upright = payload._upright(design, mean)
    lean = 0.0524 * (1.0 - upright / (design.roll_nmprad + upright))
    assert pressed - straight == pytest.approx(30.0 * lean / (design.pitch_nmprad + upright), rel=1e-6)


def test_the_wheels_that_spin_lean_the_body_outward_in_a_turn() -> None:
    """The moment is the wheels' spin times the yaw rate: a turn to the left presses the right side down."""
    design, mean, tire = DESIGN.payload, np.zeros(STATES), ROBOT.vehicle.tire
    spin_nms = 4.0 * tire.spin_inertia_kgm2 * 1.5 / tire.rolling_radius_m
    span = payload.Span(0.0, 0.0, True, 0.2, 20, direction=20.0, turned_rad=0.16, travelled_m=0.3)
    for sign in (1.0, -1.0):  # back, the same turn leans it inward
        seen = payload._means(design, replace(span, direction=sign * 20.0), measured(), 0.0)
        assert seen.gyroscopic_nm == pytest.approx(sign * 0.8 * spin_nms)
        leant = payload._rolled(design, mean, seen, 0.0)[1]
        assert leant == pytest.approx(
            sign * 0.8 * spin_nms / (design.roll_nmprad + payload._upright(design, mean))
        )


@pytest.mark.parametrize("yaw_rate", [1.5, -1.5])
def test_a_steady_turn_on_flat_ground_is_not_taken_for_a_load(roll: Roll, yaw_rate: float) -> None:
    """2 m/s and 1.3 rad/s lean the robot by 1.4 degrees; what is said of the COM stays within 5 mm."""

    def circle(time_s: float) -> tuple[float, float]:
        return min(2.0, max(0.0, time_s - 1.0)), yaw_rate if time_s > 3.5 else 0.0

    empty = Case((0.0, 0.0, 0.0), 0.0, TerrainConfig(), 0.0)
    said = driven(roll, empty, 1, circle, 10.0)
    assert abs(said.com_m[0]) < 0.004
    assert abs(said.com_m[1]) < 0.004


def test_a_pitching_body_does_not_count_as_gaining_speed() -> None:
    """The accelerometer sits above the centre of all masses and is carried ahead of it."""
    design, mean = DESIGN.payload, np.zeros(STATES)
    swinging = seen_with(gained_mps2=design.imu_height_m * 2.0, turn_radps2=2.0)
    height = design.lever_kgm / design.empty_kg
    assert payload._gained_mps2(design, mean, swinging) == pytest.approx(2.0 * height)


def test_standing_uphill_does_not_count_as_gaining_speed() -> None:
    design = DESIGN.payload
    now = measured(ahead_mps2=G * np.sin(0.1), pitch_rad=-0.06, posed_pitch_rad=-0.04)
    span = payload.step(design, payload.initial_state(design), now, 0.01).span
    assert span is not None
    span = payload.step(design, payload.PayloadState(design.mean, design.covariance, span), now, 0.01).span
    assert span is not None
    assert payload._means(design, span, now, 0.0).gained_mps2 == pytest.approx(0.0, abs=1e-12)


def test_a_drive_force_that_nothing_explains_opens_the_resistance_of_the_ground() -> None:
    """100 N more, with the same gain of speed for the same gain of force: sand, not a load."""
    design = DESIGN.payload

    def surging(state: payload.PayloadState, resistance_n: float) -> payload.PayloadState:
        """Half a minute of 0.5 m/s2 to and fro, the body on its springs as statics have it."""
        for index in range(1500):
            accel = 0.5 if index // 50 % 2 == 0 else -0.5
            drive_n = resistance_n + (design.empty_kg + design.spin_kg) * accel
            level = payload._pressed_forward(design, np.zeros(STATES), accel, 0.0, drive_n * design.radius_m)[
                1
            ]
            now = measured(
                wheels_mps=0.5 + 0.02 * accel * (index % 50),
                ahead_mps2=accel - G * np.sin(level),
                pitch_rad=level,
                drive_n=drive_n,
                fresh=index % 4 == 0,
            )
            state = payload.step(design, state, now, 0.02)
        return state

    rolling_n = 0.02 * G * design.empty_kg
    firm = surging(payload.initial_state(design), rolling_n)
    assert firm.mean[ROLLING] == pytest.approx(0.02, abs=0.006)
    assert abs(firm.mean[MASS]) < 4.0
    soft = surging(firm, rolling_n + 100.0)
    assert soft.mean[ROLLING] > 0.1
    assert abs(soft.mean[MASS]) < 12.0


def test_a_place_means_nothing_without_a_load() -> None:
    nothing = payload.payload(DESIGN.payload, payload.initial_state(DESIGN.payload))
    assert nothing.place_m == (0.0, 0.0, 0.0)
    assert nothing.place_sigma_m == (UNKNOWN_M,) * 3


def test_without_samples_the_robot_counts_as_empty() -> None:
    state = wheel_loads.initial_state(DESIGN)
    after, loads = wheel_loads.step(DESIGN, state, Inputs(0.0, armed=False), Estimate(), EXACT, 0.005)
    assert after is state
    assert loads == DESIGN.empty
