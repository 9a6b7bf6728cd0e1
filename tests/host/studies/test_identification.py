"""The identification study: its rows, its plots, and the loop closed on the identified vehicle."""

from __future__ import annotations

import json
from pathlib import Path

from tiger.studies import identification


def test_identified_vehicle_serves_the_controller_as_the_known_one_does(tmp_path: Path) -> None:
    report = identification.run(seed=2, loop_roads=3)
    value = {row.name: row.value for row in report.rows}
    assert value["maximum likelihood order"] == 14
    assert value["channel wls error over maximum likelihood error"] >= 10
    assert value["physical fit, worst of 13 parameters"] <= 1
    for design in ("holding", "holding preview"):
        for body in ("heave", "pitch", "roll"):
            assert abs(value[f"{design} rms {body} cut, points lost to the known model"]) <= 2
    for body in ("heave", "pitch", "roll"):
        assert value[f"open loop {body} fit on the bumpy road"] >= 85
    json.dumps(report.to_json())
    assert len(identification.plot(report, tmp_path)) == 5
