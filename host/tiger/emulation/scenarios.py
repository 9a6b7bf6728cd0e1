"""What happens to the emulated robot: its start, the motion of the plate it stands on, and planned faults.

A scenario is a TOML file, loaded by the name of one that comes with the package or by path:

    title = "One line that says what happens"
    duration_s = 60.0
    initial_stroke_mm = [35.0, 35.0, 35.0, 35.0]   # FL FR RL RR; left out: mid-stroke
    sensor_noise = true                            # false: perfect sensors

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

    [[fault]]                 # reserved: planned failures, carried out by the emulated robot
    at_s = 10.0
    target = "mega_suspension"
    kind = "silence"
    for_s = 1.0               # left out: for good
    value = 0.0               # what the kind needs, if anything

Segments of one axis must not overlap; between them the axis stands still.
"""

from __future__ import annotations

import tomllib
from bisect import bisect_right
from importlib import resources
from itertools import pairwise
from math import cos, inf, pi, radians, sin
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tiger.config.errors import ConfigError

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Angle = Annotated[float, Field(ge=-45.0, le=45.0, strict=True)]


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


class FaultEvent(_Section):
    """A planned failure; the emulated robot knows the targets and kinds."""

    at_s: NonNegative
    target: str
    kind: str
    for_s: Positive | None = None
    value: Finite = 0.0


class Scenario(_Section):
    """One run of the emulated robot."""

    title: str
    duration_s: Positive
    initial_stroke_mm: tuple[NonNegative, NonNegative, NonNegative, NonNegative] | None = None
    sensor_noise: bool = True
    plate: tuple[PlateSegment, ...] = ()
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


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Load a scenario by name, or a TOML file by path (a name that ends in .toml or has a slash is a path).

    Raises ConfigError: one line per wrong key, with the key's path, the value, the limit and the next step.
    """
    try:
        return Scenario.model_validate(_read(name_or_path))
    except ValidationError as error:
        raise ConfigError.from_validation(error, str(name_or_path)) from error


def _read(name_or_path: str | Path) -> dict[str, Any]:
    source = str(name_or_path)
    if isinstance(name_or_path, Path) or source.endswith(".toml") or "/" in source:
        try:
            text = Path(name_or_path).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{source}: cannot be read ({error}); check the path") from error
    elif source in scenario_names():
        folder = resources.files("tiger.emulation") / "scenarios"
        text = (folder / f"{source}.toml").read_text(encoding="utf-8")
    else:
        raise ConfigError(
            f"scenario {source!r} is not known; use one of {', '.join(scenario_names())}, "
            "or give a path to a .toml file"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source}: is not valid TOML ({error}); correct that line") from error
