"""What the world asks of the body that stands on its ground, whichever model moves it.

`linear_body` has 7 degrees of freedom on a plate, `vehicle_body` 14 on any terrain; a scenario chooses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.config.errors import ConfigError
from tiger.native._core import ffi

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import Scenario
    from tiger.record import Four


def _place(structure: str, field: str, length: int) -> slice:
    """Where a field of a C struct of doubles lies in the array of its numbers."""
    first = ffi.offsetof(structure, field) // ffi.sizeof("double")
    return slice(first, first + length)


PLATE = _place("tiger_body_command", "plate_rad", 2)
LIFT = _place("tiger_body_command", "lift_m", 4)
WHEEL_RPM = _place("tiger_body_command", "wheel_rpm", 4)
COMMANDS = ffi.sizeof("tiger_body_command") // ffi.sizeof("double")

ACCEL, RATE = _place("tiger_body_felt", "accel_mps2", 3), _place("tiger_body_felt", "rate_radps", 3)
SPRING = _place("tiger_body_felt", "spring_n", 4)
WHEEL_SPEED = _place("tiger_body_felt", "wheel_radps", 4)
WHEEL_ANGLE = _place("tiger_body_felt", "wheel_angle_rad", 4)
WHEEL_TORQUE = _place("tiger_body_felt", "wheel_torque_nm", 4)
FELT = ffi.sizeof("tiger_body_felt") // ffi.sizeof("double")


@dataclass(frozen=True, slots=True)
class Motion:
    """What no sensor tells of a body. Corners FL FR RL RR."""

    roll_rate_radps: float
    pitch_rate_radps: float
    position_m: tuple[float, float, float]
    """COM in the world."""
    speed_mps: float
    """COM, forward."""
    heave_m: float
    """COM above the ground between the wheels, less what it is at rest in mid-stroke on level ground."""
    wheel_load_n: Four
    slip_ratio: Four
    """(w r - v)/|v| of each contact, as far as its relaxation has followed."""


class Body(ABC):
    """A body with four wheels, at rest or rolling when made. Corners FL FR RL RR; SI units; ISO 8855 axes.

    It is moved by the compiled function `step` (a `tiger_body_step` of native_robot_api.h), which works on
    `context` and tells in `felt` what sensors and actuators feel of the body.
    """

    step: Any
    context: Any

    def __init__(self) -> None:
        self.felt: Any = ffi.new("tiger_body_felt *")
        felt = np.frombuffer(ffi.buffer(self.felt))
        self.accel_mps2 = felt[ACCEL]
        """Specific force where the IMU sits, (3,), body axes."""
        self.rate_radps = felt[RATE]
        """Body rates, (3,)."""
        self._command: Any = ffi.new("tiger_body_command *")

    @property
    def spring_n(self) -> Sequence[float]:
        """Forces of the four springs and dampers beyond the weight of the empty body, + pushes it up."""
        return list(self.felt.spring_n)

    @property
    def wheel_radps(self) -> Sequence[float]:
        """Speeds of the wheels against their carriers."""
        return list(self.felt.wheel_radps)

    @property
    def wheel_angle_rad(self) -> Sequence[float]:
        """How far the wheels have turned against their carriers."""
        return list(self.felt.wheel_angle_rad)

    @property
    def wheel_torque_nm(self) -> Sequence[float]:
        """What the motors do."""
        return list(self.felt.wheel_torque_nm)

    def advance(
        self, plate_rad: tuple[float, float], lift_m: Sequence[float], wheel_rpm: Sequence[float]
    ) -> None:
        """Move one step, at whose end the plate has (roll, pitch) `plate_rad`, the mechanisms `lift_m`.

        Lifts count from mid-stroke; `wheel_rpm` is commanded during the step.
        """
        command = self._command
        command.plate_rad, command.lift_m, command.wheel_rpm = plate_rad, lift_m, wheel_rpm
        self.step(self.context, command, self.felt)

    @property
    @abstractmethod
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""

    @abstractmethod
    def motion(self) -> Motion:
        """What no sensor tells, at this moment."""

    @abstractmethod
    def prepare(self, dt_s: float) -> None:
        """Make ready for steps of `dt_s`."""


def make_body(
    vehicle: VehicleConfig, scenario: Scenario, plate_rad: tuple[float, float], lift_m: Sequence[float]
) -> Body:
    """Return the body that the scenario asks for; raises ConfigError if it cannot be had here."""
    if scenario.model == "linear":
        from tiger.emulation.linear_body import LinearBody

        return LinearBody(vehicle, plate_rad, lift_m)
    try:
        from tiger.emulation.vehicle_body import VehicleBody  # compiled: half a second to load
    except ModuleNotFoundError as error:
        raise ConfigError(
            f'model = "vehicle" needs {error.name}: install tiger-robot[sim], or set model = "linear"'
        ) from error

    return VehicleBody(vehicle, scenario, plate_rad, lift_m)
