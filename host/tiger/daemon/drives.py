"""The two Roboteqs, each on the port that the config names, opened again whenever they come back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.daemon.connection import Connection
from tiger.devices.roboteq import BAUD, Phase, Roboteq

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.devices.ports import PortProvider
    from tiger.record import DriveSample, Problem


class Drive:
    """One Roboteq and its port; channel 1 drives the front wheel of its side, channel 2 the rear one."""

    def __init__(self, side: str, path: str, ports: PortProvider, robot: RobotConfig) -> None:
        safety, rate_hz = robot.safety, robot.loop.drive_rate_hz
        self.driver = Roboteq(
            f"roboteq ({side})",
            path,
            safety.roboteq_watchdog_ms,
            rate_hz,
            safety.sustained_current_s,
            safety.roboteq_read_back,
            robot.drive.roboteq_speed_query,
        )
        self.connection = Connection(ports, path, BAUD)

    @property
    def sample(self) -> DriveSample | None:
        """What it last said."""
        return self.driver.sample if self.connection.is_open else None

    @property
    def known(self) -> bool:
        """Whether it is there, configured, and confirms commands."""
        return self.connection.is_open and self.driver.phase is not Phase.CONFIGURING

    @property
    def running(self) -> bool:
        """Whether commands reach its motors."""
        return self.connection.is_open and self.driver.phase is Phase.RUNNING

    def problem(self) -> Problem | None:
        """Why it cannot be used, or None."""
        return self.connection.problem or self.driver.problem

    def step(self, now_s: float) -> None:
        """Open its port when due."""
        if self.connection.open_if_due(now_s):
            self.driver.connected(now_s)

    def receive(self, now_s: float) -> None:
        """Read its port."""
        data = self.connection.read(now_s)
        if data:
            self.driver.feed(data, now_s)

    def send(self, now_s: float) -> None:
        """Write what is due."""
        if self.connection.is_open:
            data = self.driver.outgoing(now_s) if self.connection.has_room else b""
            self.connection.write(data, now_s)
