"""The drive of a scenario reaches the daemon at its time, and only while the robot is armed."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from math import radians
from typing import Any, cast

from tiger.emulation.scenarios import DriveEvent
from tiger.record import Command, DaemonState
from tiger.rig.planned_drive import PlannedDrive

PLAN = (DriveEvent(at_s=5.0, speed_mps=0.5, yaw_rate_degps=10.0), DriveEvent(at_s=8.0))


@dataclass
class Daemon:
    """What the plan touches of a daemon."""

    state: DaemonState = DaemonState.ARMED
    command: Command = field(default_factory=Command)


def followed(daemon: Daemon, *times_s: float, plan: tuple[DriveEvent, ...] = PLAN) -> Command:
    drive = PlannedDrive(plan, cast("Any", daemon))
    for time_s in times_s:
        drive.follow(time_s)
    return daemon.command


def test_each_row_holds_from_its_time_on() -> None:
    assert followed(Daemon(), 4.99) == Command()
    assert followed(Daemon(), 4.99, 5.0) == Command(speed_mps=0.5, yaw_rate_radps=radians(10.0))
    assert followed(Daemon(), 5.0, 7.99).speed_mps == 0.5
    assert followed(Daemon(), 5.0, 8.0) == Command()


def test_what_else_is_commanded_stays() -> None:
    assert followed(Daemon(command=Command(roll_rad=0.1)), 5.0).roll_rad == 0.1
    assert followed(Daemon(command=Command(speed_mps=1.0)), 1.0, 6.0, plan=()).speed_mps == 1.0


def test_a_robot_that_is_not_armed_gets_a_neutral_command_until_it_is() -> None:
    daemon = Daemon(state=DaemonState.DISARMED)
    drive = PlannedDrive(PLAN, cast("Any", daemon))
    drive.follow(6.0)
    assert daemon.command == Command()
    daemon.state = DaemonState.ARMED
    drive.follow(6.1)
    assert daemon.command.speed_mps == 0.5
    daemon.state = DaemonState.FAULT
    drive.follow(6.2)
    assert daemon.command == Command()


def test_nothing_is_compiled_before_a_scenario_needs_the_vehicle() -> None:
    code = (
        "import sys, tiger.cli.main\n"
        "from tiger.config.robot import load_robot\n"
        "from tiger.emulation.scenarios import load_scenario\n"
        "from tiger.rig.virtual import Rig\n"
        "Rig(load_robot(None), load_scenario('shaking-plate'))\n"
        "assert 'numba' not in sys.modules\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
