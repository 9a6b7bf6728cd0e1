"""The report that every study returns."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from pathlib import Path

REPORT = Report(
    title="test",
    rows=(
        Row("roll", float(np.float64(1.5)), "deg", printed=1.6),
        Row("never", float("nan"), "s"),
    ),
    series={"time_s": np.arange(3.0), "stroke_mm": np.zeros((3, 4))},
    assumptions={"seed": np.int64(7), "road": "flat", "delays_s": (0.0, 0.1)},
)


def test_json_holds_rows_series_and_assumptions_as_plain_types(tmp_path: Path) -> None:
    REPORT.write_json(tmp_path / "report.json")
    read = json.loads((tmp_path / "report.json").read_text())
    assert read["rows"][0] == {"name": "roll", "value": 1.5, "unit": "deg", "printed": 1.6}
    assert read["series"]["time_s"] == [0.0, 1.0, 2.0]
    assert read["series"]["stroke_mm"] == [[0.0] * 4] * 3
    assert read["assumptions"] == {"seed": 7, "road": "flat", "delays_s": [0.0, 0.1]}


def test_a_figure_that_is_not_finite_becomes_null() -> None:
    assert REPORT.to_json()["rows"][1]["value"] is None


def test_table_shows_the_printed_figure_beside_the_value() -> None:
    out = io.StringIO()
    Console(file=out, width=100).print(REPORT.table())
    line = next(line for line in out.getvalue().splitlines() if "roll" in line)
    assert "1.5" in line
    assert "1.6" in line


def test_table_shows_a_dash_for_a_figure_of_nothing() -> None:
    out = io.StringIO()
    Console(file=out, width=100).print(REPORT.table())
    line = next(line for line in out.getvalue().splitlines() if "never" in line)
    assert "nan" not in line
    assert " - " in line
