"""nano_imu: from its messages to samples, and what a sample says of the force that was felt."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.models.full_car import GRAVITY_MPS2
from tiger.protocol.messages import ImuFlag
from tiger.record import ImuRawSample, ImuSample

if TYPE_CHECKING:
    from tiger.protocol.messages import ImuAttitude, ImuRaw
    from tiger.record import Three

_STALE = 1 << ImuFlag.STALE


def imu_sample(message: ImuAttitude, t_s: float) -> ImuSample | None:
    """The sample in an `imu_attitude` taken at host time `t_s`; None when the board says it is an old one."""
    if message.flags & _STALE:
        return None
    return ImuSample(
        t_s,
        message.quaternion,
        message.rate_radps,
        message.angular_accel_radps2,
        message.linear_accel_mps2,
        message.flags,
    )


def imu_raw_sample(message: ImuRaw, t_s: float) -> ImuRawSample:
    """The sample in an `imu_raw` taken at host time `t_s`."""
    return ImuRawSample(t_s, message.accel_mps2, message.gyro_radps, message.mag_ut)


def specific_force_mps2(imu: ImuSample) -> Three:
    """What the IMU's accelerometer felt, body axes: its linear acceleration with the gravity put back in."""
    w, x, y, z = imu.quaternion
    ahead, left, up = imu.linear_accel_mps2
    g = GRAVITY_MPS2
    return (
        ahead + 2.0 * g * (x * z - w * y),
        left + 2.0 * g * (y * z + w * x),
        up + g * (1.0 - 2.0 * (x * x + y * y)),
    )
