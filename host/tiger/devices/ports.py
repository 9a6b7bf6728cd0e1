"""Serial ports as the daemon sees them: bytes in, bytes out, never waiting.

The daemon is handed a `PortProvider`, so that it cannot tell a serial device from the emulated robot.
"""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from tiger.record import Problem, ProblemKind

if TYPE_CHECKING:
    from collections.abc import Iterable

READ_BYTES = 4096
MOST_BACKLOG_BYTES = 4096  # what a device that takes nothing for seconds may pile up


class Port(Protocol):
    """An open serial line."""

    @property
    def name(self) -> str:
        """Path of the device, for messages."""

    @property
    def backlog(self) -> int:
        """Bytes that `write` took and the device did not yet."""

    def fileno(self) -> int | None:
        """Descriptor to select on; None for a line that needs no waiting."""

    def read(self) -> bytes:
        """What has arrived; raises OSError when the device is gone."""

    def write(self, data: bytes) -> None:
        """Send without waiting; an empty `data` sends on with the backlog. Raises OSError when it is gone."""

    def close(self) -> None:
        """Give the device back."""


class PortProvider(Protocol):
    """Finds and opens ports."""

    def present(self, patterns: Iterable[str]) -> list[str]:
        """Paths of the devices there are now that match one of the shell patterns."""

    def same(self, path: str, other: str) -> bool:
        """Whether two paths lead to one device."""

    def open(self, path: str, baud: int) -> Port:
        """Open a device for this program alone; raises OSError."""


class SerialPort:
    """A serial device, opened through pyserial, that is read and written without waiting."""

    def __init__(self, path: str, baud: int) -> None:
        """Open `path` exclusively; raises OSError (pyserial's exceptions are OSErrors)."""
        import serial

        self._serial = serial.Serial(path, baud, exclusive=True, timeout=0, write_timeout=0)
        self._fd: int = self._serial.fileno()
        self._waiting = b""
        self._name = path
        with contextlib.suppress(OSError, ValueError, AttributeError):  # not every driver can
            self._serial.set_low_latency_mode(True)
        with contextlib.suppress(termios.error):
            self._keep_dtr()

    def _keep_dtr(self) -> None:
        """Do not drop DTR on close: on an Arduino its next rise is a reset."""
        attributes = termios.tcgetattr(self._fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)

    @property
    def name(self) -> str:
        """Path of the device."""
        return self._name

    @property
    def backlog(self) -> int:
        """Bytes taken but not yet written."""
        return len(self._waiting)

    def fileno(self) -> int | None:
        """Descriptor to select on."""
        return self._fd

    def read(self) -> bytes:
        """What has arrived; raises OSError when the device is gone."""
        try:
            return os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send without waiting; raises OSError when the device is gone or takes nothing any more."""
        self._waiting += data
        if not self._waiting:
            return
        try:
            self._waiting = self._waiting[os.write(self._fd, self._waiting) :]
        except BlockingIOError:
            if len(self._waiting) > MOST_BACKLOG_BYTES:
                raise OSError(errno.ETIMEDOUT, "the device takes no more bytes") from None

    def close(self) -> None:
        """Give the device back."""
        with contextlib.suppress(OSError):
            self._serial.close()


class SerialPorts:
    """The serial devices of this computer."""

    def present(self, patterns: Iterable[str]) -> list[str]:
        """Paths of the devices there are now that match one of the shell patterns."""
        return sorted({str(path) for pattern in patterns for path in Path("/").glob(pattern.lstrip("/"))})

    def same(self, path: str, other: str) -> bool:
        """Whether two paths lead to one device, links followed."""
        return Path(path).resolve() == Path(other).resolve()

    def open(self, path: str, baud: int) -> Port:
        """Open a device for this program alone; raises OSError."""
        return SerialPort(path, baud)


def port_problem(path: str, error: OSError) -> Problem:
    """Say why a port cannot be used, and what to do."""
    text, step = _EXPLAINED.get(error.errno or 0, ("", ""))
    if not text and "exclusively lock" in str(error):
        text, step = _EXPLAINED[errno.EBUSY]
    if not text:
        text, step = f"does not work ({error.strerror or error})", "Unplug it and plug it in again."
    return Problem(ProblemKind.PORT, path, text, step.format(path=path))


_BUSY = ("is in use by another program", "Close that program; `fuser -v {path}` names it.")
_GONE = ("was unplugged", "Plug it in again.")
_EXPLAINED = {
    errno.EACCES: (
        "may not be opened by this user",
        "Add yourself to its group with `sudo usermod -aG dialout $USER`, then log in again.",
    ),
    errno.EPERM: (
        "may not be opened by this user",
        "Add yourself to its group with `sudo usermod -aG dialout $USER`, then log in again.",
    ),
    errno.ENOENT: ("is not there", "Connect the device, or correct its path under [ports]."),
    errno.EBUSY: _BUSY,
    errno.EAGAIN: _BUSY,
    errno.EIO: _GONE,
    errno.ENODEV: _GONE,
    errno.ENXIO: _GONE,
    errno.ETIMEDOUT: ("takes no more bytes", "Unplug it and plug it in again."),
}
