"""Figure 5.5: the response lies where independent models of the car lie, and follows its parameters."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.studies import handling
from tiger.studies.report import Report


def value(report: Report, name: str) -> float:
    (row,) = [row for row in report.rows if row.name == name]
    return row.value


@pytest.fixture(scope="module")
def report() -> Report:
    return handling.run()


def test_yaw_rate_is_the_prescribed_one(report: Report) -> None:
    assert value(report, "yaw rate, peak") == pytest.approx(0.180, abs=2e-4)


def test_lateral_acceleration_lies_between_the_independent_models(report: Report) -> None:
    assert 1.45 < value(report, "lateral acceleration, amplitude") < 1.68
    assert 10.0 < value(report, "lateral acceleration, lag on yaw rate") < 18.0


def test_roll_and_load_transfer_are_those_of_the_reference(report: Report) -> None:
    assert value(report, "roll, amplitude") == pytest.approx(1.64, rel=0.01)
    assert value(report, "load transfer, peak") == pytest.approx(0.131, rel=0.015)
    assert value(report, "yaw moment needed, peak") == pytest.approx(14.9e3, rel=0.005)


@pytest.mark.parametrize(("com_height", "roll", "transfer"), [(0.45, 1.31, 0.105), (0.65, 2.00, 0.161)])
def test_higher_com_rolls_more(com_height: float, roll: float, transfer: float, tmp_path: Path) -> None:
    preset = Path(handling.__file__).parents[1] / "config" / "presets" / "table-5-1.toml"
    text = preset.read_text(encoding="utf-8")
    assert "com_height_m = 0.55" in text
    path = tmp_path / "car.toml"
    path.write_text(text.replace("com_height_m = 0.55", f"com_height_m = {com_height}"), encoding="utf-8")
    other = handling.run(str(path))
    assert value(other, "roll, amplitude") == pytest.approx(roll, rel=0.01)
    assert value(other, "load transfer, peak") == pytest.approx(transfer, rel=0.015)


def test_response_barely_depends_on_the_doubtful_inertias(report: Report) -> None:
    likely = handling.run(inertia_divisor=10.0)
    assert value(likely, "lateral acceleration, amplitude") == pytest.approx(
        value(report, "lateral acceleration, amplitude"), rel=0.005
    )
    assert value(likely, "yaw moment needed, peak") == pytest.approx(5.9e3, rel=0.01)


def test_finer_step_changes_nothing_to_speak_of(report: Report) -> None:
    fine = handling.run(dt_s=2.5e-4)
    for name in ("lateral acceleration, amplitude", "roll, amplitude"):
        assert value(fine, name) == pytest.approx(value(report, name), rel=1e-5)


def test_report_goes_to_json_and_plots(report: Report, tmp_path: Path) -> None:
    report.write_json(tmp_path / "handling.json")
    data = json.loads((tmp_path / "handling.json").read_text(encoding="utf-8"))
    assert {"rows", "series", "assumptions"} <= set(data)
    lengths = {len(series) for series in data["series"].values()}
    assert len(lengths) == 1
    assert np.ptp(data["series"]["yaw_rate_radps"]) == pytest.approx(0.36, abs=1e-3)
    (picture,) = handling.plot(report, tmp_path)
    assert picture.stat().st_size > 10_000


def test_progress_is_told() -> None:
    told: list[float] = []
    handling.run(periods=3, progress=told.append)
    assert told == sorted(told)
    assert 0.0 <= told[0] < told[-1] <= 1.0


def test_too_few_periods_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        handling.run(periods=2)


def test_step_that_does_not_divide_a_millisecond_is_refused() -> None:
    with pytest.raises(ValueError, match="whole fraction"):
        handling.run(dt_s=7e-4)


def test_unknown_vehicle_is_refused() -> None:
    with pytest.raises(ConfigError, match="table-5-1"):
        handling.run("table-5-9")
