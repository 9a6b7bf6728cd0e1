"""What happens to the emulated robot: its start, the ground, the way it drives, and planned faults.

A scenario is a TOML file, loaded by the name of one that comes with the package or by path:

    title = "One line that says what happens"
    duration_s = 60.0
    initial_stroke_mm = [35.0, 35.0, 35.0, 35.0]   # FL FR RL RR; left out: mid-stroke
    sensor_noise = true                            # false: perfect sensors
    model = "vehicle"                              # 14 DOF; "linear": 7 DOF on the plate, wheels as on stands
    friction = 0.8                                 # of every tyre; left out: the vehicle's own
    soil = "dry-sand"                              # loose ground, a preset or a file; left out: hard ground

    [start]                   # each 0 when left out
    x_m = 0.0
    y_m = 0.0
    yaw_deg = 0.0             # + turns left
    speed_mps = 0.0

    [payload]                 # a load on the body
    mass_kg = 20.0
    place_m = [0.2, 0.0, 0.2] # from the COM of the empty body: forward, left, up

    [terrain]                 # the sum of all that is given; none: level
    climb_deg = 0.0           # slope along x
    left_up_deg = 0.0         # slope along y
    twist_deg_per_m = 0.0     # how much the cross slope grows with x

    [[terrain.bump]]          # one period of height (1 - cos)/2 along x
    height_m = 0.05
    start_m = 2.0
    length_m = 1.0
    right_m = 0.0             # from y = right_m to left_m; left out: all the way
    left_m = 2.0

    [[terrain.step]]          # raised ground with smooth ramps: a curb is a short ramp without an end
    height_m = 0.05
    start_m = 2.0
    length_m = 3.0            # left out: without end
    ramp_m = 0.1

    [terrain.rough]           # rolling ground, equally rough in every direction
    roughness = "D"           # class of ISO 8608, A to H
    size_m = [60.0, 20.0]     # from x = 0, on both sides of y = 0; the rim's height goes on beyond
    shortest_wave_m = 1.0
    seed = 1

    [[terrain.slippery]]      # a patch of less friction; patches that overlap multiply
    friction_factor = 0.2     # of the tyres' friction
    start_m = 4.0             # from x = start_m over length_m
    length_m = 3.0            # left out: without end
    right_m = -1.0            # from y = right_m to left_m; left out: all the way
    left_m = 1.0

    [terrain.road]            # a random road of ISO 8608 from x = 0, one profile under each wheel track
    roughness = "C"
    length_m = 100.0
    seed = 1

    [[drive]]                 # the drive that `tiger run --emulate` commands from a time on, once armed
    at_s = 5.0
    speed_mps = 0.5
    yaw_rate_degps = 0.0

    [[waypoint]]              # or: places to drive to, one after the other, from route.at_s on
    x_m = 5.0                 # in the world, as start
    y_m = 0.0
    speed_mps = 1.0           # on the way there

    [route]                   # how the waypoints are followed
    at_s = 5.0
    laps = 1                  # once the last is reached, on to the first again
    max_yaw_rate_degps = 30.0 # in bends it slows down rather than turn faster
    lookahead_m = 1.2         # the point on the way that it steers at is so far ahead
    steer_by = "truth"        # "odometry": by what the robot believes, which then shows in where it goes

    [[plate]]                 # a raised-cosine ramp from wherever the axis stands to `to_deg`, then held
    axis = "roll"             # roll (+ = left side up) or pitch (+ = nose down)
    at_s = 5.0
    to_deg = 5.0
    over_s = 0.3

    [[plate]]                 # a harmonic about wherever the axis stands, for `for_s` (left out: to the end)
    axis = "roll"
    at_s = 30.0
    amplitude_deg = 2.0
    frequency_hz = 0.05
    phase_deg = 0.0           # 0: starts going up; at the end the angle returns to where it stood

    [[fault]]                 # a planned failure; docs/scenarios.md lists targets and kinds
    at_s = 10.0
    target = "suspension"
    kind = "silence"
    for_s = 1.0               # left out: for good
    value = 20.0              # for kinds that need one

Segments of one axis must not overlap; between them the axis stands still.
"""

from __future__ import annotations

from bisect import bisect_right
from importlib import resources
from itertools import pairwise
from math import cos, inf, pi, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tiger.config import toml
from tiger.config.errors import ConfigError
from tiger.config.vehicle import PayloadConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.config.robot import DriveControlConfig

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Angle = Annotated[float, Field(ge=-45.0, le=45.0, strict=True)]
Roughness = Literal["A", "B", "C", "D", "E", "F", "G", "H"]
Seed = Annotated[int, Field(ge=0, strict=True)]

FAR_M = 1e6
"""Beyond where any robot gets: a feature without an end."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PlateSegment(_Section):
    """One motion of one axis of the plate: a ramp or a harmonic."""

    axis: Literal["roll", "pitch"]
    at_s: NonNegative
    to_deg: Angle | None = None
    over_s: Positive | None = None
    amplitude_deg: Angle | None = None
    frequency_hz: Positive | None = None
    phase_deg: Finite = 0.0
    for_s: Positive | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        ramp = (self.to_deg, self.over_s)
        harmonic = (self.amplitude_deg, self.frequency_hz)
        is_ramp = None not in ramp and harmonic == (None, None) and self.for_s is None
        is_harmonic = None not in harmonic and ramp == (None, None)
        if not (is_ramp or is_harmonic):
            raise ValueError(
                "a segment is a ramp (to_deg and over_s) or a harmonic (amplitude_deg and frequency_hz, "
                "perhaps phase_deg and for_s); give the keys of one of them"
            )
        return self

    @property
    def end_s(self) -> float:
        """When the motion is over; infinite for a harmonic without `for_s`."""
        if self.over_s is not None:
            return self.at_s + self.over_s
        return inf if self.for_s is None else self.at_s + self.for_s

    @property
    def name(self) -> str:
        """How errors call this segment."""
        return f"{self.axis} segment at {self.at_s:g} s"


class Start(_Section):
    """Where the robot stands or rolls at the start."""

    x_m: Finite = 0.0
    y_m: Finite = 0.0
    yaw_deg: Finite = 0.0
    speed_mps: Finite = 0.0


class BumpConfig(_Section):
    """One period of height (1 - cos)/2 along x, between two sides."""

    height_m: Finite
    start_m: Finite
    length_m: Positive
    right_m: Finite = -FAR_M
    left_m: Finite = FAR_M


class StepConfig(BumpConfig):
    """Raised ground with smooth ramps at both ends."""

    length_m: Positive = FAR_M
    ramp_m: NonNegative = 0.1


class SlipperyConfig(_Section):
    """A rectangle where the tyres have only a part of their friction."""

    friction_factor: Annotated[float, Field(gt=0.0, le=1.0, strict=True)]
    start_m: Finite
    length_m: Positive = FAR_M
    right_m: Finite = -FAR_M
    left_m: Finite = FAR_M

    @model_validator(mode="after")
    def _has_an_area(self) -> Self:
        if self.right_m >= self.left_m:
            raise ValueError(
                f"right_m = {self.right_m:g} must be below left_m = {self.left_m:g}: y grows to the left; "
                "exchange them"
            )
        return self


class RoughConfig(_Section):
    """Isotropic rough ground of a class of ISO 8608."""

    roughness: Roughness
    size_m: tuple[Positive, Positive] = (60.0, 20.0)
    shortest_wave_m: Positive = 1.0
    seed: Seed = 0


class RoadConfig(_Section):
    """A random road of ISO 8608, the same across each half."""

    roughness: Roughness
    length_m: Positive = 100.0
    seed: Seed = 0


class TerrainConfig(_Section):
    """The ground: a sum of a plane, features, and rough ground or a road."""

    climb_deg: Angle = 0.0
    left_up_deg: Angle = 0.0
    twist_deg_per_m: Angle = 0.0
    bump: tuple[BumpConfig, ...] = ()
    step: tuple[StepConfig, ...] = ()
    slippery: tuple[SlipperyConfig, ...] = ()
    rough: RoughConfig | None = None
    road: RoadConfig | None = None

    @model_validator(mode="after")
    def _one_height_field(self) -> Self:
        if self.rough is not None and self.road is not None:
            raise ValueError("there is one height field: give [terrain.rough] or [terrain.road], not both")
        return self


class DriveEvent(_Section):
    """A speed and yaw rate commanded from a time on."""

    at_s: NonNegative
    speed_mps: Finite = 0.0
    yaw_rate_degps: Finite = 0.0


class Waypoint(_Section):
    """A place to drive to."""

    x_m: Finite
    y_m: Finite
    speed_mps: Positive


class RouteConfig(_Section):
    """How waypoints are followed."""

    at_s: NonNegative = 5.0
    laps: Annotated[int, Field(ge=1, strict=True)] = 1
    lookahead_m: Annotated[float, Field(ge=0.3, le=20.0, strict=True)] = 1.2
    max_yaw_rate_degps: Positive = 30.0
    steer_by: Literal["truth", "odometry"] = "truth"


class FaultEvent(_Section):
    """A planned failure; `emulation.faults` knows the targets and kinds."""

    at_s: NonNegative
    target: str
    kind: str
    for_s: Positive | None = None
    value: Finite | None = None


class Scenario(_Section):
    """One run of the emulated robot."""

    title: str
    duration_s: Positive
    initial_stroke_mm: tuple[NonNegative, NonNegative, NonNegative, NonNegative] | None = None
    sensor_noise: bool = True
    model: Literal["vehicle", "linear"] = "vehicle"
    friction: Positive | None = None
    soil: str | None = None
    start: Start = Start()
    payload: PayloadConfig | None = None
    terrain: TerrainConfig = TerrainConfig()
    plate: tuple[PlateSegment, ...] = ()
    drive: tuple[DriveEvent, ...] = ()
    waypoint: tuple[Waypoint, ...] = ()
    route: RouteConfig = RouteConfig()
    fault: tuple[FaultEvent, ...] = ()

    @model_validator(mode="after")
    def _segments_do_not_overlap(self) -> Self:
        for axis in ("roll", "pitch"):
            segments = self.segments(axis)
            for first, second in pairwise(segments):
                if second.at_s < first.end_s:
                    raise ValueError(
                        f"the {second.name} starts before the {first.name} ends ({first.end_s:g} s); "
                        "move it, or shorten the first"
                    )
        return self

    @model_validator(mode="after")
    def _linear_model_stands(self) -> Self:
        for name in ("friction", "soil", "start", "payload", "terrain", "waypoint"):
            if self.model == "linear" and getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(
                    f'{name} means nothing to model = "linear", which stands on a plate; '
                    'leave it out, or use model = "vehicle"'
                )
        return self

    @model_validator(mode="after")
    def _soil_has_its_own_friction(self) -> Self:
        if self.soil is not None and self.terrain.slippery:
            raise ValueError(
                "[[terrain.slippery]] means nothing on loose ground, whose shear strength is the soil's; "
                "leave out soil, or the patches"
            )
        return self

    @model_validator(mode="after")
    def _one_way_to_drive(self) -> Self:
        if self.waypoint and self.drive:
            raise ValueError(
                "a scenario drives by [[drive]] or by [[waypoint]], not by both; remove one of them"
            )
        if not self.waypoint and self.route != RouteConfig():
            raise ValueError("[route] says how waypoints are followed, and there are none: add [[waypoint]]")
        for first, second in pairwise(self.waypoint):
            if (first.x_m, first.y_m) == (second.x_m, second.y_m):
                raise ValueError(
                    f"two waypoints in a row are at ({first.x_m:g}, {first.y_m:g}) m; remove one of them"
                )
        return self

    @model_validator(mode="after")
    def _drive_in_order(self) -> Self:
        for first, second in pairwise(self.drive):
            if second.at_s <= first.at_s:
                raise ValueError(
                    f"the drive at {second.at_s:g} s does not come after the one at {first.at_s:g} s; "
                    "put them in the order of time"
                )
        return self

    def segments(self, axis: str) -> tuple[PlateSegment, ...]:
        """Motions of one axis in the order of time."""
        return tuple(sorted((s for s in self.plate if s.axis == axis), key=lambda s: s.at_s))


class PlateAxis:
    """Angle of one axis of the plate as a function of time."""

    def __init__(self, segments: tuple[PlateSegment, ...]) -> None:
        """Take the motions of one axis, in the order of time and apart from each other."""
        self._segments = segments
        self._starts = [segment.at_s for segment in segments]
        self._from_rad: list[float] = []
        stands = 0.0
        for segment in segments:
            self._from_rad.append(stands)
            if segment.to_deg is not None:
                stands = radians(segment.to_deg)
        self._ends = [segment.end_s for segment in segments]

    def angle_rad(self, time_s: float) -> float:
        """Return the angle at a time."""
        index = bisect_right(self._starts, time_s) - 1
        if index < 0:
            return 0.0
        segment, start = self._segments[index], self._from_rad[index]
        since = time_s - self._starts[index]
        over = time_s >= self._ends[index]
        if segment.to_deg is not None and segment.over_s is not None:
            end = radians(segment.to_deg)
            return end if over else start + (end - start) * 0.5 * (1.0 - cos(pi * since / segment.over_s))
        assert segment.amplitude_deg is not None
        assert segment.frequency_hz is not None
        if over:
            return start
        phase = 2.0 * pi * segment.frequency_hz * since + radians(segment.phase_deg)
        return start + radians(segment.amplitude_deg) * sin(phase)


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    folder = resources.files("tiger.emulation") / "scenarios"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml")))


def load_scenario(name_or_path: str | Path, drive: DriveControlConfig | None = None) -> Scenario:
    """Load a scenario by name, or a TOML file by path (a name that ends in .toml or has a slash is a path).

    With the robot's `drive`, a drive beyond its limits is refused too: the robot would quietly drive slower.
    Raises ConfigError: one line per wrong key, with the key's path, the value, the limit and the next step.
    """
    try:
        scenario = Scenario.model_validate(_read(name_or_path))
    except ValidationError as error:
        raise ConfigError.from_validation(error, str(name_or_path)) from error
    wrong = [] if drive is None else [f"{name_or_path}: {text}" for text in _beyond(scenario, drive)]
    if wrong:
        raise ConfigError(wrong)
    return scenario


def _beyond(scenario: Scenario, drive: DriveControlConfig) -> Iterator[str]:
    """What a scenario's drive asks for beyond the robot's limits."""
    asked = [
        (f"{table}.{number}.{key}", value, key)
        for table, events in (("drive", scenario.drive), ("waypoint", scenario.waypoint))
        for number, event in enumerate(events)
        for key in ("speed_mps", "yaw_rate_degps")
        if (value := getattr(event, key, None)) is not None
    ]
    if scenario.waypoint:
        asked.append(("route.max_yaw_rate_degps", scenario.route.max_yaw_rate_degps, "yaw_rate_degps"))
    most = {"speed_mps": drive.max_speed_mps, "yaw_rate_degps": drive.max_yaw_rate_degps}
    for where, value, key in asked:
        if abs(value) > most[key]:
            yield (
                f"{where} = {value:g}: is beyond ±{most[key]:g}, drive.max_{key} of the robot; "
                "ask for less, or raise that in its robot.toml"
            )


def _read(name_or_path: str | Path) -> dict[str, Any]:
    source = str(name_or_path)
    if toml.is_path(name_or_path):
        return toml.read(name_or_path)
    if source in scenario_names():
        packaged = resources.files("tiger.emulation") / "scenarios" / f"{source}.toml"
        return toml.parsed(packaged.read_text(encoding="utf-8"), source)
    raise ConfigError(
        f"scenario {source!r} is not known; use one of {', '.join(scenario_names())}, "
        "or give a path to a .toml file"
    )
