"""Did the robot just run into something? A trip is a blow along the ground, felt by the accelerometer.

Less what turning explains, the specific force along the body's x and y axes stays near its own mean of the
last tenths of a second: slopes turn slowly, and the drive only does what it is told. A wheel that hits a curb
pushes back within a few hundredths. Rough ground pushes too, but to and fro; the blow's integral tells them
apart.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from tiger.frozen import dataclass

if TYPE_CHECKING:
    from tiger.config.robot import StabilityConfig


@dataclass(frozen=True, slots=True)
class TripState:
    """Means of the specific force along x and y, the blow so far, and how long it is still shown."""

    mean_x_mps2: float = 0.0
    mean_y_mps2: float = 0.0
    blow_x_mps: float = 0.0
    blow_y_mps: float = 0.0
    told_mps: float = 0.0
    """Speed that the drive is to have by now, ..."""
    driven_mps: float = 0.0
    """... and how much of a blow that may have made."""
    hold_s: float = 0.0


def step(
    config: StabilityConfig,
    state: TripState,
    along_mps2: float,
    across_mps2: float,
    wanted_mps: float,
    driving_mps2: float,
    dt: float,
) -> TripState:
    """Take one sample of the specific force along x and y, `dt` seconds after the one before.

    `across_mps2` is without the acceleration of turning. The drive goes to `wanted_mps` with up to
    `driving_mps2`.
    """
    slow, keep = min(1.0, dt / config.trip_mean_s), config.trip_blow_s / (config.trip_blow_s + dt)
    dx, dy = along_mps2 - state.mean_x_mps2, across_mps2 - state.mean_y_mps2
    blow_x, blow_y = keep * (state.blow_x_mps + dx * dt), keep * (state.blow_y_mps + dy * dt)
    told, driven, most = state.told_mps, (1.0 - slow) * state.driven_mps, driving_mps2 * dt
    if told != wanted_mps:
        change = min(most, max(-most, wanted_mps - told))
        told += change
        driven = min(driving_mps2 * config.trip_blow_s, driven + abs(change))
    hold = max(0.0, state.hold_s - dt)
    if hypot(max(0.0, abs(blow_x) - driven), blow_y) > config.trip_blow_mps:
        hold = config.trip_hold_s
    mean_x, mean_y = state.mean_x_mps2 + slow * dx, state.mean_y_mps2 + slow * dy
    return TripState(mean_x, mean_y, blow_x, blow_y, told, driven, hold)
