"""Common-pole vector fitting: all paths share one set of poles, as Remark 6.1 says they must.

Relaxed vector fitting (Gustavsen and Semlyen 1999; Gustavsen 2006) with the fast QR of Deschrijver et al.
(2008), in Tustin's plane and weighted by the standard deviation of every response.
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


def build(data: FrfData, order: int = 14, poles: int | None = None, iterations: int = 12) -> IdentifiedModel:
    """Fit `poles` (default: `order`) shared poles to all paths and reduce to `order` states."""
    full = expand(data, fit_poles(data, poles or order, iterations))
    (a, b, c, d), hankel = balanced_truncation(full, order)
    return IdentifiedModel(a, b, c, d, data.sample_s, hankel, modes(np.linalg.eigvals(a)))


def fit_poles(data: FrfData, count: int, iterations: int = 12) -> ComplexArray:
    """Return `count` stable poles (rad/s) that all paths share; complex ones as neighbours p, p*."""
    s = 1j * data.warped_radps()
    magnitude = np.geomspace(np.abs(s[0]), 0.6 * np.abs(s[-1]), count // 2)
    poles = np.column_stack([-0.02 + 1j, -0.02 - 1j] * magnitude[:, None]).ravel()
    if count % 2:
        poles = np.append(poles, -magnitude[-1])
    h, w = _paths(data)
    for _ in range(iterations):
        poles = _relocate(s, h, w, poles)
    return poles


def _paths(data: FrfData) -> tuple[ComplexArray, Array]:
    lines = len(data.frequency_hz)
    return data.response.reshape(lines, -1), data.weight().reshape(lines, -1)


def _basis(s: ComplexArray, poles: ComplexArray) -> ComplexArray:
    """Return the partial fractions with real coefficients, (k, n): complex pairs give their sum and
    difference."""
    fractions = 1 / (s[:, None] - poles)
    basis = fractions.copy()
    i = 0
    while i < len(poles):
        if abs(poles[i].imag) > 0:
            basis[:, i] = fractions[:, i] + fractions[:, i + 1]
            basis[:, i + 1] = 1j * (fractions[:, i] - fractions[:, i + 1])
            i += 2
        else:
            i += 1
    return basis


def _relocate(s: ComplexArray, h: ComplexArray, w: Array, poles: ComplexArray) -> ComplexArray:
    """Move the poles to the zeros of the fitted sigma(s) = 1 x d + sum c / (s - p)."""
    n = len(poles)
    basis = _basis(s, poles)
    numerator = np.hstack([basis, np.ones((len(s), 1))])
    reduced, target = [], []
    for path in range(h.shape[1]):
        use = w[:, path] > 0
        weight = w[use, path, None]
        left = numerator[use] * weight
        right = -numerator[use] * h[use, path, None] * weight
        rows = np.hstack([left, right])
        r = np.asarray(np.linalg.qr(np.vstack([rows.real, rows.imag]), mode="r"))
        reduced.append(r[n + 1 :, n + 1 :])
        target.append(np.zeros(len(r) - n - 1))
    # Relaxation: the mean real part of sigma over the lines is held at one instead of its constant.
    scale = np.sqrt(np.sum(np.abs(h * w) ** 2)) / len(s)
    reduced.append(scale * numerator.real.sum(axis=0)[None])
    target.append(np.array([scale * len(s)]))
    rows, aim = np.vstack(reduced), np.concatenate(target)
    norm = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / norm, aim, rcond=None)[0] / norm
    c, constant = solution[:n], solution[n]
    if abs(constant) < 1e-8:
        constant = np.copysign(1e-8, constant)
    a, b = _real_dynamics(poles)
    return _sorted_stable(np.linalg.eigvals(a - np.outer(b, c) / constant))


def _real_dynamics(poles: ComplexArray) -> tuple[Array, Array]:
    """Return A, b with c (s - A)^-1 b = basis @ c for the real coefficients of `_basis`."""
    blocks, b = [], []
    i = 0
    while i < len(poles):
        p = poles[i]
        if abs(p.imag) > 0:
            blocks.append(np.array([[p.real, p.imag], [-p.imag, p.real]]))
            b += [2.0, 0.0]
            i += 2
        else:
            blocks.append(np.array([[p.real]]))
            b.append(1.0)
            i += 1
    return block_diag(*blocks), np.array(b)


def _sorted_stable(poles: ComplexArray) -> ComplexArray:
    """Reflect what is unstable and put pairs side by side, positive imaginary part first."""
    poles = -np.abs(poles.real) + 1j * poles.imag
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    real = poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)].real
    pairs = np.column_stack([upper, upper.conj()]).ravel()
    return np.concatenate([pairs, real.astype(complex)])


def expand(data: FrfData, poles: ComplexArray) -> tuple[Array, Array, Array, Array]:
    """Fit residues and the direct term of all paths for given poles: a system with a copy of the poles per
    output.

    (With fewer outputs than inputs, that is the smaller realisation.)
    """
    s = 1j * data.warped_radps()
    h, w = _paths(data)
    outputs, inputs = data.response.shape[1:]
    numerator = np.hstack([_basis(s, poles), np.ones((len(s), 1))])
    n = len(poles)
    coefficients = np.zeros((n + 1, outputs * inputs))
    for path in range(h.shape[1]):
        use = w[:, path] > 0
        rows = numerator[use] * w[use, path, None]
        aim = h[use, path] * w[use, path]
        stacked = np.vstack([rows.real, rows.imag])
        norm = np.linalg.norm(stacked, axis=0)
        solved = np.linalg.lstsq(stacked / norm, np.r_[aim.real, aim.imag], rcond=None)[0]
        coefficients[:, path] = solved / norm
    by_path = coefficients.reshape(n + 1, outputs, inputs)
    dynamics, excite = _real_dynamics(poles)
    # Observer form per output: A' carries the basis, B the coefficients, C reads the basis.
    a = np.asarray(np.kron(np.eye(outputs), dynamics.T), dtype=np.float64)
    b = np.vstack([by_path[:n, i] for i in range(outputs)])
    c = np.asarray(np.kron(np.eye(outputs), excite[None]), dtype=np.float64)
    return a, b, c, by_path[n]
