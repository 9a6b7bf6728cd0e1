"""robot.toml: defaults, overlay, and what a wrong key is told."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

import pytest

from tiger.config.errors import ConfigError
from tiger.config.robot import default_robot_toml, load_robot
from tiger.config.vehicle import load_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def write_robot(text: str) -> Path:
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_robot


def messages(path: Path) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    return caught.value.messages


def test_the_default_is_the_real_robot_at_200_hz() -> None:
    robot = load_robot()
    assert robot.vehicle == load_vehicle("tiger")
    assert robot.loop.period_s == 0.005
    assert robot.leveling.dead_zone_deg == 0.27
    assert robot.stroke_range_mm == (1.5, 68.5)


def test_every_default_is_explained_or_explains_itself() -> None:
    keys = [line for line in default_robot_toml().splitlines() if "=" in line and not line.startswith("#")]
    units = (
        "_deg",
        "_degs",
        "_degps",
        "_degps2",
        "_s",
        "_ms",
        "_mm",
        "_mps",
        "_mps2",
        "_mps3",
        "_mmps2",
        "_hz",
        "_a",
    )
    units += ("_v", "_rpm", "_celsius", "_per_s", "_factor")
    for line in keys:
        assert "#" in line or line.split("=")[0].strip().endswith(units), line


def test_a_users_file_changes_only_what_it_names(write: Callable[[str], Path]) -> None:
    robot = load_robot(write("[leveling]\ndead_zone_deg = 0.15\n"))
    default = load_robot()
    assert robot.leveling.dead_zone_deg == 0.15
    assert robot.leveling.model_copy(update={"dead_zone_deg": 0.27}) == default.leveling
    assert robot.safety == default.safety


def test_a_vehicle_file_is_found_beside_the_robot_file(write: Callable[[str], Path], tmp_path: Path) -> None:
    from importlib import resources

    preset = resources.files("tiger.config") / "presets" / "tiger.toml"
    text = preset.read_text(encoding="utf-8").replace("mass_kg = 41.22", "mass_kg = 45.0", 1)
    (tmp_path / "heavy.toml").write_text(text, encoding="utf-8")
    assert load_robot(write('vehicle = "heavy.toml"')).vehicle.body.mass_kg == 45.0
    table = tomllib.loads(text)["body"]["mass_kg"]
    assert table == 45.0


def test_all_errors_are_told_at_once_with_key_value_and_next_step(write: Callable[[str], Path]) -> None:
    told = messages(
        write(
            'vehicle = "tigre"\nspeed = 3\n[loop]\nrate_hz = 5000.0\n[drive]\nmax_speed_mps = "fast"\n'
            "[safety]\nmax_tilt_deg = -1.0\n"
        )
    )
    assert len(told) == 5
    for needles in (
        ("tigre", "tiger"),
        ("speed", "not a known key"),
        ("loop.rate_hz", "5000.0", "500"),
        ("drive.max_speed_mps", "'fast'", "number"),
        ("safety.max_tilt_deg", "-1.0", "greater than 0"),
    ):
        assert any(all(needle in line for needle in needles) for line in told), (needles, told)


@pytest.mark.parametrize(
    ("text", "needles"),
    [
        ("[leveling]\nwake_deg = 0.1", ("settle_deg = 0.08", "dead_zone_deg = 0.2", "wake_deg = 0.1")),
        ("[leveling]\nride_stroke_mm = 69.5", ("leveling.ride_stroke_mm = 69.5", "68.5")),
        ("[leveling]\nahead_trial_m = 2.0", ("ahead_trial_m = 2.0", "ahead_memory_m = 2.0", "lower it")),
        ("[leveling]\nstroke_margin_mm = 35.0", ("leveling.stroke_margin_mm = 35.0", "lower it")),
        ("[loop]\nsetpoint_rate_hz = 90.0", ("rate_hz = 200.0", "setpoint_rate_hz = 90.0")),
        ("[safety]\nbattery_min_v = 23.0", ("battery_low_v = 22.0", "battery_min_v = 23.0")),
        ('[ports]\nboards = ["ttyACM0"]', ("ports.boards.0", "'ttyACM0'")),
        ('[ports]\nroboteq_left = "/dev/a"\nroboteq_right = "/dev/a"', ("/dev/a", "two ports")),
        ('vehicle = "table-6-1"', ("stroke-rate", 'vehicle = "tiger"')),
        ("vehicle = 7", ("vehicle = 7", "preset")),
        ("[vehicle]\nimu_offset_m = [0.0, 0.0, 0.0]", ("[vehicle]", "body is missing")),
        ("[loop]\nlock_memory = 1", ("loop.lock_memory = 1", "bool")),
        ("drive = 3", ("drive = 3",)),
        ("a = [", ("not valid TOML",)),
    ],
)
def test_a_wrong_file_says_what_to_correct(
    write: Callable[[str], Path], text: str, needles: tuple[str, ...]
) -> None:
    told = messages(write(text))
    assert any(all(needle in line for needle in needles) for line in told), told


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "gone.toml"
    assert messages(path) == (f"{path}: cannot be read (No such file or directory); check the path",)
