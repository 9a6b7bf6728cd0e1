"""The drive of a scenario: speed and yaw rate, commanded to the daemon as time passes.

A plan is either a table of commands over time or a route of waypoints, which a driver follows by looking a
little ahead along it (pure pursuit: Coulter, CMU-RI-TR-92-01): the arc from where the robot is to the point
that lies `lookahead_m` ahead on the way has the curvature 2 y/L2, y being how far left the point lies and L
how far away. The driver sees the robot where it is, or where it believes to be.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import copysign, cos, hypot, inf, radians, sin, sqrt
from typing import TYPE_CHECKING

from tiger.record import DaemonState, Odometry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tiger.daemon.daemon import Daemon
    from tiger.emulation.scenarios import DriveEvent, RouteConfig, Scenario, Start, Waypoint

Pose = tuple[float, float, float]
"""x and y in m and yaw in rad, in the world."""

CREEP_MPS = 0.1
"""Speed left at the very end of a route."""
BRAKING_MPS2 = 0.5
NOWHERE = Odometry()


class Pursuit:
    """Follows waypoints; remembers how far along it is."""

    def __init__(self, start: Start, waypoints: Sequence[Waypoint], route: RouteConfig) -> None:
        """Take at least one waypoint; the way to the first leads from the start."""
        legs = list(waypoints) * route.laps
        places = [(start.x_m, start.y_m), *((w.x_m, w.y_m) for w in legs)]
        self._legs = [(a, b, w.speed_mps) for (a, b), w in zip(pairwise(places), legs, strict=True) if a != b]
        self._route = route
        self._leg = 0

    @property
    def arrived(self) -> bool:
        """The last waypoint is behind the robot."""
        return self._leg == len(self._legs)

    def steer(self, pose: Pose) -> tuple[float, float]:
        """Return speed in m/s and yaw rate in rad/s from a pose; zeros after the last waypoint."""
        x, y, yaw = pose
        while not self.arrived and self._left_of_leg_m(x, y) <= 0.0:
            self._leg += 1
        if self.arrived:
            return 0.0, 0.0
        ahead_x, ahead_y = self._ahead(x, y)
        east, north = ahead_x - x, ahead_y - y
        distance_m = max(hypot(east, north), 1e-6)
        forward, left = cos(yaw) * east + sin(yaw) * north, cos(yaw) * north - sin(yaw) * east
        curvature_per_m = 2.0 * left / distance_m**2
        if forward < 0.0:  # behind: the tightest arc, to the nearer side
            curvature_per_m = copysign(2.0 / distance_m, left)
        yaw_most = radians(self._route.max_yaw_rate_degps)
        speed = min(self._legs[self._leg][2], yaw_most / max(abs(curvature_per_m), 1e-9))
        speed = min(speed, sqrt(2.0 * BRAKING_MPS2 * self._left_of_route_m(x, y)) + CREEP_MPS)
        return speed, speed * curvature_per_m

    def _left_of_leg_m(self, x: float, y: float, leg: int | None = None) -> float:
        (ax, ay), (bx, by), _ = self._legs[self._leg if leg is None else leg]
        length = hypot(bx - ax, by - ay)
        return ((bx - x) * (bx - ax) + (by - y) * (by - ay)) / length

    def _left_of_route_m(self, x: float, y: float) -> float:
        return inf if self._leg < len(self._legs) - 1 else self._left_of_leg_m(x, y)

    def _ahead(self, x: float, y: float) -> tuple[float, float]:
        """Point on the way, `lookahead_m` beyond the robot's place on it; beyond the end straight on."""
        beyond = self._route.lookahead_m
        left = max(self._left_of_leg_m(x, y), 0.0)
        leg = self._leg
        while beyond > left and leg < len(self._legs) - 1:
            beyond -= left
            leg += 1
            (ax, ay), (bx, by), _ = self._legs[leg]
            left = hypot(bx - ax, by - ay)
        (ax, ay), (bx, by), _ = self._legs[leg]
        over = (beyond - left) / hypot(bx - ax, by - ay)
        return bx + over * (bx - ax), by + over * (by - ay)


class PlannedDrive:
    """Call `follow` once a tick. Only an armed robot is told to drive: arming needs a neutral command."""

    def __init__(self, scenario: Scenario, daemon: Daemon, true_pose: Callable[[], Pose]) -> None:
        """`true_pose` tells where the robot really is, for a driver that looks."""
        self._plan: tuple[DriveEvent, ...] = scenario.drive
        self._route, self._start = scenario.route, scenario.start
        self._pursuit = Pursuit(self._start, scenario.waypoint, self._route) if scenario.waypoint else None
        self._daemon = daemon
        self._true_pose = true_pose
        self._commanded = (0.0, 0.0)

    @property
    def arrived(self) -> bool:
        """The route has been driven; False for a plan without one."""
        return self._pursuit is not None and self._pursuit.arrived

    def follow(self, time_s: float, odometry: Odometry = NOWHERE) -> None:
        """Command what the plan says for this time; leave alone whatever else is commanded meanwhile.

        `odometry` is what the robot believes, for a driver that steers by it.
        """
        wanted = self._wanted(time_s, odometry) if self._daemon.state is DaemonState.ARMED else (0.0, 0.0)
        if wanted != self._commanded:
            self._commanded = wanted
            speed_mps, yaw_rate_radps = wanted
            self._daemon.command = replace(
                self._daemon.command, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps
            )

    def _wanted(self, time_s: float, odometry: Odometry) -> tuple[float, float]:
        if self._pursuit is not None:
            if time_s < self._route.at_s:
                return 0.0, 0.0
            believed = self._route.steer_by == "odometry"
            return self._pursuit.steer(
                believed_pose(self._start, odometry) if believed else self._true_pose()
            )
        wanted = (0.0, 0.0)
        for event in self._plan:
            if event.at_s > time_s:
                break
            wanted = event.speed_mps, radians(event.yaw_rate_degps)
        return wanted


def believed_pose(start: Start, odometry: Odometry) -> Pose:
    """Return in the world what odometry counts from the start."""
    yaw = radians(start.yaw_deg)
    x, y = odometry.x_m, odometry.y_m
    return (
        start.x_m + cos(yaw) * x - sin(yaw) * y,
        start.y_m + sin(yaw) * x + cos(yaw) * y,
        yaw + odometry.yaw_rad,
    )
