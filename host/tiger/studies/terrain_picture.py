"""TIGER on its terrain, drawn from what the world really did: a strip of pictures, or an animation.

    frames = [Frame.from_truth(robot.truth()), ...]
    strip(frames, terrain, Path("climb.png"), "Climbing", vehicle)
    animate(frames, terrain, Path("climb.gif"), "Climbing", vehicle)

Each picture shows the robot from two sides and its four wheel loads; a wheel that carries nothing is red. The
drawing is an orthographic projection of flat faces, painted from far to near. The mechanisms stand as their
strokes say, and a wheel hangs below the body by as much as its load leaves of its spring's compression: what
a slow ride looks like, and within millimetres of what a fast one does.
"""

from __future__ import annotations

from math import asin, cos, pi, radians, sin
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tiger.config.vehicle import load_vehicle
from tiger.models.eam import Eam
from tiger.models.full_car import FullCarParameters
from tiger.studies.figures import new_figure, save
from tiger.studies.report import CORNERS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.world import Truth
    from tiger.models.terrain import Terrain
    from tiger.record import Four

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

PATCH_M = (2.1, 1.9)
"""Length and width of the ground around the robot that is drawn."""
GROUND_SPACING_M = 0.1
GROUND_RELIEF = 3.0
"""How much steeper than it is the ground is lit, so that its shape can be seen."""
HANGING_SHARE = 0.02
"""A wheel with less than this share of its load at rest counts as hanging."""

# What the drawing adds to the vehicle's configuration, metres: a box between the mechanisms, wheels, rods.
BOX_LENGTH_M, BOX_WIDTH_M, BOX_HEIGHT_M = 0.86, 0.56, 0.25
PAYLOAD_M = 0.26
TYRE_WIDTH_M = 0.09
HUB_RADIUS_M = 0.07
SPOKES = 20
ROD_M = 0.022

GROUND: Colour = (0.86, 0.77, 0.61)
GROUND_DARK: Colour = (0.80, 0.70, 0.54)
BODY: Colour = (0.24, 0.36, 0.50)
PAYLOAD: Colour = (0.72, 0.50, 0.24)
TYRE: Colour = (0.22, 0.22, 0.23)
HANGING: Colour = (0.85, 0.16, 0.14)
HUB: Colour = (0.75, 0.75, 0.77)
ARROW: Colour = (0.85, 0.88, 0.92)
ARM: Colour = (0.55, 0.57, 0.60)
ACTUATOR: Colour = (0.95, 0.62, 0.10)
SPRING: Colour = (0.20, 0.62, 0.40)

LIGHT = np.array([0.35, -0.45, 0.82])
AMBIENT = 0.55


class Frame(NamedTuple):
    """What the robot looked like at one moment. Corners FL FR RL RR; angles are roll, pitch, yaw."""

    time_s: float
    position_m: tuple[float, float, float]
    """COM in the world."""
    attitude_rad: tuple[float, float, float]
    stroke_mm: Four
    wheel_load_n: Four

    @classmethod
    def from_truth(cls, truth: Truth) -> Frame:
        """Take what a picture needs of a sample of the world."""
        return cls(
            truth.time_s,
            truth.position_m,
            (radians(truth.roll_deg), radians(truth.pitch_deg), radians(truth.yaw_deg)),
            truth.stroke_mm,
            truth.wheel_load_n,
        )


class Camera(NamedTuple):
    """Where the eye stands, seen from the robot, and how much of the picture's plane it takes in."""

    right_of_tail_deg: float
    above_horizon_deg: float
    view_m: tuple[float, float]


BESIDE = Camera(58.0, 24.0, (2.75, 1.62))
BEHIND = Camera(0.0, 7.0, (1.95, 1.02))


class _Face(NamedTuple):
    """A flat polygon, (n, 3) in the world, its colour in full light, how much its slope is exaggerated."""

    corners: Array
    colour: Colour
    relief: float = 1.0
    nearer_m: float = 0.0
    """Painted as if it were so much nearer: a mark lies on what carries it."""


def strip(
    frames: Sequence[Frame],
    terrain: Terrain,
    path: Path,
    title: str = "",
    vehicle: VehicleConfig | None = None,
    captions: Sequence[str] = (),
) -> Path:
    """Draw the frames side by side into a PNG; choose four to six of them, see `evenly`.

    `captions` replace the times above the pictures. Without `vehicle` it is the preset `tiger`; one with a
    payload shows it.
    """
    picture = _Picture(vehicle or load_vehicle("tiger"), terrain)
    shapes = [camera.view_m[1] / camera.view_m[0] for camera in (BESIDE, BEHIND)]
    figure = new_figure(3.0 * len(frames), 3.0 * (sum(shapes) + 0.5))
    figure.suptitle(title, fontsize=12)
    columns = figure.subplots(3, len(frames), squeeze=False, height_ratios=(*shapes, 0.32)).T
    for index, (frame, axes) in enumerate(zip(frames, columns, strict=True)):
        axes[0].set_title(captions[index] if captions else f"{frame.time_s:.1f} s", fontsize=10)
        picture.look(axes[0], frame, BESIDE)
        picture.look(axes[1], frame, BEHIND)
        picture.loads(axes[2], frame, labelled=index == 0)
    return save(figure, path)


def animate(
    frames: Sequence[Frame],
    terrain: Terrain,
    path: Path,
    title: str = "",
    vehicle: VehicleConfig | None = None,
    frames_per_s: int = 10,
) -> Path:
    """Draw every frame into a GIF. Take some hundred frames at most: each costs a tenth of a second."""
    from matplotlib.animation import PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    picture = _Picture(vehicle or load_vehicle("tiger"), terrain)
    figure = Figure(figsize=(7.2, 3.9))
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = PillowWriter(fps=frames_per_s)
    with writer.saving(figure, path, dpi=80):
        for frame in frames:
            _compose(figure, picture, frame, title)
            writer.grab_frame()
    return path


def evenly(frames: Sequence[Frame], count: int) -> list[Frame]:
    """Return `count` frames at even distances, the first and the last among them."""
    return [frames[round(index)] for index in np.linspace(0, len(frames) - 1, count)]


def _compose(figure: Figure, picture: _Picture, frame: Frame, title: str) -> None:
    figure.clear()
    figure.suptitle(f"{title}   {frame.time_s:5.1f} s".strip(), fontsize=11)
    picture.look(figure.add_axes((0.01, 0.02, 0.60, 0.90)), frame, BESIDE)
    picture.look(figure.add_axes((0.62, 0.46, 0.37, 0.46)), frame, BEHIND)
    picture.loads(figure.add_axes((0.69, 0.10, 0.29, 0.30)), frame, labelled=True)


class _Picture:
    """What all pictures of one robot on one terrain share."""

    def __init__(self, vehicle: VehicleConfig, terrain: Terrain) -> None:
        self._robot = _RobotShape(vehicle)
        self._terrain = terrain

    def look(self, axes: Axes, frame: Frame, camera: Camera) -> None:
        """Draw robot and ground as the camera sees them; it follows the robot and turns with it."""
        yaw = frame.attitude_rad[2]
        ground = _ground_faces(self._terrain, frame.position_m[:2])
        level = float(self._terrain.at(*frame.position_m[:2])[0])
        centre = np.array([*frame.position_m[:2], level + 0.5 * (frame.position_m[2] - level)])
        _paint(axes, [*ground, *self._robot.faces(frame)], camera, centre, yaw)
        width, height = camera.view_m
        axes.set_xlim(-0.5 * width, 0.5 * width)
        axes.set_ylim(-0.5 * height, 0.5 * height)
        axes.set_aspect("equal")
        axes.set_axis_off()

    def loads(self, axes: Axes, frame: Frame, labelled: bool) -> None:
        """Draw the four wheel loads beside those of the empty robot at rest on level ground."""
        at_rest = self._robot.load_at_rest_n
        colours = [HANGING if hangs else TYRE for hangs in self._robot.hanging(frame)]
        axes.bar(range(4), frame.wheel_load_n, color=colours, width=0.65)
        axes.hlines(at_rest, np.arange(4) - 0.4, np.arange(4) + 0.4, color=ACTUATOR, lw=1.5)
        axes.set_xticks(range(4), CORNERS, fontsize=8)
        axes.set_ylim(0.0, 2.2 * max(at_rest))
        axes.tick_params(axis="y", labelsize=7, labelleft=labelled)
        axes.spines[["top", "right"]].set_visible(False)
        if labelled:
            axes.set_ylabel("wheel load (N)", fontsize=8)


class _RobotShape:
    """The faces of the robot in a frame."""

    def __init__(self, vehicle: VehicleConfig) -> None:
        assert vehicle.eam is not None
        assert vehicle.actuator.kind == "rate"
        parameters = FullCarParameters.from_config(vehicle)
        eam = Eam.from_vehicle(vehicle)
        self._payload = vehicle.payload
        self._x_m = parameters.corner_positions_m()[:, 0]
        self._spring_npm = parameters.spring_npm()
        self.load_at_rest_n = parameters.static_tire_load_n()
        self._radius_m = vehicle.tire.rolling_radius_m
        self._wheel_z_m = self._radius_m - vehicle.body.com_height_m  # below the COM at rest in mid-stroke

        strokes = np.linspace(0.0, vehicle.actuator.stroke_max_mm, 36)
        q = eam.assemble(strokes)
        self._strokes_mm, self._rise_m = strokes, 1e-3 * eam.pose(strokes).rise_mm
        self._mid_rise_m = float(np.interp(0.5 * vehicle.actuator.stroke_max_mm, strokes, self._rise_m))
        self._rocker_rad = q[:, 5]
        clearance_m = 1e-3 * float(
            np.interp(0.5 * vehicle.actuator.stroke_max_mm, strokes, eam.pose(strokes).ground_clearance_mm)
        )
        mechanism = vehicle.eam
        self._mechanism = mechanism
        self._pivot_m = np.array(
            [1e-3 * mechanism.arm_pivot_from_midplane_mm, clearance_m - vehicle.body.com_height_m]
        )

    def hanging(self, frame: Frame) -> list[bool]:
        """Which wheels carry next to nothing."""
        pairs = zip(frame.wheel_load_n, self.load_at_rest_n, strict=True)
        return [load < HANGING_SHARE * rest for load, rest in pairs]

    def faces(self, frame: Frame) -> list[_Face]:
        """Return all faces, in the world."""
        turn = _rotation(frame.attitude_rad)
        local = [*_box((0.0, 0.0, 0.0), (BOX_LENGTH_M, BOX_WIDTH_M, BOX_HEIGHT_M), BODY), _arrow()]
        if self._payload is not None:
            x, y, z = self._payload.place_m
            bottom = max(0.5 * BOX_HEIGHT_M, z - 0.5 * PAYLOAD_M)
            local += _box((x, y, bottom + 0.5 * PAYLOAD_M), (PAYLOAD_M,) * 3, PAYLOAD)
        for corner, hangs in enumerate(self.hanging(frame)):
            local += self._corner(corner, frame, hangs)
        place = np.asarray(frame.position_m)
        return [face._replace(corners=face.corners @ turn.T + place) for face in local]

    def _corner(self, corner: int, frame: Frame, hangs: bool) -> Iterable[_Face]:
        """Rods and wheel of one corner, body axes; the mechanism lies in the plane x = axle."""
        x, side = float(self._x_m[corner]), 1.0 if corner % 2 == 0 else -1.0
        stroke = frame.stroke_mm[corner]
        lift_m = float(np.interp(stroke, self._strokes_mm, self._rise_m)) - self._mid_rise_m
        # Statics: the load beyond the one at rest has pressed the wheel up, the stroke has pushed it down.
        beyond_n = frame.wheel_load_n[corner] - self.load_at_rest_n[corner]
        wheel_z = self._wheel_z_m + beyond_n / float(self._spring_npm[corner]) - lift_m

        points = {name: np.asarray(p) for name, p in self._mechanism_m(stroke, wheel_z).items()}

        def place(point: Array) -> Array:
            return np.array([x, side * point[0], point[1]])

        up = np.array([0.0, 0.07])
        rods = [
            ("pivot", "wheel_joint", ARM, 0.0),
            ("pivot", "wheel_joint", ARM, 1.0),
            ("wheel_joint", "hub", ARM, 0.5),
            ("rocker_pivot", "rocker_actuator", ARM, 0.0),
            ("rocker_pivot", "rocker_damper", ARM, 0.0),
            ("anchor", "rocker_actuator", ACTUATOR, 0.0),
            ("rocker_damper", "damper_mount", SPRING, 0.0),
        ]
        for first, last, colour, above in rods:
            yield from _rod(place(points[first] + above * up), place(points[last] + above * up), colour)
        yield from _wheel(place(points["hub"]), self._radius_m, side, HANGING if hangs else TYRE)

    def _mechanism_m(self, stroke_mm: float, wheel_z_m: float) -> dict[str, Array]:
        """Points of the mechanism, (outboard, up) from the COM's mid-plane, for a stroke and a wheel height.

        The stroke turns the rocker; arm and wheel go where the spring lets them.
        """
        m, pivot = self._mechanism, self._pivot_m
        reach = 1e-3 * m.arm_length_mm
        arm = asin(min(1.0, max(-1.0, (wheel_z_m - float(pivot[1])) / reach)))
        rocker = float(np.interp(stroke_mm, self._strokes_mm, self._rocker_rad))
        rocker_pivot = pivot + 1e-3 * np.array(m.rocker_pivot_mm)
        along, across = (1e-3 * value for value in m.damper_mount_mm)
        joint = pivot + reach * _direction(arm)
        return {
            "pivot": pivot,
            "wheel_joint": joint,
            "hub": joint + np.array([1e-3 * m.hub_offset_mm, 0.0]),
            "rocker_pivot": rocker_pivot,
            "rocker_actuator": rocker_pivot + 1e-3 * m.rocker_actuator_arm_mm * _direction(rocker),
            "rocker_damper": rocker_pivot
            + 1e-3 * m.rocker_damper_arm_mm * _direction(rocker + m.rocker_angle_rad),
            "anchor": pivot + 1e-3 * np.array(m.actuator_anchor_mm),
            "damper_mount": pivot + along * _direction(arm) + across * _direction(arm + 0.5 * pi),
        }


# ---- shapes -------------------------------------------------


def _ground_faces(terrain: Terrain, centre_m: tuple[float, float]) -> list[_Face]:
    """Squares of the ground around the robot. They stay where they are in the world as it drives."""
    lines = [_grid_lines(centre, size) for centre, size in zip(centre_m, PATCH_M, strict=True)]
    height, _, _ = terrain.at(lines[0][:, None], lines[1][None, :])
    points = np.stack([*np.meshgrid(*lines, indexing="ij"), height], axis=-1)
    # Chequered, two squares to a field, so that one sees how far it went.
    fields = [np.floor(0.5 * (line[:-1] + line[1:]) / (2.0 * GROUND_SPACING_M)) for line in lines]
    faces = []
    for i, row in enumerate(fields[0]):
        for j, column in enumerate(fields[1]):
            square = points[[i, i + 1, i + 1, i], [j, j, j + 1, j + 1]]
            faces.append(_Face(square, GROUND_DARK if (row + column) % 2 else GROUND, GROUND_RELIEF))
    return faces


def _grid_lines(centre_m: float, size_m: float) -> Array:
    """Places of the world's grid lines within the patch, and of its two edges."""
    first, last = centre_m - 0.5 * size_m, centre_m + 0.5 * size_m
    inside = np.arange(np.ceil(first / GROUND_SPACING_M), last / GROUND_SPACING_M) * GROUND_SPACING_M
    return np.unique(np.r_[first, inside, last])


def _box(centre: tuple[float, float, float], size: Sequence[float], colour: Colour) -> list[_Face]:
    faces = []
    for axis in range(3):
        for end in (-0.5, 0.5):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            corners = np.zeros((4, 3))
            corners[:, axis] = end * size[axis]
            corners[:, first] = np.array([-0.5, 0.5, 0.5, -0.5]) * size[first]
            corners[:, second] = np.array([-0.5, -0.5, 0.5, 0.5]) * size[second]
            faces.append(_Face(corners + np.asarray(centre), colour))
    return faces


def _arrow() -> _Face:
    """Points ahead, on the deck."""
    ahead, wide = 0.40 * BOX_LENGTH_M, 0.14 * BOX_WIDTH_M
    above = 0.5 * BOX_HEIGHT_M + 0.01
    tips = [[ahead, 0.0, above], [ahead - 0.15, wide, above], [ahead - 0.15, -wide, above]]
    return _Face(np.array(tips), ARROW, nearer_m=BOX_LENGTH_M)


def _rod(first: Array, last: Array, colour: Colour) -> list[_Face]:
    """A square rod in a plane x = const."""
    along = (last - first) / np.linalg.norm(last - first)
    across = 0.5 * ROD_M * np.array([0.0, -along[2], along[1]])
    ahead = np.array([0.5 * ROD_M, 0.0, 0.0])
    sides = [across + ahead, across - ahead, -across - ahead, -across + ahead]
    return [
        _Face(np.stack([first + a, last + a, last + b, first + b]), colour)
        for a, b in zip(sides, [*sides[1:], sides[0]], strict=True)
    ]


def _wheel(centre: Array, radius_m: float, side: float, colour: Colour) -> list[_Face]:
    angle = 2.0 * pi * np.arange(SPOKES) / SPOKES
    ring = np.stack([np.cos(angle), np.zeros(SPOKES), np.sin(angle)], axis=-1)
    width = np.array([0.0, 0.5 * TYRE_WIDTH_M, 0.0])
    outer, inner = centre + radius_m * ring + width, centre + radius_m * ring - width
    following = np.roll(np.arange(SPOKES), -1)
    faces = [
        _Face(np.stack([outer[i], outer[j], inner[j], inner[i]]), colour) for i, j in enumerate(following)
    ]
    faces += [_Face(outer, colour), _Face(inner, colour)]
    cap = centre + HUB_RADIUS_M * ring + side * 1.1 * width
    return [*faces, _Face(cap, HUB)]


# ---- projection ---------------------------------------------


def _paint(axes: Axes, faces: Sequence[_Face], camera: Camera, centre: Array, yaw_rad: float) -> None:
    """Paint the faces from far to near."""
    from matplotlib.collections import PolyCollection

    azimuth, elevation = yaw_rad + pi + radians(camera.right_of_tail_deg), radians(camera.above_horizon_deg)
    to_eye = np.array([cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)])
    right = np.array([-sin(azimuth), cos(azimuth), 0.0])
    screen = np.stack([right, np.cross(to_eye, right)], axis=-1)
    nearness = np.array([face.corners.mean(axis=0) for face in faces]) @ to_eye
    nearness += [face.nearer_m for face in faces]
    order = np.argsort(nearness, kind="stable")
    colours = _lit(faces, yaw_rad)[order]
    outlines = [(faces[i].corners - centre) @ screen for i in order]
    axes.add_collection(PolyCollection(outlines, facecolors=colours, edgecolors=colours, linewidths=0.4))


def _lit(faces: Sequence[_Face], yaw_rad: float) -> Array:
    """Colours (n, 3) of faces in a light from above that turns with the robot; both sides look alike."""
    a, b, c = np.array([face.corners[:3] for face in faces]).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    normal[:, :2] *= np.array([face.relief for face in faces])[:, None]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    light = _rotation((0.0, 0.0, yaw_rad)) @ LIGHT
    shade = AMBIENT + (1.0 - AMBIENT) * np.maximum(0.0, normal @ light)
    return np.asarray(np.minimum(1.0, shade[:, None] * np.array([face.colour for face in faces])))


def _rotation(attitude_rad: tuple[float, float, float]) -> Array:
    """Body to world of roll, pitch, yaw (eq. 5.2: Z-Y-X)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", attitude_rad[::-1]).as_matrix())


def _direction(angle_rad: float) -> Array:
    return np.array([cos(angle_rad), sin(angle_rad)])
