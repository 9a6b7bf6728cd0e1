"""Class of the ground's roughness (ISO 8608) from the vertical acceleration of the body and its speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.record import Roughness

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Inputs


@dataclass(frozen=True, slots=True)
class RoughnessDesign:
    """What `design_roughness` computes once."""


@dataclass(frozen=True, slots=True)
class RoughnessState:
    """What a tick leaves to the next."""


def design_roughness(robot: RobotConfig) -> RoughnessDesign:
    """Prepare the filters."""
    return RoughnessDesign()


def step(
    design: RoughnessDesign, state: RoughnessState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[RoughnessState, Roughness]:
    """Advance by `dt` seconds; `estimate` has the odometry of this tick."""
    return state, Roughness()
