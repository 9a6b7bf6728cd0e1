"""Carries out the drives of `wheels` with the daemon, on the real robot or on the emulated one.

The daemon arms only with a person's leave, asked anew for each drive, and is disarmed after it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tiger.calibration.person import measured
from tiger.calibration.procedure import CalibrationError, Confirm, Measure, Turn, What
from tiger.calibration.station import CONNECT_PATIENCE_S
from tiger.calibration.wheels import (
    ARM_PATIENCE_S,
    Drive,
    DriveState,
    Phase,
    progress,
    solve,
    step,
    wrong_angle,
    wrong_distance,
)
from tiger.daemon.loop import run
from tiger.record import Command, DaemonState, Mode

if TYPE_CHECKING:
    from tiger.calibration.person import Person
    from tiger.calibration.procedure import Result
    from tiger.config.robot import RobotConfig
    from tiger.daemon.clock import Clock
    from tiger.daemon.daemon import Daemon
    from tiger.record import Problem, Record
    from tiger.rig.virtual import Rig

Ticks = Callable[[Callable[["Record"], bool]], None]
"""Lets the daemon tick until what it is given returns False."""


@dataclass(frozen=True, slots=True)
class Course:
    """What is driven: a distance ahead, then full turns, + to the left."""

    distance_m: float
    turns: int
    turn_speed_mps: float = 0.0  # 0: on the spot


def real_ticks(daemon: Daemon, clock: Clock) -> Ticks:
    """The ticks of the real robot."""

    def ticks(on_record: Callable[[Record], bool]) -> None:
        run(daemon, clock, on_record)

    return ticks


def virtual_ticks(rig: Rig) -> Ticks:
    """The ticks of an emulated robot."""

    def ticks(on_record: Callable[[Record], bool]) -> None:
        while True:
            record = rig.tick()
            if record is not None and not on_record(record):
                return

    return ticks


def calibrate_wheels(
    robot: RobotConfig, daemon: Daemon, ticks: Ticks, person: Person, course: Course
) -> Result:
    """Drive a distance and some turns on the spot, let a person measure both. Raises CalibrationError."""
    if not robot.drive.enabled:
        raise CalibrationError("wheels: drive.enabled = false in the configuration; set it to true")
    radius_m = robot.vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor
    distance_m, turns = course.distance_m, course.turns
    ahead = Drive(radius_m, distance_m=distance_m)
    around = Drive(radius_m, angle_rad=2.0 * math.pi * turns, turn_speed_mps=course.turn_speed_mps)
    place = "on a circle" if course.turn_speed_mps else "on the spot"
    side = "left" if turns > 0 else "right"
    _connected(ticks)
    person.confirm(Confirm("Mark where the robot stands, on firm and even ground."))
    straight = _drive(
        daemon, ticks, person, ahead, f"It will drive {distance_m:g} m ahead. Is the way clear?"
    )
    (measured_m,) = measured(
        person,
        Measure(
            "How far did it go, in m, mark to mark?",
            What.DISTANCE,
            lambda typed: wrong_distance(robot, straight, typed[0]),
        ),
    )
    person.confirm(Confirm(f"Mark its heading: it will turn {place}, to the {side}."))
    turning = _drive(daemon, ticks, person, around, f"It will turn {abs(turns)} times. Is the way clear?")
    (beyond_deg,) = measured(
        person,
        Measure(
            f"How far beyond {abs(turns)} full turns did it come, in degrees (short: negative)?",
            What.BEYOND,
            lambda typed: wrong_angle(turning, _turned_rad(turns, typed[0])),
        ),
    )
    angle_rad = _turned_rad(turns, beyond_deg)
    return solve(robot, straight, measured_m, turning, angle_rad)


def _turned_rad(turns: int, beyond_deg: float) -> float:
    return math.copysign(1.0, turns) * (2.0 * math.pi * abs(turns) + math.radians(beyond_deg))


def _connected(ticks: Ticks) -> None:
    """Let the daemon find the robot, before anyone marks the floor for it. Raises CalibrationError."""
    since_s: float | None = None
    missing: tuple[Problem, ...] | None = None

    def on_record(record: Record) -> bool:
        nonlocal since_s, missing
        now_s = record.inputs.now_s
        since_s = now_s if since_s is None else since_s
        if record.state not in (DaemonState.DISCONNECTED, DaemonState.HANDSHAKE):
            return False
        if now_s - since_s < CONNECT_PATIENCE_S:
            return True
        missing = record.problems
        return False

    ticks(on_record)
    if missing is not None:
        said = "\n".join(map(str, missing))
        raise CalibrationError(said or "wheels: the robot does not answer; try `tiger doctor`")


def _drive(daemon: Daemon, ticks: Ticks, person: Person, drive: Drive, question: str) -> DriveState:
    if not person.permit(question):
        raise CalibrationError("wheels: not permitted to move; nothing was driven")
    state, error = DriveState(), ""

    def on_record(record: Record) -> bool:
        nonlocal state, error
        try:
            state, daemon.command = step(drive, state, record)
        except CalibrationError as found:
            error = str(found)
        person.show(Turn(progress(drive, state), state.phase.value))
        return not error and state.phase is not Phase.END

    daemon.arm(ARM_PATIENCE_S)
    try:
        ticks(on_record)
    finally:
        daemon.command = Command(mode=Mode.HOLD)
        daemon.disarm()
        problems = _settled(ticks)
    if error:
        raise CalibrationError("\n".join([error, *map(str, problems)]))
    return state


def _settled(ticks: Ticks, count: int = 100) -> tuple[Problem, ...]:
    """Let the daemon carry out what it was told; returns what it has to say by then."""
    records: deque[Record] = deque(maxlen=1)
    left = iter(range(count - 1, -1, -1))

    def on_record(record: Record) -> bool:
        records.append(record)
        return next(left) > 0

    ticks(on_record)
    return records[0].problems
