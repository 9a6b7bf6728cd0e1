"""Power, energy and reach: what the currents, voltages and strokes of a record say."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import Pose, Suspension
from tiger.daemon.overview import DriveEnergy, overview
from tiger.models.eam import Eam
from tiger.record import (
    STILL,
    DaemonState,
    DriveSample,
    Four,
    Inputs,
    Outputs,
    Record,
    StrokeSample,
)

RPM = 60.0
DRIVE = DriveSample(0.0, (RPM, RPM), (5.0, 6.0), (1.0, 2.0), 24.0, 30.0, 0, 0)


@pytest.fixture(scope="module")
def suspension() -> Suspension:
    return Suspension.from_config(load_robot())


def at(t_s: float, battery_a: tuple[float, float] = (1.0, 2.0)) -> Inputs:
    sample = replace(DRIVE, t_s=t_s, battery_current_a=battery_a)
    return Inputs(t_s, armed=True, drive_left=sample, drive_right=replace(sample, battery_v=20.0))


def test_power_and_torque_of_each_wheel_follow_from_its_current(suspension: Suspension) -> None:
    record = Record(0, DaemonState.ARMED, "", at(0.0), Outputs())
    found = overview(record, DriveEnergy(), suspension)
    assert found.current_a == (5.0, 5.0, 6.0, 6.0)
    assert found.electric_w == (24.0, 20.0, 48.0, 40.0)
    assert 0.0 < found.torque_nm[0] < found.torque_nm[2]
    radps = RPM * 2.0 * math.pi / 60.0
    assert found.power_w == pytest.approx(tuple(torque * radps for torque in found.torque_nm))


def test_energy_is_power_over_time_and_each_sample_counts_once() -> None:
    energy = DriveEnergy()
    for k in range(101):
        inputs = at(k * 0.02)
        energy.add(inputs)
        energy.add(inputs)  # the ticks between two samples
    assert energy.energy_j == pytest.approx((48.0, 40.0, 96.0, 80.0))
    assert energy.largest_w == (24.0, 20.0, 48.0, 40.0)
    assert energy.largest_a == (5.0, 5.0, 6.0, 6.0)
    assert energy.lowest_v == 20.0


@pytest.mark.parametrize("gap_s", [0.6, -1.0, 0.0])
def test_over_a_gap_nothing_is_added(gap_s: float) -> None:
    energy = DriveEnergy()
    energy.add(at(1.0))
    energy.add(at(1.0 + gap_s))
    assert energy.energy_j == STILL


def test_a_drive_that_was_lost_begins_anew() -> None:
    energy = DriveEnergy()
    for inputs in (at(1.0), Inputs(1.1, armed=False), at(1.2)):
        energy.add(inputs)
    assert energy.energy_j == STILL


def strokes(suspension: Suspension, roll_rad: float, pitch_rad: float) -> Four:
    low, high = suspension.ride_range_mm(roll_rad, pitch_rad)
    lifts = suspension.lifts_mm(Pose(roll_rad, pitch_rad, 0.5 * (low + high)))
    curve = Eam.from_vehicle(load_robot().vehicle).curve()
    fl, fr, rl, rr = (float(curve.stroke_mm(lift)) for lift in lifts)
    return fl, fr, rl, rr


def test_the_part_of_the_reach_that_is_used(suspension: Suspension) -> None:
    roll, pitch = suspension.limits()
    for a, b, used in ((0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (0.0, -1.0, 1.0), (-0.25, 0.5, 0.75)):
        sample = StrokeSample(0.0, strokes(suspension, a * roll, b * pitch), STILL, (0, 0, 0, 0), 0)
        record = Record(0, DaemonState.ARMED, "", Inputs(0.0, armed=True, strokes=sample), Outputs())
        assert overview(record, DriveEnergy(), suspension).reach_used == pytest.approx(used, abs=0.01)
    bare = Record(0, DaemonState.ARMED, "", Inputs(0.0, armed=True), Outputs())
    assert overview(bare, DriveEnergy(), suspension).reach_used is None
