"""The attitude filter on a synthetic off-road vehicle, with and without the wheels' help.

Truth at 1 kHz, sensors at 100 Hz. The body follows its terrain and moves on its suspension; the velocity is
along the terrain, not along the body, so the aiding model is not the one that made the data. The
accelerometer is calibrated (offset 0.05 m/s2 at most), the gyroscope is not. Scored after the first minute.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal
from scipy.spatial.transform import Rotation

from tiger.native.attitude import AttitudeFilter, AttitudeHistory

Array = NDArray[np.float64]
FINE_HZ, SENSOR_HZ, MAG_EVERY = 1000, 100, 5
GRAVITY = 9.80665
EARTH_FIELD_UT = np.array([0.0, 20.0, -45.0])
SETTLE_S = 60.0


@dataclass(frozen=True)
class Drive:
    """Truth and sensor readings at 100 Hz."""

    body_to_earth: Rotation
    gyro_radps: Array
    accel_mps2: Array
    mag_ut: Array
    wheel_mps: Array


def _noise(rng: np.random.Generator, n: int, band_hz: tuple[float, float], rms: float) -> Array:
    sos = signal.butter(2, band_hz, "bandpass", fs=FINE_HZ, output="sos")
    x = signal.sosfilt(sos, rng.standard_normal(n))
    return x * (rms / x.std())


def _speed(rng: np.random.Generator, n: int, stops: bool) -> Array:
    """Speed up to 9.7 m/s with accelerations up to 2.5 m/s2."""
    target = np.empty(n)
    at = 0
    while at < n:
        end = at + int(rng.uniform(4, 18) * FINE_HZ)
        target[at:end] = 0.0 if stops and rng.random() < 0.2 else rng.uniform(1.0, 9.7)
        at = end
    v, speed = np.empty(n), 0.0 if stops else 3.0
    limit = rng.uniform(1.0, 2.5) / FINE_HZ
    for i in range(n):
        speed += min(max(target[i] - speed, -limit), limit)
        v[i] = speed
    kernel = signal.windows.hann(601)
    return np.convolve(np.pad(v, 300, "edge"), kernel / kernel.sum(), "valid")


def _over_ground(rng: np.random.Generator, distance_m: Array, wavelength_m: float, rms: float) -> Array:
    """A profile over the ground, seen along the path."""
    step = 0.1
    n = int(distance_m[-1] / step) + 400
    sos = signal.butter(2, 2 * step / wavelength_m, output="sos")
    x = signal.sosfiltfilt(sos, rng.standard_normal(n))
    kernel = signal.windows.hann(15)
    x = np.convolve(x * (rms / x.std()), kernel / kernel.sum(), "same")
    return np.interp(distance_m, np.arange(n) * step, x)


@cache
def drive(seed: int, stops: bool, minutes: float = 10.0) -> Drive:
    rng = np.random.default_rng(seed)
    n = int(minutes * 60 * FINE_HZ)
    dt = 1.0 / FINE_HZ
    v = _speed(rng, n, stops)
    moving = np.clip(v / 2.0, 0.0, 1.0)
    distance = np.cumsum(v) * dt

    # Ground: slow and faster slopes; body: 1 to 4 Hz on its suspension.
    slopes = [_over_ground(rng, distance, 40.0, 5.0) + _over_ground(rng, distance, 10.0, 2.5) for _ in "rp"]
    roll, pitch = np.radians(slopes)
    lateral = signal.sosfilt(signal.butter(1, 0.1, fs=FINE_HZ, output="sos"), rng.standard_normal(n))
    lateral = np.clip(lateral / lateral.std() * 1.5, -4.0, 4.0)
    turn = lateral / np.maximum(v, 2.0) * np.clip(v, 0.0, 2.0) / 2.0
    yaw = np.cumsum(turn) * dt + rng.uniform(-np.pi, np.pi)
    ground = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    sway = [np.radians(_noise(rng, n, (1.0, 4.0), 1.0)) * moving for _ in "rp"]
    body = ground * Rotation.from_euler("YX", np.column_stack(sway))

    velocity = v[:, None] * ground.apply([1.0, 0.0, 0.0])
    accel = np.gradient(velocity, dt, axis=0)
    accel[:, 2] += _noise(rng, n, (1.0, 4.0), 1.0) * moving
    force = body.inv().apply(accel + np.array([0.0, 0.0, GRAVITY]))
    force += np.column_stack([_noise(rng, n, (15.0, 80.0), rms) for rms in (1.5, 1.5, 3.0)]) * moving[:, None]
    rate = np.zeros((n, 3))
    rate[1:] = (body[:-1].inv() * body[1:]).as_rotvec() / dt
    rate += np.column_stack([np.radians(_noise(rng, n, (15.0, 80.0), 6.0)) for _ in "xyz"]) * moving[:, None]

    # The sensors: anti-alias filter, bias, noise and digits of the BNO055.
    every = FINE_HZ // SENSOR_HZ
    alias = signal.butter(2, 40.0, fs=FINE_HZ, output="sos")
    start = signal.sosfilt_zi(alias)[:, :, None]
    force = signal.sosfilt(alias, force, axis=0, zi=start * force[0])[0][::every]
    rate = signal.sosfilt(alias, rate, axis=0, zi=start * rate[0])[0][::every]
    m = len(force)
    walk = np.cumsum(rng.normal(0, 0.002 / np.sqrt(SENSOR_HZ), (m, 3)), axis=0)
    bias = np.radians(rng.uniform(-0.7, 0.7, 3) + walk)
    gyro = rate + bias + np.radians(rng.normal(0, 0.12, (m, 3)))
    force = force + rng.uniform(-0.05, 0.05, 3) + rng.normal(0, 0.015, (m, 3))

    truth = body[::every]
    field = np.tile(EARTH_FIELD_UT, (m, 1))
    at = int(rng.uniform(60, 90) * SENSOR_HZ)
    while at < m:
        lasts = int(rng.uniform(10, 40) * SENSOR_HZ)
        direction = rng.standard_normal(3)
        field[at : at + lasts] += rng.uniform(10, 40) * direction / np.linalg.norm(direction)
        at += lasts + int(rng.uniform(30, 90) * SENSOR_HZ)
    current = np.abs(np.gradient(v, dt)[::every])[:, None] * rng.normal(0, 0.5, 3)
    mag = truth.inv().apply(field) + current + rng.normal(0, 0.6, (m, 3))
    mag = np.round(mag * 16) / 16
    mag[np.arange(m) % MAG_EVERY != 0] = np.nan

    slip = signal.sosfilt(signal.butter(1, 1.0, fs=SENSOR_HZ, output="sos"), rng.standard_normal(m))
    wheel = v[::every] * (1 + rng.uniform(-0.02, 0.02)) * (1 + 0.03 * slip / slip.std())
    return Drive(truth, np.round(gyro * 900) / 900, np.round(force * 100) / 100, mag, wheel)


def errors_deg(truth: Rotation, quaternion: Array) -> tuple[Array, Array]:
    """Inclination and heading error after the first minute, as BROAD defines them."""
    w, x, y, z = quaternion.T
    off = (Rotation.from_quat(np.column_stack([x, y, z, w])) * truth.inv()).as_quat()
    off = off[int(SETTLE_S * SENSOR_HZ) :]
    inclination = 2 * np.arccos(np.clip(np.hypot(off[:, 3], off[:, 2]), 0, 1))
    heading = 2 * np.arctan2(np.abs(off[:, 2]), np.abs(off[:, 3]))
    return np.degrees(inclination), np.degrees(heading)


def run(trip: Drive, aided: bool) -> AttitudeHistory:
    speed = trip.wheel_mps if aided else None
    return AttitudeFilter().run(trip.gyro_radps, trip.accel_mps2, trip.mag_ut, speed_mps=speed)


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def score(seeds: range) -> tuple[float, float, float]:
    """Over drives with and without stops: RMS and worst 99th percentile of inclination, RMS of heading."""
    inclinations, headings = [], []
    for seed in seeds:
        for stops in (True, False):
            trip = drive(seed, stops)
            inclination, heading = errors_deg(trip.body_to_earth, run(trip, aided=True).quaternion)
            inclinations.append(inclination)
            headings.append(heading)
    worst_p99 = max(float(np.percentile(each, 99)) for each in inclinations)
    return rms(np.concatenate(inclinations)), worst_p99, rms(np.concatenate(headings))


def test_aided_attitude_off_road_stays_within_its_bars() -> None:
    inclination, p99, heading = score(range(100, 101))
    assert inclination <= 0.5
    assert p99 <= 1.0
    assert heading <= 5.0


@pytest.mark.proof
@pytest.mark.timeout(600)
def test_aided_attitude_off_road_stays_within_its_bars_over_twelve_drives() -> None:
    inclination, p99, heading = score(range(100, 106))
    print(f"aided: inclination RMSE {inclination:.2f}, p99 {p99:.2f}, heading RMSE {heading:.2f} degrees")
    assert inclination <= 0.5
    assert p99 <= 1.0
    assert heading <= 5.0


def test_the_wheels_take_the_inclination_error_down_five_times() -> None:
    trip = drive(100, True)
    plain, _ = errors_deg(trip.body_to_earth, run(trip, aided=False).quaternion)
    aided, _ = errors_deg(trip.body_to_earth, run(trip, aided=True).quaternion)
    assert rms(aided) < rms(plain) / 5
