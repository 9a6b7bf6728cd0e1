"""The attitude filter on BROAD, beside PyPI's `vqf` in its default tuning, on the same data in the same run.

BROAD: D. Laidig, M. Caruso, A. Cereatti, T. Seel, Data 6(7):72, 2021, doi 10.3390/data6070072, CC BY 4.0. The
trials are not part of the project: `TIGER_BROAD_DIR` names a folder of npz files with rate_hz, gyr_radps,
acc_mps2, mag_uT, quat_wxyz (truth, NaN where it is missing) and movement. `vqf` is no dependency either;
where it is not installed, `TIGER_VQF_DIR` may name the folder of `pip install --target FOLDER --no-deps vqf`.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from tiger.native.attitude import AttitudeFilter, AttitudeTuning

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    rate_hz: float
    gyro: Array
    accel: Array
    mag: Array
    truth: Array
    scored: NDArray[np.bool_]

    def decimated(self, factor: int) -> Trial:
        """Every so-manieth sample behind a linear-phase low-pass; truth and scored phases stay aligned."""
        half = 10 * factor
        taps = signal.firwin(2 * half + 1, 0.9 / factor)[:, None]

        def slow(x: Array) -> Array:
            padded = np.pad(x, ((half, half), (0, 0)), "edge")
            return np.asarray(signal.oaconvolve(padded, taps, "valid", axes=0))[::factor]

        return Trial(
            self.rate_hz / factor,
            slow(self.gyro),
            slow(self.accel),
            slow(self.mag),
            self.truth[::factor],
            self.scored[::factor],
        )

    def errors_deg(self, quaternion: Array) -> Array:
        """RMSE of total, heading and inclination over the scored phases, as BROAD defines them."""
        w1, x1, y1, z1 = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
        w2, x2, y2, z2 = (self.truth * [1, -1, -1, -1]).T
        w = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
        z = w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
        errors = (
            2 * np.arccos(np.clip(np.abs(w), 0, 1)),
            2 * np.arctan2(np.abs(z), np.abs(w)),
            2 * np.arccos(np.clip(np.hypot(w, z), 0, 1)),
        )
        valid = self.scored & np.isfinite(self.truth).all(axis=1)
        return np.degrees([np.sqrt(np.mean(error[valid] ** 2)) for error in errors])


@pytest.fixture(scope="module")
def trials() -> list[Trial]:
    folder = os.environ.get("TIGER_BROAD_DIR")
    if not folder:
        pytest.skip("BROAD is absent: set TIGER_BROAD_DIR to the folder with its trials as npz files")
    files = sorted(Path(folder).glob("*.npz"))
    if not files:
        pytest.skip(f"BROAD is absent: no npz files in TIGER_BROAD_DIR={folder}")
    found = []
    for file in files:
        with np.load(file) as data:
            keys = ("gyr_radps", "acc_mps2", "mag_uT", "quat_wxyz")
            gyro, accel, mag, truth = (data[key].astype(np.float64) for key in keys)
            found.append(Trial(float(data["rate_hz"]), gyro, accel, mag, truth, data["movement"]))
    return found


@pytest.fixture(scope="module")
def peer() -> Any:
    if folder := os.environ.get("TIGER_VQF_DIR"):
        sys.path.append(folder)
    return pytest.importorskip("vqf", reason="install vqf, or set TIGER_VQF_DIR").VQF


def ours(trial: Trial, slow_every: int, mag_every: int) -> Array:
    tick_s = 1.0 / trial.rate_hz
    tuning = AttitudeTuning(tick_s=tick_s, mag_period_s=mag_every * tick_s, slow_every=slow_every)
    mag = trial.mag.copy()
    mag[np.arange(len(mag)) % mag_every != 0] = np.nan
    return AttitudeFilter(tuning).run(trial.gyro, trial.accel, mag).quaternion


def theirs(peer: Any, trial: Trial) -> Array:
    gyro, accel, mag = (np.ascontiguousarray(x) for x in (trial.gyro, trial.accel, trial.mag))
    return np.asarray(peer(1.0 / trial.rate_hz).updateBatch(gyro, accel, mag)["quat9D"])


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("decimation", "slow_every", "mag_every", "bar"),
    [
        pytest.param(1, 1, 1, 1.0, id="286 Hz, everything at every sample"),
        pytest.param(3, 4, 5, 1.1, id="95 Hz, the schedule of the Nano"),
    ],
)
def test_inclination_on_broad_is_no_worse_than_vqfs(
    trials: list[Trial], peer: Any, decimation: int, slow_every: int, mag_every: int, bar: float
) -> None:
    sets = [trial.decimated(decimation) if decimation > 1 else trial for trial in trials]
    own = np.mean([trial.errors_deg(ours(trial, slow_every, mag_every)) for trial in sets], axis=0)
    reference = np.mean([trial.errors_deg(theirs(peer, trial)) for trial in sets], axis=0)
    print(f"\n{sets[0].rate_hz:.0f} Hz; total, heading, inclination in degrees")
    print(f"ours {own.round(3)}, vqf {reference.round(3)}, ratio {(own / reference).round(3)}")
    assert own[2] <= bar * reference[2]
    assert own[0] <= bar * reference[0]
