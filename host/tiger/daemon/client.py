"""Talk to a running daemon: standard library only, so copy this file into any program.

    with Robot() as robot:
        robot.ask("arm")
        robot.wait_for("ARMED")
        for _ in range(20):  # a drive command lives for half a second: repeat it
            robot.ask("drive", speed_mps=0.3, yaw_rate_radps=0.0)
            time.sleep(0.1)
        robot.ask("release")

docs/api.md lists every request. One `Robot` belongs to one thread.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections import deque
from pathlib import Path
from typing import Any, Self


class Refused(Exception):
    """The daemon said no; the text says why and what to do."""


def socket_path() -> Path:
    """Where the daemon listens: $TIGER_SOCKET, or a folder of the user's own."""
    if named := os.environ.get("TIGER_SOCKET"):
        return Path(named)
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime, "tiger") if runtime else Path(f"/tmp/tiger-{os.getuid()}")
    return folder / "robot.sock"


class Robot:
    """A connection. Raises ConnectionError or TimeoutError, both OSError, when the daemon is not there."""

    def __init__(self, path: Path | None = None, timeout_s: float = 2.0) -> None:
        self.path = path or socket_path()
        self._telemetry: deque[dict[str, Any]] = deque(maxlen=100)
        self._received = b""
        self._id = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout_s)
        try:
            self._socket.connect(str(self.path))
        except OSError:
            self._socket.close()
            raise

    def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        """Send a request and return its answer. Raises Refused."""
        self._id += 1
        self._socket.sendall(json.dumps({"id": self._id, "do": do, **fields}).encode() + b"\n")
        while (line := self._line()).get("id", -1) != self._id:
            self._telemetry.append(line)
        if not line["ok"]:
            raise Refused(f"{line['reason'].rstrip('.')}. {line['next_step']}")
        return line

    def wait_for(self, state: str, seconds: float = 5.0) -> None:
        """Wait until the robot is in a state. Raises TimeoutError, which tells the state it is in instead."""
        end_s = time.monotonic() + seconds
        while (status := self.ask("status")["status"])["state"] != state:
            if time.monotonic() > end_s:
                raise TimeoutError(f"the robot is in {status['state']}: {status['reason']}")
            time.sleep(0.02)

    def telemetry(self) -> dict[str, Any]:
        """Wait for the next telemetry; `ask("subscribe", rate_hz=10)` first."""
        return self._telemetry.popleft() if self._telemetry else self._line()

    def _line(self) -> dict[str, Any]:
        while b"\n" not in self._received:
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionResetError("the daemon closed the connection")
            self._received += data
        text, self._received = self._received.split(b"\n", 1)
        line: dict[str, Any] = json.loads(text)
        if line.get("closing"):
            raise Refused(f"{line['reason'].rstrip('.')}. {line['next_step']}")
        return line

    def close(self) -> None:
        """Hang up; a robot that this connection drove stops."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
