"""The limiter: the part of a speed and yaw rate command that does not bring the robot near tipping.

It asks what the command would do once carried out, not what has happened. Driving at v and r on a slope the
ground pushes with f = (a_x - g_x, v r - g_y, g_n) in its plane, per unit mass. The centre of pressure moves
by h f/g_n, and because the springs let the body lean over the wheels' centres (radius w) and gravity leans on
it, by 1/(1 - m g_n (h - w)/K) as much, K the springs' stiffness against the lean. Setting that to
`load_transfer_max` of the way to an edge bounds lateral and longitudinal acceleration; over a corner both
count, so that what a slope uses across is not there for braking, and the other way round. Where the tyres
would slide first there is no bound.

- *Curvature.* |v r| within the bound: the speed goes to where the commanded path can be driven, and until it
  is there the yaw rate is what the present speed allows.
- *Slope.* Ground that gets steeper towards the bound lowers the speed so that the axle ahead stops before it;
  from there it may go back the way it came. It does not turn into a heading that the slope does not allow.
- *Braking and speeding up* stay within the longitudinal bound.
- *After a trip* it stops.

Nothing here jumps unless the command does, and the drive's ramps follow behind.
"""

from __future__ import annotations

from math import copysign, cos, hypot, inf, sin, sqrt
from typing import TYPE_CHECKING

from tiger.control.tip_over import FRONT, LEFT, REAR, RIGHT
from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2
from tiger.record import LimitCause

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.control.tip_over import Stance

SPEED, CURVATURE, ACCELERATION = 1, 2, 4
"""Bits of `Stability.limited`."""

FARTHEST_M = 2.5
"""So far a slope that gets steeper is taken to go on."""

LEVEL = 0.25
"""Of `load_transfer_max`: below, what gets steeper is a bump."""
STOP = (0.0, 0.0)

LEAD_S = 0.25
"""So far may a limited speed run ahead of the robot's."""

ENOUGH_MPS = 0.5
"""A smaller change of speed is over before it tips anything, however sudden."""

LEAST_RIGIDITY = 0.1
"""Of 1 - c g_n: a load so high that the springs hardly carry it upright."""


@dataclass(frozen=True, slots=True)
class LimiterDesign:
    """What the limiter takes from the config, SI."""

    load_transfer_max: float
    friction_max: float
    acceleration_mps2: float
    brake_min_mps2: float
    crawl_mps: float
    crawl_radps: float
    foresight_s: float
    half_wheelbase_m: float
    trend_m: tuple[float, float]
    """Along, where driving rocks the body, and across."""


@dataclass(frozen=True, slots=True)
class LimiterState:
    """What one sample leaves to the next."""

    speed_mps: float = 0.0
    """Commanded, within the accelerations."""
    used: tuple[float, float] = (0.0, 0.0)
    """How much of the way to an edge the slope takes at rest (1: all), along and across."""
    per_m: tuple[float, float] = (0.0, 0.0)
    """How much that grows with every metre forward."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """The command as far as it is safe, and what was taken away."""

    speed_mps: float
    yaw_rate_radps: float
    limited: int = 0
    cause: LimitCause = LimitCause.NOTHING
    would_tip: bool = False
    """The command as given would bring the net force over an edge."""


def design_limiter(robot: RobotConfig) -> LimiterDesign:
    """Bring the config into SI."""
    config, body = robot.stability, robot.vehicle.body
    return LimiterDesign(
        load_transfer_max=config.load_transfer_max,
        friction_max=config.friction_max,
        acceleration_mps2=robot.drive.acceleration_mps2,
        brake_min_mps2=config.brake_min_mps2,
        crawl_mps=config.crawl_mps,
        crawl_radps=config.crawl_mps / body.half_track_m,
        foresight_s=config.foresight_s,
        half_wheelbase_m=0.5 * (body.com_to_front_axle_m + body.com_to_rear_axle_m),
        trend_m=(config.trend_along_m, config.trend_m),
    )


@dataclass(frozen=True, slots=True)
class Footing:
    """What ground and load leave, for one stance on one slope. Pairs are forward and to the left."""

    to_edge_mps2: tuple[float, float]
    """Push along the ground that brings the centre of pressure from the middle to an edge."""
    slope_mps2: tuple[float, float]
    """Gravity along the ground's plane."""
    offset_mps2: tuple[float, float]
    """The push that moves it as much as the COM's offset and the lean by the strokes do."""
    grip_mps2: float
    """The most that the tyres push along the ground."""

    def bound(self, edge: int, share: float) -> float:
        """Acceleration away from an edge that takes the centre of pressure `share` of the way to it.

        Infinite where the tyres slide before the robot tips.
        """
        axis, sign = _OUTWARD[edge]
        push, offset = self.to_edge_mps2[axis], sign * self.offset_mps2[axis]
        if push - offset > self.grip_mps2:
            return inf
        return share * push - offset - sign * self.slope_mps2[axis]

    def at_rest(self, heading_rad: float = 0.0) -> tuple[float, float]:
        """Shares of the way to an edge that are used at rest, along and across, after turning left."""
        (x, y), (offset_x, offset_y) = self.slope_mps2, self.offset_mps2
        c, s = cos(heading_rad), sin(heading_rad)
        along, across = c * x + s * y + offset_x, c * y - s * x + offset_y
        return abs(along) / self.to_edge_mps2[0], abs(across) / self.to_edge_mps2[1]


_OUTWARD = ((1, 1.0), (1, -1.0), (0, 1.0), (0, -1.0))
"""Axis and sign of each edge: LEFT, RIGHT, FRONT, REAR."""


def footing(stance: Stance, plane_rad: tuple[float, float], friction: float) -> Footing:
    """Return what a ground of slope `plane_rad` (roll, pitch) leaves to the body as its strokes lean it.

    The centre of pressure is (h f/g_n + (h - w) lean + offset)/(1 - m g_n (h - w)/K) from the middle. Leaning
    moves the COM over the wheels' centres: to the right with roll, forward with pitch.
    """
    roll, pitch = plane_rad
    normal = GRAVITY_MPS2 * cos(roll) * cos(pitch)
    per_m = normal / stance.height_m
    over_hubs = 1.0 - stance.wheel_radius_m / stance.height_m
    rigid_x = max(1.0 - over_hubs * stance.pitch_sway_s2pm * normal, LEAST_RIGIDITY)
    rigid_y = max(1.0 - over_hubs * stance.roll_sway_s2pm * normal, LEAST_RIGIDITY)
    left, right, front, rear = stance.reach_m
    lean_roll, lean_pitch = stance.strokes_rad
    return Footing(
        to_edge_mps2=(0.5 * (front + rear) * rigid_x * per_m, 0.5 * (left + right) * rigid_y * per_m),
        slope_mps2=(GRAVITY_MPS2 * sin(pitch), -GRAVITY_MPS2 * sin(roll)),
        offset_mps2=(
            0.5 * (rear - front) * per_m + over_hubs * lean_pitch * normal,
            0.5 * (right - left) * per_m - over_hubs * lean_roll * normal,
        ),
        grip_mps2=friction * normal,
    )


def step(
    design: LimiterDesign,
    state: LimiterState,
    ground: Footing,
    command: tuple[float, float],
    moving_mps: float,
    tripped: bool,
    dt: float,
) -> tuple[LimiterState, Allowed]:
    """Limit a command (speed in m/s, yaw rate in rad/s) of a robot that moves at `moving_mps`."""
    used_x, used_y = used = ground.at_rest()
    # Over a corner both ways count: what one axis uses at rest is not there for the other.
    share = design.load_transfer_max
    share_x, share_y = share * max(0.0, 1.0 - used_y), share * max(0.0, 1.0 - used_x)
    to_front, to_rear = ground.bound(FRONT, share_x), ground.bound(REAR, share_x)
    hardest = min(to_front, to_rear)
    fastest = max(abs(moving_mps), abs(state.speed_mps))

    speed, yaw = command
    limited, cause, would_tip = 0, LimitCause.NOTHING, False
    if speed and yaw:
        speed, yaw, limited, would_tip = _within_turn(design, ground, speed, yaw, fastest, share_y)
        cause = LimitCause.TURN if limited else cause

    # The slope: stop before it takes too much, go back, turn only where it takes less.
    per_m = _growth(design, state, used, moving_mps, dt)
    if speed:
        brake = min(design.acceleration_mps2, max(hardest, design.brake_min_mps2))
        top = _top_speed(design, used, per_m if speed > 0.0 else (-per_m[0], -per_m[1]), fastest, brake)
        if abs(speed) > top:
            speed, limited, cause = copysign(top, speed), limited | SPEED, LimitCause.SLOPE
    turned = _turn(design, ground, max(used), yaw) if yaw else yaw
    if turned != yaw:
        yaw, limited, cause = turned, limited | CURVATURE, LimitCause.SLOPE

    if tripped and (speed or yaw):
        speed, yaw, limited, cause = 0.0, 0.0, limited | SPEED, LimitCause.TRIP

    now = state.speed_mps
    if design.acceleration_mps2 > hardest and cause != LimitCause.SLOPE:
        # What the robot lags behind, its speed loop makes up for all the harder; a slope cannot wait.
        lead = max(design.crawl_mps, LEAD_S * hardest)
        now = min(moving_mps + lead, max(moving_mps - lead, now))
    slewed = _slew(design, now, speed, to_front, to_rear, dt)
    if slewed != speed and design.acceleration_mps2 > hardest:
        edge = FRONT if speed < slewed else REAR
        would_tip |= abs(speed - slewed) > ENOUGH_MPS and design.acceleration_mps2 > ground.bound(edge, 1.0)
        speed, limited = slewed, limited | ACCELERATION
        cause = cause or LimitCause.BRAKING
    known = LimiterState(slewed, used, per_m)
    if command == STOP and not limited & ACCELERATION:
        limited, cause = 0, LimitCause.NOTHING
    return known, Allowed(speed, yaw, limited, cause, would_tip or max(used) > 1.0)


def _within_turn(
    design: LimiterDesign, ground: Footing, speed: float, yaw: float, fastest: float, share: float
) -> tuple[float, float, int, bool]:
    """Limit a = v r, which presses on the outer edge: speed, yaw rate, what was limited, if it tips.

    The path stays what it is where less speed on it is enough; a robot that is still faster turns less.
    """
    turn, limited = abs(speed * yaw), 0
    outer = RIGHT if (speed > 0.0) == (yaw > 0.0) else LEFT
    most = max(ground.bound(outer, share), design.crawl_mps * design.crawl_radps)
    would_tip = turn > most and turn > ground.bound(outer, 1.0)
    if turn > most:
        path = sqrt(most / turn)
        speed, yaw, limited = speed * path, yaw * path, SPEED
    if fastest * abs(yaw) > most:
        yaw, limited = copysign(most / fastest, yaw), limited | CURVATURE
    return speed, yaw, limited, would_tip


def _growth(
    design: LimiterDesign, state: LimiterState, used: tuple[float, float], moving_mps: float, dt: float
) -> tuple[float, float]:
    """Follow how much the share used at rest grows with every metre forward, along and across."""
    if abs(moving_mps) <= 0.5 * design.crawl_mps:
        return state.per_m
    per_m = []
    for trend_m, before, grows, taken in zip(design.trend_m, state.used, state.per_m, used, strict=True):
        if before and before < design.load_transfer_max:
            more = taken - before if moving_mps > 0.0 else before - taken
            grows += (more - abs(moving_mps) * dt * grows) / trend_m
        per_m.append(grows)
    return per_m[0], per_m[1]


def _top_speed(
    design: LimiterDesign,
    used: tuple[float, float],
    per_m: tuple[float, float],
    fastest: float,
    brake_mps2: float,
) -> float:
    """The speed from which it stops before the slope takes more than the share; `per_m` the way it goes."""
    share, top = design.load_transfer_max, inf
    for taken, growth in zip(used, per_m, strict=True):
        # The axle ahead stands on that ground already.
        ahead = taken + max(0.0, growth) * (fastest * design.foresight_s + design.half_wheelbase_m)
        if ahead > share:
            top = min(top, 0.0 if growth > 0.0 else design.crawl_mps)
        elif taken > LEVEL * share and share - ahead < FARTHEST_M * growth:
            # With half the braking it stops before the bound.
            top = min(top, sqrt(brake_mps2 * (share - ahead) / growth))
    return top


def _turn(design: LimiterDesign, ground: Footing, used: float, yaw: float) -> float:
    """The part of a yaw rate that keeps the heading within what the slope allows."""
    share = design.load_transfer_max
    (x, y), (offset_x, offset_y) = ground.slope_mps2, ground.offset_mps2
    if hypot(x, y) + max(abs(offset_x), abs(offset_y)) < share * min(ground.to_edge_mps2):
        return yaw  # no heading is in question
    after = max(ground.at_rest(yaw * design.foresight_s))
    if after <= max(share, used):
        return yaw if used <= share else copysign(min(abs(yaw), design.crawl_radps), yaw)
    room = max(share - used, 0.0)
    return yaw * room / (after - used)


def _slew(
    design: LimiterDesign, now: float, wanted: float, to_front: float, to_rear: float, dt: float
) -> float:
    """Bring a speed to `wanted` within the accelerations allowed forward (rear edge) and backward (front)."""
    if now == wanted:
        return now
    most, least = design.acceleration_mps2, design.brake_min_mps2
    faster, slower = max(least, min(most, to_rear)), max(least, min(most, to_front))
    return min(now + faster * dt, max(now - slower * dt, wanted))
