"""One corner of the vehicle: body mass on a spring, damper and actuator, wheel mass on the tyre spring (4.5).

The signs are those of the equations of motion; the matrices printed under (4.5) carry the opposite sign for
the force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.models.linear import LinearModel

if TYPE_CHECKING:
    from tiger.config.vehicle import VehicleConfig

STATES = ("body_m", "body_rate_mps", "wheel_m", "wheel_rate_mps")
INPUTS = ("force_n", "road_m", "lift_m", "lift_rate_mps")
OUTPUTS = ("body_accel_mps2", "body_m", "wheel_m", "suspension_m", "tire_m")


@dataclass(frozen=True, slots=True)
class QuarterCarParameters:
    """Masses, spring, damper and tyre of one corner."""

    body_mass_kg: float
    wheel_mass_kg: float
    spring_npm: float
    damper_nspm: float
    tire_stiffness_npm: float

    @classmethod
    def from_config(cls, vehicle: VehicleConfig, axle: str = "front") -> QuarterCarParameters:
        """Take one corner of the named axle, with the share of the body that rests on it."""
        if axle not in ("front", "rear"):
            raise ValueError(f"axle is {axle!r}: use front or rear")
        corner = vehicle.front if axle == "front" else vehicle.rear
        front, rear = vehicle.body.com_to_front_axle_m, vehicle.body.com_to_rear_axle_m
        share = (rear if axle == "front" else front) / (2 * (front + rear))
        return cls(
            body_mass_kg=vehicle.body.mass_kg * share,
            wheel_mass_kg=corner.unsprung_mass_kg,
            spring_npm=corner.spring_npm,
            damper_nspm=corner.damper_nspm,
            tire_stiffness_npm=vehicle.tire.vertical_stiffness_npm,
        )


def quarter_car(p: QuarterCarParameters) -> LinearModel:
    """Build (4.5) with inputs force (+ lifts the body), road, and the lift of a stroke in series with its
    rate.

    Outputs: body acceleration, body and wheel height, suspension = body - wheel, tyre = wheel - road (m,
    m/s^2).
    """
    k, c, kt = p.spring_npm, p.damper_nspm, p.tire_stiffness_npm
    body = np.array([-k, -c, k, c]) / p.body_mass_kg
    wheel = np.array([k, c, -k - kt, -c]) / p.wheel_mass_kg
    body_inputs = np.array([1.0, 0.0, k, c]) / p.body_mass_kg
    wheel_inputs = np.array([-1.0, kt, -k, -c]) / p.wheel_mass_kg
    a = np.array([[0, 1, 0, 0], body, [0, 0, 0, 1], wheel])
    b = np.array([np.zeros(4), body_inputs, np.zeros(4), wheel_inputs])
    outputs = np.array([body, [1, 0, 0, 0], [0, 0, 1, 0], [1, 0, -1, 0], [0, 0, 1, 0]])
    through = np.zeros((5, 4))
    through[0], through[4, 1] = body_inputs, -1.0
    return LinearModel(a, b, outputs, through, STATES, INPUTS, OUTPUTS)
