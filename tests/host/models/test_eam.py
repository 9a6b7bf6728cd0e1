"""The elastic actuated mechanism: solved exactly, in one assembly, and refused where it cannot stand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.vehicle import MechanismConfig, load_vehicle
from tiger.models.eam import RESIDUAL_LIMIT, Eam, MechanismError

GEOMETRIES = ("tiger", "tiger-b")

# Rows of the designed mechanism, every 10 mm from 0 to 100 mm of stroke.
ARM_DEG = [-7.50, -1.7, 4.0, 9.5, 15.1, 20.6, 26.3, 32.0, 37.8, 43.6, 49.0]
RISE_A_MM = [0, 21.3, 42.0, 62.2, 82.0, 101.4, 120.3, 138.6, 156.0, 172.1, 186.0]
TRACK_A_MM = [1266.4, 1269.8, 1269.0, 1264.2, 1255.5, 1243.1, 1226.7, 1206.3, 1182.1, 1154.3, 1125.4]
RATIO_A = [2.17, 2.10, 2.05, 2.00, 1.96, 1.92, 1.86, 1.79, 1.68, 1.52, 1.21]
RISE_B_MM = [0, 38.3, 75.5, 112, 147.7, 182.5, 216.5, 249.5, 281, 310, 335]


def mechanism(name: str) -> MechanismConfig:
    config = load_vehicle(name).eam
    assert config is not None
    return config


def build(config: MechanismConfig, stroke_max_mm: float = 100.0) -> Eam:
    return Eam(config, stroke_max_mm=stroke_max_mm, length_at_zero_stroke_mm=244.0, wheel_radius_mm=162.0)


FULL = {name: build(mechanism(name)) for name in GEOMETRIES}
TIGER = Eam.from_vehicle(load_vehicle("tiger"))
STROKES = np.arange(0.0, 101.0, 10.0)

geometry = pytest.mark.parametrize("eam", FULL.values(), ids=GEOMETRIES)


# ---- the designed motion


def test_geometry_a_moves_as_designed() -> None:
    pose = FULL["tiger"].pose(STROKES)
    np.testing.assert_allclose(np.degrees(pose.arm_angle_rad), ARM_DEG, atol=0.06)
    np.testing.assert_allclose(pose.rise_mm, RISE_A_MM, atol=0.06)
    np.testing.assert_allclose(pose.track_mm, TRACK_A_MM, atol=0.11)
    np.testing.assert_allclose(pose.motion_ratio, RATIO_A, atol=0.006)


def test_geometry_b_moves_as_designed() -> None:
    pose = FULL["tiger-b"].pose(STROKES)
    np.testing.assert_allclose(np.degrees(pose.arm_angle_rad), ARM_DEG, atol=0.06)
    np.testing.assert_allclose(pose.rise_mm, RISE_B_MM, atol=0.3)


def test_arm_sweeps_the_printed_range_of_minus_7_5_to_49_degrees_over_100_mm() -> None:
    angle = np.degrees(FULL["tiger"].pose(np.array([0.0, 100.0])).arm_angle_rad)
    np.testing.assert_allclose(angle, [-7.5, 49.0], atol=0.05)


@geometry
def test_track_widens_until_the_arm_is_level_and_narrows_after(eam: Eam) -> None:
    pose = eam.pose(np.linspace(0.0, 100.0, 401))
    widest = int(np.argmax(pose.track_mm))
    assert abs(np.degrees(pose.arm_angle_rad[widest])) < 0.1
    assert 12.0 < pose.stroke_mm[widest] < 14.0
    assert np.all(np.diff(pose.track_mm[: widest + 1]) > 0.0)
    assert np.all(np.diff(pose.track_mm[widest:]) < 0.0)


@geometry
def test_clearance_and_rise_are_the_arm_seen_twice(eam: Eam) -> None:
    pose = eam.pose(STROKES)
    drop = eam.mechanism.arm_length_mm * np.sin(pose.arm_angle_rad)
    np.testing.assert_allclose(pose.ground_clearance_mm, eam.wheel_radius_mm + drop, atol=1e-9)
    np.testing.assert_allclose(pose.rise_mm, drop - drop[0], atol=1e-9)


def test_pose_keeps_the_shape_of_the_strokes() -> None:
    grid = np.array([[0.0, 10.0, 20.0], [30.0, 40.0, 70.0]])
    assert TIGER.pose(grid).rise_mm.shape == (2, 3)
    assert TIGER.pose(35.0).track_mm.shape == ()
    assert TIGER.pose(grid).rise_mm[1, 0] == pytest.approx(float(TIGER.pose(30.0).rise_mm), abs=1e-9)


# ---- eqs. 4.2 to 4.4


@geometry
def test_residual_is_at_rounding_level_over_the_whole_stroke(eam: Eam) -> None:
    strokes = np.linspace(0.0, 100.0, 1001)
    assert np.abs(eam.residual(eam.assemble(strokes), strokes)).max() < RESIDUAL_LIMIT


@geometry
def test_body_does_not_turn_and_the_wheel_stands_on_the_ground(eam: Eam) -> None:
    q = eam.assemble(STROKES)
    np.testing.assert_allclose(q[:, [0, 2, 14]], 0.0, atol=1e-12)
    np.testing.assert_allclose(q[:, 13], 162.0, rtol=1e-12)


@geometry
def test_velocity_is_the_derivative_of_the_coordinates(eam: Eam) -> None:
    strokes, rate, step = np.linspace(1.0, 99.0, 60), 9.4, 1e-3
    q_dot = eam.velocity(eam.assemble(strokes), strokes, rate)
    moved = (eam.assemble(strokes + rate * step) - eam.assemble(strokes - rate * step)) / (2.0 * step)
    for column in np.flatnonzero(np.abs(q_dot).max(axis=0) > 1e-9):
        scale = np.abs(q_dot[:, column]).max()
        assert np.abs(moved - q_dot)[:, column].max() < 1e-5 * scale


@geometry
@pytest.mark.parametrize("accel_mmps2", [0.0, 120.0])
def test_acceleration_is_the_derivative_of_the_velocity(eam: Eam, accel_mmps2: float) -> None:
    strokes, rate, step = np.linspace(1.0, 99.0, 60), 9.4, 1e-3

    def speed_at(time_s: float) -> np.ndarray:
        stroke = strokes + rate * time_s + accel_mmps2 * time_s**2 / 2.0
        return eam.velocity(eam.assemble(stroke), stroke, rate + accel_mmps2 * time_s)

    q = eam.assemble(strokes)
    q_ddot = eam.acceleration(q, speed_at(0.0), strokes, rate, accel_mmps2)
    moved = (speed_at(step) - speed_at(-step)) / (2.0 * step)
    for column in np.flatnonzero(np.abs(q_ddot).max(axis=0) > 1e-9):
        scale = np.abs(q_ddot[:, column]).max()
        assert np.abs(moved - q_ddot)[:, column].max() < 1e-5 * scale


@geometry
def test_motion_ratio_is_the_slope_of_the_rise(eam: Eam) -> None:
    strokes = np.linspace(1.0, 99.0, 60)
    slope = (eam.pose(strokes + 1e-3).rise_mm - eam.pose(strokes - 1e-3).rise_mm) / 2e-3
    np.testing.assert_allclose(eam.pose(strokes).motion_ratio, slope, rtol=1e-7)


@geometry
def test_newton_needs_at_most_five_iterations_from_a_badly_disturbed_start(eam: Eam) -> None:
    rng = np.random.default_rng(4)
    strokes = np.linspace(0.0, 100.0, 400)
    q = eam.assemble(strokes)
    noise = rng.uniform(-1.0, 1.0, q.shape) * np.tile([10.0, 10.0, 0.1], 5)
    right = 0
    for row in range(len(strokes)):
        solved, iterations = eam._newton(strokes[row : row + 1], eam._scaled((q + noise)[row : row + 1]))
        assert iterations <= 5
        right += bool(np.abs(eam._in_mm(solved) - q[row]).max() < 1e-8)
    assert right >= 0.97 * len(strokes)


def test_scaled_jacobian_is_well_conditioned() -> None:
    q = TIGER.assemble(np.linspace(0.0, 70.0, 71))
    assert np.linalg.cond(TIGER._jacobian(TIGER._scaled(q))).max() < 100.0


# ---- what is refused


@pytest.mark.parametrize("stroke", [-0.1, 70.1, 1e9, float("nan"), float("inf")])
def test_a_stroke_outside_the_range_is_refused_by_name_value_and_limit(stroke: float) -> None:
    with pytest.raises(MechanismError, match=r"stroke .* mm is outside 0\.\.70 mm"):
        TIGER.pose([10.0, stroke])


def test_the_ends_of_the_stroke_are_inside_despite_rounding() -> None:
    assert float(TIGER.pose(-1e-12).rise_mm) == pytest.approx(0.0, abs=1e-9)
    assert float(TIGER.pose(70.0 + 1e-12).stroke_mm) == 70.0


def test_a_start_in_the_other_assembly_is_refused() -> None:
    other = TIGER.assemble([35.0])
    # Mirror the damper-arm triangle about the line from P3 to P8: it closes too, and hangs the other way.
    mirror = np.arctan2(other[0, 7] - other[0, 1], other[0, 6] - other[0, 0])
    for angle in (8, 11):
        other[0, angle] = 2.0 * mirror - other[0, angle]
    other[0, 11] += 2.0 * np.arctan2(18.0, 133.8) * -1.0
    other[0, 12] = TIGER.mechanism.arm_length_mm * np.cos(other[0, 11]) + 100.0
    with pytest.raises(MechanismError, match="assembly"):
        TIGER.assemble([35.0], other)


def test_a_start_far_away_never_gives_a_wrong_answer() -> None:
    rng = np.random.default_rng(1)
    right = TIGER.assemble([35.0])
    outcomes = {"right": 0, "refused": 0}
    for _ in range(200):
        guess = right + rng.uniform(-1.0, 1.0, right.shape) * np.tile([300.0, 300.0, 3.0], 5)
        try:
            found = TIGER.assemble([35.0], guess)
        except MechanismError:
            outcomes["refused"] += 1
            continue
        turns = np.round((found - right)[0, 2::3] / (2.0 * np.pi))
        found[0, 2::3] -= 2.0 * np.pi * turns
        np.testing.assert_allclose(found, right, atol=1e-8)
        outcomes["right"] += 1
    assert min(outcomes.values()) > 10


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("damper_length_mm", 900.0, "does not reach"),
        ("rocker_actuator_arm_mm", 5.0, "no assembly|dead point|stands at"),
        ("arm_angle_at_zero_stroke_rad", -0.6, "correct it or the points"),
    ],
)
def test_points_that_make_no_mechanism_are_refused(key: str, value: float, said: str) -> None:
    with pytest.raises(MechanismError, match=said):
        build(mechanism("tiger").model_copy(update={key: value}))


def test_a_stroke_past_the_dead_point_is_refused() -> None:
    with pytest.raises(MechanismError, match=r"assembly|rise"):
        build(mechanism("tiger"), stroke_max_mm=160.0)


def test_a_vehicle_without_a_mechanism_is_refused() -> None:
    with pytest.raises(MechanismError, match=r"\[eam\]"):
        Eam.from_vehicle(load_vehicle("table-6-1"))


# ---- inverse and interpolant


@geometry
@given(stroke=st.floats(0.0, 100.0))
@settings(max_examples=50, deadline=None)
def test_rise_and_stroke_are_inverse_to_each_other(eam: Eam, stroke: float) -> None:
    assert float(eam.stroke_for_rise(eam.pose(stroke).rise_mm)) == pytest.approx(stroke, abs=1e-7)


def test_a_rise_no_stroke_gives_is_refused() -> None:
    with pytest.raises(MechanismError, match=r"rise 139 mm is outside 0\.\.138\.61"):
        TIGER.stroke_for_rise([20.0, 139.0])


@geometry
def test_the_interpolant_stays_within_a_micrometre(eam: Eam) -> None:
    curve, strokes = eam.curve(), np.linspace(0.0, 100.0, 5003)
    pose = eam.pose(strokes)
    assert np.abs(curve.rise_mm(strokes) - pose.rise_mm).max() < 1e-3
    assert np.abs(curve.motion_ratio(strokes) - pose.motion_ratio).max() < 1e-3


@given(st.floats(-50.0, 150.0))
def test_the_scalar_interpolant_is_the_vector_one(stroke: float) -> None:
    rise, ratio = CURVE.at(stroke)
    assert rise == pytest.approx(float(CURVE.rise_mm(stroke)), abs=1e-9)
    assert ratio == pytest.approx(float(CURVE.motion_ratio(stroke)), abs=1e-9)


@given(st.floats(0.0, 70.0))
def test_the_interpolant_inverts(stroke: float) -> None:
    assert float(CURVE.stroke_mm(CURVE.rise_mm(stroke))) == pytest.approx(stroke, abs=1e-9)


def test_the_interpolant_holds_its_ends() -> None:
    assert CURVE.at(-3.0) == CURVE.at(0.0)
    assert CURVE.at(73.0) == CURVE.at(70.0)
    assert float(CURVE.stroke_mm(1000.0)) == pytest.approx(70.0, abs=1e-9)


CURVE = TIGER.curve()
