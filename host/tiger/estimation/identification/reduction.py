"""Balanced truncation by Hankel singular values (section 6.3), with the Gramians the text means, and modal
form."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov, svd

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    System = tuple[Array, Array, Array, Array]


def _root(gramian: Array) -> Array:
    """Return a factor R with R R' = gramian, tolerant of round-off."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def gramian_roots(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """Return factors of the controllability and observability Gramians of a stable continuous system."""
    control = solve_continuous_lyapunov(a, -b @ b.T)
    observe = solve_continuous_lyapunov(a.T, -c.T @ c)
    return _root(control), _root(observe)


def hankel_singular_values(a: Array, b: Array, c: Array) -> Array:
    """Return the Hankel singular values, largest first, shape (n,)."""
    control, observe = gramian_roots(a, b, c)
    return np.asarray(svd(observe.T @ control, compute_uv=False))


def balanced_truncation(system: System, order: int) -> tuple[System, Array]:
    """Keep the `order` strongest states of a stable continuous system; return it and all Hankel singular
    values."""
    a, b, c, d = system
    control, observe = gramian_roots(a, b, c)
    left, values, right = svd(observe.T @ control)
    scale = 1 / np.sqrt(values[:order])
    into = control @ right[:order].T * scale
    out = (observe @ left[:, :order] * scale).T
    return (out @ a @ into, out @ b, c @ into, d), values


def modal_blocks(system: System) -> tuple[Array, Array, Array, Array]:
    """Bring a system of even order to blocks [[0, 1], [-k, -g]].

    Returns (block (n/2, 2) of (k, g), B (n, m), C (p, n), D). A block is stable exactly when k > 0 and g > 0;
    it is smooth where a pair of poles turns real. Raises ValueError for an odd order or defective poles.
    """
    a, b, c, d = system
    n = len(a)
    if n % 2:
        raise ValueError(f"modal blocks need an even order, not {n}")
    poles, vectors = np.linalg.eig(a)
    is_real = np.abs(poles.imag) < 1e-9 * np.abs(poles)
    real = np.flatnonzero(is_real)[np.argsort(poles[is_real].real)]
    upper = np.flatnonzero(~is_real & (poles.imag > 0))
    pairs = [(i, int(np.argmin(np.abs(poles - poles[i].conj())))) for i in upper]
    pairs += list(zip(real[::2], real[1::2], strict=True))
    blocks, transform = np.zeros((n // 2, 2)), np.zeros((n, n))
    for row, pair in enumerate(pairs):
        i, j = int(pair[0]), int(pair[1])
        p, q = poles[i], poles[j]
        blocks[row] = (p * q).real, -(p + q).real
        companion_vectors = np.array([[1, 1], [p, q]])
        transform[:, 2 * row : 2 * row + 2] = (vectors[:, [i, j]] @ np.linalg.inv(companion_vectors)).real
    return blocks, np.asarray(np.linalg.solve(transform, b), dtype=np.float64), c @ transform, d


def from_blocks(blocks: Array) -> Array:
    """Build A (n, n) from the (k, g) of its blocks."""
    return np.asarray(block_diag(*(np.array([[0.0, 1.0], [-k, -g]]) for k, g in blocks)))
