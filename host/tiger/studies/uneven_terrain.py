"""Figure 4.12: driving over uneven terrain at fixed speeds, the suspension levelling the body or holding.

The whole stack takes part: firmware, wire, daemon and the emulated robot on rolling ground, in virtual time.
The figure prints curves and no numbers. The yardstick is what actuators of 9.4 mm/s can do at all:

- the bound: the rate-limited motion that is nearest to the ground under the wheels over the whole ride, all
  of it known beforehand, no lag (`control.rate_limited`);
- the bound without foresight: the same over the next moments again and again, from the ground that the wheels
  have touched. The rear wheels' next metre is known from the front ones, the front wheels' is not;
- the same with the delay that the robot has: of the setpoint on its way, and of the actuators. This is the
  least that can be done with foresight from passed ground only; how near the robot comes to it is a row.

All as shares: what is left of the slope under the wheels, in the RMS. The robot's share is what its body
rolls and pitches with the suspension levelling, over what it does with the strokes held. A body does more
than its ground, so the first bound is also given for what the passive body does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.robot import load_robot
from tiger.control.attitude import design_leveling
from tiger.control.rate_limited import distance_to_optimum, nearest_motion
from tiger.emulation.ground import make_terrain
from tiger.emulation.scenarios import RoughConfig, Roughness, Scenario, Start, TerrainConfig
from tiger.record import STILL, Command, DaemonState, Mode
from tiger.rig.virtual import Rig
from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.models.terrain import Terrain
    from tiger.studies.terrain_picture import Frame

    Array = NDArray[np.float64]

ROUGHNESS: Roughness = "D"
SHORTEST_WAVE_M = 1.0
START_M, LENGTH_M = 5.0, 150.0
DRIVE_AT_S = 8.0
RUN_UP_S = 6.0
"""Speeding up, and the first metres, from which the ground ahead is told."""
SAMPLE_S = 0.02
ITERATIONS = 3000
LOOK_AHEAD_S, LOOK_STEP_S, LOOK_ITERATIONS = 0.72, 0.06, 40
BENDS_AFTER_M = 0.2
"""Beyond what the front wheels touch, the ground goes on as it rises for about so long."""
_RIDES = {"passive": Mode.HOLD, "active": Mode.LEVEL}


@dataclass(frozen=True, slots=True, eq=False)
class Ride:
    """What the world did, every `SAMPLE_S`: n samples, angles in degrees."""

    time_s: Array
    attitude_deg: Array
    ground_deg: Array
    """Roll and pitch of the plane under the wheels (n, 2)."""
    axles_deg: Array
    """(n, 4): cross slope under front and rear axle, and their mean heights over half the wheelbase."""
    position_m: Array
    yaw_deg: Array
    stroke_mm: Array
    load_n: Array
    estimate_deg: Array
    """Roll and pitch of the body as estimated (n, 2)."""
    duty: Array
    """Drive of the actuators (n, 4), -1 to 1."""

    def counted(self) -> Array:
        """Select the samples after the run-up."""
        return np.asarray(self.time_s >= DRIVE_AT_S + RUN_UP_S)


def run(
    speeds_kmh: str = "1,2,5,10",
    duration_s: float = 20.0,
    seed: int = 3,
    progress: Callable[[float], None] | None = None,
) -> Report:
    """Drive at each speed twice over the same ground of class D, strokes held and body levelled.

    Raises ValueError for speeds that are no positive numbers, or when the robot does not stay armed.
    """
    try:
        speeds = [float(text) for text in speeds_kmh.split(",")]
    except ValueError:
        raise ValueError(f"speeds_kmh = {speeds_kmh!r}: give numbers with commas between") from None
    if not speeds or min(speeds) <= 0.0 or duration_s <= 0.0:
        raise ValueError(f"speeds_kmh = {speeds_kmh!r} and duration_s = {duration_s:g} must be positive")
    way_m = START_M + max(speeds) / 3.6 * (RUN_UP_S + duration_s) + 1.0
    if way_m > LENGTH_M:
        raise ValueError(
            f"{max(speeds):g} km/h for {RUN_UP_S:g} + {duration_s:g} s needs {way_m:.0f} m of ground, "
            f"there are {LENGTH_M:g}: lower duration_s"
        )
    robot = load_robot()
    terrain = make_terrain(_ground(seed), robot.vehicle.body.half_track_m)
    rows: list[Row] = []
    series: dict[str, Array] = {}
    for index, kmh in enumerate(speeds):
        scenario = _scenario(kmh / 3.6, duration_s, seed)
        rides = {}
        for turn, (name, mode) in enumerate(_RIDES.items()):
            rides[name] = _ride(robot, scenario, terrain, mode, kmh / 3.6, seed)
            series |= {f"{name}_{kmh:g}_{key}": values for key, values in _series(rides[name]).items()}
            if progress is not None:
                progress((2 * index + turn + 1) / (2 * len(speeds)))
        rows += _rows(robot, f"{kmh:g} km/h", kmh / 3.6, rides["passive"], rides["active"])
    assumptions = {
        "seed": seed,
        "ground": f"rolling ground of ISO 8608 class {ROUGHNESS}, no wave shorter than {SHORTEST_WAVE_M:g} m",
        "actuators": f"{robot.actuator.max_rate_mmps:g} mm/s at any load, lag {robot.actuator.lag_s:g} s",
        "counted": f"{duration_s:g} s, after {RUN_UP_S:g} s at the speed; RMS about the mean",
        "bound": "all the ground known beforehand, no lag, no noise, strokes without ends",
        "without foresight": "the rear wheels' next metre known from the front ones, theirs only continued",
        "delayed": "by the setpoint's way and the actuators' lag",
    }
    return Report("Driving over uneven terrain", tuple(rows), series, assumptions)


def _scenario(speed_mps: float, duration_s: float, seed: int) -> Scenario:
    return Scenario(
        title="uneven terrain",
        duration_s=DRIVE_AT_S + RUN_UP_S + duration_s,
        start=Start(x_m=START_M),
        terrain=_ground(seed),
    )


def _ground(seed: int) -> TerrainConfig:
    rough = RoughConfig(
        roughness=ROUGHNESS, size_m=(LENGTH_M, 20.0), shortest_wave_m=SHORTEST_WAVE_M, seed=seed
    )
    return TerrainConfig(rough=rough)


def _ride(
    robot: RobotConfig, scenario: Scenario, terrain: Terrain, mode: Mode, speed_mps: float, seed: int
) -> Ride:
    """Drive straight on, armed as soon as it may be."""
    rig = Rig(robot, scenario, seed)
    rig.daemon.command = Command(mode)
    rig.daemon.arm(patience_s=DRIVE_AT_S)
    every = round(SAMPLE_S * robot.loop.rate_hz)
    rows = []
    for tick, record in enumerate(rig.run(scenario.duration_s)):
        if rig.time_s > DRIVE_AT_S and record.state is not DaemonState.ARMED:
            problems = "; ".join(str(problem) for problem in record.problems)
            raise ValueError(f"the robot is {record.state.name} ({record.reason}) {problems}")
        rig.daemon.command = Command(mode, speed_mps=speed_mps if rig.time_s > DRIVE_AT_S else 0.0)
        if tick % every == 0:
            truth, estimate, strokes = rig.robot.truth(), record.outputs.estimate, record.inputs.strokes
            attitude = truth.roll_deg, truth.pitch_deg, truth.yaw_deg
            estimated = math.degrees(estimate.roll_rad), math.degrees(estimate.pitch_rad)
            duty = strokes.duty_permille if strokes is not None else STILL
            world = (*attitude, *truth.position_m, *truth.stroke_mm, *truth.wheel_load_n)
            rows.append((truth.time_s, *world, *estimated, *duty))
    table = np.array(rows)
    ground, axles = _under_wheels(robot, terrain, table[:, 4:6], table[:, 3])
    return Ride(
        time_s=table[:, 0],
        attitude_deg=table[:, 1:3],
        ground_deg=ground,
        axles_deg=axles,
        position_m=table[:, 4:7],
        yaw_deg=table[:, 3],
        stroke_mm=table[:, 7:11],
        load_n=table[:, 11:15],
        estimate_deg=table[:, 15:17],
        duty=table[:, 17:] / 1000.0,
    )


def _under_wheels(
    robot: RobotConfig, terrain: Terrain, place_m: Array, yaw_deg: Array
) -> tuple[Array, Array]:
    """Slopes of the ground under the wheels, and what the two axles have in them, degrees."""
    body = robot.vehicle.body
    sin, cos = np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg))
    heights = []
    for x in (body.com_to_front_axle_m, -body.com_to_rear_axle_m):
        for y in (body.half_track_m, -body.half_track_m):
            at = place_m[:, 0] + cos * x - sin * y, place_m[:, 1] + sin * x + cos * y
            heights.append(terrain.at(*at)[0])
    fl, fr, rl, rr = heights
    across, along = 4.0 * body.half_track_m, 2.0 * body.wheelbase_m
    axles = np.degrees(
        np.column_stack([(fl - fr) / across, (rl - rr) / across, -(fl + fr) / along, (rl + rr) / along])
    )
    return axles[:, [0, 2]] + axles[:, [1, 3]], axles


def _series(ride: Ride) -> dict[str, Array]:
    return {
        "time_s": ride.time_s,
        "attitude_deg": ride.attitude_deg,
        "ground_deg": ride.ground_deg,
        "position_m": ride.position_m,
        "yaw_deg": ride.yaw_deg,
        "stroke_mm": ride.stroke_mm,
        "load_n": ride.load_n,
    }


# ---- yardsticks -------------------------------------------------


def bound(ground_deg: Array, limits_degps: tuple[float, float]) -> tuple[Array, float]:
    """Return what the best rate-limited motion leaves of the ground (n, 2) that it knows beforehand.

    Second, how far below it the true optimum may lie: sums of squares, as a share of the ground's.
    """
    rate, left = nearest_motion(ground_deg, limits_degps, SAMPLE_S, ITERATIONS)
    gap = distance_to_optimum(rate, left, limits_degps, SAMPLE_S)
    return left, gap / float((_rms(ground_deg) ** 2).sum() * len(ground_deg))


def without_foresight(
    axles_deg: Array,
    limits_degps: tuple[float, float],
    speed_mps: float,
    wheelbase_m: float,
    delay_s: float = 0.0,
) -> Array:
    """Return what is left of the ground (n, 2) when only what the wheels have touched is known.

    Planned anew every `LOOK_STEP_S` over the next `LOOK_AHEAD_S`, without noise; what is decided acts
    `delay_s` later.
    """
    every = round(LOOK_STEP_S / SAMPLE_S)
    ahead_s = delay_s + LOOK_STEP_S * np.arange(1, round(LOOK_AHEAD_S / LOOK_STEP_S) + 1)
    goes_on_s = BENDS_AFTER_M / speed_mps
    rises_s = goes_on_s * (1.0 - np.exp(-ahead_s / goes_on_s))
    front, rear = axles_deg[:, [0, 2]], axles_deg[:, [1, 3]]
    rising = np.gradient(front, SAMPLE_S, axis=0)
    seen = np.minimum(ahead_s, wheelbase_m / speed_mps) / SAMPLE_S
    ground = front + rear
    body, rates, left = ground[0].copy(), np.zeros((len(ahead_s), 2)), np.empty_like(ground)
    decided = [np.zeros(2)] * round(delay_s / SAMPLE_S)
    for now in range(len(ground)):
        if now % every == 0:
            known = rear[np.minimum(now + seen.astype(int), len(rear) - 1)]
            expected = known + front[now] + rises_s[:, None] * rising[now]
            begin = body + SAMPLE_S * np.sum(decided, axis=0)
            rates, _ = nearest_motion(
                expected, limits_degps, LOOK_STEP_S, LOOK_ITERATIONS, start=begin, guess=rates
            )
        decided.append(rates[0])
        body = body + SAMPLE_S * decided.pop(0)
        left[now] = ground[now] - body
    return left


def _rows(robot: RobotConfig, name: str, speed_mps: float, passive: Ride, active: Ride) -> list[Row]:
    """RMS passive and active, their ratio, and the shares that the yardsticks leave."""
    roll, pitch = design_leveling(robot).turn_limits_radps
    limits, wheelbase_m = (math.degrees(roll), math.degrees(pitch)), robot.vehicle.body.wheelbase_m
    delay_s = robot.actuator.lag_s + robot.leveling.setpoint_delay_s
    counted = active.counted()
    ground, axles = active.ground_deg[counted], active.axles_deg[counted]
    body = passive.attitude_deg[passive.counted()]
    left, gap = bound(ground, limits)
    left_of_body, _ = bound(body, limits)
    blind = without_foresight(axles, limits, speed_mps, wheelbase_m)
    late = without_foresight(axles, limits, speed_mps, wheelbase_m, delay_s)
    held, levelled, slopes = _rms(body), _rms(active.attitude_deg[counted]), _rms(ground)
    yardsticks = {
        "bound": _rms(left) / slopes,
        "bound of the body": _rms(left_of_body) / held,
        "bound without foresight": _rms(blind) / slopes,
        "bound without foresight, delayed": _rms(late) / slopes,
    }
    rows = []
    for axis, label in enumerate(("roll", "pitch")):
        share = levelled[axis] / held[axis]
        rows += [
            Row(f"{name}: {label} RMS, passive", float(held[axis]), "deg"),
            Row(f"{name}: {label} RMS, active", float(levelled[axis]), "deg"),
            Row(f"{name}: {label}, active over passive", float(share), "-"),
            *(Row(f"{name}: {label}, {what}", float(least[axis]), "-") for what, least in yardsticks.items()),
            *(
                Row(f"{name}: {label}, above the {what}", float(share - least[axis]), "of passive")
                for what, least in yardsticks.items()
            ),
            Row(
                f"{name}: {label}, active over the least with foresight from passed ground only",
                float(share / yardsticks["bound without foresight, delayed"][axis]),
                "-",
            ),
        ]
    mean = active.attitude_deg[counted].mean(axis=0)
    wrong = np.abs(active.estimate_deg - active.attitude_deg)[active.time_s > DRIVE_AT_S].max()
    rows.append(Row(f"{name}: mean tilt, active", float(np.abs(mean).max()), "deg"))
    rows.append(Row(f"{name}: attitude as estimated, worst, from the start on", float(wrong), "deg"))
    rows.append(
        Row(
            f"{name}: heat of the worst actuator",
            float((active.duty[counted] ** 2).mean(axis=0).max()),
            "of full",
        )
    )
    rows.append(Row(f"{name}: bound, duality gap", gap, "-"))
    return rows


def _rms(angles: Array) -> Array:
    """RMS about the mean, of each axis."""
    return np.asarray(angles.std(axis=0))


# ---- pictures ---------------------------------------------------


def frames(series: Mapping[str, Array], name: str) -> list[Frame]:
    """What a picture needs of a ride in the report's series."""
    from tiger.studies.terrain_picture import Frame

    angles = np.radians(np.column_stack([series[f"{name}_attitude_deg"], series[f"{name}_yaw_deg"]]))
    columns = (series[f"{name}_time_s"], series[f"{name}_position_m"], angles)
    rows = zip(
        *(column.tolist() for column in columns),
        series[f"{name}_stroke_mm"].tolist(),
        series[f"{name}_load_n"].tolist(),
        strict=True,
    )
    return [
        Frame(at, tuple(place), tuple(turn), tuple(stroke), tuple(load))
        for at, place, turn, stroke, load in rows
    ]


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw roll and pitch at each speed, the shares beside the bounds, and the robot on its ground."""
    from tiger.studies.terrain_picture import animate, evenly, strip

    directory.mkdir(parents=True, exist_ok=True)
    series = {name: np.asarray(values) for name, values in report.series.items()}
    speeds = [
        name.split("_")[1] for name in series if name.startswith("active_") and name.endswith("_time_s")
    ]
    paths = [_curves(series, speeds, directory / "uneven-terrain.png")]
    paths.append(_shares(report, speeds, directory / "uneven-terrain-shares.png"))
    robot = load_robot()
    terrain = make_terrain(_ground(report.assumptions["seed"]), robot.vehicle.body.half_track_m)
    pictures = [f for f in frames(series, f"active_{speeds[0]}") if f.time_s > DRIVE_AT_S]
    title = f"Levelled at {speeds[0]} km/h"
    paths.append(
        strip(evenly(pictures, 5), terrain, directory / "uneven-terrain-pictures.png", title, robot.vehicle)
    )
    some = evenly(pictures, min(len(pictures), 100))
    paths.append(animate(some, terrain, directory / "uneven-terrain.gif", title, robot.vehicle))
    return paths


def _curves(series: Mapping[str, Array], speeds: list[str], path: Path) -> Path:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(7.0, 2.2 * len(speeds)), layout="constrained")
        for row, kmh in zip(figure.subplots(len(speeds), 2, squeeze=False, sharey=True), speeds, strict=True):
            for axis, (axes, label) in enumerate(zip(row, ("roll", "pitch"), strict=True)):
                for name, style in (("passive", {"color": "0.6", "lw": 1.0}), ("active", {"lw": 1.2})):
                    time_s = series[f"{name}_{kmh}_time_s"]
                    here = time_s >= DRIVE_AT_S + RUN_UP_S
                    angle = series[f"{name}_{kmh}_attitude_deg"][here, axis]
                    axes.plot(time_s[here], angle, label=name, **style)
                axes.set_title(f"{kmh} km/h, {label}", fontsize=9)
            row[0].set_ylabel("degrees")
            row[0].legend(loc="upper right", ncols=2, fontsize=8)
        figure.supxlabel("time (s)", fontsize=9)
        figure.savefig(path, dpi=110)
    return path


def _shares(report: Report, speeds: list[str], path: Path) -> Path:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    value = {row.name: row.value for row in report.rows}
    lines = {
        "active over passive": "o-",
        "bound without foresight, delayed": "x--",
        "bound without foresight": "s--",
        "bound": "^:",
    }
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        for axes, label in zip(figure.subplots(1, 2, sharey=True), ("roll", "pitch"), strict=True):
            for name, style in lines.items():
                shares = [value[f"{kmh} km/h: {label}, {name}"] for kmh in speeds]
                axes.plot([float(kmh) for kmh in speeds], shares, style, label=name)
            axes.set_title(label)
            axes.set_xlabel("speed (km/h)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
        figure.supylabel("share of passive", fontsize=9)
        figure.savefig(path, dpi=110)
    return path
