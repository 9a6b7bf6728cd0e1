"""What the world asks of the body that stands on its ground, whichever model moves it.

`linear_body` has 7 degrees of freedom on a plate, `vehicle_body` 14 on any terrain; a scenario chooses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from tiger.config.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import Scenario

Four = tuple[float, float, float, float]


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


class Body(Protocol):
    """A body with four wheels, at rest or rolling when made. Corners FL FR RL RR; SI units; ISO 8855 axes."""

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""

    @property
    def accel_mps2(self) -> NDArray[np.float64]:
        """Specific force where the IMU sits, (3,), body axes."""

    @property
    def rate_radps(self) -> NDArray[np.float64]:
        """Body rates, (3,)."""

    @property
    def spring_n(self) -> Sequence[float]:
        """Forces of the four springs and dampers beyond the weight of the empty body, + pushes it up."""

    @property
    def wheel_radps(self) -> Sequence[float]:
        """Speeds of the wheels against their carriers."""

    @property
    def wheel_angle_rad(self) -> Sequence[float]:
        """How far the wheels have turned against their carriers."""

    @property
    def wheel_torque_nm(self) -> Sequence[float]:
        """What the motors do."""

    def motion(self) -> Motion:
        """What no sensor tells, at this moment."""

    def prepare(self, dt_s: float) -> None:
        """Make ready for steps of `dt_s`."""

    def advance(
        self, plate_rad: tuple[float, float], lift_m: Sequence[float], wheel_rpm: Sequence[float]
    ) -> None:
        """Move one step, at whose end the plate has (roll, pitch) `plate_rad`, the mechanisms `lift_m`.

        Lifts count from mid-stroke; `wheel_rpm` is commanded during the step.
        """


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
