"""The 14-DOF vehicle: rest, rolling, energy, convergence, symmetry, the 7-DOF model in the small, its API."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.tire import load_tire_set
from tiger.config.vehicle import VehicleConfig, load_vehicle
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters, full_car
from tiger.models.road import iso_road
from tiger.models.terrain import Terrain
from tiger.models.tire import Tire
from tiger.models.vehicle import Inputs, Vehicle, euler_from_quaternion, simulate_many

CAR = load_vehicle("table-5-1")
TIGER = load_vehicle("tiger")
IDLE = Inputs()

MIRROR_STATE = np.concatenate(
    [
        [1, -1, 1],  # position
        [1, -1, 1, -1],  # attitude: roll and yaw turn round
        [1, -1, 1],  # velocity
        [-1, 1, -1],  # rates
        np.ones(12),
        np.ones(4),
        -np.ones(4),  # slip angles
    ]
)
LEFT_RIGHT = [1, 0, 3, 2]


def with_sections(config: VehicleConfig, **sections: dict[str, float]) -> VehicleConfig:
    """Return `config` with keys of sections replaced."""
    update = {name: getattr(config, name).model_copy(update=keys) for name, keys in sections.items()}
    return config.model_copy(update=update)


LIKELY_CAR = with_sections(CAR, body={"pitch_inertia_kgm2": 2607.0, "yaw_inertia_kgm2": 2674.4})
LOSSLESS_CAR = with_sections(
    CAR,
    front={"damper_nspm": 0.0},
    rear={"damper_nspm": 0.0},
    tire={"friction": 1e-9, "rolling_resistance": 0.0},
)


def mirrored(state: np.ndarray) -> np.ndarray:
    image = state * MIRROR_STATE
    for first in (13, 17, 21, 25, 29):
        image[first : first + 4] = image[first : first + 4][LEFT_RIGHT]
    return image


# ---- rest and rolling ------------


@pytest.mark.parametrize("config", [CAR, LIKELY_CAR, TIGER], ids=["car", "likely car", "tiger"])
def test_vehicle_at_rest_does_not_drift_in_ten_seconds(config: VehicleConfig) -> None:
    vehicle = Vehicle(config)
    start = vehicle.at_rest(3.0, -2.0, 0.7)
    assert np.abs(vehicle.step(start.copy(), IDLE, 1e-3, 10_000) - start).max() < 1e-6


def test_tyres_carry_the_weight_by_the_lever_rule() -> None:
    config = load_vehicle("table-6-1")
    vehicle = Vehicle(config)
    loads = vehicle.sense(vehicle.at_rest(), IDLE).wheel_load_n
    b, wheelbase = config.body.com_to_rear_axle_m, config.body.wheelbase_m
    front = (2160.0 * b / wheelbase / 2 + 85.0) * GRAVITY_MPS2
    rear = (2160.0 * (1 - b / wheelbase) / 2 + 60.0) * GRAVITY_MPS2
    np.testing.assert_allclose(loads, [front, front, rear, rear], rtol=1e-9)


def test_coasting_stops_without_chatter() -> None:
    vehicle = Vehicle(CAR)
    history = vehicle.simulate(vehicle.rolling(1.0), IDLE, 15.0)
    speed = history.velocity_mps[:, 0]
    moving = (history.time_s > 0.5) & (history.time_s < 5.5)
    slowing = np.polyfit(history.time_s[moving], speed[moving], 1)[0]
    assert slowing == pytest.approx(-0.1432, rel=1e-3)
    assert speed.min() > -1e-3
    assert np.abs(history.states[-2000:, 7:13]).max() < 1e-3
    spins = np.diff(np.sign(np.round(history.states[-5000:, 21], 4)))
    assert np.count_nonzero(spins) <= 4


@pytest.mark.parametrize("speed", [-3.0, 3.0])
def test_coasting_backwards_is_coasting_forwards(speed: float) -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.step(vehicle.rolling(speed), IDLE, 1e-3, 2000)
    assert abs(state[7]) == pytest.approx(3.0 - 2 * 0.1432, abs=1e-3)
    assert np.sign(state[7]) == np.sign(speed)


def test_reversing_sideways_slip_is_opposed_too() -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.rolling(-8.0)
    state[8] = 1.0
    later = vehicle.step(state.copy(), IDLE, 1e-3, 500)
    assert abs(later[8]) < 0.3


def test_locked_wheels_hold_the_robot_on_a_slope() -> None:
    vehicle = Vehicle(TIGER, Terrain.slope(15.0, 5.0))
    state = vehicle.settle(vehicle.at_rest())
    assert np.abs(state[7:13]).max() < 1e-6
    roll, pitch, _ = euler_from_quaternion(state[3:7])
    assert np.degrees(pitch) == pytest.approx(-15.0, abs=1.0)
    assert np.degrees(roll) == pytest.approx(5.0, abs=1.0)


def test_dropped_vehicle_lands_and_settles() -> None:
    vehicle = Vehicle(TIGER)
    state = vehicle.at_rest()
    state[2] += 0.2
    state = vehicle.step(state, IDLE, 1e-3, 8000)
    np.testing.assert_allclose(state[2], vehicle.at_rest()[2], atol=1e-4)


# ---- energy and step size ------------


def energy_drift(state: np.ndarray, vehicle: Vehicle, dt: float) -> float:
    start, state = vehicle.energy(state), state.copy()
    drift = 0.0
    for _ in range(200):
        vehicle.step(state, IDLE, dt, round(0.01 / dt))
        drift = max(drift, abs(vehicle.energy(state) - start))
    return drift


def test_energy_of_a_lossless_swing_is_kept() -> None:
    vehicle = Vehicle(LOSSLESS_CAR)
    state = vehicle.at_rest()
    state[2] += 0.005
    state[10:13] = [0.05, 0.02, 0.3]
    swing = 1410.0 * GRAVITY_MPS2 * 0.005
    coarse, fine = (energy_drift(state, vehicle, dt) for dt in (1e-3, 5e-4))
    assert coarse < 1e-5 * swing
    assert fine < coarse / 2.0


def test_energy_is_kept_through_lift_off_and_tumbling() -> None:
    vehicle = Vehicle(LOSSLESS_CAR)
    swing = 1410.0 * GRAVITY_MPS2 * 0.15
    rng = np.random.default_rng(7)
    drifts = []
    for _ in range(4):
        state = vehicle.at_rest()
        state[2] += 0.15
        state[7:10] = rng.normal(0.0, 2.0, 3)
        state[10:13] = rng.normal(0.0, 0.6, 3)
        state[21:25] = rng.normal(0.0, 30.0, 4)
        drifts.append([energy_drift(state, vehicle, dt) for dt in (1e-3, 5e-4)])
    coarse, fine = np.sqrt(np.mean(np.square(drifts), axis=0))
    assert np.max(drifts) < 1e-3 * swing
    assert fine < coarse / 2.0


def test_one_millisecond_is_fine_enough_for_the_double_bump() -> None:
    ground = Terrain().with_bump(0.2, 10.0, 10.0, right_m=0.0).with_bump(0.2, 20.0, 10.0, right_m=0.0)
    vehicle = Vehicle(LIKELY_CAR, ground)
    coarse, fine = (
        vehicle.simulate(vehicle.rolling(60 / 3.6), IDLE, 3.0, dt, round(1e-3 / dt)) for dt in (1e-3, 1.25e-4)
    )
    assert np.degrees(np.abs(coarse.attitude_rad - fine.attitude_rad)).max() < 1e-3
    assert np.abs(coarse.position_m - fine.position_m).max() < 1e-3


# ---- agreement with the linear models ------------


def oscillations(poles: np.ndarray) -> np.ndarray:
    """Upper half-plane poles by magnitude."""
    above = poles[poles.imag > 1.0]
    return above[np.argsort(np.abs(above))]


def test_small_motion_has_the_seven_modes_of_the_linear_car() -> None:
    config = with_sections(LIKELY_CAR, tire={"friction": 1e-9, "rolling_resistance": 0.0})
    vehicle, step = Vehicle(config), 1e-6
    rest = vehicle.at_rest()
    jacobian = np.empty((33, 33))
    for k, unit in enumerate(np.eye(33) * step):
        jacobian[:, k] = (vehicle.rate(rest + unit, IDLE) - vehicle.rate(rest - unit, IDLE)) / (2 * step)
    found = oscillations(np.linalg.eigvals(jacobian))
    linear = oscillations(full_car(FullCarParameters.from_config(config)).poles())
    pitch, heave, roll, warp, heave_hop, pitch_hop, roll_hop = range(7)
    for mode in (heave, heave_hop):
        assert found[mode] == pytest.approx(linear[mode], rel=1e-4)
    for mode in (warp, pitch_hop, roll_hop):
        assert abs(found[mode]) == pytest.approx(abs(linear[mode]), rel=2e-3)
    # Gravity on the leaning body softens pitch and roll; eqs. 4.6-4.8 leave it out.
    assert abs(found[pitch]) == pytest.approx(abs(linear[pitch]), rel=0.02)
    assert abs(linear[roll]) == pytest.approx(8.62, abs=0.01)
    assert abs(found[roll]) == pytest.approx(8.35, abs=0.01)


def test_100_newton_at_each_corner_lift_the_body_by_5_mm() -> None:
    vehicle, inputs = Vehicle(LIKELY_CAR), Inputs()
    inputs.actuator_force_n[:] = 100.0
    state = vehicle.step(vehicle.at_rest(), inputs, 1e-3, 10_000)
    assert state[2] - vehicle.at_rest()[2] == pytest.approx(5.000e-3, rel=1e-6)


def test_spring_seats_that_rise_by_5_mm_lift_the_body_by_5_mm() -> None:
    vehicle, inputs = Vehicle(LIKELY_CAR), Inputs()
    inputs.lift_m[:] = 5e-3
    state = vehicle.step(vehicle.at_rest(), inputs, 1e-3, 10_000)
    assert state[2] - vehicle.at_rest()[2] == pytest.approx(5.000e-3, rel=1e-6)


def test_lift_goes_on_at_its_rate_within_a_step() -> None:
    vehicle = Vehicle(TIGER)
    whole, parts = Inputs(), Inputs()
    whole.lift_rate_mps[:] = parts.lift_rate_mps[:] = 0.02
    one = vehicle.step(vehicle.at_rest(), whole, 1e-3, 100)
    many = vehicle.at_rest()
    for k in range(100):
        parts.lift_m[:] = k * 1e-3 * 0.02
        vehicle.step(many, parts, 1e-3)
    np.testing.assert_allclose(one, many, atol=1e-12)


# ---- symmetry, bounds, finiteness ------------

small = st.floats(-1.0, 1.0)
vectors = st.lists(small, min_size=26, max_size=26)


def any_state(vehicle: Vehicle, numbers: list[float], speed: float) -> np.ndarray:
    """A state far from rest: tilted by up to 30 degrees or so, moving, slipping, bouncing."""
    n = np.array(numbers)
    state = vehicle.rolling(speed)
    state[:3] += [5.0 * n[0], 5.0 * n[1], 0.2 * n[2]]
    state[3:7] += [0.0, 0.3 * n[3], 0.3 * n[4], n[5]]
    state[3:7] /= np.linalg.norm(state[3:7])
    state[8:10] = 5.0 * n[6:8]
    state[10:13] = 3.0 * n[8:11]
    state[13:17] = 0.05 * n[11:15]
    state[17:21] = np.roll(n, 3)[:4]
    state[21:25] += 50.0 * n[15:19]
    state[25:29] = n[19:23]
    state[29:33] = n[22:26]
    return state


@settings(deadline=None)
@given(vectors, st.floats(-20.0, 20.0), st.sampled_from([CAR, TIGER]))
def test_mirrored_vehicle_moves_as_the_mirror_image(
    numbers: list[float], speed: float, config: VehicleConfig
) -> None:
    vehicle, inputs, image = Vehicle(config), Inputs(), Inputs()
    state = any_state(vehicle, numbers, speed)
    inputs.wheel_torque_nm[:] = 15.0 * np.array(numbers[:4])
    inputs.lift_m[:] = 0.02 * np.array(numbers[4:8])
    inputs.body_force_n[:] = numbers[8:11]
    inputs.body_moment_nm[:] = numbers[11:14]
    image.wheel_torque_nm[:] = inputs.wheel_torque_nm[LEFT_RIGHT]
    image.lift_m[:] = inputs.lift_m[LEFT_RIGHT]
    image.body_force_n[:] = inputs.body_force_n * [1, -1, 1]
    image.body_moment_nm[:] = inputs.body_moment_nm * [-1, 1, -1]
    here, there = vehicle.rate(state, inputs), vehicle.rate(mirrored(state), image)
    np.testing.assert_allclose(there, mirrored(here), rtol=1e-8, atol=1e-8 * np.abs(here).max())


@settings(deadline=None)
@given(vectors, st.floats(-20.0, 20.0), small, small)
def test_motion_does_not_depend_on_place_or_heading(
    numbers: list[float], speed: float, x: float, heading: float
) -> None:
    vehicle = Vehicle(CAR)
    state = any_state(vehicle, numbers, speed)
    moved = state.copy()
    moved[:2] += [10.0 * x, -7.0 * x]
    c, s = np.cos(heading), np.sin(heading)
    w, qx, qy, qz = state[3:7]
    moved[3:7] = [c * w - s * qz, c * qx - s * qy, c * qy + s * qx, c * qz + s * w]
    here, there = vehicle.rate(state, IDLE)[7:], vehicle.rate(moved, IDLE)[7:]
    np.testing.assert_allclose(there, here, rtol=1e-7, atol=1e-7 * np.abs(here).max())


@settings(deadline=None)
@given(vectors, st.floats(-20.0, 20.0))
def test_no_tyre_pulls_and_none_exceeds_its_grip(numbers: list[float], speed: float) -> None:
    vehicle = Vehicle(CAR)
    readings = vehicle.sense(any_state(vehicle, numbers, speed), IDLE)
    assert (readings.wheel_load_n >= 0.0).all()
    tire, sweep = Tire.from_config(load_tire_set(), CAR.tire), np.linspace(0.0, 3.0, 301)
    for load, force in zip(readings.wheel_load_n, readings.wheel_force_n.T, strict=True):
        fx, fy = tire.forces(load, sweep, 0.0)[0], tire.forces(load, 0.0, sweep)[1]
        assert np.hypot(*force) <= 1.01 * max(fx.max(), -fy.min()) + 1e-9


@settings(deadline=None, max_examples=40)
@given(vectors, st.floats(-20.0, 20.0), st.sampled_from([CAR, TIGER]), st.integers(0, 5))
def test_half_a_second_from_any_state_stays_finite(
    numbers: list[float], speed: float, config: VehicleConfig, seed: int
) -> None:
    ground = Terrain.random("F", seed, (20.0, 20.0)).with_plate(0.15, 2.0, ramp_m=0.05, length_m=1.0)
    vehicle, inputs = Vehicle(config, ground), Inputs()
    inputs.wheel_torque_nm[:] = 17.0 * np.array(numbers[:4])
    inputs.actuator_force_n[:] = 500.0 * np.array(numbers[4:8])
    state = vehicle.step(any_state(vehicle, numbers, speed), inputs, 1e-3, 500)
    assert np.isfinite(state).all()


@settings(deadline=None, max_examples=30)
@given(vectors, st.floats(-20.0, 20.0))
def test_isolated_body_keeps_its_momentum(numbers: list[float], speed: float) -> None:
    """In the air the total force is the weight and the angular momentum about the common COM stays."""
    vehicle = Vehicle(TIGER)
    state = any_state(vehicle, numbers, speed)
    state[2] += 5.0

    def momentum(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_quat(np.roll(s[3:7], -1))
        body, axle = TIGER.body, TIGER.front.unsprung_mass_kg
        places = np.column_stack(
            [*vehicle.corners_m, TIGER.tire.rolling_radius_m - body.com_height_m + s[13:17]]
        )
        speeds = s[7:10] + np.cross(s[10:13], places)
        speeds[:, 2] += s[17:21]
        linear = body.mass_kg * s[7:10] + axle * speeds.sum(axis=0)
        inertia = np.array([body.roll_inertia_kgm2, body.pitch_inertia_kgm2, body.yaw_inertia_kgm2])
        angular = inertia * s[10:13] + axle * np.cross(places, speeds).sum(axis=0)
        angular[1] += TIGER.tire.spin_inertia_kgm2 * s[21:25].sum()
        total = body.mass_kg + 4 * axle
        common = axle * places.sum(axis=0) / total
        angular -= np.cross(common, linear)
        return turn.apply(linear), turn.apply(angular)

    inputs = Inputs()
    inputs.wheel_torque_nm[:] = 10.0 * np.array(numbers[:4])
    linear, angular = momentum(state)
    later_linear, later_angular = momentum(vehicle.step(state, inputs, 5e-4, 200))
    weight = (TIGER.body.mass_kg + 4 * TIGER.front.unsprung_mass_kg) * GRAVITY_MPS2
    np.testing.assert_allclose(later_linear - linear, [0, 0, -0.1 * weight], atol=1e-4)
    np.testing.assert_allclose(later_angular, angular, atol=1e-4)


# ---- driving ------------


def test_wheel_torque_drives_and_the_body_squats() -> None:
    vehicle, inputs = Vehicle(LIKELY_CAR), Inputs()
    inputs.wheel_torque_nm[:] = 200.0
    state = vehicle.step(vehicle.rolling(5.0), inputs, 1e-3, 1000)
    effective_mass = 1410.0 + 4 * 1.2 / 0.3509**2
    expected = (800.0 / 0.3509 - 0.015 * 1410.0 * GRAVITY_MPS2) / effective_mass
    assert state[7] - 5.0 == pytest.approx(expected, rel=0.02)
    assert vehicle.sense(state, inputs).attitude_rad[1] < 0.0


def turn_on_the_spot(friction: float) -> np.ndarray:
    vehicle, inputs = Vehicle(with_sections(TIGER, tire={"friction": friction})), Inputs()
    inputs.wheel_speed_radps[:] = [-3.0, 3.0, -3.0, 3.0]
    return vehicle.step(vehicle.at_rest(), inputs, 1e-3, 4000)


def test_wheels_driven_against_each_other_turn_the_robot_on_the_spot() -> None:
    state = turn_on_the_spot(friction=0.4)
    assert 0.2 < state[12] < 3.0 * 0.162 / 0.6
    assert np.hypot(*state[:2]) < 0.05


def test_17_newton_metres_cannot_scrub_the_robot_round_on_full_grip() -> None:
    """4 x 17 Nm make 252 Nm of yaw moment; four gripping tyres resist with up to 390 Nm."""
    state = turn_on_the_spot(friction=1.0)
    assert abs(state[12]) < 1e-6


def test_speed_command_is_reached_and_its_torque_is_limited() -> None:
    vehicle, inputs = Vehicle(TIGER), Inputs()
    inputs.wheel_speed_radps[:] = 10.0
    assert vehicle.sense(vehicle.at_rest(), inputs).wheel_torque_nm == pytest.approx([17.0] * 4)
    state = vehicle.step(vehicle.at_rest(), inputs, 1e-3, 5000)
    np.testing.assert_allclose(vehicle.sense(state, inputs).wheel_speed_radps, 10.0, atol=0.1)
    assert state[7] == pytest.approx(1.62, rel=0.02)


def test_torque_command_is_limited_to_the_motors() -> None:
    vehicle, inputs = Vehicle(TIGER), Inputs()
    inputs.wheel_torque_nm[:] = 100.0
    assert vehicle.sense(vehicle.at_rest(), inputs).wheel_torque_nm == pytest.approx([17.0] * 4)


def test_bump_slows_the_wheel_that_climbs_it() -> None:
    vehicle = Vehicle(LIKELY_CAR, Terrain().with_bump(0.2, 10.0, 10.0))
    history = vehicle.simulate(vehicle.rolling(60 / 3.6), IDLE, 1.0)
    climbing = np.searchsorted(history.position_m[:, 0], 15.0)
    coasted = 60 / 3.6 - 0.1432 * history.time_s[climbing]
    assert history.velocity_mps[climbing, 0] < coasted - 0.02


# ---- the robot's interface ------------


def test_strokes_lift_the_robot_by_the_mechanisms_rise() -> None:
    from tiger.models.eam import Eam

    vehicle, inputs = Vehicle(TIGER), Inputs()
    curve = Eam.from_vehicle(TIGER).curve()
    vehicle.set_strokes(inputs, 45.0)
    state = vehicle.settle(vehicle.at_rest(), 5.0, inputs)
    rise = 1e-3 * float(curve.rise_mm(45.0) - curve.rise_mm(35.0))
    assert state[2] - vehicle.at_rest()[2] == pytest.approx(rise, rel=1e-3)
    vehicle.set_strokes(inputs, 45.0, 9.4)
    np.testing.assert_allclose(inputs.lift_rate_mps, 9.4e-3 * curve.motion_ratio(45.0))


def test_left_strokes_roll_the_robot_left_side_up() -> None:
    vehicle, inputs = Vehicle(TIGER), Inputs()
    vehicle.set_strokes(inputs, [45.0, 25.0, 45.0, 25.0])
    roll = vehicle.sense(vehicle.settle(vehicle.at_rest(), 5.0, inputs), inputs).attitude_rad[0]
    assert np.degrees(roll) == pytest.approx(2.0, abs=0.3)


def test_car_has_no_strokes_to_set() -> None:
    with pytest.raises(ValueError, match="lift_m"):
        Vehicle(CAR).set_strokes(Inputs(), 10.0)


def test_wheels_put_down_on_rough_ground_do_not_hold_against_each_other() -> None:
    road, place_m = iso_road("D", 77), np.arange(0.0, 4.0, 0.05)
    left, right = road.height_m(place_m, 0), road.height_m(place_m, 1)
    vehicle = Vehicle(TIGER, Terrain.from_tracks(left, right, 0.05, TIGER.body.half_track_m))
    forces = vehicle.sense(vehicle.settle(vehicle.at_rest(x_m=1.0)), IDLE).wheel_force_n
    assert np.abs(forces[0] - forces[0].mean()).max() < 0.02 * TIGER.tire.nominal_load_n
    assert np.abs(forces[1]).max() < 0.02 * TIGER.tire.nominal_load_n


def test_accelerometer_at_rest_feels_gravity_in_its_own_axes() -> None:
    vehicle = Vehicle(TIGER, Terrain.slope(10.0))
    readings = vehicle.sense(vehicle.settle(vehicle.at_rest()), IDLE)
    pitch = readings.attitude_rad[1]
    expected = GRAVITY_MPS2 * np.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    np.testing.assert_allclose(readings.specific_force_mps2, expected, atol=1e-3)


def test_accelerometer_off_the_com_feels_the_turn() -> None:
    config = TIGER.model_copy(update={"imu_offset_m": (0.3, 0.0, 0.0)})
    state = Vehicle(config).at_rest()
    state[12] = 2.0
    at_com = Vehicle(TIGER.model_copy(update={"imu_offset_m": (0.0, 0.0, 0.0)})).sense(state, IDLE)
    ahead = Vehicle(config).sense(state, IDLE)
    lever = np.cross(at_com.angular_acceleration_radps2, [0.3, 0, 0]) - np.array([0.3 * 4.0, 0, 0])
    np.testing.assert_allclose(ahead.specific_force_mps2 - at_com.specific_force_mps2, lever, atol=1e-9)


def test_specific_force_is_what_the_velocity_shows() -> None:
    vehicle = Vehicle(with_sections(TIGER), Terrain.random("E", 2, (30.0, 10.0)))
    inputs = Inputs()
    inputs.wheel_speed_radps[:] = [8.0, 9.0, 8.0, 9.0]
    state = vehicle.step(vehicle.at_rest(5.0, 0.0), inputs, 1e-3, 500)
    before = vehicle.step(state.copy(), inputs, 1e-5, 10)
    after = vehicle.step(before.copy(), inputs, 1e-5, 10)
    from scipy.spatial.transform import Rotation

    def imu_velocity(s: np.ndarray) -> np.ndarray:
        turn = Rotation.from_quat(np.roll(s[3:7], -1))
        return turn.apply(s[7:10] + np.cross(s[10:13], TIGER.imu_offset_m))

    middle = vehicle.step(state.copy(), inputs, 1e-5, 15)
    acceleration = (imu_velocity(after) - imu_velocity(before)) / 1e-4
    turn = Rotation.from_quat(np.roll(middle[3:7], -1))
    expected = turn.inv().apply(acceleration + np.array([0.0, 0.0, GRAVITY_MPS2]))
    np.testing.assert_allclose(vehicle.sense(middle, inputs).specific_force_mps2, expected, atol=2e-3)


def test_wheel_speed_is_counted_against_the_carrier() -> None:
    state = Vehicle(TIGER).rolling(1.0)
    state[11] = 0.5
    assert Vehicle(TIGER).sense(state, IDLE).wheel_speed_radps == pytest.approx([1.0 / 0.162 - 0.5] * 4)


def test_euler_angles_follow_the_printed_rotation_matrix() -> None:
    """Eq. 5.2: r31 = -sin(theta), r32 = sin(phi) cos(theta), r21 = cos(theta) sin(psi)."""
    from scipy.spatial.transform import Rotation

    roll, pitch, yaw = 0.3, -0.4, 1.2
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    matrix = turn.as_matrix()
    assert matrix[2, 0] == pytest.approx(-np.sin(pitch))
    assert matrix[2, 1] == pytest.approx(np.sin(roll) * np.cos(pitch))
    assert matrix[1, 0] == pytest.approx(np.cos(pitch) * np.sin(yaw))
    np.testing.assert_allclose(euler_from_quaternion(np.roll(turn.as_quat(), 1)), [roll, pitch, yaw])


def test_history_records_what_stepping_by_hand_gives() -> None:
    vehicle, inputs = Vehicle(CAR, Terrain.random("D", 1, (30.0, 10.0))), Inputs()
    inputs.wheel_torque_nm[:] = 50.0
    history = vehicle.simulate(vehicle.rolling(5.0), inputs, 0.5, 1e-3, 5)
    state = vehicle.rolling(5.0)
    for k in range(100):
        np.testing.assert_array_equal(history.states[k], state)
        np.testing.assert_allclose(
            history.acceleration_mps2[k] + GRAVITY_MPS2 * vehicle_up(state),
            vehicle.sense(state, inputs).specific_force_mps2,
            atol=1e-9,
        )
        vehicle.step(state, inputs, 1e-3, 5)
    np.testing.assert_array_equal(history.states[-1], state)
    np.testing.assert_array_equal(history.time_s, np.arange(101) * 5e-3)


def vehicle_up(state: np.ndarray) -> np.ndarray:
    w, x, y, z = state[3:7]
    return np.array([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)])


def test_simulation_leaves_its_start_alone() -> None:
    vehicle = Vehicle(CAR)
    start = vehicle.rolling(5.0)
    copy = start.copy()
    vehicle.simulate(start, IDLE, 0.1)
    np.testing.assert_array_equal(start, copy)


def test_input_table_of_the_wrong_length_is_refused() -> None:
    vehicle = Vehicle(CAR)
    with pytest.raises(ValueError, match=r"\(100, 34\)"):
        vehicle.simulate(vehicle.at_rest(), np.zeros((99, 34)), 0.1)


def test_many_vehicles_run_as_they_would_alone() -> None:
    vehicles = [Vehicle(with_sections(CAR, body={"mass_kg": mass})) for mass in (1000.0, 1210.0, 1400.0)]
    inputs = Inputs()
    inputs.post_m[0] = 0.02
    starts = [vehicle.rolling(5.0) for vehicle in vehicles]
    together = simulate_many(vehicles, starts, inputs, 0.2)
    for vehicle, start, history in zip(vehicles, starts, together, strict=True):
        np.testing.assert_array_equal(history.states, vehicle.simulate(start, inputs, 0.2).states)
    assert together[0].states[-1, 2] != together[2].states[-1, 2]


def test_rollover_index_is_the_share_of_load_gone_to_one_side() -> None:
    vehicle, inputs = Vehicle(CAR), Inputs()
    inputs.body_moment_nm[0] = 1000.0
    history = vehicle.simulate(vehicle.rolling(10.0), inputs, 5.0)
    arm = 1410.0 * GRAVITY_MPS2 * CAR.body.half_track_m
    assert history.load_transfer[-1] == pytest.approx(-1000.0 / arm, rel=0.08)


def test_interpreted_source_moves_as_the_compiled_one_does() -> None:
    program = (
        "from tiger.config.tire import load_soil; from tiger.config.vehicle import load_vehicle\n"
        "from tiger.models.terrain import Terrain; from tiger.models.vehicle import Inputs, Vehicle\n"
        "ground = Terrain.random('D', 1, (10.0, 6.0)).with_bump(0.1, 0.0, 1.0)\n"
        "for soil in (None, load_soil('dry-sand')):\n"
        "    vehicle, inputs = Vehicle(load_vehicle('tiger'), ground, soil=soil), Inputs()\n"
        "    inputs.wheel_torque_nm[:] = [5.0, 6.0, 5.0, 6.0]\n"
        "    print(repr(vehicle.step(vehicle.rolling(2.0, 0.5), inputs, 1e-3, 25).tolist()))\n"
    )

    def states(**environment: str) -> np.ndarray:
        run = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=True,
        )
        return np.array([json.loads(line) for line in run.stdout.splitlines()])

    np.testing.assert_allclose(
        states(NUMBA_DISABLE_JIT="1"), states(NUMBA_DISABLE_JIT="0"), rtol=1e-9, atol=1e-9
    )


@pytest.mark.proof
@pytest.mark.realtime
def test_one_core_makes_a_hundred_thousand_steps_a_second(
    record_figure: Callable[[str, object, str], None],
) -> None:
    vehicle, inputs = Vehicle(CAR), Inputs()
    inputs.wheel_torque_nm[:] = [20.0, 30.0, 20.0, 30.0]
    vehicle.step(vehicle.rolling(15.0), inputs)
    start = time.process_time()
    vehicle.step(vehicle.rolling(15.0), inputs, 1e-3, 50_000)
    speed = 50_000 / (time.process_time() - start)
    record_figure("14-DOF Runge-Kutta steps per second of one core", speed, ">= 1e5")
    assert speed >= 1e5


def test_a_wheel_on_a_slippery_patch_has_a_share_of_the_grip() -> None:
    """Under full torque the left wheels spin at the patch's friction, the right ones push as ever."""
    vehicle = Vehicle(load_vehicle("tiger"), Terrain().with_slippery(0.1, -5.0, 10.0, right_m=0.0))
    state, inputs = vehicle.at_rest(), Inputs()
    inputs.wheel_torque_nm[:] = 17.0
    vehicle.step(state, inputs, steps=200)
    readings = vehicle.sense(state, inputs)
    push, load = readings.wheel_force_n[0], readings.wheel_load_n
    assert (push[[0, 2]] < 0.11 * load[[0, 2]]).all()
    assert (push[[0, 2]] > 0.04 * load[[0, 2]]).all()  # a tyre that spins is beyond the peak of its grip
    assert push[[1, 3]] == pytest.approx(17.0 / 0.162, rel=0.2)
