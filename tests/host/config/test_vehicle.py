"""Vehicle configuration: the presets hold the printed tables, and a wrong file is told what is wrong."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.errors import ConfigError
from tiger.config.vehicle import VehicleConfig, load_vehicle, preset_names

PRESETS = resources.files("tiger.config") / "presets"


def test_presets_are_the_robot_its_long_arm_variant_and_the_two_cars() -> None:
    assert preset_names() == ("table-5-1", "table-6-1", "tiger", "tiger-b")


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_loads(name: str) -> None:
    assert isinstance(load_vehicle(name), VehicleConfig)


@pytest.mark.parametrize("name", preset_names())
def test_every_value_of_a_preset_is_marked_printed_or_chosen(name: str) -> None:
    for line in (PRESETS / f"{name}.toml").read_text().splitlines():
        if "=" in line.split("#")[0] and not line.startswith(("kind", "extends")):
            assert "printed" in line or "chosen" in line, line


def test_tiger_holds_the_printed_figures_of_tables_3_1_to_3_3() -> None:
    tiger = load_vehicle("tiger")
    assert tiger.body.mass_kg == 41.22
    assert tiger.front.unsprung_mass_kg == tiger.rear.unsprung_mass_kg == 9.67
    assert tiger.body.com_to_front_axle_m == tiger.body.com_to_rear_axle_m == 0.5
    assert tiger.tire.rolling_radius_m == 0.324 / 2
    assert tiger.actuator.kind == "rate"
    assert (tiger.actuator.max_rate_mmps, tiger.actuator.max_force_n) == (9.4, 667.0)
    assert (tiger.actuator.stroke_max_mm, tiger.actuator.length_at_zero_stroke_mm) == (70.0, 244.0)
    assert tiger.drive is not None
    assert tiger.drive.max_wheel_speed_rpm == 800.0


def test_table_5_1_keeps_the_inertias_as_printed() -> None:
    car = load_vehicle("table-5-1")
    assert (car.body.pitch_inertia_kgm2, car.body.yaw_inertia_kgm2) == (26070.0, 26744.0)
    assert 2 * car.body.half_track_m == 1.586
    assert car.eam is None


def test_table_6_1_holds_the_printed_figures() -> None:
    car = load_vehicle("table-6-1")
    assert (car.front.unsprung_mass_kg, car.rear.unsprung_mass_kg) == (85.0, 60.0)
    assert (car.front.spring_npm, car.rear.spring_npm) == (96861.0, 52310.0)
    assert car.body.wheelbase_m == pytest.approx(2.68)
    assert car.actuator.kind == "force"
    assert car.actuator.rattle_space_m == 0.08


def test_a_file_that_extends_a_preset_gives_only_what_differs(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('extends = "tiger"\n[body]\nmass_kg = 45.0\n')
    mine, tiger = load_vehicle(path), load_vehicle("tiger")
    assert mine.body.mass_kg == 45.0
    assert mine.body.half_track_m == tiger.body.half_track_m
    assert mine.eam == tiger.eam


def test_another_actuator_kind_replaces_the_base_actuator_whole(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'extends = "table-6-1"\n[actuator]\nkind = "rate"\nmax_rate_mmps = 9.4\nlag_s = 0.05\n'
        "max_force_n = 667.0\nstroke_max_mm = 70.0\nlength_at_zero_stroke_mm = 244.0\n"
    )
    assert load_vehicle(str(path)).actuator.kind == "rate"


def broken(tmp_path: Path, before: str, after: str) -> ConfigError:
    text = (PRESETS / "tiger.toml").read_text()
    assert text.count(before) == 1
    path = tmp_path / "broken.toml"
    path.write_text(text.replace(before, after))
    with pytest.raises(ConfigError) as caught:
        load_vehicle(path)
    return caught.value


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("mass_kg = 41.22", "mass_kg = -1.0", "body.mass_kg = -1.0: input should be greater than 0"),
        ("mass_kg = 41.22", "mass_kg = 0", "body.mass_kg = 0: input should be greater than 0"),
        ("mass_kg = 41.22", 'mass_kg = "41"', "body.mass_kg = '41': input should be a valid number"),
        ("mass_kg = 41.22", "mass_kg = true", "body.mass_kg = True: input should be a valid number"),
        ("mass_kg = 41.22", "mass_kg = inf", "body.mass_kg = inf: input should be a finite number"),
        ("mass_kg = 41.22", "weight = 41.22", "body.mass_kg is missing; add it"),
        ("lag_s = 0.05", "lag_s = -0.1", "actuator.lag_s = -0.1: input should be greater than or equal to 0"),
        ('kind = "rate"', 'kind = "magic"', "actuator"),
        ("[0.0, 0.0, 0.125]", "[0.0, 0.125]", "imu_offset_m.2 is missing"),
    ],
)
def test_a_wrong_value_is_named_with_its_key_value_and_limit(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    assert said in str(broken(tmp_path, before, after))


def test_each_wrong_key_gets_a_line_of_its_own(tmp_path: Path) -> None:
    error = broken(tmp_path, "mass_kg = 41.22", "mass_kgs = 41.22")
    assert len(error.messages) == 2
    assert any("body.mass_kg is missing" in line for line in error.messages)
    assert any("body.mass_kgs is not a known key" in line for line in error.messages)


def test_an_eam_without_a_stroke_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'extends = "tiger"\n[actuator]\nkind = "force"\nmax_force_n = 667.0\nrattle_space_m = 0.08\n'
    )
    with pytest.raises(ConfigError, match="needs an actuator with a stroke"):
        load_vehicle(path)


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="table-5-1, table-6-1, tiger"):
        load_vehicle("lion")


def test_an_unknown_base_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('extends = "lion"\n')
    with pytest.raises(ConfigError, match="extends = 'lion' is not a preset; use one of table-5-1"):
        load_vehicle(path)


def test_a_missing_file_and_bad_toml_are_config_errors(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_vehicle(tmp_path / "absent.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[body\n")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_vehicle(bad)


@given(st.sampled_from(preset_names()), st.floats(0.1, 10.0))
def test_a_vehicle_survives_a_round_trip_through_its_own_dump(name: str, factor: float) -> None:
    vehicle = load_vehicle(name)
    heavier = vehicle.model_copy(
        update={"body": vehicle.body.model_copy(update={"mass_kg": vehicle.body.mass_kg * factor})}
    )
    assert VehicleConfig.model_validate(heavier.model_dump()) == heavier


def test_a_vehicle_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        load_vehicle("tiger").body.mass_kg = 1.0  # type: ignore[misc]


def test_preset_files_are_plain_toml() -> None:
    for name in preset_names():
        assert tomllib.loads((PRESETS / f"{name}.toml").read_text())
