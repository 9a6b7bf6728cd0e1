"""One ride controller for smooth long waves and for rough roads: two designs, blended by how rough the road
feels.

Both filters run all the time on the force that really acts, so that either may take over without a bump.
Roughness is the heave acceleration above the body modes, where long waves leave only sensor noise and a rough
road its wheel hop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.ride import PERIOD_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.control.ride import RideController

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RoughnessGauge:
    """How the road is judged: a high-pass, a mean square, and the range over which the force goes over."""

    corner_hz: float = 10.0
    memory_s: float = 0.2
    smooth_mps2: float = 0.05
    rough_mps2: float = 0.10


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledRide:
    """Controllers for long waves and for rough roads, and the gauge between them."""

    long_waves: RideController
    rough_road: RideController
    gauge: RoughnessGauge = RoughnessGauge()

    def start(self, runs: int | None = None) -> ScheduledState:
        """Return the state of a controller that knows nothing yet."""
        tail = () if runs is None else (runs,)
        states = tuple(np.zeros((len(c.model.a), *tail)) for c in (self.long_waves, self.rough_road))
        none = np.zeros(tail)
        return ScheduledState(states, np.zeros((4, *tail)), none, none)

    def step(self, state: ScheduledState, imu: Array) -> tuple[ScheduledState, Array]:
        """Take one IMU sample (3,) or (3, runs) and return the new state and the force (4,) or (4, runs)."""
        low, square = _gauge(self.gauge, state, imu[0])
        rms = np.sqrt(square)
        share = np.clip(
            (rms - self.gauge.smooth_mps2) / (self.gauge.rough_mps2 - self.gauge.smooth_mps2), 0.0, 1.0
        )
        estimates, force = [], np.zeros_like(state.force_n)
        for controller, predicted, part in zip(
            (self.long_waves, self.rough_road), state.predicted, (1 - share, share), strict=True
        ):
            model = controller.model
            innovation = imu - model.c @ predicted - model.d @ state.force_n
            estimate = predicted + controller.filter_gain @ innovation
            force = force - part * (controller.feedback @ estimate)
            estimates.append((model, estimate))
        limit = min(self.long_waves.max_force_n, self.rough_road.max_force_n)
        force = np.clip(force, -limit, limit)
        after = tuple(model.a @ estimate + model.b @ force for model, estimate in estimates)
        return ScheduledState(after, force, low, square), force


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledState:
    """Predictions of both filters, the acting force, and the gauge."""

    predicted: tuple[Array, ...]
    force_n: Array
    low_mps2: Array
    square: Array


def _gauge(gauge: RoughnessGauge, state: ScheduledState, accel: Array) -> tuple[Array, Array]:
    """Return the low-passed acceleration and the mean square of the rest."""
    follow = 1 - np.exp(-2 * np.pi * gauge.corner_hz * PERIOD_S)
    low = state.low_mps2 + follow * (accel - state.low_mps2)
    forget = PERIOD_S / gauge.memory_s
    return low, state.square + forget * ((accel - low) ** 2 - state.square)
