"""Where the robot is and how fast it goes: wheels and IMU, gated by slip.

`inertial` carries the motion forward from gyroscope and accelerometer; here is what holds it: wheels that do
not slip, a body that hardly slides sideways, standing still, and Earth's magnetic field. Place and heading
count from where the robot was when its first samples came, in a level plane: x points where it looked. The
distance is counted along the ground; x and y are of its projection.
"""

from __future__ import annotations

from dataclasses import field
from math import asin, cos, hypot, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.tire import load_tire_set
from tiger.control.drive import DriveDesign, design_drive, half_track_m
from tiger.estimation import inertial, slip
from tiger.estimation.inertial import (
    FX,
    FY,
    GZ,
    HX,
    HY,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Correction,
    Motion,
    N,
    Noise,
    U,
    V,
)
from tiger.estimation.slip import SlipState
from tiger.frozen import dataclass, replace
from tiger.models.full_car import GRAVITY_MPS2
from tiger.record import STILL, Odometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import OdometryConfig, RobotConfig
    from tiger.record import Estimate, Four, ImuRawSample, Inputs, Three

    Array = NDArray[np.float64]

Six = tuple[float, float, float, float, float, float]

CORRECT_EVERY = 2
"""IMU samples between two corrections: 20 ms."""
LONGEST_GAP_S = 0.1
"""Between two IMU samples; after a longer one no one knows what happened meanwhile."""
TOOTH_RAD = 2.0 * pi / 60.0


@dataclass(frozen=True, slots=True, eq=False)
class OdometryDesign:
    """What `design_odometry` computes once."""

    config: OdometryConfig
    noise: Noise
    drive: DriveDesign
    wheel_radius_m: float
    com_height_m: float
    imu_height_m: float  # over the COM
    drive_slip_s2pm: float  # slip ratio for each m/s2 that the wheels push
    side_slip_s2pm: float


@dataclass(frozen=True, slots=True, eq=False)
class OdometryState:
    """What a tick leaves to the next."""

    motion: Motion = field(default_factory=Motion)
    covariance: Array = field(default_factory=lambda: np.zeros((N, N)))
    slip: SlipState = field(default_factory=SlipState)
    imu_t_s: float = -np.inf
    wheel_t_s: float = -np.inf
    mag_ut: Three = (0.0, 0.0, 0.0)  # the sample last used
    field_up_ut: float = 0.0
    corrected_s: float = 0.0  # time since the last correction
    samples: int = 0  # of the IMU, since then
    push_mps2: float = 0.0  # specific force of the tyres ahead, smoothed
    side_push_mps2: float = 0.0
    stood_s: float = 0.0
    distance_m: float = 0.0
    pose_covariance: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    speed_sigma_mps: float = 0.0
    begun: bool = False
    has_field: bool = False


def design_odometry(robot: RobotConfig) -> OdometryDesign:
    """Prepare the filter; tyre stiffness is that of the vehicle's tyre under its static load."""
    vehicle, config = robot.vehicle, robot.odometry
    ahead, across = load_tire_set().stiffness_per_load
    return OdometryDesign(
        config=config,
        noise=inertial.make_noise(config),
        drive=design_drive(robot),
        wheel_radius_m=vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor,
        com_height_m=vehicle.body.com_height_m,
        imu_height_m=vehicle.imu_offset_m[2],
        drive_slip_s2pm=1.0 / (ahead * GRAVITY_MPS2),
        side_slip_s2pm=1.0 / (across * GRAVITY_MPS2),
    )


def step(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[OdometryState, Odometry]:
    """Advance by `dt` seconds; `estimate` has the attitude and the ground's slope of this tick."""
    raw, left, right = inputs.imu_raw, inputs.wheels_left, inputs.wheels_right
    if raw is None:
        return state, Odometry()
    if not state.begun:
        return _begun(design, raw), Odometry()
    if raw.t_s > state.imu_t_s:
        state = _integrated(design, state, raw, estimate)
    if left is not None and right is not None:
        sampled_s = 0.5 * (left.t_s + right.t_s)
        fresh = min(left.t_s, right.t_s) > state.wheel_t_s
        if fresh and state.samples >= CORRECT_EVERY:
            state = _corrected(design, state, inputs, estimate, sampled_s)
    return state, _shown(design, state, inputs.now_s)


def _begun(design: OdometryDesign, raw: ImuRawSample) -> OdometryState:
    """Start where the accelerometer says up is."""
    ax, ay, _ = raw.accel_mps2
    g = GRAVITY_MPS2
    pitch, roll = asin(min(1.0, max(-1.0, -ax / g))), asin(min(1.0, max(-1.0, ay / g)))
    return OdometryState(
        motion=Motion(pitch_rad=pitch, roll_rad=roll),
        covariance=inertial.start_covariance(design.noise),
        slip=SlipState(scrub=design.config.scrub_start),
        imu_t_s=raw.t_s,
        begun=True,
    )


def _integrated(
    design: OdometryDesign, state: OdometryState, raw: ImuRawSample, estimate: Estimate
) -> OdometryState:
    """Carry the nominal motion to a new IMU sample."""
    dt = raw.t_s - state.imu_t_s
    if dt > LONGEST_GAP_S:
        return replace(state, imu_t_s=raw.t_s, corrected_s=state.corrected_s + dt)
    scale = design.config.gyro_scale_factor
    p, q, r = raw.gyro_radps
    gyro = (scale * p, scale * q, scale * r)
    motion = inertial.integrate(state.motion, raw.accel_mps2, gyro, estimate.plate_pitch_rad, dt)
    smooth = dt / design.config.push_time_s
    push = raw.accel_mps2[0] - motion.accel_bias_mps2[0]
    push += GRAVITY_MPS2 * sin(motion.pitch_rad - estimate.plate_pitch_rad)  # as felt along the ground
    side = raw.accel_mps2[1] - motion.accel_bias_mps2[1]
    moved = 0.5 * (motion.u_mps + state.motion.u_mps) * dt
    return replace(
        state,
        motion=motion,
        imu_t_s=raw.t_s,
        corrected_s=state.corrected_s + dt,
        samples=state.samples + 1,
        push_mps2=state.push_mps2 + smooth * (push - state.push_mps2),
        side_push_mps2=state.side_push_mps2 + smooth * (side - state.side_push_mps2),
        distance_m=state.distance_m + abs(moved),
    )


# ---- what holds the motion --------------------------------------------------


def _corrected(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate, sampled_s: float
) -> OdometryState:
    """Carry the covariance forward and take in wheels, standstill and magnetometer."""
    config, motion, dt = design.config, state.motion, state.corrected_s
    covariance = inertial.spread(state.covariance, motion, design.noise, dt)
    correction = Correction(motion, covariance)
    left, right = inputs.wheels_left, inputs.wheels_right
    assert left is not None
    assert right is not None
    wheel_radps = (left.speed_radps[0], right.speed_radps[0], left.speed_radps[1], right.speed_radps[1])
    p, q, r = motion.rate_radps

    # The body's speed at the IMU's height when the wheels were measured: teeth tell of the time they took.
    mean_radps = 0.25 * sum(map(abs, wheel_radps))
    tooth_s = 0.5 * TOOTH_RAD / mean_radps if mean_radps > TOOTH_RAD / config.longest_tooth_s else 0.0
    before_s = state.imu_t_s - sampled_s + tooth_s
    lever = q * (design.com_height_m + design.imu_height_m)
    ahead = cos(motion.pitch_rad - estimate.plate_pitch_rad)
    radius = design.wheel_radius_m * (1.0 + motion.scale)
    rolls = ahead * (1.0 - design.drive_slip_s2pm * state.push_mps2)
    strokes = inputs.strokes.stroke_mm if inputs.strokes is not None else STILL
    half_track = _four([half_track_m(design.drive, stroke) for stroke in strokes])
    surface = _four([radius * speed for speed in wheel_radps])
    wheels = slip.told(_four([rolls * speed + lever for speed in surface]), half_track, r, state.slip.scrub)
    speed = motion.u_mps - motion.accel_mps2[0] * before_s
    coasting = sqrt(max(float(covariance[U, U]), 0.0))
    good = slip.trusted(config, state.slip, wheels, speed, coasting, r)

    stood_s = _standing_s(config, state, wheel_radps, dt)
    standing = stood_s > config.stand_s
    if standing:
        variance = config.stand_noise_mps**2
        correction.take({U: 1.0}, q * design.imu_height_m - motion.u_mps, variance)
        correction.take({V: 1.0}, -p * design.imu_height_m - motion.v_mps, variance)
        correction.take({GZ: 1.0}, r, np.deg2rad(config.stand_gyro_degps) ** 2)
    else:
        if any(good):
            seen, both = slip.mean_of(wheels.told_mps, good)
            if both and not slip.plausible(config, state.slip, seen, speed, coasting, r):
                good = slip.NONE
        if any(good):
            scrubbing = config.scrub_speed_m * r if both else config.scrub_noise * r * half_track[0]
            variance = config.wheel_sigma_mps**2 + config.memory * scrubbing**2
            correction.take({U: 1.0, SCALE: -seen}, seen - speed, variance)
        sliding = -design.side_slip_s2pm * state.side_push_mps2 * motion.u_mps
        variance = config.slide_sigma_mps**2 + config.memory * (config.slide_m * r) ** 2
        correction.take({V: 1.0}, sliding - p * design.imu_height_m - motion.v_mps, variance)

    mag_ut, field_up, has_field = state.mag_ut, state.field_up_ut, state.has_field
    raw = inputs.imu_raw
    if raw is not None and raw.mag_ut != mag_ut:
        mag_ut = raw.mag_ut
        motion, field_up, has_field = _with_field(config, correction, state, mag_ut)
        correction.motion = motion

    motion = correction.applied()
    sigma = sqrt(max(float(correction.covariance[U, U]), 0.0))
    (xx, xy, x_yaw), (_, yy, y_yaw), (_, _, yaw_yaw) = correction.covariance[: YAW + 1, : YAW + 1].tolist()
    surfaces = _four([ahead * speed + lever for speed in surface])
    slipping = slip.step(
        config, state.slip, replace(wheels, surface_mps=surfaces), good, motion.u_mps, sigma, r, dt
    )
    return replace(
        state,
        motion=motion,
        covariance=correction.covariance,
        slip=SlipState(scrub=slipping.scrub) if standing else slipping,
        wheel_t_s=max(left.t_s, right.t_s),
        mag_ut=mag_ut,
        field_up_ut=field_up,
        has_field=has_field,
        corrected_s=0.0,
        samples=0,
        stood_s=stood_s,
        pose_covariance=(xx, xy, x_yaw, yy, y_yaw, yaw_yaw),
        speed_sigma_mps=sigma,
    )


def _standing_s(config: OdometryConfig, state: OdometryState, wheel_radps: Four, dt: float) -> float:
    """For how long all wheels have stood while nothing said that the robot slides."""
    still = max(map(abs, wheel_radps)) < config.stand_wheel_radps
    slow = hypot(state.motion.u_mps, state.motion.v_mps) < config.stand_speed_mps
    turning = abs(state.motion.rate_radps[2]) > np.deg2rad(config.stand_yaw_rate_degps)
    known = state.covariance[GZ, GZ] < np.deg2rad(config.stand_yaw_rate_degps) ** 2 / 9.0
    return state.stood_s + dt if still and (slow or not known) and not (turning and known) else 0.0


def _with_field(
    config: OdometryConfig, correction: Correction, state: OdometryState, mag_ut: Three
) -> tuple[Motion, float, bool]:
    """Take in a magnetometer sample, turned level; return the motion, the field's vertical part, and True.

    It is Earth's field turned by the yaw, and what the robot itself carries; an error of roll or pitch mixes
    in the vertical field. A field whose vertical part or direction is not as expected is left out.
    """
    motion = correction.motion
    sin_roll, cos_roll = sin(motion.roll_rad), cos(motion.roll_rad)
    sin_pitch, cos_pitch = sin(motion.pitch_rad), cos(motion.pitch_rad)
    x, y, z = mag_ut
    level_y = cos_roll * y - sin_roll * z
    down = sin_roll * y + cos_roll * z
    level_x, up = cos_pitch * x + sin_pitch * down, cos_pitch * down - sin_pitch * x
    if not state.has_field:
        cos_yaw, sin_yaw = cos(motion.yaw_rad), sin(motion.yaw_rad)
        field_ut = (cos_yaw * level_x - sin_yaw * level_y, sin_yaw * level_x + cos_yaw * level_y)
        return replace(motion, field_ut=field_ut), up, True
    cos_yaw, sin_yaw = cos(motion.yaw_rad), sin(motion.yaw_rad)
    (north, west), (iron_x, iron_y) = motion.field_ut, motion.iron_ut
    ahead, left = cos_yaw * north + sin_yaw * west, cos_yaw * west - sin_yaw * north
    variance = config.mag_noise_ut**2
    rows = (
        {YAW: left, FX: cos_yaw, FY: sin_yaw, HX: 1.0, PITCH: -up},
        {YAW: -ahead, FX: -sin_yaw, FY: cos_yaw, HY: 1.0, ROLL: up},
    )
    misses = (level_x - ahead - iron_x, level_y - left - iron_y)
    most = config.mag_gate_sigmas**2
    off = up - state.field_up_ut
    if off * off > most * config.mag_up_noise_ut**2 or any(
        miss * miss > most * (correction.variance(row) + variance)
        for row, miss in zip(rows, misses, strict=True)
    ):
        return motion, state.field_up_ut, True
    for row, miss in zip(rows, misses, strict=True):
        correction.take(row, miss, variance)
    return motion, state.field_up_ut + config.mag_up_learning * off, True


# ---- what is shown --------------------------------------------------


def _shown(design: OdometryDesign, state: OdometryState, now_s: float) -> Odometry:
    """The estimate for now: the last sample's motion carried on for its age."""
    motion = state.motion
    _, q, r = motion.rate_radps
    age_s = min(max(now_s - state.imu_t_s, 0.0), LONGEST_GAP_S)
    ahead, left = motion.u_mps * age_s, motion.v_mps * age_s
    yaw = motion.yaw_rad + r * age_s
    cos_yaw, sin_yaw = cos(yaw), sin(yaw)
    return Odometry(
        motion.x_m + cos_yaw * ahead - sin_yaw * left,
        motion.y_m + sin_yaw * ahead + cos_yaw * left,
        yaw,
        state.pose_covariance,
        motion.u_mps - q * design.imu_height_m,
        state.speed_sigma_mps,
        r,
        state.distance_m,
        state.slip.ratio,
        state.slip.slipping,
        state.stood_s > design.config.stand_s,
    )


def _four(values: list[float]) -> Four:
    a, b, c, d = values
    return a, b, c, d
