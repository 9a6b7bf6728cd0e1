"""Randomised roll-overs of the whole robot, each through firmware, wire and daemon; `tip_over` counts them.

TIGER itself slides before it tips on flat ground (docs/stability.md), so the body's COM is raised to 0.75 to
1.1 m and the ground grips at 0.9 to 1.2. Six ways to tip:

- *turn*: a turn at 4-7 m/s, on level ground or across a slope of up to 12 degrees;
- *downhill*: a turn while driving down a slope of 6 to 14 degrees;
- *slope*: a cross slope that grows while the robot drives along it;
- *hill*: up a hill that gets too steep;
- *brake*: braking down a slope;
- *reverse*: the last two backwards.

A seventh, *trip*, drives into a curb, and asks when the impact is flagged. The controller knows the load as
the payload estimator would: it is in its vehicle file, but for a remainder of up to 10 % of the mass and 5
cm. A run ends as soon as its outcome is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from tiger.config.robot import RobotConfig, load_robot
from tiger.config.vehicle import PayloadConfig
from tiger.daemon.wheel_check import Phase, WheelCheck
from tiger.emulation.ground import make_terrain
from tiger.emulation.scenarios import BumpConfig, DriveEvent, Scenario, Start, StepConfig, TerrainConfig
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.record import DaemonState, Mode
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.world import Truth
    from tiger.record import Record

Kind = Literal["turn", "downhill", "slope", "hill", "brake", "reverse", "trip"]
KINDS: tuple[Kind, ...] = ("turn", "downhill", "slope", "hill", "brake", "reverse", "turn")
MOTOR_NM = {
    "turn": 40.0,
    "downhill": 40.0,
    "slope": 25.0,
    "hill": 50.0,
    "brake": 50.0,
    "reverse": 50.0,
    "trip": 17.0,
}
"""TIGER's own 17 Nm are too weak to tip it: it turns too slowly at speed, and does not get up the hill."""

ARMED_S = 3.8
"""By now most are armed: drives begin."""

LONGEST_S = 11.0
STANDS_S = 1.0
"""A robot that has stood for so long after its last command is not going to tip."""
STANDS_MPS = 0.03
SEEN_S = 0.15
"""This long after an impact it has been flagged in time, or not."""


@dataclass(frozen=True, slots=True)
class Case:
    """One run: the robot as its controller knows it, and what happens to it."""

    kind: Kind
    robot: RobotConfig
    scenario: Scenario
    seed: int
    numbers: dict[str, float]
    """What was drawn, for the table of the runs."""


class Outcome(NamedTuple):
    """What became of a run; times from its start, NaN for what did not happen."""

    kind: Kind
    balance_s: float
    """COM over an edge."""
    lifted_s: float
    """Both wheels of a side or an axle in the air."""
    warned_s: float
    """Since when the warning stands, at the end."""
    tripped_s: float
    """First flagged as a trip."""
    impact_s: float
    stopped: str
    """Why the daemon stopped it, if it did."""
    transfer_error: tuple[float, float]
    """RMS error of the lateral and longitudinal load transfer while at least three wheels are loaded."""

    @property
    def tipped(self) -> bool:
        """Whether the COM got over an edge."""
        return not math.isnan(self.balance_s)


def draw(kind: Kind, seed: int) -> Case:
    """Return one random case."""
    random = np.random.default_rng([seed, *kind.encode()])
    number = {
        "com_m": random.uniform(0.75, 1.1),
        "payload_kg": random.uniform(0.0, 30.0),
        "payload_up_m": random.uniform(0.2, 0.5),
        "payload_forward_m": random.uniform(-0.15, 0.15),
        "payload_left_m": random.uniform(-0.15, 0.15),
        "friction": random.uniform(0.9, 1.2),
    }
    robot = _robot(kind, number)
    terrain, start, drive = _ground_and_drive(kind, number, random)
    scenario = Scenario(
        title=f"{kind} {seed}",
        duration_s=LONGEST_S,
        friction=number["friction"],
        payload=_remainder(number["payload_kg"], random),
        start=start,
        terrain=terrain,
        drive=drive,
    )
    return Case(kind, robot, scenario, seed, number)


def _robot(kind: Kind, number: dict[str, float]) -> RobotConfig:
    """TIGER with its COM raised, its payload in the body's figures, and limits that do not stop it first."""
    robot = load_robot(None).with_motor_current(100.0)
    return robot.model_copy(
        update={
            "vehicle": loaded(robot.vehicle, number, MOTOR_NM[kind]),
            "drive": robot.drive.model_copy(
                update={
                    "max_speed_mps": 8.0,
                    "max_yaw_rate_degps": 120.0,
                    "acceleration_mps2": 4.0 if kind in ("brake", "reverse") else 2.0,
                    "jerk_mps3": 15.0,
                    "effective_track_factor": 2.0,
                }
            ),
            # Runs of seconds: the load is the declared one.
            "stability": robot.stability.model_copy(update={"load_sigma_m": 1e-3, "load_sigma_kg": 0.1}),
            # What else would stop it before it tips: not what is measured here.
            "safety": robot.safety.model_copy(update={"max_tilt_deg": 60.0, "max_wheel_speed_rpm": 800.0}),
        }
    )


def loaded(vehicle: VehicleConfig, number: dict[str, float], motor_nm: float) -> VehicleConfig:
    """Return the vehicle with its COM at `com_m`, a payload that counts as part of the body, and motors."""
    body, mass = vehicle.body, number["payload_kg"]
    share = mass / (body.mass_kg + mass)
    x, y, z = number["payload_forward_m"], number["payload_left_m"], number["payload_up_m"]
    reduced = mass * body.mass_kg / (body.mass_kg + mass)
    assert vehicle.drive is not None
    return vehicle.model_copy(
        update={
            "drive": vehicle.drive.model_copy(update={"max_torque_nm": motor_nm}),
            "body": body.model_copy(
                update={
                    "mass_kg": body.mass_kg + mass,
                    "com_height_m": number["com_m"] + share * z,
                    "com_to_front_axle_m": body.com_to_front_axle_m - share * x,
                    "com_to_rear_axle_m": body.com_to_rear_axle_m + share * x,
                    "roll_inertia_kgm2": body.roll_inertia_kgm2 + reduced * (y * y + z * z),
                    "pitch_inertia_kgm2": body.pitch_inertia_kgm2 + reduced * (x * x + z * z),
                    "yaw_inertia_kgm2": body.yaw_inertia_kgm2 + reduced * (x * x + y * y),
                }
            ),
        }
    )


def _remainder(payload_kg: float, random: np.random.Generator) -> PayloadConfig | None:
    """What an estimator within its bars (10 % of the mass, 5 cm) may not know of the payload."""
    mass = random.uniform(0.02, 0.1) * payload_kg
    angle, off = random.uniform(0.0, 2.0 * math.pi), random.uniform(0.0, 0.05)
    if mass < 0.1:
        return None
    arm = min(off * payload_kg / mass, 0.5)
    return PayloadConfig(
        mass_kg=mass, place_m=(arm * math.cos(angle), arm * math.sin(angle), random.uniform(0.0, 0.3))
    )


def _ground_and_drive(
    kind: Kind, number: dict[str, float], random: np.random.Generator
) -> tuple[TerrainConfig, Start, tuple[DriveEvent, ...]]:
    """Draw what happens; the motion is chosen so that about two thirds tip over when nothing limits it."""
    side = 1.0 if random.random() < 0.5 else -1.0

    def events(*steps: tuple[float, float, float]) -> tuple[DriveEvent, ...]:
        return tuple(DriveEvent(at_s=t, speed_mps=v, yaw_rate_degps=r) for t, v, r in steps)

    if kind == "turn":
        speed = number["speed_mps"] = random.uniform(4.0, 7.0)
        slope = number["slope_deg"] = random.uniform(0.0, 12.0)
        lateral = number["lateral_mps2"] = random.uniform(5.0, 9.0)
        rate = math.degrees(lateral / speed) * side
        turn_s = ARMED_S + 0.5 + speed / 2.0
        # Turning to the left presses on the right wheels: the slope falls to the right.
        terrain = TerrainConfig(left_up_deg=slope * side)
        return terrain, Start(), events((ARMED_S, speed, 0.0), (turn_s, speed, rate))
    if kind == "downhill":
        speed = number["speed_mps"] = random.uniform(2.5, 5.0)
        slope = number["slope_deg"] = random.uniform(6.0, 14.0)
        lateral = number["lateral_mps2"] = random.uniform(4.0, 8.0)
        turn_s = ARMED_S + 0.5 + speed / 2.0
        rate = math.degrees(lateral / speed) * side
        return (
            TerrainConfig(climb_deg=-slope),
            Start(),
            events((ARMED_S, speed, 0.0), (turn_s, speed, rate)),
        )
    if kind == "slope":
        speed = number["speed_mps"] = random.uniform(0.9, 1.5)
        twist = number["twist_deg_per_m"] = random.uniform(5.0, 9.0)
        start = Start(x_m=math.tan(math.radians(10.0)) / math.tan(math.radians(twist)))
        return TerrainConfig(twist_deg_per_m=twist * side), start, events((ARMED_S, speed, 0.0))
    forward = -1.0 if kind == "reverse" else 1.0
    start = Start(yaw_deg=180.0) if kind == "reverse" else Start()
    if kind == "hill" or (kind == "reverse" and side > 0.0):
        speed = number["speed_mps"] = forward * random.uniform(0.6, 1.2)
        height = number["height_m"] = random.uniform(1.8, 2.8)
        hill = BumpConfig(height_m=height, start_m=0.6, length_m=9.0)
        return TerrainConfig(bump=(hill,)), start, events((ARMED_S, speed, 0.0))
    if kind in ("brake", "reverse"):
        speed = number["speed_mps"] = forward * random.uniform(2.0, 4.0)
        slope = number["slope_deg"] = random.uniform(8.0, 16.0)
        stop_s = ARMED_S + 1.5 + abs(speed) / 4.0
        return TerrainConfig(climb_deg=-slope), start, events((ARMED_S, speed, 0.0), (stop_s, 0.0, 0.0))
    speed = number["speed_mps"] = random.uniform(1.0, 3.0)
    height = number["height_m"] = random.uniform(0.06, 0.12)
    yaw = number["yaw_deg"] = random.uniform(-50.0, 50.0)
    start_m = 0.8 + 1.2 * speed * speed / 2.0 + 0.6 * speed
    curb = StepConfig(height_m=height, start_m=start_m, ramp_m=0.05)
    return TerrainConfig(step=(curb,)), Start(yaw_deg=yaw), events((ARMED_S, speed, 0.0))


def run(case: Case, limiter: str, watch: Callable[[Rig, Record], None] | None = None) -> Outcome:
    """Drive one case with `stability.limiter` on, off, or only logged, until its outcome is known.

    `watch` sees every tick of the armed robot.
    """
    robot = case.robot.model_copy(
        update={"stability": case.robot.stability.model_copy(update={"limiter": limiter})}
    )
    rig = Rig(robot, case.scenario, case.seed)
    # The heavy, high loads are more than the actuators push: they hold.
    rig.daemon.command = replace(rig.daemon.command, mode=Mode.HOLD)
    rig.daemon.arm(8.0)
    polygon = Polygon(case)
    last_s = case.scenario.drive[-1].at_s
    balance = lifted = warned = tripped = impact = math.nan
    moved_s, stopped, armed = 0.0, "", False
    errors: list[tuple[float, float]] = []
    for record in rig.run(case.scenario.duration_s):
        if not armed:
            if record.state is DaemonState.ARMED:
                armed = True
                # These top-heavy robots rock so much that the check takes their ports for swapped.
                rig.daemon._wheel_check = WheelCheck(Phase.PASSED)
            continue
        if watch is not None:
            watch(rig, record)
        if record.state is not DaemonState.ARMED and not stopped:
            stopped = "; ".join([record.reason, *map(str, rig.daemon.latched)])
        shown = record.outputs.estimate.stability
        if not shown.warning:
            warned = math.nan
        elif math.isnan(warned):
            warned = rig.time_s
        if shown.tripped and math.isnan(tripped):
            tripped = rig.time_s
        if record.tick % 2 and case.kind != "trip":
            continue
        truth = rig.robot.truth()
        if math.isnan(impact) and case.kind == "trip" and polygon.touches_curb(truth):
            impact = rig.time_s
        lateral, longitudinal, in_air = transfers(truth)
        if in_air >= 2 and math.isnan(lifted):
            lifted = rig.time_s
        if in_air < 2:
            errors.append(
                (shown.lateral_load_transfer - lateral, shown.longitudinal_load_transfer - longitudinal)
            )
        if polygon.passed(truth):
            balance = rig.time_s
            break
        if in_air or abs(truth.speed_mps) > STANDS_MPS or abs(truth.pitch_rate_degps) > 1.0:
            moved_s = rig.time_s
        if rig.time_s > max(moved_s, last_s + 1.0) + STANDS_S or rig.time_s > impact + SEEN_S:
            break
    lateral_rms, longitudinal_rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else (0.0, 0.0)
    if not armed:
        stopped = f"never armed: {rig.daemon.reason}"
    return Outcome(
        case.kind,
        balance,
        lifted,
        warned,
        tripped,
        impact,
        stopped,
        (float(lateral_rms), float(longitudinal_rms)),
    )


def transfers(truth: Truth) -> tuple[float, float, int]:
    """Lateral and longitudinal load transfer of the true loads, and how many wheels are in the air."""
    fl, fr, rl, rr = truth.wheel_load_n
    total = max(fl + fr + rl + rr, 1.0)
    lateral, longitudinal = (fl - fr + rl - rr) / total, (fl + fr - rl - rr) / total
    return lateral, longitudinal, sum(load < 1.0 for load in truth.wheel_load_n)


class Polygon:
    """Where the COM of everything is to the contacts, with all the body's weight on two wheels."""

    def __init__(self, case: Case) -> None:
        """Take the vehicle as it truly is, with the remainder of its payload."""
        vehicle, rest = case.robot.vehicle, case.scenario.payload
        body = vehicle.body
        parameters = FullCarParameters.from_config(vehicle)
        self._radius_m = vehicle.tire.rolling_radius_m
        wheel_up = self._radius_m - body.com_height_m
        corners = np.column_stack([parameters.corner_positions_m(), np.full(4, wheel_up)])
        masses = [body.mass_kg, *parameters.wheel_mass_kg()]
        places = [np.zeros(3), *corners]
        if rest is not None:
            masses.append(rest.mass_kg)
            places.append(np.array(rest.place_m))
        self._com = np.average(places, axis=0, weights=masses)
        upper = sum(masses) - float(sum(parameters.wheel_mass_kg()))
        more = upper + (rest.mass_kg if rest is not None else 0.0)
        # Springs that carry twice as much as at rest, and the remainder of the payload.
        corners[:, 2] += more * GRAVITY_MPS2 / float(sum(parameters.spring_npm()))
        self._wheels = corners[[0, 1, 3, 2]]  # round the polygon, clockwise from above
        self._terrain = make_terrain(case.scenario.terrain, body.half_track_m)
        self._curb = case.scenario.terrain.step

    def passed(self, truth: Truth) -> bool:
        """Whether the COM stands over an edge, along gravity."""
        turned = _rotation(truth)
        com = turned @ self._com
        wheels = self._wheels @ turned.T
        _, slope_x, slope_y = self._terrain.at(
            truth.position_m[0] + wheels[:, 0], truth.position_m[1] + wheels[:, 1]
        )
        steep = np.sqrt(1.0 + slope_x**2 + slope_y**2)
        on_ground = wheels[:, :2] + self._radius_m * np.column_stack([slope_x, slope_y]) / steep[:, None]
        edges = np.roll(on_ground, -1, axis=0) - on_ground
        to_com = com[:2] - on_ground
        # Clockwise, the inside is to the right of every edge; on its side the polygon is nothing.
        return bool((edges[:, 0] * to_com[:, 1] - edges[:, 1] * to_com[:, 0]).max() > 0.0)

    def touches_curb(self, truth: Truth) -> bool:
        """Whether a wheel has begun to climb the curb."""
        reach = truth.position_m[0] + (self._wheels @ _rotation(truth).T)[:, 0]
        return bool(reach.max() > self._curb[0].start_m)


def _rotation(truth: Truth) -> NDArray[np.float64]:
    """Body to world, Z-Y-X angles."""
    cr, sr = math.cos(math.radians(truth.roll_deg)), math.sin(math.radians(truth.roll_deg))
    cp, sp = math.cos(math.radians(truth.pitch_deg)), math.sin(math.radians(truth.pitch_deg))
    cy, sy = math.cos(math.radians(truth.yaw_deg)), math.sin(math.radians(truth.yaw_deg))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
