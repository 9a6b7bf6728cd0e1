"""Dead reckoning by gyroscope and accelerometer, held by whatever measures: an error-state Kalman filter.

The nominal motion is integrated at every IMU sample: position in a level plane, heading, roll and pitch, and
the speed of the IMU's place ahead (u) and to the left (v) in body axes (docs/odometry.md derives the rest):

    u' = f_x - a_x + g sin(pitch) + r v - q w            roll'  = p + r pitch
    v' = f_y - a_y - g sin(roll) cos(pitch) - r u + p w  pitch' = q cos(roll) - r sin(roll)
    (p, q, r) = gyroscope - bias                         yaw'   = (q sin(roll) + r cos(roll))/cos(pitch)

w follows from the ground the wheels stand on. The error of each, of the three gyro biases, two accelerometer
offsets, the wheels' scale, Earth's field in the plane and the hard iron on board make 17 error states. Their
covariance is carried forward every 20 ms by the linearised equations (Sola, Quaternion kinematics for the
error-state Kalman filter, 2017, sections 5.3 and 6.1), and measurements come one scalar at a time, which
needs no matrix inverse (Bierman, Factorization Methods, 1977, section 2.5).
"""

from __future__ import annotations

from math import cos, radians, sin
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiger.frozen import dataclass, replace
from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import OdometryConfig
    from tiger.record import Three

    Array = NDArray[np.float64]

ERRORS = (
    *("x", "y", "yaw", "u", "v", "pitch", "roll", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y"),
    *("scale", "field_x", "field_y", "iron_x", "iron_y"),
)
X, Y, YAW, U, V, PITCH, ROLL, GX, GY, GZ, AX, AY, SCALE, FX, FY, HX, HY = range(len(ERRORS))
N = len(ERRORS)

_DIAGONAL = np.arange(N)


@dataclass(frozen=True, slots=True)
class Motion:
    """The nominal state: m, rad, m/s, rad/s, m/s2, uT."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    u_mps: float = 0.0
    v_mps: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    gyro_bias_radps: Three = (0.0, 0.0, 0.0)
    accel_bias_mps2: tuple[float, float] = (0.0, 0.0)
    scale: float = 0.0  # how much more than the wheels say is travelled
    field_ut: tuple[float, float] = (0.0, 0.0)
    iron_ut: tuple[float, float] = (0.0, 0.0)
    rate_radps: Three = (0.0, 0.0, 0.0)  # of the last sample, without bias
    accel_mps2: tuple[float, float] = (0.0, 0.0)  # du/dt and dv/dt of the last sample


class Noise(NamedTuple):
    """Variances: what one second adds to each error (N,), and what they are at the start (N,)."""

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
    start[[HX, HY]] = config.start_iron_ut
    return Noise(walk**2, start**2)


def start_covariance(noise: Noise) -> Array:
    """Covariance (N, N) before the first measurement."""
    return np.diag(noise.at_start)


def integrate(
    motion: Motion, force_mps2: Three, gyro_radps: Three, ground_pitch_rad: float, dt: float
) -> Motion:
    """Advance the nominal state by one IMU sample, `dt` after the one before.

    force_mps2 and gyro_radps as read, body axes; `ground_pitch_rad` of the plane under the wheels.
    """
    (bp, bq, br), (ax, ay) = motion.gyro_bias_radps, motion.accel_bias_mps2
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
        motion.gyro_bias_radps,
        motion.accel_bias_mps2,
        motion.scale,
        motion.field_ut,
        motion.iron_ut,
        (p, q, r),
        (du, dv),
    )


def spread(covariance: Array, motion: Motion, noise: Noise, dt: float) -> Array:
    """Carry the covariance (N, N) forward by `dt` with the equations linearised about `motion`."""
    u, v, r = motion.u_mps * dt, motion.v_mps * dt, motion.rate_radps[2] * dt
    cos_yaw, sin_yaw = cos(motion.yaw_rad), sin(motion.yaw_rad)
    g = GRAVITY_MPS2 * dt
    step = np.eye(N)
    step[X, YAW], step[X, U], step[X, V] = -sin_yaw * u - cos_yaw * v, cos_yaw * dt, -sin_yaw * dt
    step[Y, YAW], step[Y, U], step[Y, V] = cos_yaw * u - sin_yaw * v, sin_yaw * dt, cos_yaw * dt
    step[YAW, GZ] = step[PITCH, GY] = step[ROLL, GX] = step[U, AX] = step[V, AY] = -dt
    step[U, PITCH], step[U, V], step[U, GZ] = g, r, -v
    step[V, ROLL], step[V, U], step[V, GZ] = -g, -r, u
    step[PITCH, ROLL], step[ROLL, PITCH] = -r, r
    spread = step @ covariance @ step.T
    spread[_DIAGONAL, _DIAGONAL] += noise.per_second * dt
    return spread


class Correction:
    """Measurements of one moment, taken in one by one; `applied` gives the corrected motion."""

    def __init__(self, motion: Motion, covariance: Array) -> None:
        """Begin with what is known before; the covariance (N, N) is left untouched."""
        self.motion = motion
        self.covariance = covariance.copy()
        self._error = np.zeros(N)

    def take(self, row: dict[int, float], innovation: float, variance: float) -> None:
        """Take in a scalar: its row of H, what it differs by from the nominal, and its own variance."""
        gain, seen = self._gain(row), innovation
        total = variance
        for index, factor in row.items():
            total += factor * gain[index]
            seen -= factor * self._error[index]
        self._error += gain * (seen / total)
        self.covariance -= np.multiply.outer(gain, gain / total)

    def variance(self, row: dict[int, float]) -> float:
        """Variance of a scalar as predicted, without its own noise."""
        gain = self._gain(row)
        return float(sum(factor * gain[index] for index, factor in row.items()))

    def _gain(self, row: dict[int, float]) -> Array:
        gain = np.zeros(N)
        for index, factor in row.items():
            gain += factor * self.covariance[index]
        return gain

    def applied(self) -> Motion:
        """The nominal state with the errors found put right."""
        m = self.motion
        x, y, yaw, u, v, pitch, roll, gx, gy, gz, ax, ay, scale, fx, fy, hx, hy = self._error.tolist()
        (bx, by, bz), (a, b), field, iron = m.gyro_bias_radps, m.accel_bias_mps2, m.field_ut, m.iron_ut
        return replace(
            m,
            x_m=m.x_m + x,
            y_m=m.y_m + y,
            yaw_rad=m.yaw_rad + yaw,
            u_mps=m.u_mps + u,
            v_mps=m.v_mps + v,
            pitch_rad=m.pitch_rad + pitch,
            roll_rad=m.roll_rad + roll,
            gyro_bias_radps=(bx + gx, by + gy, bz + gz),
            accel_bias_mps2=(a + ax, b + ay),
            scale=m.scale + scale,
            field_ut=(field[0] + fx, field[1] + fy),
            iron_ut=(iron[0] + hx, iron[1] + hy),
        )
