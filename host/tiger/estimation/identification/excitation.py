"""Signals that excite a vehicle for identification: the dissertation's filtered noise, and multisines.

A multisine repeats, so its response has no leakage; it fills chosen lines only, so the empty ones show the
noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Multisine:
    """One period of each input and the lines it fills.

    signal (period, inputs); lines (k,) are DFT bins of one period; excited (k, inputs) says who fills which
    line.
    """

    signal: Array
    lines: NDArray[np.int64]
    excited: NDArray[np.bool_]
    sample_s: float

    @property
    def frequency_hz(self) -> Array:
        """Frequency of each line, shape (k,)."""
        return np.asarray(self.lines / (len(self.signal) * self.sample_s))

    def record(self, periods: int) -> Array:
        """Repeat the period, shape (periods * period, inputs)."""
        return np.tile(self.signal, (periods, 1))


def multisine(
    amplitude: Array,
    seed: int = 0,
    *,
    period_samples: int = 4096,
    sample_s: float = 0.005,
    band_hz: tuple[float, float] = (0.15, 62.0),
    relative_spacing: float = 0.02,
    simultaneous: bool = True,
) -> Multisine:
    """Design a multisine for every input; `amplitude` (inputs,) is the peak of each, m or N.

    Lines lie `relative_spacing` x frequency apart (at least one bin), each with power in proportion to its
    spacing, so that the density is flat. simultaneous: input j takes every line j modulo inputs (orthogonal:
    all inputs at once); otherwise every input takes all lines, to be used one input at a time.
    """
    inputs = len(amplitude)
    bin_hz = 1 / (period_samples * sample_s)
    low, high = band_hz
    if not bin_hz <= low < high < 0.5 / sample_s:
        raise ValueError(
            f"the band {low} to {high} Hz must lie between one bin ({bin_hz:.3g} Hz) and the Nyquist "
            f"frequency ({0.5 / sample_s:.4g} Hz): lengthen the period or lower the band"
        )
    lines: list[int] = []
    next_line = low / bin_hz
    while next_line * bin_hz <= high:
        lines.append(round(next_line))
        # Two bins at least, so that every neighbourhood keeps an empty bin that shows the noise.
        next_line = lines[-1] + max(2.0, relative_spacing * lines[-1] / (inputs if simultaneous else 1))
    bins = np.array(lines)
    power = np.gradient(bins.astype(float))
    excited = np.ones((len(bins), inputs), dtype=bool)
    if simultaneous:
        excited = (np.arange(len(bins))[:, None] % inputs) == np.arange(inputs)
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((period_samples // 2 + 1, inputs), dtype=complex)
    phase = rng.uniform(0, 2 * np.pi, excited.shape)
    spectrum[bins] = np.sqrt(power)[:, None] * np.exp(1j * phase) * excited
    signal = np.fft.irfft(spectrum, period_samples, axis=0)
    signal *= np.asarray(amplitude) / np.abs(signal).max(axis=0)
    return Multisine(signal, bins, excited, sample_s)


def filtered_noise(samples: int, amplitude: float, seed: int = 0, *, as_printed: bool = False) -> Array:
    """Return white noise through L(q) of section 6.3, scaled to the peak `amplitude`, shape (samples,).

    The printed denominator (pi-2)/pi z^-1 - 2/pi gives a gain of -7.3 at zero frequency and inverts the
    signal; corrected it is (pi-2)/pi z^-1 + (pi+2)/pi. With its break at the Nyquist frequency it does not
    limit the band.
    """
    white = np.random.default_rng(seed).standard_normal(samples)
    leading = -2 / np.pi if as_printed else (np.pi + 2) / np.pi
    denominator = np.array([leading, (np.pi - 2) / np.pi])
    if as_printed:  # its pole lies at z = 0.571 only because |pi - 2| < 2
        denominator = -denominator
    signal = lfilter([1.0, 1.0], denominator, white)
    return np.asarray(signal * amplitude / np.abs(signal).max())
