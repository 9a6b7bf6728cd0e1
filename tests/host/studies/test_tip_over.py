"""Roll-overs at random: what is drawn, what is counted, what is kept; two of them for real."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.rig.virtual import Rig
from tiger.studies import tip_over
from tiger.studies.tip_over import KINDS, Pair, drawn, gather, tally
from tiger.studies.tip_over_runs import Outcome, Polygon, draw

if TYPE_CHECKING:
    from pathlib import Path

    from tiger.studies.tip_over_runs import Kind

NAN = math.nan


def outcome(
    kind: Kind, balance_s: float = NAN, warned_s: float = NAN, tripped_s: float = NAN, impact_s: float = NAN
) -> Outcome:
    return Outcome(kind, balance_s, NAN, warned_s, tripped_s, impact_s, "", (0.01, 0.02))


def tipped(warned_s: float, prevented: bool = True, seed: int = 1) -> Pair:
    """A turn that reaches the balance point after 8 s when nothing limits."""
    limited = outcome("turn") if prevented else outcome("turn", balance_s=9.0)
    return Pair("turn", seed, outcome("turn", 8.0, warned_s), limited)


def curb(flagged_s: float) -> Pair:
    """A curb hit after 5 s."""
    return Pair("trip", 2, outcome("trip", tripped_s=flagged_s, impact_s=5.0), None)


# ---- what is drawn --------------------------------------------------


def test_more_runs_begin_with_the_same_ones_and_have_every_kind() -> None:
    many = drawn(100, 7)
    assert drawn(40, 7) == many[:40]
    assert {kind for kind, _ in many} == {*KINDS, "trip"}
    assert sum(kind == "trip" for kind, _ in many) == 20
    assert [seed for _, seed in many] == list(range(7, 107))


def test_a_case_depends_on_kind_and_seed_alone() -> None:
    assert draw("turn", 3) == draw("turn", 3)
    assert draw("turn", 3).numbers != draw("turn", 4).numbers
    assert draw("hill", 3).numbers["com_m"] != draw("turn", 3).numbers["com_m"]


def test_the_ways_to_tip_are_what_their_names_say() -> None:
    for seed in range(12):
        downhill, back = draw("downhill", seed).scenario, draw("reverse", seed).scenario
        assert downhill.terrain.climb_deg < 0.0
        assert downhill.drive[-1].yaw_rate_degps != 0.0
        assert back.drive[0].speed_mps < 0.0
        assert back.start.yaw_deg == 180.0  # so that it backs towards what lies at positive x
        assert len(draw("trip", seed).scenario.terrain.step) == 1


# ---- what is counted ------------------------------------------------


def test_a_warning_counts_from_half_a_second_before_the_balance_point() -> None:
    found = tally([tipped(7.5), tipped(7.6, seed=9), tipped(NAN, seed=10)])
    assert (found.tipped, found.warned, found.prevented) == (3, 1, 3)
    assert any("turn 9: warned 0.40 s ahead" in late for late in found.late)


def test_what_the_limiter_did_not_prevent_is_named() -> None:
    found = tally([tipped(6.0), tipped(6.0, prevented=False, seed=4)])
    assert (found.tipped, found.prevented) == (2, 1)
    assert found.late == ("turn 4: not prevented",)


@pytest.mark.parametrize(
    ("flagged_s", "counts"), [(5.1, True), (5.0, True), (5.12, False), (4.5, False), (NAN, False)]
)
def test_a_flag_counts_within_100_ms_of_the_impact_and_not_before(flagged_s: float, counts: bool) -> None:
    found = tally([curb(flagged_s)])
    assert (found.impacts, found.flagged) == (1, int(counts))
    assert bool(found.late) is not counts


def test_a_curb_that_was_not_reached_proves_nothing() -> None:
    missed = Pair("trip", 5, outcome("trip"), None)
    assert tally([missed])[:3] == (1, 1, 0)
    assert tally([missed]).impacts == 0


# ---- what is kept ---------------------------------------------------


def test_what_was_interrupted_goes_on_and_another_program_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[int] = []

    def run_both(kind: Kind, seed: int) -> Pair:
        ran.append(seed)
        return (
            curb(5.05)._replace(seed=seed) if kind == "trip" else tipped(6.0, seed=seed)._replace(kind=kind)
        )

    monkeypatch.setattr(tip_over, "run_both", run_both)
    keep = tmp_path / "new" / "kept.jsonl"
    first = gather(drawn(5), jobs=1, keep=keep)
    assert sorted(ran) == [0, 1, 2, 3, 4]
    shares: list[float] = []
    again = gather(drawn(8), jobs=1, keep=keep, progress=shares.append)
    assert sorted(ran) == [0, 1, 2, 3, 4, 5, 6, 7]
    assert json.dumps(again[:5]) == json.dumps(first)
    assert tally(again).flagged == tally(first).flagged == 1
    assert shares[-1] == 1.0

    monkeypatch.setattr(tip_over, "fingerprint", lambda: "another program")
    gather(drawn(2), jobs=1, keep=keep)
    assert sorted(ran[-2:]) == [0, 1]
    assert len(keep.read_text(encoding="utf-8").splitlines()) == 3


# ---- the robot ------------------------------------------------------


def test_the_balance_point_is_where_the_com_stands_over_an_edge() -> None:
    case = draw("turn", 1)
    level = replace(Rig(case.robot, case.scenario, 0).robot.truth(), roll_deg=0.0, pitch_deg=0.0)
    polygon = Polygon(case)
    passed = [polygon.passed(replace(level, pitch_deg=degrees)) for degrees in (-60.0, 0.0, 10.0, 60.0)]
    assert passed == [True, False, False, True]


def test_a_study_of_two_runs_has_rows_series_and_a_picture(tmp_path: Path) -> None:
    report = tip_over.run(runs=2, first_seed=20002, jobs=1, picture=True)
    value = {row.name: row.value for row in report.rows}
    assert value["runs"] == 2
    assert value["unfit: stopped by something else"] == 0
    assert report.series["unlimited_balance_point_s"] > report.series["unlimited_time_s"][0]
    assert np.isnan(report.series["limited_balance_point_s"])
    paths = tip_over.plot(report, tmp_path)
    assert [path.name for path in paths] == ["stability-turn.png", "stability-runs.png"]
    assert all(path.stat().st_size > 10_000 for path in paths)
    report.write_json(tmp_path / "report.json")
    assert json.loads((tmp_path / "report.json").read_text())["rows"]
