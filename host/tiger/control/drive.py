"""From forward speed and yaw rate to four wheel speeds, on the track that the robot has at these strokes.

Skid steering: the wheel at y_i (left +) runs at v - yaw_rate y_i. The track changes with the strokes
(`models/track.py`), and the four contacts scrub, so that the geometric half-tracks are multiplied by one
effective-track factor (measured by `tiger calibrate wheels`); what that misses, an integral of the gyro's yaw
rate makes up for. The wheel speeds are closed by the Roboteqs on their own sensors or, by choice, by an
integral on those of mega_speed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tiger.frozen import dataclass
from tiger.models.track import Track, half_tracks_m, track_of
from tiger.record import STILL

if TYPE_CHECKING:
    from tiger.config.robot import DriveControlConfig, RobotConfig
    from tiger.record import Command, Four, Inputs

_RPM_PER_RADPS = 30.0 / math.pi


@dataclass(frozen=True, slots=True, eq=False)
class DriveDesign:
    """What `design_drive` computes once."""

    config: DriveControlConfig
    track: Track
    rpm_per_mps: float
    rpm_max: float


@dataclass(frozen=True, slots=True)
class Ramp:
    """A value on its way to a setpoint, and its rate of change."""

    value: float = 0.0
    rate: float = 0.0


@dataclass(frozen=True, slots=True)
class DriveState:
    """Speeds commanded now, and what the yaw-rate loop has added to the yaw rate."""

    speed_mps: Ramp = Ramp()
    yaw_rate_radps: Ramp = Ramp()
    yaw_trim_radps: float = 0.0
    wheel_trim_rpm: Four = STILL


_STANDING = DriveState()


def design_drive(robot: RobotConfig) -> DriveDesign:
    """Prepare the drive; wheel speeds stay below both the motor's and the safety limit."""
    config, vehicle = robot.drive, robot.vehicle
    radius_m = vehicle.tire.rolling_radius_m * config.wheel_radius_factor
    motor_rpm = vehicle.drive.max_wheel_speed_rpm if vehicle.drive is not None else 0.0
    return DriveDesign(
        config=config,
        track=track_of(vehicle),
        rpm_per_mps=_RPM_PER_RADPS / radius_m,
        rpm_max=min(motor_rpm, 0.95 * robot.safety.max_wheel_speed_rpm),
    )


def step(
    design: DriveDesign, state: DriveState, command: Command, inputs: Inputs, dt: float
) -> tuple[DriveState, Four]:
    """Advance by `dt` and return the wheel speeds in rpm, forward positive."""
    config = design.config
    standing = command.speed_mps == 0.0 == command.yaw_rate_radps and state == _STANDING
    if standing or not config.enabled:
        return _STANDING, STILL
    top, top_yaw = config.max_speed_mps, math.radians(config.max_yaw_rate_degps)
    yaw_acceleration = math.radians(config.yaw_acceleration_degps2)
    wanted = min(top, max(-top, command.speed_mps))
    wanted_yaw = min(top_yaw, max(-top_yaw, command.yaw_rate_radps))
    speed = ramp(state.speed_mps, wanted, config.acceleration_mps2, config.jerk_mps3, dt)
    yaw = ramp(
        state.yaw_rate_radps,
        wanted_yaw,
        yaw_acceleration,
        yaw_acceleration * config.jerk_mps3 / config.acceleration_mps2,
        dt,
    )
    trim = _yaw_trim(config, state.yaw_trim_radps, speed.value, yaw.value, inputs, dt)
    stroke_mm = inputs.strokes.stroke_mm if inputs.strokes is not None else STILL
    wheel_rpm = wheel_speeds_rpm(design, speed.value, yaw.value + trim, stroke_mm)
    if config.speed_source == "roboteq":
        return DriveState(speed, yaw, trim), wheel_rpm
    wheel_trim = _wheel_trim(config, state.wheel_trim_rpm, wheel_rpm, inputs, dt)
    fl, fr, rl, rr = (
        min(design.rpm_max, max(-design.rpm_max, rpm + more))
        for rpm, more in zip(wheel_rpm, wheel_trim, strict=True)
    )
    return DriveState(speed, yaw, trim, wheel_trim), (fl, fr, rl, rr)


def wheel_speeds_rpm(design: DriveDesign, speed_mps: float, yaw_rate_radps: float, stroke_mm: Four) -> Four:
    """Return wheel speeds for a motion at given strokes; beyond the limit all shrink, the curvature stays."""
    turning = yaw_rate_radps * design.config.effective_track_factor
    half_fl, half_fr, half_rl, half_rr = half_tracks_m(design.track, stroke_mm)
    gain = design.rpm_per_mps
    fl, rl = gain * (speed_mps - turning * half_fl), gain * (speed_mps - turning * half_rl)
    fr, rr = gain * (speed_mps + turning * half_fr), gain * (speed_mps + turning * half_rr)
    fastest = max(abs(fl), abs(fr), abs(rl), abs(rr))
    if fastest <= design.rpm_max:
        return fl, fr, rl, rr
    scale = design.rpm_max / fastest
    return scale * fl, scale * fr, scale * rl, scale * rr


def ramp(now: Ramp, wanted: float, acceleration: float, jerk: float, dt: float) -> Ramp:
    """Bring a value to `wanted` with limited first and second derivative, without overshoot."""
    left = wanted - now.value
    if abs(left) <= jerk * dt * dt and abs(now.rate) <= jerk * dt:
        return Ramp(wanted, 0.0)
    # The rate from which steps of jerk * dt still bring it to zero within what is left.
    half = 0.5 * jerk * dt
    braking = math.sqrt(half * half + 2.0 * jerk * abs(left)) - half
    goal = math.copysign(min(acceleration, braking), left)
    change = min(jerk * dt, max(-jerk * dt, goal - now.rate))
    rate = now.rate + change
    value = now.value + rate * dt
    if (wanted - value) * left <= 0.0 and abs(rate) <= 2.0 * jerk * dt:
        return Ramp(wanted, 0.0)
    return Ramp(value, rate)


def _yaw_trim(
    config: DriveControlConfig, trim: float, speed: float, yaw_rate: float, inputs: Inputs, dt: float
) -> float:
    """Integrate what the gyro misses of the yaw rate; forget it at a standstill."""
    if inputs.imu is None or (speed == 0.0 and yaw_rate == 0.0):
        return 0.0
    most = math.radians(config.yaw_rate_trim_max_degps)
    missing = yaw_rate - inputs.imu.rate_radps[2]
    return min(most, max(-most, trim + config.yaw_rate_gain_per_s * missing * dt))


def _wheel_trim(
    config: DriveControlConfig, trim_rpm: Four, wheel_rpm: Four, inputs: Inputs, dt: float
) -> Four:
    """Integrate what each wheel misses of its speed on mega_speed's sensors; forget it at a standstill."""
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is None or right is None or wheel_rpm == STILL:
        return STILL
    measured = (left.speed_radps[0], right.speed_radps[0], left.speed_radps[1], right.speed_radps[1])
    most, gain = config.wheel_trim_max_rpm, config.wheel_speed_gain_per_s * dt
    fl, fr, rl, rr = (
        min(most, max(-most, old + gain * (rpm - _RPM_PER_RADPS * speed)))
        for old, rpm, speed in zip(trim_rpm, wheel_rpm, measured, strict=True)
    )
    return fl, fr, rl, rr
