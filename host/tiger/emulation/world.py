"""The emulated robot's world: TIGER on a tilting plate, its actuators, wheels and sensors. No clock, no I/O.

    world = World(load_vehicle("tiger"), load_scenario("shaking-plate"), seed=1)
    world.step(0.001, duty, wheel_rpm)         # 1 ms: duties -1..1 (+ raises the body) and rpm, FL FR RL RR
    world.potentiometer_volts()                # what the boards measure: call as often as they sample
    world.potentiometer_counts(), world.lower_switches, world.upper_switches
    world.imu()                                # accel_mps2, gyro_radps, mag_ut in the BNO055's axes
    world.tooth_phase                          # per wheel: teeth passed since the start, a float
    world.motor_current_a(), world.wheel_speed_rpm
    world.truth()                              # attitude, strokes, ride height: for tests and plots

The body is the linear 7-DOF model about mid-stroke at rest (body.py), driven by the tilt of the plate under
the wheels and by the lift of the four mechanisms (the true curve of the EAM). An actuator's rate follows its
duty with a first-order lag; it is self-locking, stops at the ends of its stroke, and cannot push more than
its force limit. The wheels are free to turn, as on stands; + is forward. Everything random is from the seed:
two worlds given the same calls are equal. The BNO055 is mounted along the body axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, degrees, exp, nan, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from tiger.config.vehicle import VehicleConfig
from tiger.emulation.body import BodyOnPlate
from tiger.emulation.scenarios import PlateAxis, Scenario
from tiger.models.eam import Eam, MechanismError
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.models.sensors.gear import QuadratureGear
from tiger.models.sensors.imu import BNO055, Imu, ImuReading, ImuSpec, TriadSpec
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.models.sensors.potentiometer import Potentiometer

Array = NDArray[np.float64]
Four = tuple[float, float, float, float]

MAGNETIC_FIELD_UT = (20.0, 0.0, -43.0)
"""Earth's field at middle latitudes, the robot facing north: north, west, up."""

CALIBRATED_ACCEL_OFFSET_MPS2 = 0.02
CALIBRATED_MAG_OFFSET_UT = 2.0
SWITCH_MARGIN_MM = 0.2
WHEEL_LAG_S = 0.1

_MAGNETIC_PERIOD_S = 0.01
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
    """Height of the COM above the middle of the plate."""
    stroke_mm: Four
    stroke_rate_mmps: Four
    actuator_force_n: Four
    wheel_speed_rpm: Four
    plate_roll_deg: float
    plate_pitch_deg: float


class World:
    """See the top of this file. Raises MechanismError for a vehicle without an EAM, or impossible strokes."""

    def __init__(self, vehicle: VehicleConfig, scenario: Scenario, seed: int = 0) -> None:
        actuator = vehicle.actuator
        eam = Eam.from_vehicle(vehicle)
        assert actuator.kind == "rate"  # Eam.from_vehicle has refused everything else
        self.vehicle, self.scenario = vehicle, scenario
        self.time_us = 0

        self._actuator = actuator
        self._curve = eam.curve()
        self._mid_rise_mm = self._curve.at(actuator.stroke_max_mm / 2.0)[0]
        start = scenario.initial_stroke_mm or (actuator.stroke_max_mm / 2.0,) * 4
        for corner, stroke in zip(("FL", "FR", "RL", "RR"), start, strict=True):
            if stroke > actuator.stroke_max_mm:
                raise MechanismError(
                    f"initial_stroke_mm of {corner} = {stroke:g} is outside 0..{actuator.stroke_max_mm:g}; "
                    "correct the scenario"
                )
        self._stroke_mm = list(start)
        self._rate_mmps = [0.0] * 4
        self._lift = [self._curve.at(stroke) for stroke in start]  # (rise mm, motion ratio)

        parameters = FullCarParameters.from_config(vehicle)
        body_load = parameters.static_tire_load_n() - parameters.wheel_mass_kg() * GRAVITY_MPS2
        self._preload_n: list[float] = body_load.tolist()
        self._plate = (PlateAxis(scenario.segments("roll")), PlateAxis(scenario.segments("pitch")))

        random_imu, random_pot, random_gear, random_current = (
            np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(4)
        )
        noisy = scenario.sensor_noise
        self._imu = Imu(_imu_spec(noisy), random_imu)
        self._felt = (np.zeros(3), np.zeros(3))
        self._field = np.zeros(3)
        self._magnetic_s = 0.0
        self.potentiometer = Potentiometer(actuator.stroke_max_mm)
        self._random_pot = random_pot if noisy else None
        self._gears = [QuadratureGear(random=random_gear if noisy else None) for _ in range(4)]
        self._current = MotorCurrent()
        self._random_current = random_current if noisy else None

        self._wheel_radps = [0.0] * 4
        self._wheel_accel_radps2 = [0.0] * 4
        self._wheel_angle_rad = [0.0] * 4

        self._dt_s = nan  # no step yet
        self._body = BodyOnPlate(parameters, self._inputs())
        self._feel(_LONG_S)

    # ---- time

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self.time_us * 1e-6

    def step(self, dt_s: float, actuator_duty: Sequence[float], wheel_speed_cmd_rpm: Sequence[float]) -> None:
        """Advance by `dt_s` (1 ms as a rule) with duties -1..1 and wheel-speed commands held, (4,) each."""
        if dt_s != self._dt_s:
            self._prepare(dt_s)
        self._move_actuators(actuator_duty)
        self._turn_wheels(wheel_speed_cmd_rpm)
        self.time_us += self._dt_us
        self._body.advance(self._inputs())
        self._feel(dt_s)

    # ---- what the boards and controllers see

    def potentiometer_volts(self) -> Array:
        """Wiper voltages, (4,), of a 5 V supply; every call is a new sample."""
        return self.potentiometer.volts(self._stroke_mm, self._random_pot)

    def potentiometer_counts(self) -> NDArray[np.int64]:
        """Counts 0..1023 of a 10-bit ratiometric converter, (4,); every call is a new sample."""
        return self.potentiometer.counts(self.potentiometer_volts())

    @property
    def lower_switches(self) -> tuple[bool, bool, bool, bool]:
        """Pressed near zero stroke."""
        a, b, c, d = (stroke <= SWITCH_MARGIN_MM for stroke in self._stroke_mm)
        return a, b, c, d

    @property
    def upper_switches(self) -> tuple[bool, bool, bool, bool]:
        """Pressed near full stroke."""
        limit = self._actuator.stroke_max_mm - SWITCH_MARGIN_MM
        a, b, c, d = (stroke >= limit for stroke in self._stroke_mm)
        return a, b, c, d

    def imu(self) -> ImuReading:
        """One sample of the BNO055, rounded to its digits; read at 100 Hz or so."""
        return self._imu.read()

    @property
    def tooth_phase(self) -> Four:
        """Teeth that have passed each sensor since the start: negative backwards, four edges to the tooth."""
        phases = (gear.phase(a) for gear, a in zip(self._gears, self._wheel_angle_rad, strict=True))
        a, b, c, d = phases
        return a, b, c, d

    @property
    def wheels_stand(self) -> bool:
        """No wheel turns."""
        return not any(self._wheel_radps)

    @property
    def wheel_speed_rpm(self) -> Four:
        """True wheel speeds."""
        a, b, c, d = (speed * (30.0 / pi) for speed in self._wheel_radps)
        return a, b, c, d

    def motor_current_a(self) -> Array:
        """Motor currents as the drives measure them, (4,); every call is a new sample."""
        torque = self.vehicle.tire.spin_inertia_kgm2 * np.array(self._wheel_accel_radps2)
        current = self._current.true_a(torque, self._wheel_radps)
        return self._current.measured_a(current, self._random_current)

    # ---- what no one sees

    @property
    def roll_deg(self) -> float:
        """True roll."""
        return degrees(self._body.roll_rad)

    @property
    def pitch_deg(self) -> float:
        """True pitch."""
        return degrees(self._body.pitch_rad)

    @property
    def stroke_mm(self) -> Four:
        """True strokes."""
        a, b, c, d = self._stroke_mm
        return a, b, c, d

    def truth(self) -> Truth:
        """Everything true at this moment."""
        body = self._body
        plate_roll, plate_pitch = self._plate
        fl, fr, rl, rr = self._rate_mmps
        forces = [self._actuator_force_n(corner) for corner in range(4)]
        return Truth(
            time_s=self.time_s,
            roll_deg=self.roll_deg,
            pitch_deg=self.pitch_deg,
            roll_rate_degps=degrees(body.roll_rate_radps),
            pitch_rate_degps=degrees(body.pitch_rate_radps),
            heave_m=body.heave_m,
            ride_height_m=self.vehicle.body.com_height_m + body.heave_m,
            stroke_mm=self.stroke_mm,
            stroke_rate_mmps=(fl, fr, rl, rr),
            actuator_force_n=(forces[0], forces[1], forces[2], forces[3]),
            wheel_speed_rpm=self.wheel_speed_rpm,
            plate_roll_deg=degrees(plate_roll.angle_rad(self.time_s)),
            plate_pitch_deg=degrees(plate_pitch.angle_rad(self.time_s)),
        )

    # ---- physics of one step

    # These run a thousand times a second: comparisons, not min() and max(); lists, not small arrays.

    def _move_actuators(self, actuator_duty: Sequence[float]) -> None:
        rates, strokes, dt_s, gain = self._rate_mmps, self._stroke_mm, self._dt_s, self._actuator_gain
        max_rate_mmps, stroke_max_mm = self._actuator.max_rate_mmps, self._actuator.stroke_max_mm
        for corner, duty in enumerate(actuator_duty):
            rate = rates[corner]
            if duty == 0.0 and -1e-9 < rate < 1e-9:
                rates[corner] = 0.0  # locked
                continue
            limited = 1.0 if duty > 1.0 else -1.0 if duty < -1.0 else duty
            rate += gain * (limited * max_rate_mmps - rate)
            if rate > 0.0 and self._actuator_force_n(corner) > self._actuator.max_force_n:
                rate = 0.0  # stalled: it holds, but cannot push on
            stroke = strokes[corner] + rate * dt_s
            if not 0.0 < stroke < stroke_max_mm:
                stroke, rate = (0.0 if stroke <= 0.0 else stroke_max_mm), 0.0
            rates[corner] = rate
            strokes[corner] = stroke
            self._lift[corner] = self._curve.at(stroke)

    def _actuator_force_n(self, corner: int) -> float:
        """Push of an actuator: the spring's force seen through the mechanism."""
        return (self._preload_n[corner] + self._body.spring_n[corner]) * self._lift[corner][1]

    def _turn_wheels(self, wheel_speed_cmd_rpm: Sequence[float]) -> None:
        speeds, most = self._wheel_radps, self._wheel_change_radps
        for wheel, rpm in enumerate(wheel_speed_cmd_rpm):
            speed = speeds[wheel]
            if rpm == 0.0 and -1e-9 < speed < 1e-9:
                speeds[wheel] = self._wheel_accel_radps2[wheel] = 0.0
                continue
            change = self._wheel_gain * (rpm * (pi / 30.0) - speed)
            change = most if change > most else -most if change < -most else change
            self._wheel_accel_radps2[wheel] = change / self._dt_s
            self._wheel_angle_rad[wheel] += (speed + 0.5 * change) * self._dt_s
            speeds[wheel] = speed + change

    def _inputs(self) -> list[float]:
        """Plate roll and pitch in rad, lifts from mid-stroke in m."""
        roll, pitch = self._plate
        time_s, mid = self.time_s, self._mid_rise_mm
        fl, fr, rl, rr = self._lift
        return [
            roll.angle_rad(time_s),
            pitch.angle_rad(time_s),
            (fl[0] - mid) * 1e-3,
            (fr[0] - mid) * 1e-3,
            (rl[0] - mid) * 1e-3,
            (rr[0] - mid) * 1e-3,
        ]

    def _feel(self, dt_s: float) -> None:
        """Let the IMU follow the motion of the point where it sits."""
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
        x, y, z = self.vehicle.imu_offset_m
        pushed = body.heave_accel_mps2 + GRAVITY_MPS2
        along = p * x + q * y + r * z
        square = p * p + q * q + r * r
        accel, rate = self._felt
        accel[0] = pushed * ux + qq * z - rr * y + along * p - square * x
        accel[1] = pushed * uy + rr * x - pp * z + along * q - square * y
        accel[2] = pushed * uz + pp * y - qq * x + along * r - square * z
        rate[0], rate[1], rate[2] = p, q, r
        self._imu.accelerometer.advance(accel, dt_s)
        self._imu.gyroscope.advance(rate, dt_s)
        self._magnetic_s += dt_s
        if self._magnetic_s >= _MAGNETIC_PERIOD_S:
            self._imu.magnetometer.advance(self._field_in_body(), self._magnetic_s)
            self._magnetic_s = 0.0

    # ---- preparation

    def _prepare(self, dt_s: float) -> None:
        """Compute what depends on the length of a step."""
        self._dt_us = round(dt_s * 1e6)
        if self._dt_us <= 0 or abs(self._dt_us - dt_s * 1e6) > 1e-6:
            raise ValueError(f"a step takes a positive whole number of microseconds, not {dt_s} s")
        self._dt_s = dt_s
        self._actuator_gain = _lag_gain(dt_s, self._actuator.lag_s)
        self._wheel_gain = _lag_gain(dt_s, WHEEL_LAG_S)
        drive = self.vehicle.drive
        most_torque_nm = np.inf if drive is None else drive.max_torque_nm
        self._wheel_change_radps = most_torque_nm / self.vehicle.tire.spin_inertia_kgm2 * dt_s
        self._body.prepare(dt_s)

    def _field_in_body(self) -> Array:
        """Earth's field in body axes for the present roll and pitch."""
        north, west, up = MAGNETIC_FIELD_UT
        pitch, roll = self._body.pitch_rad, self._body.roll_rad
        x = cos(pitch) * north - sin(pitch) * up
        z = sin(pitch) * north + cos(pitch) * up
        self._field[:] = x, cos(roll) * west + sin(roll) * z, -sin(roll) * west + cos(roll) * z
        return self._field


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
