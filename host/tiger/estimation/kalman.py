"""Discrete Kalman filter in its two halves, update and predict, as pure functions.

The model is x[k+1] = A x[k] + B u[k] + w[k], y[k] = C x[k] + D u[k] + v[k] with cov w = W, cov v = V, cov(w,
v) = N. Gains are in filter form, P C' S^-1: they correct the state of the present sample. `control.dlqe`
returns the predictor form A P C' S^-1, which corrects the next one. (6.22)-(6.25) print neither; see
docs/chapter6.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_discrete_are

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


_RESIDUAL = 1e-9
"""Of the Riccati equation, relative to its solution, above which a solution is not trusted."""


@dataclass(frozen=True, slots=True, eq=False)
class SteadyStateGain:
    """Gain (n, p), error covariance before (n, n) and after (n, n) the update, and innovation covariance (p,
    p)."""

    gain: Array
    prior: Array
    posterior: Array
    innovation: Array


def steady_state_gain(
    a: Array, c: Array, process: Array, measurement: Array, cross: Array | None = None
) -> SteadyStateGain:
    """Solve the filter Riccati equation for the constant gain L = P C' (C P C' + V)^-1.

    a (n, n), c (p, n), process W (n, n), measurement V (p, p), cross N (n, p) or None.
    With a cross term the correction of the state is still L times the innovation; the prediction must add
    N S^-1 times the innovation (see `predictor_gain`). Raises ValueError where no stabilising solution
    exists.
    """
    try:
        prior = _doubling(a, c, process, measurement) if cross is None else None
        if prior is None:
            prior = solve_discrete_are(a.T, c.T, process, measurement, s=cross)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(
            f"no stable Kalman filter for {a.shape[0]} states and {c.shape[0]} measurements ({error}): "
            "a mode on the stability limit is not observable, or no noise drives it"
        ) from error
    innovation = c @ prior @ c.T + measurement
    gain: Array = np.asarray(np.linalg.solve(innovation, c @ prior).T, dtype=np.float64)
    posterior = prior - gain @ innovation @ gain.T
    return SteadyStateGain(gain, prior, 0.5 * (posterior + posterior.T), innovation)


def _doubling(a: Array, c: Array, process: Array, measurement: Array) -> Array | None:
    """Solve the filter Riccati equation by structure-preserving doubling (Chu, Fan, Lin and Wang 2004).

    Ten times faster than `solve_discrete_are` on the hundred states of a wheelbase delay line, and as
    accurate where it settles. None where it does not: little noise and a road offset that is hardly
    observable.
    """
    identity = np.eye(len(a))
    transition, gain, covariance = a.T.copy(), c.T @ np.linalg.solve(measurement, c), process.copy()
    for _ in range(60):
        solved = np.linalg.solve(identity + gain @ covariance, np.hstack([transition, gain]))
        by_transition, by_gain = solved[:, : len(a)], solved[:, len(a) :]
        increment = transition.T @ covariance @ by_transition
        gain = gain + transition @ by_gain @ transition.T
        transition = transition @ by_transition
        covariance = covariance + increment
        covariance, gain = 0.5 * (covariance + covariance.T), 0.5 * (gain + gain.T)
        if not np.isfinite(covariance).all():
            break
        if np.abs(increment).max() <= 1e-10 * np.abs(covariance).max():
            innovation = c @ covariance @ c.T + measurement
            seen = np.linalg.solve(innovation, c @ covariance)
            filtered = covariance - (c @ covariance).T @ seen
            residual = a @ filtered @ a.T + process - covariance
            return covariance if np.abs(residual).max() <= _RESIDUAL * np.abs(covariance).max() else None
    return None


def predictor_gain(a: Array, filtered: SteadyStateGain, cross: Array | None = None) -> Array:
    """Return (A P C' + N) S^-1, the gain of the one-step predictor (`control.dlqe`), shape (n, p)."""
    gain = a @ filtered.gain
    if cross is not None:
        gain = gain + np.linalg.solve(filtered.innovation, cross.T).T
    return gain


def predict(a: Array, b: Array, x: Array, u: Array, covariance: Array, process: Array) -> tuple[Array, Array]:
    """Carry the estimate x (n,) and its covariance (n, n) over one sample with input u (m,)."""
    return a @ x + b @ u, a @ covariance @ a.T + process


def update(
    x: Array, covariance: Array, innovation: Array, c: Array, measurement: Array
) -> tuple[Array, Array]:
    """Correct x (n,) and its covariance with the innovation y - C x - D u (p,), in Joseph's form (stays
    symmetric)."""
    s = c @ covariance @ c.T + measurement
    gain = np.linalg.solve(s, c @ covariance).T
    keep = np.eye(len(x)) - gain @ c
    return x + gain @ innovation, keep @ covariance @ keep.T + gain @ measurement @ gain.T


def log_likelihood(innovation: Array, covariance: Array) -> float:
    """Return the Gaussian log-likelihood of one innovation (p,) with covariance (p, p)."""
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (log_determinant + innovation @ np.linalg.solve(covariance, innovation)))
