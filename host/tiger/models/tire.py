"""Magic Formula tyre with combined slip, scaled to a vehicle by similarity (Pacejka 2006, ch. 4.3, App. 3).

ISO axes: F_x forward, F_y left. Slips: kappa = (w r - v_x)/|v_x| (erratum of eq. 5.13: one form for drive and
brake) and tan(alpha) = v_y/|v_x| (erratum of eq. 5.14), so F_x grows with kappa and F_y falls with alpha. In
a vehicle both slips are states of a first-order contact lag, `contact_slip_rates`: no division by speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, exp, hypot, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiger.models.jit import Record, Row, jit, record

if TYPE_CHECKING:
    from tiger.config.tire import TireSetConfig
    from tiger.config.vehicle import TireConfig

Array = NDArray[np.float64]

TIRE = np.dtype(
    [
        (name, np.float64)
        for name in (
            # Table A3.1
            *("pcx1", "pdx1", "pdx2", "pex1", "pex2", "pex3", "pkx1", "pkx2", "pkx3", "rbx1", "rbx2", "rcx1"),
            *("pcy1", "pdy1", "pdy2", "pey1", "pey2", "pky1", "pky2", "rby1", "rby2", "rcy1"),
            # the vehicle's tyre and its contact, SI
            *("nominal_load", "load_ratio_max", "friction", "relaxation_x", "relaxation_y", "damping"),
            *("damping_speed", "slip_limit", "rolling_resistance", "rolling_threshold"),
        )
    ]
)
"""A tyre as compiled code reads it."""


def tire_record(tire_set: TireSetConfig, tire: TireConfig) -> Record:
    """Scale a tyre set to a vehicle's tyre: its nominal load (similarity), grip and relaxation lengths."""
    return record(
        TIRE,
        {
            **tire_set.longitudinal.model_dump(),
            **tire_set.lateral.model_dump(),
            "nominal_load": tire.nominal_load_n,
            "load_ratio_max": tire_set.load_ratio_max,
            "friction": tire.friction,
            "relaxation_x": tire.longitudinal_relaxation_m,
            "relaxation_y": tire.lateral_relaxation_m,
            "damping": tire_set.standstill.damping_nspm,
            "damping_speed": tire_set.standstill.damping_fades_at_mps,
            "slip_limit": tire_set.standstill.slip_limit,
            "rolling_resistance": tire.rolling_resistance,
            "rolling_threshold": tire_set.standstill.rolling_threshold_mps,
        },
    )


# ---- compiled: t is a row of TIRE ------------


LEAST_LOAD_N = 1e-6
"""A tyre that carries less has lifted: below, stiffnesses are too small to divide by."""


@jit
def load_deviation(t: Row, load: float) -> float:
    """df_z of eq. 4.E2, held where the coefficients stop being meaningful."""
    return min(load / t.nominal_load, t.load_ratio_max) - 1.0


@jit
def longitudinal_stiffness(t: Row, load: float) -> float:
    """dF_x/dkappa at zero slip in N (eq. 4.E15)."""
    dfz = load_deviation(t, load)
    return load * (t.pkx1 + t.pkx2 * dfz) * exp(t.pkx3 * dfz)


@jit
def lateral_stiffness(t: Row, load: float) -> float:
    """dF_y/dtan(alpha) at zero slip in N, negative (eq. 4.E25; sin(2 atan u) = 2u/(1 + u^2))."""
    ratio = load / (t.pky2 * t.nominal_load)
    return t.pky1 * t.nominal_load * 2.0 * ratio / (1.0 + ratio * ratio)


@jit
def magic_formula(t: Row, grip: float, load: float, kappa: float, tan_alpha: float) -> tuple[float, float]:
    """(F_x, F_y) in N at a load > 0 in N and slips (eqs. 4.E9-4.E30 pure, 4.E50-4.E62 combined slip).

    `grip` is the share of the tyre's friction that the ground gives.
    """
    dfz = load_deviation(t, load)
    friction = grip * t.friction

    peak_x = (t.pdx1 + t.pdx2 * dfz) * friction * load
    curvature_x = min(1.0, t.pex1 + dfz * (t.pex2 + dfz * t.pex3))
    slip_x = longitudinal_stiffness(t, load) / (t.pcx1 * peak_x) * kappa
    pure_x = peak_x * sin(t.pcx1 * atan(slip_x - curvature_x * (slip_x - atan(slip_x))))

    peak_y = (t.pdy1 + t.pdy2 * dfz) * friction * load
    curvature_y = min(1.0, t.pey1 + t.pey2 * dfz)
    slip_y = lateral_stiffness(t, load) / (t.pcy1 * peak_y) * tan_alpha
    pure_y = peak_y * sin(t.pcy1 * atan(slip_y - curvature_y * (slip_y - atan(slip_y))))

    # Each slip takes grip from the other, at most all of it (C > 1 would turn the force round at large
    # slips); cos(atan u) = 1/sqrt(1 + u^2).
    weight_x = cos(t.rcx1 * atan(t.rbx1 / sqrt(1.0 + (t.rbx2 * kappa) ** 2) * tan_alpha))
    weight_y = cos(t.rcy1 * atan(t.rby1 / sqrt(1.0 + (t.rby2 * tan_alpha) ** 2) * kappa))
    return max(0.0, weight_x) * pure_x, max(0.0, weight_y) * pure_y


@jit
def contact_slip_rates(
    t: Row, slip_speed: float, forward_speed: float, side_speed: float, kappa: float, tan_alpha: float
) -> tuple[float, float]:
    """(kappa', tan(alpha)') of the contact's first-order lag (Pacejka 2006, ch. 7.2 and 8.6).

    sigma k' = (w r - v_x) - |v_x| k and sigma a' = v_y - |v_x| a. Sliding in place refreshes the contact too,
    so that the slips cannot wind up beyond `slip_limit` when the wheel spins or slides without rolling.
    """
    transport = max(abs(forward_speed), hypot(slip_speed, side_speed) / t.slip_limit)
    return (
        (slip_speed - transport * kappa) / t.relaxation_x,
        (side_speed - transport * tan_alpha) / t.relaxation_y,
    )


@jit
def contact_forces(
    t: Row,
    grip: float,
    load: float,
    slip_speed: float,
    forward_speed: float,
    side_speed: float,
    kappa: float,
    tan_alpha: float,
) -> tuple[float, float]:
    """(F_x, F_y) in N of the lagged slips, plus tread damping that fades with speed (ch. 8.6)."""
    if load < LEAST_LOAD_N:
        return 0.0, 0.0
    if abs(forward_speed) < t.damping_speed:
        damping = 0.5 * t.damping * (1.0 + cos(pi * forward_speed / t.damping_speed))
        # A tyre about to lift has next to no stiffness: the damping's share of the slip has the slip's limit.
        damping_kappa = damping * slip_speed / longitudinal_stiffness(t, load)
        damping_alpha = -damping * side_speed / lateral_stiffness(t, load)
        kappa += min(max(damping_kappa, -t.slip_limit), t.slip_limit)
        tan_alpha += min(max(damping_alpha, -t.slip_limit), t.slip_limit)
    return magic_formula(t, grip, load, kappa, tan_alpha)


@jit
def _forces(tire: Record, load: Array, kappa: Array, tan_alpha: Array, forces: Array) -> None:
    for i in range(load.size):
        if load[i] > 0.0:
            forces[0, i], forces[1, i] = magic_formula(tire[0], 1.0, load[i], kappa[i], tan_alpha[i])


# ---- for people ------------


@dataclass(frozen=True, slots=True, eq=False)
class Tire:
    """One tyre's forces over arrays of slips and loads."""

    parameters: Record

    @classmethod
    def from_config(cls, tire_set: TireSetConfig, tire: TireConfig) -> Tire:
        """Scale `tire_set` to the vehicle tyre `tire`."""
        return cls(tire_record(tire_set, tire))

    def forces(self, load_n: ArrayLike, kappa: ArrayLike, tan_alpha: ArrayLike) -> tuple[Array, Array]:
        """Return steady (F_x, F_y) in N; the three arguments broadcast. No load, no force."""
        load, k, a = np.broadcast_arrays(
            np.asarray(load_n, float), np.asarray(kappa, float), np.asarray(tan_alpha, float)
        )
        forces = np.zeros((2, load.size))
        _forces(self.parameters, load.ravel(), k.ravel(), a.ravel(), forces)
        return forces[0].reshape(load.shape), forces[1].reshape(load.shape)

    def stiffness(self, load_n: float) -> tuple[float, float]:
        """Return (C_kappa, C_alpha) in N per unit slip and N/rad at a load, both positive."""
        row = self.parameters[0]
        return float(longitudinal_stiffness(row, load_n)), -float(lateral_stiffness(row, load_n))
