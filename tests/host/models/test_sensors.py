"""Potentiometer, gear and motor current: inverses undo their sensors, and errors have their stated size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.models.sensors.gear import TURN, QuadratureGear
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.models.sensors.potentiometer import Potentiometer

# ---- potentiometer


POT = Potentiometer(stroke_max_mm=70.0)


@given(st.floats(0.0, 70.0))
def test_counts_give_the_stroke_back_within_half_a_count(stroke: float) -> None:
    half_count_mm = 0.5 * 5.0 / 1024 / 4.5 * 70.0
    assert float(POT.stroke_mm(POT.counts(POT.volts(stroke)))) == pytest.approx(
        stroke, abs=half_count_mm + 1e-9
    )


def test_wiper_uses_the_configured_part_of_the_supply() -> None:
    assert POT.volts([0.0, 35.0, 70.0]) == pytest.approx([0.25, 2.5, 4.75])
    narrow = Potentiometer(50.0, volts_at_zero_stroke=4.0, volts_at_full_stroke=1.0)
    assert narrow.volts([0.0, 50.0]) == pytest.approx([4.0, 1.0])
    assert float(narrow.stroke_mm(narrow.counts(narrow.volts(20.0)))) == pytest.approx(20.0, abs=0.05)


@given(st.floats(0.0, 70.0))
def test_exact_counts_agree_with_the_volts(stroke: float) -> None:
    bent = Potentiometer(70.0, nonlinearity=0.02)
    assert bent.exact_counts(stroke) == pytest.approx(float(bent.volts(stroke)) / 5.0 * 1024)


def test_converter_never_leaves_its_ten_bits() -> None:
    assert POT.counts([-1.0, 0.0, 2.5, 4.999, 5.0, 9.0]).tolist() == [0, 0, 512, 1023, 1023, 1023]


def test_noise_has_its_size_and_stays_on_the_rails() -> None:
    volts = POT.volts(np.full(20000, 35.0), np.random.default_rng(1))
    assert volts.std() == pytest.approx(0.002, rel=0.03)
    edge = Potentiometer(70.0, volts_at_zero_stroke=0.0, noise_v=0.1).volts(
        np.zeros(100), np.random.default_rng(1)
    )
    assert edge.min() == 0.0


def test_nonlinearity_bends_by_its_share_of_the_stroke_and_keeps_the_ends() -> None:
    bent = replace(POT, nonlinearity=0.01)
    strokes = np.linspace(0.0, 70.0, 701)
    error = (bent.volts(strokes) - POT.volts(strokes)) / 4.5
    assert np.abs(error).max() == pytest.approx(0.01, rel=1e-3)
    assert error[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-12)


# ---- gear


GEAR = QuadratureGear(60, 0.01, np.random.default_rng(2))


def test_an_ideal_gear_counts_angle() -> None:
    assert QuadratureGear(60).phase(TURN / 4) == pytest.approx(15.0)
    assert QuadratureGear(60).phase(-TURN) == pytest.approx(-60.0)


@given(st.floats(-1000.0, 1000.0), st.integers(-50, 50))
def test_phase_repeats_with_every_turn(angle: float, turns: int) -> None:
    assert GEAR.phase(angle + turns * TURN) == pytest.approx(GEAR.phase(angle) + 60 * turns, abs=1e-6)


@given(st.floats(-100.0, 100.0), st.floats(1e-9, 1.0))
def test_phase_never_runs_backwards(angle: float, step: float) -> None:
    assert GEAR.phase(angle + step) >= GEAR.phase(angle)


@given(st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=10))
def test_one_by_one_and_all_at_once_agree(angles: list[float]) -> None:
    assert GEAR.phases(angles) == pytest.approx([GEAR.phase(angle) for angle in angles], abs=1e-9)


def test_teeth_start_at_whole_phases() -> None:
    assert GEAR.phases(GEAR.edges_rad[:-1]) == pytest.approx(np.arange(60.0), abs=1e-9)


def test_pitch_error_has_its_size_and_closes_over_the_turn() -> None:
    gears = [QuadratureGear(60, 0.01, np.random.default_rng(seed)) for seed in range(100)]
    pitches = np.array([np.diff(gear.edges_rad) for gear in gears]) / (TURN / 60)
    assert pitches.std() == pytest.approx(0.01, rel=0.05)
    assert pitches.sum(axis=1) == pytest.approx(np.full(100, 60.0))


def test_channel_a_leads_b_forwards_and_only_one_changes_at_a_time() -> None:
    forwards = [QuadratureGear.levels(phase) for phase in (0.1, 0.3, 0.6, 0.8, 1.1)]
    assert forwards == [(True, False), (True, True), (False, True), (False, False), (True, False)]
    assert QuadratureGear.levels(-0.1) == (False, False)


def test_count_is_four_to_the_tooth_and_floors_below_zero() -> None:
    assert QuadratureGear.count([0.0, 0.24, 0.25, 1.0, -0.01]).tolist() == [0, 0, 1, 4, -1]


def test_a_gear_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one tooth"):
        QuadratureGear(0)
    with pytest.raises(ValueError, match=r"less than 0\.25"):
        QuadratureGear(60, 2.0, np.random.default_rng(0))


# ---- motor current


@given(st.floats(-15.0, 15.0), st.floats(-80.0, 80.0))
def test_torque_comes_back_from_the_current(torque: float, speed: float) -> None:
    motor = MotorCurrent()
    assert float(motor.torque_nm(motor.true_a(torque, speed), speed)) == pytest.approx(torque, abs=1e-9)


def test_rated_point_of_table_3_3() -> None:
    # 350 W at 24 V, 800 rpm: 14.6 A for 4.18 Nm, beside the no-load current.
    assert float(MotorCurrent(no_load_a=0.0).true_a(4.18, 83.8)) == pytest.approx(14.6, rel=1e-3)


def test_current_saturates_and_turns_with_direction() -> None:
    motor = MotorCurrent()
    assert float(motor.true_a(1000.0, 10.0)) == 60.0
    assert float(motor.true_a(-5.0, -10.0)) == -float(motor.true_a(5.0, 10.0))
    assert float(motor.true_a(0.0, 0.0)) == 0.0


def test_measured_current_is_in_whole_tenths_with_noise_on_demand() -> None:
    motor = MotorCurrent()
    assert motor.measured_a([1.234, -1.26]) == pytest.approx([1.2, -1.3])
    noisy = motor.measured_a(np.full(20000, 5.0), np.random.default_rng(0))
    assert noisy.std() == pytest.approx(np.hypot(0.15, 0.1 / np.sqrt(12)), rel=0.03)
