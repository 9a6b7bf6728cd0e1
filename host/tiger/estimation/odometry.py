"""Where the robot is and how fast it goes: wheels and IMU, gated by slip.

`inertial` carries the motion forward from gyroscope and accelerometer; here is what holds it: wheels that do
not slip, a body that hardly slides sideways, standing still, and Earth's magnetic field. Place and heading
count from where the robot was when its first samples came, in a level plane: x points where it looked. The
distance is counted along the ground; x and y are of its projection.
"""

from __future__ import annotations

from dataclasses import field
from math import asin, cos, hypot, pi, radians, sin, sqrt
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
    Measurement,
    Motion,
    N,
    Noise,
    U,
    V,
)
from tiger.estimation.slip import FourBools, SlipState, Wheels
from tiger.frozen import dataclass, replace
from tiger.models.full_car import GRAVITY_MPS2
from tiger.record import STILL, Odometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import OdometryConfig, RobotConfig
    from tiger.record import Estimate, Four, ImuRawSample, Inputs, Three, WheelSample

    Array = NDArray[np.float64]

Stands = tuple[list[Measurement], float]
Six = tuple[float, float, float, float, float, float]

CORRECT_EVERY_S = 0.02
STANDING_EVERY_S = 0.1
"""Between two corrections, while the robot moves and while it stands."""
HALF_A_SAMPLE_S = 0.005
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
    track_offset_m: float  # measured at half the stroke, less what the mechanism's drawing says

    def half_track_at(self, stroke_mm: float) -> float:
        """Half the track at one wheel in m: the vehicle's at half its stroke, and how the mechanism changes it."""
        return half_track_m(self.drive, stroke_mm) + self.track_offset_m


@dataclass(frozen=True, slots=True)
class Magnetic:
    """What is known of the magnetic field beside the errors' nominal."""

    sample_ut: Three = (0.0, 0.0, 0.0)  # last used
    up_ut: float = 0.0  # vertical component
    found: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """What a correction leaves to the next."""

    covariance: Array = field(default_factory=lambda: np.zeros((N, N)))
    slip: SlipState = field(default_factory=SlipState)
    imu_t_s: float = -np.inf  # of the sample that was corrected
    yaw_rad: float = 0.0
    wheel_t_s: float = -np.inf
    stood_s: float = 0.0
    turning_s: float = 0.0  # for how long it has seemed to turn although it stands
    magnetic: Magnetic = field(default_factory=Magnetic)
    pose_covariance: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    speed_sigma_mps: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class OdometryState:
    """What a tick leaves to the next."""

    motion: Motion = field(default_factory=Motion)
    imu_t_s: float = -np.inf
    push_mps2: float = 0.0  # specific force of the tyres ahead, smoothed
    side_push_mps2: float = 0.0
    distance_m: float = 0.0
    held: Held = field(default_factory=Held)
    begun: bool = False


def design_odometry(robot: RobotConfig) -> OdometryDesign:
    """Prepare the filter; tyre stiffness is that of the vehicle's tyre under its static load."""
    vehicle, config = robot.vehicle, robot.odometry
    ahead, across = load_tire_set().stiffness_per_load
    drive = design_drive(robot)
    return OdometryDesign(
        config=config,
        noise=inertial.make_noise(config),
        drive=drive,
        wheel_radius_m=vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor,
        com_height_m=vehicle.body.com_height_m,
        imu_height_m=vehicle.imu_offset_m[2],
        drive_slip_s2pm=1.0 / (ahead * GRAVITY_MPS2),
        side_slip_s2pm=1.0 / (across * GRAVITY_MPS2),
        track_offset_m=vehicle.body.half_track_m - half_track_m(drive, 0.5 * drive.stroke_max_mm),
    )


def step(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[OdometryState, Odometry]:
    """Advance by `dt` seconds; `estimate` has the attitude and the ground's slope of this tick."""
    raw, left, right = inputs.imu_raw, inputs.wheels_left, inputs.wheels_right
    if raw is None or not any(raw.accel_mps2):  # a sensor that has not woken up feels no gravity
        return state, _shown(design, state, inputs.now_s) if state.begun else Odometry()
    if not state.begun:
        return _begun(design, raw), Odometry()
    if raw.t_s > state.imu_t_s:
        state = _integrated(design, state, raw, estimate)
    if left is not None and right is not None and _due(design.config, state, left, right):
        state = _corrected(design, state, inputs, estimate)
    return state, _shown(design, state, inputs.now_s)


def _begun(design: OdometryDesign, raw: ImuRawSample) -> OdometryState:
    """Start where the accelerometer says up is."""
    ax, ay, _ = raw.accel_mps2
    g = GRAVITY_MPS2
    pitch, roll = asin(min(1.0, max(-1.0, -ax / g))), asin(min(1.0, max(-1.0, ay / g)))
    slipping = SlipState(scrub=design.config.scrub_start)
    return OdometryState(
        motion=Motion(pitch_rad=pitch, roll_rad=roll),
        imu_t_s=raw.t_s,
        held=Held(covariance=design.noise.at_start, slip=slipping, imu_t_s=raw.t_s),
        begun=True,
    )


def _integrated(
    design: OdometryDesign, state: OdometryState, raw: ImuRawSample, estimate: Estimate
) -> OdometryState:
    """Carry the nominal motion to a new IMU sample."""
    dt, before = raw.t_s - state.imu_t_s, state.motion
    if dt > LONGEST_GAP_S:
        return replace(state, imu_t_s=raw.t_s)
    scale, ground = design.config.gyro_scale_factor, estimate.plate_pitch_rad
    p, q, r = raw.gyro_radps
    motion = inertial.integrate(before, raw.accel_mps2, (scale * p, scale * q, scale * r), ground, dt)
    smooth = dt / design.config.push_time_s
    (fx, fy, _), (ax, ay) = raw.accel_mps2, motion.learned.accel_bias_mps2
    push = fx - ax + GRAVITY_MPS2 * sin(motion.pitch_rad - ground)  # as felt along the ground
    return OdometryState(
        motion,
        raw.t_s,
        state.push_mps2 + smooth * (push - state.push_mps2),
        state.side_push_mps2 + smooth * (fy - ay - state.side_push_mps2),
        state.distance_m + abs(0.5 * (motion.u_mps + before.u_mps) * dt),
        state.held,
        True,
    )


# ---- what holds the motion --------------------------------------------------


def _due(config: OdometryConfig, state: OdometryState, left: WheelSample, right: WheelSample) -> bool:
    """Tell whether it is time to correct; a robot that stands needs it less often."""
    held = state.held
    if min(left.t_s, right.t_s) <= held.wheel_t_s:
        return False
    waited_s = state.imu_t_s - held.imu_t_s + HALF_A_SAMPLE_S
    if waited_s < CORRECT_EVERY_S:
        return False
    turns = max(map(abs, left.speed_radps + right.speed_radps)) >= config.stand_wheel_radps
    return turns or held.stood_s <= config.stand_s or waited_s >= STANDING_EVERY_S


def _corrected(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate
) -> OdometryState:
    """Carry the covariance forward and take in wheels, standstill and magnetometer."""
    left, right, raw = inputs.wheels_left, inputs.wheels_right, inputs.imu_raw
    assert left is not None
    assert right is not None
    assert raw is not None
    config, motion, held = design.config, state.motion, state.held
    dt, yaw_rate = state.imu_t_s - held.imu_t_s, motion.rate_radps[2]
    covariance = inertial.spread(held.covariance, motion, design.noise, dt)
    coasting = sqrt(max(covariance.item(U, U), 0.0))
    wheels, wheel_radps, speed = _read_wheels(design, state, inputs, estimate)
    good = slip.trusted(config, held.slip, wheels, speed, coasting, yaw_rate)

    stood_s = _standing_s(config, state, covariance.item(GZ, GZ), wheel_radps, dt)
    standing = stood_s > config.stand_s
    turning_s = 0.0
    if standing:
        measured, turning_s = _stands(design, held, covariance, motion, dt)
    else:
        measured = [_slides_little(design, state)]
        rolls, good = _rolls(design, held.slip, wheels, good, speed, coasting, yaw_rate)
        measured += rolls
    magnetic = held.magnetic
    if raw.mag_ut != magnetic.sample_ut:
        motion, magnetic, north = _with_field(config, covariance, motion, magnetic, raw.mag_ut)
        measured += north

    errors, covariance = inertial.correct(covariance, measured)
    motion = inertial.put_right(motion, errors)
    sigma = sqrt(max(covariance.item(U, U), 0.0))
    slipping = slip.step(config, held.slip, wheels, good, motion.u_mps, sigma, yaw_rate, dt)
    (xx, xy, x_yaw), (_, yy, y_yaw), (_, _, yaw_yaw) = covariance[: YAW + 1, : YAW + 1].tolist()
    after = Held(
        covariance,
        SlipState(scrub=slipping.scrub) if standing else slipping,
        state.imu_t_s,
        motion.yaw_rad,
        max(left.t_s, right.t_s),
        stood_s,
        turning_s,
        magnetic,
        (xx, xy, x_yaw, yy, y_yaw, yaw_yaw),
        sigma,
    )
    return replace(state, motion=motion, held=after)


def _read_wheels(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate
) -> tuple[Wheels, Four, float]:
    """What the wheels tell, their speeds, and the body's speed by inertia when they were measured.

    Teeth tell of the time they took, which is over; a body that pitches carries the IMU along.
    """
    config, motion = design.config, state.motion
    left, right, strokes = inputs.wheels_left, inputs.wheels_right, inputs.strokes
    assert left is not None
    assert right is not None
    (fl, rl), (fr, rr) = left.speed_radps, right.speed_radps
    mean_radps = 0.25 * (abs(fl) + abs(fr) + abs(rl) + abs(rr))
    tooth_s = 0.5 * TOOTH_RAD / mean_radps if mean_radps > TOOTH_RAD / config.longest_tooth_s else 0.0
    before_s = state.imu_t_s - 0.5 * (left.t_s + right.t_s) + tooth_s

    _, q, r = motion.rate_radps
    lever = q * (design.com_height_m + design.imu_height_m)
    ahead = cos(motion.pitch_rad - estimate.plate_pitch_rad)
    along = ahead * design.wheel_radius_m * (1.0 + motion.learned.scale)
    a, b, c, d = strokes.stroke_mm if strokes is not None else STILL
    wheels = slip.told(
        (along * fl + lever, along * fr + lever, along * rl + lever, along * rr + lever),
        (design.half_track_at(a), design.half_track_at(b), design.half_track_at(c), design.half_track_at(d)),
        design.drive_slip_s2pm * state.push_mps2,
        r,
        state.held.slip.scrub,
    )
    return wheels, (fl, fr, rl, rr), motion.u_mps - motion.accel_mps2[0] * before_s


def _standing_s(
    config: OdometryConfig, state: OdometryState, bias_variance: float, wheel_radps: Four, dt: float
) -> float:
    """For how long all wheels have stood while nothing said that the robot slides."""
    if max(map(abs, wheel_radps)) >= config.stand_wheel_radps:
        return 0.0
    most_radps = radians(config.stand_yaw_rate_degps)
    known = bias_variance < most_radps**2 / 9.0
    if known and abs(state.motion.rate_radps[2]) > most_radps:
        return 0.0
    slow = hypot(state.motion.u_mps, state.motion.v_mps) < config.stand_speed_mps
    return state.held.stood_s + dt if slow or not known else 0.0


def _stands(design: OdometryDesign, held: Held, covariance: Array, motion: Motion, dt: float) -> Stands:
    """Neither the wheels' contacts nor the heading move: what the gyro has turned since is its bias.

    A robot that drives off turns before the first tooth passes a sensor, but not for long.
    """
    config, (p, q, _) = design.config, motion.rate_radps
    often = CORRECT_EVERY_S / dt  # sigmas are those of a measurement every 20 ms
    measured = [
        Measurement({U: 1.0}, q * design.imu_height_m - motion.u_mps, config.stand_noise_mps**2 * often),
        Measurement({V: 1.0}, -p * design.imu_height_m - motion.v_mps, config.stand_noise_mps**2 * often),
    ]
    turned_radps = (motion.yaw_rad - held.yaw_rad) / dt
    bias = Measurement({GZ: 1.0}, turned_radps, radians(config.stand_gyro_degps) ** 2 * often)
    turns = inertial.surprising(covariance, [bias], config.stand_gate_sigmas)
    turning_s = held.turning_s + dt if turns else 0.0
    without_gap = dt < STANDING_EVERY_S + CORRECT_EVERY_S
    if without_gap and (not turns or turning_s > config.stand_turning_s):
        measured.append(bias)
    return measured, turning_s


def _rolls(
    design: OdometryDesign,
    slipping: SlipState,
    wheels: Wheels,
    good: FourBools,
    speed_mps: float,
    coasting_mps: float,
    yaw_rate_radps: float,
) -> tuple[list[Measurement], FourBools]:
    """The speed that good wheels tell, and which of them are good once their mean has been looked at."""
    if not any(good):
        return [], good
    config = design.config
    seen, both = slip.mean_of(wheels.told_mps, good)
    if both and not slip.plausible(config, slipping, seen, speed_mps, coasting_mps, yaw_rate_radps):
        return [], slip.NONE
    one_side = config.scrub_noise * wheels.half_track_m[0]
    scrubbing = (config.scrub_speed_m if both else one_side) * yaw_rate_radps
    # Where wheels slip the ground is slippery: those that hold carry more, and may slip a little unseen.
    sigma = config.wheel_sigma_mps * config.missing_wheel_factor ** (4 - sum(good))
    variance = sigma**2 + config.memory * scrubbing**2
    return [Measurement({U: 1.0, SCALE: -seen}, seen - speed_mps, variance)], good


def _slides_little(design: OdometryDesign, state: OdometryState) -> Measurement:
    """A tyre drifts in proportion to the side force it takes; a turn is about a place not quite known."""
    config, motion = design.config, state.motion
    p, _, r = motion.rate_radps
    sliding = -design.side_slip_s2pm * state.side_push_mps2 * motion.u_mps
    variance = config.slide_sigma_mps**2 + config.memory * (config.slide_m * r) ** 2
    return Measurement({V: 1.0}, sliding - p * design.imu_height_m - motion.v_mps, variance)


def _with_field(
    config: OdometryConfig, covariance: Array, motion: Motion, magnetic: Magnetic, mag_ut: Three
) -> tuple[Motion, Magnetic, list[Measurement]]:
    """Look at a magnetometer sample, turned level; the first one is what Earth's field is taken for.

    It is Earth's field turned by the yaw, and what the robot itself carries; an error of roll or pitch mixes
    in the vertical field. A field whose vertical part or direction is not as expected is left out.
    """
    sin_roll, cos_roll = sin(motion.roll_rad), cos(motion.roll_rad)
    sin_pitch, cos_pitch = sin(motion.pitch_rad), cos(motion.pitch_rad)
    yaw_rad = motion.yaw_rad - config.mag_lag_s * motion.rate_radps[2]
    cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
    x, y, z = mag_ut
    level_y = cos_roll * y - sin_roll * z
    down = sin_roll * y + cos_roll * z
    level_x, up = cos_pitch * x + sin_pitch * down, cos_pitch * down - sin_pitch * x
    if not magnetic.found:
        field_ut = (cos_yaw * level_x - sin_yaw * level_y, sin_yaw * level_x + cos_yaw * level_y)
        learned = replace(motion.learned, field_ut=field_ut)
        return replace(motion, learned=learned), Magnetic(mag_ut, up, True), []
    (north, west), (iron_x, iron_y) = motion.learned.field_ut, motion.learned.iron_ut
    ahead, left = cos_yaw * north + sin_yaw * west, cos_yaw * west - sin_yaw * north
    variance = config.mag_noise_ut**2
    measured = [
        Measurement(
            {YAW: left, FX: cos_yaw, FY: sin_yaw, HX: 1.0, PITCH: -up}, level_x - ahead - iron_x, variance
        ),
        Measurement(
            {YAW: -ahead, FX: -sin_yaw, FY: cos_yaw, HY: 1.0, ROLL: up}, level_y - left - iron_y, variance
        ),
    ]
    off, most = up - magnetic.up_ut, config.mag_gate_sigmas
    if abs(off) > most * config.mag_up_noise_ut or inertial.surprising(covariance, measured, most):
        return motion, Magnetic(mag_ut, magnetic.up_ut, True), []
    return motion, Magnetic(mag_ut, magnetic.up_ut + config.mag_up_learning * off, True), measured


# ---- what is shown --------------------------------------------------


def _shown(design: OdometryDesign, state: OdometryState, now_s: float) -> Odometry:
    """The estimate for now: the last sample's motion carried on for its age."""
    motion, held = state.motion, state.held
    _, q, r = motion.rate_radps
    age_s = min(max(now_s - state.imu_t_s, 0.0), LONGEST_GAP_S)
    ahead, left = motion.u_mps * age_s, motion.v_mps * age_s
    yaw = motion.yaw_rad + r * age_s
    cos_yaw, sin_yaw = cos(yaw), sin(yaw)
    return Odometry(
        motion.x_m + cos_yaw * ahead - sin_yaw * left,
        motion.y_m + sin_yaw * ahead + cos_yaw * left,
        yaw,
        held.pose_covariance,
        motion.u_mps - q * design.imu_height_m,
        held.speed_sigma_mps,
        r,
        state.distance_m,
        held.slip.ratio,
        held.slip.slipping,
        held.stood_s > design.config.stand_s,
    )
