"""Model-predictive ride control: the regulator of `ride`, with limits on force, force rate and suspension
travel.

The filter is the same. The force is the regulator's plus a correction c, planned over a horizon: since the
regulator is optimal, its cost-to-go makes the price of the corrections exactly sum c'(R + B'PB) c. The
quadratic program therefore has a constant, well-conditioned Hessian and no gradient, and c = 0 wherever no
limit is in sight. DAQP solves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.lqr import output_weights
from tiger.control.ride import REGULATED, RideController, RideState, regulate
from tiger.models.full_car import SUSPENSION

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.control.ride import RideWeights

    Array = NDArray[np.float64]

_SOFT = 8  # DAQP's flag of a constraint that may be broken at a price
# Units of the program, chosen so that its numbers are near one.
_N_PER_KN = 1000.0
_M_PER_UNIT = 0.01


@dataclass(frozen=True, slots=True)
class Limits:
    """What the actuators and the rattle space allow. Travel is a soft limit: the road may make it
    impossible."""

    force_n: float
    force_rate_nps: float
    suspension_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RideMpc:
    """A condensed program over `blocks` corrections in kN, the first held one period, the others longer.

    hessian (4 blocks, 4 blocks); forces, travel and rates: each a pair (rows, 4 blocks), (rows, n) that maps
    corrections and estimated state to the limited quantity.
    """

    controller: RideController
    limits: Limits
    hessian: Array
    forces: tuple[Array, Array]
    travel: tuple[Array, Array]
    rates: tuple[Array, Array]
    periods: Array
    """Periods between one limited rate and the one before, (rows of rates,)."""

    def start(self, runs: int | None = None) -> RideState:
        """Return the state of a controller that knows nothing yet. Runs are not taken side by side."""
        if runs not in (None, 1):
            raise ValueError("the predictive controller drives one run at a time")
        return self.controller.start(runs)

    def step(self, state: RideState, imu: Array) -> tuple[RideState, Array]:
        """Take one IMU sample (3,) or (3, 1) and return the new state and the force."""
        model = self.controller.model
        innovation = imu - model.c @ state.predicted - model.d @ state.acting_n
        estimate = state.predicted + self.controller.filter_gain @ innovation
        force = self.solve(estimate.reshape(-1), state.acting_n.reshape(-1)).reshape(state.acting_n.shape)
        return RideState(model.a @ estimate + model.b @ force, force, force), force

    def solve(self, estimate: Array, before_n: Array) -> Array:
        """Return the force to apply now (4,), for the estimated state (n,) and the force applied before (4,).

        Raises RuntimeError where the solver finds no solution; travel is soft, so that only a solver fault
        can.
        """
        import daqp

        regulator = -self.controller.feedback @ estimate
        force, travel, rate = (free @ estimate for _, free in (self.forces, self.travel, self.rates))
        rate[:4] -= before_n / _N_PER_KN
        most = self.limits.force_n / _N_PER_KN
        step = self.limits.force_rate_nps / _N_PER_KN * self.controller.model.period_s * self.periods
        reach = self.limits.suspension_m / _M_PER_UNIT
        upper = np.concatenate([most - force, step - rate, reach - travel])
        lower = np.concatenate([-most - force, -step - rate, -reach - travel])
        if (upper >= 0).all() and (lower <= 0).all():
            return regulator  # the regulator meets every limit over the horizon: no correction is better
        sense = np.zeros(len(upper), dtype=np.int32)
        sense[-len(travel) :] = _SOFT
        solution, _, flag, _ = daqp.solve(
            self.hessian, np.zeros(len(self.hessian)), self._rows(), upper, lower, sense
        )
        if flag < 1:
            raise RuntimeError(f"the ride program has no solution (DAQP code {flag}): widen the limits")
        limit = self.limits.force_n
        return np.asarray(np.clip(regulator + _N_PER_KN * solution[:4], -limit, limit))

    def _rows(self) -> Array:
        return np.vstack([self.forces[0], self.rates[0], self.travel[0]])


def design(
    controller: RideController, weights: RideWeights, limits: Limits, blocks: int = 5, hold: int = 6
) -> RideMpc:
    """Condense the program for a ride controller without delay; limits are checked at the start of each
    block."""
    if controller.delay_samples:
        raise ValueError("the predictive controller needs a force that acts at once (delay_samples = 0)")
    model, gain = controller.model, controller.feedback
    n, count = len(model.a), 4 * blocks
    cost = regulate(model, weights).cost
    _, r, _ = output_weights(model.h, model.j, weights.of_outputs(), np.eye(4) * weights.force)
    price = r + model.b.T @ cost @ model.b
    price = price / np.trace(price)
    sizes = [1] + [hold] * (blocks - 1)
    suspension = [REGULATED.index(name) for name in SUSPENSION]
    closed = model.a - model.b @ gain

    from_state, from_moves = np.eye(n), np.zeros((n, count))
    hessian = np.zeros((count, count))
    forces: list[tuple[Array, Array]] = []
    travel: list[tuple[Array, Array]] = []
    for block, periods in enumerate(sizes):
        move = np.zeros((4, count))
        move[:, 4 * block : 4 * block + 4] = np.eye(4)
        hessian += periods * move.T @ price @ move
        forces.append((move - gain @ from_moves / _N_PER_KN, -gain @ from_state / _N_PER_KN))
        for _ in range(periods):
            from_moves = closed @ from_moves + _N_PER_KN * model.b @ move
            from_state = closed @ from_state
        seen = model.h[suspension]
        travel.append((seen @ from_moves / _M_PER_UNIT, seen @ from_state / _M_PER_UNIT))
    force_rows, force_free = (np.vstack([pair[i] for pair in forces]) for i in (0, 1))
    change = np.eye(count) - np.eye(count, k=-4)
    return RideMpc(
        controller,
        limits,
        hessian,
        (force_rows, force_free),
        (np.vstack([pair[0] for pair in travel]), np.vstack([pair[1] for pair in travel])),
        (change @ force_rows, change @ force_free),
        np.repeat([1, *sizes[:-1]], 4).astype(float),
    )
