"""Loose ground under a wheel: Bekker's pressure-sinkage, Janosi-Hanamoto shear (Remark 5.1, section 4.4.3).

A wheel of radius r and width b sinks to z under the load W (Bekker; Wong, Theory of Ground Vehicles, ch. 2):

    W = (3 - n)/3 * b * (k_c/b + k_phi) * sqrt(2 r) * z^(n + 1/2)

presses the soil down against a resistance R = b (k_c/b + k_phi) z^(n + 1)/(n + 1), and stands on a patch of
length L = sqrt(2 r z) that shears off at A c + W tan(phi), A = b L. Along the patch the shear builds up with
the sliding so far (Janosi and Hanamoto), tau = tau_max (1 - exp(-j/K)), j = s x. Over the whole patch that
makes tau_max A (1 - (1 - exp(-u))/u) with u = s L/K, opposite to the sliding.

Every wheel rolls on fresh soil: no ruts, no rebound of its own, no bulldozing sideways.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import expm1, hypot, radians, sqrt, tan, tanh
from typing import TYPE_CHECKING

import numpy as np

from tiger.models.jit import Record, Row, jit, record

if TYPE_CHECKING:
    from tiger.config.tire import SoilConfig, TireSetConfig
    from tiger.config.vehicle import TireConfig

SOIL = np.dtype(
    [
        ("soft", np.bool_),
        ("stiffness", np.float64),
        ("exponent", np.float64),
        ("cohesion", np.float64),
        ("tan_friction", np.float64),
        ("shear_modulus", np.float64),
        ("wheel_radius", np.float64),
        ("wheel_width", np.float64),
    ]
)
"""A soil under one wheel as compiled code reads it; `stiffness` is k_c/b + k_phi, not `soft` means a road."""

_NEWTON_STEPS = 30
_NEWTON_TOLERANCE_M = 1e-12


def soil_record(soil: SoilConfig | None, tire_set: TireSetConfig, tire: TireConfig) -> Record:
    """Combine a soil and a wheel (width scaled from the tyre set by radius); None stands for a hard road."""
    width = tire_set.width_m * tire.rolling_radius_m / tire_set.unloaded_radius_m
    names = SOIL.names or ()
    if soil is None:
        return record(SOIL, dict.fromkeys(names, 0))
    return record(
        SOIL,
        {
            "soft": True,
            "stiffness": soil.cohesive_modulus_npm / width + soil.frictional_modulus_npm2,
            "exponent": soil.sinkage_exponent,
            "cohesion": soil.cohesion_pa,
            "tan_friction": tan(radians(soil.friction_angle_deg)),
            "shear_modulus": soil.shear_modulus_m,
            "wheel_radius": tire.rolling_radius_m,
            "wheel_width": width,
        },
    )


# ---- compiled: s is a row of SOIL ------------


@jit
def _bearing(s: Row) -> float:
    """Load in N over sinkage^(n + 1/2)."""
    return (3.0 - s.exponent) / 3.0 * s.wheel_width * s.stiffness * sqrt(2.0 * s.wheel_radius)


@jit
def sinkage_of_load(s: Row, load: float) -> float:
    """Sinkage z in m that carries a load in N."""
    return float((max(load, 0.0) / _bearing(s)) ** (1.0 / (s.exponent + 0.5)))


@jit
def sinkage_of_tire(s: Row, tire_stiffness: float, compression: float) -> float:
    """Sinkage z in m when tyre and soil in series share a compression in m: k (d - z) = W(z).

    Newton from above the root: both sides are monotonic. A step that would pass zero is cut to half the way.
    """
    if compression <= 0.0:
        return 0.0
    bearing, power = _bearing(s), s.exponent + 0.5
    z = min(compression, float((tire_stiffness * compression / bearing) ** (1.0 / power)))
    for _ in range(_NEWTON_STEPS):
        load = bearing * z**power
        step = (load - tire_stiffness * (compression - z)) / (power * load / z + tire_stiffness)
        z = z - step if step < z else 0.5 * z
        if abs(step) < _NEWTON_TOLERANCE_M:
            break
    return z


@jit
def soil_forces(s: Row, load: float, sinkage: float, kappa: float, tan_alpha: float) -> tuple[float, float]:
    """Shear (F_x, F_y) in N, both opposite to the sliding (kappa, tan alpha as for a tyre)."""
    if load <= 0.0:
        return 0.0, 0.0
    length = sqrt(2.0 * s.wheel_radius * sinkage)
    strength = s.wheel_width * length * s.cohesion + load * s.tan_friction
    slip = hypot(kappa, tan_alpha)
    u = slip * length / s.shear_modulus
    # (1 - (1 - exp(-u))/u)/slip, by its series where the difference would cancel
    if u > 1e-4:
        mobilised = (1.0 + expm1(-u) / u) / slip
    else:
        mobilised = (0.5 - u / 6.0) * length / s.shear_modulus
    return strength * mobilised * kappa, -strength * mobilised * tan_alpha


@jit
def compaction_resistance(s: Row, sinkage: float) -> float:
    """Force in N it takes to press the rut; it acts through the wheel's centre, against its motion."""
    power = s.exponent + 1.0
    return s.wheel_width * s.stiffness * float(sinkage**power) / power


@jit
def rolling_direction(speed: float, threshold: float) -> float:
    """Smooth sign of a speed in m/s: no chatter at rest."""
    return tanh(speed / threshold)


# ---- for people ------------


@dataclass(frozen=True, slots=True, eq=False)
class SoilContact:
    """One wheel on one soil, steady: the sinkage, resistance and pull of a loaded, slipping, rigid wheel."""

    parameters: Record

    @classmethod
    def from_config(cls, soil: SoilConfig, tire_set: TireSetConfig, tire: TireConfig) -> SoilContact:
        """Put the wheel of `tire` on `soil`."""
        return cls(soil_record(soil, tire_set, tire))

    def sinkage_m(self, load_n: float) -> float:
        """Return the sinkage under a load."""
        return float(sinkage_of_load(self.parameters[0], load_n))

    def compaction_resistance_n(self, load_n: float) -> float:
        """Return the force it takes to press the rut under a load."""
        return float(compaction_resistance(self.parameters[0], self.sinkage_m(load_n)))

    def forces(self, load_n: float, kappa: float, tan_alpha: float) -> tuple[float, float]:
        """Return the shear forces (F_x, F_y) in N."""
        x, y = soil_forces(self.parameters[0], load_n, self.sinkage_m(load_n), kappa, tan_alpha)
        return float(x), float(y)

    def drawbar_pull_n(self, load_n: float, kappa: float) -> float:
        """Return what is left for pulling: shear force less compaction resistance, at a driving slip."""
        return self.forces(load_n, kappa, 0.0)[0] - self.compaction_resistance_n(load_n)
