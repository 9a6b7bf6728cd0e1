"""The emulated robot in real time and in a process of its own, behind pseudo-terminals.

with SeparateRobot(vehicle, "shaking-plate", seed=0) as robot:
    daemon = Daemon(config.model_copy(update={"ports": robot.ports}), SerialPorts(), MonotonicClock())
    robot.truth()          # what the world really does, for plots only
"""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
import time
from multiprocessing.sharedctypes import RawArray
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tiger.config.robot import PortsConfig

if TYPE_CHECKING:
    from multiprocessing.synchronize import Event

    from tiger.config.vehicle import VehicleConfig

START_TIME_S = 300.0
"""The first start on a computer compiles the vehicle model."""


class SeparateTruth(NamedTuple):
    """True attitude at a moment of virtual time."""

    time_s: float
    roll_deg: float
    pitch_deg: float


class SeparateRobot:
    """Context manager; see the module's text."""

    def __init__(self, vehicle: VehicleConfig, scenario: str, seed: int = 0) -> None:
        """`scenario` is a name or a path, and must be one that can be loaded."""
        context = multiprocessing.get_context("spawn")
        self._folder = tempfile.TemporaryDirectory(prefix="tiger-")
        self._truth: Any = RawArray("d", len(SeparateTruth._fields))
        self._ready = context.Event()
        self._begin = context.Event()
        self._process = context.Process(
            target=_serve,
            args=(vehicle, scenario, seed, self._folder.name, self._truth, self._ready, self._begin),
            daemon=True,
        )

    @property
    def ports(self) -> PortsConfig:
        """Where its serial lines are."""
        folder = Path(self._folder.name)
        return PortsConfig(
            boards=(f"{folder}/board-*",),
            roboteq_left=f"{folder}/roboteq-left",
            roboteq_right=f"{folder}/roboteq-right",
        )

    def truth(self) -> SeparateTruth:
        """What the world really does."""
        return SeparateTruth(*self._truth)

    def begin(self) -> None:
        """Let its time run; until then its lines are there and silent."""
        self._begin.set()

    def __enter__(self) -> SeparateRobot:
        self._process.start()
        deadline_s = time.monotonic() + START_TIME_S
        while not self._ready.wait(0.1):
            if self._process.is_alive() and time.monotonic() < deadline_s:
                continue
            self.__exit__()
            raise RuntimeError("the emulated robot did not start; run `tiger emulate` to see why")
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.join(timeout=5.0)
        self._folder.cleanup()


def _serve(
    vehicle: VehicleConfig, scenario: str, seed: int, folder: str, truth: Any, ready: Event, begin: Event
) -> None:
    """Body of the process."""
    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.scenarios import load_scenario
    from tiger.emulation.serve import PtyRobot

    def each_step(robot: EmulatedRobot) -> bool:
        now = robot.truth()
        truth[:] = (now.time_s, now.roll_deg, now.pitch_deg)
        return True

    robot = EmulatedRobot(vehicle, load_scenario(scenario), seed=seed)
    with contextlib.suppress(KeyboardInterrupt), PtyRobot(robot, Path(folder)) as served:
        ready.set()
        begin.wait()
        served.run(float("inf"), each_step)
