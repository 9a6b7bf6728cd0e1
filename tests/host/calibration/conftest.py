"""An emulated robot on the bench, and someone who calibrates it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest

from tiger.calibration import parameters
from tiger.calibration.person import EmulatedPerson
from tiger.calibration.runner import run
from tiger.calibration.station import Station, VirtualTime
from tiger.config.robot import load_robot
from tiger.emulation.scenarios import Scenario
from tiger.protocol.messages import BoardKind, ImuAttitude, ImuRaw
from tiger.rig.ports import EMULATED_PORTS
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.calibration.procedure import Procedure, Result
    from tiger.protocol.messages import Message
    from tiger.record import Four

LEVEL_GROUND = Scenario(title="stands on level ground", duration_s=60.0)


@dataclass
class Bench:
    """An emulated robot, the station that talks to its boards, and the person beside it."""

    rig: Rig
    person: EmulatedPerson
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.station = Station(EMULATED_PORTS, self.rig.ports, VirtualTime(self.rig))

    def calibrate(self, procedure: Procedure, store: bool = True) -> Result:
        """Run a procedure and keep what it found."""
        result = run(procedure, self.station, self.person)
        if store:
            parameters.store(self.station, procedure.board, result.parameters)
        return result

    def power_cycle(self, kind: BoardKind) -> None:
        """Take the supply away from a board for a moment, and wait until it is back."""
        board = self.rig.robot.imu if kind is BoardKind.NANO_IMU else self.rig.robot.suspension
        board.reset()
        self.gather(1.5)
        self.station.connect(BoardKind.MEGA_SUSPENSION, kind)

    def gather(self, seconds: float) -> list[Message]:
        """What the boards send in that time."""
        end_s = self.rig.time_s + seconds
        messages: list[Message] = []
        while self.rig.time_s < end_s:
            messages += [message for _, message in self.station.advance()]
        return messages

    def attitude(self, seconds: float = 2.0) -> ImuAttitude:
        """What the Nano makes of its readings, after some time."""
        return [m for m in self.gather(seconds) if isinstance(m, ImuAttitude)][-1]

    def raw(self, seconds: float = 2.0) -> list[ImuRaw]:
        """Raw readings."""
        return [m for m in self.gather(seconds) if isinstance(m, ImuRaw)]

    def stroke_error_mm(self) -> Four:
        """What the board measures, less the truth."""
        self.gather(0.5)
        assert self.station.stroke_mm is not None
        truth = self.rig.robot.truth().stroke_mm
        a, b, c, d = (measured - true for measured, true in zip(self.station.stroke_mm, truth, strict=True))
        return a, b, c, d


@pytest.fixture
def bench_on() -> Callable[[Scenario], Bench]:
    """Return `bench(scenario)`."""

    def bench(scenario: Scenario) -> Bench:
        rig = Rig(load_robot(None), scenario, seed=5)
        return Bench(rig, EmulatedPerson(rig))

    return bench


@pytest.fixture
def bench(bench_on: Callable[[Scenario], Bench]) -> Bench:
    """A robot on level ground."""
    return bench_on(LEVEL_GROUND)
