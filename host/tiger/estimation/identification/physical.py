"""Fit the thirteen parameters of the seven-degree-of-freedom car to measured responses.

Masses, inertias and springs are all identifiable here because the forces are known. The structure is assumed
right, which is why few parameters do with little signal; what it cannot explain shows in the cost.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from tiger.models.full_car import (
    BODY_ACCELERATION,
    FORCE,
    IMU,
    ROAD,
    FullCarParameters,
    full_car,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.estimation.identification.frf import FrfData

    Array = NDArray[np.float64]

PARAMETERS = tuple(f.name for f in fields(FullCarParameters) if f.name != "com_left_m")


@dataclass(frozen=True, slots=True, eq=False)
class PhysicalFit:
    """The car, the relative standard deviation of each of PARAMETERS, and the cost per degree of freedom (1 =
    right)."""

    car: FullCarParameters
    relative_std: Array
    cost: float


def fit(
    data: FrfData, start: FullCarParameters, imu_offset_m: tuple[float, float] = (0.0, 0.0)
) -> PhysicalFit:
    """Fit all of PARAMETERS from a start that may be tens of percent off.

    data: responses of IMU heave acceleration, pitch and roll acceleration to four roads and four forces,
    sampled by Tustin's rule (6.10). Raises ValueError where the fit does not converge.
    """
    warped_hz = data.warped_radps() / (2 * np.pi)
    on = np.isfinite(data.variance)
    weight = np.sqrt(2) * data.weight()[on]

    def residual(logarithms: Array) -> Array:
        car = _car(logarithms, start)
        model = full_car(car, imu_offset_m).select(
            inputs=(*ROAD, *FORCE), outputs=(IMU[0], *BODY_ACCELERATION[1:])
        )
        error = (model.frequency_response(warped_hz)[on] - data.response[on]) * weight
        return np.concatenate([error.real, error.imag])

    x0 = np.log(astuple(start)[: len(PARAMETERS)])
    solved = least_squares(residual, x0, method="lm", xtol=1e-10, ftol=1e-10)
    if not solved.success:
        raise ValueError(f"the physical fit did not converge ({solved.message}): start nearer to the vehicle")
    information = solved.jac.T @ solved.jac
    freedom = len(solved.fun) - len(x0)
    car = _car(solved.x, start)
    return PhysicalFit(car, np.sqrt(np.diag(np.linalg.pinv(information))), 2 * solved.cost / freedom)


def _car(logarithms: Array, start: FullCarParameters) -> FullCarParameters:
    return replace(start, **{name: float(v) for name, v in zip(PARAMETERS, np.exp(logarithms), strict=True)})
