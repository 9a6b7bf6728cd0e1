"""Road height as a function of position: the bump of (6.30), a step, and random roads of ISO 8608 (6.31).

A road answers `height_m(position_m, lane)` for the left (0) and right (1) wheel track, so that the same road
serves any speed, any vehicle and any number of wheels. `wheel_heights_m` turns it into the four inputs of the
full car, with the rear wheels on the front wheels' tracks a wheelbase later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

LEFT, RIGHT = 0, 1
REFERENCE_CYCLES_PER_M = 0.1
# Geometric means of G_d(n0) in m^3, ISO 8608:2016 Table A.1.
ISO_ROUGHNESS_M3 = {name: 16e-6 * 4**i for i, name in enumerate("ABCDEFGH")}


class Road(Protocol):
    """A surface with two wheel tracks. Height is zero before the start of every road here."""

    def height_m(self, position_m: ArrayLike, lane: int) -> Array:
        """Height at each position along the lane (LEFT or RIGHT), same shape as `position_m`."""
        ...


@dataclass(frozen=True, slots=True)
class Bump:
    """`cycles` raised cosines in a row, (6.30): h/2 (1 - cos 2 pi x / wavelength), the same in both lanes."""

    height: float = 0.1
    wavelength: float = 20.0
    cycles: int = 2
    start: float = 0.0

    def height_m(self, position_m: ArrayLike, lane: int) -> Array:
        """Height at each position; the lane does not matter."""
        x = np.asarray(position_m, dtype=float) - self.start
        on = (x >= 0) & (x <= self.cycles * self.wavelength)
        return np.where(on, 0.5 * self.height * (1 - np.cos(2 * np.pi * x / self.wavelength)), 0.0)


@dataclass(frozen=True, slots=True)
class Step:
    """A kerb of `height` at `start`, in the named lanes."""

    height: float = 0.1
    start: float = 0.0
    lanes: tuple[int, ...] = (LEFT, RIGHT)

    def height_m(self, position_m: ArrayLike, lane: int) -> Array:
        """Height at each position of the lane."""
        x = np.asarray(position_m, dtype=float)
        return np.where(x >= self.start, self.height, 0.0) * (lane in self.lanes)


@dataclass(frozen=True, slots=True, eq=False)
class IsoRoad:
    """A random road of ISO 8608: cosines at consecutive harmonics of 1 / period, with random phases.

    Each lane is sum A cos(2 pi n x + phase) less its value at x = 0, so that it starts without a step.
    """

    period_m: float
    first_harmonic: int
    phasors_m: NDArray[np.complexfloating[Any, Any]]
    """A exp(i phase) of each lane and harmonic, shape (2, k)."""

    def height_m(self, position_m: ArrayLike, lane: int) -> Array:
        """Height at each position of the lane, zero for positions before the start."""
        x = np.asarray(position_m, dtype=float)
        turn = np.exp(2j * np.pi / self.period_m * np.maximum(x, 0.0))
        total = np.zeros(x.shape, dtype=complex)
        for phasor in self.phasors_m[lane, ::-1]:  # Horner: one multiplication per harmonic, no cosine
            total *= turn
            total += phasor
        start = float(self.phasors_m[lane].sum().real)
        return np.where(x > 0, (total * turn**self.first_harmonic).real - start, 0.0)


def iso_road(
    road_class: str = "C",
    seed: int = 0,
    *,
    band_cycles_per_m: tuple[float, float] = (0.01, 1.7),
    period_m: float = 100.0,
    coherence_length_m: float = np.inf,
) -> IsoRoad:
    """Draw a road of G_d(n) = G_d(n0) (n / n0)^-2 (6.31), with n0 = 0.1 cycles/m.

    Amplitudes are sqrt(2 G_d(n) dn) with dn = 1 / `period_m` over `band_cycles_per_m`. What (6.31) leaves
    open is stated here: the geometric-mean roughness of the class (256e-6 m^3 for C), the band, and the
    relation of the lanes. Two lanes have coherence exp(-4 pi n coherence_length_m): 0 gives one profile for
    both, infinity (the default, as section 6.5.1 asks for "two different road profiles") two independent
    ones.
    """
    if road_class not in ISO_ROUGHNESS_M3:
        raise ValueError(f"road class {road_class!r} is not known: use one of {', '.join(ISO_ROUGHNESS_M3)}")
    low, high = band_cycles_per_m
    if not 0 < low < high:
        raise ValueError(f"the band {low} to {high} cycles/m is empty or reaches zero: give 0 < low < high")
    rng = np.random.default_rng(seed)
    harmonic = np.arange(int(np.ceil(low * period_m - 1e-9)), int(np.floor(high * period_m + 1e-9)) + 1)
    n = harmonic / period_m
    density = ISO_ROUGHNESS_M3[road_class] * (n / REFERENCE_CYCLES_PER_M) ** -2
    amplitude = np.sqrt(2 * density / period_m)
    own = np.exp(1j * rng.uniform(0, 2 * np.pi, (2, len(n))))
    shared = np.exp(1j * rng.uniform(0, 2 * np.pi, len(n)))
    common = np.exp(-2 * np.pi * n * coherence_length_m)  # share of the power; coherence is its square
    phasors = amplitude * (np.sqrt(common) * shared + np.sqrt(1 - common) * own)
    return IsoRoad(period_m, int(harmonic[0]), phasors)


def rear_delay_s(wheelbase_m: float, speed_mps: float) -> float:
    """Return tau = (a + b) / V, the time by which a rear wheel follows the front wheel of its lane."""
    if speed_mps <= 0:
        raise ValueError(f"the speed must be positive to give a wheelbase delay, not {speed_mps} m/s")
    return wheelbase_m / speed_mps


def wheel_heights_m(road: Road, time_s: Array, speed_mps: float, delays_s: Sequence[float]) -> Array:
    """Return the road under each wheel, shape (len(time_s), 4).

    `delays_s` says when FL, FR, RL, RR reach the start of the road; usually (0, 0, tau, tau).
    """
    columns = [
        road.height_m((np.asarray(time_s) - delay) * speed_mps, lane)
        for delay, lane in zip(delays_s, (LEFT, RIGHT, LEFT, RIGHT), strict=True)
    ]
    return np.column_stack(columns)
