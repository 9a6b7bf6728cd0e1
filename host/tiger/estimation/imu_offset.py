"""Where is the IMU? Find its horizontal offset from the centre of mass in the innovations of the ride filter.

An offset (x, y) adds -x theta'' + y phi'' to the measured heave acceleration (6.7, small angles). A filter
that assumes the wrong offset leaves that in its innovations. They are linear in the offset, so a batch of
data gives log-likelihoods whose maximum Gauss-Newton finds in a few filter runs; the wheel delay is searched
with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from tiger.control import ride
from tiger.control.ride import RoadPrior
from tiger.estimation.kalman import steady_state_gain
from tiger.frozen import dataclass

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tiger.control.ride import ImuNoise
    from tiger.models.full_car import FullCarParameters

    Array = NDArray[np.float64]


ROUGH_ROAD = RoadPrior(noise=0.0225, leak_radps=0.05, bandwidth_radps=100.0)
LONG_WAVES = RoadPrior(noise=0.1, leak_radps=0.02, bandwidth_radps=2.5, lane_correlation=0.5)


_LEAST_MOTION = 3.0
"""Pitch and roll rate must exceed the gyros' noise by this factor to say anything about a lever arm."""


@dataclass(frozen=True, slots=True)
class OffsetEstimate:
    """Offset of the IMU from the centre of mass, its standard deviation, and the preview delay that goes with
    it."""

    x_m: float
    y_m: float
    x_std_m: float
    y_std_m: float
    preview_s: float | None
    log_likelihood: float


def innovations(model: ride.RideModel, noise: ImuNoise, imu: Array, force_n: Array) -> tuple[Array, Array]:
    """Run the steady-state filter over imu (steps, 3) and the force acting after each sample (steps, 4).

    Returns the innovations (steps, 3) and their covariance (3, 3).
    """
    filtered = steady_state_gain(model.a, model.c, model.process, noise.covariance())
    carry = model.a - model.a @ filtered.gain @ model.c
    correct = model.a @ filtered.gain
    x, acting = np.zeros(len(model.a)), np.zeros(4)
    out = np.empty_like(imu)
    for k, (sample, force) in enumerate(zip(imu, force_n, strict=True)):
        through = model.d @ acting
        out[k] = sample - model.c @ x - through
        x = carry @ x + correct @ (sample - through) + model.b @ force
        acting = force
    return out, filtered.innovation


def log_likelihood(
    p: FullCarParameters,
    prior: RoadPrior,
    noise: ImuNoise,
    imu: Array,
    force_n: Array,
    offset_m: tuple[float, float],
    preview_s: float | None,
) -> float:
    """Return the log-likelihood of a batch whose innovations have an unknown covariance.

    With that covariance maximised out it is -steps/2 log det of the sample's, the prediction-error criterion
    (Ljung 1999, eq. 7.95): a road that is rougher or smoother than the prior does not pull at the offset.
    """
    model = ride.ride_model(p, prior, preview_s, offset_m)
    error, _ = innovations(model, noise, imu, force_n)
    return float(-0.5 * len(error) * np.linalg.slogdet(error.T @ error / len(error))[1])


def estimate(
    p: FullCarParameters,
    noise: ImuNoise,
    imu: Array,
    force_n: Array | None = None,
    *,
    preview_s: Sequence[float | None],
    priors: Sequence[RoadPrior] = (ROUGH_ROAD, LONG_WAVES),
    start_m: tuple[float, float] = (0.0, 0.0),
) -> OffsetEstimate:
    """Return the most likely offset over the candidate delays from front to rear wheel and the candidate
    roads.

    imu (steps, 3) are measurements at the controller's period, force_n (steps, 4) the force acting after each
    one (None: passive). Without a delay (None) the offset is barely observable. Raises ValueError where no
    candidate determines it (no pitch or no roll motion).
    """
    forces = np.zeros((len(imu), 4)) if force_n is None else force_n
    moves = (imu[:, 1:].std(axis=0) > _LEAST_MOTION * noise.rate_radps).all()
    best: OffsetEstimate | None = None
    for delay in preview_s if moves else ():
        for prior in priors:
            found = _climb(p, prior, noise, imu, forces, delay, np.array(start_m))
            if found is not None and (best is None or found.log_likelihood > best.log_likelihood):
                best = found
    if best is None:
        raise ValueError(
            "the data do not determine the IMU offset: "
            "record more pitch and roll, at least a few seconds of rough road"
        )
    return best


def _climb(
    p: FullCarParameters,
    prior: RoadPrior,
    noise: ImuNoise,
    imu: Array,
    force_n: Array,
    preview_s: float | None,
    start: Array,
) -> OffsetEstimate | None:
    """Maximise over the offset by Newton steps on a quadratic through a small cross of points; None: no
    peak."""
    reach = 0.5 * np.array([p.wheelbase_m, 2 * p.half_track_m])
    scale = 1.0 / len(imu)

    def cost(x: Array) -> float:
        offset = (float(x[0]), float(x[1]))
        return -scale * log_likelihood(p, prior, noise, imu, force_n, offset, preview_s)

    solved = minimize(
        cost,
        start,
        method="L-BFGS-B",
        bounds=[(-reach[0], reach[0]), (-reach[1], reach[1])],
        options={"eps": 1e-4, "maxiter": 30, "ftol": 1e-9},
    )
    x, value = solved.x, float(solved.fun) / scale
    width = 0.005
    east, west = cost(x + np.array([width, 0])), cost(x - np.array([width, 0]))
    north, south = cost(x + np.array([0, width])), cost(x - np.array([0, width]))
    corner, centre = cost(x + width), float(solved.fun)
    mixed = corner - east - north + centre
    hessian = np.array([[east - 2 * centre + west, mixed], [mixed, north - 2 * centre + south]])
    hessian /= scale * width**2
    if np.linalg.eigvalsh(hessian).min() <= 0:
        return None
    spread = np.sqrt(np.diag(np.linalg.inv(hessian)))
    if (spread > 0.2 * reach).any():
        return None
    return OffsetEstimate(float(x[0]), float(x[1]), float(spread[0]), float(spread[1]), preview_s, -value)
