"""The quarter-car study prints the closed forms of its corner."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tiger.studies import quarter_car


def test_figures_of_table_5_1(tmp_path: Path) -> None:
    report = quarter_car.run()
    value = {row.name: row.value for row in report.rows}
    assert value["mode 1 frequency"] == pytest.approx(1.320, rel=1e-3)
    assert value["mode 2 damping ratio"] == pytest.approx(0.466, rel=2e-3)
    assert value["step: highest body"] == pytest.approx(0.1307, rel=1e-3)
    assert value["step: peak body acceleration"] == pytest.approx(36.47, rel=1e-3)
    assert value["push: body rise at rest"] == pytest.approx(0.005)
    assert value["push: body rise at the end"] == pytest.approx(0.005, rel=1e-2)
    json.dumps(report.to_json())
    assert all(path.stat().st_size > 1000 for path in quarter_car.plot(report, tmp_path))
