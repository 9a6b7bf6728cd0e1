"""What the calibrations make of their readings, on readings whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tiger.calibration import accel, imu, level, strokes
from tiger.calibration.procedure import CalibrationError, Window
from tiger.config.robot import load_robot
from tiger.models.full_car import GRAVITY_MPS2
from tiger.protocol.messages import PARAMS, BoardKind

NANO = {param.name: param.default for param in PARAMS[BoardKind.NANO_IMU]}
MEGA = {param.name: param.default for param in PARAMS[BoardKind.MEGA_SUSPENSION]}
SMALL = st.floats(-1.0, 1.0)


def at_rest(accel_mps2, gyro_degps=(0.0, 0.0, 0.0), samples: int = 1000, noise: float = 0.1) -> Window:
    random = np.random.default_rng(1)
    force = np.asarray(accel_mps2) + 0.01 * random.standard_normal((samples, 3))
    rate = np.asarray(gyro_degps) + noise * random.standard_normal((samples, 3))
    return Window(np.hstack([force, np.radians(rate)]))


UP = (0.0, 0.0, GRAVITY_MPS2)


# ---- imu


def test_bias_and_noise_are_found_to_their_uncertainty() -> None:
    result = imu.solve((at_rest(UP, (0.5, -0.8, 0.2)),), NANO)
    assert np.degrees(result.parameters["gyro_bias_radps"]) == pytest.approx((0.5, -0.8, 0.2), abs=0.015)
    assert result.parameters["calibrated"] == (1.0,)
    found = {finding.name: finding for finding in result.findings}
    assert found["gyro noise x"].value == pytest.approx(0.1, rel=0.1)
    assert found["gravity error"].good


@pytest.mark.parametrize(
    ("window", "reason"),
    [
        (at_rest(UP, noise=0.3), "varies by 0.3"),
        (at_rest(UP, (3.5, 0.0, 0.0)), "the data sheet allows 3"),
        (Window(at_rest(UP).readings + np.linspace(0.0, 0.004, 1000)[:, None]), "changed by"),
        (Window(at_rest(UP).readings + np.sin(np.arange(1000.0))[:, None] * [1, 0, 0, 0, 0, 0]), "shakes"),
    ],
)
def test_a_robot_that_is_not_at_rest_is_told_so(window: Window, reason: str) -> None:
    complaint = imu.unrest(window.readings)
    assert complaint is not None
    assert reason in complaint
    assert ";" in complaint  # and the next step


def test_rest_passes_as_rest() -> None:
    assert imu.unrest(at_rest(UP, (2.5, -2.5, 0.0)).readings) is None


def test_an_accelerometer_that_misses_gravity_is_noticed() -> None:
    result = imu.solve((at_rest((0.0, 0.0, 10.1)),), NANO)
    assert any("tiger calibrate accel" in note for note in result.notes)


# ---- accel


@settings(max_examples=40, deadline=None)
@given(
    offset=st.tuples(SMALL, SMALL, SMALL),
    stretch=st.tuples(SMALL, SMALL, SMALL),
    seed=st.integers(0, 1000),
)
def test_offset_and_scale_come_back_however_askew_the_sensor_was_held(offset, stretch, seed) -> None:
    scale = 1.0 + 0.1 * np.array(stretch)
    random = np.random.default_rng(seed)
    true = [
        GRAVITY_MPS2
        * Rotation.from_rotvec(random.uniform(-15, 15, 3), degrees=True).apply(sign * np.eye(3)[k])
        for k, sign in accel.POSITIONS
    ]
    found_offset, found_scale, left = accel.fit(np.array(true) / scale + np.array(offset))
    assert found_offset == pytest.approx(np.array(offset), abs=1e-6)
    assert found_scale == pytest.approx(scale, abs=1e-6)
    assert np.abs(left).max() < 1e-6


def test_a_wrong_position_is_named() -> None:
    complaint = accel.not_upright(0, 1.0, at_rest((0.0, -GRAVITY_MPS2, 0.0)).readings)
    assert complaint is not None
    assert "y axis down" in complaint
    assert accel.not_upright(1, -1.0, at_rest((0.0, -GRAVITY_MPS2, 0.0)).readings) is None


def test_a_hopeless_accelerometer_is_refused() -> None:
    windows = [at_rest(sign * GRAVITY_MPS2 * 1.5 * np.eye(3)[k]) for k, sign in accel.POSITIONS]
    with pytest.raises(CalibrationError, match="cannot be stored"):
        accel.solve(tuple(windows), NANO)


# ---- level


@given(x=SMALL, y=SMALL, z=st.floats(0.1, 1.0))
def test_the_shortest_turn_points_up_and_leaves_yaw_alone(x, y, z) -> None:
    direction = np.array([x, y, z])
    turn = level.shortest_turn_up(direction)
    assert turn.apply(direction / np.linalg.norm(direction)) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert turn.as_rotvec()[2] == pytest.approx(0.0, abs=1e-12)


def test_levelling_twice_changes_nothing() -> None:
    tilt = Rotation.from_euler("xyz", (4.0, -3.0, 20.0), degrees=True)
    first = level.solve((at_rest(tilt.inv().apply(UP)),), NANO).parameters
    turn = Rotation.from_quat(first["mounting_quaternion"], scalar_first=True)
    second = level.solve((at_rest(turn.apply(tilt.inv().apply(UP))),), NANO | first).parameters
    assert second["mounting_quaternion"] == pytest.approx(first["mounting_quaternion"], abs=1e-3)


def test_offset_and_bias_turn_with_the_mounting() -> None:
    before = NANO | {"accel_offset_mps2": (0.0, 0.0, 0.3), "gyro_bias_radps": (0.01, 0.0, 0.02)}
    tilt = Rotation.from_euler("y", 30.0, degrees=True)
    found = level.solve((at_rest(tilt.inv().apply(UP) + np.array([0.0, 0.0, 0.3])),), before).parameters
    assert found["accel_offset_mps2"] == pytest.approx(tilt.apply([0.0, 0.0, 0.3]), abs=1e-3)
    assert found["gyro_bias_radps"] == pytest.approx(tilt.apply([0.01, 0.0, 0.02]), abs=1e-4)


@pytest.mark.parametrize(
    ("window", "reason"),
    [
        (at_rest((0.0, 0.0, -GRAVITY_MPS2)), "tilted by 180"),
        (at_rest((GRAVITY_MPS2, 0.0, 0.0)), "tilted by 90"),
        (at_rest((0.0, 0.0, 10.5)), "tiger calibrate accel"),
        (replace(at_rest(UP), stroke_mm=(35.0, 35.0, 35.0, 38.0)), "3.0 mm apart"),
    ],
)
def test_what_cannot_be_levelled_is_refused(window: Window, reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        level.solve((window,), NANO)


# ---- strokes


def measured(sums, stroke_mm) -> tuple[Window, ...]:
    """One window per position: all corners alike."""
    return tuple(
        Window(np.full((20, 4), float(s)), measured=(mm,) * 4) for s, mm in zip(sums, stroke_mm, strict=True)
    )


@pytest.mark.parametrize(("low", "high"), [(1000.0, 15000.0), (15000.0, 1000.0)])
def test_a_line_is_found_whichever_way_the_potentiometer_is_wired(low: float, high: float) -> None:
    strokes_mm = np.array([5.0, 30.0, 66.0])
    result = strokes.solve(measured(low + (high - low) * strokes_mm / 70.0, strokes_mm), MEGA)
    assert result.parameters["pot_low_counts"] == (low,) * 4
    assert result.parameters["pot_high_counts"] == (high,) * 4


def test_a_bow_is_fitted_and_what_is_left_of_it_is_said() -> None:
    strokes_mm = np.linspace(0.0, 70.0, 8)
    bent = strokes_mm + 2.0 * np.sin(2.0 * np.pi * strokes_mm / 70.0)
    result = strokes.solve(measured(1000.0 + 200.0 * bent, strokes_mm), MEGA)
    worst = next(finding for finding in result.findings if finding.name == "FL farthest")
    assert worst.good
    assert max(result.parameters["pot_quarter_counts"]) > 200.0


def test_the_distance_from_the_curve_is_said() -> None:
    strokes_mm = np.linspace(0.0, 70.0, 8)
    read = strokes_mm + np.array([0.0, 3.0, -3.0, 3.0, -3.0, 3.0, -3.0, 0.0])  # a ruler that slips
    result = strokes.solve(measured(1000.0 + 200.0 * read, strokes_mm), MEGA)
    worst = next(finding for finding in result.findings if finding.name == "FL farthest")
    assert not worst.good
    assert "measure again" in result.notes[0]


@pytest.mark.parametrize(
    ("sums", "strokes_mm", "reason"),
    [
        ((1000.0, 4000.0), (5.0, 20.0), "measured over 15.0 mm only"),
        ((1000.0, 1000.0), (5.0, 65.0), "reads 1000 at every position"),
        ((1000.0, 2000.0), (5.0, 65.0), "at least 2800"),
        ((200.0, 16300.0), (20.0, 60.0), "outside 0 to 16368"),
    ],
)
def test_strokes_that_make_no_curve_are_refused(sums, strokes_mm, reason: str) -> None:
    with pytest.raises(CalibrationError, match=reason):
        strokes.solve(measured(sums, strokes_mm), MEGA)


def test_strokes_in_another_unit_are_asked_again_at_once() -> None:
    ask = strokes.strokes_procedure([0.0, 35.0, 70.0], moves=False).stages[0].measure
    assert ask is not None
    assert ask.wrong((-1.0, 0.0, 71.0, 35.0)) is None
    assert "RL at 350 mm is beyond ±105 mm" in str(ask.wrong((35.0, 35.0, 350.0, 35.0)))


def test_the_robot_stays_clear_of_the_ends_and_a_person_does_not() -> None:
    full = load_robot(None).actuator.stroke_max_mm
    assert strokes.positions_mm(full, 3, moves=False) == [0.0, full / 2.0, full]
    low, _, high = strokes.positions_mm(full, 3, moves=True)
    assert low >= 5.0
    assert high <= full - 5.0
    with pytest.raises(CalibrationError, match="at least two"):
        strokes.strokes_procedure([35.0], moves=False)


# ---- strokes: the curve of a potentiometer that is not straight


def bowed(share: np.ndarray) -> np.ndarray:
    """Sums of a potentiometer that reads up to 600 above the straight line."""
    return 900.0 + 14000.0 * share + 600.0 * np.sin(np.pi * share)


def test_many_positions_find_the_bow_at_the_quarters() -> None:
    share = np.linspace(0.05, 0.95, 13)
    curve = strokes.fit_curve(share, bowed(share))
    assert curve == pytest.approx(bowed(np.linspace(0.0, 1.0, 5)), abs=70.0)
    straight = np.polyval(np.polyfit(share, bowed(share), 1), share)
    by_curve = np.interp(share, np.linspace(0.0, 1.0, 5), curve)
    assert np.abs(bowed(share) - by_curve).max() < 0.35 * np.abs(bowed(share) - straight).max()


@given(
    low=st.floats(500.0, 2000.0),
    span=st.floats(5000.0, 13000.0),
    positions=st.integers(2, 15),
    falls=st.booleans(),
)
def test_a_straight_potentiometer_has_no_bow(low: float, span: float, positions: int, falls: bool) -> None:
    share = np.linspace(0.1, 0.9, positions)
    reading = low + span * (1.0 - share if falls else share)
    ends = (low + span, low) if falls else (low, low + span)
    assert strokes.fit_curve(share, reading) == pytest.approx(np.linspace(*ends, 5), abs=0.01)


def test_few_positions_give_a_line() -> None:
    share = np.linspace(0.1, 0.9, strokes.POSITIONS_FOR_A_CURVE - 1)
    curve = strokes.fit_curve(share, bowed(share))
    assert np.diff(curve, n=2) == pytest.approx(np.zeros(3), abs=1e-6)
