"""The stroke potentiometer of a linear actuator, read ratiometrically by a 10-bit converter."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ADC_COUNTS = 1024


@dataclass(frozen=True, slots=True)
class Potentiometer:
    """Wiper voltage against stroke. Chosen values: the wiper uses the middle 90 % of the supply."""

    stroke_max_mm: float
    supply_v: float = 5.0
    volts_at_zero_stroke: float = 0.25
    volts_at_full_stroke: float = 4.75
    noise_v: float = 0.002
    nonlinearity: float = 0.0
    """Greatest deviation from the straight line, as a share of the stroke (one sine over the stroke)."""

    def volts(self, stroke_mm: ArrayLike, random: np.random.Generator | None = None) -> Array:
        """Return the wiper voltage at each stroke, with noise when a generator is given, within 0..supply."""
        share = np.asarray(stroke_mm, dtype=float) / self.stroke_max_mm
        if self.nonlinearity:
            share = share + self.nonlinearity * np.sin(2.0 * np.pi * share)
        volts = self.volts_at_zero_stroke + (self.volts_at_full_stroke - self.volts_at_zero_stroke) * share
        if random is not None:
            volts = volts + self.noise_v * random.standard_normal(np.shape(volts))
        return np.asarray(np.minimum(np.maximum(volts, 0.0), self.supply_v))

    def exact_counts(self, stroke_mm: float) -> float:
        """Return the converter's input at one stroke in counts, with fractions and without noise."""
        share = stroke_mm / self.stroke_max_mm
        if self.nonlinearity:
            share += self.nonlinearity * sin(2.0 * pi * share)
        span = self.volts_at_full_stroke - self.volts_at_zero_stroke
        return (self.volts_at_zero_stroke + span * share) / self.supply_v * ADC_COUNTS

    @property
    def noise_counts(self) -> float:
        """Noise of one conversion, root mean square."""
        return self.noise_v / self.supply_v * ADC_COUNTS

    def counts(self, volts: ArrayLike) -> NDArray[np.int64]:
        """Return what the converter makes of each voltage: 0..1023, the supply being its reference."""
        counts = np.floor(np.asarray(volts, dtype=float) / self.supply_v * ADC_COUNTS).astype(np.int64)
        return np.minimum(np.maximum(counts, 0), ADC_COUNTS - 1)

    def stroke_mm(self, counts: ArrayLike) -> Array:
        """Return the stroke at the middle of each count (inverse of a straight potentiometer)."""
        volts = (np.asarray(counts, dtype=float) + 0.5) / ADC_COUNTS * self.supply_v
        span = self.volts_at_full_stroke - self.volts_at_zero_stroke
        return np.asarray((volts - self.volts_at_zero_stroke) / span * self.stroke_max_mm)
