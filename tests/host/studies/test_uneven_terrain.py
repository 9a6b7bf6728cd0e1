"""Figure 4.12 in short, and its yardsticks against what is known of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tiger.studies import uneven_terrain

LIMITS = (1.8, 2.1)


@pytest.fixture(scope="module")
def report():
    patch = pytest.MonkeyPatch()
    patch.setattr(uneven_terrain, "RUN_UP_S", 3.0)
    patch.setattr(uneven_terrain, "ITERATIONS", 300)
    try:
        yield uneven_terrain.run("2", duration_s=4.0, seed=3)
    finally:
        patch.undo()


def test_levelling_leaves_less_than_holding_at_a_pace_the_actuators_can_follow(report) -> None:
    value = {row.name: row.value for row in report.rows}
    for axis in ("roll", "pitch"):
        assert value[f"2 km/h: {axis} RMS, active"] < 0.5 * value[f"2 km/h: {axis} RMS, passive"]
        assert value[f"2 km/h: {axis}, bound"] <= value[f"2 km/h: {axis}, bound without foresight"]
        assert value[f"2 km/h: {axis} RMS, active"] < 0.1


def test_the_report_is_plain_data_and_has_the_series_of_both_rides(report) -> None:
    data = report.to_json()
    assert {"passive_2_attitude_deg", "active_2_stroke_mm"} <= set(data["series"])
    assert all(math.isfinite(row["value"]) for row in data["rows"])


def test_its_plots_show_the_robot_on_its_ground(report, tmp_path) -> None:
    names = {path.name for path in uneven_terrain.plot(report, tmp_path)}
    assert names == {
        "uneven-terrain.png",
        "uneven-terrain-shares.png",
        "uneven-terrain-pictures.png",
        "uneven-terrain.gif",
    }


@pytest.mark.parametrize(
    ("speeds", "duration_s", "message"),
    [("fast", 20.0, "numbers"), ("-1", 20.0, "positive"), ("10", 60.0, "needs")],
)
def test_what_cannot_be_driven_is_refused_with_the_reason(speeds, duration_s, message) -> None:
    with pytest.raises(ValueError, match=message):
        uneven_terrain.run(speeds, duration_s)


def test_ground_that_stands_still_costs_nothing_without_foresight() -> None:
    axles = np.full((200, 4), 1.5)
    left = uneven_terrain.without_foresight(axles, LIMITS, 1.0, 1.0)
    assert np.abs(left).max() < 1e-9


def test_a_delay_costs_where_the_ground_bends_and_nothing_before() -> None:
    rise = np.concatenate([np.zeros(100), 0.4 * uneven_terrain.SAMPLE_S * np.arange(400)])
    axles = np.column_stack([rise, rise, 0.0 * rise, 0.0 * rise])
    late, prompt = (
        np.abs(uneven_terrain.without_foresight(axles, LIMITS, 1.0, 10.0, delay_s)[:, 0])
        for delay_s in (0.06, 0.0)
    )
    assert late[:50].max() < 1e-9
    assert late.max() > 1.2 * prompt.max()
    assert late[-100:].max() < 0.01


def test_foresight_never_hurts() -> None:
    rng = np.random.default_rng(1)
    waves = np.cumsum(rng.standard_normal((400, 2)), axis=0) * 0.05
    delay = round(1.0 / 1.0 / uneven_terrain.SAMPLE_S)
    axles = np.column_stack([waves[delay:, 0], waves[:-delay, 0], waves[delay:, 1], waves[:-delay, 1]])
    ground = axles[:, [0, 2]] + axles[:, [1, 3]]
    best, gap = uneven_terrain.bound(ground, LIMITS)
    causal = uneven_terrain.without_foresight(axles, LIMITS, 1.0, 1.0)
    assert (best**2).sum() <= (causal**2).sum() * (1.0 + 1e-6)
    assert gap >= 0.0
