"""What the strokes can reach, and how fast: the geometry of quasi-static attitude control.

Slow self-locking actuators set the static attitude of the body relative to the wheels. A body plane of ride
r, roll phi and pitch theta needs the lifts r + y_i phi - x_i theta (4.8); the four strokes span a fourth
motion, warp, that twists the body's seats against each other and moves it nowhere. Lifts are in mm above zero
stroke.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

from tiger.frozen import dataclass
from tiger.models.eam import Eam, LiftCurve
from tiger.models.full_car import FullCarParameters

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.record import Four

WARP: Four = (1.0, -1.0, -1.0, 1.0)
"""Sign of each corner in a twist of the four lifts."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Attitude and ride of the body relative to its wheels, and the twist of the four lifts."""

    roll_rad: float
    pitch_rad: float
    ride_mm: float
    warp_mm: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Suspension:
    """Geometry, stroke range and speed of the four actuators; corners are in mm from the centre of mass."""

    curve: LiftCurve
    x_mm: Four
    y_mm: Four
    stroke_low_mm: float
    stroke_high_mm: float
    rate_mmps: float
    lift_low_mm: float
    """Lift at the lowest stroke in use."""
    lift_high_mm: float
    """Lift at the highest stroke in use."""

    @classmethod
    def from_config(cls, robot: RobotConfig) -> Suspension:
        """Read the geometry. Solves the mechanism once (some milliseconds)."""
        corners = 1000.0 * FullCarParameters.from_config(robot.vehicle).corner_positions_m()
        low, high = robot.stroke_range_mm
        x, y = corners.T.tolist()
        curve = Eam.from_vehicle(robot.vehicle).curve()
        (lift_low, _), (lift_high, _) = curve.at(low), curve.at(high)
        rate = robot.actuator.max_rate_mmps
        return cls(curve, tuple(x), tuple(y), low, high, rate, lift_low, lift_high)

    def pose(self, lift_mm: Four) -> Pose:
        """Return the plane through four lifts (least squares), and their warp."""
        fl, fr, rl, rr = lift_mm
        ahead, behind, half = self.x_mm[0], -self.x_mm[2], self.y_mm[0]
        front, rear = 0.5 * (fl + fr), 0.5 * (rl + rr)
        wheelbase = ahead + behind
        return Pose(
            roll_rad=(fl - fr + rl - rr) / (4.0 * half),
            pitch_rad=(rear - front) / wheelbase,
            ride_mm=(front * behind + rear * ahead) / wheelbase,
            warp_mm=0.25 * (fl - fr - rl + rr),
        )

    def lifts_mm(self, pose: Pose) -> Four:
        """Return the lifts of a pose."""
        (x_fl, x_fr, x_rl, x_rr), (y_fl, y_fr, y_rl, y_rr) = self.x_mm, self.y_mm
        roll, pitch, ride, warp = pose.roll_rad, pose.pitch_rad, pose.ride_mm, pose.warp_mm
        return (
            ride + y_fl * roll - x_fl * pitch + warp,
            ride + y_fr * roll - x_fr * pitch - warp,
            ride + y_rl * roll - x_rl * pitch - warp,
            ride + y_rr * roll - x_rr * pitch + warp,
        )

    def reachable(self, roll_rad: float, pitch_rad: float) -> bool:
        """Tell whether some ride height allows this attitude relative to the wheels."""
        nearest = self.nearest(roll_rad, pitch_rad)
        return math.isclose(nearest[0], roll_rad, abs_tol=1e-9) and math.isclose(
            nearest[1], pitch_rad, abs_tol=1e-9
        )

    def nearest(self, roll_rad: float, pitch_rad: float, warp_mm: float = 0.0) -> tuple[float, float]:
        """Return the reachable roll and pitch relative to the wheels with the least error to those given.

        The reachable set is the rhombus roll/roll_max + pitch/pitch_max <= 1: all four corners of a plane
        must find their lift in one range. This is the projection on it. A twist cuts its corners off: with it
        the wheels of one side, or of one axle, are 2 (|y roll| + |warp|) or 2 (|x pitch| + |warp|) apart.
        """
        span = self.lift_high_mm - self.lift_low_mm
        if warp_mm != 0.0:
            room = max(0.0, 0.5 * span - abs(warp_mm))
            most_roll, most_pitch = room / self.y_mm[0], 2.0 * room / (self.x_mm[0] - self.x_mm[2])
            roll_rad = min(most_roll, max(-most_roll, roll_rad))
            pitch_rad = min(most_pitch, max(-most_pitch, pitch_rad))
        # Highest and lowest corner of the plane are 2 half_track |roll| + wheelbase |pitch| apart.
        across, along = 2.0 * self.y_mm[0], self.x_mm[0] - self.x_mm[2]
        excess = across * abs(roll_rad) + along * abs(pitch_rad) - span
        if excess <= 0.0:
            return roll_rad, pitch_rad
        step = excess / (across**2 + along**2)
        roll, pitch = abs(roll_rad) - step * across, abs(pitch_rad) - step * along
        if roll < 0.0:
            roll, pitch = 0.0, span / along
        elif pitch < 0.0:
            roll, pitch = span / across, 0.0
        return math.copysign(roll, roll_rad), math.copysign(pitch, pitch_rad)

    @property
    def warp_most_mm(self) -> float:
        """The most twist, to either side, of a body that is level to its wheels."""
        return 0.5 * (self.lift_high_mm - self.lift_low_mm)

    def ride_range_mm(self, roll_rad: float, pitch_rad: float, warp_mm: float = 0.0) -> tuple[float, float]:
        """Return the lowest and highest ride that leave a reachable attitude and twist their lifts."""
        tilt = self.lifts_mm(Pose(roll_rad, pitch_rad, 0.0, warp_mm))
        return self.lift_low_mm - min(tilt), self.lift_high_mm - max(tilt)

    def limits(self) -> tuple[float, float]:
        """Return the largest roll and the largest pitch in rad, each alone."""
        return self.nearest(math.pi, 0.0)[0], self.nearest(0.0, math.pi)[1]


@lru_cache(maxsize=4)
def seats(suspension: Suspension, stroke_mm: Four) -> tuple[Four, Four]:
    """Return the lift of the four seats in mm, and their motion ratios; a tick asks several times."""
    at, (fl, fr, rl, rr) = suspension.curve.at, stroke_mm
    (lift_fl, ratio_fl), (lift_fr, ratio_fr) = at(fl), at(fr)
    (lift_rl, ratio_rl), (lift_rr, ratio_rr) = at(rl), at(rr)
    return (lift_fl, lift_fr, lift_rl, lift_rr), (ratio_fl, ratio_fr, ratio_rl, ratio_rr)


def rate_bound_s(suspension: Suspension, stroke_mm: Four, roll_rad: float, pitch_rad: float) -> float:
    """Return the least time in which any controller turns the body by roll and pitch from the present
    strokes.

    All that limits it is the actuators' speed and the ends of their stroke: no lag, no delay, ride height
    free. Pass the turn less the band that counts as arrived. Infinite when the turn is out of reach.
    """
    lift, _ = seats(suspension, stroke_mm)
    tilt = suspension.lifts_mm(Pose(roll_rad, pitch_rad, 0.0))

    def possible(time_s: float) -> bool:
        """Is there a change of ride with which every corner's target is within its reach after this time?"""
        way = suspension.rate_mmps * time_s
        lowest, highest = -math.inf, math.inf
        for at, stroke, turn in zip(lift, stroke_mm, tilt, strict=True):
            low = suspension.curve.at(max(stroke - way, 0.0))[0] - at
            high = suspension.curve.at(min(stroke + way, suspension.curve.stroke_max_mm))[0] - at
            lowest, highest = max(lowest, low - turn), min(highest, high - turn)
        return lowest <= highest

    short, long = 0.0, suspension.curve.stroke_max_mm / suspension.rate_mmps
    if not possible(long):
        return math.inf
    while long - short > 1e-6:
        middle = 0.5 * (short + long)
        short, long = (short, middle) if possible(middle) else (middle, long)
    return long
