"""One port that is opened, and opened again after it failed, with growing pauses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.devices.ports import port_problem

if TYPE_CHECKING:
    from tiger.devices.ports import Port, PortProvider
    from tiger.record import Problem

FIRST_PAUSE_S = 0.25
LONGEST_PAUSE_S = 4.0


class Connection:
    """A path, and the open port behind it whenever there is one."""

    def __init__(self, ports: PortProvider, path: str, baud: int) -> None:
        self.path = path
        self.baud = baud
        self.port: Port | None = None
        self.problem: Problem | None = None
        self.was_open = False
        self._ports = ports
        self._pause_s = FIRST_PAUSE_S
        self._retry_s = float("-inf")

    @property
    def is_open(self) -> bool:
        """Whether bytes can go through."""
        return self.port is not None

    @property
    def has_room(self) -> bool:
        """Whether all bytes written so far are on their way."""
        return self.port is not None and self.port.backlog == 0

    def open_if_due(self, now_s: float) -> bool:
        """Open the port if it is closed and its pause is over; returns whether it was just opened."""
        if self.port is not None or now_s < self._retry_s:
            return False
        try:
            self.port = self._ports.open(self.path, self.baud)
        except OSError as error:
            self._failed(error, now_s)
            return False
        self.problem = None
        self.was_open = True
        return True

    def read(self, now_s: float) -> bytes:
        """What has arrived; nothing from a closed port."""
        if self.port is None:
            return b""
        try:
            data = self.port.read()
        except OSError as error:
            self._failed(error, now_s)
            return b""
        if data:
            self._pause_s = FIRST_PAUSE_S
        return data

    def write(self, data: bytes, now_s: float) -> None:
        """Send; with empty `data`, send on what the device did not take before."""
        if self.port is None or not (data or self.port.backlog):
            return
        try:
            self.port.write(data)
        except OSError as error:
            self._failed(error, now_s)

    def close(self) -> None:
        """Give the port back; it is opened again when due."""
        if self.port is not None:
            self.port.close()
            self.port = None

    def _failed(self, error: OSError, now_s: float) -> None:
        self.close()
        self.problem = port_problem(self.path, error)
        self._retry_s = now_s + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
