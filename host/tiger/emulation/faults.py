"""Planned failures of the emulated robot: what a scenario's [[fault]] may break, and when it is carried out.

    failures = table_of_failures(robot)               # {(target, kind): Failure}
    plan = Plan(scenario.fault, failures)             # refuses what the robot cannot have, with what it can
    plan.act(robot.world.time_us)                     # at every step: begins and ends what is due

A failure is put where it happens: a cable loses bytes, a program hangs, a pin shows a wrong level. What the
firmware and the daemon make of it is theirs. One that ends by itself (a reset) has nothing to end.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from tiger.config.errors import ConfigError
from tiger.models.sensors.potentiometer import ADC_COUNTS
from tiger.native.boards import BROWN_OUT, EXTERNAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.scenarios import FaultEvent

CORNER_NAMES = ("fl", "fr", "rl", "rr")
SIDES = {"left": (0, 2), "right": (1, 3)}
"""Front and rear corner of each side."""
DEAD_A, DEAD_B, SWAPPED = 1, 2, 4
"""Bits of a wheel sensor's faults."""
_OPEN_POT_COUNTS = float(ADC_COUNTS - 1)

Failures = dict[tuple[str, str], "Failure"]


class Failure(NamedTuple):
    """How one kind of planned failure begins and ends; the argument is the event's value."""

    begin: Callable[[float], None]
    end: Callable[[float], None]
    needs_value: bool = False


def table_of_failures(robot: EmulatedRobot) -> Failures:
    """Return every failure that this robot can have, by target and kind."""
    table: Failures = {
        ("nano_wire", "cut"): _flag(robot, "nano_wire_cut"),
        ("estop", "press"): _flag(robot, "estop_pressed"),
        ("imu_sensor", "faults"): _bits(robot.imu.set_faults),
        ("imu_sensor", "power_cycle"): _once(robot.imu.power_cycle_sensor),
    }
    for name, cable in robot.cables.items():
        table[name, "cut"] = Failure(_ignoring(cable.cut), _ignoring(cable.mend))
        table[name, "silence"] = _flag(cable, "is_silent")
    for name, board in robot.boards.items():
        table[name, "hang"] = _once(board.hang)
        table[name, "hang_hard"] = _once(partial(board.hang, interrupts_off=True))
        table[name, "reset"] = _once(partial(board.reset, EXTERNAL))
        table[name, "brown_out"] = _once(partial(board.reset, BROWN_OUT))
    for side in SIDES:
        table |= _drive_failures(robot, side)
    for corner, name in enumerate(CORNER_NAMES):
        table |= _corner_failures(robot, corner, name)
    native = robot.world.native
    table["actuators", "jam"] = _number(native, "max_rate_mmps", always=0.0)
    table["actuators", "slow"] = _number(native, "max_rate_mmps")
    table["actuators", "weak"] = _number(native, "max_force_n")
    return table


def _drive_failures(robot: EmulatedRobot, side: str) -> Failures:
    """Of a Roboteq, and of the wheel sensors of its side."""
    drive, board, name = robot.drives[side], robot.speed[side], f"roboteq_{side}"
    table: Failures = {
        (name, "silent"): _flag(drive, "silent"),
        (name, "deaf"): _flag(drive, "deaf"),
        (name, "fault_flags"): _bits(partial(setattr, drive, "fault_flags")),
        (name, "battery_v"): _number(drive, "battery_v"),
        (name, "reboot"): _once(drive.reboot),
    }
    for channel, corner in enumerate(SIDES[side]):
        sensor = f"wheel_sensor_{CORNER_NAMES[corner]}"
        for kind, bit in (("dead_a", DEAD_A), ("dead_b", DEAD_B), ("swapped", SWAPPED)):
            table[sensor, kind] = Failure(
                _ignoring(partial(board.set_faults, channel, bit)),
                _ignoring(partial(board.set_faults, channel, 0)),
            )
    return table


def _corner_failures(robot: EmulatedRobot, corner: int, name: str) -> Failures:
    pot, motor = f"potentiometer_{name}", f"motor_{name}"
    heal = _ignoring(partial(robot.show_stroke, corner))

    def shows(counts: float | None) -> Callable[[float], None]:
        return _ignoring(partial(robot.force_stroke, corner, counts))

    turn = _ignoring(partial(robot.cross_motor, corner))
    return {
        (pot, "open"): Failure(shows(_OPEN_POT_COUNTS), heal),
        (pot, "short"): Failure(shows(0.0), heal),
        (pot, "stuck"): Failure(shows(None), heal),
        (motor, "crossed"): Failure(turn, turn),
    }


class Plan:
    """Failures in the order of time. Raises ConfigError for one that the robot cannot have."""

    def __init__(self, events: tuple[FaultEvent, ...], failures: Mapping[tuple[str, str], Failure]) -> None:
        self._due: list[tuple[int, Callable[[float], None], float]] = []
        for event in events:
            failure = failures.get((event.target, event.kind))
            if failure is None:
                raise ConfigError(_unknown(event, failures))
            if failure.needs_value and event.value is None:
                wanting = f"fault at {event.at_s:g} s: {event.kind!r} of {event.target!r}"
                raise ConfigError(f"{wanting} needs a number; add `value = ...`")
            value = event.value or 0.0
            self._due.append((round(event.at_s * 1e6), failure.begin, value))
            if event.for_s is not None:
                self._due.append((round((event.at_s + event.for_s) * 1e6), failure.end, value))
        self._due.sort(key=lambda entry: -entry[0])  # the next one is popped off the end

    @property
    def next_us(self) -> int | None:
        """When something begins or ends next; None: nothing more."""
        return self._due[-1][0] if self._due else None

    def act(self, now_us: int) -> None:
        """Begin and end what is due."""
        while self._due and self._due[-1][0] <= now_us:
            _, action, value = self._due.pop()
            action(value)


def _unknown(event: FaultEvent, failures: Mapping[tuple[str, str], Failure]) -> str:
    kinds = sorted(kind for target, kind in failures if target == event.target)
    known = (
        f"{event.target} knows {', '.join(kinds)}"
        if kinds
        else f"targets are {', '.join(sorted({target for target, _ in failures}))}"
    )
    return f"fault at {event.at_s:g} s: no {event.kind!r} of {event.target!r}; {known}"


# ---- ways to fail -------------------------------------------


def _ignoring(action: Callable[[], object]) -> Callable[[float], None]:
    def act(_: float) -> None:
        action()

    return act


def _once(action: Callable[[], object]) -> Failure:
    """A failure that ends by itself."""
    return Failure(_ignoring(action), _ignoring(lambda: None))


def _flag(owner: object, name: str) -> Failure:
    return Failure(
        _ignoring(partial(setattr, owner, name, True)), _ignoring(partial(setattr, owner, name, False))
    )


def _bits(set_to: Callable[[int], object]) -> Failure:
    """The value's bits, none at the end."""

    def begin(value: float) -> None:
        set_to(int(value))

    def end(_: float) -> None:
        set_to(0)

    return Failure(begin, end, needs_value=True)


def _number(owner: object, name: str, always: float | None = None) -> Failure:
    """Another number: `always`, or the event's value; the one of now is back at the end."""
    normal = float(getattr(owner, name))

    def begin(value: float) -> None:
        setattr(owner, name, value if always is None else always)

    def end(_: float) -> None:
        setattr(owner, name, normal)

    return Failure(begin, end, needs_value=always is None)
