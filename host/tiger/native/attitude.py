"""The Nano's attitude filter on the host, where it can have the wheels' help.

The same C++ as on the board (`firmware/libraries/TigerCore/src/tiger/fusion`), fed with the raw samples that
the board forwards. Given the forward speed of the body it takes the acceleration of the body off the
accelerometer, which leaves gravity: the inclination stays within half a degree, without it several are lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiger.native._core import ffi, lib

Array = NDArray[np.float64]
Vector = Sequence[float]

_SAMPLE = np.dtype(
    {
        "names": [
            "gyro",
            "accel",
            "mag",
            "speed",
            "dt",
            "wheels",
            "has_mag",
            "accel_usable",
            "follows_gap",
        ],
        "formats": ["3f4", "3f4", "3f4", "f4", "f4", "u1", "u1", "u1", "u1"],
    }
)
_STATE = np.dtype(
    {
        "names": ["quaternion", "level_quaternion", "rate", "bias", "resting", "disturbed"],
        "formats": ["4f4", "4f4", "3f4", "3f4", "u1", "u1"],
        "itemsize": ffi.sizeof("tiger_attitude_state"),
    }
)
assert _SAMPLE.itemsize == ffi.sizeof("tiger_attitude_sample"), "native_attitude_api.h and _SAMPLE differ"

_NO_WHEELS, _GRIP, _SLIP = 0, 1, 2


@dataclass(frozen=True, slots=True)
class AttitudeTuning:
    """How the filter is tuned; without arguments as on the Nano."""

    tick_s: float = 0.01
    """Nominal time between two samples."""
    mag_period_s: float = 0.05
    """Time between two new magnetometer samples."""
    slow_every: int = 4
    """Ticks between two corrections: a multiple of four, or 1 for everything in every tick."""
    accel_tau_s: float = 3.0
    """Time constant of the accelerometer's averaging."""
    mag_tau_s: float = 9.0
    """Time constant of the heading's correction."""
    bias_sigma_init_radps: float = math.radians(0.5)
    bias_sigma_motion_radps: float = math.radians(0.1)
    bias_sigma_rest_radps: float = math.radians(0.03)

    def __post_init__(self) -> None:
        if self.slow_every != 1 and (self.slow_every % 4 != 0 or not 4 <= self.slow_every <= 252):
            raise ValueError(f"slow_every is {self.slow_every}: use 1, or a multiple of four up to 252")
        for name in ("tick_s", "mag_period_s", "accel_tau_s", "mag_tau_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}: it must be positive")
        if self.tick_s * self.slow_every > 0.25 * self.accel_tau_s:
            raise ValueError(
                f"a correction every {self.tick_s * self.slow_every:g} s is too slow for accel_tau_s "
                f"{self.accel_tau_s:g}: make slow_every smaller"
            )


class Attitude(NamedTuple):
    """What the filter knows after a sample."""

    quaternion: tuple[float, float, float, float]
    """w x y z, body to earth (east, north, up)."""
    level_quaternion: tuple[float, float, float, float]
    """The same without the magnetometer: its heading drifts."""
    rate_radps: tuple[float, float, float]
    """Angular rate of the body in its own axes, bias removed."""
    bias_radps: tuple[float, float, float]
    """Bias of the gyroscope."""
    resting: bool
    disturbed: bool
    """The magnetic field is not the earth's: the heading runs on the gyroscope."""


class AttitudeHistory(NamedTuple):
    """`Attitude` of N samples, arrays of leading dimension N."""

    quaternion: Array
    level_quaternion: Array
    rate_radps: Array
    bias_radps: Array
    resting: NDArray[np.bool_]
    disturbed: NDArray[np.bool_]


class AttitudeFilter:
    """Attitude from gyroscope, accelerometer, magnetometer and, where there are any, wheels."""

    def __init__(self, tuning: AttitudeTuning = AttitudeTuning()) -> None:
        self.tuning = tuning
        native = ffi.new("tiger_attitude_tuning*")
        for name in AttitudeTuning.__dataclass_fields__:
            setattr(native, name, getattr(tuning, name))
        self._filter: Any = ffi.gc(lib.tiger_attitude_new(native), lib.tiger_attitude_free)
        self._sample = ffi.new("tiger_attitude_sample*")
        self._state = ffi.new("tiger_attitude_state*")

    def start_bias_from(self, bias_radps: Vector) -> None:
        """Begin from a known gyroscope bias (3,), such as that of a rest calibration."""
        lib.tiger_attitude_start_bias(self._filter, bias_radps)

    def step(
        self,
        gyro_radps: Vector,
        accel_mps2: Vector | None,
        mag_ut: Vector | None = None,
        *,
        speed_mps: float | None = None,
        slipping: bool = False,
        dt_s: float | None = None,
        follows_gap: bool = False,
    ) -> Attitude:
        """Take in one sample, in body axes (x forward, y left, z up).

        Args:
            gyro_radps: angular rate (3,), calibrated.
            accel_mps2: specific force (3,), calibrated, +g along z at rest; None: not usable.
            mag_ut: magnetic field (3,) if it is new, else None.
            speed_mps: forward speed of the body by its wheels; None: no wheels to ask.
            slipping: the wheels do not tell the speed now. For five seconds the gyroscope carries alone.
            dt_s: time since the sample before; the tuning's tick unless told.
            follows_gap: samples are missing: hold the attitude across the gap, then walk to gravity.
        """
        sample, state = self._sample, self._state
        sample.gyro_radps = gyro_radps
        sample.accel_usable = accel_mps2 is not None
        if accel_mps2 is not None:
            sample.accel_mps2 = accel_mps2
        sample.has_mag = mag_ut is not None
        if mag_ut is not None:
            sample.mag_ut = mag_ut
        sample.wheels = _NO_WHEELS if speed_mps is None else _SLIP if slipping else _GRIP
        sample.speed_mps = 0.0 if speed_mps is None else speed_mps
        sample.dt_s = 0.0 if follows_gap else self.tuning.tick_s if dt_s is None else dt_s
        sample.follows_gap = follows_gap
        lib.tiger_attitude_run(self._filter, 1, sample, state)
        w, x, y, z = state.quaternion
        lw, lx, ly, lz = state.level_quaternion
        rx, ry, rz = state.rate_radps
        bx, by, bz = state.bias_radps
        return Attitude(
            (w, x, y, z),
            (lw, lx, ly, lz),
            (rx, ry, rz),
            (bx, by, bz),
            bool(state.resting),
            bool(state.disturbed),
        )

    def run(
        self,
        gyro_radps: ArrayLike,
        accel_mps2: ArrayLike,
        mag_ut: ArrayLike | None = None,
        *,
        speed_mps: ArrayLike | None = None,
        slipping: ArrayLike | None = None,
    ) -> AttitudeHistory:
        """Take in N samples a tick apart: (N, 3) each, speed and slip (N,).

        Rows of `mag_ut` with a NaN hold no new sample; rows of `accel_mps2` with a NaN are not used.
        """
        gyro = np.asarray(gyro_radps, dtype=np.float32)
        accel = np.asarray(accel_mps2, dtype=np.float32)
        if gyro.ndim != 2 or gyro.shape[1] != 3 or accel.shape != gyro.shape:
            raise ValueError(
                f"gyro_radps is {gyro.shape} and accel_mps2 {accel.shape}: both must be (N, 3) alike"
            )
        samples = np.zeros(len(gyro), dtype=_SAMPLE)
        samples["gyro"] = gyro
        samples["accel_usable"] = np.isfinite(accel).all(axis=1)
        samples["accel"] = np.nan_to_num(accel)
        samples["dt"] = self.tuning.tick_s
        if mag_ut is not None:
            mag = np.asarray(mag_ut, dtype=np.float32)
            samples["has_mag"] = np.isfinite(mag).all(axis=1)
            samples["mag"] = np.nan_to_num(mag)
        if speed_mps is not None:
            samples["speed"] = speed_mps
            samples["wheels"] = _GRIP if slipping is None else np.where(slipping, _SLIP, _GRIP)
        states = np.zeros(len(gyro), dtype=_STATE)
        lib.tiger_attitude_run(
            self._filter,
            len(samples),
            ffi.from_buffer("tiger_attitude_sample[]", samples),
            ffi.from_buffer("tiger_attitude_state[]", states),
        )
        return AttitudeHistory(
            states["quaternion"].astype(np.float64),
            states["level_quaternion"].astype(np.float64),
            states["rate"].astype(np.float64),
            states["bias"].astype(np.float64),
            states["resting"].astype(bool),
            states["disturbed"].astype(bool),
        )


# ---- from the wire to the filter


class RawSample(Protocol):
    """The fields of `imu_raw` that a calibration works on."""

    accel_mps2: tuple[float, float, float]
    gyro_radps: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImuCalibration:
    """The Nano's parameters that turn `imu_raw` into calibrated readings, in the robot's axes.

    The mounting is not among them: `imu_raw` is in the robot's axes already.
    """

    gyro_bias_radps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_offset_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def apply(self, raw: RawSample) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Calibrated angular rate in rad/s and specific force in m/s2, as the Nano computes them."""
        gyro = tuple(r - b for r, b in zip(raw.gyro_radps, self.gyro_bias_radps, strict=True))
        accel = tuple(
            s * (a - o)
            for s, a, o in zip(self.accel_scale, raw.accel_mps2, self.accel_offset_mps2, strict=True)
        )
        return gyro, accel
