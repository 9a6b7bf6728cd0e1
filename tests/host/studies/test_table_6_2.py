"""Table 6.2: the rows, the bars that few seeds can show, and the schedule for both roads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.control import ride_designs
from tiger.control.ride import ImuNoise
from tiger.studies import ride_cases, table_6_2
from tiger.studies.performance import INDEX_NAMES, performance_index, simulate

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def report():
    return table_6_2.run(bumpy_seeds=6, iso_seeds=12, first_seed=40)


def test_every_row_of_the_table_stands_beside_the_printed_one(report, tmp_path: Path) -> None:
    rows = {row.name: row for row in report.rows}
    for column, printed in ride_cases.PRINTED.items():
        for name, figure in zip(INDEX_NAMES, printed, strict=True):
            assert rows[f"{column} {name}"].printed == figure
    json.dumps(report.to_json())
    assert len(table_6_2.plot(report, tmp_path)) == 8


def test_active_bumpy_rows_are_on_average_at_or_below_the_printed_ones(report) -> None:
    value = {row.name: row.value for row in report.rows}
    assert value["bumpy active, worst mean row over printed"] <= 1.0
    assert value["bumpy active, noise x0.1, preview, worst mean row over printed"] <= 1.005
    assert value["bumpy active, noise x1, no preview, worst mean row over printed"] <= 1.55


def test_iso_road_comfort_and_road_holding(report) -> None:
    value = {row.name: row.value for row in report.rows}
    assert value["iso active rms heave cut"] >= 60
    assert value["iso active rms pitch cut"] >= 65
    assert value["iso active rms roll cut"] >= 61
    assert value["iso holding rms heave cut"] >= 46
    assert value["iso holding preview rms heave cut"] >= 53
    for i in (1, 2):
        assert value[f"iso holding preview rms relative tire load eta{i}, active over passive"] <= 1.0
    for i in (3, 4):
        assert value[f"iso holding preview rms relative tire load eta{i}, active over passive"] <= 0.75


def test_one_scheduled_controller_serves_both_roads() -> None:
    bumpy, iso = table_6_2.compare_schedule(seeds=6)
    assert bumpy.max() <= 1.10
    assert iso.max() <= 1.10


@pytest.mark.proof
def test_all_rows_in_all_of_twenty_seeds() -> None:
    case = ride_cases.load_case("table-6-1")
    noise = ImuNoise().scaled(0.03)
    controller = ride_designs.BUMPY_PREVIEW_TACTICAL.controller(case.car, noise, ride_cases.BUMPY_PREVIEW_S)
    run = simulate(case.car, ride_cases.bumpy_road(), controller, noise, tuple(range(20)))
    ratio = performance_index(case.car, case.rattle_space_m, run) / np.array(
        ride_cases.PRINTED["bumpy active"]
    )
    assert ratio.max() <= 1.003
    assert ratio.mean(axis=0).max() <= 1.0


def test_vehicle_without_force_actuators_is_refused_with_the_reason() -> None:
    with pytest.raises(ConfigError, match="force"):
        table_6_2.run(vehicle="tiger")
