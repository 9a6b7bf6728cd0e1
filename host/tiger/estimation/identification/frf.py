"""Frequency responses of all paths with their variances: from periodic records, and by Welch's method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from tiger.estimation.identification.excitation import Multisine

    Array = NDArray[np.float64]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class FrfData:
    """Measured responses.

    response (k, outputs, inputs), variance of each as a complex number (same shape; infinite where the path
    was not excited at that line), coherence (same shape, NaN where unknown).
    """

    frequency_hz: Array
    response: ComplexArray
    variance: Array
    coherence: Array
    sample_s: float

    def warped_radps(self) -> Array:
        """Return 2/T tan(w T/2): the continuous frequency that Tustin's rule (6.10) maps on each line, shape
        (k,)."""
        return np.asarray(2 / self.sample_s * np.tan(np.pi * self.frequency_hz * self.sample_s))

    def weight(self) -> Array:
        """Return 1 / standard deviation, zero for unexcited paths, (k, outputs, inputs)."""
        return np.asarray(1 / np.sqrt(self.variance))


def noise_at_rest(imu: Array) -> tuple[Array, Array]:
    """Return bias and standard deviation of each output from a record at rest (samples, outputs), section
    6.3."""
    return imu.mean(axis=0), imu.std(axis=0, ddof=1)


def differentiate_rates(data: FrfData, outputs: Sequence[int]) -> FrfData:
    """Turn rates into accelerations, s H with s of Tustin's rule; their variance grows with them.

    In the frequency domain this amplifies no noise: weight and response change together.
    """
    factor = np.ones(data.response.shape[1:2], dtype=complex)[None].repeat(len(data.frequency_hz), axis=0)
    factor[:, list(outputs)] = 1j * data.warped_radps()[:, None]
    return FrfData(
        data.frequency_hz,
        data.response * factor[:, :, None],
        data.variance * np.abs(factor[:, :, None]) ** 2,
        data.coherence,
        data.sample_s,
    )


def from_multisine(
    excitation: Multisine, records: Sequence[tuple[Array, Sequence[int]]], discard_periods: int = 1
) -> FrfData:
    """Estimate the responses from records of a repeated multisine.

    Each record is (outputs (samples, p), inputs that were on). The first periods hold the transient and are
    dropped. The noise is read off the empty lines of the same record, averaged over a neighbourhood.
    """
    period = len(excitation.signal)
    inputs = excitation.signal.shape[1]
    outputs = records[0][0].shape[1]
    lines = len(excitation.lines)
    response = np.zeros((lines, outputs, inputs), dtype=complex)
    variance = np.full((lines, outputs, inputs), np.inf)
    coherence = np.full((lines, outputs, inputs), np.nan)
    drive = np.fft.rfft(excitation.signal, axis=0)[excitation.lines]
    for measured, on in records:
        periods = len(measured) // period - discard_periods
        if periods < 1:
            raise ValueError(
                f"a record of {len(measured)} samples leaves no full period of {period} after the transient"
            )
        steady = measured[discard_periods * period : (discard_periods + periods) * period]
        spectrum = np.fft.rfft(steady, axis=0) / periods
        bins = excitation.lines * periods
        noise = _noise_power(spectrum, bins)
        for j in on:
            mine = excitation.excited[:, j]
            power = np.abs(drive[mine, j]) ** 2
            response[mine, :, j] = spectrum[bins[mine]] / drive[mine, j][:, None]
            variance[mine, :, j] = noise[mine] / power[:, None]
            gain = np.abs(response[mine, :, j]) ** 2
            coherence[mine, :, j] = gain / (gain + variance[mine, :, j])
    return FrfData(excitation.frequency_hz, response, variance, coherence, excitation.sample_s)


def _noise_power(spectrum: ComplexArray, bins: NDArray[np.int64], neighbours: int = 60) -> Array:
    """Return the noise power at each excited bin, averaged over the nearest empty ones, shape (k, p)."""
    empty = np.ones(len(spectrum), dtype=bool)
    empty[bins] = False
    empty[0] = False
    power = np.abs(spectrum) ** 2
    total = np.vstack([np.zeros(power.shape[1]), np.cumsum(np.where(empty[:, None], power, 0.0), axis=0)])
    count = np.r_[0, np.cumsum(empty)]
    low, high = np.maximum(bins - neighbours, 0), np.minimum(bins + neighbours + 1, len(spectrum))
    return np.asarray((total[high] - total[low]) / (count[high] - count[low])[:, None])


def from_noise(
    records: Sequence[tuple[Array, Array, int]],
    inputs: int,
    sample_s: float,
    *,
    estimator: str = "H1",
    segment: int = 2048,
    band_hz: tuple[float, float] = (0.2, 60.0),
) -> FrfData:
    """Estimate (6.13)-(6.15) by Welch's method from one record per input: (u (samples,), y (samples, p),
    input).

    H1 = S_uy / S_uu (unbiased for output noise), H2 = S_yy / S_yu (unbiased for input noise). The variance is
    that of Bendat and Piersol (2010) eq. 9.86, |H|^2 (1 - coherence) / (coherence x averages).
    """
    if estimator not in ("H1", "H2"):
        raise ValueError(f"estimator {estimator!r} is not known: use H1 or H2")
    outputs = records[0][1].shape[1]
    frequency = np.fft.rfftfreq(segment, sample_s)
    band = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    shape = (int(band.sum()), outputs, inputs)
    response = np.zeros(shape, dtype=complex)
    variance, coherence = np.full(shape, np.inf), np.full(shape, np.nan)
    rate = 1 / sample_s
    for u, y, j in records:
        averages = max(1.0, 2 * len(u) / segment - 1) * 0.95  # half-overlapped Hann windows
        s_uu = signal.welch(u, rate, nperseg=segment, detrend=False)[1][band, None]
        s_yy = signal.welch(y, rate, nperseg=segment, detrend=False, axis=0)[1][band]
        s_uy = signal.csd(u[:, None], y, rate, nperseg=segment, detrend=False, axis=0)[1][band]
        gamma = np.abs(s_uy) ** 2 / (s_uu * s_yy)
        response[:, :, j] = s_uy / s_uu if estimator == "H1" else s_yy / s_uy.conj()
        coherence[:, :, j] = gamma
        spread = (1 - gamma) / (gamma * averages)
        variance[:, :, j] = np.abs(response[:, :, j]) ** 2 * np.maximum(spread, 1e-12)
    return FrfData(np.asarray(frequency[band], dtype=np.float64), response, variance, coherence, sample_s)
