"""A running robot for the commands that talk to one: the daemon and the emulated robot in this process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from tiger.config.robot import load_robot
from tiger.daemon.api import Api
from tiger.emulation.scenarios import load_scenario
from tiger.rig.virtual import Rig


class RunningRobot:
    """A thread in which virtual time passes; the commands find its socket through TIGER_SOCKET."""

    def __init__(self, path) -> None:
        self.rig = Rig(load_robot(None), load_scenario("shaking-plate"))
        self.api = Api(self.rig.config, path)
        self.fastest_radps = 0.0
        self._ended = False
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._ended:
            record = self.rig.tick()
            assert record is not None
            self.api.poll(self.rig.daemon, record, self.rig.time_s)
            left = record.inputs.wheels_left
            if left is not None:
                self.fastest_radps = max(self.fastest_radps, *left.speed_radps)
            time.sleep(0.0005)

    def start(self) -> None:
        """Let it boot, faster than time, then go on beside the test."""
        for record in self.rig.run(3.6):
            self.api.poll(self.rig.daemon, record, self.rig.time_s)
        self._thread.start()

    def stop(self) -> None:
        """End it."""
        self._ended = True
        self._thread.join()
        self.api.close(self.rig.daemon)
        self.rig.daemon.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningRobot]:
    path = tmp_path_factory.mktemp("run") / "private" / "robot.sock"
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("TIGER_SOCKET", str(path))
        robot = RunningRobot(path)
        robot.start()
        yield robot
        robot.stop()
