"""The emulated robot's world: physics against closed forms and an independent integrator, sensors, seed."""

from __future__ import annotations

import time
from math import cos, degrees, radians, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from tiger.config.vehicle import load_vehicle
from tiger.emulation.scenarios import PlateSegment, Scenario, load_scenario
from tiger.emulation.world import World
from tiger.models.eam import Eam, MechanismError
from tiger.models.full_car import GRAVITY_MPS2, LIFT, LIFT_RATE, ROAD, FullCarParameters, full_car
from tiger.models.sensors.potentiometer import Potentiometer

TIGER = load_vehicle("tiger")
REST = (0.0, 0.0, 0.0, 0.0)
MS = 0.001


def scenario(
    *plate: PlateSegment, noise: bool = False, stroke_mm: tuple[float, ...] | None = None
) -> Scenario:
    return Scenario.model_validate(
        {
            "title": "test",
            "duration_s": 100.0,
            "plate": plate,
            "sensor_noise": noise,
            "model": "linear",
            "initial_stroke_mm": stroke_mm,
        }
    )


def ramp(axis: str, to_deg: float, at_s: float = 0.0, over_s: float = 0.1) -> PlateSegment:
    return PlateSegment.model_validate({"axis": axis, "at_s": at_s, "to_deg": to_deg, "over_s": over_s})


def run(world: World, seconds: float, duty: tuple[float, ...] = REST, rpm: tuple[float, ...] = REST) -> World:
    for _ in range(round(seconds / MS)):
        world.step(MS, duty, rpm)
    return world


# ---- the body


def test_at_rest_nothing_moves_for_ten_seconds() -> None:
    world = run(World(TIGER, scenario()), 10.0)
    truth = world.truth()
    assert max(abs(truth.roll_deg), abs(truth.pitch_deg), abs(truth.heave_m)) < 1e-12
    assert truth.stroke_mm == (35.0, 35.0, 35.0, 35.0)
    assert truth.time_s == pytest.approx(10.0, abs=1e-12)


@pytest.mark.parametrize("axis", ["roll", "pitch"])
def test_body_takes_the_tilt_of_the_plate_when_nothing_acts(axis: str) -> None:
    truth = run(World(TIGER, scenario(ramp(axis, 5.0))), 12.0).truth()
    assert (truth.roll_deg, truth.pitch_deg) == pytest.approx(
        (5.0, 0.0) if axis == "roll" else (0.0, 5.0), abs=1e-4
    )


def test_world_starts_settled_on_a_plate_already_tilted() -> None:
    tilted = PlateSegment(axis="pitch", at_s=0.0, amplitude_deg=3.0, frequency_hz=1e-9, phase_deg=90.0)
    world = World(TIGER, scenario(tilted))
    assert world.pitch_deg == pytest.approx(3.0, abs=1e-9)
    assert run(world, 2.0).pitch_deg == pytest.approx(3.0, abs=1e-5)


def test_uneven_strokes_tilt_the_body_as_the_mechanism_lifts() -> None:
    strokes = (45.0, 25.0, 45.0, 25.0)
    rise = Eam.from_vehicle(TIGER).pose(np.array(strokes)).rise_mm
    world = World(TIGER, scenario(stroke_mm=strokes))
    expected = degrees((rise[0] - rise[1]) * 1e-3 / (2.0 * TIGER.body.half_track_m))
    assert world.roll_deg == pytest.approx(expected, abs=1e-6)  # the interpolant's micrometre
    assert run(world, 3.0).roll_deg == pytest.approx(world.roll_deg, abs=1e-9)


def test_all_strokes_up_raise_the_body_level() -> None:
    world = run(World(TIGER, scenario()), 8.0, duty=(1.0,) * 4)
    eam = Eam.from_vehicle(TIGER)
    raised = float(eam.pose(70.0).rise_mm - eam.pose(35.0).rise_mm) * 1e-3
    truth = world.truth()
    assert truth.heave_m == pytest.approx(raised, abs=1e-5)
    assert truth.ride_height_m == pytest.approx(TIGER.body.com_height_m + raised, abs=1e-5)
    assert (truth.roll_deg, truth.pitch_deg) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_motion_equals_an_independent_integration_of_the_seven_dof_model() -> None:
    world = World(TIGER, scenario(ramp("roll", 4.0, over_s=0.3), ramp("pitch", -2.0, at_s=0.1, over_s=0.2)))
    duty = (1.0, -0.5, 0.25, 0.0)
    times, rolls, pitches = [], [], []
    for _ in range(1500):
        world.step(MS, duty, REST)
        times.append(world.time_s)
        rolls.append(radians(world.roll_deg))
        pitches.append(radians(world.pitch_deg))

    parameters = FullCarParameters.from_config(TIGER)
    model = full_car(parameters).select(inputs=(*ROAD, *LIFT, *LIFT_RATE))
    curve, lag = Eam.from_vehicle(TIGER).curve(), 0.05

    def cosine_ramp(t: float, at: float, to: float, over: float) -> float:
        return radians(to) * 0.5 * (1.0 - cos(np.pi * min(max((t - at) / over, 0.0), 1.0)))

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        # The world's lag holds the duty over a step and moves by the rate at its end: half a step early.
        shifted = t + 0.5 * MS
        rate = 9.4 * np.array(duty) * (1.0 - np.exp(-shifted / lag))
        stroke = 35.0 + 9.4 * np.array(duty) * (shifted - lag * (1.0 - np.exp(-shifted / lag)))
        lift = (curve.rise_mm(stroke) - curve.at(35.0)[0]) * 1e-3
        lift_rate = curve.motion_ratio(stroke) * rate * 1e-3
        tilt = np.array([0.0, cosine_ramp(t, 0.1, -2.0, 0.2), cosine_ramp(t, 0.0, 4.0, 0.3)])
        road = parameters.corner_kinematics() @ tilt
        return model.a @ state + model.b @ np.concatenate([road, lift, lift_rate])

    answer = solve_ivp(slope, (0.0, 1.5), np.zeros(14), t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.005)
    assert np.abs(answer.y[4] - rolls).max() < radians(0.002)
    assert np.abs(answer.y[2] - pitches).max() < radians(0.002)


@pytest.mark.parametrize("dt_s", [0.00025, 0.0005, 0.002, 0.005])
def test_the_step_length_hardly_matters(dt_s: float) -> None:
    plate = ramp("roll", 5.0, over_s=0.3)
    fine, other = World(TIGER, scenario(plate)), World(TIGER, scenario(plate))
    run(fine, 0.5)
    for _ in range(round(0.5 / dt_s)):
        other.step(dt_s, REST, REST)
    assert other.time_us == fine.time_us
    assert other.roll_deg == pytest.approx(fine.roll_deg, abs=2e-3)


def test_a_step_of_no_whole_number_of_microseconds_is_refused() -> None:
    for dt_s in (0.0, -0.001, 1.5e-6):
        with pytest.raises(ValueError, match="positive whole number of microseconds"):
            World(TIGER, scenario()).step(dt_s, REST, REST)


def test_left_and_right_are_mirror_images() -> None:
    left = run(World(TIGER, scenario(ramp("roll", 3.0))), 1.0, duty=(0.5, -0.2, 0.1, 0.0))
    right = run(World(TIGER, scenario(ramp("roll", -3.0))), 1.0, duty=(-0.2, 0.5, 0.0, 0.1))
    assert left.roll_deg == pytest.approx(-right.roll_deg, abs=1e-12)
    assert left.pitch_deg == pytest.approx(right.pitch_deg, abs=1e-12)


# ---- the actuators


def test_actuator_runs_at_9_4_mm_per_s_after_a_50_ms_lag() -> None:
    world = run(World(TIGER, scenario()), 1.0, duty=(1.0, -1.0, 0.5, 0.0))
    travel = 9.4 * (1.0 - 0.05)  # the lag costs its own length once
    expected = (35.0 + travel, 35.0 - travel, 35.0 + travel / 2.0, 35.0)
    assert world.stroke_mm == pytest.approx(expected, abs=0.01)
    assert world.truth().stroke_rate_mmps == pytest.approx((9.4, -9.4, 4.7, 0.0), abs=1e-6)


def test_five_degrees_of_roll_take_the_rate_bound() -> None:
    # Left down, right up at 9.4 mm/s from mid-stroke: when the two sides differ by what 4.5 degrees take.
    curve, needed_mm = Eam.from_vehicle(TIGER).curve(), 2000.0 * TIGER.body.half_track_m * radians(4.5)
    bound_s = brentq(lambda t: curve.at(35 + 9.4 * t)[0] - curve.at(35 - 9.4 * t)[0] - needed_mm, 0.1, 3.7)
    world = World(TIGER, scenario(ramp("roll", 5.0)))
    run(world, 3.0)
    started = world.time_s
    while world.roll_deg > 0.5:
        world.step(MS, (-1.0, 1.0, -1.0, 1.0), REST)
    assert world.time_s - started == pytest.approx(bound_s + 0.05, abs=0.02)


def test_duty_beyond_one_is_no_faster() -> None:
    full, over = World(TIGER, scenario()), World(TIGER, scenario())
    assert run(full, 0.5, duty=(1.0,) * 4).stroke_mm == run(over, 0.5, duty=(7.0,) * 4).stroke_mm


def test_actuator_locks_without_duty() -> None:
    world = run(World(TIGER, scenario(ramp("roll", 10.0))), 0.3, duty=(1.0, 0.0, 0.0, -1.0))
    run(world, 2.0)
    held = world.stroke_mm
    run(world, 5.0)
    assert world.stroke_mm == held


def test_actuator_stops_at_both_ends_and_presses_its_switches() -> None:
    world = World(TIGER, scenario())
    assert world.lower_switches == world.upper_switches == (False,) * 4
    run(world, 5.0, duty=(1.0, -1.0, 0.0, 0.0))
    assert world.stroke_mm[:2] == (70.0, 0.0)
    assert world.upper_switches == (True, False, False, False)
    assert world.lower_switches == (False, True, False, False)
    assert world.truth().stroke_rate_mmps[:2] == (0.0, 0.0)
    run(world, 0.5, duty=(-1.0, 1.0, 0.0, 0.0))
    assert world.lower_switches == world.upper_switches == (False,) * 4


def test_actuator_carries_its_share_of_the_body_through_the_motion_ratio() -> None:
    world = World(TIGER, scenario())
    ratio = Eam.from_vehicle(TIGER).curve().at(35.0)[1]
    expected = TIGER.body.mass_kg * GRAVITY_MPS2 / 4.0 * ratio
    assert world.truth().actuator_force_n == pytest.approx((expected,) * 4, rel=1e-9)


def test_strokes_against_each_other_share_the_load_as_springs_and_tyres_in_series_do() -> None:
    strokes = (45.0, 25.0, 25.0, 45.0)  # across the diagonal: the body nearly stays, the corners fight
    curve, world = Eam.from_vehicle(TIGER).curve(), World(TIGER, scenario(stroke_mm=strokes))
    lifts = np.array([curve.at(stroke)[0] for stroke in strokes]) * 1e-3
    warp = lifts @ [1.0, -1.0, -1.0, 1.0] / 4.0  # the rest is heave, which costs nothing
    spring, tire = TIGER.front.spring_npm, TIGER.tire.vertical_stiffness_npm
    change = warp * spring * tire / (spring + tire) * np.array([1.0, -1.0, -1.0, 1.0])
    load = TIGER.body.mass_kg * GRAVITY_MPS2 / 4.0 + change
    expected = load * [curve.at(stroke)[1] for stroke in strokes]
    assert world.truth().actuator_force_n == pytest.approx(expected, rel=1e-9)
    assert run(world, 0.5).truth().actuator_force_n == pytest.approx(expected, rel=1e-9)


def test_actuator_cannot_push_beyond_its_force_but_can_let_go() -> None:
    actuator = TIGER.actuator.model_copy(update={"max_force_n": 150.0})  # the body alone takes 200
    weak = TIGER.model_copy(update={"actuator": actuator})
    assert run(World(weak, scenario()), 1.0, duty=(1.0,) * 4).stroke_mm == (35.0,) * 4
    assert run(World(weak, scenario()), 1.0, duty=(-1.0,) * 4).stroke_mm[0] < 27.0


# ---- the sensors


def test_imu_at_rest_feels_gravity_along_the_tilted_body() -> None:
    world = run(World(TIGER, scenario(ramp("roll", 5.0), ramp("pitch", 3.0))), 12.0)
    roll, pitch = radians(world.roll_deg), radians(world.pitch_deg)
    expected = GRAVITY_MPS2 * np.array([-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch)])
    reading = world.imu()
    np.testing.assert_allclose(reading.accel_mps2, expected, atol=1e-4)
    np.testing.assert_allclose(reading.gyro_radps, 0.0, atol=1e-6)


def test_imu_feels_the_true_motion_of_the_point_where_it_sits() -> None:
    offset = np.array([0.3, -0.2, 0.4])
    vehicle = TIGER.model_copy(update={"imu_offset_m": tuple(offset)})
    world = World(
        vehicle, scenario(ramp("roll", 30.0, over_s=0.3), ramp("pitch", -20.0, at_s=0.05, over_s=0.2))
    )
    turns, places, readings = [], [], []
    for _ in range(600):
        world.step(MS, (1.0, 0.5, 0.0, -1.0), REST)
        truth = world.truth()
        turn = Rotation.from_euler("YX", [truth.pitch_deg, truth.roll_deg], degrees=True)
        turns.append(turn)
        places.append(turn.apply(offset) + np.array([0.0, 0.0, truth.heave_m]))
        readings.append(world.imu())
    # Differentiated twice by hand, turned into the body, and through the same first-order low-pass.
    gravity = np.array([0.0, 0.0, GRAVITY_MPS2])
    acceleration = np.gradient(np.gradient(places, MS, axis=0), MS, axis=0) + gravity
    spins = [(a.inv() * b).as_rotvec() / (2 * MS) for a, b in zip(turns, turns[2:], strict=False)]
    felt, turned = gravity.copy(), np.zeros(3)
    for k in range(2, 598):
        felt += (1.0 - np.exp(-2.0 * np.pi * 62.5 * MS)) * (turns[k].inv().apply(acceleration[k]) - felt)
        turned += (1.0 - np.exp(-2.0 * np.pi * 47.0 * MS)) * (spins[k - 1] - turned)
        if k > 30:
            np.testing.assert_allclose(readings[k].accel_mps2, felt, atol=0.05)
            np.testing.assert_allclose(readings[k].gyro_radps, turned, atol=0.005)


def test_imu_reads_right_before_the_first_step() -> None:
    reading = World(TIGER, scenario()).imu()
    np.testing.assert_allclose(reading.accel_mps2, [0.0, 0.0, GRAVITY_MPS2], atol=1e-9)
    np.testing.assert_allclose(reading.mag_ut, [20.0, 0.0, -43.0], atol=1e-9)


def test_gyro_follows_the_rate_of_roll() -> None:
    slow = PlateSegment(axis="roll", at_s=0.0, amplitude_deg=5.0, frequency_hz=0.1)
    world = run(World(TIGER, scenario(slow)), 10.0)
    before = radians(world.roll_deg)
    world.step(MS, REST, REST)
    rate = (radians(world.roll_deg) - before) / MS
    assert world.imu().gyro_radps[0] == pytest.approx(rate, abs=2e-4)


def test_accelerometer_feels_the_heave_of_the_body() -> None:
    world = World(TIGER, scenario())
    felt, heights = [], []
    for _ in range(3000):
        world.step(MS, (1.0, 1.0, 1.0, 1.0), REST)
        felt.append(float(world.imu().accel_mps2[2]) - GRAVITY_MPS2)
        heights.append(world.truth().heave_m)
    speed = np.gradient(heights, MS)
    assert np.cumsum(felt)[::100] * MS == pytest.approx(speed[::100], abs=2e-3)


def test_magnetometer_turns_with_the_body() -> None:
    world = run(World(TIGER, scenario(ramp("roll", 10.0))), 12.0)
    field = world.imu().mag_ut
    assert np.linalg.norm(field) == pytest.approx(np.hypot(20.0, 43.0), abs=1e-6)
    assert degrees(np.arctan2(-field[1], -field[2])) == pytest.approx(10.0, abs=1e-3)


def test_noise_has_the_size_of_the_data_sheet() -> None:
    world = World(TIGER, scenario(noise=True), seed=3)
    samples = [world.imu() for _ in range(4000)]
    accel, gyro = (np.array([getattr(s, name) for s in samples]) for name in ("accel_mps2", "gyro_radps"))
    assert np.abs(accel.mean(axis=0) - [0.0, 0.0, GRAVITY_MPS2]).max() < 0.02 + 0.002
    assert np.abs(gyro.mean(axis=0)).max() < radians(1.0) + 1e-3
    np.testing.assert_allclose(accel.std(axis=0), np.hypot(0.0116, 0.01 / np.sqrt(12.0)), rtol=0.08)
    np.testing.assert_allclose(
        gyro.std(axis=0), np.hypot(radians(0.096), radians(1 / 16) / np.sqrt(12)), rtol=0.08
    )


def test_readings_are_whole_digits_of_the_chip() -> None:
    reading = run(World(TIGER, scenario(noise=True), seed=3), 0.1).imu()
    for values, digit in (
        (reading.accel_mps2, 0.01),
        (reading.gyro_radps, radians(1 / 16)),
        (reading.mag_ut, 1 / 16),
    ):
        digits = np.array(values) / digit
        assert digits == pytest.approx(np.rint(digits), abs=1e-6)


def test_potentiometers_show_the_strokes() -> None:
    world = World(TIGER, scenario(stroke_mm=(0.0, 17.5, 35.0, 70.0)))
    expected = Potentiometer(stroke_max_mm=70.0)
    assert world.potentiometer_volts() == pytest.approx(expected.volts([0.0, 17.5, 35.0, 70.0]))
    assert expected.stroke_mm(world.potentiometer_counts()) == pytest.approx(
        [0.0, 17.5, 35.0, 70.0], abs=0.06
    )


def test_wheels_follow_their_commands_and_turn_their_gears() -> None:
    world = run(World(TIGER, scenario()), 3.0, rpm=(60.0, -60.0, 120.0, 0.0))
    assert world.wheel_speed_rpm == pytest.approx((60.0, -60.0, 120.0, 0.0), abs=1e-3)
    before = world.tooth_phase
    run(world, 1.0, rpm=(60.0, -60.0, 120.0, 0.0))
    passed = [b - a for a, b in zip(before, world.tooth_phase, strict=True)]
    assert passed == pytest.approx([60.0, -60.0, 120.0, 0.0], abs=0.01)


def test_a_wheel_accelerates_no_faster_than_its_motor_can() -> None:
    world = run(World(TIGER, scenario()), 0.01, rpm=(800.0, 0.0, 0.0, 0.0))
    assert TIGER.drive is not None
    limit_rpm = TIGER.drive.max_torque_nm / TIGER.tire.spin_inertia_kgm2 * 0.01 * 30.0 / np.pi
    assert world.wheel_speed_rpm[0] == pytest.approx(limit_rpm, rel=1e-9)
    assert world.tooth_phase[0] == pytest.approx(0.5 * limit_rpm / 60.0 * 0.01 * 60.0, rel=1e-9)
    assert world.motor_current_a()[0] > 50.0


def test_motor_current_of_a_wheel_at_rest_is_zero() -> None:
    assert World(TIGER, scenario()).motor_current_a().tolist() == [0.0] * 4


# ---- the seed, errors, cost


def everything(world: World) -> list[float]:
    reading = world.imu()
    parts = (
        reading.accel_mps2,
        reading.gyro_radps,
        reading.mag_ut,
        world.potentiometer_volts(),
        world.tooth_phase,
        world.motor_current_a(),
    )
    return [float(value) for part in parts for value in part]


@given(st.integers(0, 2**32), st.integers(0, 2**32))
@settings(max_examples=5, deadline=None)
def test_one_seed_one_world(seed: int, other: int) -> None:
    def lived(seed: int) -> list[float]:
        world = World(TIGER, load_scenario("shaking-plate"), seed)
        run(world, 0.05, duty=(1.0, -1.0, 0.5, 0.0), rpm=(100.0, 200.0, -100.0, 0.0))
        return everything(world)

    assert lived(seed) == lived(seed)
    if seed != other:
        assert lived(seed) != lived(other)


def test_reading_one_sensor_does_not_disturb_another() -> None:
    quiet, busy = World(TIGER, scenario(noise=True), 5), World(TIGER, scenario(noise=True), 5)
    for _ in range(100):
        busy.potentiometer_volts()
        busy.motor_current_a()
    assert quiet.imu().accel_mps2 == busy.imu().accel_mps2


def test_a_stroke_beyond_the_actuator_is_refused_by_corner() -> None:
    with pytest.raises(MechanismError, match=r"initial_stroke_mm of RL = 80 is outside 0\.\.70"):
        World(TIGER, scenario(stroke_mm=(0.0, 0.0, 80.0, 0.0)))


def test_a_car_without_mechanism_is_refused() -> None:
    with pytest.raises(MechanismError, match=r"\[eam\]"):
        World(load_vehicle("table-6-1"), scenario())


def test_a_millisecond_of_the_world_costs_no_more_than_adding_two_thousand_numbers() -> None:
    # 10 us where the adding takes 28, whatever else the machine is doing: a minute of the world in a second.
    world = World(TIGER, load_scenario("shaking-plate"))
    ratios = []
    for _ in range(5):
        start = time.process_time()
        run(world, 0.5, duty=(0.1, -0.1, 0.1, -0.1), rpm=(10.0, 10.0, 10.0, 10.0))
        middle = time.process_time()
        for _ in range(500):
            sum(range(2000))
        ratios.append((middle - start) / (time.process_time() - middle))
    assert min(ratios) < 1.0
