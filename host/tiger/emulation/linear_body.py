"""The linear body: 7 degrees of freedom on a tilting plate, its wheels free to turn, as on stands.

Advanced exactly, a step at a time. Six inputs: roll and pitch of the plate under the four wheels (rad), and
the lifts of the four mechanisms from mid-stroke (m, FL FR RL RR). They are straight lines over a step, so the
extended system of state, inputs and their change needs no input of its own and its matrix exponential is
exact: a step is one matrix product. Compiled code makes the steps and adds wheels and what an IMU feels
(firmware/native/native_linear_body.cpp).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from tiger.emulation.body import Body, Motion
from tiger.models.full_car import (
    BODY_ACCELERATION,
    GRAVITY_MPS2,
    LIFT,
    LIFT_RATE,
    ROAD,
    SUSPENSION,
    SUSPENSION_RATE,
    FullCarParameters,
    full_car,
)
from tiger.native._core import ffi, lib

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.config.vehicle import VehicleConfig

Array = NDArray[np.float64]

WHEEL_LAG_S = 0.1
"""How long a drive takes to bring its free wheel to a commanded speed."""

_STATES = 14
_INPUTS = 6


class LinearBody(Body):
    """See `body.Body`. Starts at rest on the plate, with the mechanisms lifted as given."""

    step = lib.tiger_linear_step

    def __init__(
        self, vehicle: VehicleConfig, plate_rad: tuple[float, float], lift_m: Sequence[float]
    ) -> None:
        super().__init__()
        parameters = FullCarParameters.from_config(vehicle)
        self._plate = _OnPlate.of(parameters)
        self._com_height_m = vehicle.body.com_height_m
        self._static_load_n: list[float] = parameters.static_tire_load_n().tolist()
        self._tire_npm = vehicle.tire.vertical_stiffness_npm
        self._max_torque_nm = inf if vehicle.drive is None else vehicle.drive.max_torque_nm
        self.context: Any = ffi.new("tiger_linear_body *")
        self.context.imu_offset_m = vehicle.imu_offset_m
        self.context.gravity_mps2 = GRAVITY_MPS2
        self.context.spin_inertia_kgm2 = vehicle.tire.spin_inertia_kgm2
        z = np.frombuffer(ffi.buffer(ffi.addressof(self.context, "z")))
        self._state, self._inputs = z[:_STATES], z[_STATES : _STATES + _INPUTS]
        self._inputs[:] = (*plate_rad, *lift_m)
        self._state[:], outputs = self._plate.at_rest(self._inputs)
        self.context.outputs = outputs.tolist()
        lib.tiger_linear_feel(self.context, self.felt)
        self.prepare(1e-3)

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        return float(self._state[4]), float(self._state[2]), 0.0

    def motion(self) -> Motion:
        """What it does at this moment."""
        heave_m, _, _, pitch_rate, _, roll_rate = self._state[:6].tolist()
        squeeze_m = self._plate.corners @ self._inputs[:2] - self._state[6::2]
        fl, fr, rl, rr = (
            max(0.0, load + self._tire_npm * more)
            for load, more in zip(self._static_load_n, squeeze_m.tolist(), strict=True)
        )
        return Motion(
            roll_rate_radps=roll_rate,
            pitch_rate_radps=pitch_rate,
            position_m=(0.0, 0.0, self._com_height_m + heave_m),
            speed_mps=0.0,
            heave_m=heave_m,
            wheel_load_n=(fl, fr, rl, rr),
            slip_ratio=(0.0, 0.0, 0.0, 0.0),
        )

    def prepare(self, dt_s: float) -> None:
        """Compute what depends on the length of a step."""
        body = self.context
        body.dt_s = dt_s
        body.wheel_gain = 1.0 - exp(-dt_s / WHEEL_LAG_S)
        body.most_change_radps = self._max_torque_nm / body.spin_inertia_kgm2 * dt_s
        self._matrix = np.ascontiguousarray(self._plate.step_matrix(dt_s))  # kept: the body points to it
        body.matrix = ffi.from_buffer("double[]", self._matrix)


@dataclass(frozen=True, slots=True, eq=False)
class _OnPlate:
    """x' = a x + b u + b_rate u', y = c x + d u + d_rate u'; y: accelerations and spring forces."""

    a: Array
    b: Array
    b_rate: Array
    c: Array
    d: Array
    d_rate: Array
    corners: Array
    """Height of the plate under each wheel from its roll and pitch, (4, 2)."""

    @classmethod
    def of(cls, parameters: FullCarParameters) -> Self:
        """Put the 7-DOF model on a plate; forces of springs and dampers count beyond the static load."""
        model = full_car(parameters).select(
            inputs=(*ROAD, *LIFT, *LIFT_RATE),
            outputs=(*BODY_ACCELERATION, *SUSPENSION, *SUSPENSION_RATE),
        )
        stiffness, damping = np.diag(parameters.spring_npm()), np.diag(parameters.damper_nspm())
        of_inputs, of_rates = np.zeros((12, _INPUTS)), np.zeros((12, _INPUTS))
        corners = of_inputs[:4, :2] = parameters.corner_kinematics()[:, [2, 1]]
        of_inputs[4:8, 2:] = np.eye(4)
        of_rates[8:, 2:] = np.eye(4)
        # A spring is compressed by lift - (corner - wheel).
        of_outputs = block_diag(np.eye(3), np.hstack([-stiffness, -damping]))
        d, d_rate = of_outputs @ model.d @ of_inputs, of_outputs @ model.d @ of_rates
        d[3:, 2:] += stiffness
        d_rate[3:, 2:] += damping
        return cls(model.a, model.b @ of_inputs, model.b @ of_rates, of_outputs @ model.c, d, d_rate, corners)

    def at_rest(self, inputs: Array) -> tuple[Array, Array]:
        """Return state (14,) and outputs (7,) at rest under inputs (6,)."""
        state = np.asarray(-np.linalg.solve(self.a, self.b @ inputs), float)
        return state, np.asarray(self.c @ state + self.d @ inputs)

    def step_matrix(self, dt_s: float) -> Array:
        """Return the matrix of a step, (21, 26): (state, inputs, change) to (state, outputs)."""
        n, m = _STATES, _INPUTS
        extended = np.zeros((n + 2 * m, n + 2 * m))
        extended[:n, :n] = self.a
        extended[:n, n : n + m] = self.b
        extended[:n, n + m :] = self.b_rate / dt_s
        extended[n : n + m, n + m :] = np.eye(m) / dt_s
        to_state = expm(extended * dt_s)[:n]
        to_inputs = np.hstack([np.zeros((m, n)), np.eye(m), np.eye(m)])
        to_rates = np.hstack([np.zeros((m, n + m)), np.eye(m) / dt_s])
        to_outputs = self.c @ to_state + self.d @ to_inputs + self.d_rate @ to_rates
        return np.asarray(np.vstack([to_state, to_outputs]))
