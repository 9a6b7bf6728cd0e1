"""Traction through real firmware and daemon: what it changes on loose ground, and what it leaves alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.emulation.scenarios import Scenario
from tiger.record import Command, DaemonState, Mode
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig

    Array = NDArray[np.float64]

START_S = 4.0
TWISTED_MM = (23.0, 47.0, 47.0, 23.0)  # 196 N at each wheel become 145 and 247


def robot_with(max_motor_current_a: float = 30.0, **traction: object) -> RobotConfig:
    robot = load_robot().with_motor_current(max_motor_current_a)
    return robot.model_copy(update={"traction": robot.traction.model_copy(update=traction)})


def scenario(
    speed_mps: float = 0.3, yaw_rate_degps: float = 0.0, end_s: float = 10.0, **keys: object
) -> Scenario:
    drive = {"at_s": START_S, "speed_mps": speed_mps, "yaw_rate_degps": yaw_rate_degps}
    return Scenario.model_validate({"title": "traction", "duration_s": end_s, "drive": [drive], **keys})


def ride(robot: RobotConfig, course: Scenario, settled_s: float = 4.0) -> tuple[Rig, dict[str, Array]]:
    """Drive with the strokes held; means of torque, trim and load, speed and heading once it has settled."""
    rig = Rig(robot, course)
    rig.daemon.command = Command(mode=Mode.HOLD)
    rig.daemon.arm(START_S)
    rows = []
    for record in rig.run(course.duration_s):
        assert record.state is not DaemonState.FAULT, [str(problem) for problem in rig.daemon.latched]
        if rig.time_s < START_S + settled_s or rig.robot.world.time_us % 20_000:
            continue
        truth, traction = rig.robot.truth(), record.outputs.traction
        rows.append(
            (
                *traction.torque_nm,
                *traction.trim_rpm,
                *truth.wheel_load_n,
                truth.speed_mps,
                truth.yaw_deg,
                truth.time_s,
            )
        )
    table = np.array(rows)
    return rig, {
        "torque_nm": table[:, 0:4],
        "trim_rpm": table[:, 4:8],
        "load_n": table[:, 8:12],
        "speed_mps": table[:, 12],
        "yaw_deg": table[:, 13],
        "time_s": table[:, 14],
    }


def yaw_rate_degps(seen: dict[str, Array]) -> float:
    yaw_deg = np.unwrap(seen["yaw_deg"], period=360.0)
    return float((yaw_deg[-1] - yaw_deg[0]) / (seen["time_s"][-1] - seen["time_s"][0]))


def test_equal_shares_make_of_each_side_an_open_differential() -> None:
    course = scenario(soil="sandy-loam", initial_stroke_mm=TWISTED_MM)
    open_ = {"slip_max": 100.0, "slip_gain_per_s": 0.0}
    _, seen = ride(robot_with(mode="on", share="equal", **open_), course)
    fl, fr, rl, rr = seen["torque_nm"].mean(axis=0)
    assert fl == pytest.approx(rl, abs=0.25)
    assert fr == pytest.approx(rr, abs=0.25)
    _, alone = ride(robot_with(mode="log"), course)
    fl, fr, rl, rr = alone["torque_nm"].mean(axis=0)
    assert rl - fl > 0.5  # without: the loaded wheel does more
    assert fr - rr > 0.5


def test_shared_by_load_the_forces_are_in_proportion_to_the_loads() -> None:
    course = scenario(soil="sandy-loam", initial_stroke_mm=TWISTED_MM)
    rig, seen = ride(robot_with(mode="on"), course)
    estimated = rig.daemon._estimate.loads.wheel_load_n
    torque = seen["torque_nm"].mean(axis=0)
    for front, rear in ((0, 2), (1, 3)):
        share = torque[front] / (torque[front] + torque[rear])
        assert share == pytest.approx(estimated[front] / (estimated[front] + estimated[rear]), abs=0.06)


@pytest.mark.parametrize("yaw_rate", [0.0, 20.0])
def test_speed_and_yaw_rate_are_those_without_traction_control(yaw_rate: float) -> None:
    course = scenario(0.6, yaw_rate, end_s=12.0, initial_stroke_mm=TWISTED_MM, friction=0.5)
    seen = {}
    for mode in ("on", "off"):
        robot = robot_with(60.0, mode=mode)  # turning takes more than 30 A
        turning = robot.drive.model_copy(update={"effective_track_factor": 1.8})
        _, seen[mode] = ride(robot.model_copy(update={"drive": turning}), course)
    # Turning sticks and slips, with and without: a twentieth either way is not traction's doing.
    for wanted, measure in ((0.6, lambda one: one["speed_mps"].mean()), (yaw_rate, yaw_rate_degps)):
        without = abs(measure(seen["off"]) - wanted)
        assert abs(measure(seen["on"]) - wanted) <= without + 0.05 * max(wanted, 0.4)


def test_no_motor_is_asked_for_the_current_that_stops_the_robot(record_figure: Callable) -> None:
    """A slope on which one speed for all wheels ends by the current of the rear ones."""
    course = scenario(
        0.2,
        soil="sandy-loam",
        terrain={"climb_deg": 4.0},
        initial_stroke_mm=(18.0, 52.0, 52.0, 18.0),
        end_s=18.0,
    )
    with pytest.raises(AssertionError, match="motor current"):
        ride(robot_with(mode="log"), course)
    robot = robot_with(mode="on")
    _, seen = ride(robot, course)
    record_figure("largest torque on the slope", float(seen["torque_nm"].max()), "30 A: 8.4 Nm")
    assert seen["speed_mps"].mean() > 0.03


def test_standing_the_trims_are_gone() -> None:
    course = scenario(soil="sandy-loam", initial_stroke_mm=TWISTED_MM, end_s=12.5)
    stop = {"at_s": START_S + 4.0, "speed_mps": 0.0}
    course = course.model_copy(update={"drive": (*course.drive, type(course.drive[0]).model_validate(stop))})
    _, seen = ride(robot_with(mode="on"), course, settled_s=7.0)
    assert (seen["trim_rpm"] == 0.0).all()
    assert np.abs(seen["speed_mps"]).max() < 0.02
