"""Roll and pitch that starts, stops and turns do not bend: gyro and accelerometer, held by the wheels' speed.

An inclinometer takes the acceleration of a start for a slope; the IMU's own filter (docs/attitude-filter.md)
resists with its gyro for a while, and is some half a degree off after a second of 1 m/s2. The wheels know
that acceleration. For small angles (ISO 8855: pitch + = nose down, roll + = left side up) the accelerometer
feels f_x = v' - g pitch and f_y = v r + g roll, so

    v'     = f_x + g pitch              corrected by the wheels' speed, which no tilt can bend,
    pitch' = q cos(roll) - r sin(roll)  corrected by the same difference,
    roll'  = p + tan(pitch) r           corrected by (f_y - v r)/g - roll.

The poles of the pitch are at `bandwidth_radps`, damping 0.7. Slipping wheels correct nothing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from tiger.record import ImuSample, Three

_DAMPING = 0.7
_MOST_OFF_MPS = 0.1
"""A larger difference between wheels and integral is slip, and corrects no more than this one does."""


@dataclass(frozen=True, slots=True)
class AidedTilt:
    """The filter's state."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    speed_mps: float = 0.0
    begun: bool = False


def specific_force_mps2(sample: ImuSample) -> Three:
    """What the accelerometer felt, body axes: the linear acceleration with the gravity put back in."""
    w, x, y, z = sample.quaternion
    ax, ay, az = sample.linear_accel_mps2
    g = GRAVITY_MPS2
    return (
        ax + g * 2.0 * (x * z - w * y),
        ay + g * 2.0 * (y * z + w * x),
        az + g * (1.0 - 2.0 * (x * x + y * y)),
    )


def step(
    state: AidedTilt,
    force_mps2: Three,
    rate_radps: Three,
    wheels_mps: float,
    slipping: bool,
    bandwidth_radps: float,
    dt: float,
) -> AidedTilt:
    """Advance by `dt` seconds with the newest specific force, body rates and mean speed of the wheels."""
    fx, fy, _ = force_mps2
    g = GRAVITY_MPS2
    if not state.begun:
        pitch, roll = -fx / g, fy / g
        return AidedTilt(roll, pitch, wheels_mps, begun=True)
    roll, pitch = state.roll_rad, state.pitch_rad
    p, q, r = rate_radps
    off = 0.0 if slipping else min(_MOST_OFF_MPS, max(-_MOST_OFF_MPS, wheels_mps - state.speed_mps))
    sin, cos = math.sin(roll), math.cos(roll)
    lean = (fy - state.speed_mps * r) / g - roll
    return AidedTilt(
        roll + dt * (p + math.tan(pitch) * (q * sin + r * cos) + bandwidth_radps * _ROLL_SHARE * lean),
        pitch + dt * (q * cos - r * sin + bandwidth_radps**2 / g * off),
        state.speed_mps + dt * (fx + g * pitch + 2.0 * _DAMPING * bandwidth_radps * off),
        begun=True,
    )


_ROLL_SHARE = 0.3
"""The roll is held more softly: sideways, bumps are as strong as the lean of a turn."""
