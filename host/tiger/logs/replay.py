"""Steps the controller again on logged inputs, and compares what it commands with what it commanded then.

Inputs and outputs are logged exactly, so on the same kind of computer every number must be the same to the
last bit. What the daemon does around `controller.step` is repeated too: a fresh start of the suspension and
drive controllers when it arms, no motion unless armed or on late samples, and the check of the wheels.

Replay begins at the first tick of a run or at a checkpoint; after ticks that are missing from the log it
waits for the next checkpoint.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from tiger.daemon import controller, limits, wheel_check
from tiger.daemon.wheel_check import Phase, WheelCheck
from tiger.logs.checkpoint import thaw
from tiger.logs.topics import CHECKPOINT, TICK, Checkpoint, Tick
from tiger.record import STILL, DaemonState, Outputs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.config.robot import RobotConfig
    from tiger.logs.reader import Log

SHOWN = 20  # differences that are kept in full
BY_CHECK = {WheelCheck(phase).wheel_rpm for phase in Phase}


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that came out otherwise."""

    tick: int
    time_s: float
    name: str
    logged: Any
    replayed: Any

    def __str__(self) -> str:
        return f"tick {self.tick} ({self.time_s:.3f} s): {self.name} {self.logged!r} became {self.replayed!r}"


@dataclass
class Replayed:
    """What a replay found."""

    ticks: int = 0  # stepped and compared
    skipped: int = 0  # without a state to begin with
    missing: int = 0  # not in the log
    different_ticks: int = 0
    worst: dict[str, float] = field(default_factory=dict)  # largest difference of each number
    first: list[Difference] = field(default_factory=list)

    @property
    def exact(self) -> bool:
        """Whether everything that was compared is the same, and something was."""
        return self.ticks > 0 and self.different_ticks == 0

    def add(self, tick: Tick, replayed: Outputs) -> None:
        """Compare one tick."""
        self.ticks += 1
        if replayed == tick.outputs:
            return
        found = list(differences("", tick.outputs, replayed))
        if not found:  # NaN twice
            return
        self.different_ticks += 1
        for name, logged, new in found:
            if len(self.first) < SHOWN:
                self.first.append(Difference(tick.tick, tick.inputs.now_s, name, logged, new))
            if isinstance(logged, int | float) and isinstance(new, int | float):
                self.worst[name] = max(self.worst.get(name, 0.0), abs(float(new) - float(logged)))


def differences(name: str, logged: Any, replayed: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, logged and replayed value of every leaf that differs; NaN is equal to NaN."""
    if dataclasses.is_dataclass(logged):
        for part in dataclasses.fields(logged):
            below = f"{name}.{part.name}".lstrip(".")
            yield from differences(below, getattr(logged, part.name), getattr(replayed, part.name))
    elif isinstance(logged, tuple) and len(logged) == len(replayed):
        for i, pair in enumerate(zip(logged, replayed, strict=True)):
            yield from differences(f"{name}[{i}]", *pair)
    elif isinstance(logged, float) and math.isnan(logged):
        if not math.isnan(replayed):
            yield name, logged, replayed
    elif logged != replayed:
        yield name, logged, replayed


class Replay:
    """The controller with what the daemon does around it."""

    def __init__(self, robot: RobotConfig) -> None:
        self._robot = robot
        self._design = controller.design_controller(robot)
        self._initial = controller.initial_state(self._design)
        self._control: controller.ControllerState | None = None
        self._next_tick = 0
        self._state = DaemonState.DISCONNECTED
        self._check: WheelCheck | None = WheelCheck()  # None: of a phase that is not known
        self.missing = 0

    def begin(self, point: Checkpoint) -> None:
        """Take up the state of a checkpoint, unless the replay has it already."""
        if self._control is not None and self._next_tick == point.tick:
            return
        self._control = thaw(self._initial, point.values)
        self.missing += max(point.tick - self._next_tick, 0) if self._next_tick else 0
        self._next_tick = point.tick
        self._check = None

    def step(self, tick: Tick) -> Outputs | None:
        """What the tick commands; None when the state before it is not known."""
        if tick.tick == 0:
            self._control = self._initial
        elif tick.tick != self._next_tick:
            self.missing += tick.tick - self._next_tick if self._next_tick else 0
            self._control = None
        self._next_tick = tick.tick + 1
        arming = tick.state is DaemonState.ARMED and self._state is not DaemonState.ARMED
        self._state = tick.state
        if self._control is None:
            return None
        if arming and not tick.inputs.armed:
            self._control = controller.rearmed(self._design, self._control)
            self._check = WheelCheck()
        period_s = self._robot.loop.period_s
        self._control, outputs = controller.step(self._design, self._control, tick.inputs, period_s)
        return self._permitted(tick, outputs)

    def _permitted(self, tick: Tick, outputs: Outputs) -> Outputs:
        """What the daemon lets through."""
        if tick.state is not DaemonState.ARMED or not tick.inputs.armed:
            return replace(outputs, stroke_rate_mmps=STILL, wheel_rpm=STILL)
        if limits.is_late(self._robot.safety, tick.inputs):
            outputs = replace(outputs, stroke_rate_mmps=STILL, reason="holding: samples are late")
        if not self._robot.drive.enabled:
            return outputs
        return self._checked(tick, outputs)

    def _checked(self, tick: Tick, outputs: Outputs) -> Outputs:
        """Follow the check of the wheels. What the user wanted is not logged, but that the check began is.

        From a checkpoint on, how far the check was is not known: until a command reaches the controller,
        which proves that it had passed, what the check may have commanded is believed.
        """
        logged, command = tick.outputs.wheel_rpm, tick.inputs.command
        if self._check is None and (command.speed_mps or command.yaw_rate_radps):
            self._check = WheelCheck(Phase.PASSED)
        if self._check is None:
            return replace(outputs, wheel_rpm=logged) if logged in BY_CHECK else outputs
        if self._check.passed:
            return outputs
        began = logged == WheelCheck(Phase.LEFT).wheel_rpm
        self._check = wheel_check.step(self._check, began, tick.inputs, self._robot.loop.period_s)
        return replace(outputs, wheel_rpm=self._check.wheel_rpm)


def replay(log: Log, robot: RobotConfig | None = None) -> Replayed:
    """Replay a log with its own configuration, or with another one to see its effect. Raises LogError."""
    again = Replay(log.robot() if robot is None else robot)
    found = Replayed()
    for logged in log.messages((TICK, CHECKPOINT)):
        value = logged.value()
        if isinstance(value, Checkpoint):
            again.begin(value)
            continue
        outputs = again.step(value)
        if outputs is None:
            found.skipped += 1
        else:
            found.add(value, outputs)
    found.missing = again.missing
    return found
