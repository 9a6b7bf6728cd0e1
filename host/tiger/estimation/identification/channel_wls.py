"""The dissertation's builder: each path by its own weighted least squares, then one balanced truncation.

(6.16)-(6.19) with the errors of the text mended: the fit is a rational function, its residual is taken in the
frequency domain, and there the coherence weights it. What remains is the method's own: the linear (Levy)
residual favours high frequencies and is biased by noise, and 24 paths have 24 sets of poles, so that no
Hankel singular value marks the order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag

from tiger.estimation.identification.model import IdentifiedModel
from tiger.estimation.identification.reduction import balanced_truncation
from tiger.models.linear import modes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.estimation.identification.frf import FrfData

    Array = NDArray[np.float64]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]


def build(data: FrfData, order: int = 14, path_order: int = 14) -> IdentifiedModel:
    """Fit every path with `path_order` poles, reflect unstable ones, and reduce the sum to `order` states."""
    outputs, inputs = data.response.shape[1:]
    s = 1j * data.warped_radps()
    scale = float(np.abs(s).max())
    blocks: list[Array] = []
    b_rows: list[Array] = []
    c_columns: list[Array] = []
    d = np.zeros((outputs, inputs))
    for i in range(outputs):
        for j in range(inputs):
            use = np.isfinite(data.variance[:, i, j])
            numerator, denominator = _levy(
                s[use] / scale, data.response[use, i, j], data.coherence[use, i, j], path_order
            )
            poles = np.roots(denominator).astype(complex)
            residues = np.asarray(np.polyval(numerator, poles) / np.polyval(np.polyder(denominator), poles))
            poles = np.where(poles.real >= -1e-6, -np.abs(poles.real) - 1e-6 + 1j * poles.imag, poles)
            dynamics, excite, read = _real_form(poles * scale, residues * scale)
            d[i, j] = numerator[0] / denominator[0]
            blocks.append(dynamics)
            b_rows.append(np.outer(excite, np.eye(inputs)[j]))
            c_columns.append(np.outer(np.eye(outputs)[i], read))
    full = block_diag(*blocks), np.vstack(b_rows), np.hstack(c_columns), d
    reduced, hankel = balanced_truncation(full, order)
    return IdentifiedModel(*reduced, data.sample_s, hankel, modes(np.linalg.eigvals(reduced[0])))


def path_poles(data: FrfData, path_order: int = 14) -> ComplexArray:
    """Return the poles of all separate fits in Tustin's plane, rad/s, before any is reflected (Figure
    6.7)."""
    s = 1j * data.warped_radps()
    scale = float(np.abs(s).max())
    found = []
    for i, j in np.ndindex(data.response.shape[1:]):
        use = np.isfinite(data.variance[:, i, j])
        _, denominator = _levy(
            s[use] / scale, data.response[use, i, j], data.coherence[use, i, j], path_order
        )
        found.append(np.roots(denominator).astype(complex) * scale)
    return np.concatenate(found)


def _levy(s: ComplexArray, h: ComplexArray, weight: Array, order: int) -> tuple[Array, Array]:
    """Minimise sum weight |b(s) - h a(s)|^2 with a monic, in the powers of a normalised s."""
    powers = s[:, None] ** np.arange(order, -1, -1)
    w = np.sqrt(weight)[:, None]
    complex_rows = np.hstack([powers, -h[:, None] * powers[:, 1:]]) * w
    target = h * powers[:, 0] * w[:, 0]
    rows = np.vstack([complex_rows.real, complex_rows.imag])
    norm = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / norm, np.r_[target.real, target.imag], rcond=None)[0] / norm
    return solution[: order + 1], np.r_[1.0, solution[order + 1 :]]


def _real_form(poles: NDArray[Any], residues: NDArray[Any]) -> tuple[Array, Array, Array]:
    """Realise sum residue / (s - pole) with real matrices, one block per pole pair."""
    a_blocks, b, c = [], [], []
    for p, r in zip(poles, residues, strict=True):
        if abs(p.imag) < 1e-9 * abs(p):
            a_blocks.append(np.array([[p.real]]))
            b.append([1.0])
            c.append([r.real])
        elif p.imag > 0:
            a_blocks.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
            b.append([2.0, 0.0])
            c.append([r.real, r.imag])
    return block_diag(*a_blocks), np.concatenate(b), np.concatenate(c)
