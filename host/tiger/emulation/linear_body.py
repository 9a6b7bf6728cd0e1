"""The linear body: 7 degrees of freedom on a tilting plate, its wheels free to turn, as on stands.

`BodyOnPlate` is the model, advanced exactly, a step at a time. Six inputs: roll and pitch of the plate under
the four wheels (rad), and the lifts of the four mechanisms from mid-stroke (m, FL FR RL RR). They are
straight lines over a step, so the extended system of state, inputs and their change needs no input of its own
and its matrix exponential is exact: a step is one matrix product. `LinearBody` adds wheels and an IMU.
"""

from __future__ import annotations

from math import cos, exp, inf, pi, sin
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from tiger.emulation.body import Motion
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

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.config.vehicle import VehicleConfig

Array = NDArray[np.float64]

WHEEL_LAG_S = 0.1
"""How long a drive takes to bring its free wheel to a commanded speed."""

_STATES = 14
_INPUTS = 6


class LinearBody:
    """See `body.Body`. Starts at rest on the plate, with the mechanisms lifted as given."""

    def __init__(
        self, vehicle: VehicleConfig, plate_rad: tuple[float, float], lift_m: Sequence[float]
    ) -> None:
        parameters = FullCarParameters.from_config(vehicle)
        self._body = BodyOnPlate(parameters, (*plate_rad, *lift_m))
        self._imu_offset_m = vehicle.imu_offset_m
        self._com_height_m = vehicle.body.com_height_m
        self._static_load_n: list[float] = parameters.static_tire_load_n().tolist()
        self._tire_npm = vehicle.tire.vertical_stiffness_npm
        self._spin_inertia_kgm2 = vehicle.tire.spin_inertia_kgm2
        self._max_torque_nm = inf if vehicle.drive is None else vehicle.drive.max_torque_nm
        self.accel_mps2, self.rate_radps = np.zeros(3), np.zeros(3)
        self.wheel_radps = [0.0] * 4
        self.wheel_angle_rad = [0.0] * 4
        self.wheel_torque_nm = [0.0] * 4
        self._feel()

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        return self._body.roll_rad, self._body.pitch_rad, 0.0

    @property
    def spring_n(self) -> Sequence[float]:
        """Forces of the springs beyond the body's weight."""
        return self._body.spring_n

    def motion(self) -> Motion:
        """What it does at this moment."""
        body = self._body
        squeeze = body.tire_squeeze_m()
        fl, fr, rl, rr = (
            max(0.0, load + self._tire_npm * more)
            for load, more in zip(self._static_load_n, squeeze, strict=True)
        )
        return Motion(
            roll_rate_radps=body.roll_rate_radps,
            pitch_rate_radps=body.pitch_rate_radps,
            position_m=(0.0, 0.0, self._com_height_m + body.heave_m),
            speed_mps=0.0,
            heave_m=body.heave_m,
            wheel_load_n=(fl, fr, rl, rr),
            slip_ratio=(0.0, 0.0, 0.0, 0.0),
        )

    def prepare(self, dt_s: float) -> None:
        """Compute what depends on the length of a step."""
        self._dt_s = dt_s
        self._wheel_gain = 1.0 - exp(-dt_s / WHEEL_LAG_S)
        self._most_change_radps = self._max_torque_nm / self._spin_inertia_kgm2 * dt_s
        self._body.prepare(dt_s)

    def advance(
        self, plate_rad: tuple[float, float], lift_m: Sequence[float], wheel_rpm: Sequence[float]
    ) -> None:
        """Move one step, at whose end plate and lifts are as given."""
        self._turn_wheels(wheel_rpm)
        self._body.advance((*plate_rad, *lift_m))
        self._feel()

    def _turn_wheels(self, wheel_rpm: Sequence[float]) -> None:
        speeds, most = self.wheel_radps, self._most_change_radps
        for wheel, rpm in enumerate(wheel_rpm):
            speed = speeds[wheel]
            if rpm == 0.0 and -1e-9 < speed < 1e-9:
                speeds[wheel] = self.wheel_torque_nm[wheel] = 0.0
                continue
            change = self._wheel_gain * (rpm * (pi / 30.0) - speed)
            change = most if change > most else -most if change < -most else change
            self.wheel_torque_nm[wheel] = self._spin_inertia_kgm2 * change / self._dt_s
            self.wheel_angle_rad[wheel] += (speed + 0.5 * change) * self._dt_s
            speeds[wheel] = speed + change

    def _feel(self) -> None:
        """Let the IMU feel the motion of the point where it sits."""
        body = self._body
        pitch, pitch_rate, pitch_accel = body.pitch_rad, body.pitch_rate_radps, body.pitch_accel_radps2
        roll, roll_rate, roll_accel = body.roll_rad, body.roll_rate_radps, body.roll_accel_radps2
        sin_roll, cos_roll = sin(roll), cos(roll)
        level = cos(pitch)
        ux, uy, uz = -sin(pitch), sin_roll * level, cos_roll * level
        # Angular rate and acceleration in body axes for yaw-pitch-roll angles without yaw.
        p, q, r = roll_rate, pitch_rate * cos_roll, -pitch_rate * sin_roll
        pp = roll_accel
        qq = pitch_accel * cos_roll + roll_rate * r
        rr = -pitch_accel * sin_roll - roll_rate * q
        x, y, z = self._imu_offset_m
        pushed = body.heave_accel_mps2 + GRAVITY_MPS2
        along = p * x + q * y + r * z
        square = p * p + q * q + r * r
        accel, rate = self.accel_mps2, self.rate_radps
        accel[0] = pushed * ux + qq * z - rr * y + along * p - square * x
        accel[1] = pushed * uy + rr * x - pp * z + along * q - square * y
        accel[2] = pushed * uz + pp * y - qq * x + along * r - square * z
        rate[0], rate[1], rate[2] = p, q, r


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

    def tire_squeeze_m(self) -> list[float]:
        """How much each tyre is squeezed beyond its static load."""
        road = self._corners @ self._inputs[:2]
        wheels: list[float] = (road - self._state[6::2]).tolist()
        return wheels

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
        self._corners = of_inputs[:4, :2] = parameters.corner_kinematics()[:, [2, 1]]
        of_inputs[4:8, 2:] = np.eye(4)
        of_rates[8:, 2:] = np.eye(4)
        # A spring is compressed by lift - (corner - wheel).
        of_outputs = block_diag(np.eye(3), np.hstack([-stiffness, -damping]))
        self._a, self._b, self._b_rate = model.a, model.b @ of_inputs, model.b @ of_rates
        self._c, self._d = of_outputs @ model.c, of_outputs @ model.d @ of_inputs
        self._d_rate = of_outputs @ model.d @ of_rates
        self._d[3:, 2:] += stiffness
        self._d_rate[3:, 2:] += damping
