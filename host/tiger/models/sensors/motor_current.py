"""The current of an in-wheel motor as its controller reports it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MotorCurrent:
    """Current against shaft torque, and its measurement.

    Torque constant from Table 3.3: 350 W at 24 V is 14.6 A, and at 800 rpm 4.18 Nm. No-load current and noise
    are chosen; the step is the controller's digit.
    """

    torque_per_amp_nm: float = 4.18 / 14.6
    no_load_a: float = 0.6
    noise_a: float = 0.15
    step_a: float = 0.1
    limit_a: float = 60.0

    def true_a(self, torque_nm: ArrayLike, speed_radps: ArrayLike) -> Array:
        """Return the motor current that makes a torque; friction takes the no-load current while it turns."""
        drag = self.no_load_a * np.tanh(np.asarray(speed_radps, dtype=float) / 0.5)
        current = np.asarray(torque_nm, dtype=float) / self.torque_per_amp_nm + drag
        return np.asarray(np.minimum(np.maximum(current, -self.limit_a), self.limit_a))

    def measured_a(self, current_a: ArrayLike, random: np.random.Generator | None = None) -> Array:
        """Return what the controller reports of each current."""
        current = np.asarray(current_a, dtype=float)
        if random is not None:
            current = current + self.noise_a * random.standard_normal(current.shape)
        if self.step_a > 0.0:
            current = np.rint(current / self.step_a) * self.step_a
        return np.asarray(current, dtype=float)

    def torque_nm(self, current_a: ArrayLike, speed_radps: ArrayLike) -> Array:
        """Estimate the torque from a current (inverse of `true_a` below the limit)."""
        drag = self.no_load_a * np.tanh(np.asarray(speed_radps, dtype=float) / 0.5)
        return np.asarray((np.asarray(current_a, dtype=float) - drag) * self.torque_per_amp_nm)
