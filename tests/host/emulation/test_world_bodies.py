"""Both bodies of the world agree where they must, and the 14-DOF one keeps to closed forms on the ground."""

from __future__ import annotations

from math import cos, degrees, hypot, nan, pi, radians, sin, tan

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.emulation.body import make_body
from tiger.emulation.scenarios import Scenario
from tiger.emulation.world import World
from tiger.models.eam import Eam
from tiger.models.full_car import GRAVITY_MPS2

TIGER = load_vehicle("tiger")
REST = (0.0, 0.0, 0.0, 0.0)
MS = 0.001
BOTH = pytest.mark.parametrize("model", ["linear", "vehicle"])
SPRUNG_N = TIGER.body.mass_kg * GRAVITY_MPS2
WEIGHT_N = SPRUNG_N + 2.0 * (TIGER.front.unsprung_mass_kg + TIGER.rear.unsprung_mass_kg) * GRAVITY_MPS2


def scenario(model: str = "vehicle", **keys: object) -> Scenario:
    return Scenario.model_validate(
        {"title": "test", "duration_s": 100.0, "sensor_noise": False, "model": model, **keys}
    )


def tilt(axis: str, to_deg: float, over_s: float = 0.3) -> dict[str, object]:
    return {"axis": axis, "at_s": 0.0, "to_deg": to_deg, "over_s": over_s}


def world_of(model: str = "vehicle", **keys: object) -> World:
    return World(TIGER, scenario(model, **keys))


def run(world: World, seconds: float, duty: tuple[float, ...] = REST, rpm: tuple[float, ...] = REST) -> World:
    for _ in range(round(seconds / MS)):
        world.step(MS, duty, rpm)
    return world


def lean_deg(slope_deg: float, half_m: float) -> float:
    """How much further than a slope the robot leans, by its weight, which the linear model leaves out.

    The slope's pull acts at the COMs of body and wheels; a contact stays below its wheel's centre, so that
    the lean itself only moves the body beside the wheels.
    """
    spring, tire = TIGER.front.spring_npm, TIGER.tire.vertical_stiffness_npm
    stiffness = 4.0 * half_m**2 / (1.0 / spring + 1.0 / tire)
    height, radius = TIGER.body.com_height_m, TIGER.tire.rolling_radius_m
    pull = SPRUNG_N * height + (WEIGHT_N - SPRUNG_N) * radius
    return slope_deg * pull / (stiffness - SPRUNG_N * (height - radius))


# ---- both


@BOTH
def test_at_rest_nothing_moves(model: str) -> None:
    truth = run(world_of(model), 5.0).truth()
    assert max(abs(truth.roll_deg), abs(truth.pitch_deg), abs(truth.yaw_deg)) < 1e-9
    assert abs(truth.heave_m) < 1e-9
    assert hypot(*truth.position_m[:2]) < 1e-9
    assert truth.wheel_load_n == pytest.approx((WEIGHT_N / 4.0,) * 4, rel=1e-6)


@BOTH
@pytest.mark.parametrize(("axis", "half_m"), [("roll", 0.6), ("pitch", 0.5)])
def test_body_settles_on_a_tilted_plate(model: str, axis: str, half_m: float) -> None:
    truth = run(world_of(model, plate=[tilt(axis, 5.0)]), 12.0).truth()
    angle, other = (truth.roll_deg, truth.pitch_deg) if axis == "roll" else (truth.pitch_deg, truth.roll_deg)
    assert angle == pytest.approx(5.0 + (lean_deg(5.0, half_m) if model == "vehicle" else 0.0), abs=0.02)
    assert other == pytest.approx(0.0, abs=1e-6)
    across = cos(radians(5.0)) if model == "vehicle" else 1.0  # the slope carries the rest along itself
    assert sum(truth.wheel_load_n) == pytest.approx(WEIGHT_N * across, rel=2e-4)


@BOTH
def test_a_level_body_stays_level_when_all_strokes_rise(model: str) -> None:
    world = run(world_of(model), 8.0, duty=(1.0,) * 4)
    eam = Eam.from_vehicle(TIGER)
    raised = float(eam.pose(70.0).rise_mm - eam.pose(35.0).rise_mm) * 1e-3
    truth = world.truth()
    assert truth.heave_m == pytest.approx(raised, abs=1e-5)
    assert (truth.roll_deg, truth.pitch_deg) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_response_to_strokes_is_the_same_but_for_the_weights_lever() -> None:
    # Front up, rear down: pitch, where the lever is smallest. Both bodies at every tenth of a second.
    worlds = [world_of(model) for model in ("linear", "vehicle")]
    for _ in range(30):
        for world in worlds:
            run(world, 0.1, duty=(0.5, 0.5, -0.5, -0.5))
        linear, vehicle = (world.truth() for world in worlds)
        assert linear.stroke_mm == pytest.approx(vehicle.stroke_mm, abs=1e-9)
        assert vehicle.pitch_deg == pytest.approx(linear.pitch_deg, rel=0.16, abs=0.02)
        assert vehicle.heave_m == pytest.approx(linear.heave_m, abs=1e-3)
        assert vehicle.pitch_deg <= linear.pitch_deg + 0.02  # nose up, and the weight leans further


@BOTH
def test_imu_at_rest_feels_gravity_along_the_body(model: str) -> None:
    world = run(world_of(model, plate=[tilt("roll", 5.0), tilt("pitch", 3.0)]), 12.0)
    roll, pitch = radians(world.roll_deg), radians(world.pitch_deg)
    expected = GRAVITY_MPS2 * np.array([-sin(pitch), sin(roll) * cos(pitch), cos(roll) * cos(pitch)])
    reading = world.imu()
    np.testing.assert_allclose(reading.accel_mps2, expected, atol=1e-3)
    np.testing.assert_allclose(reading.gyro_radps, 0.0, atol=1e-4)


@BOTH
def test_imu_feels_the_same_roll_as_the_truth(model: str) -> None:
    world = world_of(model, plate=[{"axis": "roll", "at_s": 0.0, "amplitude_deg": 4.0, "frequency_hz": 0.3}])
    run(world, 3.0)
    before = radians(world.roll_deg)
    run(world, 0.01)
    rate = (radians(world.roll_deg) - before) / 0.01
    assert world.imu().gyro_radps[0] == pytest.approx(rate, abs=2e-3)


@BOTH
def test_wheels_follow_their_commands(model: str) -> None:
    world = run(world_of(model), 6.0, rpm=(20.0,) * 4)
    assert world.wheel_speed_rpm == pytest.approx((20.0,) * 4, abs=0.1)
    before = world.tooth_phase
    run(world, 1.0, rpm=(20.0,) * 4)
    passed = [b - a for a, b in zip(before, world.tooth_phase, strict=True)]
    assert passed == pytest.approx([20.0] * 4, abs=0.2)
    assert not world.wheels_stand
    assert run(world, 6.0).wheel_speed_rpm == pytest.approx(REST, abs=0.2)


@BOTH
def test_step_length_hardly_matters(model: str) -> None:
    fine, coarse = (world_of(model, plate=[tilt("roll", 5.0)]) for _ in range(2))
    run(fine, 0.5, duty=(0.3, -0.3, 0.3, -0.3))
    for _ in range(100):
        coarse.step(0.005, (0.3, -0.3, 0.3, -0.3), REST)
    assert coarse.time_us == fine.time_us
    assert coarse.roll_deg == pytest.approx(fine.roll_deg, abs=5e-3)


@BOTH
def test_one_seed_one_world(model: str) -> None:
    def lived(seed: int) -> list[float]:
        noisy = scenario(model, sensor_noise=True, plate=[tilt("roll", 3.0)])
        world = run(World(TIGER, noisy, seed), 0.3, duty=(1.0, -1.0, 0.5, 0.0), rpm=(10.0,) * 4)
        reading = world.imu()
        return [*reading.accel_mps2, *reading.gyro_radps, *world.potentiometer_volts(), *world.tooth_phase]

    assert lived(4) == lived(4)
    assert lived(4) != lived(5)


# ---- the 14-DOF vehicle on the ground


def test_the_robot_drives_where_its_wheels_take_it() -> None:
    truth = run(world_of(start={"yaw_deg": 30.0}), 8.0, rpm=(30.0,) * 4).truth()
    speed = 30.0 * pi / 30.0 * TIGER.tire.rolling_radius_m
    assert truth.speed_mps == pytest.approx(speed, rel=0.01)
    x, y, _ = truth.position_m
    assert degrees(np.arctan2(y, x)) == pytest.approx(30.0, abs=0.1)
    assert max(map(abs, truth.slip_ratio)) < 0.01


def test_faster_right_wheels_turn_the_robot_to_the_left() -> None:
    truth = run(world_of(friction=0.4), 5.0, rpm=(10.0, 40.0, 10.0, 40.0)).truth()
    assert truth.yaw_deg > 10.0
    assert truth.position_m[1] > 0.05


def test_imu_feels_the_pull_of_a_turn() -> None:
    body = make_body(TIGER, scenario(friction=0.4), (0.0, 0.0), [0.0] * 4)
    body.prepare(MS)
    felt, expected = [], []
    for tick in range(6000):
        body.advance((0.0, 0.0), [0.0] * 4, (40.0, 90.0, 40.0, 90.0))
        if tick > 3000:
            felt.append(body.accel_mps2[1] - GRAVITY_MPS2 * sin(body.attitude_rad[0]))
            expected.append(body.motion().speed_mps * body.rate_radps[2])
    assert np.mean(expected) > 0.05
    assert np.mean(felt) == pytest.approx(np.mean(expected), rel=0.05)


def test_a_coasting_robot_slows_by_its_rolling_resistance_and_stops() -> None:
    body = make_body(TIGER, scenario(start={"speed_mps": 1.0}), (0.0, 0.0), [0.0] * 4)
    body.prepare(MS)
    speeds = []
    for _ in range(7000):
        body.advance((0.0, 0.0), [0.0] * 4, (nan,) * 4)
        speeds.append(body.motion().speed_mps)
    tire = TIGER.tire
    wheels_kg = 4.0 * tire.spin_inertia_kgm2 / tire.rolling_radius_m**2
    slowing = tire.rolling_resistance * WEIGHT_N / (WEIGHT_N / GRAVITY_MPS2 + wheels_kg)
    assert (speeds[1000] - speeds[3000]) / 2.0 == pytest.approx(slowing, rel=0.01)
    assert abs(speeds[-1]) < 1e-3
    assert min(speeds) > -0.02


def test_wheels_on_stands_know_no_rolling_resistance() -> None:
    world = run(world_of("linear"), 3.0, rpm=(30.0,) * 4)
    assert world.motor_current_a() == pytest.approx([0.6] * 4, abs=0.1)  # no-load current
    assert run(world_of(), 5.0, rpm=(30.0,) * 4).motor_current_a().min() > 1.5


def test_motor_torque_and_current_carry_the_robot_up_a_slope() -> None:
    world = run(world_of(terrain={"climb_deg": 5.0}), 6.0, rpm=(20.0,) * 4)
    tire = TIGER.tire
    force = WEIGHT_N * (sin(radians(5.0)) + tire.rolling_resistance * cos(radians(5.0)))
    amps = force / 4.0 * tire.rolling_radius_m / (4.18 / 14.6) + 0.6
    assert np.mean(world.motor_current_a()) == pytest.approx(amps, rel=0.03)
    assert world.truth().speed_mps > 0.3


def test_torque_keeps_within_the_motors_limit() -> None:
    body = make_body(TIGER, scenario(), (0.0, 0.0), [0.0] * 4)
    body.prepare(MS)
    assert TIGER.drive is not None
    torques = []
    for _ in range(300):
        body.advance((0.0, 0.0), [0.0] * 4, (400.0, 400.0, -400.0, -400.0))
        torques += body.wheel_torque_nm
    assert max(map(abs, torques)) == TIGER.drive.max_torque_nm


def test_a_robot_on_a_side_slope_stands_where_it_is_and_leans_down_the_slope() -> None:
    world = world_of(terrain={"left_up_deg": 8.0})
    before = world.truth()
    after = run(world, 5.0).truth()
    assert after.roll_deg == pytest.approx(8.0 + lean_deg(8.0, 0.6), abs=0.05)
    assert np.subtract(after.position_m, before.position_m) == pytest.approx([0.0] * 3, abs=1e-4)
    left, right = after.wheel_load_n[0] + after.wheel_load_n[2], after.wheel_load_n[1] + after.wheel_load_n[3]
    assert left < right


def test_a_raised_step_lifts_the_robot_by_its_height() -> None:
    step = {"height_m": 0.03, "start_m": 1.0, "ramp_m": 0.1}
    world = run(world_of(terrain={"step": [step]}), 8.0, rpm=(25.0,) * 4)
    truth = world.truth()
    assert truth.position_m[0] > 2.0
    assert truth.position_m[2] == pytest.approx(TIGER.body.com_height_m + 0.03, abs=2e-3)
    assert truth.heave_m == pytest.approx(0.0, abs=2e-3)


def test_twisted_ground_loads_one_diagonal() -> None:
    loads = world_of(terrain={"twist_deg_per_m": 4.0}).truth().wheel_load_n
    # z = t x y under the wheels: +-t a w/... raises FL and RR, and the springs and tyres in series feel it.
    warp = tan(radians(4.0)) * TIGER.body.com_to_front_axle_m * TIGER.body.half_track_m
    spring, tire = TIGER.front.spring_npm, TIGER.tire.vertical_stiffness_npm
    change = warp * spring * tire / (spring + tire)
    expected = WEIGHT_N / 4.0 + change * np.array([1.0, -1.0, -1.0, 1.0])
    assert loads == pytest.approx(expected.tolist(), rel=0.02)


def test_wheels_sink_into_soft_soil_and_slip_more_on_it() -> None:
    firm = run(world_of(terrain={"climb_deg": 3.0}), 6.0, rpm=(20.0,) * 4).truth()
    soft = run(world_of(terrain={"climb_deg": 3.0}, soil="sandy-loam"), 6.0, rpm=(20.0,) * 4).truth()
    assert max(firm.slip_ratio) < 0.02 < min(soft.slip_ratio)
    assert soft.position_m[0] < firm.position_m[0]


def test_friction_is_that_of_the_scenario() -> None:
    slope = {"left_up_deg": 12.0}  # tangent 0.21
    sliding = world_of(terrain=slope, friction=0.15)
    run(sliding, 2.0)
    holding = run(world_of(terrain=slope, friction=0.5), 2.0)
    assert sliding.truth().position_m[1] < -0.2
    assert abs(holding.truth().position_m[1]) < 0.12


def test_a_payload_weighs_where_it_lies() -> None:
    world = run(world_of(payload={"mass_kg": 20.0, "place_m": [0.2, 0.1, 0.2]}), 1.0)
    truth = world.truth()
    front_left, front_right, rear_left, rear_right = truth.wheel_load_n
    assert sum(truth.wheel_load_n) == pytest.approx(WEIGHT_N + 20.0 * GRAVITY_MPS2, rel=1e-4)
    half_wheelbase = TIGER.body.com_to_front_axle_m
    forward = (front_left + front_right - rear_left - rear_right) * half_wheelbase
    assert forward == pytest.approx(20.0 * GRAVITY_MPS2 * 0.2, rel=0.15)  # it leans, and leans further by it
    assert front_left + rear_left > front_right + rear_right
    assert truth.heave_m < -0.02  # it sags
    assert truth.pitch_deg > 0.5
    assert truth.roll_deg < -0.2


def test_magnetometer_shows_the_heading() -> None:
    ahead, left, _ = world_of(start={"yaw_deg": 90.0}).imu().mag_ut
    assert (ahead, left) == pytest.approx((0.0, -20.0), abs=0.1)


def test_a_rolling_start_goes_on() -> None:
    world = world_of(start={"speed_mps": 0.5})
    rpm = 0.5 / TIGER.tire.rolling_radius_m * 30.0 / pi
    assert world.wheel_speed_rpm == pytest.approx((rpm,) * 4, rel=1e-6)
    assert run(world, 1.0, rpm=(rpm,) * 4).truth().speed_mps == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("ground", ["rough", "road"])
def test_rough_ground_shakes_the_robot_and_its_seed_decides_how(ground: str) -> None:
    def ridden(seed: int) -> list[float]:
        world = world_of(terrain={ground: {"roughness": "D", "seed": seed}}, start={"x_m": 5.0})
        rides = []
        for _ in range(20):
            truth = run(world, 0.2, rpm=(40.0,) * 4).truth()
            rides += [truth.roll_deg, truth.pitch_deg, *truth.wheel_load_n]
        return rides

    first = ridden(1)
    assert first == ridden(1)
    assert first != ridden(2)
    assert np.std(first[0::6]) > 0.05
    assert np.isfinite(first).all()
