"""Boards in simavr, built on demand: the images with make, the simulator's wrapper with cffi."""

from __future__ import annotations

import fcntl
import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
MID_STROKE_CODE = 512


@pytest.fixture(scope="session")
def simulated() -> ModuleType:
    """Module `simulated`, with the images of the present sources."""
    (ROOT / "build").mkdir(exist_ok=True)
    with (ROOT / "build" / "avr.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # several test processes may come here at once
        subprocess.run(["make", "--silent", "firmware-images"], cwd=ROOT, check=True)
        if str(HERE) not in sys.path:
            sys.path.insert(0, str(HERE))
        return importlib.import_module("simulated")


@pytest.fixture
def make_board(simulated: ModuleType) -> Iterator[Callable[[str], Any]]:
    """Make a simulated board with its image, its inputs at rest."""
    made = []

    def make(name: str) -> Any:
        board = simulated.Board(name)
        made.append(board)
        if name == "mega_suspension":
            for corner in range(4):
                board.adc(corner, MID_STROKE_CODE)
                board.pin(f"A{4 + corner}", 0)  # limit switches closed: not pressed
                board.pin(f"C{7 - corner}", 0)
            board.pin("E5", 0)  # emergency stop closed
        if name == "mega_speed":
            for pin in ("E4", "E5", "D2", "D3"):
                board.pin(pin, 0)
        if name == "nano_imu":
            board.add_bno055()
        return board

    yield make
    for board in made:
        board.close()


@pytest.fixture
def suspension(simulated: ModuleType, make_board: Callable[[str], Any]) -> Any:
    """The host's end of a booted mega_suspension without a Nano."""
    host = simulated.Host([make_board("mega_suspension")], (simulated.KIND["mega_suspension"],))
    host.listen(400)
    return host


@pytest.fixture
def armed(simulated: ModuleType, suspension: Any) -> Any:
    """The same on its four actuators, armed, and a neutral setpoint accepted."""
    suspension.world = simulated.Actuators(suspension.board).step
    assert suspension.arm().status == 0
    suspension.command((0, 0, 0, 0), 50)
    return suspension


@pytest.fixture
def speed(simulated: ModuleType, make_board: Callable[[str], Any]) -> Any:
    """The host's end of a booted mega_speed."""
    host = simulated.Host([make_board("mega_speed")], (simulated.KIND["mega_speed"],))
    host.listen(50)
    return host


@pytest.fixture
def pair(simulated: ModuleType, make_board: Callable[[str], Any]) -> Any:
    """The host's end of a mega_suspension with a nano_imu behind it; `boards` are both."""
    mega, nano = make_board("mega_suspension"), make_board("nano_imu")
    mega.connect(1, nano, 0)
    return simulated.Host([mega, nano], (simulated.KIND["mega_suspension"], simulated.KIND["nano_imu"]))
