"""Wheel radius and yaw scale, from a straight drive and full turns on the spot.

A drive is a small state machine over the daemon's records: wait until it is armed, go, stop, wait until the
wheels stand. What the wheels turned is counted in teeth; what the robot did is measured by a person. From
them follow the two factors of [drive] in robot.toml: the radius factor (rolling radius over the vehicle's)
and the effective-track factor (how much faster than its geometry a skid-steered robot must turn its wheels).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from tiger.calibration.procedure import CalibrationError, Finding, Result
from tiger.models.track import half_tracks_m, track_of
from tiger.protocol.messages import PARAMS, BoardKind
from tiger.record import STILL, Command, DaemonState, Mode

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Four, Inputs, Record

SPEED_MPS = 0.3
YAW_RATE_RADPS = math.radians(20.0)
ROLLING_S = 4.0  # from the start of a drive to its turning, wheel check included
YAW_RISE_S = 2.0
STAND_S = 1.0
STANDING_RADPS = 0.02
ARM_PATIENCE_S = 20.0
PATIENCE_RATIO = 4.0  # of the time a drive should take
EDGES_PER_TOOTH = 4
WHEELS_APART_MOST = 0.05
FACTOR_MOST_OFF = 0.2  # of the radius: beyond it something else is wrong
_TEETH = next(param for param in PARAMS[BoardKind.MEGA_SPEED] if param.name == "teeth_counts")
_LEFT_TURN = np.array([-1.0, 1.0, -1.0, 1.0])  # how FL FR RL RR turn when the robot turns left


class Phase(Enum):
    """Where a drive stands."""

    ARM = "arming"
    GO = "driving"
    STOP = "stopping"
    END = "done"


@dataclass(frozen=True, slots=True)
class Drive:
    """What to drive: a distance ahead, or an angle (+ left) on a circle; the other is zero."""

    radius_m: float  # of the wheels, as known before
    distance_m: float = 0.0
    angle_rad: float = 0.0
    turn_speed_mps: float = 0.0  # 0: on the spot

    def command(self, elapsed_s: float) -> Command:
        """What drives so; a turn begins when the robot rolls, and gently: tyres that roll scrub less."""
        if not self.angle_rad:
            return Command(mode=Mode.HOLD, speed_mps=SPEED_MPS)
        since_s = elapsed_s - (ROLLING_S if self.turn_speed_mps else 0.0)
        yaw_radps = math.copysign(YAW_RATE_RADPS * min(max(since_s / YAW_RISE_S, 0.0), 1.0), self.angle_rad)
        return Command(mode=Mode.HOLD, speed_mps=self.turn_speed_mps, yaw_rate_radps=yaw_radps)

    @property
    def time_s(self) -> float:
        """How long it takes, about."""
        return self.distance_m / SPEED_MPS + abs(self.angle_rad) / YAW_RATE_RADPS


@dataclass(frozen=True, slots=True)
class DriveState:
    """Between two ticks of a drive."""

    phase: Phase = Phase.ARM
    since_s: float | None = None  # in this phase
    start_rad: Four = STILL
    wheel_rad: Four = STILL  # turned since the start
    stroke_mm: Four = STILL
    yaw_rad: float = 0.0  # by the gyro
    imu_s: float | None = None
    stood_s: float | None = None


def step(drive: Drive, state: DriveState, record: Record) -> tuple[DriveState, Command]:
    """Follow one tick and return the next command. Raises CalibrationError when the drive ends early."""
    inputs, now_s = record.inputs, record.inputs.now_s
    if state.since_s is None:
        state = replace(state, since_s=now_s)
    elapsed_s = now_s - (state.since_s or 0.0)
    neutral = Command(mode=Mode.HOLD)
    if state.phase is Phase.ARM:
        return _arm(state, record, elapsed_s), neutral
    if state.phase is Phase.END:
        return state, neutral
    if record.state is not DaemonState.ARMED:
        raise CalibrationError(_hint(drive, f"wheels: stopped while {state.phase.value} ({record.reason})"))
    if elapsed_s > PATIENCE_RATIO * drive.time_s + 10.0:
        raise CalibrationError(_hint(drive, f"wheels: {state.phase.value} for {elapsed_s:.0f} s"))
    state = _follow(state, inputs)
    if state.phase is Phase.GO:
        if not _arrived(drive, state):
            return state, drive.command(elapsed_s)
        return replace(state, phase=Phase.STOP, since_s=now_s), neutral
    return _stop(state, inputs), neutral


def _hint(drive: Drive, text: str) -> str:
    step = "look for what holds the robot"
    if drive.angle_rad:
        step += "; on ground with much grip it cannot turn on the spot: take a smooth floor"
    return f"{text}; {step}"


def progress(drive: Drive, state: DriveState) -> float:
    """How much of a drive is done, 0 to 1."""
    if state.phase is Phase.END:
        return 1.0
    if drive.angle_rad:
        return min(abs(state.yaw_rad / drive.angle_rad), 1.0)
    return min(max(float(np.mean(state.wheel_rad)) * drive.radius_m / drive.distance_m, 0.0), 1.0)


def _arm(state: DriveState, record: Record, elapsed_s: float) -> DriveState:
    inputs = record.inputs
    if record.state is DaemonState.ARMED and inputs.wheels_left and inputs.wheels_right and inputs.strokes:
        strokes = inputs.strokes.stroke_mm
        return DriveState(Phase.GO, inputs.now_s, start_rad=_wheel_rad(inputs), stroke_mm=strokes)
    if elapsed_s > ARM_PATIENCE_S:
        raise CalibrationError(f"wheels: not armed after {ARM_PATIENCE_S:g} s")
    return state


def _follow(state: DriveState, inputs: Inputs) -> DriveState:
    """Count what wheels and gyro have turned."""
    turned = np.subtract(_wheel_rad(inputs), state.start_rad).tolist()
    yaw, imu = state.yaw_rad, inputs.imu
    if imu is not None and state.imu_s is not None:
        yaw += imu.rate_radps[2] * max(imu.t_s - state.imu_s, 0.0)
    fl, fr, rl, rr = turned
    return replace(
        state, wheel_rad=(fl, fr, rl, rr), yaw_rad=yaw, imu_s=imu.t_s if imu is not None else state.imu_s
    )


def _arrived(drive: Drive, state: DriveState) -> bool:
    if drive.angle_rad:
        return abs(state.yaw_rad) >= abs(drive.angle_rad) - YAW_RATE_RADPS**2 / 2.0
    return float(np.mean(state.wheel_rad)) * drive.radius_m >= drive.distance_m


def _stop(state: DriveState, inputs: Inputs) -> DriveState:
    samples = (inputs.wheels_left, inputs.wheels_right)
    speeds = [abs(speed) for sample in samples if sample is not None for speed in sample.speed_radps]
    if max(speeds, default=0.0) > STANDING_RADPS:
        return replace(state, stood_s=None)
    stood_s = state.stood_s if state.stood_s is not None else inputs.now_s
    phase = Phase.END if inputs.now_s - stood_s >= STAND_S else Phase.STOP
    return replace(state, stood_s=stood_s, phase=phase)


def _wheel_rad(inputs: Inputs) -> Four:
    """What the wheels have turned since their boards were started, FL FR RL RR."""
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is None or right is None:
        raise CalibrationError("wheels: a mega_speed fell silent; check its cable, then start again")
    per_edge = 2.0 * math.pi / (EDGES_PER_TOOTH * _TEETH.default[0])
    (fl, rl), (fr, rr) = left.edge_counts, right.edge_counts
    return fl * per_edge, fr * per_edge, rl * per_edge, rr * per_edge


def wrong_distance(robot: RobotConfig, straight: DriveState, distance_m: float) -> str | None:
    """Why a person cannot have measured this distance; None when it can be."""
    mean = float(np.mean(straight.wheel_rad))
    if mean <= 0.0:
        return "wheels: the robot did not drive ahead; check the sensors, then start again"
    counted_m = mean * robot.vehicle.tire.rolling_radius_m
    if abs(distance_m / counted_m - 1.0) <= FACTOR_MOST_OFF:
        return None
    return (
        f"wheels: {distance_m:g} m is {distance_m / counted_m:.2f} of the {counted_m:.2f} m that the wheels "
        f"rolled; at most {100.0 * FACTOR_MOST_OFF:g} % off is believed: measure again, in metres, "
        "check the teeth of the gears"
    )


def wrong_angle(turning: DriveState, angle_rad: float) -> str | None:
    """Why the robot cannot have turned so far; None when it can have."""
    if abs(angle_rad - turning.yaw_rad) <= FACTOR_MOST_OFF * abs(turning.yaw_rad):
        return None
    return (
        f"wheels: {math.degrees(angle_rad):.0f} degrees in all are more than {100.0 * FACTOR_MOST_OFF:g} % "
        f"off the {math.degrees(turning.yaw_rad):.0f} that the gyro counted: measure again, in degrees, "
        "count the full turns"
    )


def solve(
    robot: RobotConfig,
    straight: DriveState,
    distance_m: float,
    turning: DriveState,
    angle_rad: float,
) -> Result:
    """Radius factor from a straight drive and the distance a person measured, track factor from the turns.

    A wheel of radius r that turned by a went r a; on the spot it went effective factor x half track x yaw
    (`control/drive.py`). `angle_rad` is what the robot truly turned, + left, full turns included.
    """
    wrong = wrong_distance(robot, straight, distance_m) or wrong_angle(turning, angle_rad)
    if wrong is not None:
        raise CalibrationError(wrong)
    straight_rad = np.array(straight.wheel_rad)
    mean = float(straight_rad.mean())
    apart = float(np.ptp(straight_rad)) / mean
    radius = distance_m / mean
    radius_factor = radius / robot.vehicle.tire.rolling_radius_m
    half_m = float(np.mean(half_tracks_m(track_of(robot.vehicle), turning.stroke_mm)))
    turned = float((_LEFT_TURN * np.array(turning.wheel_rad)).mean())
    track_factor = radius * turned / (angle_rad * half_m)
    if not 0.8 <= track_factor <= 3.0:
        raise CalibrationError(
            f"wheels: the turns make the effective-track factor {track_factor:.2f}, outside 0.8 to 3; "
            "measure again, on ground of one kind"
        )
    findings = (
        Finding("wheel_radius_factor", radius_factor, ""),
        Finding("effective_track_factor", track_factor, ""),
        Finding("rolling radius", radius, "m"),
        Finding("wheels apart on the straight", 100.0 * apart, "%", 100.0 * WHEELS_APART_MOST),
        Finding("gyro over what was turned", turning.yaw_rad / angle_rad, ""),
    )
    notes = []
    if apart > WHEELS_APART_MOST:
        notes.append("The wheels did not turn alike: the ground was not even, or a tyre is low.")
    notes.append("The track factor is that of this ground: loose ground scrubs less.")
    return Result(findings, notes=tuple(notes))


def as_toml(result: Result) -> str:
    """The two factors as they go into robot.toml."""
    values = {finding.name: finding.value for finding in result.findings}
    names = ("wheel_radius_factor", "effective_track_factor")
    return "[drive]\n" + "".join(f"{name} = {values[name]:.4f}\n" for name in names)
