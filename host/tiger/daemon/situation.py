"""What the robot knows of its motion, load and ground: the estimators behind the attitude, in order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tiger.estimation import odometry, roughness, wheel_loads
from tiger.estimation.odometry import OdometryDesign, OdometryState
from tiger.estimation.roughness import RoughnessDesign, RoughnessState
from tiger.estimation.wheel_loads import LoadsDesign, LoadsState

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Inputs


@dataclass(frozen=True, slots=True, eq=False)
class SituationDesign:
    """Designs of the estimators."""

    odometry: OdometryDesign
    loads: LoadsDesign
    roughness: RoughnessDesign


@dataclass(frozen=True, slots=True, eq=False)
class SituationState:
    """States of the estimators."""

    odometry: OdometryState = field(default_factory=OdometryState)
    loads: LoadsState = field(default_factory=LoadsState)
    roughness: RoughnessState = field(default_factory=RoughnessState)


def design_situation(robot: RobotConfig) -> SituationDesign:
    """Design everything for a checked configuration."""
    return SituationDesign(
        odometry=odometry.design_odometry(robot),
        loads=wheel_loads.design_loads(robot),
        roughness=roughness.design_roughness(robot),
    )


def step(
    design: SituationDesign, state: SituationState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[SituationState, Estimate]:
    """Advance by `dt` seconds from this tick's attitude; each estimator sees what those before it found."""
    moving, where = odometry.step(design.odometry, state.odometry, inputs, estimate, dt)
    estimate = replace(
        estimate, speed_mps=where.speed_mps, yaw_rate_radps=where.yaw_rate_radps, odometry=where
    )
    loading, loads = wheel_loads.step(design.loads, state.loads, inputs, estimate, dt)
    rolling, rough = roughness.step(design.roughness, state.roughness, inputs, estimate, dt)
    return SituationState(moving, loading, rolling), replace(estimate, loads=loads, roughness=rough)
