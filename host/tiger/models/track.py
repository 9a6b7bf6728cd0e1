"""Half the track at each wheel: the vehicle's at half stroke, changed by the mechanism as the strokes go.

A swinging arm carries its wheel in as it raises the body (docs/eam.md). The vehicle's `half_track_m` is that
of a robot at half stroke, where a tape measures it; of the mechanism only what the strokes change counts.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.vehicle import RateActuatorConfig
from tiger.frozen import dataclass
from tiger.models.eam import Eam, MechanismError

if TYPE_CHECKING:
    from tiger.config.vehicle import VehicleConfig
    from tiger.record import Four

_POINTS = 29


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Distances of the wheels' mid-planes from the vehicle's; ask `track_of` for one."""

    half_m: tuple[float, ...]
    """At equal steps of the stroke from 0 to `stroke_max_mm`."""
    stroke_max_mm: float

    def half_at(self, stroke_mm: float) -> float:
        """Return half the track in m at one wheel."""
        last = len(self.half_m) - 1
        place = min(max(stroke_mm / self.stroke_max_mm, 0.0), 1.0) * last
        index = min(int(place), last - 1)
        low = self.half_m[index]
        return low + (place - index) * (self.half_m[index + 1] - low)


@lru_cache(maxsize=8)
def track_of(vehicle: VehicleConfig) -> Track:
    """Return the track of a vehicle over its strokes. Raises MechanismError if it has no mechanism."""
    actuator = vehicle.actuator
    if not isinstance(actuator, RateActuatorConfig):
        raise MechanismError("this vehicle has no strokes that could change its track")
    most_mm = actuator.stroke_max_mm
    strokes = np.linspace(0.0, most_mm, _POINTS)
    eam = Eam.from_vehicle(vehicle)
    change_mm = eam.pose(strokes).track_mm - eam.pose(0.5 * most_mm).track_mm
    return Track(tuple((vehicle.body.half_track_m + change_mm / 2000.0).tolist()), most_mm)


@lru_cache(maxsize=4)
def half_tracks_m(track: Track, stroke_mm: Four) -> Four:
    """Return half the track at each wheel; one tick asks several times."""
    fl, fr, rl, rr = stroke_mm
    return track.half_at(fl), track.half_at(fr), track.half_at(rl), track.half_at(rr)
