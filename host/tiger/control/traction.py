"""Forces distributed over the four tyres, as trims of the wheel speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.record import Traction

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Four, Inputs


@dataclass(frozen=True, slots=True)
class TractionDesign:
    """What `design_traction` computes once."""


@dataclass(frozen=True, slots=True)
class TractionState:
    """What a tick leaves to the next."""


def design_traction(robot: RobotConfig) -> TractionDesign:
    """Prepare limits and the quadratic programme."""
    return TractionDesign()


def step(
    design: TractionDesign,
    state: TractionState,
    wheel_rpm: Four,
    inputs: Inputs,
    estimate: Estimate,
    dt: float,
) -> tuple[TractionState, Traction, Four]:
    """Advance by `dt` seconds; returns the wheel speeds in rpm with their trims."""
    return state, Traction(), wheel_rpm
