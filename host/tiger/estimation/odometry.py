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
from tiger.estimation import inertial, slip
from tiger.estimation.inertial import (
    FX,
    FY,
    GZ,
    HX,
    HY,
    HZ,
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
from tiger.models.track import Track, half_tracks_m, track_of
from tiger.record import STILL, Odometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import OdometryConfig, RobotConfig
    from tiger.record import Estimate, Four, ImuRawSample, Inputs, StrokeSample, Three, WheelSample

    Array = NDArray[np.float64]

Six = tuple[float, float, float, float, float, float]

LOOK_EVERY_S = 0.02
"""Between two looks at which wheels slip; sigmas are those of a measurement this often."""
CORRECT_EVERY_S = 0.04
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
    wheel_radius_m: float
    com_height_m: float
    imu_height_m: float  # over the COM
    drive_slip_s2pm: float  # slip ratio for each m/s2 that the wheels push
    side_slip_s2pm: float
    track: Track


@dataclass(frozen=True, slots=True)
class Magnetic:
    """What is known of the magnetic field beside the errors' nominal."""

    sample_ut: Three = (0.0, 0.0, 0.0)  # last used
    up_ut: float = 0.0  # vertical component
    off_ut: tuple[float, float] = (0.0, 0.0)  # how far the last samples were off together, ahead and left
    doubted_s: float = 0.0  # for how long the field has not been used
    found: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """What a correction leaves to the next."""

    covariance: Array = field(default_factory=lambda: np.zeros((N, N)))
    imu_t_s: float = -np.inf  # of the sample that was corrected
    yaw_rad: float = 0.0
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
    slip: SlipState = field(default_factory=SlipState)
    looked_t_s: float = -np.inf  # IMU sample of the last look at the wheels ...
    wheel_t_s: float = -np.inf  # ... and theirs
    begun: bool = False


def design_odometry(robot: RobotConfig) -> OdometryDesign:
    """Prepare the filter; tyre stiffness is that of the vehicle's tyre under its static load."""
    vehicle, config = robot.vehicle, robot.odometry
    ahead, across = load_tire_set().stiffness_per_load
    return OdometryDesign(
        config=config,
        noise=inertial.make_noise(config),
        wheel_radius_m=vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor,
        com_height_m=vehicle.body.com_height_m,
        imu_height_m=vehicle.imu_offset_m[2],
        drive_slip_s2pm=1.0 / (ahead * GRAVITY_MPS2),
        side_slip_s2pm=1.0 / (across * GRAVITY_MPS2),
        track=track_of(vehicle),
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
        if left is not None and right is not None and min(left.t_s, right.t_s) > state.wheel_t_s:
            state = _with_wheels(design, state, inputs, left, right, estimate)
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
        held=Held(covariance=design.noise.at_start, imu_t_s=raw.t_s),
        slip=slipping,
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
        state.slip,
        state.looked_t_s,
        state.wheel_t_s,
        True,
    )


# ---- what holds the motion --------------------------------------------------


def _with_wheels(
    design: OdometryDesign,
    state: OdometryState,
    inputs: Inputs,
    left: WheelSample,
    right: WheelSample,
    estimate: Estimate,
) -> OdometryState:
    """See which wheels slip and, less often, put the motion right; standing needs neither often."""
    config, held, now_s = design.config, state.held, state.imu_t_s + HALF_A_SAMPLE_S
    if now_s - state.looked_t_s < LOOK_EVERY_S:
        return state
    (fl, rl), (fr, rr) = left.speed_radps, right.speed_radps
    wheel_radps = (fl, fr, rl, rr)
    still = max(map(abs, wheel_radps)) < config.stand_wheel_radps
    every_s = STANDING_EVERY_S if still and held.stood_s > config.stand_s else CORRECT_EVERY_S
    due = now_s - held.imu_t_s >= every_s
    if not due and every_s == STANDING_EVERY_S:
        return state
    sampled_s = 0.5 * (left.t_s + right.t_s)
    wheels, speed = _read_wheels(design, state, inputs.strokes, wheel_radps, sampled_s, estimate)
    sigma, yaw_rate = held.speed_sigma_mps, state.motion.rate_radps[2]
    good = slip.trusted(config, state.slip, wheels, speed, sigma, yaw_rate)
    since_s = min(state.imu_t_s - state.looked_t_s, STANDING_EVERY_S)
    if due:
        state, good = _corrected(design, state, inputs.imu_raw, wheels, good, speed, still)
    slipping = slip.step(
        config, state.slip, wheels, good, state.motion.u_mps, state.held.speed_sigma_mps, yaw_rate, since_s
    )
    if state.held.stood_s > config.stand_s:
        slipping = SlipState(scrub=slipping.scrub)
    return replace(state, slip=slipping, looked_t_s=state.imu_t_s, wheel_t_s=max(left.t_s, right.t_s))


def _read_wheels(
    design: OdometryDesign,
    state: OdometryState,
    strokes: StrokeSample | None,
    wheel_radps: Four,
    sampled_s: float,
    estimate: Estimate,
) -> tuple[Wheels, float]:
    """What the wheels tell, and the body's speed by inertia when they were measured.

    Teeth tell of the time they took, which is over; a body that pitches carries the IMU along.
    """
    config, motion = design.config, state.motion
    fl, fr, rl, rr = wheel_radps
    mean_radps = 0.25 * (abs(fl) + abs(fr) + abs(rl) + abs(rr))
    tooth_s = 0.5 * TOOTH_RAD / mean_radps if mean_radps > TOOTH_RAD / config.longest_tooth_s else 0.0
    before_s = state.imu_t_s - sampled_s + tooth_s
    _, q, r = motion.rate_radps
    lever = q * (design.com_height_m + design.imu_height_m)
    ahead = cos(motion.pitch_rad - estimate.plate_pitch_rad)
    along = ahead * design.wheel_radius_m * (1.0 + motion.learned.scale)
    stroke_mm = strokes.stroke_mm if strokes is not None else STILL
    wheels = slip.told(
        (along * fl + lever, along * fr + lever, along * rl + lever, along * rr + lever),
        half_tracks_m(design.track, stroke_mm),
        design.drive_slip_s2pm * state.push_mps2,
        r,
        state.slip.scrub,
    )
    return wheels, motion.u_mps - motion.accel_mps2[0] * before_s


def _corrected(
    design: OdometryDesign,
    state: OdometryState,
    raw: ImuRawSample | None,
    wheels: Wheels,
    good: FourBools,
    speed_mps: float,
    still: bool,
) -> tuple[OdometryState, FourBools]:
    """Carry the covariance forward, take in wheels, standstill and magnetometer; return who was believed."""
    config, motion, held = design.config, state.motion, state.held
    dt = state.imu_t_s - held.imu_t_s
    covariance = inertial.spread(held.covariance, motion, design.noise, dt)
    stood_s, turning_s = _standing_s(config, state, covariance.item(GZ, GZ), dt) if still else 0.0, 0.0
    if stood_s > config.stand_s:
        measured, turning_s = _stands(design, held, covariance, motion, dt)
    else:
        often = LOOK_EVERY_S / dt
        coasting = sqrt(max(covariance.item(U, U), 0.0))
        measured, good = _rolls(design, state, wheels, good, speed_mps, coasting, often)
        measured.append(_slides_little(design, state, often))
    magnetic = held.magnetic
    if raw is not None and raw.mag_ut != magnetic.sample_ut:
        motion, magnetic, north = _with_field(config, motion, magnetic, raw.mag_ut, dt)
        measured += north

    errors, covariance = inertial.correct(covariance, measured)
    motion = inertial.put_right(motion, errors)
    (xx, xy, x_yaw), (_, yy, y_yaw), (_, _, yaw_yaw) = covariance[: YAW + 1, : YAW + 1].tolist()
    after = Held(
        covariance,
        state.imu_t_s,
        motion.yaw_rad,
        stood_s,
        turning_s,
        magnetic,
        (xx, xy, x_yaw, yy, y_yaw, yaw_yaw),
        sqrt(max(covariance.item(U, U), 0.0)),
    )
    return replace(state, motion=motion, held=after), good


def _standing_s(config: OdometryConfig, state: OdometryState, bias_variance: float, dt: float) -> float:
    """For how long the wheels, which are still, have stood while nothing said that the robot slides."""
    most_radps = radians(config.stand_yaw_rate_degps)
    known = bias_variance < most_radps**2 / 9.0
    if known and abs(state.motion.rate_radps[2]) > most_radps:
        return 0.0
    slow = hypot(state.motion.u_mps, state.motion.v_mps) < config.stand_speed_mps
    return state.held.stood_s + dt if slow or not known else 0.0


def _stands(
    design: OdometryDesign, held: Held, covariance: Array, motion: Motion, dt: float
) -> tuple[list[Measurement], float]:
    """Neither the wheels' contacts nor the heading move: what the gyro has turned since is its bias.

    A robot that drives off turns before the first tooth passes a sensor, but not for long; returns for how
    long it has seemed to turn, too.
    """
    config, (p, q, _) = design.config, motion.rate_radps
    often = LOOK_EVERY_S / dt
    variance, bias_variance = config.stand_noise_mps**2 * often, radians(config.stand_gyro_degps) ** 2 * often
    measured = [
        Measurement({U: 1.0}, q * design.imu_height_m - motion.u_mps, variance),
        Measurement({V: 1.0}, -p * design.imu_height_m - motion.v_mps, variance),
    ]
    turned_radps = (motion.yaw_rad - held.yaw_rad) / dt
    expected = config.stand_gate_sigmas**2 * (covariance.item(GZ, GZ) + bias_variance)
    turning_s = held.turning_s + dt if turned_radps**2 > expected else 0.0
    without_gap = dt < STANDING_EVERY_S + LOOK_EVERY_S
    if without_gap and (turning_s == 0.0 or turning_s > config.stand_turning_s):
        measured.append(Measurement({GZ: 1.0}, turned_radps, bias_variance))
    return measured, turning_s


def _rolls(
    design: OdometryDesign,
    state: OdometryState,
    wheels: Wheels,
    good: FourBools,
    speed_mps: float,
    coasting_mps: float,
    often: float,
) -> tuple[list[Measurement], FourBools]:
    """The speed that good wheels tell, and which of them are good once their mean has been looked at."""
    if not any(good):
        return [], good
    config, yaw_rate = design.config, state.motion.rate_radps[2]
    seen, both = slip.mean_of(wheels.told_mps, good)
    if both and not slip.plausible(config, state.slip, seen, speed_mps, coasting_mps, yaw_rate):
        return [], slip.NONE
    one_side = config.scrub_noise * wheels.half_track_m[0]
    scrubbing = (config.scrub_speed_m if both else one_side) * yaw_rate
    # Where wheels slip the ground is slippery: those that hold carry more, and may slip a little unseen.
    sigma = config.wheel_sigma_mps * config.missing_wheel_factor ** (4 - sum(good))
    variance = often * (sigma**2 + config.memory * scrubbing**2)
    return [Measurement({U: 1.0, SCALE: -seen}, seen - speed_mps, variance)], good


def _slides_little(design: OdometryDesign, state: OdometryState, often: float) -> Measurement:
    """A tyre drifts in proportion to the side force it takes; a turn is about a place not quite known."""
    config, motion = design.config, state.motion
    p, _, r = motion.rate_radps
    sliding = -design.side_slip_s2pm * state.side_push_mps2 * motion.u_mps
    variance = often * (config.slide_sigma_mps**2 + config.memory * (config.slide_m * r) ** 2)
    return Measurement({V: 1.0}, sliding - p * design.imu_height_m - motion.v_mps, variance)


def _with_field(
    config: OdometryConfig, motion: Motion, magnetic: Magnetic, mag_ut: Three, dt: float
) -> tuple[Motion, Magnetic, list[Measurement]]:
    """Look at a magnetometer sample, turned level; the first one is what Earth's field is taken for.

    It is Earth's field turned by the yaw, and what the robot itself carries, which tilts with it; an error of
    roll or pitch mixes in the vertical field. A field whose vertical part or direction is not as expected is
    left out.
    """
    sin_roll, cos_roll = sin(motion.roll_rad), cos(motion.roll_rad)
    sin_pitch, cos_pitch = sin(motion.pitch_rad), cos(motion.pitch_rad)
    yaw_rad = motion.yaw_rad - config.mag_lag_s * motion.rate_radps[2]
    cos_yaw, sin_yaw = cos(yaw_rad), sin(yaw_rad)
    (x, y, z), (iron_x, iron_y, iron_z) = mag_ut, motion.learned.iron_ut
    x, y, z = x - iron_x, y - iron_y, z - iron_z
    level_y = cos_roll * y - sin_roll * z
    down = sin_roll * y + cos_roll * z
    level_x, up = cos_pitch * x + sin_pitch * down, cos_pitch * down - sin_pitch * x
    if not magnetic.found:
        field_ut = (cos_yaw * level_x - sin_yaw * level_y, sin_yaw * level_x + cos_yaw * level_y)
        learned = replace(motion.learned, field_ut=field_ut)
        return replace(motion, learned=learned), Magnetic(mag_ut, up, found=True), []
    north, west = motion.learned.field_ut
    ahead, left = cos_yaw * north + sin_yaw * west, cos_yaw * west - sin_yaw * north
    misses, gate = (level_x - ahead, level_y - left), config.mag_gate_sigmas
    magnetic = _doubted(config, magnetic, mag_ut, misses, up - magnetic.up_ut, dt)
    if magnetic.doubted_s > 0.0:
        return motion, magnetic, []
    variance = config.mag_noise_ut**2
    along = {YAW: left, FX: cos_yaw, FY: sin_yaw, PITCH: -up}
    along |= {HX: cos_pitch, HY: sin_pitch * sin_roll, HZ: sin_pitch * cos_roll}
    across = {YAW: -ahead, FX: -sin_yaw, FY: cos_yaw, HY: cos_roll, HZ: -sin_roll, ROLL: up}
    measured = [Measurement(along, misses[0], variance, gate), Measurement(across, misses[1], variance, gate)]
    return motion, magnetic, measured


def _doubted(
    config: OdometryConfig,
    magnetic: Magnetic,
    mag_ut: Three,
    misses_ut: tuple[float, float],
    up_miss_ut: float,
    dt: float,
) -> Magnetic:
    """See whether the field is Earth's: a magnet's comes slowly, and its samples are off together."""
    share = min(dt / config.mag_lasting_s, 1.0)
    (x, y), (ahead, left) = magnetic.off_ut, misses_ut
    x, y = x + share * (ahead - x), y + share * (left - y)
    lasting_ut = config.mag_lasting_ut * (0.5 if magnetic.doubted_s > 0.0 else 1.0)
    wrong = hypot(x, y) > lasting_ut or abs(up_miss_ut) > config.mag_gate_sigmas * config.mag_up_noise_ut
    doubted_s = magnetic.doubted_s + dt if wrong else 0.0
    if doubted_s > config.mag_longest_doubt_s:
        x = y = doubted_s = 0.0
    up = magnetic.up_ut + (0.0 if doubted_s > 0.0 else config.mag_up_learning * up_miss_ut)
    return Magnetic(mag_ut, up, (x, y), doubted_s, True)


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
        state.slip.ratio,
        state.slip.slipping,
        held.stood_s > design.config.stand_s,
    )
