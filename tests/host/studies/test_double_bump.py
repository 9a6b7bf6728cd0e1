"""Figures 5.7 and 5.8: what ideal forces gain on the double bump, and how little 9.4 mm/s can."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tiger.studies import double_bump
from tiger.studies.report import Report


def value(report: Report, name: str) -> float:
    (row,) = [row for row in report.rows if row.name == name]
    return row.value


@pytest.fixture(scope="module")
def report() -> Report:
    return double_bump.run()


@pytest.mark.parametrize(
    ("figure", "limit"),
    [
        ("roll, RMS", 0.20),
        ("pitch, RMS", 0.25),
        ("load transfer, peak", 0.30),
        ("path deviation, peak", 0.35),
    ],
)
def test_ideal_forces_reduce_the_passive_response(report: Report, figure: str, limit: float) -> None:
    assert value(report, f"{figure}, active/passive") <= limit


def test_forces_stay_within_three_kilonewtons(report: Report) -> None:
    assert value(report, "actuator force, peak, active") <= 3000.0


def test_active_suspension_keeps_every_wheel_on_the_ground_and_the_passive_one_does_not(
    report: Report,
) -> None:
    assert value(report, "wheel load, least, active") > 500.0
    assert value(report, "wheel load, least, passive") == 0.0


def test_wheel_hop_dies_out_after_the_bumps(report: Report) -> None:
    time = np.asarray(report.series["time_s"])
    force = np.asarray(report.series["force_fl_n_active"])[time > 3.0]
    assert np.ptp(force) < 50.0


def test_rate_limited_eam_gains_next_to_nothing(report: Report) -> None:
    for figure in ("roll, RMS", "pitch, RMS", "load transfer, peak", "path deviation, peak"):
        assert 0.85 < value(report, f"{figure}, eam/passive") < 1.05


def test_eam_never_lifts_faster_than_its_actuator(report: Report) -> None:
    lift = np.asarray(report.series["lift_fl_mm_eam"])
    fastest = np.abs(np.diff(lift)).max() / 1e-3
    assert fastest <= 9.4 * 2.2
    assert fastest > 9.4


def test_active_keeps_speed_with_less_torque(report: Report) -> None:
    assert value(report, "traction torque, peak, active") < value(report, "traction torque, peak, passive")
    assert value(report, "speed, least, active") > value(report, "speed, least, passive")


def test_finer_step_changes_nothing_to_speak_of(report: Report) -> None:
    fine = double_bump.run(dt_s=1.25e-4)
    for case in double_bump.CASES:
        for name in ("roll_deg", "pitch_deg"):
            difference = np.asarray(fine.series[f"{name}_{case}"]) - np.asarray(
                report.series[f"{name}_{case}"]
            )
            assert np.abs(difference).max() < 1e-3
        for name in ("x_m", "y_m", "heave_m"):
            difference = np.asarray(fine.series[f"{name}_{case}"]) - np.asarray(
                report.series[f"{name}_{case}"]
            )
            assert np.abs(difference).max() < 1e-3


@pytest.mark.parametrize("speed_kmh", [40.0, 50.0])
def test_gains_hold_at_other_speeds(speed_kmh: float) -> None:
    other = double_bump.run(speed_kmh=speed_kmh)
    assert value(other, "roll, RMS, active/passive") < 0.2
    assert value(other, "pitch, RMS, active/passive") < 0.25
    assert value(other, "actuator force, peak, active") <= 3000.0


def test_no_bump_no_motion() -> None:
    flat = double_bump.run(bump_m=0.0, duration_s=1.0)
    for case in double_bump.CASES:
        assert np.abs(np.asarray(flat.series[f"roll_deg_{case}"])).max() < 1e-9


def test_pictures_are_drawn(report: Report, tmp_path: Path) -> None:
    pictures = double_bump.plot(report, tmp_path)
    assert [p.name for p in pictures] == ["double_bump_path.png", "double_bump_attitude.png"]
    assert all(p.stat().st_size > 10_000 for p in pictures)


def test_vehicle_without_force_actuators_is_refused() -> None:
    with pytest.raises(ValueError, match="force actuator"):
        double_bump.run("tiger")


def test_eam_without_a_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="rate"):
        double_bump.run(eam="table-6-1")
