"""Did the robot just run into something? A trip is a blow along the ground, felt by the accelerometer.

Less what turning explains, the specific force along the body's x and y axes stays near its own mean of the
last few tenths of a second: slopes turn slowly, and driving only does what the drive is allowed to. A wheel
that hits a curb pushes back within a few hundredths. Rough ground pushes too, but to and fro; the blow's
integral tells them apart.
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
    hold_s: float = 0.0


def step(
    config: StabilityConfig,
    state: TripState,
    along_mps2: float,
    across_mps2: float,
    driving_mps2: float,
    dt: float,
) -> TripState:
    """Take one sample of the specific force along x and y, `dt` seconds after the one before.

    `across_mps2` is without the acceleration of turning; up to `driving_mps2` along x may be the drive's.
    """
    slow, fast = min(1.0, dt / config.trip_mean_s), dt / (config.trip_blow_s + dt)
    dx, dy = along_mps2 - state.mean_x_mps2, across_mps2 - state.mean_y_mps2
    blow_x = (1.0 - fast) * (state.blow_x_mps + dx * dt)
    blow_y = (1.0 - fast) * (state.blow_y_mps + dy * dt)
    hold = max(0.0, state.hold_s - dt)
    unexplained_x = max(0.0, abs(blow_x) - driving_mps2 * config.trip_blow_s)
    if hypot(unexplained_x, blow_y) > config.trip_blow_mps:
        hold = config.trip_hold_s
    return TripState(state.mean_x_mps2 + slow * dx, state.mean_y_mps2 + slow * dy, blow_x, blow_y, hold)
