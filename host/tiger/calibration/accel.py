"""Six-position calibration of the accelerometer: offset and scale of each axis.

At rest a true reading has the length of gravity whatever its direction, so nobody need hold the sensor
exactly upright: offset b and scale s make |s (a - b)| = g in all positions (least squares). Each axis must
point up once and down once, or its offset and scale cannot be told apart.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from tiger.calibration.imu import AXES, STILL_ACCEL_MPS2, channels
from tiger.calibration.procedure import (
    Array,
    CalibrationError,
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
from tiger.protocol.messages import BoardKind

POSITION_S = 3.0
UPRIGHT_SHARE = 0.9  # of gravity that an axis must feel to count as upright: within 26 degrees
OFFSET_MOST_MPS2 = 2.0 * BNO055.accelerometer.bias  # twice the data sheet's typical offset
SCALE_ERROR_MOST = 0.04  # data sheet, at most

POSITIONS = tuple((axis, sign) for axis in range(3) for sign in (1.0, -1.0))
"""Axis and direction that points up in each position."""


def position_name(axis: int, sign: float) -> str:
    """How a person calls a position."""
    return f"{AXES[axis]} axis {'up' if sign > 0.0 else 'down'}"


def _up(axis: int, sign: float) -> tuple[float, float, float]:
    x, y, z = (sign * np.eye(3)[axis]).tolist()
    return x, y, z


def not_upright(axis: int, sign: float, readings: Array) -> str | None:
    """Why readings (N, 6) are not those of a sensor lying still in a position; None when they are."""
    accel = readings[:, :3]
    shaking = float(accel.std(axis=0).max())
    if shaking > STILL_ACCEL_MPS2:
        return f"it moves ({shaking:.2f} m/s2 RMS, at most {STILL_ACCEL_MPS2:g}); lay it down, do not hold it"
    felt = sign * float(accel[:, axis].mean())
    least = UPRIGHT_SHARE * GRAVITY_MPS2
    if felt < least:
        mean = accel.mean(axis=0)
        now = int(np.abs(mean).argmax())
        return (
            f"that axis feels {felt:.1f} m/s2, at least {least:.1f} when upright; "
            f"now it is {position_name(now, float(np.sign(mean[now])))}: turn it"
        )
    return None


def fit(means: Array) -> tuple[Array, Array, Array]:
    """Offset (3,), scale (3,) and what is left of |s (a - b)| - g, (N,), for readings at rest (N, 3)."""

    def miss(unknown: Array) -> Array:
        return np.asarray(np.linalg.norm(unknown[3:] * (means - unknown[:3]), axis=1) - GRAVITY_MPS2)

    high, low = means.max(axis=0), means.min(axis=0)
    start = np.concatenate([(high + low) / 2.0, 2.0 * GRAVITY_MPS2 / (high - low)])
    found = least_squares(miss, start, method="lm")
    return found.x[:3], found.x[3:], miss(found.x)


def solve(windows: tuple[Window, ...], before: Values) -> Result:
    """Offset and scale from one still window (N, 6) for each of POSITIONS."""
    means = np.array([window.mean[:3] for window in windows])
    offset, scale, left = fit(means)
    worst_offset, worst_scale = float(np.abs(offset).max()), float(np.abs(scale - 1.0).max())
    if worst_offset > 3.0 or worst_scale > 0.2:
        raise CalibrationError(
            f"accel: an offset of {worst_offset:.2f} m/s2 and a scale {100.0 * worst_scale:.0f} % off "
            "cannot be stored (at most 3 m/s2 and 20 %); do it again, and replace the sensor if it stays"
        )
    old_offset = np.asarray(before["accel_offset_mps2"])
    old_scale = np.asarray(before["accel_scale_permille"]) / 1000.0
    missed = np.linalg.norm(old_scale * (means - old_offset), axis=1) - GRAVITY_MPS2
    spread = max(float(w.readings[:, :3].std(axis=0).max()) / math.sqrt(len(w.readings)) for w in windows)
    findings = [
        Finding(
            f"offset {axis}", float(value), "m/s2", OFFSET_MOST_MPS2, bool(abs(value) <= OFFSET_MOST_MPS2)
        )
        for axis, value in zip(AXES, offset, strict=True)
    ]
    findings += [
        Finding(
            f"scale {axis}",
            float(value),
            "",
            1.0 + SCALE_ERROR_MOST,
            bool(abs(value - 1.0) <= SCALE_ERROR_MOST),
        )
        for axis, value in zip(AXES, scale, strict=True)
    ]
    findings += [
        Finding("gravity error before", float(np.sqrt(np.mean(missed**2))), "m/s2 RMS"),
        Finding("left by the fit", float(np.sqrt(np.mean(left**2))), "m/s2 RMS"),
        Finding("uncertainty of a mean", spread, "m/s2"),
    ]
    notes = () if all(f.good for f in findings) else ("Beyond the data sheet: consider another sensor.",)
    (bx, by, bz), (sx, sy, sz) = offset.tolist(), (1000.0 * scale).tolist()
    parameters = {"accel_offset_mps2": (bx, by, bz), "accel_scale_permille": (sx, sy, sz)}
    return Result(tuple(findings), parameters, notes)


def accel_procedure(position_s: float = POSITION_S) -> Procedure:
    """Six positions of the sensor, `position_s` each."""
    stages = tuple(
        Stage(
            name,
            position_s,
            partial(not_upright, axis, sign),
            Confirm(f"Lay the sensor (or the robot) down with its {name}, within 20 degrees or so.", up),
        )
        for axis, sign in POSITIONS
        for name, up in ((position_name(axis, sign), _up(axis, sign)),)
    )
    return Procedure("accel", BoardKind.NANO_IMU, stages, channels, solve)
