"""The controller: what one tick of the robot computes, as a pure function.

    design = design_controller(robot)
    state = initial_state(design)
    state, outputs = step(design, state, inputs, dt)

No clock, no ports, no globals. Observer, situation (odometry, loads, roughness), stability, suspension, drive
and traction are modules; this file connects them and holds the table of modes.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import TYPE_CHECKING

from tiger.control import attitude, balance, drive, motor_heat, stability, traction
from tiger.control.attitude import LevelingDesign, LevelingState, Target
from tiger.control.balance import BalanceState
from tiger.control.drive import DriveDesign, DriveState
from tiger.control.reachable import Pose, seats
from tiger.control.rhythm import Rhythm, followable, learn
from tiger.control.stability import StabilityDesign, StabilityState
from tiger.control.traction import TractionDesign, TractionState
from tiger.daemon import situation
from tiger.daemon.situation import SituationDesign, SituationState
from tiger.estimation import attitude_observer as observer
from tiger.estimation import ground_ahead
from tiger.estimation.attitude_observer import ObserverDesign, ObserverState
from tiger.frozen import dataclass, replace
from tiger.record import Command, Estimate, Inputs, Mode, Outputs

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.robot import RobotConfig
    from tiger.estimation.contact import Contact
    from tiger.record import Four


@dataclass(frozen=True, slots=True, eq=False)
class ControllerDesign:
    """Gains and geometry, computed once."""

    robot: RobotConfig
    observer: ObserverDesign
    leveling: LevelingDesign
    drive: DriveDesign
    situation: SituationDesign
    stability: StabilityDesign
    traction: TractionDesign
    max_angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class ControllerState:
    """What a tick leaves to the next."""

    observer: ObserverState
    situation: SituationState
    leveling: LevelingState = field(default_factory=LevelingState)
    drive: DriveState = field(default_factory=DriveState)
    ground: tuple[Rhythm, Rhythm] = (Rhythm(), Rhythm())
    """What was learned of the ground's rocking in roll and in pitch."""
    imu_t_s: float = -math.inf
    """Time of the IMU sample last used."""
    heat: Four = motor_heat.COLD
    """Of the actuators' motors; 1 is where mega_suspension stops the robot."""
    balance: BalanceState = field(default_factory=BalanceState)
    stability: StabilityState = field(default_factory=StabilityState)
    traction: TractionState = field(default_factory=TractionState)


def design_controller(robot: RobotConfig) -> ControllerDesign:
    """Design everything for a checked configuration. Raises ValueError naming what cannot be designed."""
    return ControllerDesign(
        robot=robot,
        observer=observer.design_observer(robot),
        leveling=attitude.design_leveling(robot),
        drive=drive.design_drive(robot),
        situation=situation.design_situation(robot),
        stability=stability.design_stability(robot),
        traction=traction.design_traction(robot),
        max_angle_rad=math.radians(robot.leveling.max_angle_deg),
    )


def initial_state(design: ControllerDesign) -> ControllerState:
    """Return the state before the first tick."""
    return ControllerState(observer.initial_state(design.observer), situation.initial_state(design.situation))


def rearmed(design: ControllerDesign, state: ControllerState) -> ControllerState:
    """Return the state that an armed phase begins with: what is known of the robot, and no command yet."""
    return ControllerState(
        state.observer,
        state.situation,
        ground=state.ground,
        imu_t_s=state.imu_t_s,
        heat=state.heat,
        stability=state.stability,
    )


def step(
    design: ControllerDesign, state: ControllerState, inputs: Inputs, dt: float
) -> tuple[ControllerState, Outputs]:
    """Advance by `dt` seconds. Commands are zero unless armed, with strokes and an estimate to act on."""
    observed, estimate = _observe(design, state, inputs)
    imu_t_s = state.imu_t_s if inputs.imu is None else inputs.imu.t_s
    strokes = inputs.strokes
    if strokes is None or not estimate.ready:
        state = ControllerState(
            observed, state.situation, imu_t_s=imu_t_s, heat=state.heat, stability=state.stability
        )
        return state, Outputs(estimate=estimate, reason="not ready")
    heat = motor_heat.step(state.heat, strokes.duty_permille, dt)
    ground = (
        learn(state.ground[0], estimate.plate_roll_rad, estimate.plate_roll_rate_radps, dt),
        learn(state.ground[1], estimate.plate_pitch_rad, estimate.plate_pitch_rate_radps, dt),
    )
    known, estimate = situation.step(design.situation, state.situation, inputs, estimate, dt)
    steady, margins, command = stability.step(
        design.stability, state.stability, inputs.command, inputs, estimate, dt
    )
    estimate = replace(estimate, stability=margins)
    if not inputs.armed:
        state = ControllerState(observed, known, ground=ground, imu_t_s=imu_t_s, heat=heat, stability=steady)
        return state, Outputs(estimate=estimate, reason="not armed")

    contact = known.contact.contact
    balancing = _balancing(design, state.balance, command, contact, strokes.stroke_mm)
    turning = ground_ahead.turning_radps(design.situation.ahead, known.ahead, estimate)
    now = _Known(estimate, ground, balancing, contact, turning)
    target, reason = _target(design, command, now)
    rate_share = motor_heat.rate_share(design.robot.leveling, heat)
    leveling, levelled = attitude.step(
        design.leveling, state.leveling, target, strokes.stroke_mm, dt, rate_share
    )
    driving, wheel_rpm = drive.step(design.drive, state.drive, command, inputs, dt)
    gripping, forces, wheel_rpm = traction.step(
        design.traction, state.traction, wheel_rpm, inputs, estimate, dt
    )
    unreachable = target is not None and target.unreachable
    limited = stability.reason(margins)
    if limited:
        reason = f"{reason}; {limited}"
    if rate_share != motor_heat.FULL:
        reason = f"{reason}; actuators are hot and move slower"
    outputs = Outputs(
        stroke_rate_mmps=levelled.command_mmps,
        wheel_rpm=wheel_rpm,
        estimate=estimate,
        reason=reason,
        error_rad=levelled.error_rad,
        settled=levelled.settled,
        unreachable=unreachable,
        at_limit=levelled.at_limit,
        traction=forces,
    )
    return ControllerState(
        observer=observed,
        situation=known,
        leveling=leveling,
        drive=driving,
        ground=ground,
        imu_t_s=imu_t_s,
        heat=heat,
        balance=balancing,
        stability=steady,
        traction=gripping,
    ), outputs


def _balancing(
    design: ControllerDesign, state: BalanceState, command: Command, contact: Contact, stroke_mm: Four
) -> BalanceState:
    """Advance mode balance; in any other mode it waits at its beginning."""
    if command.mode is not Mode.BALANCE:
        return BalanceState()
    suspension = design.leveling.suspension
    warp_mm = suspension.pose(seats(suspension, stroke_mm)[0]).warp_mm
    now = balance.Situation(contact, warp_mm, suspension.warp_most_mm)
    return balance.step(design.robot.balance, state, now)


def _observe(
    design: ControllerDesign, state: ControllerState, inputs: Inputs
) -> tuple[ObserverState, Estimate]:
    strokes, imu = inputs.strokes, inputs.imu
    if strokes is None:
        return state.observer, Estimate()
    (fl, fr, rl, rr), (p, q, r, s) = seats(design.leveling.suspension, strokes.stroke_mm)
    v, w, x, y = strokes.rate_mmps
    lift_m = 0.001 * fl, 0.001 * fr, 0.001 * rl, 0.001 * rr
    lift_rate_mps = 0.001 * p * v, 0.001 * q * w, 0.001 * r * x, 0.001 * s * y
    sample = imu if imu is not None and imu.t_s > state.imu_t_s else None
    age_s = 0.0 if sample is None else inputs.now_s - sample.t_s
    error = state.situation.tilt_error
    off = error.roll_rad, error.pitch_rad
    return observer.step(design.observer, state.observer, lift_m, lift_rate_mps, sample, age_s, off)


# ---- modes --------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Known:
    """What a mode may look at."""

    estimate: Estimate
    ground: tuple[Rhythm, Rhythm]
    balance: BalanceState
    contact: Contact
    turning_radps: tuple[float, float]
    """Rates of roll and pitch of the ground over the next moments."""


def _target(design: ControllerDesign, command: Command, known: _Known) -> tuple[Target | None, str]:
    """Return the target of the command's mode, None to stand still, and what to tell the user."""
    most = design.max_angle_rad
    roll = min(most, max(-most, command.roll_rad))
    pitch = min(most, max(-most, command.pitch_rad))
    mode = _MODES[command.mode]
    refuse = design.robot.leveling.out_of_reach == "refuse"
    if refuse and mode.has_attitude and not design.leveling.suspension.reachable(roll, pitch):
        return None, f"{command.mode}: refused, the strokes do not reach this attitude"
    if (roll, pitch) != (command.roll_rad, command.pitch_rad):
        command = replace(command, roll_rad=roll, pitch_rad=pitch)
    target = mode.target(design, command, known)
    if target is not None and target.unreachable:
        return target, f"{mode.reason(command, known)}: out of reach, holding the nearest attitude"
    return target, mode.reason(command, known)


def _named(command: Command, known: _Known) -> str:
    return str(command.mode)


def _hold(design: ControllerDesign, command: Command, known: _Known) -> Target | None:
    return None


def _level(design: ControllerDesign, command: Command, known: _Known) -> Target | None:
    """Roll and pitch against gravity: what the ground does not give, the strokes must."""
    (roll, roll_rate), (pitch, pitch_rate) = _followable_ground(design, known)
    roll, pitch = command.roll_rad - roll, command.pitch_rad - pitch
    target = _posed(design, command, roll, pitch, (-roll_rate, -pitch_rate))
    rolling = abs(known.estimate.speed_mps) > design.robot.leveling.rolling_mps
    return replace(target, rolling=True) if rolling else target


def _balance(design: ControllerDesign, command: Command, known: _Known) -> Target | None:
    """As level, as far as the twist of the strokes leaves it that shares the load: wheels first.

    While it feels for the ground only the twist moves: what a body on three wheels leans over is no slope.
    """
    estimate, phase = known.estimate, known.balance.phase
    if phase in balance.FEELING:
        roll, pitch = (
            estimate.roll_rad - estimate.plate_roll_rad,
            estimate.pitch_rad - estimate.plate_pitch_rad,
        )
        roll_rate = pitch_rate = 0.0
    else:
        (roll, roll_rate), (pitch, pitch_rate) = _followable_ground(design, known)
        roll, pitch = command.roll_rad - roll, command.pitch_rad - pitch
    target = _posed(design, command, roll, pitch, (-roll_rate, -pitch_rate), known.balance.wanted_mm)
    probing = phase == balance.Phase.PROBE
    twist_mmps = design.robot.balance.probe_mmps if probing else design.leveling.lift_rate_mmps
    return replace(target, twist_mmps=twist_mmps)


def _balance_reason(command: Command, known: _Known) -> str:
    return f"{command.mode}: {balance.reason(known.balance, known.contact)}"


def _followable_ground(
    design: ControllerDesign, known: _Known
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Angle and rate of the ground in roll and pitch; where it is too fast, of what can be followed of it."""
    estimate = known.estimate
    axes = [
        (estimate.plate_roll_rad, known.turning_radps[0]),
        (estimate.plate_pitch_rad, known.turning_radps[1]),
    ]
    limits, actuator = design.leveling.turn_limits_radps, design.robot.actuator
    delay_s = design.robot.leveling.setpoint_delay_s
    # Rates of two axes add on the actuators: each gets its share of what is asked.
    demand = [
        rhythm.amplitude_rad * rhythm.frequency_radps / limit if rhythm.trusted else 0.0
        for rhythm, limit in zip(known.ground, limits, strict=True)
    ]
    total = sum(demand)
    if total > 1.0:
        for axis, rhythm in enumerate(known.ground):
            limit = limits[axis] * demand[axis] / total
            if limit > 0.0:
                axes[axis] = followable(rhythm, limit, delay_s, actuator.lag_s)
    return axes[0], axes[1]


def _pose(design: ControllerDesign, command: Command, known: _Known) -> Target | None:
    """Roll, pitch and ride height against the wheels."""
    return _posed(design, command, command.roll_rad, command.pitch_rad)


def _stow(design: ControllerDesign, command: Command, known: _Known) -> Target | None:
    """All four strokes at the low end of the range in use."""
    return Target(Pose(0.0, 0.0, design.leveling.suspension.lift_low_mm))


def _posed(
    design: ControllerDesign,
    command: Command,
    roll_rad: float,
    pitch_rad: float,
    turning_radps: tuple[float, float] = (0.0, 0.0),
    warp_mm: float = 0.0,
) -> Target:
    """Target the nearest attitude that the twist leaves, at the wanted ride as far as both leave it."""
    suspension = design.leveling.suspension
    roll, pitch = suspension.nearest(roll_rad, pitch_rad, warp_mm)
    unreachable = abs(roll - roll_rad) + abs(pitch - pitch_rad) > 1e-9
    lowest, highest = suspension.ride_range_mm(roll, pitch, warp_mm)
    wanted = design.leveling.ride_mm
    if command.ride_stroke_mm is not None:
        wanted = suspension.curve.at(command.ride_stroke_mm)[0]
    if unreachable:
        turning_radps = (0.0, 0.0)
    pose = Pose(roll, pitch, min(max(wanted, lowest), highest), warp_mm)
    return Target(pose, *turning_radps, unreachable)


@dataclass(frozen=True, slots=True)
class _ModeRow:
    """What a mode aims at, and whether it takes roll and pitch from the command."""

    target: Callable[[ControllerDesign, Command, _Known], Target | None]
    has_attitude: bool
    reason: Callable[[Command, _Known], str] = _named


_MODES = {
    Mode.HOLD: _ModeRow(_hold, has_attitude=False),
    Mode.LEVEL: _ModeRow(_level, has_attitude=True),
    Mode.BALANCE: _ModeRow(_balance, has_attitude=True, reason=_balance_reason),
    Mode.POSE: _ModeRow(_pose, has_attitude=True),
    Mode.STOW: _ModeRow(_stow, has_attitude=False),
}
