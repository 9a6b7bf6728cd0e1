"""What every builder returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.models.linear import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedModel:
    """A stable model of `order` states in Tustin's continuous plane, and the Hankel singular values it was
    cut by.

    `sample_s` is the period of the record: `discrete()` is the model as identified. Evaluated at the warped
    frequency 2/T tan(w T/2), the continuous matrices give exactly the response of the discrete ones.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    sample_s: float
    hankel: Array
    modes: Array
    """(frequency_hz, damping ratio) of each oscillating mode, slowest first."""
    mode_std: Array | None = None
    """Standard deviations of `modes`; None where the builder estimates none."""
    parameter_covariance: Array | None = None
    """Covariance of the parameters of a maximum-likelihood model (`maximum_likelihood.response_std` uses
    it)."""

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.a)

    def response(self, frequency_hz: Array) -> NDArray[np.complexfloating[Any, Any]]:
        """Return the response of the discrete model at each frequency, shape (k, outputs, inputs)."""
        s = 2j / self.sample_s * np.tan(np.pi * np.asarray(frequency_hz) * self.sample_s)
        resolvent = s[:, None, None] * np.eye(len(self.a)) - self.a
        inner = np.linalg.solve(resolvent, np.broadcast_to(self.b, (len(s), *self.b.shape)))
        return np.asarray(self.c @ inner + self.d, dtype=np.complex128)

    def discrete(self, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
        """Return the sampled model with names for its inputs and outputs."""
        states = tuple(f"state_{i}" for i in range(len(self.a)))
        continuous = LinearModel(self.a, self.b, self.c, self.d, states, inputs, outputs)
        return continuous.discretise(self.sample_s, "tustin")


def fit_percent(estimate: ComplexArray, truth: ComplexArray) -> Array:
    """Return 100 (1 - |H - H0| / |H0|) of every path over the frequencies (axis 0), (outputs, inputs)."""
    error = np.linalg.norm(estimate - truth, axis=0)
    return np.asarray(100 * (1 - error / np.linalg.norm(truth, axis=0)))
