"""A linear time-invariant model whose states, inputs and outputs have names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.linalg import expm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """x' = A x + B u, y = C x + D u (or x[k+1] = ... where `period_s` is set), with a name for every row and
    column.

    A name ends in its unit (`pitch_rate_radps`). Shapes: a (n, n), b (n, m), c (p, n), d (p, m).
    """

    a: Array
    b: Array
    c: Array
    d: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period_s: float | None = None

    def __post_init__(self) -> None:
        n, m, p = len(self.states), len(self.inputs), len(self.outputs)
        for name, matrix, shape in (
            ("a", self.a, (n, n)),
            ("b", self.b, (n, m)),
            ("c", self.c, (p, n)),
            ("d", self.d, (p, m)),
        ):
            if matrix.shape != shape:
                raise ValueError(f"matrix {name} is {matrix.shape}, but its names make it {shape}")

    def select(
        self, *, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> LinearModel:
        """Keep the named inputs and outputs, in the order given. Raises KeyError naming what is unknown."""
        into = self.inputs if inputs is None else tuple(inputs)
        out = self.outputs if outputs is None else tuple(outputs)
        columns = _positions(into, self.inputs, "input")
        rows = _positions(out, self.outputs, "output")
        return LinearModel(
            self.a,
            self.b[:, columns],
            self.c[rows],
            self.d[np.ix_(rows, columns)],
            self.states,
            into,
            out,
            self.period_s,
        )

    def discretise(self, period_s: float, method: Literal["zoh", "foh", "tustin"] = "zoh") -> LinearModel:
        """Sample the continuous model every `period_s` seconds.

        zoh: exact for inputs held over a period (forces from a computer); the output is read at the start of
        the period. foh: exact for inputs that are straight between samples (a road). tustin: (6.10), s = 2/T
        (z-1)/(z+1), which makes D nonzero even where the continuous D is zero.
        """
        if self.period_s is not None:
            raise ValueError(f"the model is already sampled every {self.period_s} s")
        if period_s <= 0:
            raise ValueError(f"the sampling period must be positive, not {period_s} s")
        n, m = self.b.shape
        a: Array
        b: Array
        c: Array
        d: Array
        if method == "tustin":
            half = 0.5 * period_s
            inverse = np.linalg.inv(np.eye(n) - half * self.a)
            a = inverse @ (np.eye(n) + half * self.a)
            b = inverse @ self.b * period_s
            c = self.c @ inverse
            d = self.d + half * self.c @ inverse @ self.b
        elif method in ("zoh", "foh"):
            block = np.zeros((n + 2 * m, n + 2 * m))
            block[:n, :n] = self.a * period_s
            block[:n, n : n + m] = self.b * period_s
            block[n : n + m, n + m :] = np.eye(m)
            power = expm(block)
            a, held, ramped = power[:n, :n], power[:n, n : n + m], power[:n, n + m :]
            c = self.c
            if method == "zoh":
                b, d = held, self.d
            else:  # state shifted by the ramp term, so that only u[k] appears
                b = held + a @ ramped - ramped
                d = self.d + self.c @ ramped
        else:
            raise ValueError(f"unknown method {method!r}: use zoh, foh or tustin")
        return LinearModel(a, b, c, d, self.states, self.inputs, self.outputs, period_s)

    def poles(self) -> NDArray[np.complex128]:
        """Return the eigenvalues of A (1/s, or z-plane where the model is sampled), shape (n,)."""
        return np.linalg.eigvals(self.a).astype(np.complex128)

    def frequency_response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Return H at each frequency, shape (len(frequency_hz), p, m)."""
        omega = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
        point = omega if self.period_s is None else np.exp(omega * self.period_s)
        n = self.a.shape[0]
        resolvent = point[:, None, None] * np.eye(n) - self.a
        response = self.c @ np.linalg.solve(resolvent, np.broadcast_to(self.b, (len(omega), *self.b.shape)))
        return np.asarray(response + self.d, dtype=np.complex128)

    def static_gain(self) -> Array:
        """Return the gain at zero frequency, shape (p, m)."""
        if self.period_s is None:
            return np.asarray(self.d - self.c @ np.linalg.solve(self.a, self.b))
        identity = np.eye(self.a.shape[0])
        return np.asarray(self.d + self.c @ np.linalg.solve(identity - self.a, self.b))

    def simulate(self, u: Array, x0: Array | None = None) -> tuple[Array, Array]:
        """Run a sampled model over inputs `u` (steps, m) and return (outputs (steps, p), states (steps,
        n))."""
        if self.period_s is None:
            raise ValueError("sample the model with discretise() before simulating it")
        u = np.asarray(u, dtype=float)
        driven = u @ self.b.T
        x = np.zeros(self.a.shape[0]) if x0 is None else np.asarray(x0, dtype=float)
        states = np.empty((len(u), len(x)))
        for k, drive in enumerate(driven):
            states[k] = x
            x = self.a @ x + drive
        return states @ self.c.T + u @ self.d.T, states


def modes(poles: NDArray[np.inexact[Any]]) -> Array:
    """Return (frequency_hz, damping ratio) of each continuous complex pole pair, shape (pairs, 2), slowest
    first."""
    upper = poles[poles.imag > 0]
    table = np.column_stack([np.abs(upper) / (2 * np.pi), -upper.real / np.abs(upper)])
    return np.asarray(table[np.argsort(table[:, 0])])


def _positions(wanted: Sequence[str], known: tuple[str, ...], kind: str) -> list[int]:
    missing = [name for name in wanted if name not in known]
    if missing:
        raise KeyError(f"no {kind} {', '.join(missing)}; the model has {', '.join(known)}")
    return [known.index(name) for name in wanted]
