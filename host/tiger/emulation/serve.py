"""The emulated robot in real time behind pseudo-terminals, for any program that can open a serial port.

`PtyRobot` makes a folder with one link per serial line and a `robot.toml` that names them:

    board-suspension  board-speed-left  board-speed-right  roboteq-left  roboteq-right  robot.toml

and keeps the robot's virtual time beside the wall clock, a millisecond at a time.
"""

from __future__ import annotations

import contextlib
import os
import pty
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING

from tiger.emulation.robot import STEP_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.emulation.cable import Cable
    from tiger.emulation.robot import EmulatedRobot

LINKS = {
    "suspension": "board-suspension",
    "speed_left": "board-speed-left",
    "speed_right": "board-speed-right",
    "roboteq_left": "roboteq-left",
    "roboteq_right": "roboteq-right",
}
"""Cable of the emulated robot -> name of its link in the folder."""

READ_BYTES = 4096
MOST_BEHIND_S = 0.03
"""What a stall took beyond this is not made up for: in a long burst the boards would hear no one, and once a
board has been 50 ms behind the host, whatever the host says after it caught up is too old for it."""


class PtyLine:
    """One cable behind one pseudo-terminal."""

    def __init__(self, cable: Cable, link: Path) -> None:
        self._cable = cable
        self._link = link
        # The slave end stays open here, so that programs may come and go without the line hanging up.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))

    def carry(self) -> None:
        """Move what waits on either side. A program that reads nothing loses bytes, as from a real UART."""
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._master, READ_BYTES)
            self._cable.host_write(data)
        waiting = self._cable.host_read()
        if waiting:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, waiting)

    def close(self) -> None:
        """Remove the link and hang up."""
        self._link.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)


class PtyRobot:
    """Context manager: the robot behind pseudo-terminals in `folder`, which is made if it is not there."""

    def __init__(self, robot: EmulatedRobot, folder: Path) -> None:
        self.robot = robot
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._lines = [PtyLine(robot.cables[cable], folder / link) for cable, link in LINKS.items()]
        self._config = folder / "robot.toml"
        self._config.write_text(_config_text(folder), encoding="utf-8")
        self.began_s = 0.0  # when its time was zero, on the monotonic clock
        self.longest_step_s = 0.0
        self.skipped_s = 0.0  # wall time that stalls took away from the robot

    def __enter__(self) -> PtyRobot:
        return self

    def __exit__(self, *_: object) -> None:
        for line in self._lines:
            line.close()
        self._config.unlink(missing_ok=True)

    def run(self, duration_s: float, each_step: Callable[[EmulatedRobot], bool] | None = None) -> None:
        """Keep the robot beside the wall clock for `duration_s`, or until `each_step` returns False."""
        robot = self.robot
        end_s = robot.time_s + duration_s
        self.began_s = time.monotonic() - robot.time_s - self.skipped_s
        while robot.time_s < end_s:
            began_s = time.monotonic()
            for line in self._lines:
                line.carry()
            robot.run()
            if each_step is not None and not each_step(robot):
                return
            now_s = time.monotonic()
            self.longest_step_s = max(self.longest_step_s, now_s - began_s)
            behind_s = now_s - self.began_s - self.skipped_s - robot.time_s
            if behind_s > MOST_BEHIND_S:
                self.skipped_s += behind_s - MOST_BEHIND_S
            elif behind_s < -STEP_S:
                time.sleep(-behind_s - 0.5 * STEP_S)


def _config_text(folder: Path) -> str:
    where = folder.resolve()
    return (
        "# Written by the emulated robot: where its serial lines are.\n"
        "[ports]\n"
        f'boards = ["{where}/board-*"]\n'
        f'roboteq_left = "{where}/{LINKS["roboteq_left"]}"\n'
        f'roboteq_right = "{where}/{LINKS["roboteq_right"]}"\n'
    )
