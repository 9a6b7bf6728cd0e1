"""The body with 14 degrees of freedom on any terrain (`models.vehicle`), its wheels driven on the ground.

A step is one call into compiled code: drives, Runge-Kutta steps, and what the IMU feels. Each wheel has a
speed loop as in the Roboteq, proportional and integral, whose torque keeps within the vehicle's limit.

The plate of the experiments is the ground's plane, tilting about the origin: over a step its slope is that of
the start, and posts under the wheels carry on its motion, so that height is continuous and damping right.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import asin, atan2, ceil, cos, isnan, nan, pi, sin, tan
from threading import Timer
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiger.config.tire import load_soil
from tiger.emulation.body import Motion
from tiger.emulation.ground import make_terrain
from tiger.models import vehicle_kernel as kernel
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.jit import Record, jit, record
from tiger.models.vehicle import Inputs, Vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import Scenario

Array = NDArray[np.float64]

LONGEST_STEP_S = 1e-3
LOADED_LAG_S = 0.25
"""Of a wheel's speed loop when it moves its share of the vehicle: a step of 15 rpm then takes 4 Nm, 13 A."""

INTEGRAL_TIME_S = 4.0 * LOADED_LAG_S
"""Of the wheels' speed loops: their two poles coincide when the wheels carry the vehicle."""

NOTICE_AFTER_S = 3.0
NOTICE = "Compiling the vehicle model for this computer: once, some ten seconds."

DRIVE = np.dtype([(name, np.float64) for name in ("gain", "integral_gain", "torque_max", "gravity")])
"""Four equal speed loops as compiled code reads them."""

ACCEL, RATE, SPRING, WHEEL_SPEED = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 14)
SPRING_AT, WHEEL_SPEED_AT = 6, 10
SENSED = 14


@jit
def _drive(
    drive: Record, state: Array, inputs: Array, command: Array, integral: Array, angle: Array, dt: float
) -> None:
    """Set the motors' torques for the next `dt` and let the wheels' angles follow."""
    d = drive[0]
    for i in range(4):
        speed = state[kernel.SPIN_AT + i] - state[11]
        angle[i] += speed * dt
        error = command[i] - speed
        if isnan(error):  # no command: the motor is off
            inputs[kernel.TORQUE_AT + i] = integral[i] = 0.0
            continue
        torque = d.gain * error + integral[i]
        limited = min(max(torque, -d.torque_max), d.torque_max)
        if torque == limited or torque * error < 0.0:
            integral[i] += d.integral_gain * error * dt
        inputs[kernel.TORQUE_AT + i] = limited


@jit
def _sense(
    vehicle: Record, gravity: float, state: Array, rate: Array, contact: Array, imu: Array, sensed: Array
) -> None:
    """Write what the IMU feels at its place, the springs' forces and the wheels' speeds."""
    v = vehicle[0]
    u, side, rise = state[7], state[8], state[9]
    p, q, r = state[10], state[11], state[12]
    pp, qq, rr = rate[10], rate[11], rate[12]
    w, a, b, c = state[3], state[4], state[5], state[6]
    x, y, z = imu[0], imu[1], imu[2]
    along, square = p * x + q * y + r * z, p * p + q * q + r * r
    up_x, up_y = 2.0 * (a * c - b * w), 2.0 * (b * c + a * w)
    up_z = 1.0 - 2.0 * (a * a + b * b)
    sensed[0] = rate[7] + q * rise - r * side + gravity * up_x + qq * z - rr * y + along * p - square * x
    sensed[1] = rate[8] + r * u - p * rise + gravity * up_y + rr * x - pp * z + along * q - square * y
    sensed[2] = rate[9] + p * side - q * u + gravity * up_z + pp * y - qq * x + along * r - square * z
    sensed[3], sensed[4], sensed[5] = p, q, r
    for i in range(4):
        sensed[SPRING_AT + i] = contact[i, kernel.STRUT_FORCE_AT] - v.preload[i]
        sensed[WHEEL_SPEED_AT + i] = state[kernel.SPIN_AT + i] - q


@jit
def _post_rates(vehicle: Record, state: Array, turning: Array, inputs: Array) -> None:
    """Let posts under the wheels rise as the plate does that changes its slopes (x, y) at `turning`."""
    v = vehicle[0]
    w, a, b, c = state[3], state[4], state[5], state[6]
    for i in range(4):
        x, y, z = v.x[i], v.y[i], v.wheel_height + state[kernel.STRUT_AT + i]
        east = state[0] + (1.0 - 2.0 * (b * b + c * c)) * x
        east += 2.0 * (a * b - c * w) * y + 2.0 * (a * c + b * w) * z
        north = state[1] + 2.0 * (a * b + c * w) * x
        north += (1.0 - 2.0 * (a * a + c * c)) * y + 2.0 * (b * c - a * w) * z
        inputs[kernel.POST_RATE_AT + i] = turning[0] * east + turning[1] * north


@jit
def _advance(
    vehicle: Record,
    tire: Record,
    soil: Record,
    ground: Record,
    features: Record,
    heights: Array,
    drive: Record,
    state: Array,
    inputs: Array,
    command: Array,
    integral: Array,
    angle: Array,
    turning: Array,
    dt: float,
    steps: int,
    imu: Array,
    rate: Array,
    contact: Array,
    sensed: Array,
) -> None:
    """Move `state` by `steps` of `dt`, then sense; lifts and plate go on at their rates meanwhile."""
    for _ in range(steps):
        _drive(drive, state, inputs, command, integral, angle, dt)
        _post_rates(vehicle, state, turning, inputs)
        kernel.advance(vehicle, tire, soil, ground, features, heights, state, inputs, dt, 1, contact)
        for i in range(4):
            inputs[kernel.LIFT_AT + i] += dt * inputs[kernel.LIFT_RATE_AT + i]
        ground[0].slope_x += dt * turning[0]
        ground[0].slope_y += dt * turning[1]
    kernel.derivative(vehicle, tire, soil, ground, features, heights, state, inputs, 0.0, rate, contact)
    _sense(vehicle, drive[0].gravity, state, rate, contact, imu, sensed)


class VehicleBody:
    """See `body.Body`. Starts at rest on the ground, wheels locked until then, or rolling at a speed."""

    def __init__(
        self,
        config: VehicleConfig,
        scenario: Scenario,
        plate_rad: tuple[float, float],
        lift_m: Sequence[float],
    ) -> None:
        config = _as_in(scenario, config)
        terrain = make_terrain(scenario.terrain, config.body.half_track_m)
        self._slopes = terrain.slope_x, terrain.slope_y
        self._plate_rad = plate_rad
        slope_x, slope_y = self._with_plate(plate_rad)
        soil = load_soil(scenario.soil) if scenario.soil is not None else None
        self._vehicle = Vehicle(config, replace(terrain, slope_x=slope_x, slope_y=slope_y), soil=soil)
        self._ground = self._vehicle.plant[3]
        self._loops = _drive_record(config)
        self._imu = self._vehicle.imu_place_m
        self._com_height_m = self._vehicle.com_height_m
        self._inputs = Inputs()
        self._inputs.wheel_speed_radps[:] = nan
        self._inputs.lift_m[:] = self._lift_m = list(lift_m)
        self._command = np.zeros(4)
        self._wheel_rpm: Sequence[float] = (0.0,) * 4
        self._integral, self._angle, self._turning = np.zeros(4), np.zeros(4), np.zeros(2)
        self._moves = False  # plate or lifts
        self._rate, self._sensed = np.zeros(kernel.STATES), np.zeros(SENSED)
        self._contact = np.zeros((4, kernel.CONTACT_FIGURES))
        self._accel, self._body_rate = self._sensed[ACCEL], self._sensed[RATE]
        self._spring, self._wheel_speed = self._sensed[SPRING], self._sensed[WHEEL_SPEED]

        notice = Timer(NOTICE_AFTER_S, print, (NOTICE,), {"file": sys.stderr, "flush": True})
        notice.daemon = True
        notice.start()
        try:
            start = scenario.start
            stands = self._vehicle.at_rest(start.x_m, start.y_m, start.yaw_deg * pi / 180.0)
            self._state = self._vehicle.settle(stands, inputs=self._inputs)
            self._state[kernel.VELOCITY.start] += start.speed_mps
            self._state[kernel.SPIN] = start.speed_mps / config.tire.rolling_radius_m
            self._command[:] = start.speed_mps / config.tire.rolling_radius_m
            self._dt_s = LONGEST_STEP_S
            self._substep_s, self._substeps = LONGEST_STEP_S, 0
            self._run()
            self._integral[:] = self._contact[:, kernel.FX_AT] * config.tire.rolling_radius_m  # hold it here
        finally:
            notice.cancel()

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw (as `euler_from_quaternion`, which takes arrays and ten times as long)."""
        w, x, y, z = self._state[kernel.ATTITUDE].tolist()
        return (
            atan2(2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            asin(min(1.0, max(-1.0, 2.0 * (y * w - x * z)))),
            atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)),
        )

    @property
    def accel_mps2(self) -> Array:
        """Specific force where the IMU sits, (3,), body axes."""
        return self._accel

    @property
    def rate_radps(self) -> Array:
        """Body rates, (3,)."""
        return self._body_rate

    @property
    def spring_n(self) -> Sequence[float]:
        """Forces of the struts beyond the weight of the empty body."""
        forces: list[float] = self._spring.tolist()
        return forces

    @property
    def wheel_radps(self) -> Sequence[float]:
        """Speeds of the wheels against their carriers."""
        speeds: list[float] = self._wheel_speed.tolist()
        return speeds

    @property
    def wheel_angle_rad(self) -> Sequence[float]:
        """How far the wheels have turned against their carriers."""
        angles: list[float] = self._angle.tolist()
        return angles

    @property
    def wheel_torque_nm(self) -> Sequence[float]:
        """What the motors do, within their limit."""
        torques: list[float] = self._inputs.wheel_torque_nm.tolist()
        return torques

    def motion(self) -> Motion:
        """What no sensor tells, at this moment."""
        roll, pitch, _ = self.attitude_rad
        p, q, r = self._body_rate.tolist()
        x, y, z = self._state[kernel.POSITION].tolist()
        turning = q * sin(roll) + r * cos(roll)
        a, b, c, d = self._contact[:, kernel.LOAD_AT].tolist()
        ka, kb, kc, kd = self._state[kernel.KAPPA_AT : kernel.KAPPA_AT + 4].tolist()
        return Motion(
            roll_rate_radps=p + tan(pitch) * turning,
            pitch_rate_radps=q * cos(roll) - r * sin(roll),
            position_m=(x, y, z),
            speed_mps=float(self._state[kernel.VELOCITY.start]),
            heave_m=z - 0.25 * sum(self._contact[:, kernel.GROUND_AT].tolist()) - self._com_height_m,
            wheel_load_n=(a, b, c, d),
            slip_ratio=(ka, kb, kc, kd),
        )

    def prepare(self, dt_s: float) -> None:
        """Divide a step into Runge-Kutta steps of at most a millisecond."""
        self._dt_s = dt_s
        self._substeps = ceil(dt_s / LONGEST_STEP_S - 1e-9)
        self._substep_s = dt_s / self._substeps

    def advance(
        self, plate_rad: tuple[float, float], lift_m: Sequence[float], wheel_rpm: Sequence[float]
    ) -> None:
        """Move one step; a wheel whose command is NaN is let run free."""
        if wheel_rpm != self._wheel_rpm:
            self._wheel_rpm = wheel_rpm
            self._command[:] = wheel_rpm
            self._command *= pi / 30.0
        if self._moves or plate_rad != self._plate_rad or lift_m != self._lift_m:
            self._set_in_motion(plate_rad, lift_m)
        self._run()

    def _run(self) -> None:
        _advance(
            *self._vehicle.plant,
            self._loops,
            self._state,
            self._inputs.vector,
            self._command,
            self._integral,
            self._angle,
            self._turning,
            self._substep_s,
            self._substeps,
            self._imu,
            self._rate,
            self._contact,
            self._sensed,
        )

    def _set_in_motion(self, plate_rad: tuple[float, float], lift_m: Sequence[float]) -> None:
        """Let lifts and plate go from where they are now to where they shall be at the end of the step."""
        inputs, lifts = self._inputs, list(lift_m)
        inputs.lift_m[:] = self._lift_m
        inputs.lift_rate_mps[:] = lifts
        inputs.lift_rate_mps -= inputs.lift_m
        inputs.lift_rate_mps /= self._dt_s
        before, after = self._with_plate(self._plate_rad), self._with_plate(plate_rad)
        self._ground["slope_x"], self._ground["slope_y"] = before
        self._turning[:] = (after[0] - before[0]) / self._dt_s, (after[1] - before[1]) / self._dt_s
        self._moves = plate_rad != self._plate_rad or lifts != self._lift_m
        self._plate_rad, self._lift_m = plate_rad, lifts

    def _with_plate(self, plate_rad: tuple[float, float]) -> tuple[float, float]:
        """Slopes along x and y of the terrain's plane on the tilted plate."""
        roll, pitch = plate_rad
        return self._slopes[0] - tan(pitch), self._slopes[1] + tan(roll)


def _as_in(scenario: Scenario, vehicle: VehicleConfig) -> VehicleConfig:
    """Return the vehicle with the scenario's friction and payload."""
    changes: dict[str, object] = {}
    if scenario.friction is not None:
        changes["tire"] = vehicle.tire.model_copy(update={"friction": scenario.friction})
    if scenario.payload is not None:
        changes["payload"] = scenario.payload
    return vehicle.model_copy(update=changes) if changes else vehicle


def _drive_record(config: VehicleConfig) -> Record:
    """Speed loops that follow a command with a lag of `LOADED_LAG_S` when each wheel moves its share."""
    tire = config.tire
    mass_kg = config.body.mass_kg + 2.0 * (config.front.unsprung_mass_kg + config.rear.unsprung_mass_kg)
    inertia = tire.spin_inertia_kgm2 + 0.25 * mass_kg * tire.rolling_radius_m**2
    gain = inertia / LOADED_LAG_S
    return record(
        DRIVE,
        {
            "gain": gain,
            "integral_gain": gain / INTEGRAL_TIME_S,
            "torque_max": np.inf if config.drive is None else config.drive.max_torque_nm,
            "gravity": GRAVITY_MPS2,
        },
    )
