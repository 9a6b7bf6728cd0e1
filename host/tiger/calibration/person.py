"""The manual part of a calibration: who does it, and an emulated person who does it on the emulated robot."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tiger.calibration.procedure import CalibrationError, What
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.imu import ImuReading

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.calibration.procedure import Array, Confirm, Measure, Turn
    from tiger.emulation.world import World
    from tiger.rig.virtual import Rig

RULER_MM = 0.1
TAPE_M = 0.005
PROTRACTOR_DEG = 0.5
CLUMSY_DEG = 8.0
TRIES = 3  # at typing a number that can be


class Person(Protocol):
    """Whoever does what the robot cannot. A KeyboardInterrupt from any of these ends the calibration."""

    def confirm(self, ask: Confirm) -> None:
        """Do it, then return."""

    def measure(self, ask: Measure) -> tuple[float, ...]:
        """Measure, and return the numbers."""

    def permit(self, text: str) -> bool:
        """Whether the robot may move as `text` says."""

    def show(self, turn: Turn) -> None:
        """Look at the progress."""


def measured(person: Person, ask: Measure) -> tuple[float, ...]:
    """Numbers that can be: a person who types others is told why and asked again.

    Raises CalibrationError when that does not help.
    """
    text, wrong = ask.text, None
    for _ in range(TRIES):
        values = person.measure(replace(ask, text=text))
        infinite = next((value for value in values if not math.isfinite(value)), None)
        wrong = ask.wrong(values) if infinite is None else f"{infinite:g} is no measured value; type a number"
        if wrong is None:
            return values
        text = f"{wrong}.\n{ask.text}"
    raise CalibrationError(f"{wrong}; begin again")


class HeldImu:
    """The emulated robot's IMU, mounted askew and imperfect, and turned about in the hand.

    A reading of the chip is (true in the chip's axes) / scale + offset, plus what the world's sensor adds.
    """

    def __init__(self, world: World) -> None:
        self.up: Array | None = None
        """Direction of the chip that points up while it is in the hand; None: it is mounted."""
        self.mounting = Rotation.identity()  # chip to body
        self.heading = Rotation.identity()  # of the robot, against where the world has it
        self.offset_mps2 = np.zeros(3)
        self.scale = np.ones(3)
        self._read: Callable[[], ImuReading] = world.imu
        world.imu = self.read  # type: ignore[method-assign]

    def read(self) -> ImuReading:
        """One sample in the chip's axes."""
        accel, gyro, mag = self._read()
        to_chip = self.mounting.inv()
        if self.up is None:
            turn = to_chip * self.heading.inv()
            force, gyro, mag = turn.apply(accel), to_chip.apply(gyro), turn.apply(mag)
        else:  # a body at rest feels gravity; what else there is, is the sensor's own
            force = accel + GRAVITY_MPS2 * (self.up - np.array([0.0, 0.0, 1.0]))
        felt = (force / self.scale + self.offset_mps2, gyro, mag)
        accel, gyro, mag = (np.asarray(vector).tolist() for vector in felt)
        return ImuReading(accel, gyro, mag)


class EmulatedPerson:
    """Lays the emulated IMU down, turns the robot and reads the ruler; permits every motion."""

    def __init__(
        self,
        rig: Rig,
        seed: int = 0,
        say: Callable[[str], None] = lambda text: None,
        look: Callable[[Turn], None] = lambda turn: None,
    ) -> None:
        self.imu = HeldImu(rig.robot.world)
        self._rig = rig
        self._random = np.random.default_rng(seed)
        self._say = say
        self._look = look
        self._mark = rig.robot.truth()

    def confirm(self, ask: Confirm) -> None:
        """Do it, a little clumsily."""
        self._say(ask.text)
        self._mark = self._rig.robot.truth()
        self.imu.up = None
        if ask.up is not None:
            clumsy = Rotation.from_rotvec(self._random.uniform(-CLUMSY_DEG, CLUMSY_DEG, 3), degrees=True)
            self.imu.up = clumsy.apply(ask.up)
        if ask.turn_deg is not None:
            self.imu.heading = Rotation.from_euler("z", ask.turn_deg, degrees=True)

    def measure(self, ask: Measure) -> tuple[float, ...]:
        """Read the ruler, the tape or the protractor: the world against its last mark."""
        truth = self._rig.robot.truth()
        if ask.what is What.STROKES:
            read = tuple(round(stroke / RULER_MM) * RULER_MM for stroke in truth.stroke_mm)
        elif ask.what is What.DISTANCE:
            read = (round(math.dist(truth.position_m[:2], self._mark.position_m[:2]) / TAPE_M) * TAPE_M,)
        else:
            beyond_deg = math.remainder(truth.yaw_deg - self._mark.yaw_deg, 360.0)
            read = (round(beyond_deg / PROTRACTOR_DEG) * PROTRACTOR_DEG,)
        self._say(f"{ask.text} " + " ".join(f"{value:g}" for value in read))
        return read

    def permit(self, text: str) -> bool:
        """Nobody can be hurt."""
        self._say(text)
        return True

    def show(self, turn: Turn) -> None:
        """Look at the progress."""
        self._look(turn)
