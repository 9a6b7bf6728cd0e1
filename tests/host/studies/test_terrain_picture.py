"""The drawing of the robot: wheels stand where the world says, hanging ones show, files are whole."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.models.full_car import FullCarParameters
from tiger.models.terrain import Terrain
from tiger.studies import terrain_picture
from tiger.studies.terrain_picture import HANGING, Frame, animate, evenly, strip

TIGER = load_vehicle("tiger")
HEIGHT_M, RADIUS_M = TIGER.body.com_height_m, TIGER.tire.rolling_radius_m
REST_N: tuple[float, float, float, float] = tuple(
    FullCarParameters.from_config(TIGER).static_tire_load_n().tolist()
)


def frame(**changes: Any) -> Frame:
    at_rest = Frame(0.0, (0.0, 0.0, HEIGHT_M), (0.0, 0.0, 0.0), (35.0,) * 4, REST_N)
    return at_rest._replace(**changes)


def wheel_bottoms_m(shown: Frame) -> list[float]:
    """Lowest point of each wheel as drawn; a wheel is the two rings of its tyre."""
    faces = terrain_picture._RobotShape(TIGER).faces(shown)
    rings = [face.corners for face in faces if len(face.corners) == terrain_picture.SPOKES]
    lowest = [float(ring[:, 2].min()) for ring in rings]
    return [min(lowest[3 * corner : 3 * corner + 2]) for corner in range(4)]


def test_at_rest_the_wheels_stand_on_the_ground() -> None:
    np.testing.assert_allclose(wheel_bottoms_m(frame()), 0.0, atol=2e-3)


def test_a_longer_stroke_pushes_its_wheel_down() -> None:
    bottoms = wheel_bottoms_m(frame(stroke_mm=(45.0, 35.0, 35.0, 35.0)))
    assert bottoms[0] == pytest.approx(-0.019, abs=0.003)  # ten millimetres of stroke, motion ratio 1.9
    np.testing.assert_allclose(bottoms[1:], 0.0, atol=2e-3)


def test_a_wheel_without_load_hangs_lower_and_is_red() -> None:
    shape = terrain_picture._RobotShape(TIGER)
    hanging = frame(wheel_load_n=(REST_N[0], 0.0, REST_N[2], REST_N[3]))
    assert shape.hanging(hanging) == [False, True, False, False]
    assert sum(face.colour == HANGING for face in shape.faces(hanging)) > terrain_picture.SPOKES
    assert wheel_bottoms_m(hanging)[1] == pytest.approx(-REST_N[1] / TIGER.front.spring_npm, abs=3e-3)


def test_roll_to_the_right_and_yaw_turn_the_drawing_as_they_turn_the_robot() -> None:
    left, right = wheel_bottoms_m(frame(attitude_rad=(radians(5.0), 0.0, 0.0)))[:2]
    assert left > right  # roll +: left side up
    place = [f.corners.mean(axis=0) for f in terrain_picture._RobotShape(TIGER).faces(frame())]
    turned = frame(attitude_rad=(0.0, 0.0, radians(90.0)))
    after = [f.corners.mean(axis=0) for f in terrain_picture._RobotShape(TIGER).faces(turned)]
    np.testing.assert_allclose(np.array(after)[:, 0], -np.array(place)[:, 1], atol=1e-9)


def test_a_payload_is_drawn_where_it_is() -> None:
    from tiger.config.vehicle import PayloadConfig

    loaded = TIGER.model_copy(update={"payload": PayloadConfig(mass_kg=20.0, place_m=(0.2, -0.1, 0.3))})
    faces = terrain_picture._RobotShape(loaded).faces(frame())
    boxes = [face.corners.mean(axis=0) for face in faces if face.colour == terrain_picture.PAYLOAD]
    np.testing.assert_allclose(np.mean(boxes, axis=0), [0.2, -0.1, HEIGHT_M + 0.3], atol=1e-9)


def test_the_ground_is_drawn_at_its_height_and_stays_where_it_is_as_the_robot_drives() -> None:
    terrain = Terrain.slope(climb_deg=10.0)
    here = terrain_picture._ground_faces(terrain, (0.33, 0.0))
    for face in here:
        np.testing.assert_allclose(face.corners[:, 2], face.corners[:, 0] * np.tan(radians(10.0)), atol=1e-9)
    there = terrain_picture._ground_faces(terrain, (0.38, 0.0))

    def inner(faces: list[terrain_picture._Face]) -> dict[tuple[float, ...], object]:
        whole = [f for f in faces if np.ptp(f.corners[:, 0]) > 0.0999 and np.ptp(f.corners[:, 1]) > 0.0999]
        return {tuple(np.round(face.corners.mean(axis=0)[:2], 6)): face.colour for face in whole}

    before, after = inner(here), inner(there)
    common = before.keys() & after.keys()
    assert len(common) > 300
    assert all(before[place] == after[place] for place in common)


def test_a_strip_is_a_png_as_wide_as_its_frames(tmp_path: Path) -> None:
    from PIL import Image

    one = strip([frame()], Terrain(), tmp_path / "one.png", "One")
    three = strip([frame()] * 3, Terrain(), tmp_path / "new" / "three.png", captions=["a", "b", "c"])
    with Image.open(one) as first, Image.open(three) as second:
        assert second.width == pytest.approx(3 * first.width, abs=3)
        assert first.height > 200
        colours = first.convert("RGB").resize((64, 64)).getcolors(4096)
        assert colours is not None
        assert len(colours) > 50  # something is drawn


def test_an_animation_has_all_frames_at_its_pace(tmp_path: Path) -> None:
    from PIL import Image

    frames = [frame(time_s=t, position_m=(t, 0.0, HEIGHT_M)) for t in (0.0, 0.2, 0.4)]
    path = animate(frames, Terrain(), tmp_path / "drive.gif", "Drive", frames_per_s=5)
    with Image.open(path) as film:
        assert film.n_frames == 3  # type: ignore[attr-defined]
        assert film.info["duration"] == 200


def test_evenly_takes_the_first_and_the_last() -> None:
    frames = [frame(time_s=float(t)) for t in range(11)]
    assert [f.time_s for f in evenly(frames, 5)] == [0.0, 2.0, 5.0, 8.0, 10.0]
