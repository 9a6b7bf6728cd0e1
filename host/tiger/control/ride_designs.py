"""Weights of the chapter 6 ride controllers, and the schedule that chooses among them.

Found by `bench/tune_ride.py` for the car of Table 6.1, trained on noise and road seeds 1000 and up. Gains are
designed from the vehicle's own numbers every time; only these weights are constants. The first three are
tuned to one road each and are fragile for it, as `tiger study monte-carlo` shows; ROBUST is the one for a
vehicle that is not known well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.ride import ImuNoise, RideController, RideWeights, RoadPrior, design, ride_model

if TYPE_CHECKING:
    from tiger.models.full_car import FullCarParameters


@dataclass(frozen=True, slots=True)
class RideTuning:
    """Weights of the regulator and the road that the filter believes in."""

    weights: RideWeights
    prior: RoadPrior

    def controller(
        self,
        p: FullCarParameters,
        noise: ImuNoise,
        preview_s: float | None = None,
        imu_offset_m: tuple[float, float] = (0.0, 0.0),
        delay_samples: int = 0,
        max_force_n: float = np.inf,
    ) -> RideController:
        """Design the controller for a vehicle: see `ride.ride_model` and `ride.design`."""
        model = ride_model(p, self.prior, preview_s, imu_offset_m)
        return design(model, self.weights, noise, delay_samples, max_force_n)

    def with_suspension(self, factor: float) -> RideTuning:
        """Return the tuning with `factor` times the weight on suspension travel, to keep to the rattle
        space."""
        weights = replace(
            self.weights,
            suspension_front=self.weights.suspension_front * factor,
            suspension_rear=self.weights.suspension_rear * factor,
        )
        return replace(self, weights=weights)


BUMPY_PREVIEW_TACTICAL = RideTuning(
    RideWeights(
        pitch_accel=0.406235,
        roll_accel=6.75256,
        heave_rate=0.383929,
        pitch_rate=0.869946,
        roll_rate=0.0144835,
        suspension_front=5.92954,
        suspension_rear=3.73441,
        tire_front=0.760063,
        tire_rear=1.34803,
        force=4.48671e-11,
    ),
    RoadPrior(noise=0.112325, leak_radps=0.00366546, bandwidth_radps=2.03071, lane_correlation=0.0960332),
)
"""Bumpy road, wheelbase preview, IMU of 0.03 x the nominal noise: the rows of Table 6.2."""


BUMPY_PREVIEW = RideTuning(
    RideWeights(
        pitch_accel=0.482854,
        roll_accel=13.8154,
        heave_rate=0.159475,
        pitch_rate=1.31206,
        roll_rate=0.0172946,
        suspension_front=6.792,
        suspension_rear=3.93696,
        tire_front=0.778293,
        tire_rear=1.3214,
        force=6.25058e-11,
    ),
    RoadPrior(noise=0.0825567, leak_radps=0.00289022, bandwidth_radps=2.2335, lane_correlation=0.0937208),
)
"""Bumpy road, wheelbase preview, IMU of 0.1 x the nominal noise."""


BUMPY_PLAIN = RideTuning(
    RideWeights(
        pitch_accel=0.535088,
        roll_accel=39.3823,
        heave_rate=1.52269,
        pitch_rate=0.901059,
        roll_rate=0.0780877,
        suspension_front=2.96756,
        suspension_rear=1.98547,
        tire_front=3.00039,
        tire_rear=17.1343,
        force=1.50985e-10,
    ),
    RoadPrior(noise=0.124418, leak_radps=0.00650915, bandwidth_radps=1.54105, lane_correlation=0.6563),
)
"""Bumpy road without preview, nominal IMU."""


ISO_PREVIEW = RideTuning(
    RideWeights(
        pitch_accel=1.53948,
        roll_accel=1.01514,
        heave_rate=2.16881,
        pitch_rate=2.6346,
        roll_rate=10.3658,
        suspension_front=81.2522,
        suspension_rear=11.7739,
        tire_front=4939.3,
        tire_rear=1563.72,
        force=1.84992e-09,
    ),
    RoadPrior(noise=0.0412939, leak_radps=0.11759, bandwidth_radps=171.6, lane_correlation=0.310794),
)
"""ISO class C, wheelbase preview, nominal IMU: comfort, rear tyre loads may grow as in Table 6.2."""


HOLDING_PLAIN = RideTuning(
    RideWeights(
        pitch_accel=0.00126746,
        roll_accel=0.775865,
        heave_rate=1.44781e-06,
        pitch_rate=808.326,
        roll_rate=0.0169475,
        suspension_front=0.535962,
        suspension_rear=3209.73,
        tire_front=5.46984,
        tire_rear=0.950627,
        force=2.57844e-07,
    ),
    RoadPrior(noise=0.0297633, leak_radps=16.6105, bandwidth_radps=1560.71, lane_correlation=0.00305645),
)
"""ISO class C without preview, nominal IMU: no tyre load above the passive one."""


HOLDING_PREVIEW = RideTuning(
    RideWeights(
        pitch_accel=1.33328,
        roll_accel=0.93937,
        heave_rate=0.681653,
        pitch_rate=0.796723,
        roll_rate=6.46529,
        suspension_front=45.5182,
        suspension_rear=7.01432,
        tire_front=6703.69,
        tire_rear=7370.96,
        force=6.82342e-10,
    ),
    RoadPrior(noise=0.033383, leak_radps=0.142324, bandwidth_radps=261.593, lane_correlation=0.0639603),
)
"""ISO class C, wheelbase preview, nominal IMU: front tyre loads kept, rear ones a quarter below."""


ROBUST = RideTuning(
    RideWeights(
        pitch_accel=0.000990821,
        roll_accel=1.1638,
        heave_rate=3.19449e-06,
        pitch_rate=738.747,
        roll_rate=0.0287189,
        suspension_front=0.818186,
        suspension_rear=4446.8,
        tire_front=6.88697,
        tire_rear=0.414238,
        force=3.34627e-07,
    ),
    RoadPrior(noise=0.0311955, leak_radps=15.9375, bandwidth_radps=2898.72, lane_correlation=0.00110673),
)
"""ISO class C without preview, nominal IMU, force one period late: for a vehicle that is not known well."""


ISO_PLAIN = HOLDING_PLAIN
"""Without preview the design for comfort is no better than the one that keeps the tyre loads."""


def for_bumpy_road(noise_factor: float, preview: bool) -> RideTuning:
    """Return the tuning for the bumpy road that was found for the nearest IMU noise."""
    if not preview:
        return BUMPY_PLAIN
    return BUMPY_PREVIEW_TACTICAL if noise_factor < 0.055 else BUMPY_PREVIEW
