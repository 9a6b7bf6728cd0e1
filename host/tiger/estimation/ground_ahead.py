"""How far the ground under the wheels will turn over the next moments, from what they have rolled over.

Of the ground to come a robot that drives straight on knows half: the rear wheels roll where the front ones
have rolled. The other half, before the front wheels, goes on much as it did. Both follow from one thing, how
alike ground is over distance. That of ISO 8608, of a spectrum n^-2, is a random walk,

    E[(z(a) - z(b))^2] ~ |a - b|   and less near by, where waves shorter than some length are missing,

on a surface equally rough in every direction, and smooth over a length because tyres and springs make it so.
Roll and pitch of the plane under four wheels are differences of heights, so this gives the covariance of any
two of them, and with it the least-squares estimate of slopes to come from slopes passed (kriging; Matheron,
Principles of geostatistics, 1963). The mean slope of a hill is unknown and goes on.

How short the shortest waves are decides how far ahead the ground can be told at all, and is not known. Nor
is how well the slopes passed are known: a load that swings on its springs looks like ground. So both are
learned: at every step each of a few grounds, its slopes known well or badly, tells the slope of now from
those a little way back, and the one that has been least wrong over the last metres is believed
(multiple-model estimation; Magill, IEEE Trans. Automatic Control 10, 1965). Its share in the errors of all
counts: a jolt weighs no more than any step.

The moments that count begin when what is decided now acts, and are as long as the levelling law takes to
bring a small error down. It aims at the mean of the ground over them, which for slow actuators is as good as
a plan over all that can be foreseen (docs/uneven-terrain.md). The weights are a table over speed, made once;
slopes are remembered at every step of the way, and at each a product with the table tells what to expect.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import itj0y0, j0, j1

from tiger.control.attitude import design_leveling
from tiger.frozen import dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.config.vehicle import BodyConfig
    from tiger.record import Estimate, Four

    Array = NDArray[np.float64]

_SPEEDS = 61
_LOOKS = 8
"""Points in time whose mean is that over the moments ahead."""
_FINE_M = 0.005
"""Between two places where the covariance is computed."""
_EXACT_RAD2 = 1e-12
"""Square of an error that is none."""
_ANY_SLOPE = 1e3
"""Variance of the mean slope of the ground over that of its unevenness: unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class AheadDesign:
    """What `design_ahead` computes once."""

    step_m: float
    middle_s: float
    """From now to the middle of the moments ahead."""
    rolling_mps: float
    fade_per_rad: float
    """How much of what is known a bend makes void, each step."""
    settle: float
    """How much more is known after each step."""
    speed_step_mps: float
    table: Array
    """(grounds, speeds, axis, 2, taps), a ground being its shortest wave and a noise: weights of the slopes
    at the last steps, newest first, that give the mean slope ahead less that of now; just at a step, and a
    step later."""
    trial: Array
    """(axis, grounds, taps): the same that give how far off the newest each ground would have told."""
    learn: float
    """Weight of the newest trial in the mean."""


@dataclass(frozen=True, slots=True, eq=False)
class AheadState:
    """What a tick leaves to the next; angles in rad."""

    slopes: Array
    """Of the ground in roll and in pitch (2, taps), newest first."""
    wrong: Array
    """Mean share of each ground in how far off all were (grounds,)."""
    turn_rad: Four = (0.0, 0.0, 0.0, 0.0)
    """Turn ahead in roll, just at the last step and a step later; and in pitch."""
    known: float = 0.0
    """How much of the slopes has been seen, 0 to 1."""
    stepped_m: float = 0.0
    """Distance and heading of the last step."""
    yaw_rad: float = 0.0
    forwards: bool = True


def design_ahead(robot: RobotConfig) -> AheadDesign:
    """Compute the tables, in some tens of milliseconds."""
    config, body, leveling = robot.leveling, robot.vehicle.body, design_leveling(robot)
    # u = k error - d rate of an integrator behind a lag: it meets what is (1 + d)/k ahead.
    middle_s = (1.0 + leveling.rate_gain) / leveling.error_gain_per_s
    looks_s = leveling.lag_s + (middle_s - leveling.lag_s) * (2.0 * np.arange(_LOOKS) + 1.0) / _LOOKS
    step_m, taps = config.ahead_step_m, round(config.ahead_memory_m / config.ahead_step_m)
    speeds = np.linspace(0.0, robot.drive.max_speed_mps, _SPEEDS)
    now_m = np.array([0.0, step_m])
    then_m = now_m[:, None] + speeds[:, None, None] * looks_s
    past_m: Array = -step_m * np.arange(taps, dtype=np.float64)
    back = round(config.ahead_trial_m / step_m)
    grounds = tuple(product(config.ahead_waves_m, config.ahead_noise))
    table = np.empty((len(grounds), _SPEEDS, 2, 2, taps))
    trial = np.zeros((2, len(grounds), taps))
    trial[..., 0], trial[..., back] = 1.0, -1.0
    apart_m = np.arange(0.0, then_m.max() - past_m[-1] + _FINE_M, _FINE_M)
    for ground, (wave_m, noise) in enumerate(grounds):
        for axis, common in enumerate(_in_common(body, wave_m, config.ahead_smooth_m, apart_m)):
            slope = _Slope(apart_m, common, noise)
            table[ground, :, axis] = slope.turn(now_m, then_m, past_m)
            trial[axis, ground, back:] -= slope.turn(past_m[back], past_m[:1], past_m[back:])
    return AheadDesign(
        step_m=step_m,
        middle_s=middle_s,
        rolling_mps=config.rolling_mps,
        fade_per_rad=1.0 / math.radians(config.ahead_fade_deg),
        settle=step_m / body.wheelbase_m,
        speed_step_mps=float(speeds[1]),
        table=table,
        trial=trial,
        learn=step_m / config.ahead_learn_m,
    )


def _in_common(body: BodyConfig, wave_m: float, smooth_m: float, apart_m: Array) -> Array:
    """Return the covariance of two slopes so far apart, but for a factor, in roll and in pitch (2, n)."""

    def differ(x_m: Array, y_m: float) -> Array:
        """Mean square by which heights differ: the sum over the plane's waves, k^-3 up to 1/wave_m."""
        far_m: Array = np.sqrt(x_m**2 + y_m**2 + smooth_m**2)
        if wave_m == 0.0:
            return far_m
        phase = math.tau / wave_m * far_m
        return np.asarray(far_m * (itj0y0(phase)[0] - j1(phase) - (1.0 - j0(phase)) / phase))

    def axle(x_m: Array) -> Array:
        """Covariance of two axles' slopes, and of their mean heights."""
        track, tracks = differ(x_m, 0.0), differ(x_m, 2.0 * body.half_track_m)
        return np.stack([tracks - track, -tracks - track])

    other = axle(apart_m + body.wheelbase_m) + axle(apart_m - body.wheelbase_m)
    return 2.0 * axle(apart_m) + np.array([[1.0], [-1.0]]) * other


@dataclass(frozen=True, slots=True, eq=False)
class _Slope:
    """Roll or pitch of the ground under the wheels along the way: its covariance over distance, both (n,)."""

    apart_m: Array
    common: Array
    noise: float

    def turn(self, from_m: Array, to_m: Array, seen_m: Array) -> Array:
        """Return the weights of slopes seen that tell the mean slope of the places `to_m` less that at
        `from_m`: (..., m), (...) and (n,) give (..., n)."""
        wanted = self._with(to_m, seen_m).mean(axis=-2) - self._with(from_m, seen_m)
        noise = self.common[0] * (_ANY_SLOPE + self.noise * np.eye(len(seen_m)))
        weights = np.linalg.solve(self._with(seen_m, seen_m) + noise, wanted.reshape(-1, len(seen_m)).T).T
        return np.asarray(weights.reshape(wanted.shape))

    def _with(self, at_m: Array, seen_m: Array) -> Array:
        return np.interp(np.abs(at_m[..., None] - seen_m), self.apart_m, self.common)


def initial_state(design: AheadDesign) -> AheadState:
    """Return the state before the first metre: nothing is known."""
    return AheadState(np.zeros((2, design.table.shape[-1])), np.zeros(len(design.table)))


def step(design: AheadDesign, state: AheadState, estimate: Estimate) -> AheadState:
    """Take in the slopes under the wheels once a step has been driven, by this tick's odometry."""
    where = estimate.odometry
    over_m = where.distance_m - state.stepped_m - design.step_m
    if over_m < 0.0:
        return state
    speed, forwards, known = abs(where.speed_mps), where.speed_mps >= 0.0, state.known
    if forwards != state.forwards or over_m > design.step_m:
        known = over_m = 0.0
    since_s = over_m / speed if speed > design.rolling_mps else 0.0
    slopes = np.empty(state.slopes.shape)
    slopes[:, 1:] = state.slopes[:, :-1]
    slopes[0, 0] = estimate.plate_roll_rad - since_s * estimate.plate_roll_rate_radps
    slopes[1, 0] = estimate.plate_pitch_rad - since_s * estimate.plate_pitch_rate_radps
    if known == 0.0:  # as far as anyone knows, the ground was even
        slopes[:] = slopes[:, :1]
    bend = abs(math.remainder(where.yaw_rad - state.yaw_rad, math.tau))
    known = max(0.0, known - design.fade_per_rad * bend)
    known += (1.0 - known) * design.settle
    off_roll, off_pitch = (design.trial @ slopes[:, :, None])[..., 0]
    off_rad2 = off_roll**2 + off_pitch**2 + _EXACT_RAD2
    wrong = state.wrong + design.learn * known * (off_rad2 / off_rad2.sum() - state.wrong)
    ground = int(wrong.argmin())  # the first one, until another has been less wrong
    weights = design.table[ground, min(round(speed / design.speed_step_mps), _SPEEDS - 1)]
    (roll, roll_later), (pitch, pitch_later) = (weights @ slopes[:, :, None])[..., 0].tolist()
    turn_rad = roll, roll_later, pitch, pitch_later
    return AheadState(slopes, wrong, turn_rad, known, where.distance_m - over_m, where.yaw_rad, forwards)


def turning_radps(design: AheadDesign, state: AheadState, estimate: Estimate) -> tuple[float, float]:
    """Return the rates of roll and pitch at which the ground goes to where it will be in the mean.

    As far as that is not known, and standing, the observer's.
    """
    roll_rate, pitch_rate = estimate.plate_roll_rate_radps, estimate.plate_pitch_rate_radps
    where = estimate.odometry
    sure = min(1.0, abs(where.speed_mps) / design.rolling_mps - 1.0) * state.known
    if sure <= 0.0:
        return roll_rate, pitch_rate
    part = (where.distance_m - state.stepped_m) / design.step_m
    roll, roll_later, pitch, pitch_later = state.turn_rad
    roll, pitch = roll + part * (roll_later - roll), pitch + part * (pitch_later - pitch)
    return (
        roll_rate + sure * (roll / design.middle_s - roll_rate),
        pitch_rate + sure * (pitch / design.middle_s - pitch_rate),
    )
