"""The emulated robot in a process of its own, in real time behind pseudo-terminals, for a daemon in this one.

    with EmulatedProcess(load_vehicle("tiger"), load_scenario("shaking-plate"), seed=0) as emulated:
        daemon = Daemon(config.model_copy(update={"ports": emulated.ports}), SerialPorts(), clock)
        emulated.go()                    # the scenario's time starts now
        loop.run(daemon, ...)
        emulated.stop()
    emulated.truth                       # rows of TRUTH_COLUMNS on this computer's monotonic clock

The daemon reaches it through pyserial only, exactly as it reaches the robot.
"""

from __future__ import annotations

import multiprocessing
import signal
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiger.config.robot import PortsConfig
from tiger.emulation.serve import LINKS

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from types import TracebackType

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.scenarios import Scenario

TRUTH_COLUMNS = (
    "monotonic_s",
    "roll_deg",
    "pitch_deg",
    "stroke_fl_mm",
    "stroke_fr_mm",
    "stroke_rl_mm",
    "stroke_rr_mm",
)
TRUTH_EVERY_MS = 5
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 10.0


class EmulatedProcess:
    """Context manager; see the top of this file.

    Raises:
        RuntimeError: the process did not come up.
    """

    def __init__(self, vehicle: VehicleConfig, scenario: Scenario, seed: int = 0) -> None:
        self.truth: list[tuple[float, ...]] = []
        self._folder = tempfile.TemporaryDirectory(prefix="tiger-")
        where = Path(self._folder.name)
        self.ports = PortsConfig(
            boards=(f"{where}/board-*",),
            roboteq_left=f"{where}/{LINKS['roboteq_left']}",
            roboteq_right=f"{where}/{LINKS['roboteq_right']}",
        )
        context = multiprocessing.get_context("spawn")
        self._latest = context.Array("d", len(TRUTH_COLUMNS))
        self._ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(vehicle, scenario, seed, where, theirs, self._latest), daemon=True
        )

    def __enter__(self) -> EmulatedProcess:
        self._process.start()
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while not self._ours.poll(0.1):
            if not self._process.is_alive() or time.monotonic() > deadline_s:
                self._end()
                raise RuntimeError("the emulated robot did not start; run `tiger emulate` to see why")
        self._ours.recv()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._end()

    def go(self) -> None:
        """Start the scenario."""
        self._ours.send("go")

    def latest_truth(self) -> tuple[float, ...]:
        """The newest row of TRUTH_COLUMNS, while it runs."""
        with self._latest.get_lock():
            return tuple(self._latest)

    def stop(self) -> None:
        """End the scenario and fetch the truth."""
        if not self._process.is_alive():
            return
        self._ours.send("stop")
        if self._ours.poll(STOP_TIMEOUT_S):
            self.truth = self._ours.recv()
        self._process.join(STOP_TIMEOUT_S)

    def _end(self) -> None:
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(STOP_TIMEOUT_S)
        self._folder.cleanup()


def _serve(
    vehicle: VehicleConfig, scenario: Scenario, seed: int, folder: Path, parent: Connection, latest: Any
) -> None:
    """Body of the process: serve until told to stop, then hand over the truth."""
    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.serve import PtyRobot

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the daemon, which then tells us
    rows: list[tuple[float, ...]] = []

    def each_step(robot: EmulatedRobot) -> bool:
        if robot.world.time_us // 1000 % TRUTH_EVERY_MS == 0:
            world = robot.world
            row = (time.monotonic(), world.roll_deg, world.pitch_deg, *world.stroke_mm)
            rows.append(row)
            with latest.get_lock():
                latest[:] = row
            return not parent.poll()
        return True

    with PtyRobot(EmulatedRobot(vehicle, scenario, seed), folder) as served:
        parent.send("ready")
        if parent.recv() == "go":
            served.run(float("inf"), each_step)
    parent.send(rows)
