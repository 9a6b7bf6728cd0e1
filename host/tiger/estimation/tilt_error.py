"""What the Nano's attitude is off by, from the odometry's, which a start or a stop does not bend.

The Nano takes seconds of acceleration for a slope, up to three degrees of it, and forgets that in ten seconds
(docs/attitude-filter.md). The odometry's roll and pitch are held by the speed of the wheels
(docs/odometry.md). Both carry the same gyroscope, so that their difference at a sample is quiet and slow: it
is followed, and put right in the samples to come. Where the odometry does not know its tilt, without speeds
of wheels or after slipping for long, it is forgotten as slowly as the Nano forgets.
"""

from __future__ import annotations

from math import exp, inf, radians
from typing import TYPE_CHECKING

from tiger.estimation.attitude_observer import attitude_rad
from tiger.estimation.inertial import PITCH, ROLL
from tiger.frozen import dataclass

if TYPE_CHECKING:
    from tiger.config.robot import ObserverConfig
    from tiger.estimation.odometry import OdometryState
    from tiger.record import ImuSample

HELD_WITHIN_S = 0.3
"""Odometry that nothing has held for longer knows no better than the Nano."""
PAIRED_WITHIN_S = 0.1
"""Attitude and raw readings of one moment come apart; for so long the later is waited for."""


@dataclass(frozen=True, slots=True)
class TiltError:
    """What to add to the Nano's roll and pitch, and the time of the sample that told it."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    t_s: float = -inf


def corrected_rad(error: TiltError, sample: ImuSample) -> tuple[float, float]:
    """Return roll and pitch at a sample, put right."""
    roll, pitch = attitude_rad(sample.quaternion)
    return roll + error.roll_rad, pitch + error.pitch_rad


def step(config: ObserverConfig, error: TiltError, sample: ImuSample, odometry: OdometryState) -> TiltError:
    """Follow the difference at a sample that both have, no faster than the Nano can go astray."""
    dt = sample.t_s - error.t_s
    if dt <= 0.0:
        return error
    paired = sample.t_s == odometry.imu_t_s
    if not paired and dt < PAIRED_WITHIN_S:
        return error
    dt, held = min(dt, PAIRED_WITHIN_S), odometry.held
    known = paired and sample.t_s - held.imu_t_s < HELD_WITHIN_S
    unsure = max(held.covariance.item(ROLL, ROLL), held.covariance.item(PITCH, PITCH))
    if not known or unsure > radians(config.tilt_sigma_deg) ** 2:
        keep = exp(-dt / config.tilt_forget_s)
        return TiltError(keep * error.roll_rad, keep * error.pitch_rad, sample.t_s)
    roll, pitch = attitude_rad(sample.quaternion)
    share, most = min(1.0, dt / config.tilt_follow_s), dt * radians(config.tilt_rate_degps)
    across = share * (odometry.motion.roll_rad - roll - error.roll_rad)
    along = share * (odometry.motion.pitch_rad - pitch - error.pitch_rad)
    return TiltError(
        error.roll_rad + min(most, max(-most, across)),
        error.pitch_rad + min(most, max(-most, along)),
        sample.t_s,
    )
