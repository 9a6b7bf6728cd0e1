"""What the three studies of section 5.2 share: the car, its speed hold, and how it is driven."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiger.config.vehicle import load_vehicle
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.vehicle import Inputs
from tiger.models.vehicle_kernel import VELOCITY
from tiger.studies.report import unwatched

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.vehicle import VehicleConfig
    from tiger.models.vehicle import History, Vehicle
    from tiger.studies.report import Progress

Array = NDArray[np.float64]

KMH_TO_MPS = 1.0 / 3.6
CONTROL_PERIOD_S = 1e-3

ASSUMPTIONS = {
    "tyre": "Magic Formula, Pacejka 2006 App. 3 (205/60R15); the dissertation names no tyre",
    "com_height_m, wheel inertia, rolling resistance, relaxation": "chosen (the preset says so)",
}
"""Choices every study of chapter 5 rests on."""


def load_car(vehicle: str, inertia_divisor: float) -> VehicleConfig:
    """Load a vehicle and divide its pitch and yaw inertia (the printed ones are ten times too large)."""
    if not inertia_divisor > 0.0:
        raise ValueError(
            f"inertia_divisor = {inertia_divisor}; it must be above 0 (1: as printed, 10: likely)"
        )
    config = load_vehicle(vehicle)
    body = config.body.model_copy(
        update={
            "pitch_inertia_kgm2": config.body.pitch_inertia_kgm2 / inertia_divisor,
            "yaw_inertia_kgm2": config.body.yaw_inertia_kgm2 / inertia_divisor,
        }
    )
    return config.model_copy(update={"body": body})


class SpeedHold:
    """Cruise control: equal wheel torques, proportional-integral in the speed error, rolling drag fed in."""

    def __init__(self, config: VehicleConfig, speed_mps: float, gain_per_s: float = 3.0) -> None:
        """Hold `speed_mps`; the closed loop's bandwidth is `gain_per_s`, the integral a third of it."""
        wheels_kg = 2.0 * (config.front.unsprung_mass_kg + config.rear.unsprung_mass_kg)
        mass_kg = config.body.mass_kg + wheels_kg
        self._speed = speed_mps
        self._gain = gain_per_s
        self._integral_gain = gain_per_s / 3.0
        self._torque_per_acceleration = mass_kg * config.tire.rolling_radius_m / 4.0
        self._drag = config.tire.rolling_resistance * GRAVITY_MPS2
        self._integral = 0.0

    def act(self, state: Array, inputs: Inputs) -> None:
        """Set the four wheel torques for the next control period."""
        error = self._speed - state[VELOCITY.start]
        self._integral += error * CONTROL_PERIOD_S
        wanted = self._gain * error + self._integral_gain * self._integral + self._drag
        inputs.wheel_torque_nm[:] = self._torque_per_acceleration * wanted


def drive(
    plant: Vehicle,
    start: Array,
    duration_s: float,
    dt_s: float,
    act: Callable[[float, Array, Inputs], None],
    progress: Progress = unwatched,
) -> tuple[History, Array]:
    """Run `plant` under a controller that acts every millisecond; return samples and inputs at its instants.

    `act(time_s, state, inputs)` sets the inputs held until its next call; the integration step `dt_s` is a
    whole fraction of that millisecond. Of n + 1 samples the last has no input: the inputs are (n, 34).
    Raises ValueError for any other step.
    """
    substeps = round(CONTROL_PERIOD_S / dt_s)
    if substeps < 1 or abs(substeps * dt_s - CONTROL_PERIOD_S) > 1e-12:
        raise ValueError(f"dt_s = {dt_s}; it must be 1 ms or a whole fraction of it")
    ticks = round(duration_s / CONTROL_PERIOD_S)
    state, inputs = start.copy(), Inputs()
    table = np.empty((ticks, inputs.vector.size))
    for k in range(ticks):
        act(k * CONTROL_PERIOD_S, state, inputs)
        table[k] = inputs.vector
        plant.step(state, inputs, dt_s, substeps)
        if k % 500 == 0:
            progress(k / ticks)
    return plant.simulate(start, table, duration_s, dt_s, substeps), table


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def peak(values: Array) -> float:
    """Largest magnitude."""
    return float(np.max(np.abs(values)))
