"""The robot's body on the tilting plate: the linear 7-DOF model, advanced exactly, a step at a time.

Six inputs: roll and pitch of the plate under the four wheels (rad), and the lifts of the four mechanisms from
mid-stroke (m, FL FR RL RR). They are straight lines over a step, so the extended system of state, inputs and
their change needs no input of its own and its matrix exponential is exact: a step is one matrix product.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from tiger.models.full_car import (
    BODY_ACCELERATION,
    LIFT,
    LIFT_RATE,
    ROAD,
    SUSPENSION,
    SUSPENSION_RATE,
    FullCarParameters,
    full_car,
)

Array = NDArray[np.float64]

_STATES = 14
_INPUTS = 6


class BodyOnPlate:
    """Motion of the body and forces of its springs; starts at rest under the inputs given."""

    def __init__(self, parameters: FullCarParameters, inputs: Sequence[float]) -> None:
        self._build(parameters)
        self._z = np.zeros(_STATES + 2 * _INPUTS)
        # Views of one vector: state, inputs at the start of a step, their change over it.
        self._state = self._z[:_STATES]
        self._inputs = self._z[_STATES : _STATES + _INPUTS]
        self._change = self._z[_STATES + _INPUTS :]
        self._inputs[:] = inputs
        self._state[:] = -np.linalg.solve(self._a, self._b @ self._inputs)
        self._publish((self._c @ self._state + self._d @ self._inputs).tolist())

    def prepare(self, dt_s: float) -> None:
        """Make the matrix of steps of `dt_s`: (state, inputs, change) to (state, accelerations, forces)."""
        n, m = _STATES, _INPUTS
        extended = np.zeros((n + 2 * m, n + 2 * m))
        extended[:n, :n] = self._a
        extended[:n, n : n + m] = self._b
        extended[:n, n + m :] = self._b_rate / dt_s
        extended[n : n + m, n + m :] = np.eye(m) / dt_s
        to_state = expm(extended * dt_s)[:n]
        to_inputs = np.hstack([np.zeros((m, n)), np.eye(m), np.eye(m)])
        to_rates = np.hstack([np.zeros((m, n + m)), np.eye(m) / dt_s])
        to_outputs = self._c @ to_state + self._d @ to_inputs + self._d_rate @ to_rates
        self._matrix = np.vstack([to_state, to_outputs])

    def advance(self, inputs: Sequence[float]) -> None:
        """Move one step of the prepared length, at whose end the inputs are `inputs` (6,)."""
        change = self._change
        change[:] = inputs
        change -= self._inputs
        result = self._matrix.dot(self._z)
        self._state[:] = result[:_STATES]
        self._inputs += change
        self._publish(result[_STATES:].tolist())

    def _publish(self, outputs: list[float]) -> None:
        self.heave_m: float
        self.heave_m, _, self.pitch_rad, self.pitch_rate_radps, self.roll_rad, self.roll_rate_radps = (
            self._state[:6].tolist()
        )
        self.heave_accel_mps2, self.pitch_accel_radps2, self.roll_accel_radps2 = outputs[:3]
        # Forces of the four springs and dampers beyond the static load, + pushes the body up.
        self.spring_n = outputs[3:]

    def _build(self, parameters: FullCarParameters) -> None:
        """Make x' = a x + b u + b_rate u', y = c x + d u + d_rate u'; y: accelerations and spring forces."""
        model = full_car(parameters).select(
            inputs=(*ROAD, *LIFT, *LIFT_RATE),
            outputs=(*BODY_ACCELERATION, *SUSPENSION, *SUSPENSION_RATE),
        )
        stiffness, damping = np.diag(parameters.spring_npm()), np.diag(parameters.damper_nspm())
        of_inputs, of_rates = np.zeros((12, _INPUTS)), np.zeros((12, _INPUTS))
        of_inputs[:4, :2] = parameters.corner_kinematics()[:, [2, 1]]
        of_inputs[4:8, 2:] = np.eye(4)
        of_rates[8:, 2:] = np.eye(4)
        # A spring is compressed by lift - (corner - wheel).
        of_outputs = block_diag(np.eye(3), np.hstack([-stiffness, -damping]))
        self._a, self._b, self._b_rate = model.a, model.b @ of_inputs, model.b @ of_rates
        self._c, self._d = of_outputs @ model.c, of_outputs @ model.d @ of_inputs
        self._d_rate = of_outputs @ model.d @ of_rates
        self._d[3:, 2:] += stiffness
        self._d_rate[3:, 2:] += damping
