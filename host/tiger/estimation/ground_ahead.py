"""How far the ground under the wheels will turn over the next moments, from what they have rolled over.

Of the ground to come a robot that drives straight on knows half: the rear wheels roll where the front ones
have rolled. The other half, before the front wheels, goes on much as it did. Both follow from one thing, how
alike ground is over distance. That of ISO 8608, of a spectrum n^-2, is a random walk,

    E[(z(a) - z(b))^2] ~ sqrt(|a - b|^2 + smooth^2),

on a surface equally rough in every direction, and smooth over a length because tyres and springs make it so.
Roll and pitch of the plane under four wheels are differences of heights, so this gives the covariance of any
two of them, and with it the least-squares estimate of slopes to come from slopes passed (kriging; Matheron,
Principles of geostatistics, 1963). The mean slope of a hill is unknown and goes on.

The moments that count begin when what is decided now acts, and are as long as the levelling law takes to
bring a small error down. It aims at the mean of the ground over them, which for slow actuators is as good as
a plan over all that can be foreseen (docs/uneven-terrain.md). The weights are a table over speed, made once;
slopes are remembered at every step of the way, and at each a product with the table tells what to expect.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.attitude import design_leveling
from tiger.frozen import dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Four

    Array = NDArray[np.float64]

_SPEEDS = 61
_LOOKS = 8
"""Points in time whose mean is that over the moments ahead."""
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
    """(speeds, axis, 2, taps): weights of the slopes at the last steps, newest first, that give the mean
    slope ahead less that of now; just at a step, and a step later."""


@dataclass(frozen=True, slots=True, eq=False)
class AheadState:
    """What a tick leaves to the next; angles in rad."""

    slopes: Array
    """Of the ground in roll and in pitch (2, taps), newest first."""
    turn_rad: Four = (0.0, 0.0, 0.0, 0.0)
    """Turn ahead in roll, just at the last step and a step later; and in pitch."""
    known: float = 0.0
    """How much of the slopes has been seen, 0 to 1."""
    stepped_m: float = 0.0
    """Distance and heading of the last step."""
    yaw_rad: float = 0.0
    forwards: bool = True


def design_ahead(robot: RobotConfig) -> AheadDesign:
    """Compute the table, in some milliseconds."""
    config, body, leveling = robot.leveling, robot.vehicle.body, design_leveling(robot)
    # u = k error - d rate of an integrator behind a lag: it meets what is (1 + d)/k ahead.
    middle_s = (1.0 + leveling.rate_gain) / leveling.error_gain_per_s
    looks_s = leveling.lag_s + (middle_s - leveling.lag_s) * (2.0 * np.arange(_LOOKS) + 1.0) / _LOOKS
    step_m, taps = config.ahead_step_m, round(config.ahead_memory_m / config.ahead_step_m)
    speeds = np.linspace(0.0, robot.drive.max_speed_mps, _SPEEDS)
    now_m = np.array([0.0, step_m])
    then_m = now_m[:, None] + speeds[:, None, None] * looks_s
    past_m = -step_m * np.arange(taps)
    table = np.empty((_SPEEDS, 2, 2, taps))
    x_m = np.array([body.com_to_front_axle_m] * 2 + [-body.com_to_rear_axle_m] * 2)
    y_m = body.half_track_m * np.array([1.0, -1.0, 1.0, -1.0])
    shares = (0.25 / y_m, -0.5 * np.sign(x_m) / body.wheelbase_m)
    for axis, share in enumerate(shares):
        alike = _Alike(x_m, y_m, share, config.ahead_smooth_m)
        own = float(alike.at(np.zeros(1))[0])
        among = alike.at(past_m[:, None] - past_m) + own * (_ANY_SLOPE + config.ahead_noise * np.eye(taps))
        ahead = alike.at(then_m[..., None] - past_m).mean(axis=2) - alike.at(now_m[:, None] - past_m)
        table[:, axis] = np.linalg.solve(among, ahead.reshape(-1, taps).T).T.reshape(_SPEEDS, 2, taps)
    return AheadDesign(
        step_m=step_m,
        middle_s=middle_s,
        rolling_mps=config.rolling_mps,
        fade_per_rad=1.0 / math.radians(config.ahead_fade_deg),
        settle=step_m / body.wheelbase_m,
        speed_step_mps=float(speeds[1]),
        table=table,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Alike:
    """A slope of the ground: `share` of each height under wheels at x and y; all (4,)."""

    x_m: Array
    y_m: Array
    share: Array
    smooth_m: float

    def at(self, apart_m: Array) -> Array:
        """Return its covariance with itself so far on, but for a factor: half of what heights differ by."""
        x = np.subtract.outer(self.x_m, self.x_m) + apart_m[..., None, None]
        y = np.subtract.outer(self.y_m, self.y_m)
        return np.asarray(-0.5 * self.share @ np.sqrt(x**2 + y**2 + self.smooth_m**2) @ self.share)


def initial_state(design: AheadDesign) -> AheadState:
    """Return the state before the first metre: nothing is known."""
    return AheadState(np.zeros((2, design.table.shape[-1])))


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
    weights = design.table[min(round(speed / design.speed_step_mps), _SPEEDS - 1)]
    (roll, roll_later), (pitch, pitch_later) = (weights @ slopes[:, :, None])[..., 0].tolist()
    turn_rad = roll, roll_later, pitch, pitch_later
    return AheadState(slopes, turn_rad, known, where.distance_m - over_m, where.yaw_rad, forwards)


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
