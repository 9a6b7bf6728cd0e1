"""Figures 4.13 to 4.15: what the study counts, and (in the proof) what passive and active reach."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.control.traction import design_traction
from tiger.emulation.scenarios import load_scenario
from tiger.record import Mode
from tiger.studies import loose_slope
from tiger.studies.loose_slope import ACTIVE, COLUMNS, PASSIVE, TOP_M, Ride, configured, gentle

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tiger.studies.report import Report


def ride(speed_mps: float = 0.3, rim_mps: float = 0.4, power_w: float = 10.0, end_s: float = 30.0) -> Ride:
    """A ride at constant speed, on paper."""
    time_s = np.arange(0.0, end_s, 0.1)
    series = {name: np.zeros((len(time_s), width)) for name, width in COLUMNS.items() if width > 1}
    series["time_s"] = time_s
    series["speed_mps"] = np.full(len(time_s), speed_mps)
    series["position_m"][:, 0] = -1.0 + speed_mps * time_s
    series["rim_speed_mps"][:] = rim_mps
    series["power_w"][:] = power_w
    series["load_n"][:] = 196.0
    return Ride(series, (), design_traction(configured(ACTIVE)), "")


def value(report: Report, name: str) -> float:
    return next(row.value for row in report.rows if row.name == name)


# ---- what is counted ----------------------------------------


def test_slip_is_the_share_of_the_rim_speed_that_moves_nothing() -> None:
    middle = ride().slip[10:-10]
    assert middle == pytest.approx(np.full_like(middle, 0.25))
    assert ride(speed_mps=0.0, rim_mps=0.4).slip[10:-10].min() == 1.0
    assert ride(speed_mps=0.3, rim_mps=0.2).slip.max() <= 1.0  # braking is no slip of this kind
    assert (ride(speed_mps=0.0, rim_mps=0.0).slip == 0.0).all()


def test_a_wheel_that_jerks_has_not_slipped() -> None:
    one = ride()
    one.series["rim_speed_mps"][100, 0] = 3.0
    assert one.slip[:, 0].max() < 0.7
    one.series["rim_speed_mps"][100:110, 0] = 3.0
    assert one.slip[:, 0].max() == pytest.approx(0.9)


def test_the_check_of_the_wheels_before_the_climb_does_not_count() -> None:
    one = ride()
    one.series["rim_speed_mps"][:4] = 2.0
    assert one.peak_slip < 0.5


def test_work_is_what_the_motors_put_in() -> None:
    assert ride().energy_j[-1] == pytest.approx(4 * 10.0 * 30.0, rel=1e-6)
    assert ride(power_w=-10.0).energy_j[-1] == 0.0


def test_a_place_that_is_not_reached_has_no_time() -> None:
    assert ride().when(TOP_M) == 250
    assert ride(end_s=5.0).when(TOP_M) is None


def test_the_gentle_slope_is_the_same_hill_with_less_twist() -> None:
    hard = load_scenario(loose_slope.SCENARIO)
    easy = gentle(hard)
    assert easy.terrain.step == hard.terrain.step
    assert [b.height_m for b in easy.terrain.bump] == [
        loose_slope.GENTLE * b.height_m for b in hard.terrain.bump
    ]
    less = 22.0 * loose_slope.GENTLE
    assert easy.initial_stroke_mm == pytest.approx((35.0 - less, 35.0 + less, 35.0 + less, 35.0 - less))


def test_passive_holds_its_strokes_and_does_not_limit_slip() -> None:
    passive, active = configured(PASSIVE), configured(ACTIVE)
    assert (PASSIVE.suspension, ACTIVE.suspension) == (Mode.HOLD, Mode.BALANCE)
    assert (passive.traction.share, active.traction.share) == ("equal", "load")
    assert passive.traction.slip_gain_per_s == 0.0 < active.traction.slip_gain_per_s
    assert passive.safety == active.safety


def test_a_robot_that_does_not_start_is_named() -> None:
    scenario = load_scenario(loose_slope.SCENARIO)
    short = scenario.model_copy(update={"duration_s": scenario.drive[0].at_s + 0.5})
    with pytest.raises(ValueError, match="passive: the robot did not start to climb"):
        loose_slope.ride(PASSIVE, short)


def test_the_figures_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from tiger.studies.report import Report

    one = ride(end_s=0.8)
    series = {
        f"{name}_{key}": values
        for name in ("passive", "active")
        for key, values in loose_slope.shown(one).items()
    }
    paths = loose_slope.plot(Report("", (), series), tmp_path)
    assert [path.name for path in paths] == [
        "loose-slope-passive-pictures.png",
        "loose-slope-passive.png",
        "loose-slope-active-pictures.png",
        "loose-slope-active.png",
        "loose-slope.gif",
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)


# ---- what is reached ----------------------------------------


@pytest.mark.proof
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_slope_that_passive_fails_is_climbed_by_active(seed: int, record_figure: Callable) -> None:
    report = loose_slope.run(seed=seed)
    record_figure("passive gets to", f"{value(report, 'passive: farthest place'):.2f} m", f"top: {TOP_M:g} m")
    record_figure("active: time to the top", f"{value(report, 'active: time to the top'):.1f} s", "climbed")
    assert value(report, "passive: reached the top") == 0.0
    assert value(report, "active: reached the top") == 1.0

    end = "to where the passive one ends"
    for what, unit in (("time", "s"), ("work", "J")):
        passive, active = (value(report, f"{end}: {name}, {what}") for name in ("passive", "active"))
        record_figure(f"{end}: {what}", f"{active:.1f} of {passive:.1f} {unit}", "less")
        assert active < passive
        ratio = value(report, f"gentle, active over passive: {what}")
        record_figure(f"gentle slope, active over passive: {what}", ratio, "< 1")
        assert ratio < 1.0

    for name in (
        "peak slip, shared by load over equal torque (strokes passive)",
        "peak slip, active over passive",
    ):
        record_figure(name, value(report, name), "<= 0.8")
        assert value(report, name) <= 0.8
    late_us = value(report, "sharing out the forces: 99th percentile")
    record_figure("sharing out the forces, 99th percentile", f"{late_us:.0f} us", "<= 1 ms")
    assert late_us <= 1000.0
    assert all(math.isfinite(row.value) for row in report.rows if row.name.startswith("active"))
