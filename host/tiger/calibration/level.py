"""Mounting of the IMU from gravity on level ground: what the dissertation does with springs (section 3.4.6).

The reading of a robot on level ground must point straight up. The shortest turn that does it goes in front
of the stored mounting; it has no part about the vertical, so yaw stays as it was. Offset, scale and bias are
those of axes that turn with the mounting, and are turned along.

Level ground is seldom level. With the robot turned round by half a turn in between, slope cancels in the
mean of both readings, and what is left is the mounting.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from tiger.calibration.imu import GRAVITY_ERROR_MOST_MPS2, channels, unrest
from tiger.calibration.procedure import (
    CalibrationError,
    Confirm,
    Finding,
    Move,
    Procedure,
    Result,
    Stage,
    Values,
    Window,
)
from tiger.models.full_car import GRAVITY_MPS2
from tiger.protocol.messages import BoardKind

if TYPE_CHECKING:
    from tiger.calibration.procedure import Array

REST_S = 5.0
TILT_MOST_DEG = 45.0
STROKES_APART_MOST_MM = 1.0
SLOPE_MOST_DEG = 5.0


def shortest_turn_up(direction: Array) -> Rotation:
    """The shortest turn that brings a direction (3,) above the horizon onto z; it has no part about z."""
    x, y, z = direction / np.linalg.norm(direction)
    axis = np.array([y, -x, 0.0])  # direction x (0, 0, 1)
    sine = float(np.linalg.norm(axis))
    if sine == 0.0:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / sine * math.atan2(sine, z))


def _up(window: Window, before: Values) -> Array:
    """Direction of the calibrated specific force."""
    scale = np.asarray(before["accel_scale_permille"]) / 1000.0
    force = scale * (window.mean[:3] - np.asarray(before["accel_offset_mps2"]))
    length = float(np.linalg.norm(force))
    if abs(length - GRAVITY_MPS2) > 3.0 * GRAVITY_ERROR_MOST_MPS2:
        raise CalibrationError(
            f"level: the accelerometer reads {length:.2f} m/s2 at rest instead of {GRAVITY_MPS2:g}; "
            "run `tiger calibrate accel` first"
        )
    return np.asarray(force / length)


def _lean_deg(up: Array) -> tuple[float, float]:
    """Roll (left side up +) and pitch (nose down +) that an attitude filter would see."""
    x, y, z = up
    return math.degrees(math.atan2(y, z)), math.degrees(math.atan2(-x, math.hypot(y, z)))


def solve(windows: tuple[Window, ...], before: Values) -> Result:
    """Mounting from one still window (N, 6), or from two with half a turn of the robot in between."""
    for window in windows:
        if window.stroke_mm is not None:
            apart = max(window.stroke_mm) - min(window.stroke_mm)
            if apart > STROKES_APART_MOST_MM:
                raise CalibrationError(
                    f"level: the strokes are {apart:.1f} mm apart, at most {STROKES_APART_MOST_MM:g}: the "
                    "body leans on its mechanisms; run `tiger calibrate level --arm`, which makes them equal"
                )
    ups = [_up(window, before) for window in windows]
    up = np.mean(ups, axis=0)
    turn = shortest_turn_up(up)
    tilt = math.degrees(turn.magnitude())
    if up[2] <= 0.0 or tilt > TILT_MOST_DEG:
        raise CalibrationError(
            f"level: the sensor is tilted by {tilt:.0f} degrees, at most {TILT_MOST_DEG:g}; mount it with "
            "its x forward and its z up"
        )
    roll, pitch = _lean_deg(up)
    findings = [
        Finding("roll of the sensor", roll, "degrees"),
        Finding("pitch of the sensor", pitch, "degrees"),
    ]
    notes = []
    if len(ups) == 2:
        slope = math.degrees(math.asin(min(float(np.linalg.norm(ups[0] - ups[1])) / 2.0, 1.0)))
        findings.append(Finding("slope of the ground", slope, "degrees", SLOPE_MOST_DEG))
        if slope > SLOPE_MOST_DEG:
            raise CalibrationError(
                f"level: the ground slopes by {slope:.1f} degrees, at most {SLOPE_MOST_DEG:g}; find flatter "
                "ground"
            )
    else:
        notes.append("The ground was taken as level; `--turn` measures its slope and takes it out.")
    return Result(tuple(findings), _turned(turn, before), tuple(notes))


def _turned(turn: Rotation, before: Values) -> dict[str, tuple[float, ...]]:
    """The parameters of the board after a further turn of the axes."""
    mounting = turn * Rotation.from_quat(before["mounting_quaternion"], scalar_first=True)
    quaternion = mounting.as_quat(canonical=True, scalar_first=True)
    matrix = turn.as_matrix()
    scale = np.diag(matrix @ np.diag(before["accel_scale_permille"]) @ matrix.T)
    return {
        "mounting_quaternion": tuple(quaternion.tolist()),
        "accel_offset_mps2": tuple((matrix @ before["accel_offset_mps2"]).tolist()),
        "accel_scale_permille": tuple(scale.tolist()),
        "gyro_bias_radps": tuple((matrix @ before["gyro_bias_radps"]).tolist()),
    }


def level_procedure(turned: bool = False, even_mm: float | None = None, rest_s: float = REST_S) -> Procedure:
    """Mounting on level ground.

    Args:
        turned: measure twice, with half a turn of the robot in between, so that the ground may slope.
        even_mm: bring all strokes to this one first; None: they are left as they are.
        rest_s: length of a measurement.
    """
    at_rest = partial(Stage, gather_s=rest_s, check=unrest)
    pose: Confirm | Move = Confirm("Let the robot stand still on level ground, unloaded.")
    if even_mm is not None:
        pose = Move((even_mm, even_mm, even_mm, even_mm))
    stages = [at_rest("on level ground", pose=pose)]
    if turned:
        text = "Turn the robot round by half a turn, onto the same spot. Let it stand still."
        stages.append(at_rest("turned round", pose=Confirm(text, turn_deg=180.0)))
    return Procedure("level", BoardKind.NANO_IMU, tuple(stages), channels, solve)
