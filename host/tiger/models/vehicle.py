"""The 14-DOF vehicle (chapter 5) as people and the emulated robot use it; `vehicle_kernel` has its equations.

    vehicle = Vehicle(load_vehicle("tiger"), terrain=Terrain.random("D", seed=1))
    state = vehicle.at_rest()
    inputs = Inputs()
    while running:
        inputs.wheel_torque_nm[:] = ...                    # or inputs.wheel_speed_radps (NaN = no command)
        vehicle.set_strokes(inputs, stroke_mm, rate_mmps)  # robot with EAMs; a car: inputs.actuator_force_n
        vehicle.step(state, inputs, dt_s=1e-3)             # moves `state` in place, a few microseconds
        readings = vehicle.sense(state, inputs)            # pose, IMU, wheel speeds, wheel loads

A state is a plain array (33,) in the kernel's order: copy it to branch, store it to come back.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiger.config.tire import load_tire_set
from tiger.models import vehicle_kernel as kernel
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.jit import Record, record
from tiger.models.soil import soil_record
from tiger.models.terrain import FLAT
from tiger.models.tire import tire_record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.config.tire import SoilConfig, TireSetConfig
    from tiger.config.vehicle import VehicleConfig
    from tiger.models.eam import LiftCurve
    from tiger.models.terrain import Terrain

Array = NDArray[np.float64]

DEFAULT_STEP_S = 1e-3


class Inputs:
    """What acts on a vehicle during a step: named views of one array (34,). Corners FL, FR, RL, RR.

    `wheel_speed_radps` commands a motor's speed where it is not NaN, and `wheel_torque_nm` acts where it is.
    `lift_m` is how far a series actuator has raised the spring seat, `lift_rate_mps` how fast it does;
    `post_m` lifts the ground under a wheel, as on a four-post rig.
    """

    __slots__ = (
        "actuator_force_n",
        "body_force_n",
        "body_moment_nm",
        "lift_m",
        "lift_rate_mps",
        "post_m",
        "post_rate_mps",
        "vector",
        "wheel_speed_radps",
        "wheel_torque_nm",
    )

    def __init__(self) -> None:
        """Nothing acts."""
        self.vector = np.zeros(kernel.INPUTS)
        self.wheel_torque_nm = self.vector[kernel.TORQUE]
        self.wheel_speed_radps = self.vector[kernel.SPEED]
        self.actuator_force_n = self.vector[kernel.FORCE]
        self.lift_m = self.vector[kernel.LIFT]
        self.lift_rate_mps = self.vector[kernel.LIFT_RATE]
        self.body_force_n = self.vector[kernel.BODY_FORCE]
        self.body_moment_nm = self.vector[kernel.BODY_MOMENT]
        self.post_m = self.vector[kernel.POST]
        self.post_rate_mps = self.vector[kernel.POST_RATE]
        self.wheel_speed_radps[:] = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What sensors and observers can know of a vehicle at one instant. Corners FL, FR, RL, RR."""

    position_m: Array
    """COM in the world."""
    quaternion: Array
    """Body to world, (w, x, y, z)."""
    velocity_mps: Array
    """COM, body axes."""
    rate_radps: Array
    """Body rates p, q, r."""
    angular_acceleration_radps2: Array
    specific_force_mps2: Array
    """What an accelerometer at the IMU's place feels, body axes: one g upward at rest."""
    wheel_speed_radps: Array
    """Wheel against its carrier: what a gear sensor or a motor counts."""
    wheel_load_n: Array
    wheel_force_n: Array
    """(2, 4): F_x and F_y of each contact."""
    wheel_torque_nm: Array
    """Drive torque after the motor's limit."""
    strut_force_n: Array
    strut_compression_m: Array
    slip: Array
    """(2, 4): kappa and tan(alpha) of each contact."""
    sinkage_m: Array

    @property
    def attitude_rad(self) -> Array:
        """Roll, pitch, yaw (eq. 5.2: Z-Y-X)."""
        return euler_from_quaternion(self.quaternion)


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A simulation: n samples of everything. Corner quantities are (n, 4), vectors (n, 3)."""

    time_s: Array
    states: Array
    rates: Array
    contacts: Array
    half_diagonal_m: Array = field(repr=False)
    """Corner places relative to the COM, (2, 4)."""

    @property
    def position_m(self) -> Array:
        """COM in the world."""
        return self.states[:, kernel.POSITION]

    @property
    def attitude_rad(self) -> Array:
        """Roll, pitch, yaw."""
        return euler_from_quaternion(self.states[:, kernel.ATTITUDE])

    @property
    def velocity_mps(self) -> Array:
        """COM velocity U, V, W in body axes."""
        return self.states[:, kernel.VELOCITY]

    @property
    def rate_radps(self) -> Array:
        """Body rates p, q, r."""
        return self.states[:, kernel.RATE]

    @property
    def acceleration_mps2(self) -> Array:
        """Acceleration of the COM in body axes, gravity not included (V' + U r - W p in y)."""
        return np.asarray(self.rates[:, kernel.VELOCITY] + np.cross(self.rate_radps, self.velocity_mps))

    @property
    def wheel_load_n(self) -> Array:
        """Normal load of each tyre."""
        return self.contacts[:, :, kernel.LOAD_AT]

    @property
    def wheel_torque_nm(self) -> Array:
        """Drive torque of each wheel."""
        return self.contacts[:, :, kernel.DRIVE_TORQUE_AT]

    @property
    def load_transfer(self) -> Array:
        """Rollover index (n,): (left - right)/total load, 0 while every wheel is in the air."""
        left, right = self.wheel_load_n[:, ::2].sum(axis=1), self.wheel_load_n[:, 1::2].sum(axis=1)
        total = left + right
        return np.asarray((left - right) / np.where(total > 0.0, total, 1.0))

    @property
    def corner_height_m(self) -> Array:
        """Rise of the body above each wheel since the first sample, (n, 4)."""
        w, x, y, z = self.states[:, kernel.ATTITUDE].T
        heights = (
            self.states[:, 2:3]
            + np.outer(2.0 * (x * z - y * w), self.half_diagonal_m[0])
            + np.outer(2.0 * (y * z + x * w), self.half_diagonal_m[1])
        )
        return np.asarray(heights - heights[0])


class Vehicle:
    """A configured vehicle on a terrain. Steps and senses; holds no state of its own."""

    def __init__(
        self,
        config: VehicleConfig,
        terrain: Terrain = FLAT,
        tire_set: TireSetConfig | None = None,
        soil: SoilConfig | None = None,
        speed_droop: float = 0.01,
    ) -> None:
        """Prepare `config` for compiled stepping; without `soil` the terrain is a road.

        A speed-commanded motor gives full torque at a speed error of `speed_droop` of its top speed. Without
        a [drive] section torque is unlimited and a speed command does nothing.
        """
        tire_set = tire_set or load_tire_set()
        self.config = config
        self.terrain = terrain
        self._vehicle = _vehicle_record(config, speed_droop)
        self._plant = (
            self._vehicle,
            tire_record(tire_set, config.tire),
            soil_record(soil, tire_set, config.tire),
            *terrain.arrays(),
        )
        self._out = np.empty(kernel.STATES)
        self._contact = np.zeros((4, kernel.CONTACT_FIGURES))
        self._imu = np.array(config.imu_offset_m) - _payload(config)[1]
        self._lift = _lift_curve(config)
        self.com_height_m = config.body.com_height_m + float(_payload(config)[1][2])

    @property
    def plant(self) -> kernel.Plant:
        """What the compiled equations take before the state, for those who compile a loop of their own."""
        return self._plant

    @property
    def imu_place_m(self) -> Array:
        """Where the IMU sits relative to the COM of body and payload, (3,), body axes."""
        return self._imu.copy()

    # ---- states ------------

    def at_rest(self, x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """Return a state (33,) of rest: exact on level ground without payload, else call `settle` on it."""
        height, slope_x, slope_y = (float(value) for value in self.terrain.at(x_m, y_m))
        up = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
        forward = np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0])
        forward -= up * (forward @ up)
        forward /= np.linalg.norm(forward)
        state = np.zeros(kernel.STATES)
        state[kernel.POSITION] = np.array([x_m, y_m, height]) + up * self.com_height_m
        state[kernel.ATTITUDE] = _quaternion(np.stack([forward, np.cross(up, forward), up], axis=1))
        return state

    def rolling(self, speed_mps: float, x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """Return `at_rest` moving ahead at a speed, wheels rolling freely."""
        state = self.at_rest(x_m, y_m, yaw_rad)
        state[kernel.VELOCITY.start] = speed_mps
        state[kernel.SPIN] = speed_mps / self.config.tire.rolling_radius_m
        return state

    def settle(self, state: Array, duration_s: float = 5.0, inputs: Inputs | None = None) -> Array:
        """Return `state` after `duration_s` with the wheels locked: at rest on any ground that holds it.

        On the way down locked wheels are strained against each other, and would hold so for good: their
        tyres are let go once.
        """
        locked = self._vehicle.copy()
        locked["spin_inertia"] = np.finfo(float).max ** 0.25
        plant = (locked, *self._plant[1:])
        held = Inputs() if inputs is None else inputs
        settled = state.copy()
        settled[kernel.SPIN] = 0.0
        steps = round(duration_s / DEFAULT_STEP_S)
        down = steps // 5
        for part in (down, steps - down):
            settled[kernel.SLIP] = 0.0
            kernel.advance(plant, settled, held.vector, DEFAULT_STEP_S, part, self._contact)
        return settled

    # ---- stepping ------------

    def set_strokes(self, inputs: Inputs, stroke_mm: ArrayLike, rate_mmps: ArrayLike = 0.0) -> None:
        """Set the lift of the four spring seats from EAM strokes (4,) in mm and their rates in mm/s.

        The mechanism's rise is counted from mid-stroke, where the vehicle stands at its configured height.
        Raises ValueError for a vehicle without a mechanism.
        """
        if self._lift is None:
            raise ValueError("this vehicle has no [eam]; set inputs.lift_m or inputs.actuator_force_n")
        curve, datum_mm = self._lift
        strokes, rates = np.broadcast_to(stroke_mm, 4), np.broadcast_to(rate_mmps, 4)
        for i in range(4):
            rise_mm, ratio = curve.at(float(strokes[i]))
            inputs.lift_m[i] = 1e-3 * (rise_mm - datum_mm)
            inputs.lift_rate_mps[i] = 1e-3 * ratio * rates[i]

    def step(self, state: Array, inputs: Inputs, dt_s: float = DEFAULT_STEP_S, steps: int = 1) -> Array:
        """Move `state` in place by `steps` Runge-Kutta steps of `dt_s` with `inputs` held; return it."""
        kernel.advance(self._plant, state, inputs.vector, dt_s, steps, self._contact)
        return state

    def rate(self, state: Array, inputs: Inputs) -> Array:
        """Return d(state)/dt (33,)."""
        kernel.derivative(self._plant, state, inputs.vector, 0.0, self._out, self._contact)
        return self._out.copy()

    def sense(self, state: Array, inputs: Inputs) -> Readings:
        """Return what sensors see in `state` under `inputs`."""
        rate = self.rate(state, inputs)
        contact = self._contact.copy()
        velocity, body_rate = state[kernel.VELOCITY].copy(), state[kernel.RATE].copy()
        angular = rate[kernel.RATE]
        w, x, y, z = state[kernel.ATTITUDE]
        up = np.array([2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)])
        at_com = rate[kernel.VELOCITY] + _cross(body_rate, velocity) + GRAVITY_MPS2 * up
        lever = _cross(angular, self._imu) + _cross(body_rate, _cross(body_rate, self._imu))
        return Readings(
            position_m=state[kernel.POSITION].copy(),
            quaternion=state[kernel.ATTITUDE].copy(),
            velocity_mps=velocity,
            rate_radps=body_rate,
            angular_acceleration_radps2=angular,
            specific_force_mps2=at_com + lever,
            wheel_speed_radps=state[kernel.SPIN] - body_rate[1],
            wheel_load_n=contact[:, kernel.LOAD_AT],
            wheel_force_n=contact[:, kernel.FX_AT : kernel.FY_AT + 1].T,
            wheel_torque_nm=contact[:, kernel.DRIVE_TORQUE_AT],
            strut_force_n=contact[:, kernel.STRUT_FORCE_AT],
            strut_compression_m=state[kernel.STRUT].copy(),
            slip=state[kernel.SLIP].reshape(2, 4).copy(),
            sinkage_m=contact[:, kernel.SINKAGE_AT],
        )

    def simulate(
        self,
        state: Array,
        inputs: Inputs | ArrayLike,
        duration_s: float,
        dt_s: float = DEFAULT_STEP_S,
        steps_per_sample: int = 1,
    ) -> History:
        """Run from `state` (left untouched) and sample every `steps_per_sample` steps.

        `inputs` is held, or a table (n, 34) of input vectors, one row per sample: n = duration/sample period.
        Raises ValueError if the table's length does not fit.
        """
        samples = max(1, round(duration_s / (dt_s * steps_per_sample)))
        if isinstance(inputs, Inputs):
            table = np.broadcast_to(inputs.vector, (samples, kernel.INPUTS)).copy()
        else:
            table = np.ascontiguousarray(inputs, dtype=np.float64)
            if table.shape != (samples, kernel.INPUTS):
                raise ValueError(f"inputs have shape {table.shape}; needed is ({samples}, {kernel.INPUTS})")
        states = np.empty((samples + 1, kernel.STATES))
        rates = np.empty_like(states)
        contacts = np.empty((samples + 1, 4, kernel.CONTACT_FIGURES))
        kernel.run(self._plant, state.copy(), table, dt_s, steps_per_sample, states, rates, contacts)
        time = np.arange(samples + 1, dtype=np.float64) * (dt_s * steps_per_sample)
        return History(time, states, rates, contacts, self.corners_m)

    @property
    def corners_m(self) -> Array:
        """Wheel places (x, y) relative to the COM, (2, 4)."""
        return np.stack([self._vehicle["x"][0], self._vehicle["y"][0]])

    def energy(self, state: Array) -> float:
        """Return kinetic, gravity, spring and tyre energy in J: level road, seats not lifted, no posts."""
        v = self._vehicle[0]
        rotation = _rotation(state[kernel.ATTITUDE])
        velocity, rate = state[kernel.VELOCITY], state[kernel.RATE]
        inertia = np.array([v["roll_inertia"], v["pitch_inertia"], v["yaw_inertia"]])
        energy = 0.5 * v["mass"] * velocity @ velocity + 0.5 * inertia @ rate**2
        energy += v["mass"] * v["gravity"] * state[2]
        for i in range(4):
            place = np.array([v["x"][i], v["y"][i], v["wheel_height"] + state[kernel.STRUT_AT + i]])
            speed = velocity + np.cross(rate, place) + [0.0, 0.0, state[kernel.STRUT_RATE_AT + i]]
            height = state[2] + rotation[2] @ place
            squeeze = max(0.0, v["free_radius"][i] - height)
            energy += 0.5 * v["wheel_mass"][i] * speed @ speed + v["wheel_mass"][i] * v["gravity"] * height
            energy += 0.5 * v["spin_inertia"] * state[kernel.SPIN_AT + i] ** 2
            energy += (
                v["preload"][i] * state[kernel.STRUT_AT + i]
                + 0.5 * v["spring"][i] * state[kernel.STRUT_AT + i] ** 2
            )
            energy += 0.5 * v["tire_stiffness"] * squeeze**2
        return float(energy)


def simulate_many(
    vehicles: Sequence[Vehicle], states: Sequence[Array], inputs: Inputs | ArrayLike, duration_s: float
) -> list[History]:
    """Run many vehicles (other parameters, other terrains) from their own states under the same inputs."""
    return [
        vehicle.simulate(state, inputs, duration_s) for vehicle, state in zip(vehicles, states, strict=True)
    ]


def euler_from_quaternion(quaternion: ArrayLike) -> Array:
    """Return roll, pitch, yaw (..., 3) of quaternions (..., 4), body to world (eq. 5.2, Z-Y-X)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, float), -1, 0)
    return np.stack(
        [
            np.arctan2(2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            np.arcsin(np.clip(2.0 * (y * w - x * z), -1.0, 1.0)),
            np.arctan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)),
        ],
        axis=-1,
    )


def _vehicle_record(config: VehicleConfig, speed_droop: float) -> Record:
    body, tire = config.body, config.tire
    payload_kg, com_shift, inertia = _payload(config)
    a, b, w = body.com_to_front_axle_m, body.com_to_rear_axle_m, body.half_track_m
    axles = (config.front, config.front, config.rear, config.rear)
    # Equilibrium at the configured height: struts carry the body, tyres body and wheels (erratum of eq. 5.7).
    shares = np.array([b, b, a, a]) / (2.0 * (a + b))
    wheel_mass = np.array([axle.unsprung_mass_kg for axle in axles])
    preload = body.mass_kg * GRAVITY_MPS2 * shares
    squeeze = (preload + wheel_mass * GRAVITY_MPS2) / tire.vertical_stiffness_npm
    torque_max, speed_gain = np.inf, 0.0
    if config.drive is not None:
        torque_max = config.drive.max_torque_nm
        top_speed_radps = config.drive.max_wheel_speed_rpm * 2.0 * np.pi / 60.0
        speed_gain = torque_max / (speed_droop * top_speed_radps)
    return record(
        kernel.VEHICLE,
        {
            "gravity": GRAVITY_MPS2,
            "mass": body.mass_kg + payload_kg,
            "roll_inertia": body.roll_inertia_kgm2 + inertia[0],
            "pitch_inertia": body.pitch_inertia_kgm2 + inertia[1],
            "yaw_inertia": body.yaw_inertia_kgm2 + inertia[2],
            "tire_stiffness": tire.vertical_stiffness_npm,
            "tire_damping": tire.vertical_damping_nspm,
            "rolling_radius": tire.rolling_radius_m,
            "spin_inertia": tire.spin_inertia_kgm2,
            "torque_max": torque_max,
            "speed_gain": speed_gain,
            "wheel_height": tire.rolling_radius_m - body.com_height_m - com_shift[2],
            "x": np.array([a, a, -b, -b]) - com_shift[0],
            "y": np.array([w, -w, w, -w]) - com_shift[1],
            "wheel_mass": wheel_mass,
            "spring": [axle.spring_npm for axle in axles],
            "damper": [axle.damper_nspm for axle in axles],
            "preload": preload,
            "free_radius": tire.rolling_radius_m + squeeze,
        },
    )


def _payload(config: VehicleConfig) -> tuple[float, Array, Array]:
    """Mass in kg of the payload, the COM's shift (3,) and the inertia (3,) that it adds about the new COM.

    The springs keep the preload of the empty body, so that it sags; products of inertia are left out.
    """
    if config.payload is None:
        return 0.0, np.zeros(3), np.zeros(3)
    mass, empty = config.payload.mass_kg, config.body.mass_kg
    place = np.array(config.payload.place_m)
    squares = place**2 * mass * empty / (mass + empty)
    return mass, place * mass / (mass + empty), squares.sum() - squares


def _lift_curve(config: VehicleConfig) -> tuple[LiftCurve, float] | None:
    if config.eam is None or config.actuator.kind != "rate":
        return None
    from tiger.models.eam import Eam

    curve = Eam.from_vehicle(config).curve()
    return curve, curve.at(0.5 * config.actuator.stroke_max_mm)[0]


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two 3-vectors (np.cross spends ten times as long on its generality)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _rotation(quaternion: Array) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix())


def _quaternion(rotation: Array) -> Array:
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(rotation).as_quat(canonical=True), 1)
