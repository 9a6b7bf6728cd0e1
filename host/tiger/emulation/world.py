"""The emulated robot's world: TIGER on its ground, with actuators, wheels and sensors. No clock, no I/O.

    world = World(load_vehicle("tiger"), load_scenario("shaking-plate"), seed=1)
    world.step(0.001, duty, wheel_rpm)         # 1 ms: duties -1..1 (+ raises the body) and rpm, FL FR RL RR
    world.potentiometer_volts()                # what the boards measure: call as often as they sample
    world.potentiometer_counts(), world.lower_switches, world.upper_switches
    world.imu()                                # accel_mps2, gyro_radps, mag_ut in the BNO055's axes
    world.tooth_phase                          # per wheel: teeth passed since the start, a float
    world.motor_current_a(), world.wheel_speed_rpm
    world.truth()                              # attitude, strokes, place, wheel loads: for tests and plots

What moves is a `body.Body`: the 14-DOF vehicle on its terrain, or the linear 7-DOF model on stands, as the
scenario says. It stands on a plate that tilts, and on four mechanisms that lift it (the true curve of the
EAM). An actuator's rate follows its duty with a first-order lag; it is self-locking, stops at the ends of its
stroke, and cannot push more than its force limit. Everything random is from the seed: two worlds given the
same calls are equal. The BNO055 is mounted along the body axes. A step is compiled: native_world.cpp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, degrees, exp, nan, pi, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiger.config.vehicle import RateActuatorConfig, VehicleConfig
from tiger.emulation.body import make_body
from tiger.emulation.scenarios import PlateAxis, Scenario
from tiger.models.eam import Eam, LiftCurve, MechanismError
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.models.sensors.gear import QuadratureGear
from tiger.models.sensors.imu import BNO055, Imu, ImuReading, ImuSpec, TriadSpec
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.models.sensors.potentiometer import Potentiometer
from tiger.native._core import ffi, lib
from tiger.record import Four

Array = NDArray[np.float64]

MAGNETIC_FIELD_UT = (20.0, 0.0, -43.0)
"""Earth's field at middle latitudes, the robot facing north: north, west, up."""

CALIBRATED_ACCEL_OFFSET_MPS2 = 0.02
CALIBRATED_MAG_OFFSET_UT = 2.0
SWITCH_MARGIN_MM = 0.2
STANDING_RADPS = 1e-4
"""A wheel that turns more slowly stands: a tooth takes a quarter of an hour to pass."""

MAGNETIC_PERIOD_US = 10_000
_LONG_S = 1000.0  # after which every low-pass has settled


@dataclass(frozen=True, slots=True)
class Truth:
    """What no sensor tells. Corners FL FR RL RR; roll + = left side up, pitch + = nose down."""

    time_s: float
    roll_deg: float
    pitch_deg: float
    roll_rate_degps: float
    pitch_rate_degps: float
    heave_m: float
    ride_height_m: float
    """Height of the COM above the ground between the wheels."""
    stroke_mm: Four
    stroke_rate_mmps: Four
    actuator_force_n: Four
    wheel_speed_rpm: Four
    plate_roll_deg: float
    plate_pitch_deg: float
    position_m: tuple[float, float, float]
    """COM in the world: x and y in the plane, z up."""
    yaw_deg: float
    speed_mps: float
    wheel_load_n: Four
    slip_ratio: Four


class World:
    """See the top of this file. Raises MechanismError for a vehicle without an EAM, or impossible strokes."""

    def __init__(self, vehicle: VehicleConfig, scenario: Scenario, seed: int = 0) -> None:
        actuator = vehicle.actuator
        eam = Eam.from_vehicle(vehicle)
        assert actuator.kind == "rate"  # Eam.from_vehicle has refused everything else
        self.vehicle, self.scenario = vehicle, scenario

        self._actuator = actuator
        parameters = FullCarParameters.from_config(vehicle)
        body_load = parameters.static_tire_load_n() - parameters.wheel_mass_kg() * GRAVITY_MPS2
        self._plate = (PlateAxis(scenario.segments("roll")), PlateAxis(scenario.segments("pitch")))

        random_imu, random_pot, random_gear, random_current = (
            np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)
        )
        noisy = scenario.sensor_noise
        self._imu = Imu(_imu_spec(noisy), random_imu)
        self._read_us = 0  # when the IMU was read last
        self._field_us = 0  # when the magnetometer followed last
        self.potentiometer = Potentiometer(actuator.stroke_max_mm)
        self._random_pot = random_pot if noisy else None
        self._gears = [QuadratureGear(random=random_gear if noisy else None) for _ in range(4)]
        self.teeth = self._gears[0].teeth
        self.teeth_rad = np.array([gear.edges_rad for gear in self._gears])
        """Where each tooth of each wheel's gear starts, (4, teeth + 1); the last is the full turn."""
        self._current = MotorCurrent()
        self._random_current = random_current if noisy else None

        self._curve = eam.curve()  # kept: compiled code points to its pieces
        native = self.native = _native_world(actuator, self._curve, body_load)
        """The `tiger_world` of native_robot_api.h that compiled code moves."""
        for wheel, stroke in enumerate(_first_strokes_mm(scenario, actuator.stroke_max_mm)):
            lib.tiger_world_place(native, wheel, stroke)
        native.accel_mps2 = ffi.from_buffer("double[]", self._imu.accelerometer.state)
        native.gyro_radps = ffi.from_buffer("double[]", self._imu.gyroscope.state)

        self._body = make_body(vehicle, scenario, self.plate_rad(0), self._lift_m())
        native.step_body, native.body, native.felt = self._body.step, self._body.context, self._body.felt
        self._imu.advance(self._body.accel_mps2, self._body.rate_radps, self._field_in_body(), _LONG_S)

    # ---- time

    @property
    def time_us(self) -> int:
        """Time since the start in microseconds."""
        return int(self.native.time_us)

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self.time_us * 1e-6

    def prepare(self, dt_s: float) -> None:
        """Make ready for steps of `dt_s`; raises ValueError unless it is a whole number of microseconds."""
        native = self.native
        if dt_s == native.dt_s:
            return
        dt_us = round(dt_s * 1e6)
        if dt_us <= 0 or abs(dt_us - dt_s * 1e6) > 1e-6:
            raise ValueError(f"a step takes a positive whole number of microseconds, not {dt_s} s")
        native.dt_us, native.dt_s = dt_us, dt_s
        native.rate_gain = _lag_gain(dt_s, self._actuator.lag_s)
        native.accel_gain = self._imu.accelerometer.gain(dt_s)
        native.gyro_gain = self._imu.gyroscope.gain(dt_s)
        self._body.prepare(dt_s)

    def step(self, dt_s: float, actuator_duty: Sequence[float], wheel_speed_cmd_rpm: Sequence[float]) -> None:
        """Advance by `dt_s` (1 ms as a rule) with duties -1..1 and wheel-speed commands held, (4,) each."""
        self.prepare(dt_s)
        plate_rad = self.plate_rad(self.time_us + self.native.dt_us)
        lib.tiger_world_step(self.native, actuator_duty, wheel_speed_cmd_rpm, plate_rad)
        self.turn_field()

    def turn_field(self) -> None:
        """Let the magnetometer follow when it is time; to be called after steps made elsewhere."""
        since_us = self.time_us - self._field_us
        if since_us >= MAGNETIC_PERIOD_US:
            self._field_us += since_us
            self._imu.magnetometer.advance(self._field_in_body(), since_us * 1e-6)

    # ---- what the boards and controllers see

    def potentiometer_volts(self) -> Array:
        """Wiper voltages, (4,), of a 5 V supply; every call is a new sample."""
        return self.potentiometer.volts(self.stroke_mm, self._random_pot)

    def potentiometer_counts(self) -> NDArray[np.int64]:
        """Counts 0..1023 of a 10-bit ratiometric converter, (4,); every call is a new sample."""
        return self.potentiometer.counts(self.potentiometer_volts())

    @property
    def lower_switches(self) -> tuple[bool, bool, bool, bool]:
        """Pressed near zero stroke."""
        a, b, c, d = (stroke <= SWITCH_MARGIN_MM for stroke in self.stroke_mm)
        return a, b, c, d

    @property
    def upper_switches(self) -> tuple[bool, bool, bool, bool]:
        """Pressed near full stroke."""
        limit = self._actuator.stroke_max_mm - SWITCH_MARGIN_MM
        a, b, c, d = (stroke >= limit for stroke in self.stroke_mm)
        return a, b, c, d

    def imu(self) -> ImuReading:
        """One sample of the BNO055, rounded to its digits; read at 100 Hz or so."""
        imu, since_s = self._imu, (self.time_us - self._read_us) * 1e-6
        self._read_us = self.time_us
        imu.accelerometer.wait(since_s)
        imu.gyroscope.wait(since_s)
        return imu.read()

    @property
    def tooth_phase(self) -> Four:
        """Teeth that have passed each sensor since the start: negative backwards, four edges to the tooth."""
        phases = (gear.phase(a) for gear, a in zip(self._gears, self._body.wheel_angle_rad, strict=True))
        a, b, c, d = phases
        return a, b, c, d

    @property
    def wheels_stand(self) -> bool:
        """No wheel turns to speak of."""
        a, b, c, d = self._body.wheel_radps
        most = STANDING_RADPS
        return -most < a < most and -most < b < most and -most < c < most and -most < d < most

    @property
    def wheel_speed_rpm(self) -> Four:
        """True wheel speeds."""
        a, b, c, d = (speed * (30.0 / pi) for speed in self._body.wheel_radps)
        return a, b, c, d

    def motor_current_a(self) -> Array:
        """Motor currents as the drives measure them, (4,); every call is a new sample."""
        current = self._current.true_a(self._body.wheel_torque_nm, self._body.wheel_radps)
        return self._current.measured_a(current, self._random_current)

    # ---- what no one sees

    @property
    def roll_deg(self) -> float:
        """True roll."""
        return degrees(self._body.attitude_rad[0])

    @property
    def pitch_deg(self) -> float:
        """True pitch."""
        return degrees(self._body.attitude_rad[1])

    @property
    def stroke_mm(self) -> Four:
        """True strokes."""
        a, b, c, d = self.native.stroke_mm
        return a, b, c, d

    def truth(self) -> Truth:
        """Everything true at this moment."""
        motion = self._body.motion()
        roll, pitch, yaw = self._body.attitude_rad
        plate_roll, plate_pitch = self.plate_rad(self.time_us)
        fl, fr, rl, rr = self.native.rate_mmps
        forces = [lib.tiger_world_actuator_force_n(self.native, corner) for corner in range(4)]
        return Truth(
            time_s=self.time_s,
            roll_deg=degrees(roll),
            pitch_deg=degrees(pitch),
            roll_rate_degps=degrees(motion.roll_rate_radps),
            pitch_rate_degps=degrees(motion.pitch_rate_radps),
            heave_m=motion.heave_m,
            ride_height_m=self.vehicle.body.com_height_m + motion.heave_m,
            stroke_mm=self.stroke_mm,
            stroke_rate_mmps=(fl, fr, rl, rr),
            actuator_force_n=(forces[0], forces[1], forces[2], forces[3]),
            wheel_speed_rpm=self.wheel_speed_rpm,
            plate_roll_deg=degrees(plate_roll),
            plate_pitch_deg=degrees(plate_pitch),
            position_m=motion.position_m,
            yaw_deg=degrees(yaw),
            speed_mps=motion.speed_mps,
            wheel_load_n=motion.wheel_load_n,
            slip_ratio=motion.slip_ratio,
        )

    # ---- preparation

    def plate_rad(self, time_us: int) -> tuple[float, float]:
        """Roll and pitch of the plate at a time."""
        roll, pitch = self._plate
        time_s = time_us * 1e-6
        return roll.angle_rad(time_s), pitch.angle_rad(time_s)

    def plate_path_rad(self, steps: int, step_us: int) -> list[float]:
        """Roll and pitch of the plate now and at the steps to come, one after the other, (2 steps,)."""
        now_us = self.time_us
        if not self.scenario.plate:
            return [0.0] * (2 * steps)
        return [angle for step in range(steps) for angle in self.plate_rad(now_us + step * step_us)]

    def _lift_m(self) -> list[float]:
        """Lifts of the mechanisms from mid-stroke."""
        native = self.native
        return [(rise - native.mid_rise_mm) * 1e-3 for rise in native.rise_mm]

    def _field_in_body(self) -> Array:
        """Earth's field in body axes for the present attitude."""
        north, west, up = MAGNETIC_FIELD_UT
        roll, pitch, yaw = self._body.attitude_rad
        ahead, left = cos(yaw) * north + sin(yaw) * west, cos(yaw) * west - sin(yaw) * north
        x = cos(pitch) * ahead - sin(pitch) * up
        z = sin(pitch) * ahead + cos(pitch) * up
        return np.array([x, cos(roll) * left + sin(roll) * z, -sin(roll) * left + cos(roll) * z])


def _first_strokes_mm(scenario: Scenario, stroke_max_mm: float) -> Four:
    """Where the actuators begin: as the scenario says, else in the middle."""
    start = scenario.initial_stroke_mm or (stroke_max_mm / 2.0,) * 4
    for corner, stroke in zip(("FL", "FR", "RL", "RR"), start, strict=True):
        if stroke > stroke_max_mm:
            raise MechanismError(
                f"initial_stroke_mm of {corner} = {stroke:g} is outside 0..{stroke_max_mm:g}; "
                "correct the scenario"
            )
    return start


def _native_world(actuator: RateActuatorConfig, curve: LiftCurve, body_load_n: Array) -> Any:
    """Make a `tiger_world` before its first step; it points into `curve`."""
    native: Any = ffi.new("tiger_world *")
    native.dt_s = nan  # no step yet
    native.stroke_max_mm = actuator.stroke_max_mm
    native.max_rate_mmps = actuator.max_rate_mmps
    native.max_force_n = actuator.max_force_n
    native.mid_rise_mm = curve.at(actuator.stroke_max_mm / 2.0)[0]
    native.preload_n = body_load_n.tolist()
    native.curve, native.pieces = ffi.from_buffer("double[]", curve.pieces), len(curve.pieces)
    native.pieces_per_mm = curve.pieces_per_mm
    return native


def _lag_gain(dt_s: float, lag_s: float) -> float:
    return 1.0 if lag_s == 0.0 else 1.0 - exp(-dt_s / lag_s)


def _imu_spec(noisy: bool) -> ImuSpec:
    """The BNO055 with its accelerometer and magnetometer calibrated; the gyro's bias is as it comes."""
    if not noisy:
        triads = (BNO055.accelerometer, BNO055.gyroscope, BNO055.magnetometer)
        return ImuSpec(*(_perfect(spec) for spec in triads))
    return ImuSpec(
        accelerometer=replace(BNO055.accelerometer, bias=CALIBRATED_ACCEL_OFFSET_MPS2),
        gyroscope=replace(BNO055.gyroscope, bias=radians(1.0)),
        magnetometer=replace(BNO055.magnetometer, bias=CALIBRATED_MAG_OFFSET_UT),
    )


def _perfect(spec: TriadSpec) -> TriadSpec:
    return replace(spec, noise_density=0.0, bias=0.0, bias_walk=0.0, step=0.0)
