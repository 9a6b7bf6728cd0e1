"""What people want to see of a robot and its control does not need: power, energy, how far it can still go.

Torque, power and energy of each wheel come from the currents and voltages that the Roboteqs measure (section
3.4.5); how much of the strokes' reach is used, from the measured strokes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tiger.control.traction import electric_w, measured
from tiger.frozen import dataclass
from tiger.record import STILL, Four

if TYPE_CHECKING:
    from tiger.control.reachable import Suspension
    from tiger.record import DriveSample, Inputs, Record

LONGEST_STEP_S = 0.5  # between two samples of a drive; over a longer gap nobody knows what it took


@dataclass(frozen=True, slots=True)
class Overview:
    """Wheels are FL, FR, RL, RR. Zero where the drive has not said anything yet."""

    current_a: Four = STILL  # of the motors
    torque_nm: Four = STILL  # of the motors, from their currents
    power_w: Four = STILL  # mechanical
    electric_w: Four = STILL  # from the battery
    energy_j: Four = STILL  # from the battery, since the daemon began
    reach_used: float | None = None  # 1: the body leans against its wheels as far as the strokes allow
    reachable_rad: tuple[float, float] = (0.0, 0.0)  # largest roll and largest pitch, each alone


class DriveEnergy:
    """Adds up what each motor took from the battery, and keeps the extremes."""

    def __init__(self) -> None:
        self.energy_j: Four = STILL
        self.largest_w: Four = STILL  # from the battery
        self.largest_a: Four = STILL  # of each motor, either way
        self.lowest_v: float | None = None  # of the battery
        self._last: DriveSample | None = None

    def add(self, inputs: Inputs) -> None:
        """Take the inputs of a tick; nothing is done unless the drives have said something new."""
        sample, before = inputs.drive_left, self._last
        if sample is before:
            return
        self._last = sample
        if sample is None or before is None:
            return
        power_w, span_s = electric_w(inputs), sample.t_s - before.t_s
        if 0.0 < span_s < LONGEST_STEP_S:
            fl, fr, rl, rr = (e + p * span_s for e, p in zip(self.energy_j, power_w, strict=True))
            self.energy_j = fl, fr, rl, rr
        self.largest_w = _largest(self.largest_w, power_w)
        self.largest_a = _largest(self.largest_a, _currents_a(inputs))
        other = inputs.drive_right or sample
        self.lowest_v = min(sample.battery_v, other.battery_v, self.lowest_v or math.inf)


def overview(record: Record, energy: DriveEnergy, suspension: Suspension) -> Overview:
    """Gather what there is to see in a record."""
    inputs = record.inputs
    speed_radps, torque_nm = measured(inputs)
    fl, fr, rl, rr = (torque * speed for torque, speed in zip(torque_nm, speed_radps, strict=True))
    return Overview(
        current_a=_currents_a(inputs),
        torque_nm=torque_nm,
        power_w=(fl, fr, rl, rr),
        electric_w=electric_w(inputs),
        energy_j=energy.energy_j,
        reach_used=None if inputs.strokes is None else _reach_used(inputs.strokes.stroke_mm, suspension),
        reachable_rad=suspension.limits(),
    )


def _largest(before: Four, now: Four) -> Four:
    fl, fr, rl, rr = (max(a, abs(b)) for a, b in zip(before, now, strict=True))
    return fl, fr, rl, rr


def _currents_a(inputs: Inputs) -> Four:
    left, right = inputs.drive_left, inputs.drive_right
    if left is None or right is None:
        return STILL
    (fl, rl), (fr, rr) = left.motor_current_a, right.motor_current_a
    return fl, fr, rl, rr


def _reach_used(stroke_mm: Four, suspension: Suspension) -> float:
    """Roll and pitch against the wheels, as parts of the largest: the reachable set is their sum up to 1."""
    fl, fr, rl, rr = (suspension.curve.at(stroke)[0] for stroke in stroke_mm)
    pose = suspension.pose((fl, fr, rl, rr))
    most_roll, most_pitch = suspension.limits()
    return abs(pose.roll_rad) / most_roll + abs(pose.pitch_rad) / most_pitch
