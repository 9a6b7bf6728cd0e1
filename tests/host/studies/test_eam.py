"""The mechanism study: Figures 4.3 and 4.5 beside what the dissertation prints."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.models.eam import MechanismError
from tiger.studies import eam

REPORT = eam.run()
ROWS = {row.name: row for row in REPORT.rows}


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("arm angle at zero stroke", 0.05),
        ("arm angle at full stroke", 0.05),
        ("suspension travel", 10.0),
        ("greatest track", 10.0),
        ("track at full stroke", 10.0),
    ],
)
def test_every_printed_figure_is_met(name: str, tolerance: float) -> None:
    row = ROWS[name]
    assert row.printed is not None
    assert row.value == pytest.approx(row.printed, abs=tolerance)


def test_clearance_grows_and_track_falls_once_the_arm_is_level() -> None:
    series = {name: np.asarray(values) for name, values in REPORT.series.items()}
    level = ROWS["stroke at the greatest track (arm level)"].value
    assert np.all(np.diff(series["ground_clearance_mm"]) > 0.0)
    assert np.all(np.diff(series["track_mm"][series["stroke_mm"] >= level]) < 0.0)
    assert level == pytest.approx(13.0, abs=0.5)


def test_travel_is_slightly_nonlinear_as_figure_4_3_shows() -> None:
    share = ROWS["deviation of the travel from a straight line"].value / ROWS["suspension travel"].value
    assert 0.01 < share < 0.06


def test_rates_are_those_of_the_actuator_at_full_speed() -> None:
    series = {name: np.asarray(values) for name, values in REPORT.series.items()}
    rate = np.gradient(series["suspension_travel_mm"], series["time_s"])
    np.testing.assert_allclose(rate[1:-1], series["rise_rate_mmps"][1:-1], rtol=1e-3)
    accel = np.gradient(series["rise_rate_mmps"], series["time_s"])
    np.testing.assert_allclose(accel[2:-2], series["rise_accel_mmps2"][2:-2], rtol=2e-3)


def test_another_stroke_is_not_compared_with_the_printed_one() -> None:
    report = eam.run(stroke_mm=70.0)
    assert all(row.printed is None for row in report.rows)
    travel = next(row.value for row in report.rows if row.name == "suspension travel")
    assert travel == pytest.approx(138.6, abs=0.1)


def test_geometry_b_lifts_the_printed_250_mm_of_com_height_within_70_mm() -> None:
    report = eam.run(vehicle="tiger-b", stroke_mm=70.0)
    travel = next(row.value for row in report.rows if row.name == "suspension travel")
    assert travel == pytest.approx(250.0, abs=1.0)


@pytest.mark.parametrize(
    "options", [{"vehicle": "table-6-1"}, {"stroke_mm": -1.0}, {"points": 1}, {"stroke_mm": 500.0}]
)
def test_what_cannot_be_solved_is_said(options: dict[str, object]) -> None:
    with pytest.raises(MechanismError, match=r"\[eam\]|must be positive"):
        eam.run(**options)  # type: ignore[arg-type]


def test_an_unknown_vehicle_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="lion"):
        eam.run(vehicle="lion")


def test_report_becomes_json_and_pictures(tmp_path: Path) -> None:
    REPORT.write_json(tmp_path / "eam.json")
    data = json.loads((tmp_path / "eam.json").read_text())
    assert {row["name"]: row["printed"] for row in data["rows"]}["arm angle at full stroke"] == 49.0
    assert len(data["series"]["track_mm"]) == 201
    for path in eam.plot(REPORT, tmp_path):
        assert path.stat().st_size > 5000
