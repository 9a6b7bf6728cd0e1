"""Weak actuators: limits hold, planning for them pays unless they are far too weak, and a tick is cheap."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tiger.studies import force_limits

pytest.importorskip("daqp")


@pytest.fixture(scope="module")
def report():
    return force_limits.run(seed=5)


def test_limits_hold_for_both_controllers(report) -> None:
    value = {row.name: row.value for row in report.rows}
    for name in ("regulator", "predictive"):
        for limit in (6, 5, 4, 3):
            assert value[f"{name}, {limit} kN: largest force"] <= 1000 * limit * (1 + 1e-6)
            assert value[f"{name}, {limit} kN: largest force rate"] <= 60e3 * (1 + 1e-6)
    for limit in (6, 5, 4, 3):
        assert value[f"predictive, {limit} kN: largest suspension travel"] <= 71.5


def test_planning_beats_running_into_the_limit_in_heave(report) -> None:
    value = {row.name: row.value for row in report.rows}
    for limit in (5, 4):
        for measure, share in (("peak", 0.8), ("rms", 0.9)):
            row = f"{limit} kN: {measure} heave acceleration"
            assert value[f"predictive, {row}"] <= share * value[f"regulator, {row}"]


def test_a_tick_is_cheap_and_the_report_is_complete(report, tmp_path: Path) -> None:
    value = {row.name: row.value for row in report.rows}
    assert value["predictive tick, 99th percentile"] <= 1.5
    json.dumps(report.to_json())
    assert force_limits.plot(report, tmp_path)[0].stat().st_size > 1000
