"""The gear on a wheel hub and the two-channel sensor over it: from wheel angle to quadrature."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

TURN = 2.0 * np.pi


class QuadratureGear:
    """A gear whose teeth are not quite equal; phase counts teeth and their fractions, continuously.

    Channel A is high over the first half of a tooth's pitch, B over the half that starts a quarter later:
    going forward A leads B.
    """

    def __init__(
        self, teeth: int = 60, pitch_error: float = 0.01, random: np.random.Generator | None = None
    ) -> None:
        """Draw the pitches with relative RMS error `pitch_error`; without a generator the gear is ideal."""
        if teeth < 1:
            raise ValueError(f"a gear has at least one tooth, not {teeth}")
        pitches = np.ones(teeth)
        if random is not None:
            # Within four sigma, so that no tooth ends before it starts.
            pitches += np.clip(
                pitch_error * random.standard_normal(teeth), -4.0 * pitch_error, 4.0 * pitch_error
            )
        if np.any(pitches <= 0.0):
            raise ValueError(
                f"a pitch error of {pitch_error} makes teeth of no length; choose less than 0.25"
            )
        pitches *= TURN / pitches.sum()
        self.teeth = teeth
        self.edges_rad = np.concatenate([[0.0], np.cumsum(pitches)])
        """Angles at which the teeth start, (teeth + 1,); the last is the full turn."""
        self.edges_rad[-1] = TURN
        self._starts: list[float] = self.edges_rad.tolist()
        self._per_rad: list[float] = (1.0 / np.diff(self.edges_rad)).tolist()

    def phase(self, angle_rad: float) -> float:
        """Return the phase at a wheel angle of any size and sign."""
        turns, angle = divmod(angle_rad, TURN)
        tooth = min(bisect_right(self._starts, angle), self.teeth) - 1
        return turns * self.teeth + tooth + (angle - self._starts[tooth]) * self._per_rad[tooth]

    def phases(self, angle_rad: ArrayLike) -> Array:
        """Return the phase at each angle."""
        turns, angle = np.divmod(np.asarray(angle_rad, dtype=float), TURN)
        return np.asarray(turns * self.teeth + np.interp(angle, self.edges_rad, np.arange(self.teeth + 1.0)))

    @staticmethod
    def count(phase: ArrayLike) -> NDArray[np.int64]:
        """Return the quadrature count (four per tooth) at each phase."""
        return np.floor(4.0 * np.asarray(phase, dtype=float)).astype(np.int64)

    @staticmethod
    def levels(phase: float) -> tuple[bool, bool]:
        """Return channels (A, B) at a phase."""
        quarter = int(np.floor(4.0 * phase)) % 4
        return quarter in (0, 1), quarter in (1, 2)
