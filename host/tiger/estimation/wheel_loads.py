"""Loads of the four wheels, with the mass and the centre of mass of whatever the robot carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.record import Loads

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Estimate, Inputs


@dataclass(frozen=True, slots=True)
class LoadsDesign:
    """What `design_loads` computes once."""

    empty: Loads


@dataclass(frozen=True, slots=True)
class LoadsState:
    """What a tick leaves to the next."""


def design_loads(robot: RobotConfig) -> LoadsDesign:
    """Prepare the estimators for one vehicle, empty as the config has it."""
    from tiger.models.full_car import FullCarParameters

    parameters = FullCarParameters.from_config(robot.vehicle)
    fl, fr, rl, rr = parameters.static_tire_load_n().tolist()
    vehicle = robot.vehicle
    unsprung_kg = 2.0 * (vehicle.front.unsprung_mass_kg + vehicle.rear.unsprung_mass_kg)
    return LoadsDesign(Loads(wheel_load_n=(fl, fr, rl, rr), mass_kg=vehicle.body.mass_kg + unsprung_kg))


def step(
    design: LoadsDesign, state: LoadsState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[LoadsState, Loads]:
    """Advance by `dt` seconds; `estimate` has attitude and odometry of this tick."""
    return state, design.empty
