"""The emulated robot's cables as the ports a daemon opens, in the same process and in virtual time."""

from __future__ import annotations

import errno
from fnmatch import fnmatch
from typing import TYPE_CHECKING

from tiger.config.robot import PortsConfig

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from tiger.devices.ports import Port
    from tiger.emulation.cable import Cable

EMULATED_PORTS = PortsConfig(
    boards=("/emulated/board-*",),
    roboteq_left="/emulated/roboteq-left",
    roboteq_right="/emulated/roboteq-right",
)
"""Where the daemon of a rig looks for its devices."""

PATHS = {
    "suspension": "/emulated/board-suspension",
    "speed_left": "/emulated/board-speed-left",
    "speed_right": "/emulated/board-speed-right",
    "roboteq_left": EMULATED_PORTS.roboteq_left,
    "roboteq_right": EMULATED_PORTS.roboteq_right,
}
"""Cable of the emulated robot -> path of its port."""


class CablePort:
    """One end of a cable, open. A cut cable raises OSError as an unplugged device does."""

    backlog = 0

    def __init__(self, name: str, cable: Cable) -> None:
        self.name = name
        self._cable = cable

    def fileno(self) -> None:
        """Nothing to select on: bytes arrive when the rig lets time pass."""

    def read(self) -> bytes:
        """What has arrived."""
        self._need_plug()
        return self._cable.host_read()

    def write(self, data: bytes) -> None:
        """Send."""
        self._need_plug()
        if data:
            self._cable.host_write(data)

    def close(self) -> None:
        """Nothing to give back."""

    def _need_plug(self) -> None:
        if self._cable.is_cut:
            raise OSError(errno.EIO, "unplugged")


class CablePorts:
    """PortProvider over cables; `paths` maps the path of a port to its cable, so that a test may swap two."""

    def __init__(self, cables: Mapping[str, Cable]) -> None:
        self.paths: dict[str, Cable] = {PATHS[name]: cable for name, cable in cables.items()}

    def present(self, patterns: Iterable[str]) -> list[str]:
        """Paths of the plugged-in ports that match one of the patterns."""
        wanted = tuple(patterns)
        return sorted(
            path
            for path, cable in self.paths.items()
            if not cable.is_cut and any(fnmatch(path, pattern) for pattern in wanted)
        )

    def same(self, path: str, other: str) -> bool:
        """Whether two paths lead to one device."""
        return path == other

    def open(self, path: str, baud: int) -> Port:
        """Open a port; raises OSError when nothing is plugged in there."""
        cable = self.paths.get(path)
        if cable is None or cable.is_cut:
            raise OSError(errno.ENOENT, "no such device", path)
        cable.host_read()
        return CablePort(path, cable)
