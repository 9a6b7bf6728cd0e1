"""The ground's cross slope along the wheels' track: the rear wheels roll where the front ones have rolled.

The observer's slope of the ground in roll is the mean of the slopes under the front and the rear axle. On
its own it says nothing of their difference, the twist. But the slope under the rear axle is the one that
the front axle had a wheelbase earlier, so the mean, followed over the distance driven, tells both:

    front now = 2 mean now - front of a wheelbase ago

The recursion alone never forgets an error; a steady-state Kalman filter over the slopes between the axles
(a delay line in steps of distance, fed by ground of a known restlessness) does, but slowly: slopes that
alternate from one wheelbase to the next have no mean. Where the mean has stayed the same for a whole
wheelbase, and the filter's slopes differ from it by no more than they may be wrong, ground without twist is
far likelier than ground that mirrors itself so, and they give way to the mean. Heights are in mm, half the
difference of left and right wheel: front minus rear is twice the twist. Turning on the spot leads the rear
wheels beside the track, and what is known fades. Backwards the axles change parts.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tiger.estimation.kalman import steady_state_gain
from tiger.frozen import dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate

    Array = NDArray[np.float64]

_STEPS = 20
"""Of the wheelbase."""
_CALM_SIGMAS = 3.0
"""Of the measurement: a mean that changes by less has stayed the same."""
_NONE_SIGMAS = 3.0
"""Of the twist: slopes that differ from their mean by less may have none."""
_CALMING = 0.25
"""Of the wheelbase: where it has, two thirds of what the slopes differ from it go within this."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackDesign:
    """What `design_track` computes once. States: half differences of height from the leading to the trailing
    axle, and how much the next one will differ."""

    step_m: float
    half_track_mm: float
    transition: Array
    gain: Array
    sigma_mm: float
    """Of the twist, once the filter has settled."""
    unknown_mm: float
    settle_m: float
    fade_rad: float
    calm_mm: float
    calming: float


@dataclass(frozen=True, slots=True, eq=False)
class TrackState:
    """Slopes known, how well (0 to 1), and where the last one was taken."""

    x: Array
    known: float = 0.0
    travelled_m: float = 0.0
    yaw_rad: float = 0.0
    forwards: bool = True
    calm_mm: float = 0.0
    """The mean slope that has stayed the same ..."""
    calm_m: float = 0.0
    """... over this distance."""


def design_track(robot: RobotConfig) -> TrackDesign:
    """Design the gain for ground of the config's restlessness."""
    config, body = robot.contact, robot.vehicle.body
    step_m = body.wheelbase_m / _STEPS
    n = _STEPS + 2
    keep, bend = math.exp(-step_m / config.track_length_m), math.exp(-step_m / config.track_bend_m)
    a = np.zeros((n, n))
    a[0, 0], a[0, -1] = keep, 1.0
    a[1 : _STEPS + 1, :_STEPS] = np.eye(_STEPS)
    a[-1, -1] = bend
    c = np.zeros((1, n))
    c[0, 0] = c[0, _STEPS] = 0.5
    process = np.zeros((n, n))
    process[-1, -1] = (config.track_noise_mm * step_m) ** 2 * (1.0 - bend**2)
    process[0, 0] = 0.1**2 * step_m
    half_track_mm = 1000.0 * body.half_track_m
    noise = (math.radians(config.track_attitude_noise_deg) * half_track_mm) ** 2
    settled = steady_state_gain(a, c, process, np.array([[noise]]))
    difference = np.zeros(n)
    difference[0], difference[_STEPS] = 0.5, -0.5
    return TrackDesign(
        step_m=step_m,
        half_track_mm=half_track_mm,
        transition=a,
        gain=settled.gain[:, 0],
        sigma_mm=max(config.track_sigma_mm, math.sqrt(difference @ settled.posterior @ difference)),
        unknown_mm=config.expected_twist_mm,
        settle_m=body.wheelbase_m,
        fade_rad=math.radians(config.track_fade_deg),
        calm_mm=_CALM_SIGMAS * math.sqrt(noise),
        calming=math.exp(-1.0 / (_CALMING * _STEPS)),
    )


def initial_state(design: TrackDesign) -> TrackState:
    """Return the state before the first metre: nothing is known."""
    return TrackState(np.zeros(len(design.transition)))


def step(design: TrackDesign, state: TrackState, estimate: Estimate) -> TrackState:
    """Advance by every length of `step_m` that was driven, forwards or backwards."""
    where = estimate.odometry
    driven_m = where.distance_m - state.travelled_m
    if driven_m < design.step_m:
        return state
    x, known, forwards = state.x, state.known, where.speed_mps >= 0.0
    measured = design.half_track_mm * estimate.plate_roll_rad
    calm_mm, calm_m = state.calm_mm, state.calm_m
    if abs(measured - calm_mm) > design.calm_mm:
        calm_mm, calm_m = measured, 0.0
    if forwards != state.forwards:
        x = np.concatenate([x[_STEPS::-1], [0.0]])
    if known == 0.0:  # as far as anyone knows, the ground between the axles is even
        x = np.concatenate([np.full(_STEPS + 1, measured), [0.0]])
    fade = math.exp(-abs(math.remainder(where.yaw_rad - state.yaw_rad, math.tau)) / design.fade_rad)
    x = np.concatenate([measured + fade * (x[:-1] - measured), x[-1:]])
    known *= fade
    for _ in range(min(_STEPS, int(driven_m / design.step_m))):
        x = design.transition @ x
        x = x + design.gain * (measured - 0.5 * (x[0] + x[_STEPS]))
        known += (1.0 - known) * design.step_m / design.settle_m
        calm_m += design.step_m
        if calm_m > design.settle_m and np.abs(x[:-1] - measured).max() < _NONE_SIGMAS * design.sigma_mm:
            x[:-1] = measured + design.calming * (x[:-1] - measured)
            x[-1] *= design.calming
    travelled_m = state.travelled_m + design.step_m * int(driven_m / design.step_m)
    return TrackState(x, known, travelled_m, where.yaw_rad, forwards, calm_mm, calm_m)


def twist(design: TrackDesign, state: TrackState) -> tuple[float, float]:
    """Return the ground's twist under the wheels in mm, and its standard deviation.

    Positive: the ground is high under FL and RR. Driving backwards, the leading axle is the rear one.
    """
    lead = 1.0 if state.forwards else -1.0
    found = 0.5 * lead * float(state.x[0] - state.x[_STEPS])
    known = state.known
    sigma = math.hypot(known * design.sigma_mm, (1.0 - known) * design.unknown_mm)
    return known * found, sigma
