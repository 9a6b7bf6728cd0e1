"""An IMU somewhere on the body: eqs. 6.5-6.8 with a full 3-D offset, and what a real chip adds.

Kinematics first (pure functions), then `Imu`, the sensor with bandwidth, bias, noise, steps and range. Body
axes are ISO 8855 (x forward, y left, z up); leading dimensions are free, the last one is (x, y, z).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from collections.abc import Iterator

Array = NDArray[np.float64]
Three = tuple[float, float, float]


class PointMotion(NamedTuple):
    """Position, velocity and acceleration of a point of the body, in world axes."""

    position_m: Array
    velocity_mps: Array
    acceleration_mps2: Array


def offset_motion(
    roll_rad: ArrayLike,
    pitch_rad: ArrayLike,
    roll_rate_radps: ArrayLike,
    pitch_rate_radps: ArrayLike,
    roll_accel_radps2: ArrayLike,
    pitch_accel_radps2: ArrayLike,
    offset_m: ArrayLike,
) -> PointMotion:
    """Motion of a body-fixed point relative to the COM in world axes, eqs. 6.5-6.7 with nothing neglected.

    The angles and their derivatives (...,) are those of A = Rx(roll) Ry(pitch), `offset_m` is r_m (3,). Add
    the COM's own motion r_s. The print of A has two wrong entries: (2,3) is -sin(roll) cos(pitch) and (3,3)
    is cos(roll) cos(pitch).
    """
    roll, pitch = np.asarray(roll_rad, dtype=float), np.asarray(pitch_rad, dtype=float)
    roll_rate, pitch_rate, roll_accel, pitch_accel = (
        np.asarray(value, dtype=float)[..., None]
        for value in (roll_rate_radps, pitch_rate_radps, roll_accel_radps2, pitch_accel_radps2)
    )
    x, y, z = np.asarray(offset_m, dtype=float)

    def a_times_r(roll_turns: int, pitch_turns: int) -> Array:
        """A r_m differentiated so many times by each angle: each differentiation is a quarter turn."""
        cos_p, sin_p = _turned_cos_sin(pitch, pitch_turns)
        cos_r, sin_r = _turned_cos_sin(roll, roll_turns)
        # A constant component vanishes on differentiation: y does not see pitch, world x does not see roll.
        held_y = y if pitch_turns == 0 else 0.0
        forward = cos_p * x + sin_p * z
        up = -sin_p * x + cos_p * z
        keep_x = 1.0 if roll_turns == 0 else 0.0
        return np.stack(
            np.broadcast_arrays(keep_x * forward, cos_r * held_y - sin_r * up, sin_r * held_y + cos_r * up),
            axis=-1,
        )

    by_roll, by_pitch = a_times_r(1, 0), a_times_r(0, 1)
    velocity = roll_rate * by_roll + pitch_rate * by_pitch
    acceleration = (
        roll_accel * by_roll
        + pitch_accel * by_pitch
        + roll_rate**2 * a_times_r(2, 0)
        + pitch_rate**2 * a_times_r(0, 2)
        + 2.0 * roll_rate * pitch_rate * a_times_r(1, 1)
    )
    return PointMotion(a_times_r(0, 0), velocity, acceleration)


def specific_force(
    com_accel_mps2: ArrayLike,
    rate_radps: ArrayLike,
    angular_accel_radps2: ArrayLike,
    up: ArrayLike,
    offset_m: ArrayLike,
) -> Array:
    """What an ideal accelerometer at `offset_m` from the COM reads, (..., 3); at rest +g along `up`.

    All arguments (..., 3) in body axes: COM acceleration over ground, angular rate and acceleration, the unit
    vector that points up.
    """
    com_accel, rate, angular_accel, offset, above = (
        np.asarray(vector, dtype=float)
        for vector in (com_accel_mps2, rate_radps, angular_accel_radps2, offset_m, up)
    )
    lever = np.cross(angular_accel, offset) + np.cross(rate, np.cross(rate, offset))
    return np.asarray(com_accel + lever + GRAVITY_MPS2 * above, dtype=float)


def up_in_body(roll_rad: ArrayLike, pitch_rad: ArrayLike) -> Array:
    """Return the world's up in body axes, (..., 3), for yaw-pitch-roll (ISO 8855) attitude angles (...,)."""
    roll, pitch = np.asarray(roll_rad, dtype=float), np.asarray(pitch_rad, dtype=float)
    level = np.cos(pitch)
    parts = np.broadcast_arrays(-np.sin(pitch), np.sin(roll) * level, np.cos(roll) * level)
    return np.stack(parts, axis=-1)


# ---- the sensor


@dataclass(frozen=True, slots=True)
class TriadSpec:
    """Three equal axes of one physical quantity, in that quantity's unit."""

    noise_density: float
    """Per square root of hertz; the noise of one reading is this times the root of the bandwidth."""
    bandwidth_hz: float
    bias: float
    """Each axis draws its constant offset evenly from plus or minus this."""
    bias_walk: float
    """Standard deviation of the offset's change per square root of second."""
    step: float
    """Size of one digit; 0 does not round."""
    limit: float
    """Readings saturate at plus or minus this."""


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """Accelerometer in m/s2, gyroscope in rad/s, magnetometer in uT."""

    accelerometer: TriadSpec
    gyroscope: TriadSpec
    magnetometer: TriadSpec


DEGREE = np.pi / 180.0

# Bosch BNO055 data sheet (typical values), in the bandwidths the robot sets: 150 ug/sqrt(Hz), +-80 mg and
# 1 LSB = 0.01 m/s2 at 4 g; 0.014 deg/s/sqrt(Hz), +-1 deg/s and 1 LSB = 1/16 deg/s at 2000 deg/s; 1 LSB =
# 1/16 uT. The gyro's bias walk and the magnetometer's noise (0.6 uT) are not in it and chosen.
BNO055 = ImuSpec(
    accelerometer=TriadSpec(150e-6 * GRAVITY_MPS2, 62.5, 80e-3 * GRAVITY_MPS2, 0.0, 0.01, 4.0 * GRAVITY_MPS2),
    gyroscope=TriadSpec(0.014 * DEGREE, 47.0, 1.0 * DEGREE, 0.002 * DEGREE, DEGREE / 16.0, 2000.0 * DEGREE),
    magnetometer=TriadSpec(0.6 / np.sqrt(20.0), 20.0, 40.0, 0.0, 1.0 / 16.0, 1300.0),
)


class ImuReading(NamedTuple):
    """One sample in the chip's axes."""

    accel_mps2: Three
    gyro_radps: Three
    mag_ut: Three


class Triad:
    """One three-axis sensor: low-pass on the truth; offset, noise, rounding and range on each reading.

    A reading's noise does not depend on the one before: read no faster than about twice the bandwidth.
    """

    _BLOCK = 512

    def __init__(
        self, spec: TriadSpec, random: np.random.Generator, start: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        self._spec = spec
        self._random = random
        self.state = np.array(start, dtype=float)
        """The truth as the low-pass lets it through, (3,). Whoever moves it elsewhere says so by `wait`."""
        self._noise_sd = spec.noise_density * np.sqrt(spec.bandwidth_hz)
        self._unread_s = 0.0
        self._gain_for_s, self._gain = -1.0, 0.0
        self._noise: Iterator[list[float]] = iter(())
        self.bias = random.uniform(-1.0, 1.0, 3) * spec.bias

    def gain(self, dt_s: float) -> float:
        """Return how far the low-pass comes towards a truth that holds for `dt_s`: 0 to 1."""
        if dt_s != self._gain_for_s:
            self._gain_for_s = dt_s
            self._gain = 1.0 - exp(-2.0 * pi * self._spec.bandwidth_hz * dt_s)
        return self._gain

    def advance(self, truth: Array, dt_s: float) -> None:
        """Follow the truth (3,), taken as constant over `dt_s`."""
        self.state += self.gain(dt_s) * (truth - self.state)
        self.wait(dt_s)

    def wait(self, dt_s: float) -> None:
        """Let time pass that the state has followed already."""
        self._unread_s += dt_s

    def read(self) -> Three:
        """Return one reading."""
        spec = self._spec
        if spec.bias_walk > 0.0:
            self.bias += spec.bias_walk * sqrt(self._unread_s) * self._random.standard_normal(3)
        self._unread_s = 0.0
        noise = next(self._noise, None)
        if noise is None:
            block = self._noise_sd * self._random.standard_normal((self._BLOCK, 3))
            self._noise = iter(block.tolist())
            noise = next(self._noise)
        # Plain floats: on three of them numpy takes four times as long.
        step, limit, reading = spec.step, spec.limit, []
        for truth, bias, error in zip(self.state.tolist(), self.bias.tolist(), noise, strict=True):
            value = truth + bias + error
            if step > 0.0:
                value = round(value / step) * step
            reading.append(limit if value > limit else -limit if value < -limit else value)
        x, y, z = reading
        return x, y, z


class Imu:
    """Three triads of one chip, reproducible from the generator given."""

    def __init__(self, spec: ImuSpec, random: np.random.Generator) -> None:
        first, second, third = random.spawn(3)
        self.accelerometer = Triad(spec.accelerometer, first, start=(0.0, 0.0, GRAVITY_MPS2))
        self.gyroscope = Triad(spec.gyroscope, second)
        self.magnetometer = Triad(spec.magnetometer, third)

    def advance(self, accel_mps2: Array, gyro_radps: Array, mag_ut: Array, dt_s: float) -> None:
        """Follow the true specific force, angular rate and field, each (3,) in the chip's axes."""
        self.accelerometer.advance(accel_mps2, dt_s)
        self.gyroscope.advance(gyro_radps, dt_s)
        self.magnetometer.advance(mag_ut, dt_s)

    def read(self) -> ImuReading:
        """Return one sample."""
        return ImuReading(self.accelerometer.read(), self.gyroscope.read(), self.magnetometer.read())


def _turned_cos_sin(angle: Array, quarter_turns: int) -> tuple[Array, Array]:
    """Cosine and sine differentiated so many times."""
    turned = angle + quarter_turns * (np.pi / 2.0)
    return np.cos(turned), np.sin(turned)
