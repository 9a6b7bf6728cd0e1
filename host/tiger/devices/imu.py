"""nano_imu: from its messages to samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.protocol.messages import ImuFlag
from tiger.record import ImuRawSample, ImuSample

if TYPE_CHECKING:
    from tiger.protocol.messages import ImuAttitude, ImuRaw

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
