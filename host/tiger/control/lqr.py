"""Discrete linear-quadratic regulator with the cross term that accelerations and tyre loads need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm, solve_discrete_are

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Regulator:
    """State feedback u = -gain @ x, its cost-to-go x' cost x, and the closed-loop matrix A - B gain."""

    gain: Array
    cost: Array
    closed_loop: Array


def dlqr(a: Array, b: Array, q: Array, r: Array, n: Array | None = None) -> Regulator:
    """Minimise sum x'Q x + u'R u + 2 x'N u for x[k+1] = A x + B u.

    a (n, n), b (n, m), q (n, n), r (m, m), n (n, m) or None. G = (R + B'PB)^-1 (B'PA + N'), where (6.25)
    prints R^-1 for R. Raises ValueError where no stabilising solution exists.
    """
    cross = np.zeros_like(b) if n is None else n
    try:
        cost = solve_discrete_are(a, b, q, r, s=cross)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(
            f"no stabilising regulator for {a.shape[0]} states and {b.shape[1]} inputs ({error}): "
            "a weighted mode on the stability limit is out of the inputs' reach, or R is not positive"
        ) from error
    gain = np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a + cross.T)
    return Regulator(gain, cost, a - b @ gain)


def output_weights(c: Array, d: Array, output: Array, r: Array) -> tuple[Array, Array, Array]:
    """Turn the cost y'M y + u'R u on outputs y = C x + D u into (Q, R, N) for `dlqr`.

    output M is (p, p) or its diagonal (p,). Q = C'MC, R + D'MD, N = C'MD; (6.26) leaves the cross term out.
    """
    m = np.diag(output) if output.ndim == 1 else output
    q = c.T @ m @ c
    return 0.5 * (q + q.T), r + d.T @ m @ d, c.T @ m @ d


def sampled_cost(
    a: Array, b: Array, q: Array, r: Array, n: Array, period_s: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Sample x' = A x + B u AND its running cost x'Q x + u'R u + 2 x'N u over a held input (Van Loan 1978).

    Returns (A_d, B_d, Q_d, R_d, N_d): the cost between the samples is counted, which matters where a wheel
    mode is fast against the period.
    """
    states, inputs = b.shape
    size = states + inputs
    flow, cost = np.zeros((size, size)), np.zeros((size, size))
    flow[:states, :states], flow[:states, states:] = a, b
    cost[:states, :states], cost[states:, states:] = q, r
    cost[:states, states:], cost[states:, :states] = n, n.T
    block = np.zeros((2 * size, 2 * size))
    block[:size, :size], block[:size, size:], block[size:, size:] = -flow.T, cost, flow
    power = expm(block * period_s)
    transition = power[size:, size:]
    total = transition.T @ power[:size, size:]
    total = 0.5 * (total + total.T)
    return (
        transition[:states, :states],
        transition[:states, states:],
        total[:states, :states],
        total[states:, states:],
        total[:states, states:],
    )
