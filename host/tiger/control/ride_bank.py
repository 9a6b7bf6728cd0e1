"""Ride controllers side by side, each with a road of its own in mind; the one whose innovations are likeliest
steers.

Long waves that lie askew across the road meet one lane before the other. A design that is told how much later
has two thirds of the peak roll acceleration, but is useless where the lag is a fifth off. So three designs
run side by side: left lane first, right lane first, and four roads that have nothing to do with each other.
All filters run on the force that really acts, and tell within a few samples which of them is right.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.ride import PERIOD_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.control.ride import ImuNoise, RideController
    from tiger.control.ride_designs import RideTuning
    from tiger.models.full_car import FullCarParameters

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RideBank:
    """Controllers without delay, and how long the likelihood of their innovations is remembered."""

    controllers: tuple[RideController, ...]
    memory_s: float = 0.25
    whitening: Array = field(init=False)
    """What turns each controller's innovation into white noise of unit variance, (controllers, 3, 3)."""
    handicap: Array = field(init=False)
    """Half the log-determinant of each innovation covariance, (controllers,)."""

    def __post_init__(self) -> None:
        """Refuse controllers whose force acts late: a blend is formed for the sample it is measured in."""
        factors = np.stack([np.linalg.cholesky(c.innovation) for c in self.controllers])
        object.__setattr__(self, "whitening", np.linalg.inv(factors))
        diagonals = np.diagonal(factors, axis1=1, axis2=2)
        object.__setattr__(self, "handicap", np.log(diagonals).sum(axis=1))
        if any(controller.delay_samples for controller in self.controllers):
            raise ValueError("a bank needs controllers whose force acts at once (delay_samples = 0)")

    def start(self, runs: int | None = None) -> BankState:
        """Return the state of a bank that knows nothing yet: all controllers are equally likely."""
        tail = () if runs is None else (runs,)
        predicted = tuple(np.zeros((len(c.model.a), *tail)) for c in self.controllers)
        return BankState(predicted, np.zeros((4, *tail)), np.zeros((len(self.controllers), *tail)))

    def step(self, state: BankState, imu: Array) -> tuple[BankState, Array]:
        """Take one IMU sample (3,) or (3, runs) and return the new state and the force (4,) or (4, runs).

        The force is the mean of the controllers' forces, weighed by the likelihood of the innovations of each
        over the last `memory_s` (Magill 1965).
        """
        innovations = [
            imu - c.model.c @ predicted - c.model.d @ state.force_n
            for c, predicted in zip(self.controllers, state.predicted, strict=True)
        ]
        white = self.whitening @ np.stack(innovations).reshape(len(self.controllers), 3, -1)
        handicap = self.handicap.reshape(-1, *(1,) * (imu.ndim - 1))
        likelihood = -0.5 * (white * white).sum(axis=1).reshape(state.evidence.shape) - handicap
        evidence = (1 - PERIOD_S / self.memory_s) * state.evidence + likelihood
        share = shares(evidence)
        estimates = [
            predicted + c.filter_gain @ e
            for c, predicted, e in zip(self.controllers, state.predicted, innovations, strict=True)
        ]
        limit = min(c.max_force_n for c in self.controllers)
        force = -sum(
            part * (c.feedback @ x) for part, c, x in zip(share, self.controllers, estimates, strict=True)
        )
        force = np.clip(force, -limit, limit)
        after = tuple(
            c.model.a @ x + c.model.b @ force for c, x in zip(self.controllers, estimates, strict=True)
        )
        return BankState(after, force, evidence), force


@dataclass(frozen=True, slots=True, eq=False)
class BankState:
    """Predictions of all filters, the acting force, and the fading log-likelihood of each controller."""

    predicted: tuple[Array, ...]
    force_n: Array
    evidence: Array


def oblique(
    tuning: RideTuning,
    p: FullCarParameters,
    noise: ImuNoise,
    lane_lag_s: float,
    *,
    imu_offset_m: tuple[float, float] = (0.0, 0.0),
    max_force_n: float = np.inf,
) -> RideBank:
    """Design the three for waves askew: right lane `lane_lag_s` behind the left, left behind right,
    neither."""
    return RideBank(
        tuple(
            tuning.controller(p, noise, imu_offset_m=imu_offset_m, max_force_n=max_force_n, lane_lag_s=lag)
            for lag in (lane_lag_s, -lane_lag_s, None)
        )
    )


def shares(evidence: Array) -> Array:
    """Return the probability of each controller, from log-likelihoods (controllers,) or (controllers,
    runs)."""
    odds = np.exp(evidence - evidence.max(axis=0))
    return np.asarray(odds / odds.sum(axis=0))
