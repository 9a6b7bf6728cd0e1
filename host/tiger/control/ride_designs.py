"""Weights of the chapter 6 ride controllers, and the schedule that chooses among them.

Found by `scripts/tune_ride.py` for the car of Table 6.1, trained on noise and road seeds ≥ 1000. Gains are
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


FRONT_SHARE = 1.07


@dataclass(frozen=True, slots=True)
class RideTuning:
    """Weights of the regulator and the road that the filter believes in."""

    weights: RideWeights
    prior: RoadPrior
    accel_noise_factor: float = 1.0
    rate_noise_factor: float = 1.0
    """How much worse than it is the filter takes the IMU to be: what lowers the loop's gain for an unsure
    vehicle."""

    def controller(
        self,
        p: FullCarParameters,
        noise: ImuNoise,
        preview_s: float | None = None,
        imu_offset_m: tuple[float, float] = (0.0, 0.0),
        delay_samples: int = 0,
        max_force_n: float = np.inf,
        lane_lag_s: float | None = None,
    ) -> RideController:
        """Design the controller for a vehicle: see `ride.ride_model` and `ride.design`."""
        model = ride_model(p, self.prior, preview_s, imu_offset_m, lane_lag_s=lane_lag_s)
        assumed = ImuNoise(
            noise.accel_mps2 * self.accel_noise_factor, noise.rate_radps * self.rate_noise_factor
        )
        return design(model, self.weights, assumed, delay_samples, max_force_n)

    def with_suspension(self, factor: float) -> RideTuning:
        """Return the tuning with `factor` times the weight on suspension travel, to keep to the rattle space.

        The front gets a little more, which levels the loads of the two rear tyres.
        """
        weights = replace(
            self.weights,
            suspension_front=self.weights.suspension_front * factor**FRONT_SHARE,
            suspension_rear=self.weights.suspension_rear * factor,
        )
        return replace(self, weights=weights)


BUMPY_PREVIEW_TACTICAL = RideTuning(
    RideWeights(
        pitch_accel=0.383729,
        roll_accel=7.13916,
        heave_rate=0.376513,
        pitch_rate=0.923004,
        roll_rate=0.0138464,
        suspension_front=6.04792,
        suspension_rear=3.78599,
        tire_front=0.689813,
        tire_rear=1.22279,
        force=4.5215e-11,
    ),
    RoadPrior(noise=0.0696527, leak_radps=0.00358414, bandwidth_radps=2.04243, lane_correlation=0.0918259),
)
"""Bumpy road, wheelbase preview, IMU of 0.03 x the nominal noise: the rows of Table 6.2.

The prior's noise is 0.7 x what the tuning gave, which took the last of 120 noise seeds below the printed peak
roll.
"""


BUMPY_PREVIEW = RideTuning(
    RideWeights(
        pitch_accel=0.491033,
        roll_accel=14.9288,
        heave_rate=0.14816,
        pitch_rate=1.37497,
        roll_rate=0.0174475,
        suspension_front=6.75861,
        suspension_rear=3.79941,
        tire_front=0.776904,
        tire_rear=1.41343,
        force=5.99295e-11,
    ),
    RoadPrior(noise=0.0755815, leak_radps=0.00284354, bandwidth_radps=2.17169, lane_correlation=0.0975661),
)
"""Bumpy road, wheelbase preview, IMU of 0.1 x the nominal noise."""


BUMPY_PLAIN = RideTuning(
    RideWeights(
        pitch_accel=2.67698,
        roll_accel=15.0825,
        heave_rate=0.0622168,
        pitch_rate=2.54483,
        roll_rate=0.0641307,
        suspension_front=9.60636,
        suspension_rear=6.72462,
        tire_front=0.407304,
        tire_rear=3.73357,
        force=1.54304e-10,
    ),
    RoadPrior(
        noise=0.162096,
        leak_radps=0.00322489,
        bandwidth_radps=4.99044,
        axle_correlation=0.606594,
        damping=0.102429,
    ),
    accel_noise_factor=1.19369,
    rate_noise_factor=1.32459,
)
"""Bumpy road without preview, nominal IMU: for `ride_bank.oblique`, and alone for four separate roads."""


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
        pitch_accel=1.38568,
        roll_accel=0.767556,
        heave_rate=0.876253,
        pitch_rate=0.88094,
        roll_rate=1.03511,
        suspension_front=182.076,
        suspension_rear=17.9566,
        tire_front=8964.98,
        tire_rear=10732.4,
        force=5.964e-10,
    ),
    RoadPrior(noise=0.0308727, leak_radps=5.25088, bandwidth_radps=261.443, lane_correlation=0.0547095),
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
        pitch_accel=2.11868,
        roll_accel=0.897112,
        heave_rate=2.39999,
        pitch_rate=0.0664511,
        roll_rate=16.1585,
        suspension_front=1382.45,
        suspension_rear=35.3694,
        tire_front=10009.3,
        tire_rear=10322.9,
        force=1.08836e-09,
    ),
    RoadPrior(noise=0.0533337, leak_radps=12.357, bandwidth_radps=130.687, lane_correlation=0.0142146),
    accel_noise_factor=8.32555,
    rate_noise_factor=4.89289,
)
"""ISO class C without preview, nominal IMU, force one period late: for a vehicle that is not known well.

The suspension weights are twice what the tuning gave: under one point of comfort for a third less travel, so
that the roughest of thousands of roads keep the rattle space.
"""


ISO_PLAIN = HOLDING_PLAIN
"""Without preview the design for comfort is no better than the one that keeps the tyre loads."""


def for_bumpy_road(noise_factor: float, preview: bool) -> RideTuning:
    """Return the tuning for the bumpy road that was found for the nearest IMU noise."""
    if not preview:
        return BUMPY_PLAIN
    return BUMPY_PREVIEW_TACTICAL if noise_factor < 0.055 else BUMPY_PREVIEW
