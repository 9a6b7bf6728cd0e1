"""The emulated robot in real time and in a process of its own, behind pseudo-terminals.

with SeparateRobot(vehicle, "shaking-plate", seed=0) as robot:
    daemon = Daemon(config.model_copy(update={"ports": robot.ports}), SerialPorts(), robot.clock)
    robot.truth()          # what the world really does, for plots only

Both live in real time as far as this computer allows it. Where it is too busy, time stands still for both:
hardware would not wait, but a robot that stops because of the computer it is emulated on helps no one.
"""

from __future__ import annotations

import multiprocessing
import shutil
import tempfile
import time
from math import radians
from multiprocessing.sharedctypes import RawArray, RawValue
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tiger.config.errors import ConfigError
from tiger.config.robot import PortsConfig
from tiger.emulation.serve import MOST_BEHIND_S
from tiger.rig.spawn import start_undisturbed

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.synchronize import Event

    from tiger.config.vehicle import VehicleConfig
    from tiger.rig.planned_drive import Pose

START_TIME_S = 300.0
"""The first start on a computer compiles the vehicle model."""
HOST_STALLED_S = 0.01
"""A host that has not asked for the time for so long is not running: the robot waits for it."""
PAUSE_S = 0.001
REFUSAL = "refusal"  # file in which a robot that cannot be built says why


class SeparateTruth(NamedTuple):
    """True attitude and place at a moment of virtual time."""

    time_s: float
    roll_deg: float
    pitch_deg: float
    x_m: float
    y_m: float
    yaw_deg: float


class _Shared:
    """What the two processes tell each other; a double is written and read in one piece."""

    def __init__(self) -> None:
        self.truth: Any = RawArray("d", len(SeparateTruth._fields))
        self.began_s: Any = RawValue("d", 0.0)  # the robot's time zero on the monotonic clock; 0: not yet
        self.skipped_s: Any = RawValue("d", 0.0)
        self.asked_s: Any = RawValue("d", 0.0)  # when the host last wanted to know the time


class RobotClock:
    """The monotonic clock without what stalls took away: never further ahead of the robot than it may be.

    A robot whose process has died holds no time up: the daemon shall notice that it is gone.
    """

    def __init__(self, shared: _Shared, lives: Callable[[], bool]) -> None:
        self._shared = shared
        self._lives = lives
        self._now_s = 0.0

    def now_s(self) -> float:
        """Seconds since some moment in the past."""
        shared = self._shared
        now_s = shared.asked_s.value = time.monotonic()
        if shared.began_s.value:
            robot_s = shared.began_s.value + shared.truth[0]
            now_s -= shared.skipped_s.value
            if now_s > robot_s + MOST_BEHIND_S and self._lives():
                now_s = robot_s + MOST_BEHIND_S
        self._now_s = max(self._now_s, now_s)
        return self._now_s


class SeparateRobot:
    """Context manager; see the module's text."""

    def __init__(self, vehicle: VehicleConfig, scenario: str, seed: int = 0) -> None:
        """`scenario` is a name or a path, and must be one that can be loaded."""
        context = multiprocessing.get_context("spawn")
        self._folder = tempfile.TemporaryDirectory(prefix="tiger-")
        self._shared = _Shared()
        self._ready = context.Event()
        self._begin = context.Event()
        self._process = context.Process(
            target=_serve,
            args=(vehicle, scenario, seed, self._folder.name, self._shared, self._ready, self._begin),
            daemon=True,
        )
        self.clock = RobotClock(self._shared, self._process.is_alive)

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
        return SeparateTruth(*self._shared.truth)

    def pose(self) -> Pose:
        """Where it really is."""
        now = self.truth()
        return now.x_m, now.y_m, radians(now.yaw_deg)

    def begin(self) -> None:
        """Let its time run; until then its lines are there and silent."""
        self._begin.set()

    def __enter__(self) -> SeparateRobot:
        start_undisturbed(self._process)
        deadline_s = time.monotonic() + START_TIME_S
        while not self._ready.wait(0.1):
            if self._process.is_alive() and time.monotonic() < deadline_s:
                continue
            refusal = Path(self._folder.name, REFUSAL)
            said = refusal.read_text(encoding="utf-8") if refusal.exists() else ""
            self.__exit__()
            raise ConfigError(said or "the emulated robot did not start; run `tiger emulate` to see why")
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.join(timeout=5.0)
        self._folder.cleanup()


def _serve(
    vehicle: VehicleConfig, scenario: str, seed: int, folder: str, shared: _Shared, ready: Event, begin: Event
) -> None:
    """Body of the process."""
    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.scenarios import load_scenario
    from tiger.emulation.serve import PtyRobot

    parent = multiprocessing.parent_process()

    def orphaned() -> bool:
        """Whether the daemon was killed, too suddenly to end this process and to tidy up."""
        return parent is not None and not parent.is_alive()

    def each_step(robot: EmulatedRobot) -> bool:
        now = robot.truth()
        shared.skipped_s.value = served.skipped_s
        x_m, y_m, _ = now.position_m
        shared.truth[:] = SeparateTruth(now.time_s, now.roll_deg, now.pitch_deg, x_m, y_m, now.yaw_deg)
        shared.began_s.value = served.began_s
        while time.monotonic() - shared.asked_s.value > HOST_STALLED_S:
            if orphaned():
                return False
            time.sleep(PAUSE_S)
        return True

    try:
        robot = EmulatedRobot(vehicle, load_scenario(scenario), seed=seed)
    except (ConfigError, ValueError) as error:  # the parent tells it
        Path(folder, REFUSAL).write_text(str(error), encoding="utf-8")
        return
    with PtyRobot(robot, Path(folder)) as served:
        ready.set()
        while not begin.wait(1.0):
            if orphaned():
                break
        else:
            served.run(float("inf"), each_step)
    if orphaned():
        shutil.rmtree(folder, ignore_errors=True)
