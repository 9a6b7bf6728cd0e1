"""Rest calibration of the gyroscope: its bias, and whether its noise is that of the data sheet.

Bias is the mean of a still window, noise its standard deviation. Random walk of the bias is not looked for
(no Allan variance): it would take hours, and the board's filter follows it anyway. The bias of a BNO055 is
another one after each power-up; the daemon measures it again while the robot stands before it is armed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tiger.calibration.procedure import (
    Array,
    Confirm,
    Finding,
    Procedure,
    Result,
    Stage,
    Values,
    Window,
)
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.imu import BNO055
from tiger.protocol.messages import BoardKind, ImuRaw, Message

if TYPE_CHECKING:
    from tiger.models.sensors.imu import TriadSpec

AXES = "xyz"
REST_S = 10.0
BIAS_TYPICAL_DEGPS, BIAS_MOST_DEGPS = 1.0, 3.0  # data sheet, zero-rate offset
NOISE_MOST_RATIO = 1.5  # over the data sheet's typical noise
DRIFT_MOST_DEGPS = 0.05  # between the two halves of the window
STILL_ACCEL_MPS2 = 0.15
GRAVITY_ERROR_MOST_MPS2 = 0.1


def channels(message: Message) -> tuple[float, ...] | None:
    """Specific force x y z and angular rate x y z of an `imu_raw`."""
    return (*message.accel_mps2, *message.gyro_radps) if isinstance(message, ImuRaw) else None


def data_sheet_noise(spec: TriadSpec) -> float:
    """Standard deviation of a reading: noise density over the bandwidth, and rounding to a digit."""
    return math.hypot(spec.noise_density * math.sqrt(spec.bandwidth_hz), spec.step / math.sqrt(12.0))


def unrest(readings: Array) -> str | None:
    """Why a window of readings (N, 6) is not one of a body at rest; None when it is."""
    accel, gyro = readings[:, :3], np.degrees(readings[:, 3:])
    shaking = float(accel.std(axis=0).max())
    if shaking > STILL_ACCEL_MPS2:
        return (
            f"the robot shakes ({shaking:.2f} m/s2 RMS, at most {STILL_ACCEL_MPS2:g}); "
            "keep hands off, switch motors off"
        )
    noise_most = NOISE_MOST_RATIO * math.degrees(data_sheet_noise(BNO055.gyroscope))
    noise = float(gyro.std(axis=0).max())
    if noise > noise_most:
        return (
            f"the gyroscope varies by {noise:.2f} degrees/s RMS, at most {noise_most:.2f} at rest; "
            "keep the robot still"
        )
    half = len(gyro) // 2
    drift = float(np.abs(gyro[:half].mean(axis=0) - gyro[half:].mean(axis=0)).max())
    if drift > DRIFT_MOST_DEGPS:
        return (
            f"the rate changed by {drift:.3f} degrees/s, at most {DRIFT_MOST_DEGPS:g} at rest; "
            "wait until the sensor is warm, keep the robot still"
        )
    most = float(np.abs(gyro.mean(axis=0)).max())
    if most > BIAS_MOST_DEGPS:
        return (
            f"the gyroscope reads {most:.1f} degrees/s, the data sheet allows {BIAS_MOST_DEGPS:g} at rest; "
            "stop what turns it, or replace the sensor"
        )
    return None


def solve(windows: tuple[Window, ...], before: Values) -> Result:
    """Bias and noise of each axis from one still window (N, 6)."""
    (window,) = windows
    gyro = np.degrees(window.readings[:, 3:])
    bias, noise = gyro.mean(axis=0), gyro.std(axis=0, ddof=1)
    noise_most = NOISE_MOST_RATIO * math.degrees(data_sheet_noise(BNO055.gyroscope))
    findings = [
        Finding(f"gyro bias {axis}", float(value), "degrees/s", BIAS_TYPICAL_DEGPS)
        for axis, value in zip(AXES, bias, strict=True)
    ]
    findings += [
        Finding(f"gyro noise {axis}", float(value), "degrees/s RMS", noise_most)
        for axis, value in zip(AXES, noise, strict=True)
    ]
    findings.append(
        Finding("uncertainty of the bias", float(noise.max()) / math.sqrt(len(gyro)), "degrees/s")
    )
    notes = []
    if np.abs(bias).max() > BIAS_TYPICAL_DEGPS:
        notes.append(f"A bias beyond the typical {BIAS_TYPICAL_DEGPS:g} degrees/s is unusual, but allowed.")
    scale = np.asarray(before["accel_scale_permille"]) / 1000.0
    force = scale * (window.mean[:3] - np.asarray(before["accel_offset_mps2"]))
    error = float(np.linalg.norm(force)) - GRAVITY_MPS2
    is_good = abs(error) <= GRAVITY_ERROR_MOST_MPS2
    findings.append(Finding("gravity error", error, "m/s2", GRAVITY_ERROR_MOST_MPS2, is_good))
    if not is_good:
        notes.append("The accelerometer misses gravity: run `tiger calibrate accel`.")
    x, y, z = np.radians(bias).tolist()
    return Result(tuple(findings), {"gyro_bias_radps": (x, y, z), "calibrated": (1.0,)}, tuple(notes))


def imu_procedure(rest_s: float = REST_S) -> Procedure:
    """Gyroscope bias from `rest_s` of rest."""
    pose = Confirm("Let the robot stand still, motors off. Nobody touches it from now on.")
    stage = Stage("at rest", rest_s, unrest, pose)
    return Procedure("imu", BoardKind.NANO_IMU, (stage,), channels, solve)
