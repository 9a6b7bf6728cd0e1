"""The robot drives over terrain: real firmware, real daemon, the 14-DOF vehicle, virtual time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.emulation.scenarios import load_scenario, scenario_names
from tiger.record import DaemonState
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BEYOND_DEFAULTS = ("loose-hollows",)  # takes more current than the default limit: `tiger study loose-slope`
TERRAINS = tuple(
    name for name in scenario_names() if load_scenario(name).drive and name not in BEYOND_DEFAULTS
)


def ride(name: str, seed: int = 0) -> tuple[Rig, Array]:
    """Run a scenario to its end; one row a tick: time, roll, pitch in degrees, x, y, z in m, speed in m/s."""
    scenario = load_scenario(name)
    rig = Rig(load_robot(None), scenario, seed)
    rig.daemon.arm(scenario.drive[0].at_s)
    rows = []
    for record in rig.run(scenario.duration_s):
        truth = rig.robot.truth()
        rows.append((truth.time_s, truth.roll_deg, truth.pitch_deg, *truth.position_m, truth.speed_mps))
        assert record.state is not DaemonState.FAULT, [str(p) for p in record.problems + rig.daemon.latched]
    assert rig.daemon.state is DaemonState.ARMED
    return rig, np.array(rows)


@pytest.mark.parametrize("seed", [0, 1])
def test_robot_drives_slowly_along_a_side_slope_with_its_body_level(
    seed: int, record_figure: Callable
) -> None:
    rig, rows = ride("side-slope", seed)
    time_s, roll = rows[:, 0], rows[:, 1]
    assert roll[time_s < 3.0].min() > 5.0  # it wakes leaning
    driving = (time_s > 13.0) & (time_s < 21.0)
    worst = float(np.abs(roll[driving]).max())
    record_figure("roll while driving along a side slope of 5 degrees", worst, "0.5 degrees")
    assert worst < 0.5
    assert rows[driving & (time_s > 15.0), 6] == pytest.approx(0.3, abs=0.02)
    assert rows[-1, 3] > 2.5
    assert abs(rig.robot.truth().yaw_deg) < 1.0


def test_robot_drives_over_a_curb_without_a_fault() -> None:
    _, rows = ride("curb")
    height = rows[:, 5] - rows[0, 5]
    assert height.max() == pytest.approx(0.03, abs=0.012)  # once on the pavement
    assert rows[-1, 3] > 5.0
    assert height[-1] == pytest.approx(0.0, abs=0.003)


@pytest.mark.parametrize("name", [name for name in TERRAINS if name not in ("side-slope", "curb")])
def test_robot_gets_to_the_end_of_every_terrain_armed(name: str) -> None:
    _, rows = ride(name)
    assert rows[-1, 3] - rows[0, 3] > 2.0
    assert abs(rows[-1, 6]) < 0.02
