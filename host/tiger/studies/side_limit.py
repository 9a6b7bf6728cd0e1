"""How well a load's place to the side can be told at all, on ground of which only the class is known.

Pitch and roll of the ground under the wheels are chords of one random surface. For isotropic ground with the
line spectrum G0 (n/n0)^-2, the plane spectrum G0 n0^2/(4 k^3), heights r apart differ by a variance of

    D(r) = pi G0 n0^2 * integral of (1 - J0(2 pi k r)) / k^2 dk,

so the covariance of any chords along any path is known, and generalised least squares (Gauss, Markov) has
the least variance that there is: a Cramer-Rao bound, as everything is Gaussian. Unknown are the load's places
ahead and to the side and the ground's mean slope; tilts are all but exact, mass, height and springs known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import j0

from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.road import ISO_ROUGHNESS_M3, REFERENCE_CYCLES_PER_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.estimation.payload import PayloadDesign

    Array = NDArray[np.float64]

_NOISE_RAD = np.radians(0.05)
_SPACING_M = 0.12


def least_sigma_m(
    design: PayloadDesign,
    corners_m: Array,
    path: Array,
    roughness: str,
    waves_m: tuple[float, float],
    slope_rad: float,
    mass_kg: float,
) -> float:
    """Return the least standard deviation (m) of the place to the side after a drive.

    `corners_m` (4, 2) are the wheels' places, `path` (n, 3) is x, y and heading on the way, `waves_m` the
    shortest and the longest wave of the ground, `slope_rad` the standard deviation of its mean slope.
    """
    x, y, heading = _spaced(path).T
    cos, sin = np.cos(heading), np.sin(heading)
    wheels = np.stack(
        [np.stack([x + cos * a - sin * b, y + sin * a + cos * b], axis=1) for a, b in corners_m], axis=1
    ).reshape(-1, 2)
    apart = np.hypot(*(wheels[:, None] - wheels[None]).transpose(2, 0, 1))
    heights = -0.5 * _differ_m2(apart, roughness, waves_m)  # but for what chords do not see
    half_base, half_track = np.abs(corners_m[0])
    rise = np.array([1.0, -1.0, 1.0, -1.0]) / (4.0 * half_track)
    climb = np.array([1.0, 1.0, -1.0, -1.0]) / (4.0 * half_base)
    chords = np.vstack([np.kron(np.eye(x.size), chord) for chord in (rise, climb)])
    covariance = chords @ heights @ chords.T + _NOISE_RAD**2 * np.eye(2 * x.size)
    upright = GRAVITY_MPS2 * design.radius_m * (design.empty_kg + mass_kg)
    weight, nothing = GRAVITY_MPS2 * mass_kg, np.zeros_like(x)
    left = np.full_like(x, weight / (design.roll_nmprad + upright))
    ahead = np.full_like(x, weight / (design.pitch_nmprad + upright))
    seen = np.vstack(  # by roll and pitch, of the places to the left and ahead and of the two mean slopes
        [
            np.stack([-left, nothing, -sin, cos], axis=1),
            np.stack([nothing, -ahead, cos, sin], axis=1),
        ]
    )
    known = np.diag([0.0, 0.0, slope_rad**-2, slope_rad**-2])
    information = seen.T @ np.linalg.solve(covariance, seen) + known
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def _spaced(path: Array) -> Array:
    """Every so many metres of the way."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    return path[np.searchsorted(way, np.arange(0.05, way[-1], _SPACING_M))]


def _differ_m2(apart_m: Array, roughness: str, waves_m: tuple[float, float]) -> Array:
    """Variance of how much heights so far apart differ."""
    level = ISO_ROUGHNESS_M3[roughness] * REFERENCE_CYCLES_PER_M**2
    shortest, longest = waves_m
    k = np.geomspace(1.0 / longest, 1.0 / shortest, 2000)
    r = np.concatenate([[0.0], np.geomspace(1e-3, apart_m.max(), 300)])
    at = np.pi * level * np.trapezoid((1.0 - j0(2.0 * np.pi * np.outer(r, k))) / k**2, k, axis=1)
    return np.asarray(np.interp(apart_m, r, at))
