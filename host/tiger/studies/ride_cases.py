"""The two roads of section 6.5.1 with what the dissertation leaves out, shared by the chapter 6 studies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.errors import ConfigError
from tiger.config.vehicle import load_vehicle
from tiger.control import ride_bank, ride_designs
from tiger.control.ride import ImuNoise
from tiger.models.full_car import FullCarParameters
from tiger.models.road import Bump, iso_road, rear_delay_s, wheel_heights_m
from tiger.studies.performance import fine_time_s, performance_index

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tiger.config.vehicle import VehicleConfig
    from tiger.control.ride import RideController
    from tiger.control.ride_bank import RideBank
    from tiger.studies.performance import RideRun

    Array = NDArray[np.float64]

BUMPY_SPEED_MPS = 20.0
BUMPY_DELAYS_S = (0.0, 0.049, 0.102, 0.151)
"""When FL, FR, RL, RR meet the bump of the printed table: fitted, for (6.30) as printed gives no roll at
all."""
BUMPY_PREVIEW_S = BUMPY_DELAYS_S[2] - BUMPY_DELAYS_S[0]
BUMPY_LANE_LAG_S = BUMPY_DELAYS_S[1] - BUMPY_DELAYS_S[0]
BUMPY_DURATION_S = 4.13

ISO_SPEED_MPS = 10.0
ISO_DURATION_S = 8.0
ISO_BAND_CYCLES_PER_M = (0.01, 1.7)

PRINTED = {
    "bumpy passive": (3.855, 1.638, 2.163, 0.971, 0.969, 0.420, 0.202, 0.146, 0.217, 0.249, 0.322, 0.230,
    0.690, 0.772), "bumpy active": (0.662, 0.302, 0.215, 0.107, 0.089, 0.043, 0.067, 0.021, 0.029, 0.042,
    0.802, 0.747, 0.854, 0.865), "iso passive": (1.397, 0.454, 1.242, 0.443, 1.797, 0.595, 0.122, 0.121,
    0.071, 0.072, 0.198, 0.192, 0.202, 0.226), "iso active": (0.624, 0.193, 0.563, 0.164, 0.740, 0.225, 0.115,
    0.128, 0.092, 0.095, 0.252, 0.379, 0.310, 0.372),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Case:
    """A vehicle with force actuators, as the chapter 6 studies take it."""

    car: FullCarParameters
    rattle_space_m: float
    max_force_n: float

    @property
    def iso_preview_s(self) -> float:
        """How much later the rear wheels meet the ISO road than the front wheels."""
        return self.car.wheelbase_m / ISO_SPEED_MPS

    def index(self, run: RideRun) -> Array:
        """Return the performance index of a run of this car, (runs, 14) in the order of INDEX_NAMES."""
        return performance_index(self.car, self.rattle_space_m, run)


def load_case(vehicle: str) -> Case:
    """Load a vehicle by name or path. Raises ConfigError where it has no force actuators."""
    config: VehicleConfig = load_vehicle(vehicle)
    if config.actuator.kind != "force":
        raise ConfigError(
            f"vehicle {vehicle!r} moves strokes at a limited rate: the ride control of chapter 6 needs "
            'actuator.kind = "force", as the preset table-6-1 has'
        )
    car = FullCarParameters.from_config(config)
    return Case(car, config.actuator.rattle_space_m, config.actuator.max_force_n)


def perturbed(
    car: FullCarParameters,
    com_x: float = 0.0,
    com_y: float = 0.0,
    mass: float = 0.0,
    front_spring: float = 0.0,
    rear_spring: float = 0.0,
) -> tuple[FullCarParameters, tuple[float, float]]:
    """Return a car that is off by the given fractions, and where its IMU then lies from the true centre of
    mass.

    com_x is a fraction of the front axle's distance, com_y of the half track (r_m of section 6.5.2). The IMU
    stays where the centre of mass was believed to be. The body's inertias grow with its mass.
    """
    x, y = com_x * car.com_to_front_axle_m, com_y * car.half_track_m
    off = replace(
        car,
        body_mass_kg=car.body_mass_kg * (1 + mass),
        roll_inertia_kgm2=car.roll_inertia_kgm2 * (1 + mass),
        pitch_inertia_kgm2=car.pitch_inertia_kgm2 * (1 + mass),
        front_spring_npm=car.front_spring_npm * (1 + front_spring),
        rear_spring_npm=car.rear_spring_npm * (1 + rear_spring),
        com_to_front_axle_m=car.com_to_front_axle_m - x,
        com_to_rear_axle_m=car.com_to_rear_axle_m + x,
        com_left_m=car.com_left_m + y,
    )
    return off, (-x, -y)


def bumpy_road(speed_mps: float = BUMPY_SPEED_MPS, duration_s: float = BUMPY_DURATION_S) -> Array:
    """Return the bumpy road under the wheels, (fine steps + 1, 4); the delays scale with 20 m/s over the
    speed."""
    delays = [delay * BUMPY_SPEED_MPS / speed_mps for delay in BUMPY_DELAYS_S]
    return wheel_heights_m(Bump(), fine_time_s(duration_s), speed_mps, delays)


def bumpy_controller(
    case: Case,
    noise_factor: float,
    preview: bool,
    speed_mps: float = BUMPY_SPEED_MPS,
    suspension_factor: float = 1.0,
    max_force_n: float = np.inf,
) -> RideController | RideBank:
    """Design the controller for the bumpy road at a speed and an IMU of `noise_factor` x the nominal noise.

    preview: the rear wheels are told what the front wheels met. Without it a bank finds out which lane leads.
    """
    noise = ImuNoise().scaled(noise_factor)
    tuning = ride_designs.for_bumpy_road(noise_factor, preview).with_suspension(suspension_factor)
    slower = BUMPY_SPEED_MPS / speed_mps
    if preview:
        return tuning.controller(case.car, noise, BUMPY_PREVIEW_S * slower, max_force_n=max_force_n)
    return ride_bank.oblique(tuning, case.car, noise, BUMPY_LANE_LAG_S * slower, max_force_n=max_force_n)


def iso_roads(
    car: FullCarParameters,
    seeds: Sequence[int],
    road_class: str = "C",
    speed_mps: float = ISO_SPEED_MPS,
    duration_s: float = ISO_DURATION_S,
    band_cycles_per_m: tuple[float, float] = ISO_BAND_CYCLES_PER_M,
) -> Array:
    """Return one ISO 8608 road per seed under the wheels, (seeds, fine steps + 1, 4)."""
    tau = rear_delay_s(car.wheelbase_m, speed_mps)
    time_s = fine_time_s(duration_s)
    return np.stack(
        [
            wheel_heights_m(
                iso_road(road_class, seed, band_cycles_per_m=band_cycles_per_m),
                time_s,
                speed_mps,
                (0.0, 0.0, tau, tau),
            )
            for seed in seeds
        ]
    )
