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
    from numpy.typing import NDArray

    Array = NDArray[np.floating[Any]]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]

MOST_HZ = 1.0
LEAST_COHERENCE = 0.6
LEAST_STROKE_MM = 0.3
SEGMENTS = 6


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
    if stroke_mm.shape[1] != 4 or imu.shape != (len(stroke_mm), len(outputs)):
        raise ValueError(
            f"strokes {stroke_mm.shape} and IMU {imu.shape} do not fit 4 strokes and {len(outputs)} outputs"
        )
    segment = 2 * len(stroke_mm) // (SEGMENTS + 1)
    if segment * sample_s < 2.0:
        raise ValueError(
            f"a record of {len(stroke_mm) * sample_s:.1f} s is too short for {SEGMENTS} averages: "
            "record 30 s at least"
        )
    moved = stroke_mm.std(axis=0) > LEAST_STROKE_MM
    if not moved.any():
        raise ValueError(f"no stroke moved by more than {LEAST_STROKE_MM} mm: excite the actuators first")
    on = np.flatnonzero(moved)
    remarks = [
        f"stroke {CORNERS[i]} moved by less than {LEAST_STROKE_MM} mm: not identified"
        for i in range(4)
        if not moved[i]
    ]
    remarks.append("road and force inputs: not excited, the robot has no shaker and no force actuator")

    spectra = _spectra(np.hstack([stroke_mm[:, on], imu]), segment, sample_s)
    frequency = np.fft.rfftfreq(segment, sample_s)
    keep = (frequency > 0) & (frequency <= MOST_HZ)
    frequency, spectra = frequency[keep], spectra[keep]
    inputs = len(on)
    s_uu, s_uy = spectra[:, :inputs, :inputs], spectra[:, :inputs, inputs:]
    s_yy = np.real(np.diagonal(spectra[:, inputs:, inputs:], axis1=1, axis2=2))
    ridge = 1e-9 * np.trace(s_uu, axis1=1, axis2=2).real[:, None, None] * np.eye(inputs)
    gain = np.linalg.solve(s_uu + ridge, s_uy)  # (k, inputs, outputs)
    explained = np.real(np.einsum("kio,kio->ko", s_uy.conj(), gain))
    coherence = np.clip(explained / s_yy, 0.0, 1.0)
    noise = np.maximum(s_yy - explained, 0.0) / max(SEGMENTS - inputs, 1)
    spread = np.real(np.diagonal(np.linalg.inv(s_uu + ridge), axis1=1, axis2=2))
    response = np.zeros((len(frequency), imu.shape[1], 4), dtype=complex)
    std = np.full(response.shape, np.inf)
    response[:, :, on] = np.swapaxes(gain, 1, 2)
    std[:, :, on] = np.sqrt(noise[:, :, None] * spread[:, None, :])
    condition = np.linalg.cond(s_uu)
    if np.median(condition) > 1e4:
        remarks.append("the strokes moved together: move them one at a time to tell them apart")
    for i, name in enumerate(outputs):
        weak = frequency[coherence[:, i] < LEAST_COHERENCE]
        if len(weak):
            remarks.append(
                f"{name}: {len(weak)} of {len(frequency)} lines have a coherence below {LEAST_COHERENCE}, "
                f"from {weak[0]:.2f} to {weak[-1]:.2f} Hz"
            )
    remarks.append(f"above {MOST_HZ:g} Hz: not identified, the actuators are too slow to excite it")
    return StrokeResponse(frequency, response, std, coherence, tuple(remarks))


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
