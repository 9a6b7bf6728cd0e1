"""A closed loop without boards: the controller on the emulated world, through links that only delay."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.daemon import controller
from tiger.emulation.scenarios import PlateSegment, Scenario
from tiger.emulation.world import World
from tiger.record import Command, ImuSample, Inputs, Outputs, StrokeSample

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig

TICK_S = 0.005
SENSOR_TICKS = 2  # 100 Hz
IMU_DELAY_TICKS = 2
STROKE_DELAY_TICKS = 1
SETPOINT_DELAY_TICKS = 2
GRAVITY_MPS2 = 9.80665


@dataclass
class Run:
    """What happened, one row a tick. Angles in degrees, strokes and rates in mm and mm/s."""

    time_s: NDArray[np.float64]
    attitude_deg: NDArray[np.float64]
    estimate_deg: NDArray[np.float64]
    plate_deg: NDArray[np.float64]
    stroke_mm: NDArray[np.float64]
    command_mmps: NDArray[np.float64]
    outputs: list[Outputs] = field(repr=False)

    def after(self, start_s: float, end_s: float = math.inf) -> NDArray[np.bool_]:
        """Select the ticks from `start_s` to `end_s`."""
        return (self.time_s >= start_s) & (self.time_s < end_s)

    def time_to_level_s(self, start_s: float, band_deg: float = 0.5) -> float:
        """Time after `start_s` until roll and pitch stay within the band, looking ten seconds ahead."""
        here = self.after(start_s, start_s + 10.0)
        outside = np.abs(self.attitude_deg[here]).max(axis=1) >= band_deg
        return float(self.time_s[here][outside][-1] - start_s) if outside.any() else 0.0


@dataclass
class Bench:
    """The controller on the world. `imu_tilt_deg` is what an uncalibrated IMU would add to its attitude."""

    robot: RobotConfig
    noise_deg: float = 0.02
    gyro_noise_degps: float = 0.1
    imu_tilt_deg: float = 0.0
    gyro_bias_degps: float = 0.0
    seed: int = 1

    def run(
        self,
        duration_s: float,
        plate: tuple[PlateSegment, ...] = (),
        command: Callable[[float], Command] = lambda _: Command(),
        stroke_mm: tuple[float, float, float, float] | None = None,
    ) -> Run:
        """Run from rest, armed from the start."""
        scenario = Scenario(
            title="bench",
            duration_s=duration_s,
            model="linear",
            plate=plate,
            initial_stroke_mm=stroke_mm,
            sensor_noise=False,
        )
        world = World(self.robot.vehicle, scenario, seed=self.seed)
        random = np.random.default_rng(self.seed)
        design = controller.design_controller(self.robot)
        state = controller.initial_state(design)
        imus: deque[ImuSample] = deque()
        strokes: deque[StrokeSample] = deque()
        commands = deque([(0.0,) * 4] * SETPOINT_DELAY_TICKS)
        rows, outputs = [], []
        for tick in range(round(duration_s / TICK_S)):
            now = tick * TICK_S
            if tick % SENSOR_TICKS == 0:
                imus.append(self._imu(world, now, random))
                strokes.append(_strokes(world, now, random))
            inputs = Inputs(
                now,
                armed=True,
                command=command(now),
                strokes=_arrived(strokes, now - STROKE_DELAY_TICKS * TICK_S),
                imu=_arrived(imus, now - IMU_DELAY_TICKS * TICK_S),
            )
            state, output = controller.step(design, state, inputs, TICK_S)
            outputs.append(output)
            truth = world.truth()
            estimate = output.estimate
            rows.append(
                (
                    *(now, truth.roll_deg, truth.pitch_deg),
                    *(math.degrees(estimate.roll_rad), math.degrees(estimate.pitch_rad)),
                    *(truth.plate_roll_deg, truth.plate_pitch_deg),
                    *truth.stroke_mm,
                    *output.stroke_rate_mmps,
                )
            )
            commands.append(output.stroke_rate_mmps)
            duty = [rate / self.robot.actuator.max_rate_mmps for rate in commands.popleft()]
            for _ in range(5):
                world.step(0.001, duty, output.wheel_rpm)
        table = np.array(rows)
        return Run(
            table[:, 0], table[:, 1:3], table[:, 3:5], table[:, 5:7], table[:, 7:11], table[:, 11:], outputs
        )

    def _imu(self, world: World, now: float, random: np.random.Generator) -> ImuSample:
        truth = world.truth()
        noise = random.standard_normal(4)
        roll = math.radians(truth.roll_deg + self.imu_tilt_deg + self.noise_deg * noise[0])
        pitch = math.radians(truth.pitch_deg + self.imu_tilt_deg + self.noise_deg * noise[1])
        p = math.radians(truth.roll_rate_degps + self.gyro_bias_degps + self.gyro_noise_degps * noise[2])
        q = math.radians(truth.pitch_rate_degps + self.gyro_bias_degps + self.gyro_noise_degps * noise[3])
        accel = world.imu().accel_mps2
        gravity = GRAVITY_MPS2 * np.array(
            [-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)]
        )
        x, y, z = (float(a) for a in np.asarray(accel) - gravity)
        return ImuSample(now, quaternion(roll, pitch), (p, q, 0.0), (0.0, 0.0, 0.0), (x, y, z), 0)


def quaternion(roll: float, pitch: float) -> tuple[float, float, float, float]:
    """Body to earth, without yaw."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return cr * cp, sr * cp, cr * sp, -sr * sp


def _strokes(world: World, now: float, random: np.random.Generator) -> StrokeSample:
    truth = world.truth()
    noisy = tuple(
        s + 0.02 * e for s, e in zip(truth.stroke_mm, random.standard_normal(4).tolist(), strict=True)
    )
    return StrokeSample(now, noisy, truth.stroke_rate_mmps, (0, 0, 0, 0), 0)


def _arrived(samples: deque, until: float):
    """The newest sample that is old enough to have come through the link."""
    while len(samples) > 1 and samples[1].t_s <= until + 1e-9:
        samples.popleft()
    return samples[0] if samples and samples[0].t_s <= until + 1e-9 else None


@pytest.fixture(scope="session")
def robot() -> RobotConfig:
    return load_robot()


@pytest.fixture(scope="session")
def bench(robot: RobotConfig) -> Bench:
    return Bench(robot)
