"""The whole robot in one process, in virtual time: daemon ticks between the emulated robot's milliseconds.

rig = Rig(load_robot(None), load_scenario("shaking-plate"), seed=0)
rig.daemon.arm()
for record in rig.run(60.0): ...
"""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

from tiger.daemon.clock import VirtualClock
from tiger.daemon.daemon import Daemon
from tiger.emulation.cable import LineNoise
from tiger.emulation.robot import STEP_US, EmulatedRobot
from tiger.rig.planned_drive import NOWHERE, PlannedDrive, Pose
from tiger.rig.ports import EMULATED_PORTS, CablePorts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.config.robot import RobotConfig
    from tiger.devices.ports import PortProvider
    from tiger.emulation.scenarios import Scenario
    from tiger.record import Record


class Rig:
    """A daemon and an emulated robot that share a virtual clock.

    Args:
        config: the robot's configuration; its ports are replaced by those of the emulated robot.
        scenario: what happens to the robot.
        seed: of everything random.
        noise: damage on every framed line.
    """

    def __init__(
        self,
        config: RobotConfig,
        scenario: Scenario,
        seed: int = 0,
        noise: LineNoise = LineNoise(),  # noqa: B008  frozen
    ) -> None:
        self.config = config.model_copy(update={"ports": EMULATED_PORTS})
        self.clock = VirtualClock()
        self.robot = EmulatedRobot(config.vehicle, scenario, seed, noise)
        self.ports = CablePorts(self.robot.cables)
        self._scenario, self._seed = scenario, seed
        self.connect(self.ports)
        self._believed = NOWHERE
        self.hung = False  # a daemon that hangs: time passes, nothing is read or written
        self._steps_per_tick = round(config.loop.period_s * 1e6 / STEP_US)

    def connect(self, ports: PortProvider) -> None:
        """Begin with a new daemon behind these ports, such as the robot's own with a log at them."""
        self.daemon = Daemon(self.config, ports, self.clock, nonce=self._seed + 1)
        self.drive = PlannedDrive(self._scenario, self.daemon, self._true_pose)

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self.robot.time_s

    def tick(self) -> Record | None:
        """Let one control period pass and return what the daemon made of it; None while it hangs."""
        self.robot.run(self._steps_per_tick)
        self.clock.set(self.robot.time_s)
        if self.hung:
            return None
        self.drive.follow(self.robot.time_s, self._believed)
        record = self.daemon.tick(self.robot.time_s)
        self._believed = record.outputs.estimate.odometry
        return record

    def _true_pose(self) -> Pose:
        truth = self.robot.truth()
        x, y, _ = truth.position_m
        return x, y, radians(truth.yaw_deg)

    def run(self, duration_s: float) -> Iterator[Record]:
        """Yield the record of every tick for `duration_s` of virtual time."""
        end_us = self.robot.world.time_us + round(duration_s * 1e6)
        while self.robot.world.time_us < end_us:
            record = self.tick()
            if record is not None:
                yield record
