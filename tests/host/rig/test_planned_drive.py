"""The drive of a scenario reaches the daemon at its time, and only while the robot is armed."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from math import cos, hypot, pi, radians, sin
from typing import Any, cast

import pytest

from tiger.emulation.scenarios import DriveEvent, RouteConfig, Scenario, Start, Waypoint
from tiger.record import Command, DaemonState, Odometry
from tiger.rig.planned_drive import PlannedDrive, Pose, Pursuit, believed_pose

PLAN = (DriveEvent(at_s=5.0, speed_mps=0.5, yaw_rate_degps=10.0), DriveEvent(at_s=8.0))
SQUARE = tuple(Waypoint(x_m=x, y_m=y, speed_mps=1.0) for x, y in ((8, 0), (8, 8), (0, 8), (0, 0)))


def scenario(**keys: Any) -> Scenario:
    return Scenario(title="t", duration_s=60.0, **keys)


def at(pose: Pose) -> Any:
    return lambda: pose


@dataclass
class Daemon:
    """What the plan touches of a daemon."""

    state: DaemonState = DaemonState.ARMED
    command: Command = field(default_factory=Command)


def followed(daemon: Daemon, *times_s: float, plan: tuple[DriveEvent, ...] = PLAN) -> Command:
    drive = PlannedDrive(scenario(drive=plan), cast("Any", daemon), at((0.0, 0.0, 0.0)))
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
    drive = PlannedDrive(scenario(drive=PLAN), cast("Any", daemon), at((0.0, 0.0, 0.0)))
    drive.follow(6.0)
    assert daemon.command == Command()
    daemon.state = DaemonState.ARMED
    drive.follow(6.1)
    assert daemon.command.speed_mps == 0.5
    daemon.state = DaemonState.FAULT
    drive.follow(6.2)
    assert daemon.command == Command()


def drive_route(pursuit: Pursuit, pose: Pose, most_s: float = 200.0) -> tuple[Pose, float, float]:
    """Move a point as told; return where it ends, how far it went, and the farthest from x = 0 to 8 m."""
    x, y, yaw = pose
    dt, gone, worst = 0.02, 0.0, 0.0
    for _ in range(round(most_s / dt)):
        speed, yaw_rate = pursuit.steer((x, y, yaw))
        if pursuit.arrived:
            break
        yaw += yaw_rate * dt
        x, y = x + cos(yaw) * speed * dt, y + sin(yaw) * speed * dt
        gone += speed * dt
        worst = max(worst, -x, x - 8.0, -y, y - 8.0)
    return (x, y, yaw), gone, worst


@pytest.mark.parametrize("laps", [1, 3])
def test_a_route_is_followed_round_its_corners_to_its_end(laps: int) -> None:
    (x, y, _), gone, worst = drive_route(
        Pursuit(Start(), SQUARE, RouteConfig(laps=laps)), (0.0, 0.0, 0.0), 100.0 * laps
    )
    assert hypot(x, y) < 0.3
    assert 0.85 * 32.0 * laps < gone < 1.02 * 32.0 * laps  # it cuts corners a little
    assert worst < 0.5


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -135.0])
def test_the_way_is_found_whichever_way_the_robot_looks(yaw_deg: float) -> None:
    (x, y, _), _, _ = drive_route(Pursuit(Start(), SQUARE, RouteConfig()), (0.0, 0.0, radians(yaw_deg)))
    assert hypot(x, y) < 0.3


def test_bends_are_driven_no_faster_than_the_yaw_rate_allows() -> None:
    route = RouteConfig(max_yaw_rate_degps=20.0)
    pursuit = Pursuit(Start(), SQUARE, route)
    for step in range(200):
        _, yaw_rate = pursuit.steer((7.5, 0.0, 2.0 * pi * step / 200.0))
        assert abs(yaw_rate) <= radians(20.0) + 1e-9


def test_a_route_waits_for_its_time_and_ends_with_a_stop() -> None:
    daemon = Daemon()
    place = [(0.0, 0.0, 0.0)]
    plan = scenario(waypoint=SQUARE[:1], route=RouteConfig(at_s=6.0))
    drive = PlannedDrive(plan, cast("Any", daemon), lambda: place[0])
    drive.follow(5.99)
    assert daemon.command == Command()
    drive.follow(6.0)
    assert daemon.command.speed_mps == 1.0
    assert not drive.arrived
    place[0] = (8.0, 0.01, 0.0)
    drive.follow(20.0)
    assert daemon.command == Command()
    assert drive.arrived


def test_a_driver_that_does_not_look_steers_by_what_the_robot_believes() -> None:
    daemon = Daemon()
    plan = scenario(
        waypoint=SQUARE[:1],
        start=Start(x_m=1.0, yaw_deg=90.0),
        route=RouteConfig(at_s=0.0, steer_by="odometry"),
    )
    drive = PlannedDrive(plan, cast("Any", daemon), at((50.0, 50.0, 0.0)))
    drive.follow(1.0, Odometry(x_m=0.0, y_m=-1.0, yaw_rad=radians(-90.0)))  # on the way, looking along it
    assert daemon.command.speed_mps == 1.0
    assert daemon.command.yaw_rate_radps == pytest.approx(0.0, abs=1e-9)


def test_odometry_counts_from_the_start() -> None:
    start = Start(x_m=3.0, y_m=1.0, yaw_deg=90.0)
    pose = believed_pose(start, Odometry(x_m=2.0, y_m=0.5, yaw_rad=0.1))
    assert pose == pytest.approx((2.5, 3.0, radians(90.0) + 0.1))


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
