"""Mode `balance` by the whole robot: firmware, wire, daemon, and 14 degrees of freedom on two blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import WARP
from tiger.emulation.robot import EmulatedRobot
from tiger.emulation.scenarios import load_scenario
from tiger.record import Command, Mode
from tiger.rig import virtual

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.emulation.scenarios import Scenario

    Array = NDArray[np.float64]

AT_S = 7.0
TIPPING = (0.5, 0.3)
"""Slope that lets a body on equal springs tip: on level ground it would stand on two wheels as on a
tightrope, in an emulation without a breath of wind, and answer nothing."""


def _with_springs(vehicle, front: float, rear: float):
    axles = {"front": front, "rear": rear}
    changed = {
        name: getattr(vehicle, name).model_copy(
            update={"spring_npm": factor * getattr(vehicle, name).spring_npm}
        )
        for name, factor in axles.items()
    }
    return vehicle.model_copy(update=changed)


def _twisted(twist_mm: float, climb_deg: float = 0.0, left_up_deg: float = 0.0, **keys) -> Scenario:
    """Blocks under two wheels across, and strokes at their ends, twisted against them."""
    scenario = load_scenario("blocks")
    under_fr, under_rl = scenario.terrain.step
    front, rear = (
        ({"right_m": 0.0, "left_m": 2.0}, {"right_m": -2.0, "left_m": 0.0}) if twist_mm > 0.0 else ({}, {})
    )
    height = {"height_m": 0.002 * abs(twist_mm)}
    steps = (under_fr.model_copy(update=front | height), under_rl.model_copy(update=rear | height))
    slope = {"climb_deg": climb_deg, "left_up_deg": left_up_deg}
    stroke = (
        tuple(70.0 - s for s in scenario.initial_stroke_mm) if twist_mm > 0.0 else scenario.initial_stroke_mm
    )
    terrain = scenario.terrain.model_copy(update={"step": steps, **slope})
    return scenario.model_copy(update={"terrain": terrain, "initial_stroke_mm": stroke, **keys})


def _balanced(monkeypatch, robot, scenario: Scenario, springs: tuple[float, float], seed: int) -> Array:
    """Stand in `hold`, then balance; rows of time since then, roll, pitch, and the four loads.

    The world's springs are off by these factors; the daemon knows nothing of that.
    """
    monkeypatch.setattr(
        virtual, "EmulatedRobot", lambda car, *rest: EmulatedRobot(_with_springs(car, *springs), *rest)
    )
    rig = virtual.Rig(robot, scenario, seed)
    rig.daemon.command = Command(Mode.HOLD)
    rig.daemon.arm(patience_s=AT_S)
    rows = []
    for _ in rig.run(AT_S + 10.0):
        if rig.time_s >= AT_S:
            rig.daemon.command = Command(Mode.BALANCE)
        truth = rig.robot.truth()
        rows.append((rig.time_s - AT_S, truth.roll_deg, truth.pitch_deg, *truth.wheel_load_n))
    return np.array(rows)


def _check(table: Array) -> tuple[float, float]:
    """The bar: four wheels loaded, and the diagonals alike within 10 % of the static load, within 8 s.

    Returns the time until all are loaded, and the difference at the end.
    """
    time_s, load_n = table[:, 0], table[:, 3:]
    assert load_n[time_s < 0.0][-1].min() < 0.1
    after = time_s > 0.0
    in_the_air = after & (load_n.min(axis=1) < 5.0)
    difference = load_n @ np.array(WARP) / (0.5 * load_n.sum(axis=1))
    apart = after & (np.abs(difference) > 0.10)
    loaded_s = float(time_s[in_the_air].max(initial=0.0))
    assert loaded_s < 8.0
    assert time_s[apart].max(initial=0.0) < 8.0
    return loaded_s, float(difference[-1])


@pytest.mark.proof
@pytest.mark.parametrize(
    ("springs", "slope_deg"),
    [((0.95, 1.05), (0.0, 0.0)), ((1.03, 0.97), (0.0, 0.0)), ((1.0, 1.0), TIPPING)],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_two_wheels_in_the_air_are_brought_down_and_loaded_alike_within_eight_seconds(
    monkeypatch, springs, slope_deg, seed: int
) -> None:
    """TIGER's springs, 60 mm of twist: the strokes at their ends lift the wheels off by some millimetres."""
    table = _balanced(monkeypatch, load_robot(), _twisted(-60.0, *slope_deg), springs, seed)
    loaded_s, _ = _check(table)
    assert loaded_s < 3.0
    assert np.abs(table[table[:, 0] > 9.0, 1:3]).max() < 0.5


@pytest.mark.proof
@pytest.mark.parametrize(
    ("twist_mm", "springs", "slope_deg", "seed"),
    [
        (21.8, (1.030, 1.008), (-0.4, -0.1), 300),
        (-18.0, (1.023, 0.961), (0.1, -0.4), 301),
        (46.9, (1.046, 0.978), (0.0, 0.0), 302),
        (44.8, (0.979, 0.950), (0.0, 0.0), 303),
        (25.7, (1.039, 1.009), (1.6, -2.8), 304),
        (-35.0, (1.000, 1.000), TIPPING, 305),
        (-55.0, (0.960, 1.040), (3.0, 2.0), 306),
        (58.0, (1.050, 0.950), (-3.0, 3.0), 307),
    ],
)
def test_on_stiffer_springs_so_they_are_from_any_twist_of_the_ground(
    monkeypatch, record_figure: Callable, twist_mm, springs, slope_deg, seed
) -> None:
    """On springs half as stiff again 86 mm of twist lift a wheel: the ground's and 69 of the strokes."""
    robot = load_robot()
    robot = robot.model_copy(update={"vehicle": _with_springs(robot.vehicle, 1.5, 1.5)})
    loaded_s, difference = _check(
        _balanced(monkeypatch, robot, _twisted(twist_mm, *slope_deg), springs, seed)
    )
    case = f"twist {twist_mm:g} mm, springs {springs[0]:g} and {springs[1]:g}"
    record_figure(f"{case}: all loaded after", f"{loaded_s:.1f} s", "<= 8 s")
    record_figure(f"{case}: difference of the diagonals", f"{100.0 * difference:.1f} %", "<= 10 %")
