"""Dead reckoning by gyroscope and accelerometer, held by whatever measures: an error-state Kalman filter.

The nominal motion is integrated at every IMU sample: position in a level plane, heading, roll and pitch, and
the speed of the IMU's place ahead (u) and to the left (v) in body axes (docs/odometry.md derives the rest):

    u' = f_x - a_x + g sin(pitch) + r v - q w            roll'  = p + r pitch
    v' = f_y - a_y - g sin(roll) cos(pitch) - r u + p w  pitch' = q cos(roll) - r sin(roll)
    (p, q, r) = gyroscope - bias                         yaw'   = (q sin(roll) + r cos(roll))/cos(pitch)

w follows from the ground the wheels stand on. The error of each, of the three gyro biases, two accelerometer
offsets, the wheels' scale, Earth's field in the plane and the hard iron on board make 18 error states. Their
covariance is carried forward every 40 ms by the linearised equations (Sola, Quaternion kinematics for the
error-state Kalman filter, 2017, sections 5.3 and 6.1), and all that is measured then is taken in at once.
"""

from __future__ import annotations

from dataclasses import field
from math import cos, inf, radians, sin
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tiger.config.robot import OdometryConfig
    from tiger.record import Three

    Array = NDArray[np.float64]

ERRORS = (
    *("x", "y", "yaw", "u", "v", "pitch", "roll", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y"),
    *("scale", "field_x", "field_y", "iron_x", "iron_y", "iron_z"),
)
X, Y, YAW, U, V, PITCH, ROLL, GX, GY, GZ, AX, AY, SCALE, FX, FY, HX, HY, HZ = range(len(ERRORS))
N = len(ERRORS)

_IDENTITY = np.eye(N)
_COUPLED = np.ravel_multi_index(
    np.transpose(
        [
            *((X, YAW), (X, U), (X, V), (Y, YAW), (Y, U), (Y, V)),
            *((YAW, GZ), (PITCH, GY), (ROLL, GX), (U, AX), (V, AY)),
            *((U, PITCH), (U, V), (U, GZ), (V, ROLL), (V, U), (V, GZ), (PITCH, ROLL), (ROLL, PITCH)),
        ]
    ),
    (N, N),
)
"""Where one error changes another, in the order in which `spread` fills them in."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What only measurements change, and slowly: rad/s, m/s2, uT."""

    gyro_bias_radps: Three = (0.0, 0.0, 0.0)
    accel_bias_mps2: tuple[float, float] = (0.0, 0.0)
    scale: float = 0.0  # how much more than the wheels say is travelled
    field_ut: tuple[float, float] = (0.0, 0.0)
    iron_ut: Three = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Motion:
    """The nominal state: m, rad, m/s, rad/s, m/s2."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    u_mps: float = 0.0
    v_mps: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    rate_radps: Three = (0.0, 0.0, 0.0)  # of the last sample, without bias
    accel_mps2: tuple[float, float] = (0.0, 0.0)  # du/dt and dv/dt of the last sample
    learned: Learned = field(default_factory=Learned)


class Noise(NamedTuple):
    """Covariances (N, N): what one second adds, and that of the start."""

    per_second: Array
    at_start: Array


def make_noise(config: OdometryConfig) -> Noise:
    """Squares of the configured sigmas."""
    walk, start = np.zeros(N), np.zeros(N)
    walk[[X, Y]] = config.place_walk_m
    walk[[YAW, PITCH, ROLL]] = radians(config.angle_walk_deg)
    walk[[U, V]] = config.speed_walk_mps
    walk[[GX, GY, GZ]] = radians(config.gyro_bias_walk_degps)
    walk[[AX, AY]] = config.accel_bias_walk_mps2
    walk[[FX, FY]] = config.field_walk_ut
    start[[U, V]] = config.start_speed_mps
    start[[PITCH, ROLL]] = radians(config.start_tilt_deg)
    start[[GX, GY, GZ]] = radians(config.start_gyro_bias_degps)
    start[[AX, AY]] = config.start_accel_bias_mps2
    start[SCALE] = config.wheel_scale_sigma
    start[[FX, FY]] = config.start_field_ut
    start[[HX, HY, HZ]] = config.start_iron_ut
    return Noise(np.diag(walk**2), np.diag(start**2))


def integrate(
    motion: Motion, force_mps2: Three, gyro_radps: Three, ground_pitch_rad: float, dt: float
) -> Motion:
    """Advance the nominal state by one IMU sample, `dt` after the one before.

    force_mps2 and gyro_radps as read, body axes; `ground_pitch_rad` of the plane under the wheels.
    """
    learned = motion.learned
    (bp, bq, br), (ax, ay) = learned.gyro_bias_radps, learned.accel_bias_mps2
    p, q, r = gyro_radps[0] - bp, gyro_radps[1] - bq, gyro_radps[2] - br
    roll, pitch, yaw = motion.roll_rad, motion.pitch_rad, motion.yaw_rad
    u, v = motion.u_mps, motion.v_mps
    sin_roll, cos_roll, sin_pitch, cos_pitch = sin(roll), cos(roll), sin(pitch), cos(pitch)
    lifting = pitch - ground_pitch_rad  # the nose is lower than the ground rises: the ground lifts the body
    w = u * lifting
    du = force_mps2[0] - ax + GRAVITY_MPS2 * sin_pitch + r * v - q * w
    dv = force_mps2[1] - ay - GRAVITY_MPS2 * sin_roll * cos_pitch - r * u + p * w
    turning = q * sin_roll + r * cos_roll
    yaw_rate = turning / cos_pitch
    ahead = (u + 0.5 * du * dt) * (1.0 - 0.5 * ground_pitch_rad**2 + 0.5 * lifting**2) * dt
    left = (v + 0.5 * dv * dt) * dt
    middle = yaw + 0.5 * yaw_rate * dt
    cos_yaw, sin_yaw = cos(middle), sin(middle)
    return Motion(
        motion.x_m + cos_yaw * ahead - sin_yaw * left,
        motion.y_m + sin_yaw * ahead + cos_yaw * left,
        yaw + yaw_rate * dt,
        u + du * dt,
        v + dv * dt,
        pitch + (q * cos_roll - r * sin_roll) * dt,
        roll + (p + sin_pitch / cos_pitch * turning) * dt,
        (p, q, r),
        (du, dv),
        learned,
    )


def spread(covariance: Array, motion: Motion, noise: Noise, dt: float) -> Array:
    """Carry the covariance (N, N) forward by `dt` with the equations linearised about `motion`."""
    u, v, r = motion.u_mps * dt, motion.v_mps * dt, motion.rate_radps[2] * dt
    c, s, g = cos(motion.yaw_rad), sin(motion.yaw_rad), GRAVITY_MPS2 * dt
    step = _IDENTITY.copy()
    step.put(
        _COUPLED,
        (
            *(-s * u - c * v, c * dt, -s * dt, c * u - s * v, s * dt, c * dt),
            *(-dt, -dt, -dt, -dt, -dt, g, r, -v, -g, -r, u, -r, r),
        ),
    )
    return np.asarray(step.dot(covariance).dot(step.T) + noise.per_second * dt)


class Measurement(NamedTuple):
    """A scalar: its row of H as {error: factor}, what it differs by from the nominal, its own variance.

    Further off than `gate_sigmas` of what was expected, it and all that have a gate are left out.
    """

    row: dict[int, float]
    innovation: float
    variance: float
    gate_sigmas: float = inf


def correct(covariance: Array, measured: Sequence[Measurement]) -> tuple[Array, Array]:
    """Take in measurements of one moment together.

    Returns the errors found, (N,), and their covariance afterwards, (N, N).
    """
    rows = np.zeros((len(measured), N))
    for index, scalar in enumerate(measured):
        for error, factor in scalar.row.items():
            rows[index, error] = factor
    across = covariance.dot(rows.T)
    of_innovation = rows.dot(across)
    for index, scalar in enumerate(measured):
        variance = of_innovation[index, index] = of_innovation[index, index] + scalar.variance
        if scalar.innovation**2 > scalar.gate_sigmas**2 * variance:
            return correct(covariance, [scalar for scalar in measured if scalar.gate_sigmas == inf])
    _, gain, _ = dposv(of_innovation, across.T)  # S^-1 H P, the gain transposed
    innovation = np.array([scalar.innovation for scalar in measured])
    return innovation.dot(gain), np.asarray(covariance - across.dot(gain))


def put_right(motion: Motion, errors: Array) -> Motion:
    """The nominal state without the errors found, (N,)."""
    m, known = motion, motion.learned
    x, y, yaw, u, v, pitch, roll, gx, gy, gz, ax, ay, scale, fx, fy, hx, hy, hz = errors.tolist()
    (bx, by, bz), (a, b) = known.gyro_bias_radps, known.accel_bias_mps2
    (north, west), (iron_x, iron_y, iron_z) = known.field_ut, known.iron_ut
    learned = Learned(
        (bx + gx, by + gy, bz + gz),
        (a + ax, b + ay),
        known.scale + scale,
        (north + fx, west + fy),
        (iron_x + hx, iron_y + hy, iron_z + hz),
    )
    return Motion(
        m.x_m + x,
        m.y_m + y,
        m.yaw_rad + yaw,
        m.u_mps + u,
        m.v_mps + v,
        m.pitch_rad + pitch,
        m.roll_rad + roll,
        m.rate_radps,
        m.accel_mps2,
        learned,
    )
