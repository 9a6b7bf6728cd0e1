"""Wheel speeds closed on mega_speed's sensors: what the Roboteqs get wrong, the daemon makes up for."""

from __future__ import annotations

import math
from typing import Literal

import pytest

from tiger.config.robot import RobotConfig, load_robot
from tiger.emulation.scenarios import Scenario
from tiger.record import Command, DaemonState
from tiger.rig.virtual import Rig

STANDS = Scenario(title="wheels on stands", duration_s=60.0, model="linear")
GROUND = Scenario(title="level ground", duration_s=60.0)
GAINS = (0.94, 1.05, 0.97, 1.06)  # of the speed that a Roboteq is told, what its wheel turns at: FL FR RL RR
SPEED_MPS = 0.6


def driven(source: Literal["roboteq", "mega_speed"], scenario: Scenario, seconds: float = 7.0) -> Rig:
    """A robot with inaccurate Roboteqs that has driven straight for some seconds."""
    robot: RobotConfig = load_robot()
    drive = robot.drive.model_copy(update={"speed_source": source})
    rig = Rig(robot.model_copy(update={"drive": drive}), scenario)
    rig.robot.motor_signs = GAINS
    rig.daemon.arm(10.0)
    for record in rig.run(6.0):
        if record.state is DaemonState.ARMED:
            break
    assert record.state is DaemonState.ARMED, [str(problem) for problem in record.problems]
    rig.daemon.command = Command(speed_mps=SPEED_MPS)
    for record in rig.run(seconds):
        assert record.state is DaemonState.ARMED, [str(problem) for problem in record.problems]
    return rig


def wanted_rpm() -> float:
    return SPEED_MPS / load_robot().vehicle.tire.rolling_radius_m * 30.0 / math.pi


def test_closed_on_the_roboteqs_their_error_stays() -> None:
    turning = driven("roboteq", STANDS).robot.truth().wheel_speed_rpm
    assert turning == pytest.approx([gain * wanted_rpm() for gain in GAINS], abs=0.6)


def test_closed_on_mega_speed_every_wheel_turns_at_what_is_asked() -> None:
    turning = driven("mega_speed", STANDS).robot.truth().wheel_speed_rpm
    assert turning == pytest.approx([wanted_rpm()] * 4, abs=0.6)


def test_on_the_ground_it_drives_at_the_speed_that_is_asked() -> None:
    """Left and right differ by 11 %: the yaw-rate loop alone would keep it straight, but too slow or fast."""
    rig = driven("mega_speed", GROUND)
    truth = rig.robot.truth()
    assert truth.wheel_speed_rpm == pytest.approx([wanted_rpm()] * 4, rel=0.03)
    assert truth.speed_mps == pytest.approx(SPEED_MPS, rel=0.03)


def test_when_it_stops_nothing_of_the_correction_is_left() -> None:
    rig = driven("mega_speed", STANDS)
    rig.daemon.command = Command()
    *_, record = rig.run(3.0)
    assert record.outputs.wheel_rpm == (0.0,) * 4
    assert rig.robot.truth().wheel_speed_rpm == pytest.approx((0.0,) * 4, abs=0.1)
