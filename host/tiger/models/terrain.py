"""Ground to drive over: height, gradient and grip at any place, as compiled code reads them.

A terrain is the sum of a plane (tilted, twisted), any number of features (bumps, plates) and a height field.
All are functions of position, x forward and y left in metres, height z in metres, so that speed may vary and
the ground's gradient, which pushes a wheel back, is at hand (erratum of eq. 5.4). Everything is smooth enough
for a gradient to exist except the side edges of a feature with `edge_m` = 0. Patches scale the friction.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import cos, floor, inf, isfinite, pi, radians, sin, tan
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiger.models.jit import Record, Row, jit, record

Array = NDArray[np.float64]

BUMP, PLATE, PATCH = 0, 1, 2

FEATURE = np.dtype(
    [("kind", np.int64)]
    + [(name, np.float64) for name in ("height", "start", "length", "ramp", "right", "left", "edge", "grip")]
)
GROUND = np.dtype(
    [(name, np.float64) for name in ("height", "slope_x", "slope_y", "twist", "x0", "y0", "dx", "dy")]
)

ROUGHNESS_CLASSES = "ABCDEFGH"
_ISO_REFERENCE_PER_M = 0.1
_ISO_CLASS_A_M3 = 16e-6


class GroundArrays(NamedTuple):
    """A terrain as compiled code reads it: the plane and grid frame (1,), features (n,), heights (nx, ny)."""

    ground: Record
    features: NDArray[np.void]
    heights: Array


# ---- compiled: g is a row of GROUND ------------


@jit
def _ramp(distance: float, width: float) -> tuple[float, float]:
    """Smooth step from 0 at distance 0 to 1 at `width`, and its slope."""
    if distance <= 0.0:
        return 0.0, 0.0
    if distance >= width:
        return 1.0, 0.0
    t = distance / width
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) / width


@jit
def _window(position: float, first: float, last: float, width: float) -> tuple[float, float]:
    """1 between first and last with smooth flanks of `width` inside, and its slope."""
    up, up_slope = _ramp(position - first, width)
    down, down_slope = _ramp(last - position, width)
    return up * down, up_slope * down - up * down_slope


@jit
def _cubic(t: float, a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Catmull-Rom value and slope at t in [0, 1] between b and c."""
    k1 = 0.5 * (c - a)
    k2 = a - 2.5 * b + 2.0 * c - 0.5 * d
    k3 = 0.5 * (d - a) + 1.5 * (b - c)
    return b + t * (k1 + t * (k2 + t * k3)), k1 + t * (2.0 * k2 + t * 3.0 * k3)


@jit
def _along(heights: Array, row: int, j: int, t: float) -> tuple[float, float]:
    """Value and slope in a row of the height field at t in [0, 1] between its columns j and j + 1."""
    before, after = max(j - 1, 0), min(j + 2, heights.shape[1] - 1)
    return _cubic(t, heights[row, before], heights[row, j], heights[row, j + 1], heights[row, after])


@jit
def _field(g: Row, heights: Array, x: float, y: float) -> tuple[float, float, float]:
    """Bicubic value and gradient of the height field; beyond its border the border's height goes on."""
    nx, ny = heights.shape
    u = min(max((x - g.x0) / g.dx, 0.0), nx - 1.0)
    v = min(max((y - g.y0) / g.dy, 0.0), ny - 1.0)
    i, j = min(floor(u), nx - 2), min(floor(v), ny - 2)
    s, t = u - i, v - j
    a, da = _along(heights, max(i - 1, 0), j, t)
    b, db = _along(heights, i, j, t)
    c, dc = _along(heights, i + 1, j, t)
    d, dd = _along(heights, min(i + 2, nx - 1), j, t)
    height, slope_x = _cubic(s, a, b, c, d)
    slope_y, _ = _cubic(s, da, db, dc, dd)
    inside_x = g.x0 <= x <= g.x0 + (nx - 1) * g.dx
    inside_y = g.y0 <= y <= g.y0 + (ny - 1) * g.dy
    return height, slope_x / g.dx if inside_x else 0.0, slope_y / g.dy if inside_y else 0.0


@jit
def ground_at(
    ground: Record, features: Record, heights: Array, x: float, y: float
) -> tuple[float, float, float, float]:
    """(height, d height/dx, d height/dy, share of the friction) of the terrain at one place."""
    g = ground[0]
    grip = 1.0
    height = g.height + x * (g.slope_x + y * g.twist) + y * g.slope_y
    slope_x = g.slope_x + y * g.twist
    slope_y = g.slope_y + x * g.twist
    for i in range(features.shape[0]):
        f = features[i]
        if f.start < x < f.start + f.length and f.right < y < f.left:
            if f.kind == PATCH:
                grip *= f.grip
                continue
            if f.kind == BUMP:
                phase = 2.0 * pi * (x - f.start) / f.length
                along, along_slope = 0.5 * (1.0 - cos(phase)), pi / f.length * sin(phase)
            else:
                along, along_slope = _window(x, f.start, f.start + f.length, f.ramp)
            across, across_slope = _window(y, f.right, f.left, f.edge)
            height += f.height * along * across
            slope_x += f.height * along_slope * across
            slope_y += f.height * along * across_slope
    if heights.size:
        h, hx, hy = _field(g, heights, x, y)
        height += h
        slope_x += hx
        slope_y += hy
    return height, slope_x, slope_y, grip


@jit
def _sample(ground: Record, features: Record, heights: Array, x: Array, y: Array, out: Array) -> None:
    for i in range(x.size):
        out[0, i], out[1, i], out[2, i], out[3, i] = ground_at(ground, features, heights, x[i], y[i])


# ---- for people ------------


@dataclass(frozen=True, slots=True)
class Feature:
    """A bump (one period of (1 - cos)/2) or a plate (flat, with smooth ramps) along x from `start_m`.

    Or a patch, which scales the friction by `grip` and does no more. It lies at `right_m` < y < `left_m`,
    with smooth flanks of `edge_m` inside (0: sheer, no side push).
    """

    kind: int
    height_m: float
    start_m: float
    length_m: float
    ramp_m: float = 0.0
    right_m: float = -inf
    left_m: float = inf
    edge_m: float = 0.0
    grip: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Sum of a plane, features and a height field (nx, ny) sampled every `spacing_m` from `corner_m`."""

    height_m: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    twist_per_m: float = 0.0
    features: tuple[Feature, ...] = ()
    heights_m: Array = field(default_factory=lambda: np.zeros((0, 0)))
    corner_m: tuple[float, float] = (0.0, 0.0)
    spacing_m: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def slope(cls, climb_deg: float = 0.0, left_up_deg: float = 0.0) -> Terrain:
        """Return a tilted plane: climbing forward and rising to the left, each as seen along its axis."""
        return cls(slope_x=tan(radians(climb_deg)), slope_y=tan(radians(left_up_deg)))

    @classmethod
    def twisted(cls, twist_per_m: float) -> Terrain:
        """Return z = twist x y: the cross slope grows by `twist_per_m` every metre."""
        return cls(twist_per_m=twist_per_m)

    @classmethod
    def from_heights(
        cls, heights_m: ArrayLike, spacing_m: tuple[float, float], corner_m: tuple[float, float] = (0.0, 0.0)
    ) -> Terrain:
        """Return a height field (nx, ny), x down the rows, from `corner_m`; its border goes on outside.

        Raises ValueError if there are fewer than 2 x 2 heights, or one is not finite.
        """
        heights = np.ascontiguousarray(heights_m, dtype=np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise ValueError(f"heights have shape {heights.shape}; a field needs at least 2 x 2 of them")
        if not np.isfinite(heights).all():
            raise ValueError("heights must all be finite; fill the holes first")
        if not (min(spacing_m) > 0.0 and all(map(isfinite, (*spacing_m, *corner_m)))):
            raise ValueError(f"spacing {spacing_m} m must be positive and corner {corner_m} m finite")
        return cls(heights_m=heights, spacing_m=spacing_m, corner_m=corner_m)

    @classmethod
    def from_tracks(
        cls,
        left_m: ArrayLike,
        right_m: ArrayLike,
        spacing_m: float,
        half_track_m: float,
        start_m: float = 0.0,
    ) -> Terrain:
        """Return the ground under two wheel tracks: profiles (n,) at y = +half_track and -half_track."""
        tracks = np.stack([np.asarray(right_m, float), np.asarray(left_m, float)], axis=1)
        return cls.from_heights(tracks, (spacing_m, 2.0 * half_track_m), (start_m, -half_track_m))

    @classmethod
    def random(
        cls,
        roughness: str,
        seed: int,
        size_m: tuple[float, float] = (100.0, 20.0),
        spacing_m: float = 0.1,
        shortest_wave_m: float = 0.5,
    ) -> Terrain:
        """Return isotropic rough ground: any straight cut has the ISO 8608 line of class `roughness` (A-H).

        A line spectrum G(n) = G0 (n/n0)^-2 belongs to the isotropic plane spectrum G0 n0^2/(4 k^3). Waves are
        as long as `size_m` and as short as `shortest_wave_m`; the field starts at x = 0, centred on y = 0.
        Raises ValueError for an unknown class.
        """
        if len(roughness) != 1 or roughness not in ROUGHNESS_CLASSES:
            raise ValueError(f"roughness class {roughness!r} is unknown; use one of {ROUGHNESS_CLASSES}")
        shape = tuple(max(4, round(size / spacing_m)) for size in size_m)
        kx = np.fft.fftfreq(shape[0], spacing_m)[:, None]
        ky = np.fft.rfftfreq(shape[1], spacing_m)[None, :]
        k = np.hypot(kx, ky)
        level = _ISO_CLASS_A_M3 * 4.0 ** ROUGHNESS_CLASSES.index(roughness) * _ISO_REFERENCE_PER_M**2 / 4.0
        band = (k > 0.0) & (k <= 1.0 / shortest_wave_m)
        density = np.where(band, level / np.where(band, k, 1.0) ** 3, 0.0)
        noise = np.random.default_rng(seed).standard_normal(shape)
        heights = np.fft.irfft2(np.fft.rfft2(noise) * np.sqrt(density) / spacing_m, s=shape)
        return cls.from_heights(heights, (spacing_m, spacing_m), (0.0, -size_m[1] / 2.0))

    def with_bump(
        self,
        height_m: float,
        start_m: float,
        length_m: float,
        right_m: float = -inf,
        left_m: float = inf,
        edge_m: float = 0.0,
    ) -> Terrain:
        """Add one period of height (1 - cos)/2 over `length_m` from `start_m`, between the two sides."""
        return self._with(Feature(BUMP, height_m, start_m, length_m, 0.0, right_m, left_m, edge_m))

    def with_plate(
        self,
        height_m: float,
        start_m: float,
        length_m: float = inf,
        ramp_m: float = 0.1,
        right_m: float = -inf,
        left_m: float = inf,
        edge_m: float = 0.0,
    ) -> Terrain:
        """Add a plate with smooth ramps of `ramp_m` at both ends; length inf makes it a single step."""
        return self._with(Feature(PLATE, height_m, start_m, length_m, ramp_m, right_m, left_m, edge_m))

    def with_slippery(
        self,
        friction_factor: float,
        start_m: float,
        length_m: float = inf,
        right_m: float = -inf,
        left_m: float = inf,
    ) -> Terrain:
        """Scale the friction in a rectangle; where patches overlap their factors multiply."""
        if not friction_factor > 0.0:
            raise ValueError(f"friction_factor = {friction_factor} must be above 0: 0.05 is wet ice")
        return self._with(Feature(PATCH, 0.0, start_m, length_m, 0.0, right_m, left_m, grip=friction_factor))

    def _with(self, feature: Feature) -> Terrain:
        if not feature.length_m > 0.0 or feature.ramp_m < 0.0 or feature.edge_m < 0.0:
            raise ValueError(f"{feature} must have a length above 0, and no negative ramp or edge")
        return replace(self, features=(*self.features, feature))

    def arrays(self) -> GroundArrays:
        """Return the terrain as compiled code reads it."""
        ground = record(
            GROUND,
            {
                "height": self.height_m,
                "slope_x": self.slope_x,
                "slope_y": self.slope_y,
                "twist": self.twist_per_m,
                "x0": self.corner_m[0],
                "y0": self.corner_m[1],
                "dx": self.spacing_m[0],
                "dy": self.spacing_m[1],
            },
        )
        rows = [
            (f.kind, f.height_m, f.start_m, f.length_m, f.ramp_m, f.right_m, f.left_m, f.edge_m, f.grip)
            for f in self.features
        ]
        features = np.array(rows, FEATURE).view(type(ground))
        return GroundArrays(ground, features, self.heights_m)

    def at(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Array, Array, Array]:
        """Return height in m and the gradients dz/dx, dz/dy at each place; x and y broadcast."""
        height, slope_x, slope_y, _ = self._sampled(x_m, y_m)
        return height, slope_x, slope_y

    def grip_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        """Return the share of the tyres' friction at each place; x and y broadcast."""
        return np.asarray(self._sampled(x_m, y_m)[3])

    def _sampled(self, x_m: ArrayLike, y_m: ArrayLike) -> Array:
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        out = np.empty((4, x.size))
        _sample(*self.arrays(), x.ravel(), y.ravel(), out)
        return np.asarray(out.reshape(4, *x.shape))


FLAT = Terrain()
