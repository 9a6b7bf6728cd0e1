"""The drive of a scenario: speed and yaw rate, commanded to the daemon as time passes."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import TYPE_CHECKING

from tiger.record import DaemonState

if TYPE_CHECKING:
    from tiger.daemon.daemon import Daemon
    from tiger.emulation.scenarios import DriveEvent


class PlannedDrive:
    """Call `follow` once a tick. Only an armed robot is told to drive: arming needs a neutral command."""

    def __init__(self, plan: tuple[DriveEvent, ...], daemon: Daemon) -> None:
        self._plan = plan
        self._daemon = daemon
        self._commanded = (0.0, 0.0)

    def follow(self, time_s: float) -> None:
        """Command what the plan says for this time; leave alone whatever else is commanded meanwhile."""
        wanted = self._wanted(time_s) if self._daemon.state is DaemonState.ARMED else (0.0, 0.0)
        if wanted != self._commanded:
            self._commanded = wanted
            speed_mps, yaw_rate_radps = wanted
            self._daemon.command = replace(
                self._daemon.command, speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps
            )

    def _wanted(self, time_s: float) -> tuple[float, float]:
        wanted = (0.0, 0.0)
        for event in self._plan:
            if event.at_s > time_s:
                break
            wanted = event.speed_mps, radians(event.yaw_rate_degps)
        return wanted
