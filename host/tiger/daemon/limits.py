"""What the daemon watches: a table of limits on measurements, and what devices report as faults.

A limit that is exceeded while the robot is armed stops it; before, it keeps the robot from being armed. A
sample that is only late holds the robot still, as mega_suspension does with late setpoints, and stops it when
it stays late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Protocol

from tiger.devices.roboteq import MOTOR_FAULTS, MOTOR_REMEDY, REMEDY, FaultFlag, MotorFlag, decode_flags
from tiger.frozen import dataclass
from tiger.protocol.messages import FAULT_INFO, BoardKind, Fault, ImuFlag
from tiger.record import Problem, ProblemKind

if TYPE_CHECKING:
    from tiger.config.robot import SafetyConfig
    from tiger.devices.roboteq import Roboteq
    from tiger.protocol.link import Session
    from tiger.record import DriveSample, Estimate, ImuSample, Inputs

RPM_PER_RADPS = 30.0 / math.pi
LATE_PATIENCE = 4.0  # of the age limits: 60 ms late holds the robot still, 240 ms late stops it
CORNERS = ("front left", "front right", "rear left", "rear right")


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit: `measure` gives the value, or None when there is nothing to measure yet."""

    where: str
    what: str  # of the value, with its unit
    measure: Callable[[Inputs, Estimate], float | None]
    most: Callable[[SafetyConfig], float]
    next_step: str
    sign: float = 1.0  # -1: the limit is the least, not the most
    patience: float = 1.0  # while armed, the robot is stopped at this multiple of the limit
    holds: bool = False  # while armed, the strokes hold still from the limit on: see `is_late`

    def exceeded(
        self, safety: SafetyConfig, inputs: Inputs, estimate: Estimate, is_armed: bool = False
    ) -> Problem | None:
        """The problem, or None while the value is within the limit."""
        value = self.measure(inputs, estimate)
        most = self.most(safety) * (self.patience if is_armed else 1.0)
        if value is None or self.sign * value <= self.sign * most:
            return None
        text = f"{self.what.format(value)}, the limit is {most:g}"
        return Problem(ProblemKind.LIMIT, self.where, text, self.next_step)


class _Sample(Protocol):
    @property
    def t_s(self) -> float:
        """When it was taken."""


def _no_older(
    where: str,
    what: str,
    sample: Callable[[Inputs], _Sample | None],
    most_ms: Callable[[SafetyConfig], float],
    holds: bool = False,
) -> Limit:
    """A sample must not be older. Armed, the robot is stopped by it only at a multiple: see `patience`."""

    def age_ms(inputs: Inputs, _: Estimate) -> float | None:
        newest = sample(inputs)
        return None if newest is None else (inputs.now_s - newest.t_s) * 1e3

    text = f"newest {what} {{:.0f}} ms old"
    return Limit(where, text, age_ms, most_ms, _CABLE, patience=LATE_PATIENCE, holds=holds)


def _tilt_deg(_: Inputs, estimate: Estimate) -> float | None:
    if not estimate.ready:
        return None
    return math.degrees(max(abs(estimate.roll_rad), abs(estimate.pitch_rad)))


def _wheel_rpm(inputs: Inputs, _: Estimate) -> float | None:
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is None or right is None:
        return None
    return RPM_PER_RADPS * max(map(abs, (*left.speed_radps, *right.speed_radps)))


def _of_drives(
    value: Callable[[DriveSample], float | None], worst: Callable[[list[float]], float]
) -> Callable[[Inputs, Estimate], float | None]:
    def measure(inputs: Inputs, _: Estimate) -> float | None:
        samples = (inputs.drive_left, inputs.drive_right)
        values = [value(sample) for sample in samples if sample is not None]
        known = [number for number in values if number is not None]
        return worst(known) if known else None

    return measure


def _largest_current_a(sample: DriveSample) -> float:
    a, b = sample.motor_current_a
    return max(abs(a), abs(b))


_CABLE = "Check its cable and its line in the table of links."

LIMITS = (
    _no_older("nano_imu", "sample is", lambda i: i.imu, lambda s: s.imu_age_ms, holds=True),
    _no_older("mega_suspension", "strokes are", lambda i: i.strokes, lambda s: s.stroke_age_ms, holds=True),
    _no_older("mega_speed (left)", "wheel speeds are", lambda i: i.wheels_left, lambda s: s.wheel_age_ms),
    _no_older("mega_speed (right)", "wheel speeds are", lambda i: i.wheels_right, lambda s: s.wheel_age_ms),
    _no_older("roboteq (left)", "speeds are", lambda i: i.drive_left, lambda s: s.roboteq_age_ms),
    _no_older("roboteq (right)", "speeds are", lambda i: i.drive_right, lambda s: s.roboteq_age_ms),
    Limit(
        "body",
        "tilted by {:.1f} degrees",
        _tilt_deg,
        lambda s: s.max_tilt_deg,
        "Bring the robot back to safer ground before arming it again.",
    ),
    Limit(
        "wheels",
        "turn at {:.0f} rpm",
        _wheel_rpm,
        lambda s: s.max_wheel_speed_rpm,
        "Find out what drives the wheels before arming again.",
    ),
    Limit(
        "roboteq",
        "motor current is {:.1f} A",
        _of_drives(_largest_current_a, max),
        lambda s: s.max_motor_current_a,
        "Check for a blocked wheel; on steep or rough ground drive slower.",
    ),
    Limit(
        "roboteq",
        "motor current has been {:.1f} A (RMS) for a while",
        _of_drives(lambda d: max(d.sustained_current_a), max),
        lambda s: s.max_sustained_current_a,
        "Let the motors cool; on steep or soft ground drive slower and turn less.",
    ),
    Limit(
        "roboteq",
        "controller is at {:.0f} degrees Celsius",
        _of_drives(lambda d: d.controller_temperature_celsius, max),
        lambda s: s.max_controller_temperature_celsius,
        "Let it cool.",
    ),
    Limit(
        "battery",
        "voltage is {:.1f} V",
        _of_drives(lambda d: d.battery_v, min),
        lambda s: s.battery_min_v,
        "Charge the battery.",
        sign=-1.0,
    ),
)


def exceeded(
    safety: SafetyConfig, inputs: Inputs, estimate: Estimate, is_armed: bool = False
) -> Iterator[Problem]:
    """Every limit that is exceeded now."""
    for limit in LIMITS:
        problem = limit.exceeded(safety, inputs, estimate, is_armed)
        if problem is not None:
            yield problem


TIPPING_STEP = "Slow down, turn less, and drive back the way it came."
TRIPPED_STEP = "Look at what it ran into before driving on."


def tip_warning(estimate: Estimate) -> Problem | None:
    """What is shown, and stops nothing, when the robot comes near tipping over or has run into something."""
    stability = estimate.stability
    if stability.tripped:
        return Problem(ProblemKind.LIMIT, "body", "ran into something", TRIPPED_STEP)
    if not stability.warning:
        return None
    side = ("left", "right", "front", "rear")[stability.edge]
    text = f"may tip over to the {side}, {100.0 * max(stability.margin, 0.0):.0f} % of the margin left"
    return Problem(ProblemKind.LIMIT, "body", text, TIPPING_STEP)


def is_late(safety: SafetyConfig, inputs: Inputs) -> bool:
    """Whether the attitude or the strokes are so old that nothing should move on them."""
    imu, strokes, now_s = inputs.imu, inputs.strokes, inputs.now_s
    if imu is None or strokes is None:
        return True
    return (now_s - imu.t_s) * 1e3 > safety.imu_age_ms or (now_s - strokes.t_s) * 1e3 > safety.stroke_age_ms


def board_faults(session: Session) -> Iterator[Problem]:
    """The faults that a board has latched, an emergency stop included."""
    health = session.health
    if health is None or not health.faults:
        return
    for code in range(1, 32):
        if not health.faults & (1 << code):
            continue
        info = FAULT_INFO.get(Fault(code)) if code in _FAULT_CODES else None
        text = info.text if info else f"fault {code}, unknown to this program"
        remedy = info.remedy if info else "Update the program."
        yield Problem(ProblemKind.FAULT, session.name + _seen_on(session, health.fault_detail), text, remedy)


_FAULT_CODES = frozenset(Fault)


def _seen_on(session: Session, detail: int) -> str:
    """The corner or wheel that a fault was seen on."""
    if session.kind is BoardKind.MEGA_SUSPENSION and detail < len(CORNERS):
        return f", {CORNERS[detail]}"
    if session.kind is BoardKind.MEGA_SPEED and detail < 2:
        return (", front wheel", ", rear wheel")[detail]
    return ""


def drive_faults(drive: Roboteq) -> Iterator[Problem]:
    """What a Roboteq and its driver report, an emergency stop excluded: that is a state of its own."""
    if drive.fault is not None:
        yield drive.fault
    flags, front, rear = drive.flags["FF"] & _NOT_ESTOP, drive.flags["FM1"], drive.flags["FM2"]
    if not (flags or (front | rear) & _MOTOR_FAULTS):
        return
    where = f"{drive.name} on {drive.port}"
    for bit, name in _named(flags, FaultFlag):
        remedy = REMEDY.get(FaultFlag(bit)) if bit in _DRIVE_FAULTS else None
        yield Problem(ProblemKind.FAULT, where, name, remedy or "Look it up in the controller's manual.")
    for place, motor_flags in (("front", front), ("rear", rear)):
        for _, name in _named(motor_flags & _MOTOR_FAULTS, MotorFlag):
            yield Problem(ProblemKind.FAULT, where, f"{place} motor: {name}", MOTOR_REMEDY)


_DRIVE_FAULTS = frozenset(flag.value for flag in FaultFlag)
# Plain numbers: arithmetic on IntFlag is slow, and this runs every tick.
_NOT_ESTOP = 0xFFFF & ~FaultFlag.EMERGENCY_STOP.value
_MOTOR_FAULTS = MOTOR_FAULTS.value


def _named(flags: int, kind: type[FaultFlag] | type[MotorFlag]) -> Iterator[tuple[int, str]]:
    bits = [1 << bit for bit in range(16) if flags & (1 << bit)]
    return zip(bits, decode_flags(flags, kind), strict=True)


class RestCheck:
    """Whether the IMU's calibration is good: at rest nothing turns and nothing accelerates."""

    TIME_CONSTANT_S = 0.5
    SETTLED_AFTER_S = 2.0
    _READY = 1 << ImuFlag.FILTER_READY.value
    _REST = 1 << ImuFlag.REST.value
    _CALIBRATED = 1 << ImuFlag.CALIBRATED.value

    def __init__(self, safety: SafetyConfig) -> None:
        self._safety = safety
        self._last_s: float | None = None
        self.reset()

    def add(self, sample: ImuSample) -> None:
        """Take one sample; while the board sees the robot at rest, it goes into slow means."""
        before, self._last_s = self._last_s, sample.t_s
        if not sample.flags & self._REST or before is None:
            self._rest_s = 0.0
            self._mean = [0.0] * 6
            return
        dt = max(sample.t_s - before, 0.0)
        self._rest_s += dt
        share = min(dt / self.TIME_CONSTANT_S, 1.0)
        values = (*sample.rate_radps, *sample.linear_accel_mps2)
        self._mean = [mean + share * (value - mean) for mean, value in zip(self._mean, values, strict=True)]

    def reset(self) -> None:
        """Forget the means: the calibration has changed."""
        self._last_s = None
        self._rest_s = 0.0
        self._mean = [0.0] * 6

    def problem(self, sample: ImuSample | None) -> Problem | None:
        """Why the IMU does not allow arming, or None."""
        if sample is None:
            return Problem(ProblemKind.NO_ANSWER, "nano_imu", "sends no attitude", _CABLE)
        if not sample.flags & self._CALIBRATED:
            text = "is not calibrated"
            step = "Keep the robot still for some seconds; if it stays so, run `tiger calibrate imu`."
            return Problem(ProblemKind.REFUSED, "nano_imu", text, step)
        if not sample.flags & self._READY:
            text, step = "attitude has not settled", "Keep the robot still for a few seconds."
            return Problem(ProblemKind.REFUSED, "nano_imu", text, step)
        if self._rest_s < self.SETTLED_AFTER_S:
            return None
        bias_degps = math.degrees(max(map(abs, self._mean[:3])))
        offset_mps2 = math.sqrt(sum(value * value for value in self._mean[3:]))
        for value, most, unit in (
            (bias_degps, self._safety.max_rest_gyro_bias_degps, "degrees/s while nothing turns"),
            (offset_mps2, self._safety.max_rest_accel_offset_mps2, "m/s2 while nothing moves"),
        ):
            if value > most:
                text = f"reads {value:.3g} {unit}, the limit is {most:g}"
                step = "Calibrate it at rest: `tiger calibrate imu`."
                return Problem(ProblemKind.LIMIT, "nano_imu", text, step)
        return None
