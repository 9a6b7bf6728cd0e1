"""Identify the real robot from a log: four strokes as inputs, the IMU as output, below about 1 Hz.

The robot has no shaker under its wheels and no force actuators, so twenty of the 24 paths of section 6.3
cannot be excited; at 9.4 mm/s its strokes move the body up to about 1 Hz. What could not be excited is said,
not guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

from tiger.models.full_car import CORNERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Array = NDArray[np.floating[Any]]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]

MOST_HZ = 1.0
LEAST_COHERENCE = 0.6
LEAST_STROKE_MM = 0.3
SEGMENTS = 6
LEAST_SEGMENT_S = 2.0
TANGLED_CONDITION = 1e4
"""Of the strokes' spectral matrix: beyond it they moved together."""


@dataclass(frozen=True, slots=True, eq=False)
class StrokeResponse:
    """Responses of the IMU's outputs to the strokes: response (k, outputs, 4) per millimetre, with standard
    deviations.

    coherence (k, outputs) is that with all four strokes together. `remarks` says in words what could not be
    identified.
    """

    frequency_hz: Array
    response: ComplexArray
    std: Array
    coherence: Array
    remarks: tuple[str, ...]


def identify(stroke_mm: Array, imu: Array, outputs: tuple[str, ...], sample_s: float) -> StrokeResponse:
    """Estimate the responses by multi-input H1 from strokes (samples, 4) and IMU outputs (samples, p).

    Raises ValueError for a record too short for the averaging, or where no stroke moved.
    """
    segment = _segment(stroke_mm, imu, outputs, sample_s)
    on = np.flatnonzero(stroke_mm.std(axis=0) > LEAST_STROKE_MM)
    if not len(on):
        raise ValueError(f"no stroke moved by more than {LEAST_STROKE_MM} mm: excite the actuators first")
    spectra = _spectra(np.hstack([stroke_mm[:, on], imu]), segment, sample_s)
    frequency = np.fft.rfftfreq(segment, sample_s)
    keep = (frequency > 0) & (frequency <= MOST_HZ)
    frequency, spectra = frequency[keep], spectra[keep]
    gain, gain_std, coherence = _h1(spectra, len(on))
    response = np.zeros((len(frequency), len(outputs), 4), dtype=complex)
    std = np.full(response.shape, np.inf)
    response[:, :, on], std[:, :, on] = gain, gain_std
    tangled = np.median(np.linalg.cond(spectra[:, : len(on), : len(on)])) > TANGLED_CONDITION
    remarks = (
        *(
            f"stroke {CORNERS[i]} moved by less than {LEAST_STROKE_MM} mm: not identified"
            for i in range(4)
            if i not in on
        ),
        "road and force inputs: not excited, the robot has no shaker and no force actuator",
        *(["the strokes moved together: move them one at a time to tell them apart"] if tangled else []),
        *_weak_lines(frequency, coherence, outputs),
        f"above {MOST_HZ:g} Hz: not identified, the actuators are too slow to excite it",
    )
    return StrokeResponse(frequency, response, std, coherence, remarks)


def _segment(stroke_mm: Array, imu: Array, outputs: tuple[str, ...], sample_s: float) -> int:
    """Return the samples of one average, half overlapping; raises ValueError where the record is no good."""
    if stroke_mm.shape[1] != 4 or imu.shape != (len(stroke_mm), len(outputs)):
        raise ValueError(
            f"strokes {stroke_mm.shape} and IMU {imu.shape} do not fit 4 strokes and {len(outputs)} outputs"
        )
    segment = 2 * len(stroke_mm) // (SEGMENTS + 1)
    if segment * sample_s < LEAST_SEGMENT_S:
        raise ValueError(
            f"a record of {len(stroke_mm) * sample_s:.1f} s is too short for {SEGMENTS} averages: "
            "record 30 s at least"
        )
    return segment


def _h1(spectra: ComplexArray, inputs: int) -> tuple[ComplexArray, Array, Array]:
    """Return gain and its standard deviation, (k, outputs, inputs), and multiple coherence, (k, outputs).

    `spectra` (k, channels, channels) has the inputs' channels first.
    """
    s_uu, s_uy = spectra[:, :inputs, :inputs], spectra[:, :inputs, inputs:]
    s_yy = np.real(np.diagonal(spectra[:, inputs:, inputs:], axis1=1, axis2=2))
    ridge = 1e-9 * np.trace(s_uu, axis1=1, axis2=2).real[:, None, None] * np.eye(inputs)
    gain = np.linalg.solve(s_uu + ridge, s_uy)  # (k, inputs, outputs)
    explained = np.real(np.einsum("kio,kio->ko", s_uy.conj(), gain))
    coherence = np.clip(explained / s_yy, 0.0, 1.0)
    noise = np.maximum(s_yy - explained, 0.0) / max(SEGMENTS - inputs, 1)
    spread = np.real(np.diagonal(np.linalg.inv(s_uu + ridge), axis1=1, axis2=2))
    return np.swapaxes(gain, 1, 2), np.sqrt(noise[:, :, None] * spread[:, None, :]), coherence


def _weak_lines(frequency: Array, coherence: Array, outputs: tuple[str, ...]) -> Iterator[str]:
    """Say where an output does not follow the strokes."""
    for name, of_output in zip(outputs, coherence.T, strict=True):
        weak = frequency[of_output < LEAST_COHERENCE]
        if len(weak):
            yield (
                f"{name}: {len(weak)} of {len(frequency)} lines have a coherence below {LEAST_COHERENCE}, "
                f"from {weak[0]:.2f} to {weak[-1]:.2f} Hz"
            )


def _spectra(records: Array, segment: int, sample_s: float) -> ComplexArray:
    """Return the matrix of all auto- and cross-spectra (Welch, Hann, half overlap), (k, channels,
    channels)."""
    count = records.shape[1]
    result = np.empty((segment // 2 + 1, count, count), dtype=complex)
    for i in range(count):
        _, row = signal.csd(
            records[:, [i]], records, 1 / sample_s, nperseg=segment, axis=0, detrend="constant"
        )
        result[:, i] = row
    return result
