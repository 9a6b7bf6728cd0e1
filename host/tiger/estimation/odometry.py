"""Where the robot is and how fast it goes: wheels and IMU, gated by slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.record import Odometry

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Inputs


@dataclass(frozen=True, slots=True)
class OdometryDesign:
    """What `design_odometry` computes once."""


@dataclass(frozen=True, slots=True)
class OdometryState:
    """What a tick leaves to the next."""


def design_odometry(robot: RobotConfig) -> OdometryDesign:
    """Prepare the filter."""
    return OdometryDesign()


def step(
    design: OdometryDesign, state: OdometryState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[OdometryState, Odometry]:
    """Advance by `dt` seconds; `estimate` has the attitude of this tick."""
    return state, Odometry()
