"""How far the robot is from tipping over, and the limits on its motion that keep it from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.record import Stability

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Command, Estimate, Inputs


@dataclass(frozen=True, slots=True)
class StabilityDesign:
    """What `design_stability` computes once."""


@dataclass(frozen=True, slots=True)
class StabilityState:
    """What a tick leaves to the next."""


def design_stability(robot: RobotConfig) -> StabilityDesign:
    """Prepare margins and limits."""
    return StabilityDesign()


def step(
    design: StabilityDesign,
    state: StabilityState,
    command: Command,
    inputs: Inputs,
    estimate: Estimate,
    dt: float,
) -> tuple[StabilityState, Stability, Command]:
    """Advance by `dt` seconds; return the command as far as it is safe. `estimate` has odometry and loads."""
    return state, Stability(), command
