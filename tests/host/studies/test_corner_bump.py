"""Figure 5.6: one corner lifted by 10 cm; the body settles where statics say, whatever inertia and speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tiger.studies import corner_bump
from tiger.studies.report import Report


def value(report: Report, name: str) -> float:
    (row,) = [row for row in report.rows if row.name == name]
    return row.value


@pytest.fixture(scope="module")
def likely() -> Report:
    return corner_bump.run(inertia_divisor=10.0)


def test_corners_settle_at_three_one_one_and_minus_one_quarters(likely: Report) -> None:
    """Within what gravity adds on a body that leans (small-angle theory: exactly 7.5, 2.5, 2.5, -2.5 cm)."""
    settled = [value(likely, f"{corner} corner, settled") for corner in ("FL", "FR", "RL", "RR")]
    np.testing.assert_allclose(settled, [7.5, 2.5, 2.5, -2.5], atol=0.3)


@pytest.mark.parametrize("step_m", [1e-3, -1e-3])
def test_small_steps_settle_in_the_same_shares(step_m: float) -> None:
    report = corner_bump.run(inertia_divisor=10.0, step_m=step_m)
    settled = np.array([value(report, f"{corner} corner, settled") for corner in ("FL", "FR", "RL", "RR")])
    base = corner_bump.run(inertia_divisor=10.0, step_m=0.0)
    level = np.array([value(base, f"{corner} corner, settled") for corner in ("FL", "FR", "RL", "RR")])
    np.testing.assert_allclose((settled - level) / (100 * step_m), [0.75, 0.25, 0.25, -0.25], atol=0.02)


def test_roll_settles_at_the_reference_with_gravity(likely: Report) -> None:
    """Small-angle theory 1.806 degrees; with gravity on the leaning body 1.90."""
    assert value(likely, "roll, settled") == pytest.approx(1.90, rel=0.005)
    assert value(likely, "pitch, settled") == pytest.approx(-1.085, abs=0.08)


def test_settled_attitude_depends_on_neither_inertia_nor_speed(likely: Report) -> None:
    printed = corner_bump.run(duration_s=30.0)
    slow = corner_bump.run(inertia_divisor=10.0, speed_kmh=15.0)
    for other in (printed, slow):
        assert value(other, "roll, settled") == pytest.approx(value(likely, "roll, settled"), rel=2e-3)
        assert value(other, "pitch, settled") == pytest.approx(value(likely, "pitch, settled"), abs=0.03)


def test_nothing_moves_before_the_step(likely: Report) -> None:
    time = np.asarray(likely.series["time_s"])
    before = time < 0.5
    assert np.abs(np.asarray(likely.series["roll_deg"])[before]).max() < 1e-9
    assert np.asarray(likely.series["corner_fl_cm"])[time > 0.6].min() > 1.0


def test_step_never_makes_a_tyre_pull(likely: Report) -> None:
    assert value(likely, "wheel load, least") == 0.0


def test_picture_is_drawn(likely: Report, tmp_path: Path) -> None:
    (picture,) = corner_bump.plot(likely, tmp_path)
    assert picture.stat().st_size > 10_000


def test_step_outside_the_run_is_refused() -> None:
    with pytest.raises(ValueError, match="within the run"):
        corner_bump.run(step_at_s=30.0)
