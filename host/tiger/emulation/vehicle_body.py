"""The body with 14 degrees of freedom on any terrain (`models.vehicle`), its wheels driven on the ground.

A step is compiled: drives, Runge-Kutta steps, and what the IMU feels. Each wheel has a speed loop as in the
Roboteq, proportional and integral, whose torque keeps within the vehicle's limit.

The plate of the experiments is the ground's plane, tilting about the origin: over a step its slope is that of
the start, and posts under the wheels carry on its motion, so that height is continuous and damping right.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from math import asin, atan2, ceil, cos, isnan, nan, pi, sin, tan
from threading import Timer
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]
from numpy.typing import NDArray

from tiger.config.tire import load_soil
from tiger.emulation.body import (
    COMMANDS,
    FELT,
    LIFT,
    PLATE,
    SPRING,
    WHEEL_ANGLE,
    WHEEL_RPM,
    WHEEL_SPEED,
    WHEEL_TORQUE,
    Body,
    Motion,
)
from tiger.emulation.ground import make_terrain
from tiger.models import vehicle_kernel as kernel
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.jit import Record, c_function, jit, record
from tiger.models.soil import SOIL
from tiger.models.terrain import FEATURE, GROUND
from tiger.models.tire import TIRE
from tiger.models.vehicle import Inputs, Vehicle
from tiger.native._core import ffi

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import Scenario
    from tiger.models.terrain import Terrain

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

BODY = np.dtype(
    [(name, np.float64) for name in ("dt", "substep", "slope_x", "slope_y")]
    + [
        (name, np.float64, length)
        for name, length in (
            *(("imu", 3), ("plate", 2), ("turning", 2), ("lift", 4)),
            *(("wheel_rpm", 4), ("command", 4), ("integral", 4)),
        )
    ]
    + [("substeps", np.int64), ("moves", np.bool_)]
)
"""What a body carries from step to step beside the vehicle's state.

The terrain's own slopes; plate and lifts at the end of the last step, how fast the plate's slopes change in
this one, and whether anything of that moves; the wheels' commands as told and in rad/s.
"""

PLATE_AT, LIFT_AT, WHEEL_RPM_AT = PLATE.start, LIFT.start, WHEEL_RPM.start
SPRING_AT, WHEEL_SPEED_AT = SPRING.start, WHEEL_SPEED.start
WHEEL_ANGLE_AT, WHEEL_TORQUE_AT = WHEEL_ANGLE.start, WHEEL_TORQUE.start


@jit
def _drive(drive: Record, body: Record, state: Array, inputs: Array, felt: Array, dt: float) -> None:
    """Set the motors' torques for the next `dt` and let the wheels' angles follow."""
    d, b = drive[0], body[0]
    for i in range(4):
        speed = state[kernel.SPIN_AT + i] - state[11]
        felt[WHEEL_ANGLE_AT + i] += speed * dt
        error = b.command[i] - speed
        if isnan(error):  # no command: the motor is off
            inputs[kernel.TORQUE_AT + i] = b.integral[i] = 0.0
            continue
        torque = d.gain * error + b.integral[i]
        limited = min(max(torque, -d.torque_max), d.torque_max)
        if torque == limited or torque * error < 0.0:
            b.integral[i] += d.integral_gain * error * dt
        inputs[kernel.TORQUE_AT + i] = limited


@jit
def _feel(
    vehicle: Record,
    gravity: float,
    imu: Array,
    state: Array,
    rate: Array,
    inputs: Array,
    contact: Array,
    felt: Array,
) -> None:
    """Write what the IMU feels at its place, the springs' forces, the wheels' speeds and torques."""
    v = vehicle[0]
    u, side, rise = state[7], state[8], state[9]
    p, q, r = state[10], state[11], state[12]
    pp, qq, rr = rate[10], rate[11], rate[12]
    w, a, b, c = state[3], state[4], state[5], state[6]
    x, y, z = imu[0], imu[1], imu[2]
    along, square = p * x + q * y + r * z, p * p + q * q + r * r
    up_x, up_y = 2.0 * (a * c - b * w), 2.0 * (b * c + a * w)
    up_z = 1.0 - 2.0 * (a * a + b * b)
    felt[0] = rate[7] + q * rise - r * side + gravity * up_x + qq * z - rr * y + along * p - square * x
    felt[1] = rate[8] + r * u - p * rise + gravity * up_y + rr * x - pp * z + along * q - square * y
    felt[2] = rate[9] + p * side - q * u + gravity * up_z + pp * y - qq * x + along * r - square * z
    felt[3], felt[4], felt[5] = p, q, r
    for i in range(4):
        felt[SPRING_AT + i] = contact[i, kernel.STRUT_FORCE_AT] - v.preload[i]
        felt[WHEEL_SPEED_AT + i] = state[kernel.SPIN_AT + i] - q
        felt[WHEEL_TORQUE_AT + i] = inputs[kernel.TORQUE_AT + i]


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
def _follow(body: Record, ground: Record, inputs: Array, command: Array) -> None:
    """Take the command: wheel speeds, and where plate and lifts shall go from where they are now."""
    b, g = body[0], ground[0]
    for i in range(4):
        if command[WHEEL_RPM_AT + i] != b.wheel_rpm[i]:
            b.wheel_rpm[i] = command[WHEEL_RPM_AT + i]
            b.command[i] = b.wheel_rpm[i] * (pi / 30.0)
    moves = command[PLATE_AT] != b.plate[0] or command[PLATE_AT + 1] != b.plate[1]
    for i in range(4):
        moves |= command[LIFT_AT + i] != b.lift[i]
    if not (moves or b.moves):
        return
    b.moves = moves
    for i in range(4):
        inputs[kernel.LIFT_AT + i] = b.lift[i]
        inputs[kernel.LIFT_RATE_AT + i] = (command[LIFT_AT + i] - b.lift[i]) / b.dt
        b.lift[i] = command[LIFT_AT + i]
    g.slope_x, g.slope_y = b.slope_x - tan(b.plate[1]), b.slope_y + tan(b.plate[0])
    b.plate[0], b.plate[1] = command[PLATE_AT], command[PLATE_AT + 1]
    b.turning[0] = (b.slope_x - tan(b.plate[1]) - g.slope_x) / b.dt
    b.turning[1] = (b.slope_y + tan(b.plate[0]) - g.slope_y) / b.dt


@jit
def _advance(
    plant: kernel.Plant,
    drive: Record,
    body: Record,
    state: Array,
    inputs: Array,
    rate: Array,
    contact: Array,
    command: Array,
    felt: Array,
) -> None:
    """Move `state` by one step, then feel; lifts and plate go on at their rates meanwhile."""
    vehicle, ground = plant[0], plant[3]
    _follow(body, ground, inputs, command)
    b, g = body[0], ground[0]
    for _ in range(b.substeps):
        _drive(drive, body, state, inputs, felt, b.substep)
        _post_rates(vehicle, state, b.turning, inputs)
        kernel.advance(plant, state, inputs, b.substep, 1, contact)
        for i in range(4):
            inputs[kernel.LIFT_AT + i] += b.substep * inputs[kernel.LIFT_RATE_AT + i]
        g.slope_x += b.substep * b.turning[0]
        g.slope_y += b.substep * b.turning[1]
    kernel.derivative(plant, state, inputs, 0.0, rate, contact)
    _feel(vehicle, drive[0].gravity, b.imu, state, rate, inputs, contact, felt)


def _step(arrays: Any, command: Any, felt: Any) -> None:
    """`_advance` as a `tiger_body_step`; `arrays` are the addresses of `VehicleBody._arrays`."""
    sizes = carray(arrays[0], (3,), np.int64)
    plant = (
        carray(arrays[1], (1,), kernel.VEHICLE),
        carray(arrays[2], (1,), TIRE),
        carray(arrays[3], (1,), SOIL),
        carray(arrays[4], (1,), GROUND),
        carray(arrays[5], (sizes[0],), FEATURE),
        carray(arrays[6], (sizes[1], sizes[2]), np.float64),
    )
    _advance(
        plant,
        carray(arrays[7], (1,), DRIVE),
        carray(arrays[8], (1,), BODY),
        carray(arrays[9], (kernel.STATES,), np.float64),
        carray(arrays[10], (kernel.INPUTS,), np.float64),
        carray(arrays[11], (kernel.STATES,), np.float64),
        carray(arrays[12], (4, kernel.CONTACT_FIGURES), np.float64),
        carray(command, (COMMANDS,), np.float64),
        carray(felt, (FELT,), np.float64),
    )


@cache
def _compiled_step() -> Any:
    pointer: Any = types.CPointer
    numbers = pointer(types.float64)
    compiled = c_function(types.void(pointer(types.voidptr), numbers, numbers))(_step)
    return ffi.cast("tiger_body_step", compiled.address)


class VehicleBody(Body):
    """See `body.Body`. Starts at rest on the ground, wheels locked until then, or rolling at a speed."""

    def __init__(
        self,
        config: VehicleConfig,
        scenario: Scenario,
        plate_rad: tuple[float, float],
        lift_m: Sequence[float],
    ) -> None:
        super().__init__()
        config = _as_in(scenario, config)
        terrain = make_terrain(scenario.terrain, config.body.half_track_m)
        tilted = replace(
            terrain,
            slope_x=terrain.slope_x - tan(plate_rad[1]),
            slope_y=terrain.slope_y + tan(plate_rad[0]),
        )
        soil = load_soil(scenario.soil) if scenario.soil is not None else None
        self._vehicle = Vehicle(config, tilted, soil=soil)
        self._com_height_m = self._vehicle.com_height_m
        inputs = Inputs()
        inputs.wheel_speed_radps[:] = nan
        inputs.lift_m[:] = lift_m
        start = scenario.start
        spin_radps = start.speed_mps / config.tire.rolling_radius_m
        self._body = _body_record(terrain, self._vehicle.imu_place_m, plate_rad, lift_m, spin_radps)
        self._contact = np.zeros((4, kernel.CONTACT_FIGURES))

        with _notice_when_compiling():
            stands = self._vehicle.at_rest(start.x_m, start.y_m, start.yaw_deg * pi / 180.0)
            self._state = self._vehicle.settle(stands, inputs=inputs)
            self.step = _compiled_step()
        self._state[kernel.VELOCITY.start] += start.speed_mps
        self._state[kernel.SPIN] = spin_radps
        self._arrays = self._plant_and_state(config, inputs)
        self._addresses = np.array([array.ctypes.data for array in self._arrays], np.uintp)
        self.context: Any = ffi.from_buffer(self._addresses)
        self.advance(plate_rad, lift_m, (0.0,) * 4)  # no time passes: it only feels
        self._body["integral"] = self._contact[:, kernel.FX_AT] * config.tire.rolling_radius_m  # hold it here

    def _plant_and_state(self, config: VehicleConfig, inputs: Inputs) -> tuple[NDArray[Any], ...]:
        """Return what `_step` works on, in its order; its addresses must stay where they are."""
        *_, features, heights = plant = self._vehicle.plant
        sizes = np.array([features.size, *heights.shape])
        rate = np.zeros(kernel.STATES)
        own = (_drive_record(config), self._body, self._state, inputs.vector, rate, self._contact)
        return (sizes, *plant, *own)

    @property
    def attitude_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw (as `euler_from_quaternion`, which takes arrays and ten times as long)."""
        w, x, y, z = self._state[kernel.ATTITUDE].tolist()
        return (
            atan2(2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            asin(min(1.0, max(-1.0, 2.0 * (y * w - x * z)))),
            atan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)),
        )

    def motion(self) -> Motion:
        """What no sensor tells, at this moment."""
        roll, pitch, _ = self.attitude_rad
        p, q, r = self.rate_radps.tolist()
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
        substeps = ceil(dt_s / LONGEST_STEP_S - 1e-9)
        self._body["dt"], self._body["substeps"] = dt_s, substeps
        self._body["substep"] = dt_s / substeps


def _as_in(scenario: Scenario, vehicle: VehicleConfig) -> VehicleConfig:
    """Return the vehicle with the scenario's friction and payload."""
    changes: dict[str, object] = {}
    if scenario.friction is not None:
        changes["tire"] = vehicle.tire.model_copy(update={"friction": scenario.friction})
    if scenario.payload is not None:
        changes["payload"] = scenario.payload
    return vehicle.model_copy(update=changes) if changes else vehicle


@contextmanager
def _notice_when_compiling() -> Iterator[None]:
    """Tell a person who waits for long what it waits for."""
    notice = Timer(NOTICE_AFTER_S, print, (NOTICE,), {"file": sys.stderr, "flush": True})
    notice.daemon = True
    notice.start()
    try:
        yield
    finally:
        notice.cancel()


def _body_record(
    terrain: Terrain,
    imu_place_m: Array,
    plate_rad: tuple[float, float],
    lift_m: Sequence[float],
    spin_radps: float,
) -> Record:
    """A body before its first step, on a plate that stands still, its wheels told to keep their speed."""
    return record(
        BODY,
        {
            "slope_x": terrain.slope_x,
            "slope_y": terrain.slope_y,
            "imu": imu_place_m,
            "plate": plate_rad,
            "turning": 0.0,
            "lift": lift_m,
            "wheel_rpm": 0.0,
            "command": spin_radps,
            "integral": 0.0,
            "dt": LONGEST_STEP_S,
            "substep": LONGEST_STEP_S,
            "substeps": 0,
            "moves": False,
        },
    )


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
