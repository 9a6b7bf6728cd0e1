"""Ports that are listened in on: every byte read or written is shown to someone else, then goes its way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tiger.devices.ports import Port, PortProvider


class Listener(Protocol):
    """Told of all bytes; must be quick."""

    def __call__(self, port: str, data: bytes, *, sent: bool) -> None:
        """`data` came from `port`, or was sent to it by the host."""


class TappedPort:
    """A port, and a listener to it."""

    def __init__(self, port: Port, path: str, listener: Listener) -> None:
        self._port = port
        self._path = path
        self._listener = listener

    @property
    def name(self) -> str:
        """Path of the device."""
        return self._port.name

    @property
    def backlog(self) -> int:
        """Bytes taken but not yet written."""
        return self._port.backlog

    def fileno(self) -> int | None:
        """Descriptor to select on."""
        return self._port.fileno()

    def read(self) -> bytes:
        """What has arrived; raises OSError when the device is gone."""
        data = self._port.read()
        if data:
            self._listener(self._path, data, sent=False)
        return data

    def write(self, data: bytes) -> None:
        """Send without waiting; raises OSError when the device is gone. Only what was taken is shown."""
        self._port.write(data)
        if data:
            self._listener(self._path, data, sent=True)

    def close(self) -> None:
        """Give the device back."""
        self._port.close()


class TappedPorts:
    """A PortProvider whose ports are all listened to."""

    def __init__(self, ports: PortProvider, listener: Listener) -> None:
        self._ports = ports
        self._listener = listener

    def present(self, patterns: Iterable[str]) -> list[str]:
        """Paths of the devices there are now that match one of the shell patterns."""
        return self._ports.present(patterns)

    def same(self, path: str, other: str) -> bool:
        """Whether two paths lead to one device."""
        return self._ports.same(path, other)

    def open(self, path: str, baud: int) -> Port:
        """Open a device for this program alone; raises OSError."""
        return TappedPort(self._ports.open(path, baud), path, self._listener)
