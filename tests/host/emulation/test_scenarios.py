"""Scenarios: the plate moves as the file says, and a wrong file is told what is wrong."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin, tan
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.errors import ConfigError
from tiger.config.robot import load_robot
from tiger.emulation.ground import make_terrain
from tiger.emulation.scenarios import PlateAxis, Scenario, TerrainConfig, load_scenario, scenario_names
from tiger.models.road import LEFT, RIGHT, iso_road

HEAD = 'title = "t"\nduration_s = 10.0\n'
RAMP = '[[plate]]\naxis = "roll"\nat_s = 1.0\nto_deg = 4.0\nover_s = 2.0\n'
HARMONIC = '[[plate]]\naxis = "pitch"\nat_s = 1.0\namplitude_deg = 2.0\nfrequency_hz = 0.5\n'
DRIVE = "[[drive]]\nat_s = 5.0\nspeed_mps = 0.5\nyaw_rate_degps = 5.0\n"
WAYPOINT = "[[waypoint]]\nx_m = 5.0\ny_m = 1.0\nspeed_mps = 0.5\n"
PATCH = "[[terrain.slippery]]\nfriction_factor = 0.2\nstart_m = 2.0\nlength_m = 3.0\n"


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


def roll(scenario: Scenario, time_s: float) -> float:
    return degrees(PlateAxis(scenario.segments("roll")).angle_rad(time_s))


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_of_the_package_loads(name: str) -> None:
    assert load_scenario(name).duration_s > 0.0


@pytest.mark.parametrize(
    ("time_s", "expected_deg"),
    [
        (0.0, 0.0),
        (5.0, 0.0),
        (5.075, 5.0 * (1 - cos(pi / 4)) / 2),
        (5.15, 2.5),
        (5.3, 5.0),
        (19.99, 5.0),
        (20.15, 2.5),
        (20.3, 0.0),
        (30.0, 0.0),
        (35.0, 2.0),
        (40.0, 0.0),
        (45.0, -2.0),
        (59.0, 2.0 * sin(2 * pi * 0.05 * 29.0)),
    ],
)
def test_shaking_plate_moves_as_agreed(time_s: float, expected_deg: float) -> None:
    assert roll(load_scenario("shaking-plate"), time_s) == pytest.approx(expected_deg, abs=1e-9)


def test_shaking_plate_does_not_pitch() -> None:
    plate = PlateAxis(load_scenario("shaking-plate").segments("pitch"))
    assert all(plate.angle_rad(0.1 * k) == 0.0 for k in range(600))


@given(st.floats(0.0, 60.0), st.floats(1e-6, 1e-3))
def test_shaking_plate_never_jumps(time_s: float, step_s: float) -> None:
    scenario = load_scenario("shaking-plate")
    fastest_degps = 5.0 * pi / 2 / 0.3
    assert (
        abs(roll(scenario, time_s + step_s) - roll(scenario, time_s)) <= fastest_degps * step_s * 1.01 + 1e-9
    )


def test_a_ramp_starts_where_the_axis_stands(tmp_path: Path) -> None:
    second = '[[plate]]\naxis = "roll"\nat_s = 4.0\nto_deg = -4.0\nover_s = 1.0\n'
    scenario = load_scenario(write(tmp_path, HEAD + second + RAMP))  # the order in the file does not matter
    assert roll(scenario, 3.5) == pytest.approx(4.0)
    assert roll(scenario, 4.5) == pytest.approx(0.0)
    assert roll(scenario, 9.0) == pytest.approx(-4.0)


def test_a_harmonic_swings_about_where_the_axis_stands_and_ends_there(tmp_path: Path) -> None:
    harmonic = (
        '[[plate]]\naxis = "roll"\nat_s = 4.0\namplitude_deg = 1.0\nfrequency_hz = 0.25\n'
        "phase_deg = 90.0\nfor_s = 2.5\n"
    )
    scenario = load_scenario(write(tmp_path, HEAD + RAMP + harmonic))
    assert roll(scenario, 4.0) == pytest.approx(5.0)
    assert roll(scenario, 6.0) == pytest.approx(3.0)
    assert roll(scenario, 6.5) == pytest.approx(4.0)
    assert roll(scenario, 60.0) == pytest.approx(4.0)


def test_the_two_axes_are_apart(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, HEAD + RAMP + HARMONIC))
    pitch = PlateAxis(scenario.segments("pitch"))
    assert pitch.angle_rad(1.5) == pytest.approx(radians(2.0))
    assert roll(scenario, 1.0) == 0.0


def test_faults_and_start_are_read(tmp_path: Path) -> None:
    scenario = load_scenario(
        write(
            tmp_path,
            HEAD
            + "initial_stroke_mm = [0.0, 10.0, 20.0, 70.0]\nsensor_noise = false\n"
            + '[[fault]]\nat_s = 3.0\ntarget = "nano_imu"\nkind = "silence"\nfor_s = 1.0\n',
        )
    )
    assert scenario.initial_stroke_mm == (0.0, 10.0, 20.0, 70.0)
    assert not scenario.sensor_noise
    fault = scenario.fault[0]
    assert (fault.target, fault.for_s, fault.value) == ("nano_imu", 1.0, None)


def test_ground_start_payload_and_drive_are_read(tmp_path: Path) -> None:
    scenario = load_scenario(
        write(
            tmp_path,
            HEAD
            + 'soil = "dry-sand"\nfriction = 0.5\n'
            + "[start]\nx_m = 2.0\nspeed_mps = 0.3\n"
            + "[payload]\nmass_kg = 20.0\nplace_m = [0.1, 0.0, 0.2]\n"
            + "[terrain]\nleft_up_deg = 5.0\n[[terrain.step]]\nheight_m = 0.05\nstart_m = 1.0\n"
            + DRIVE
            + "[[drive]]\nat_s = 9.0\n",
        )
    )
    assert scenario.model == "vehicle"
    assert (scenario.start.x_m, scenario.start.speed_mps, scenario.start.y_m) == (2.0, 0.3, 0.0)
    assert scenario.payload is not None
    assert scenario.payload.mass_kg == 20.0
    assert (scenario.drive[0].yaw_rate_degps, scenario.drive[1].speed_mps) == (5.0, 0.0)
    terrain = make_terrain(scenario.terrain, 0.6)
    height, slope_x, slope_y = (float(value) for value in terrain.at(5.0, 1.0))
    assert (height, slope_x) == pytest.approx((tan(radians(5.0)) + 0.05, 0.0))
    assert slope_y == pytest.approx(tan(radians(5.0)))


def test_a_road_lies_under_the_wheel_tracks() -> None:
    road = TerrainConfig.model_validate({"road": {"roughness": "C", "seed": 4}})
    terrain, profile = make_terrain(road, 0.6), iso_road("C", 4)
    for y_m, lane in ((0.6, LEFT), (-0.6, RIGHT)):
        assert terrain.at(7.0, y_m)[0] == pytest.approx(profile.height_m(7.0, lane), abs=1e-6)


@pytest.mark.parametrize("name", ["side-slope", "twist", "curb", "uneven-terrain", "loose-slope", "iso-road"])
def test_terrain_scenarios_rest_before_they_drive_and_stop_before_they_end(name: str) -> None:
    scenario = load_scenario(name)
    first, last = scenario.drive[0], scenario.drive[-1]
    assert scenario.model == "vehicle"
    assert first.at_s >= 6.0
    assert first.speed_mps > 0.0
    assert last.speed_mps == last.yaw_rate_degps == 0.0
    assert last.at_s + 2.0 <= scenario.duration_s


def test_a_slippery_patch_and_a_route_come_from_the_file(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, HEAD + WAYPOINT + PATCH))
    assert scenario.waypoint[0].speed_mps == 0.5
    assert (scenario.route.laps, scenario.route.steer_by) == (1, "truth")
    assert make_terrain(scenario.terrain, 0.6).grip_at([1.0, 3.0], 0.0).tolist() == [1.0, 0.2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            HEAD + 'model = "linear"\nsoil = "dry-sand"\n',
            'soil means nothing to model = "linear", which stands on a plate',
        ),
        (HEAD + 'model = "cubic"\n', "model = 'cubic'"),
        (HEAD + DRIVE + DRIVE, "the drive at 5 s does not come after the one at 5 s"),
        (
            HEAD + '[terrain.road]\nroughness = "C"\n[terrain.rough]\nroughness = "C"\n',
            "there is one height field",
        ),
        (HEAD + '[terrain.road]\nroughness = "Z"\n', "terrain.road.roughness = 'Z'"),
        (HEAD + "[terrain]\nleft_up_deg = 80.0\n", "terrain.left_up_deg = 80.0"),
        (HEAD + "[payload]\nmass_kg = 20.0\n", "payload.place_m is missing"),
        ("duration_s = 1.0\n", "title is missing"),
        ('title = "t"\nduration_s = -1.0\n', "duration_s = -1.0: input should be greater than 0"),
        (HEAD + "duration = 3\n", "duration is not a known key"),
        (HEAD + "initial_stroke_mm = [1.0, 2.0, 3.0]\n", "initial_stroke_mm.3 is missing"),
        (HEAD + RAMP.replace("roll", "yaw"), "plate.0.axis = 'yaw'"),
        (HEAD + RAMP.replace("over_s = 2.0\n", ""), "a segment is a ramp"),
        (HEAD + RAMP + "amplitude_deg = 2.0\n", "a segment is a ramp"),
        (HEAD + RAMP + "for_s = 2.0\n", "a segment is a ramp"),
        (
            HEAD + RAMP.replace("4.0", "90.0"),
            "plate.0.to_deg = 90.0: input should be less than or equal to 45",
        ),
        (HEAD + HARMONIC.replace("0.5", "0.0"), "frequency_hz = 0.0: input should be greater than 0"),
        (
            HEAD + RAMP + RAMP.replace("at_s = 1.0", "at_s = 2.5"),
            "the roll segment at 2.5 s starts before the roll segment at 1 s ends (3 s)",
        ),
        (
            HEAD + HARMONIC + HARMONIC.replace("at_s = 1.0", "at_s = 9.0"),
            "the pitch segment at 9 s starts before the pitch segment at 1 s ends (inf s)",
        ),
        (HEAD + DRIVE + WAYPOINT, "by [[drive]] or by [[waypoint]], not by both"),
        (HEAD + WAYPOINT + WAYPOINT, "two waypoints in a row are at (5, 1) m"),
        (HEAD + "[route]\nlaps = 2\n", "there are none: add [[waypoint]]"),
        (HEAD + WAYPOINT + '[route]\nsteer_by = "stars"\n', "route.steer_by = 'stars'"),
        (HEAD + WAYPOINT.replace("0.5", "0.0"), "waypoint.0.speed_mps = 0.0"),
        (HEAD + 'model = "linear"\n' + WAYPOINT, "waypoint means nothing to model"),
        (HEAD + PATCH.replace("0.2", "1.5"), "terrain.slippery.0.friction_factor = 1.5"),
        (HEAD + PATCH + "right_m = 2.0\nleft_m = 1.0\n", "right_m = 2 must be below left_m = 1"),
        (HEAD + 'soil = "dry-sand"\n' + PATCH, "means nothing on loose ground"),
        ("title = \n", "not valid TOML"),
    ],
)
def test_a_wrong_file_is_told_its_key_value_and_next_step(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scenario(write(tmp_path, text))
    assert said in str(caught.value)


ROUTE = "[route]\nmax_yaw_rate_degps = {}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + DRIVE.replace("0.5", "3.1"), "drive.0.speed_mps = 3.1: is beyond ±3, drive.max_speed_mps"),
        (HEAD + DRIVE.replace("0.5", "-3.1"), "drive.0.speed_mps = -3.1"),
        (
            HEAD + DRIVE.replace("degps = 5.0", "degps = -90.5"),
            "drive.0.yaw_rate_degps = -90.5: is beyond",
        ),
        (HEAD + WAYPOINT.replace("0.5", "9.0"), "waypoint.0.speed_mps = 9: is beyond ±3"),
        (HEAD + WAYPOINT + ROUTE.format(91.0), "route.max_yaw_rate_degps = 91: is beyond ±90"),
    ],
)
def test_a_drive_beyond_the_robots_own_limits_is_refused_with_both(
    tmp_path: Path, text: str, said: str
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, load_robot(None).drive)
    assert str(caught.value).startswith(f"{path}: {said}")
    assert "ask for less" in str(caught.value)
    load_scenario(path)  # behind `tiger emulate`, whoever runs the daemon drives


@pytest.mark.parametrize("speed_mps", ["3.0", "-3.0"])
def test_a_drive_at_the_robots_limits_is_driven(tmp_path: Path, speed_mps: str) -> None:
    text = HEAD + DRIVE.replace("0.5", speed_mps).replace("degps = 5.0", "degps = 90.0")
    assert load_scenario(write(tmp_path, text), load_robot(None).drive).drive[0].speed_mps == float(speed_mps)


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"'earthquake' is not known; use one of .*shaking-plate"):
        load_scenario("earthquake")


def test_a_missing_file_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scenario(tmp_path / "absent.toml")
