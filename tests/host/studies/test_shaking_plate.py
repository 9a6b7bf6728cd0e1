"""The shaking plate through the whole stack: firmware, wire, daemon, emulated robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tiger.studies import shaking_plate

if TYPE_CHECKING:
    from pathlib import Path

    from tiger.studies.report import Report


@pytest.fixture(scope="module")
def report() -> Report:
    return shaking_plate.run(frequency_hz=0.2, periods=1, amplitude_deg=1.0)


def value(report: Report, name: str) -> float:
    return next(row.value for row in report.rows if row.name == name)


@pytest.mark.parametrize("step", ["step", "step back"])
def test_each_step_is_levelled_in_time_and_stays_level(report: Report, step: str) -> None:
    assert value(report, f"{step}: over the bound") <= 1.1
    assert value(report, f"{step}: beyond level") < 0.5
    assert value(report, f"{step}: mean error at rest") <= 0.3


def test_a_disturbance_of_less_than_two_tenths_of_a_degree_gives_no_pwm(report: Report) -> None:
    assert value(report, "disturbance of 0.19 degrees: largest PWM") == 0.0


def test_strokes_and_rates_stay_within_the_actuators(report: Report) -> None:
    for name in ("step", "step back", "harmonic"):
        assert (
            1.0
            <= value(report, f"{name}: shortest stroke")
            < value(report, f"{name}: longest stroke")
            <= 69.0
        )
        assert 0.0 < value(report, f"{name}: fastest stroke rate") <= 9.4 * 1.001


def test_a_harmonic_that_can_be_followed_leaves_little(report: Report) -> None:
    assert value(report, "harmonic: top rate over the actuators'") < 1.0
    assert value(report, "harmonic: residual RMS") <= 0.1
    assert abs(value(report, "harmonic: mean error, later half less earlier")) <= 0.1


def test_the_figures_are_drawn(report: Report, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    paths = shaking_plate.plot(report, tmp_path)
    assert [path.name for path in paths] == ["shaking-plate-step.png", "shaking-plate-harmonic.png"]
    assert all(path.stat().st_size > 10_000 for path in paths)


def test_a_wrong_axis_is_named() -> None:
    with pytest.raises(ValueError, match='axis = \'yaw\': take "roll" or "pitch"'):
        shaking_plate.run(axis="yaw")


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("overspeed", [1.2, 1.5, 2.0, 3.0])
def test_a_harmonic_too_fast_to_follow_leaves_little_more_than_it_must(
    axis: str, overspeed: float, record_figure
) -> None:
    top_hz_deg = {"roll": 0.2833, "pitch": 0.34}[axis]  # the actuators' fastest turn over 2 pi
    report = shaking_plate.run(axis=axis, amplitude_deg=2.0, frequency_hz=overspeed * top_hz_deg / 2.0)
    assert value(report, "harmonic: top rate over the actuators'") == pytest.approx(overspeed, rel=0.02)
    over = value(report, "harmonic: over the least residual")
    record_figure(f"{axis}, {overspeed:g} times too fast: residual over the least", over, "<= 1.15")
    assert over <= 1.15
