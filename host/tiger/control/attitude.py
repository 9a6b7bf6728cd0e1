"""Suspension control of the real TIGER: the body's attitude and ride height by stroke rates.

The regime is quasi-static. The body follows its four seats within a tenth of a second while a move takes
seconds, so the law acts on the pose of the seats (`reachable.Pose`), whose only dynamics are those of the
actuators: an integrator behind a lag. Three parts, each a function below:

1. a target in stroke space: the pose that gives the wanted attitude on the present ground, or the nearest one
   where the strokes do not reach so far;
2. feedback: an LQR for small errors that saturates for large ones, with the turning of the ground added;
   on an integrator that is time-optimal but for the last tenth of a second;
3. allocation: the rates of the four corners, with every actuator within its limits. Attitude goes first and
   keeps its direction; ride height gives way, so that the actuator with the least lift per stroke does not
   slow the others down, and a corner at its end leaves its work to the other three.

A move begins when the error leaves the dead zone and ends near zero error, not at the edge of the zone.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm

from tiger.control.lqr import dlqr
from tiger.control.motor_heat import FULL
from tiger.control.reachable import Pose, Suspension, seats
from tiger.frozen import dataclass
from tiger.record import STILL

if TYPE_CHECKING:
    from tiger.config.robot import LevelingConfig, RobotConfig
    from tiger.record import Four

_NEAR_LIMIT_MM = 0.5
_STILL_SMOOTHING_S = 0.2
_SOON = 8.0
"""Waking within this many still times is soon; it is also the most that the still time grows."""


@dataclass(frozen=True, slots=True)
class Target:
    """Pose of the body relative to its wheels that is wanted now, and how fast it turns."""

    pose: Pose
    roll_rate_radps: float = 0.0
    pitch_rate_radps: float = 0.0
    unreachable: bool = False
    """The strokes do not reach what was asked for; `pose` is the nearest."""
    twist_mmps: float = 0.0
    """The twist of the pose is wanted for its own sake: so fast at most, and reason enough for a move."""

    rolling: bool = False
    """The robot drives: the ground will not stand still, and no error is left to rest."""

    @property
    def twists(self) -> bool:
        """Whether it is."""
        return self.twist_mmps > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LevelingDesign:
    """What `design_leveling` computes once."""

    config: LevelingConfig
    suspension: Suspension
    ride_mm: float
    """Lift of the default ride height."""
    lift_rate_mmps: float
    """Fastest lift about the default ride height."""
    turn_limits_radps: tuple[float, float]
    """Fastest roll and pitch about the default ride height, each alone."""
    error_gain_per_s: float
    rate_gain: float
    lag_s: float
    wake_moving_rad: float
    wake_still_rad: float
    patience_rads: float
    settle_rad: float
    still_radps: float


@dataclass(frozen=True, slots=True)
class Phase:
    """Resting or moving, and what decides when that changes."""

    moving: bool = False
    patience_rads: float = 0.0
    """At rest: the error beyond the dead zone, summed over time."""
    quiet_s: float = 0.0
    """How long the error has been small and the ground still (in a move), or how long we have rested."""
    still_time_s: float = 0.0
    """How long it must have been so before the next rest."""
    turning_radps: tuple[float, float] = (0.0, 0.0)
    """Smoothed roll and pitch rate of the target."""


@dataclass(frozen=True, slots=True)
class LevelingState:
    """Last commands, the rates the actuators should have by now, and where in a move we are."""

    command_mmps: Four = STILL
    rate_mmps: Four = STILL
    phase: Phase = field(default_factory=Phase)


@dataclass(frozen=True, slots=True)
class Leveling:
    """What one step decided."""

    command_mmps: Four
    error_rad: tuple[float, float]
    """Roll and pitch left to the target."""
    settled: bool
    at_limit: tuple[bool, bool, bool, bool]


def design_leveling(robot: RobotConfig) -> LevelingDesign:
    """Design the gains: minimise (error / angle_weight)^2 + (rate command / rate_weight)^2 over integrator
    and lag.

    The delay to the board counts as lag. Raises MechanismError for a vehicle without a mechanism.
    """
    config, dt = robot.leveling, robot.loop.period_s
    suspension = Suspension.from_config(robot)
    lag = max(robot.actuator.lag_s + config.setpoint_delay_s, dt)
    # States: error left, rate of the actuators. Input: rate command.
    flow = np.array([[0.0, -1.0, 0.0], [0.0, -1.0 / lag, 1.0 / lag], [0.0, 0.0, 0.0]])
    power = expm(flow * dt)
    ratio = (config.rate_weight_degps / config.angle_weight_deg) ** 2
    gain = dlqr(power[:2, :2], power[:2, 2:], np.diag([ratio, 0.0]), np.eye(1)).gain[0]
    ride_mm, ratio = suspension.curve.at(config.ride_stroke_mm)
    fastest_mmps = ratio * suspension.rate_mmps
    return LevelingDesign(
        config=config,
        suspension=suspension,
        ride_mm=ride_mm,
        lift_rate_mmps=fastest_mmps,
        turn_limits_radps=(fastest_mmps / suspension.y_mm[0], fastest_mmps / suspension.x_mm[0]),
        error_gain_per_s=float(-gain[0]),
        rate_gain=float(gain[1]),
        lag_s=lag,
        wake_moving_rad=math.radians(config.dead_zone_deg),
        wake_still_rad=math.radians(config.wake_deg),
        patience_rads=math.radians(config.patience_degs),
        settle_rad=math.radians(config.settle_deg),
        still_radps=math.radians(config.still_degps),
    )


def step(
    design: LevelingDesign,
    state: LevelingState,
    target: Target | None,
    stroke_mm: Four,
    dt: float,
    rate_share: Four = FULL,
) -> tuple[LevelingState, Leveling]:
    """Advance by `dt`: the stroke rates that bring the body to the target, or to a stop without one.

    Each actuator moves at `rate_share` of its full rate at most (see `motor_heat`).
    """
    suspension = design.suspension
    lift, ratio = seats(suspension, stroke_mm)
    rate = _lagged(design, state, dt)
    at_limit = _at_limit(suspension, stroke_mm)
    if target is None:
        command = _slewed(design, state.command_mmps, STILL, dt)
        return LevelingState(command, rate), Leveling(command, (0.0, 0.0), False, at_limit)

    present = suspension.pose(lift)
    error = (target.pose.roll_rad - present.roll_rad, target.pose.pitch_rad - present.pitch_rad)
    ride_error = target.pose.ride_mm - present.ride_mm
    warp_error = target.pose.warp_mm - present.warp_mm
    centred = max(abs(ride_error), abs(warp_error)) < design.config.ride_settle_mm
    astray = max(abs(ride_error), abs(warp_error) if target.twists else 0.0) > design.config.ride_wake_mm
    phase = _phase(design, state.phase, target, error, centred=centred, astray=astray, dt=dt)
    if phase.moving:
        speed = suspension.pose(_product(ratio, rate))
        turning = _turning(design, phase, target)
        warping = _warping(design, target, warp_error, speed)
        pressing = _pressing(design, error, turning, abs(warping) if target.twists else 0.0)
        wanted = _feedback(design, turning, pressing, ride_error, warping, speed)
        wanted = _nearest(design, wanted, min(rate_share))
        limits = _rate_limits(design, stroke_mm, rate, rate_share)
        allocate = _allocate_twisting if target.twists else _allocate
        goal = allocate(suspension, wanted, ratio, limits)
    else:
        goal = STILL
    command = _slewed(design, state.command_mmps, goal, dt)
    settled = not phase.moving and command == STILL
    return LevelingState(command, rate, phase), Leveling(command, error, settled, at_limit)


def _phase(
    design: LevelingDesign,
    last: Phase,
    target: Target,
    error: tuple[float, float],
    *,
    centred: bool,
    astray: bool,
    dt: float,
) -> Phase:
    """Decide whether to move: from having left the dead zone until near zero error on still ground.

    A move begins when the error beyond the zone has summed up to the patience: at once when it is large, not
    at all when the ground shook and is back. Ground that wakes us again soon after we rested will go
    on doing so: each time we wait twice as long before the next rest.
    """
    config = design.config
    keep = math.exp(-dt / _STILL_SMOOTHING_S)
    turning = (
        keep * last.turning_radps[0] + (1.0 - keep) * target.roll_rate_radps,
        keep * last.turning_radps[1] + (1.0 - keep) * target.pitch_rate_radps,
    )
    if target.rolling:
        return Phase(True, 0.0, 0.0, config.still_time_s, turning)
    still = max(abs(turning[0]), abs(turning[1])) < design.still_radps
    worst = max(abs(error[0]), abs(error[1]))
    if last.moving:
        arrived = worst < design.settle_rad and centred
        quiet_s = last.quiet_s + dt if still and arrived else 0.0
        if quiet_s < last.still_time_s:
            return Phase(True, 0.0, quiet_s, last.still_time_s, turning)
        return Phase(False, 0.0, 0.0, last.still_time_s, turning)
    zone = design.wake_still_rad if still else design.wake_moving_rad
    patience = max(0.0, last.patience_rads + (worst - zone) * dt)
    wake = patience > design.patience_rads or astray
    if not wake:
        return Phase(False, patience, last.quiet_s + dt, last.still_time_s, turning)
    still_time_s = config.still_time_s
    if last.quiet_s < _SOON * still_time_s:
        still_time_s = min(max(2.0 * last.still_time_s, still_time_s), _SOON * still_time_s)
    return Phase(True, 0.0, 0.0, still_time_s, turning)


def _turning(design: LevelingDesign, phase: Phase, target: Target) -> tuple[float, float]:
    """Roll and pitch rate of the target: an axis that stands must not, by its noise, slow the other."""
    roll, pitch = phase.turning_radps
    return (
        target.roll_rate_radps if abs(roll) > design.still_radps else 0.0,
        target.pitch_rate_radps if abs(pitch) > design.still_radps else 0.0,
    )


def _pressing(
    design: LevelingDesign,
    error: tuple[float, float],
    turning_radps: tuple[float, float],
    twisting_mmps: float = 0.0,
) -> tuple[float, float]:
    """Roll and pitch error, without one inside the dead zone while the actuators are busy with the other, or
    with a twist."""
    gain, zone = design.error_gain_per_s, design.wake_moving_rad
    (roll, pitch), (roll_rate, pitch_rate) = error, turning_radps
    roll_limit, pitch_limit = design.turn_limits_radps
    in_roll = abs(roll_rate + gain * roll) / roll_limit
    in_pitch = abs(pitch_rate + gain * pitch) / pitch_limit
    if max(in_roll, in_pitch, twisting_mmps / design.lift_rate_mmps) < 1.0:
        return error
    return (
        roll if in_roll >= 1.0 or abs(roll) > zone else 0.0,
        pitch if in_pitch >= 1.0 or abs(pitch) > zone else 0.0,
    )


def _feedback(
    design: LevelingDesign,
    turning_radps: tuple[float, float],
    error: tuple[float, float],
    ride_error_mm: float,
    warping_mmps: float,
    speed: Pose,
) -> Pose:
    """Rates of roll, pitch, ride and warp that are wanted before any limit, as a pose per second.

    The target may turn: the LQR acts on the rate relative to it, and the turning itself is added.
    """
    k, d = design.error_gain_per_s, design.rate_gain
    roll_rate, pitch_rate = turning_radps
    return Pose(
        roll_rad=roll_rate + k * error[0] - d * (speed.roll_rad - roll_rate),
        pitch_rad=pitch_rate + k * error[1] - d * (speed.pitch_rad - pitch_rate),
        ride_mm=k * ride_error_mm - d * speed.ride_mm,
        warp_mm=warping_mmps,
    )


def _nearest(design: LevelingDesign, wanted: Pose, rate_share: float) -> Pose:
    """Rates of roll and pitch nearest to the wanted ones among those that the actuators have.

    Both axes share them: |roll rate|/limit + |pitch rate|/limit <= 1. The nearest leave most to the axis
    that lacks most; both scaled down alike would leave the sum of squares larger for longer.
    """
    roll_limit, pitch_limit = design.turn_limits_radps
    roll_limit, pitch_limit = rate_share * roll_limit, rate_share * pitch_limit
    roll, pitch = abs(wanted.roll_rad), abs(wanted.pitch_rad)
    excess = roll * pitch_limit + pitch * roll_limit - roll_limit * pitch_limit
    if excess <= 0.0:
        return wanted
    excess /= roll_limit**2 + pitch_limit**2
    roll, pitch = roll - excess * pitch_limit, pitch - excess * roll_limit
    if roll <= 0.0:
        roll, pitch = 0.0, pitch_limit
    elif pitch <= 0.0:
        roll, pitch = roll_limit, 0.0
    return Pose(
        math.copysign(roll, wanted.roll_rad),
        math.copysign(pitch, wanted.pitch_rad),
        wanted.ride_mm,
        wanted.warp_mm,
    )


def _warping(design: LevelingDesign, target: Target, error_mm: float, speed: Pose) -> float:
    """Rate of twist: at leisure, or as fast as the actuators go where the twist itself is wanted."""
    if not target.twists:
        return design.config.warp_rate_per_s * error_mm
    rate = design.error_gain_per_s * error_mm - design.rate_gain * speed.warp_mm
    most = min(design.lift_rate_mmps, target.twist_mmps)
    return min(most, max(-most, rate))


Limits = tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]
"""Lowest and highest rate of each corner."""


def _allocate(suspension: Suspension, wanted: Pose, ratio: Four, limits: Limits) -> Four:
    """Turn wanted pose rates into four stroke rates within (lowest, highest) mm/s each; 0 lies within each.

    Corner i lifts at (ride + k d_i) with d_i the share of roll, pitch and warp. k <= 1 is the largest scale
    for which a common ride rate keeps all corners within their limits: for every pair, k (d_j - d_i) <=
    high_j - low_i. Then the ride rate is the wanted one clipped to what the corners leave.
    """
    tilt = suspension.lifts_mm(Pose(wanted.roll_rad, wanted.pitch_rad, 0.0, wanted.warp_mm))
    low, high = _lift_limits(ratio, limits)
    scale = 1.0
    lowest, highest = max(_difference(low, tilt)), min(_difference(high, tilt))
    if lowest > highest:
        for d_i, low_i in zip(tilt, low, strict=True):
            for d_j, high_j in zip(tilt, high, strict=True):
                room = high_j - low_i
                if scale * (d_j - d_i) > room:
                    scale = room / (d_j - d_i)
        tilt = _scaled(scale, tilt)
        lowest, highest = max(_difference(low, tilt)), min(_difference(high, tilt))
    ride = max(lowest, min(highest, wanted.ride_mm))
    (fl, fr, rl, rr), (m_fl, m_fr, m_rl, m_rr) = tilt, ratio
    return (ride + fl) / m_fl, (ride + fr) / m_fr, (ride + rl) / m_rl, (ride + rr) / m_rr


def _allocate_twisting(suspension: Suspension, wanted: Pose, ratio: Four, limits: Limits) -> Four:
    """As `_allocate`, with the twist to give way to roll and pitch, and ride to both.

    The two corners of a diagonal share what ride and twist do to them, so only they compete: k (d_j - d_i) <=
    high_j - low_i within a diagonal. Then twist, then ride are the wanted ones clipped to what is left.
    """
    tilt = suspension.lifts_mm(Pose(wanted.roll_rad, wanted.pitch_rad, 0.0))
    low, high = _lift_limits(ratio, limits)
    scale = 1.0
    for i, j in ((0, 3), (3, 0), (1, 2), (2, 1)):
        room = high[j] - low[i]
        if scale * (tilt[j] - tilt[i]) > room:
            scale = room / (tilt[j] - tilt[i])
    tilt = _scaled(scale, tilt)
    least, most = _difference(low, tilt), _difference(high, tilt)
    # What ride + twist may be (FL, RR), and ride - twist (FR, RL).
    up_low, up_high = max(least[0], least[3]), min(most[0], most[3])
    down_low, down_high = max(least[1], least[2]), min(most[1], most[2])
    warp = max(0.5 * (up_low - down_high), min(0.5 * (up_high - down_low), wanted.warp_mm))
    lowest, highest = max(up_low - warp, down_low + warp), min(up_high - warp, down_high + warp)
    ride = max(lowest, min(highest, wanted.ride_mm))
    (fl, fr, rl, rr), (m_fl, m_fr, m_rl, m_rr) = tilt, ratio
    up, down = ride + warp, ride - warp
    return (up + fl) / m_fl, (down + fr) / m_fr, (down + rl) / m_rl, (up + rr) / m_rr


def _lift_limits(ratio: Four, limits: Limits) -> tuple[Four, Four]:
    """Lowest and highest rate of each seat, from those of the strokes."""
    (m_fl, m_fr, m_rl, m_rr), (fl, fr, rl, rr) = ratio, limits
    return (
        (m_fl * fl[0], m_fr * fr[0], m_rl * rl[0], m_rr * rr[0]),
        (m_fl * fl[1], m_fr * fr[1], m_rl * rl[1], m_rr * rr[1]),
    )


def _rate_limits(design: LevelingDesign, stroke_mm: Four, rate_mmps: Four, share: Four) -> Limits:
    """Rates each actuator may have: its speed, or less where it must brake before the end of its range."""
    (fl, fr, rl, rr), (v_fl, v_fr, v_rl, v_rr) = stroke_mm, rate_mmps
    lag_s, most = design.lag_s, design.suspension.rate_mmps
    return (
        _rate_limit(design, fl + lag_s * v_fl, share[0] * most),
        _rate_limit(design, fr + lag_s * v_fr, share[1] * most),
        _rate_limit(design, rl + lag_s * v_rl, share[2] * most),
        _rate_limit(design, rr + lag_s * v_rr, share[3] * most),
    )


def _rate_limit(design: LevelingDesign, stroke_mm: float, most_mmps: float) -> tuple[float, float]:
    suspension, brake = design.suspension, design.config.stroke_brake_per_s
    down = min(most_mmps, max(0.0, brake * (stroke_mm - suspension.stroke_low_mm)))
    up = min(most_mmps, max(0.0, brake * (suspension.stroke_high_mm - stroke_mm)))
    return -down, up


def _slewed(design: LevelingDesign, last: Four, goal: Four, dt: float) -> Four:
    """Go from the last command towards the goal within the acceleration limit, in a straight line."""
    way = _difference(goal, last)
    change = max(max(way), -min(way))
    most = design.config.acceleration_mmps2 * dt
    if change <= most:
        return goal
    (fl, fr, rl, rr), (d_fl, d_fr, d_rl, d_rr) = last, way
    share = most / change
    return fl + share * d_fl, fr + share * d_fr, rl + share * d_rl, rr + share * d_rr


def _lagged(design: LevelingDesign, state: LevelingState, dt: float) -> Four:
    """Rates that the actuators should have by now, from the commands: free of the potentiometers' noise."""
    (v_fl, v_fr, v_rl, v_rr), (u_fl, u_fr, u_rl, u_rr) = state.rate_mmps, state.command_mmps
    keep = math.exp(-dt / design.lag_s)
    take = 1.0 - keep
    return (
        keep * v_fl + take * u_fl,
        keep * v_fr + take * u_fr,
        keep * v_rl + take * u_rl,
        keep * v_rr + take * u_rr,
    )


def _at_limit(suspension: Suspension, stroke_mm: Four) -> tuple[bool, bool, bool, bool]:
    low, high = suspension.stroke_low_mm + _NEAR_LIMIT_MM, suspension.stroke_high_mm - _NEAR_LIMIT_MM
    fl, fr, rl, rr = stroke_mm
    return not low <= fl <= high, not low <= fr <= high, not low <= rl <= high, not low <= rr <= high


# ---- four corners at once: a tick has no time for loops over four ----


def _product(a: Four, b: Four) -> Four:
    return a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]


def _difference(a: Four, b: Four) -> Four:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]


def _scaled(share: float, a: Four) -> Four:
    return share * a[0], share * a[1], share * a[2], share * a[3]
