"""The whole robot in virtual time, for the tests of this folder."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import Suspension
from tiger.control.reachable import rate_bound_s as least_time_s
from tiger.emulation.cable import LineNoise
from tiger.emulation.scenarios import Scenario, load_scenario
from tiger.record import DaemonState
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.record import Record


@dataclass
class Run:
    """What a run left behind; one row of each series per control tick."""

    rig: Rig
    records: list[Record] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """time_s, roll_deg, pitch_deg, four strokes, four duties: what the world knows."""

    @property
    def series(self) -> NDArray[np.float64]:
        """The rows as an array, (N, 11)."""
        return np.array(self.rows)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of each tick, (N,)."""
        return self.series[:, 0]

    @property
    def worst_tilt_deg(self) -> NDArray[np.float64]:
        """The larger of |roll| and |pitch|, (N,)."""
        return np.asarray(np.abs(self.series[:, 1:3]).max(axis=1))

    @property
    def duty(self) -> NDArray[np.float64]:
        """Drive of the four actuators, -1 to 1, (N, 4)."""
        return self.series[:, 7:]

    def go(self, duration_s: float, until: Callable[[Record], bool] | None = None) -> Record:
        """Let time pass and keep everything; stops early once `until` holds. Returns the last record."""
        for record in self.rig.run(duration_s):
            self.records.append(record)
            truth = self.rig.robot.truth()
            self.rows.append(
                (
                    truth.time_s,
                    truth.roll_deg,
                    truth.pitch_deg,
                    *truth.stroke_mm,
                    *self.rig.robot.suspension.drive(),
                )
            )
            if until is not None and until(record):
                break
        return self.records[-1]

    def arm(self, patience_s: float = 6.0) -> None:
        """Arm, and demand that it works."""
        self.rig.daemon.arm(patience_s)
        record = self.go(patience_s, until=lambda r: r.state is DaemonState.ARMED)
        assert record.state is DaemonState.ARMED, [str(p) for p in record.problems]


STANDING = Scenario(title="stands on level ground, wheels on stands", duration_s=60.0, model="linear")


@pytest.fixture
def run_of() -> Callable[[RobotConfig], Run]:
    """Return `run(config)`: a robot of this configuration on level ground, not armed yet."""
    return lambda config: Run(Rig(config, STANDING, seed=3))


@pytest.fixture
def standing(run_of: Callable[[RobotConfig], Run]) -> Run:
    """A robot of the default configuration on level ground, not armed yet."""
    return run_of(load_robot(None))


@pytest.fixture
def armed(standing: Run) -> Run:
    """A robot on level ground, armed."""
    standing.arm()
    standing.go(0.5)
    return standing


def _fresh_plate(seed: int, duration_s: float = 60.0, noise: float = 0.0) -> Run:
    run = Run(Rig(load_robot(None), load_scenario("shaking-plate"), seed, LineNoise.everything(noise)))
    run.rig.daemon.arm(5.0)
    run.go(duration_s)
    return run


_plate = cache(_fresh_plate)


@pytest.fixture
def make_plate_run() -> Callable[..., Run]:
    """Return `run(seed, duration_s=60, noise=0)`: the shaking plate, run anew at each call."""
    return _fresh_plate


@pytest.fixture
def plate_run() -> Callable[..., Run]:
    """Return `run(seed, duration_s=60, noise=0)`: the shaking plate, each run done once."""

    def run(seed: int, duration_s: float = 60.0, noise: float = 0.0) -> Run:
        return _plate(seed, duration_s, noise)

    return run


@pytest.fixture
def rate_bound_s() -> float:
    """Time the actuators need at the least to take a roll of 5 degrees to 0.5 degrees."""
    suspension = Suspension.from_config(load_robot(None))
    middle = suspension.curve.stroke_max_mm / 2.0
    return least_time_s(suspension, (middle, middle, middle, middle), math.radians(4.5), 0.0)
