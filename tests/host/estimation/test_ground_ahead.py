"""How far the ground will turn: told from slopes passed, on ground that is known here in full."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.emulation.ground import make_terrain
from tiger.emulation.scenarios import RoughConfig, TerrainConfig
from tiger.estimation import ground_ahead
from tiger.estimation.ground_ahead import AheadDesign, AheadState, design_ahead, initial_state, turning_radps
from tiger.record import Estimate, Odometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Slopes = Callable[[float], tuple[float, float]]

ROBOT = load_robot()
DESIGN = design_ahead(ROBOT)
# Slopes are known exactly here, and no load swings on the springs: they may be believed.
TRUSTING = design_ahead(
    ROBOT.model_copy(update={"leveling": ROBOT.leveling.model_copy(update={"ahead_noise": (1e-4,)})})
)
BODY = ROBOT.vehicle.body
DT = 0.005
ROLL_OF_HILL, PITCH_OF_HILL = math.radians(3.0), math.radians(-6.0)


def hill(x_m: float) -> tuple[float, float]:
    return ROLL_OF_HILL, PITCH_OF_HILL


def seen(slopes: Slopes, at_m: float, speed_mps: float, yaw_rad: float = 0.0) -> Estimate:
    """What the observer and the odometry say when the slopes (roll, pitch) at the place are known."""
    roll, pitch = slopes(at_m)
    roll_on, pitch_on = slopes(at_m + 0.001)
    way = abs(speed_mps) / 0.001
    return Estimate(
        ready=True,
        plate_roll_rad=roll,
        plate_pitch_rad=pitch,
        plate_roll_rate_radps=way * (roll_on - roll),
        plate_pitch_rate_radps=way * (pitch_on - pitch),
        speed_mps=speed_mps,
        odometry=Odometry(speed_mps=speed_mps, distance_m=at_m, yaw_rad=yaw_rad),
    )


def driven(
    slopes: Slopes, speed_mps: float, way_m: float, design: AheadDesign = DESIGN
) -> tuple[AheadState, NDArray[np.float64]]:
    """Drive, and return at every tick the way, the rates told, and those of now."""
    state = initial_state(design)
    rows, x = [], 0.0
    while x < way_m:
        now = seen(slopes, x, speed_mps)
        state = ground_ahead.step(design, state, now)
        rows.append((x, *turning_radps(design, state, now), *rates(now)))
        x += abs(speed_mps) * DT
    return state, np.array(rows)


def rates(estimate: Estimate) -> tuple[float, float]:
    return estimate.plate_roll_rate_radps, estimate.plate_pitch_rate_radps


@cache
def rolling_ground(seed: int, shortest_wave_m: float = 1.0) -> Slopes:
    """Slopes under the four wheels on rolling ground of class D, its axis along the robot's way."""
    rough = RoughConfig(roughness="D", size_m=(60.0, 20.0), shortest_wave_m=shortest_wave_m, seed=seed)
    terrain = make_terrain(TerrainConfig(rough=rough), BODY.half_track_m)
    x = np.arange(0.0, 50.0, 0.01)
    a, b, y = BODY.com_to_front_axle_m, BODY.com_to_rear_axle_m, BODY.half_track_m
    fl, fr, rl, rr = (
        terrain.at(5.0 + x + ahead, np.full_like(x, left))[0]
        for ahead, left in ((a, y), (a, -y), (-b, y), (-b, -y))
    )
    roll, pitch = (fl - fr + rl - rr) / (4.0 * y), (rl + rr - fl - fr) / (2.0 * (a + b))
    return lambda at: (float(np.interp(at, x, roll)), float(np.interp(at, x, pitch)))


def turn_to_come(slopes: Slopes, speed_mps: float, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """What should be told, (n, 2): the mean over the moments ahead less what is there now."""
    lag_s = ROBOT.actuator.lag_s + ROBOT.leveling.setpoint_delay_s
    looks_s = np.linspace(lag_s, 2.0 * DESIGN.middle_s - lag_s, 15)
    return np.array(
        [np.mean([slopes(x + speed_mps * s) for s in looks_s], axis=0) - slopes(x) for x in places_m.tolist()]
    )


@pytest.mark.parametrize(("speed_mps", "over_rate"), [(0.8, 1.1), (1.4, 0.85), (2.8, 0.75)])
@pytest.mark.parametrize("seed", [1, 2])
def test_on_rough_ground_it_knows_more_the_faster_it_goes(
    speed_mps: float, over_rate: float, seed: int
) -> None:
    slopes = rolling_ground(seed)
    _, rows = driven(slopes, speed_mps, 38.0, TRUSTING)
    rows = rows[rows[:, 0] > 3.0][::10]
    true = turn_to_come(slopes, speed_mps, rows[:, 0])
    told, rate = DESIGN.middle_s * rows[:, 1:3] - true, DESIGN.middle_s * rows[:, 3:5] - true
    assert (told.std(axis=0) < over_rate * rate.std(axis=0)).all()
    assert (told.std(axis=0) < 0.75 * true.std(axis=0)).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(0.2, 3.0))
def test_a_hill_of_any_slope_goes_on(speed_mps: float) -> None:
    _, rows = driven(hill, speed_mps, 4.0)
    assert np.abs(rows[:, 1:3]).max() < math.radians(0.05)


def only(ground: int) -> AheadDesign:
    """Return the design that knows of one ground alone."""
    return replace(DESIGN, table=DESIGN.table[[ground]], trial=DESIGN.trial[:, [ground]])


def missed(slopes: Slopes, design: AheadDesign) -> float:
    """How far off what is told is, RMS of roll and pitch after some metres."""
    speed_mps = 1.4
    _, rows = driven(slopes, speed_mps, 38.0, design)
    rows = rows[rows[:, 0] > 8.0][::10]
    told = design.middle_s * rows[:, 1:3] - turn_to_come(slopes, speed_mps, rows[:, 0])
    return float(np.sqrt((told.std(axis=0) ** 2).sum()))


GROUNDS = list(product(ROBOT.leveling.ahead_waves_m, ROBOT.leveling.ahead_noise))
LONG_WAVES = GROUNDS.index((1.0, max(ROBOT.leveling.ahead_noise)))


def believed(state: AheadState) -> tuple[float, float]:
    """Shortest wave and noise of the ground that was least wrong."""
    return GROUNDS[int(state.wrong.argmin())]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ground_without_short_waves_is_told_further_ahead(seed: int) -> None:
    slopes = rolling_ground(seed)
    state, _ = driven(slopes, 1.4, 20.0)
    assert believed(state)[0] >= 0.7
    assert missed(slopes, DESIGN) < 0.8 * missed(slopes, only(0))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_broken_ground_is_told_with_caution(seed: int) -> None:
    slopes = rolling_ground(seed, 0.2)
    state, _ = driven(slopes, 1.4, 20.0)
    assert believed(state)[0] < 0.5
    assert missed(slopes, DESIGN) < 0.7 * missed(slopes, only(LONG_WAVES))


@pytest.mark.parametrize(("swing_deg", "noise"), [(0.0, min), (0.1, max)])
def test_slopes_that_a_swinging_load_bends_are_trusted_less(
    swing_deg: float, noise: Callable[..., float]
) -> None:
    """At 1 m/s a swing of 2 Hz looks like waves of half a metre."""
    slopes = rolling_ground(1)

    def swung(x: float) -> tuple[float, float]:
        swing = math.radians(swing_deg) * math.sin(2.0 * math.tau * x)
        roll, pitch = slopes(x)
        return roll + swing, pitch + swing

    state, _ = driven(swung, 1.0, 20.0)
    assert believed(state)[1] == noise(ROBOT.leveling.ahead_noise)


def test_it_learns_when_the_ground_breaks_up() -> None:
    rolling, broken = rolling_ground(1), rolling_ground(1, 0.2)
    state, _ = driven(
        lambda x: rolling(x) if x < 20.0 else broken(x), 1.4, 20.0 + 2.0 * ROBOT.leveling.ahead_learn_m
    )
    assert believed(state)[0] < 0.5


def test_a_jolt_teaches_no_more_than_any_step() -> None:
    """A start rocks the body for a moment, all grounds are wrong by far: slopes may count less."""
    slopes = rolling_ground(1)

    def jolted(x: float) -> tuple[float, float]:
        roll, pitch = slopes(x)
        return roll, pitch + (math.radians(10.0) if 18.0 < x < 18.1 else 0.0)

    quiet, _ = driven(slopes, 1.4, 20.5)
    shaken, _ = driven(jolted, 1.4, 20.5)
    (wave_m, noise), (shaken_wave_m, shaken_noise) = believed(quiet), believed(shaken)
    assert shaken_wave_m == wave_m
    assert shaken_noise >= noise
    assert shaken.wrong.sum() == pytest.approx(quiet.wrong.sum())


@pytest.mark.parametrize("ground", range(len(GROUNDS)))
def test_a_trial_of_a_slope_that_goes_on_finds_nothing_wrong(ground: int) -> None:
    assert np.abs(DESIGN.trial[:, ground].sum(axis=1)).max() < 1e-3
    assert (DESIGN.trial[:, ground, 0] == 1.0).all()


def test_a_mound_on_even_ground_is_told_no_worse_than_by_the_present_rate() -> None:
    """Its shape is none of rough ground, and nothing could be learned before."""
    shares = []
    for length_m in (0.8, 1.5, 3.0):

        def mound(x: float, length_m: float = length_m) -> tuple[float, float]:
            front, rear = (
                0.02 * math.sin(math.pi * min(max((at - 10.0) / length_m, 0.0), 1.0)) ** 2
                for at in (x, x - BODY.wheelbase_m)
            )
            return 0.0, (rear - front) / BODY.wheelbase_m

        _, rows = driven(mound, 1.4, 15.0)
        rows = rows[rows[:, 0] > 9.0]
        true = turn_to_come(mound, 1.4, rows[:, 0])
        told, rate = DESIGN.middle_s * rows[:, 1:3] - true, DESIGN.middle_s * rows[:, 3:5] - true
        assert np.abs(told[:, 0]).max() < 1e-9
        shares.append(told[:, 1].std() / rate[:, 1].std())
    assert max(shares) < 1.1
    assert np.mean(shares) < 0.97


def test_a_robot_that_stands_is_told_the_present_rate() -> None:
    state, _ = driven(rolling_ground(1), 1.0, 5.0)
    turning = replace(seen(hill, 5.0, 0.0), plate_roll_rate_radps=0.02, plate_pitch_rate_radps=-0.01)
    assert turning_radps(DESIGN, state, turning) == (0.02, -0.01)


def test_nothing_is_known_before_the_first_metre() -> None:
    state = initial_state(DESIGN)
    now = replace(seen(hill, 0.01, 1.0), plate_roll_rate_radps=0.02)
    assert turning_radps(DESIGN, state, now) == pytest.approx((0.02, 0.0))


@pytest.mark.parametrize("change", ["a sharp bend", "backwards", "a leap"])
def test_slopes_that_no_wheel_will_meet_again_are_forgotten(change: str) -> None:
    slopes = rolling_ground(1)
    state, _ = driven(slopes, 1.0, 6.0)
    assert state.known > 0.99
    x = state.stepped_m + 1.1 * DESIGN.step_m
    after = {
        "a sharp bend": seen(slopes, x, 1.0, yaw_rad=math.radians(ROBOT.leveling.ahead_fade_deg)),
        "backwards": seen(slopes, x, -1.0),
        "a leap": seen(slopes, x + 1.0, 1.0),
    }[change]
    state = ground_ahead.step(DESIGN, state, after)
    assert state.known < 0.1


def test_between_two_steps_nothing_is_computed() -> None:
    state, _ = driven(hill, 1.0, 3.0)
    assert ground_ahead.step(DESIGN, state, seen(hill, state.stepped_m + 0.5 * DESIGN.step_m, 1.0)) is state


def test_the_rates_told_are_smooth_enough_to_act_on() -> None:
    """From step to step what is told changes little: no more than the ground itself."""
    _, rows = driven(rolling_ground(2), 1.4, 30.0)
    told, rate = rows[600:, 1:3], rows[600:, 3:5]
    assert (np.abs(np.diff(told, axis=0)).max(axis=0) < 0.25 * np.abs(rate).max(axis=0)).all()
