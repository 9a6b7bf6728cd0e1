"""The builder to use: maximum likelihood over a state-space model, started by vector fitting.

Vector fitting gives every path its own residue at each shared pole: three times the states that the vehicle
has. Balanced truncation cuts those to a few more than are needed, and Gauss-Newton fits poles, B, C and D to
all paths at once, each response weighted by its measured variance. Then the mode that is missed least is
taken away, again and again: of two modes of nearly the same frequency truncation would lose one. Poles live
in blocks [[0, 1], [-k, -g]], so that stability is k > 0 and g > 0. The inverse of the information matrix
gives the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.estimation.identification import vector_fitting
from tiger.estimation.identification.model import IdentifiedModel
from tiger.estimation.identification.reduction import balanced_truncation, from_blocks, modal_blocks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tiger.estimation.identification.frf import FrfData
    from tiger.estimation.identification.reduction import System

    Array = NDArray[np.float64]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]

CANDIDATES = (8, 10, 12, 14, 16)
SPARE = 2
"""States more than the largest order wanted, with which the fit begins."""
START_POLES = (18, 20, 16, 22)
TRIAL, BRIEF, THOROUGH = 3, 12, 60
"""Iterations to judge a mode by its absence, to settle between orders, and to finish."""
SPREAD_LIMIT = 3.0
"""Standard deviations of the cost above its mean at which a start counts as failed."""
SAME = 1e-3
"""Relative difference below which two starts have found the same fit."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Parameters of the model, the cost sum |residual|^2 / variance and the information matrix J'J."""

    blocks: Array
    b: Array
    c: Array
    d: Array
    cost: float
    information: Array

    def covariance(self) -> Array:
        """Return the covariance of the parameters, in the order of `_pack`."""
        scale = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        # 2: information of complex residuals. The scaling of each mode is free, hence the pseudo-inverse.
        scaled = 2 * self.information / np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) / np.outer(scale, scale))


def build(data: FrfData, order: int | None = None, iterations: int = THOROUGH) -> IdentifiedModel:
    """Identify a stable model; order None chooses among CANDIDATES by the Bayesian information criterion.

    Where the residual is larger than the measured variances explain, a mode may have been missed, and the
    fit starts again from another number of poles, until the noise explains it or two starts agree.
    """
    orders = CANDIDATES if order is None else (order,)
    best: tuple[float, Fit, Array] | None = None
    for poles in START_POLES:
        found = _descend(data, max(poles, max(orders) + SPARE), orders, iterations)
        confirmed = best is not None and abs(found[0] - best[0]) <= SAME * abs(best[0])
        if best is None or found[0] < best[0]:
            best = found
        inside = len(orders) == 1 or 2 * len(best[1].blocks) < max(orders)
        if confirmed or (inside and best[1].cost <= _explained(data, 2 * len(best[1].blocks))):
            break
    assert best is not None
    return _identified(data, best[1], best[2])


def _parameters(data: FrfData, order: int) -> int:
    """Return the number of parameters that a model of `order` has, its choice of states apart."""
    outputs, inputs = int(data.response.shape[1]), int(data.response.shape[2])
    return order * (outputs + inputs) + outputs * inputs


def _explained(data: FrfData, order: int) -> float:
    """Return the cost up to which noise alone may have made it: that of as many complex normal residuals."""
    residuals = int(np.isfinite(data.variance).sum())
    return residuals - 0.5 * _parameters(data, order) + SPREAD_LIMIT * float(np.sqrt(residuals))


def _truncate(data: FrfData, system: System, order: int) -> tuple[System, Array]:
    """Truncate with every input scaled to the same mean response, so that metres and newtons weigh the
    same."""
    a, b, c, d = system
    on = np.isfinite(data.variance)
    gain = np.sqrt(np.sum(np.abs(data.response) ** 2 * on, axis=(0, 1)) / on.sum(axis=(0, 1)))
    (a, b, c, d), hankel = balanced_truncation((a, b / gain, c, d / gain), order)
    return (a, b * gain, c, d * gain), hankel


def _descend(data: FrfData, poles: int, orders: tuple[int, ...], iterations: int) -> tuple[float, Fit, Array]:
    """Start from a vector fit and take away one mode at a time; return the best of `orders` by the criterion,
    with its value and the Hankel singular values of the start."""
    samples = 2 * int(np.isfinite(data.variance).sum())
    full = vector_fitting.expand(data, vector_fitting.fit_poles(data, poles))
    start, hankel = _truncate(data, full, max(orders) + SPARE)
    fit = refine(data, *modal_blocks(start), BRIEF)
    best: tuple[float, Fit] | None = None
    for order in range(2 * len(fit.blocks) - 2, min(orders) - 1, -2):
        fit = _without_weakest_mode(data, fit)
        if order not in orders:
            continue
        # Twice the negative log-likelihood: real and imaginary part each have half the variance.
        criterion = 2 * fit.cost + _parameters(data, order) * np.log(samples)
        if best is None or criterion < best[0]:
            best = criterion, fit
        elif criterion > best[0] + 10 * samples**0.5:
            break  # far worse: what is still smaller can only be worse again
    assert best is not None
    chosen = best[1]
    polished = refine(data, chosen.blocks, chosen.b, chosen.c, chosen.d, iterations)
    return best[0] - 2 * (chosen.cost - polished.cost), polished, hankel


def _without_weakest_mode(data: FrfData, fit: Fit) -> Fit:
    """Leave each mode out in turn, and keep the fit that recovers best."""
    trials = []
    for i in range(len(fit.blocks)):
        states = [2 * i, 2 * i + 1]
        b, c = np.delete(fit.b, states, axis=0), np.delete(fit.c, states, axis=1)
        trials.append(refine(data, np.delete(fit.blocks, i, axis=0), b, c, fit.d, TRIAL))
    best = min(trials, key=lambda trial: trial.cost)
    return refine(data, best.blocks, best.b, best.c, best.d, BRIEF)


def refine(data: FrfData, blocks: Array, b: Array, c: Array, d: Array, iterations: int) -> Fit:
    """Run Levenberg-Marquardt from the given blocks; a step that is unstable or worse is shortened."""
    s = 1j * data.warped_radps()
    weight = data.weight()
    x = _pack(blocks, b, c, d)
    shape = (len(blocks), b.shape[1], c.shape[0])
    residual, information, gradient = _normal_equations(s, data.response, weight, x, shape)
    damping = 1e-6
    for _ in range(iterations):
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information / np.outer(scale, scale)
        improved = False
        for _ in range(8):
            step = np.linalg.solve(scaled + damping * np.eye(len(x)), gradient / scale) / scale
            trial = x + step
            if np.all(trial[: 2 * shape[0]] > 0):
                cost = _cost(s, data.response, weight, trial, shape)
                if cost < residual:
                    improved = True
                    break
            damping = max(10 * damping, 1e-6)
        if not improved:
            break
        decrease = (residual - cost) / residual
        x, damping = trial, max(0.1 * damping, 1e-9)
        residual, information, gradient = _normal_equations(s, data.response, weight, x, shape)
        if decrease < 1e-7:
            break
    return Fit(*_unpack(x, shape), residual, information)


def _pack(blocks: Array, b: Array, c: Array, d: Array) -> Array:
    return np.concatenate([blocks.ravel(), b.ravel(), c.ravel(), d.ravel()])


def _unpack(x: Array, shape: tuple[int, int, int]) -> tuple[Array, Array, Array, Array]:
    pairs, inputs, outputs = shape
    n = 2 * pairs
    ends = np.cumsum([n, n * inputs, outputs * n])
    blocks, b, c, d = np.split(x, ends)
    return blocks.reshape(pairs, 2), b.reshape(n, inputs), c.reshape(outputs, n), d.reshape(outputs, inputs)


def _resolvent(s: ComplexArray, blocks: Array) -> ComplexArray:
    """Return (s - A)^-1 of every block, (k, pairs, 2, 2): [[s + g, 1], [-k, s]] / (s^2 + g s + k)."""
    k, g = blocks.T
    determinant = s[:, None] ** 2 + g * s[:, None] + k
    inverse = np.empty((len(s), len(blocks), 2, 2), dtype=complex)
    inverse[..., 0, 0] = s[:, None] + g
    inverse[..., 0, 1] = 1.0
    inverse[..., 1, 0] = -k
    inverse[..., 1, 1] = s[:, None]
    return np.asarray(inverse / determinant[..., None, None])


def _states(s: ComplexArray, blocks: Array, b: Array) -> ComplexArray:
    """Return X = (s - A)^-1 B, (k, n, inputs)."""
    inverse = _resolvent(s, blocks)
    split = b.reshape(len(blocks), 2, -1)
    return np.asarray(np.einsum("kpij,pjm->kpim", inverse, split)).reshape(len(s), -1, b.shape[1])


def _cost(s: ComplexArray, h: ComplexArray, weight: Array, x: Array, shape: tuple[int, int, int]) -> float:
    blocks, b, c, d = _unpack(x, shape)
    return float(np.sum(np.abs((h - c @ _states(s, blocks, b) - d) * weight) ** 2))


def _normal_equations(
    s: ComplexArray, h: ComplexArray, weight: Array, x: Array, shape: tuple[int, int, int]
) -> tuple[float, Array, Array]:
    """Return the cost, J'J and J'r of the weighted residual, J = dH / dx."""
    jacobian, index, model = jacobian_of(s, x, shape)
    residual = np.ascontiguousarray(((h - model) * weight).transpose(1, 2, 0))
    jacobian *= weight.transpose(1, 2, 0)[:, :, None]
    # Real and imaginary parts lie side by side along the lines, so that every path is one small real product.
    rows, target = jacobian.view(float), residual.view(float)
    size = len(x)
    products = rows @ rows.swapaxes(-1, -2)
    pairs = index[..., :, None] * size + index[..., None, :]
    information = _sums(pairs, products, size * size).reshape(size, size)
    return float(np.sum(target**2)), information, _sums(index, rows @ target[..., None], size)


def _sums(index: NDArray[np.int64], values: Array, size: int) -> Array:
    """Add up the values that share an index, shape (size,)."""
    return np.asarray(np.bincount(index.ravel(), values.ravel(), size), dtype=np.float64)


def jacobian_of(
    s: ComplexArray, x: Array, shape: tuple[int, int, int]
) -> tuple[ComplexArray, NDArray[np.int64], ComplexArray]:
    """Return what dH/dx (outputs, inputs, 3 n + 1, k) is not zero, which parameters those are (outputs,
    inputs, 3 n + 1), and H (k, outputs, inputs).

    A path depends on the poles, its own column of B, its own row of C and its own entry of D.
    """
    pairs, inputs, outputs = shape
    n, lines = 2 * pairs, len(s)
    blocks, b, c, d = _unpack(x, shape)
    states = _states(s, blocks, b)
    inverse = _resolvent(s, blocks)
    read = np.einsum("opi,kpij->opjk", c.reshape(outputs, pairs, 2), inverse)  # C (s - A)^-1
    # dA = -dk e2 e1' - dg e2 e2' in each block.
    by_block = states.reshape(lines, pairs, 2, inputs).transpose(3, 1, 2, 0)
    from_a = -read[:, None, :, 1, None] * by_block
    jacobian = np.empty((outputs, inputs, 3 * n + 1, lines), dtype=complex)
    jacobian[:, :, :n] = from_a.reshape(outputs, inputs, n, lines)
    jacobian[:, :, n : 2 * n] = read.reshape(outputs, 1, n, lines)
    jacobian[:, :, 2 * n : 3 * n] = states.transpose(2, 1, 0)
    jacobian[:, :, 3 * n] = 1.0
    at_b, at_c, at_d = n, n + n * inputs, n + n * (inputs + outputs)
    i, j, state = np.ogrid[:outputs, :inputs, :n]
    index = np.empty((outputs, inputs, 3 * n + 1), dtype=np.int64)
    index[..., :n] = state
    index[..., n : 2 * n] = at_b + state * inputs + j
    index[..., 2 * n : 3 * n] = at_c + i * n + state
    index[..., 3 * n] = at_d + (i * inputs + j)[..., 0]
    return jacobian, index, c @ states + d


def _identified(data: FrfData, fit: Fit, hankel: Array) -> IdentifiedModel:
    blocks, a = fit.blocks, from_blocks(fit.blocks)
    k, g = blocks.T
    oscillates = g**2 < 4 * k
    order = np.argsort(k[oscillates])
    frequency = np.sqrt(k) / (2 * np.pi)
    damping = g / (2 * np.sqrt(k))
    covariance = fit.covariance()
    modes, spread = [], []
    for i in np.flatnonzero(oscillates)[order]:
        local = covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        to_frequency = np.array([frequency[i] / (2 * k[i]), 0.0])
        to_damping = np.array([-damping[i] / (2 * k[i]), 1 / (2 * np.sqrt(k[i]))])
        modes.append([frequency[i], damping[i]])
        spread.append([np.sqrt(v @ local @ v) for v in (to_frequency, to_damping)])
    return IdentifiedModel(
        a,
        fit.b,
        fit.c,
        fit.d,
        data.sample_s,
        hankel,
        np.array(modes),
        np.array(spread),
        covariance,
    )


def response_std(model: IdentifiedModel, frequency_hz: Sequence[float] | Array) -> tuple[Array, Array]:
    """Return the standard deviations of real and imaginary part of the model's responses, (k, outputs,
    inputs) each."""
    if model.parameter_covariance is None:
        raise ValueError("this model carries no parameter covariance: build it by maximum likelihood")
    s = 2j / model.sample_s * np.tan(np.pi * np.asarray(frequency_hz) * model.sample_s)
    blocks = np.column_stack([-model.a[1::2, ::2].diagonal(), -model.a[1::2, 1::2].diagonal()])
    shape = (len(blocks), model.b.shape[1], model.c.shape[0])
    jacobian, index, _ = jacobian_of(s, _pack(blocks, model.b, model.c, model.d), shape)
    covariance = model.parameter_covariance[index[..., :, None], index[..., None, :]]
    real, imag = (
        np.sqrt(np.sum(part * (covariance @ part), axis=2)).transpose(2, 0, 1)
        for part in (jacobian.real, jacobian.imag)
    )
    return real, imag
