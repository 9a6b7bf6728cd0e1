"""One logged run of the emulated robot, shared by the tests that only read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from tiger.config.robot import load_robot
from tiger.daemon.daemon import Daemon
from tiger.emulation.scenarios import load_scenario
from tiger.logs.session import LogSession
from tiger.record import Command
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.record import Record

TICKS_PER_S = 200
ARM_S, DRIVE_S, STOP_S, END_S = 3.0, 6.0, 9.5, 10.0
EPOCH_NS = 1_700_000_000_000_000_000


class Run(NamedTuple):
    """What was handed to a log, and where it is."""

    folder: Path
    rig: Rig
    records: list[Record]


def log_run(folder: Path, end_s: float = END_S, part_mb: float = 64.0) -> Run:
    """Arm, level on a tilting plate, drive, press the emergency stop."""
    robot = load_robot()
    robot = robot.model_copy(update={"log": robot.log.model_copy(update={"part_mb": part_mb})})
    rig = Rig(robot, load_scenario("shaking-plate"), seed=3)
    records: list[Record] = []
    with LogSession(folder, rig.config, rig.clock, epoch_ns=EPOCH_NS) as log:
        rig.daemon = Daemon(rig.config, log.tap(rig.ports), rig.clock)
        actions = {
            ARM_S: rig.daemon.arm,
            DRIVE_S: lambda: setattr(rig.daemon, "command", Command(speed_mps=0.3, yaw_rate_radps=0.1)),
            STOP_S: rig.daemon.estop,
        }
        for record in rig.run(end_s):
            records.append(record)
            log.record(record, rig.daemon._control)
            actions.get(len(records) / TICKS_PER_S, lambda: None)()
    assert log.problem is None
    assert log.dropped_packets == 0
    return Run(folder, rig, records)


@pytest.fixture(scope="session")
def log_a_run() -> Callable[..., Run]:
    """Return the function that logs a run into a folder."""
    return log_run


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One run in a single file."""
    return log_run(tmp_path_factory.mktemp("log"))
