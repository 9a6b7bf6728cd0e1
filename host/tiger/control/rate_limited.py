"""The rate-limited motion of roll and pitch that is nearest to a ground known ahead.

    least sum of |ground - motion|^2   with   |roll rate|/roll limit + |pitch rate|/pitch limit <= 1

The four actuators share one speed, so that the rates of both axes lie in a rhombus. A convex quadratic
programme; solved by the accelerated projected gradient method (FISTA; Beck and Teboulle 2009), whose
projection on the rhombus is known in closed form. Over a whole ride it is the bound of what any follower can
do, with all the ground known; over the next half second, from where the body is now, its first rate is what
to do now.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def in_rhombus(rate: Array, limits: tuple[float, float]) -> Array:
    """Project each row (n, 2) on |roll|/limit + |pitch|/limit <= 1."""
    across, along = 1.0 / limits[0], 1.0 / limits[1]
    size = np.abs(rate)
    excess = np.maximum(size[:, 0] * across + size[:, 1] * along - 1.0, 0.0) / (across**2 + along**2)
    roll, pitch = size[:, 0] - excess * across, size[:, 1] - excess * along
    # Beyond a corner of the rhombus the corner is nearest.
    alone_pitch, alone_roll = roll < 0.0, pitch < 0.0
    roll = np.where(alone_pitch, 0.0, np.where(alone_roll, np.minimum(size[:, 0], limits[0]), roll))
    pitch = np.where(alone_roll, 0.0, np.where(alone_pitch, np.minimum(size[:, 1], limits[1]), pitch))
    return np.copysign(np.stack([roll, pitch], axis=1), rate)


def nearest_motion(
    ground: Array,
    limits: tuple[float, float],
    dt: float,
    iterations: int,
    start: Array | None = None,
    guess: Array | None = None,
) -> tuple[Array, Array]:
    """Return the rates (n, 2) before each sample of `ground` (n, 2), and what then is left of it (n, 2).

    It starts from `start` (2,) one sample before the ground begins; None: from wherever is best. `guess`
    (n, 2) are rates to begin the search with.
    """
    n = len(ground)
    rate = np.zeros((n, 2)) if guess is None else guess
    place = ground.mean(axis=0) if start is None else start
    norm2 = (2.0 * n * dt / math.pi) ** 2
    norm2 *= 1.0 if start is not None else 2.0
    free = 0.0 if start is not None else 1.0 / (2.0 * n)
    ahead, ahead_place, momentum = rate, place, 1.0
    for _ in range(iterations):
        missed = ahead_place + dt * np.cumsum(ahead, axis=0) - ground
        slope = dt * np.cumsum(missed[::-1], axis=0)[::-1]
        new = in_rhombus(ahead - slope / norm2, limits)
        new_place = ahead_place - free * missed.sum(axis=0)
        later = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum * momentum))
        swing = (momentum - 1.0) / later
        ahead, ahead_place = new + swing * (new - rate), new_place + swing * (new_place - place)
        rate, place, momentum = new, new_place, later
    return rate, ground - place - dt * np.cumsum(rate, axis=0)


def distance_to_optimum(rate: Array, left: Array, limits: tuple[float, float], dt: float) -> float:
    """Return how much lower, at most, the sum of squares of any rate-limited motion is than that of `left`.

    The duality gap of Frank and Wolfe: nothing is below |left|^2 less this.
    """
    slope = -2.0 * dt * np.cumsum(left[::-1], axis=0)[::-1]
    lowest = -np.maximum(np.abs(slope[:, 0]) * limits[0], np.abs(slope[:, 1]) * limits[1]).sum()
    return float((slope * rate).sum() - lowest)
