"""The builder to use: maximum likelihood over a state-space model, started by vector fitting.

Vector fitting gives every path its own residue at each shared pole: three times the states that the vehicle
has. Balanced truncation cuts those to the order, and Gauss-Newton then fits poles, B, C and D of exactly that
order to all paths at once, each response weighted by its measured variance. Poles live in blocks [[0, 1],
[-k, -g]], so that stability is k > 0 and g > 0. The inverse of the information matrix gives the intervals.
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
START_POLES = (18, 20, 16)
BRIEF = 8
RIGHT_COST = 1.15
"""Squared weighted residual per response of a model that explains everything but the noise; it is 1 on
average."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Parameters of the model, the cost sum |residual|^2 / variance and the inverse information matrix."""

    blocks: Array
    b: Array
    c: Array
    d: Array
    cost: float
    covariance: Array


def build(data: FrfData, order: int | None = None, iterations: int = 12) -> IdentifiedModel:
    """Identify a stable model; order None chooses among CANDIDATES by the Bayesian information criterion.

    Vector fitting starts with more poles than are needed, so that it catches the weak modes; where the
    residual shows that a mode was missed all the same, it starts again with another number of poles.
    """
    orders = tuple(sorted(CANDIDATES, reverse=True)) if order is None else (order,)
    residuals = int(np.isfinite(data.variance).sum())
    best: tuple[float, Fit, Array] | None = None
    for poles in START_POLES:
        full = vector_fitting.expand(data, vector_fitting.fit_poles(data, max(poles, orders[0])))
        found = _choose(data, full, orders, iterations)
        if best is None or found[0] < best[0]:
            best = found
        inside = len(orders) == 1 or 2 * len(best[1].blocks) < orders[0]
        if inside and best[1].cost <= RIGHT_COST * residuals:
            break
    assert best is not None
    return _identified(data, best[1], best[2])


def _truncate(data: FrfData, system: System, order: int) -> tuple[System, Array]:
    """Truncate with every input scaled to the same mean response, so that metres and newtons weigh the
    same."""
    a, b, c, d = system
    on = np.isfinite(data.variance)
    gain = np.sqrt(np.sum(np.abs(data.response) ** 2 * on, axis=(0, 1)) / on.sum(axis=(0, 1)))
    (a, b, c, d), hankel = balanced_truncation((a, b / gain, c, d / gain), order)
    return (a, b * gain, c, d * gain), hankel


def _choose(
    data: FrfData, full: System, orders: tuple[int, ...], iterations: int
) -> tuple[float, Fit, Array]:
    """Fit the orders from the largest down; return the best by the criterion, with its value and `full`'s
    spectrum."""
    samples = 2 * int(np.isfinite(data.variance).sum())
    outputs, inputs = data.response.shape[1:]
    best: tuple[float, Fit] | None = None
    system = full
    for order in orders:
        # A second start where the first ends in a valley of its own: from the fit above, then from vector
        # fitting.
        starts = [full] if best is None else [system, full]
        fit = refine(data, *modal_blocks(_truncate(data, starts[0], order)[0]), BRIEF)
        if best is not None and fit.cost > RIGHT_COST * samples / 2:
            other = refine(data, *modal_blocks(_truncate(data, starts[1], order)[0]), BRIEF)
            fit = min(fit, other, key=lambda f: f.cost)
        system = from_blocks(fit.blocks), fit.b, fit.c, fit.d
        parameters = order * (outputs + inputs) + outputs * inputs
        # Twice the negative log-likelihood: real and imaginary part each have half the variance.
        criterion = 2 * fit.cost + parameters * np.log(samples)
        if best is None or criterion < best[0]:
            best = criterion, fit
        elif criterion > best[0] + 10 * samples**0.5:
            break  # far worse: what is still smaller can only be worse again
    assert best is not None
    fit = best[1]
    polished = refine(data, fit.blocks, fit.b, fit.c, fit.d, iterations)
    return best[0], polished, _truncate(data, full, orders[0])[1]


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
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    # 2: information of complex residuals. The scaling of each mode is free, hence the pseudo-inverse.
    inverse = np.linalg.pinv(2 * information / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return Fit(*_unpack(x, shape), residual, inverse / np.outer(scale, scale))


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
    residual = (h - model) * weight
    rows = jacobian * weight[..., None]
    # One small product per path: real parts and imaginary parts below one another.
    by_path = np.concatenate([rows.real, rows.imag]).transpose(1, 2, 0, 3)
    target = np.concatenate([residual.real, residual.imag]).transpose(1, 2, 0)[..., None]
    turned = by_path.swapaxes(-1, -2)
    information, gradient = np.zeros((len(x), len(x))), np.zeros(len(x))
    np.add.at(information, (index[..., :, None], index[..., None, :]), turned @ by_path)
    np.add.at(gradient, index, (turned @ target)[..., 0])
    return float(np.sum(target**2)), information, gradient


def jacobian_of(
    s: ComplexArray, x: Array, shape: tuple[int, int, int]
) -> tuple[ComplexArray, NDArray[np.int64], ComplexArray]:
    """Return what dH/dx (k, outputs, inputs, 3 n + 1) is not zero, which parameters those are (outputs,
    inputs, 3 n + 1), and H (k, outputs, inputs).

    A path depends on the poles, its own column of B, its own row of C and its own entry of D.
    """
    pairs, inputs, outputs = shape
    n, lines = 2 * pairs, len(s)
    blocks, b, c, d = _unpack(x, shape)
    states = _states(s, blocks, b)
    inverse = _resolvent(s, blocks)
    read = np.einsum("opi,kpij->kopj", c.reshape(outputs, pairs, 2), inverse)  # C (s - A)^-1
    # dA = -dk e2 e1' - dg e2 e2' in each block.
    by_block = states.reshape(lines, pairs, 2, inputs)
    from_a = -np.einsum("kop,kpim->kompi", read[..., 1], by_block)
    jacobian = np.ones((lines, outputs, inputs, 3 * n + 1), dtype=complex)
    jacobian[..., :n] = from_a.reshape(lines, outputs, inputs, n)
    jacobian[..., n : 2 * n] = read.reshape(lines, outputs, 1, n)
    jacobian[..., 2 * n : 3 * n] = states.transpose(0, 2, 1)[:, None]
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
    modes, spread = [], []
    for i in np.flatnonzero(oscillates)[order]:
        local = fit.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
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
        fit.covariance,
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
        np.sqrt(np.einsum("k...i,...ij,k...j->k...", part, covariance, part, optimize=True))
        for part in (jacobian.real, jacobian.imag)
    )
    return real, imag
