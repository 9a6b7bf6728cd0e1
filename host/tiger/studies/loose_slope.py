"""Figures 4.13 to 4.15: up a loose slope, two wheels in hollows, with a passive and an active configuration.

The whole stack takes part: firmware, wire, daemon and the emulated robot on soft soil, in virtual time. The
figures print curves of slip and power and no numbers.

Passive: the strokes stay as they are, and every motor is given the same torque (each side an open
differential, made of the Roboteqs' speed loops by trims until the measured torques agree). Active: mode
`balance` loads the wheels alike, and the forces are shared by load. Two more rides tell the two apart:
passive strokes with all wheels at one speed, and passive strokes with the forces shared by load.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.robot import load_robot
from tiger.control import traction
from tiger.emulation.scenarios import load_scenario
from tiger.record import STILL, Command, DaemonState, Mode
from tiger.rig.virtual import Rig
from tiger.studies.figures import gridded, legend_above, new_figure, save
from tiger.studies.report import CORNERS, Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.emulation.scenarios import Scenario
    from tiger.record import Estimate, Four
    from tiger.studies.report import Progress
    from tiger.studies.terrain_picture import Frame

    Array = NDArray[np.float64]

SCENARIO = "loose-hollows"
TOP_M = 6.5
"""The COM is here at the end of the climb."""
CURRENT_A = 60.0
"""In place of the 30 A of the default: what a motor at its full torque takes, so that no case ends by it."""
OPEN = 100.0
"""Slip limit that limits nothing: wheels on an open differential spin as they like."""
GENTLE = 0.67
"""Of the mounds, hollows and twisted strokes, on the slope that both configurations climb."""
PEAK_OVER_S = 0.5
"""Slip is a mean over this time: a wheel that jerks has not slipped."""
TURNING_MPS = 0.05
UNDER_WAY_M = 0.2
"""From the start: before, the daemon turns one side after the other to see that they are wired right."""
SAMPLE_S = 0.1
PATIENCE_S = 10.0
COLUMNS = {
    "time_s": 1,
    "position_m": 3,
    "attitude_deg": 3,
    "speed_mps": 1,
    "rim_speed_mps": 4,
    "load_n": 4,
    "torque_nm": 4,
    "power_w": 4,
    "electric_w": 4,
    "trim_rpm": 4,
    "stroke_mm": 4,
}


@dataclass(frozen=True, slots=True)
class Case:
    """One way of climbing."""

    name: str
    suspension: Mode
    traction: str  # mode of the traction control
    share: str = "load"


PASSIVE = Case("passive", Mode.HOLD, "on", "equal")
ONE_SPEED = Case("passive, one speed", Mode.HOLD, "log")
BY_LOAD = Case("passive, shared by load", Mode.HOLD, "on")
ACTIVE = Case("active", Mode.BALANCE, "on")


@dataclass(frozen=True, slots=True, eq=False)
class Ride:
    """What happened, over time from the start of the drive, and what was to be shared out."""

    series: Mapping[str, Array]
    tasks: tuple[traction.Task, ...]
    design: traction.TractionDesign
    fault: str

    @property
    def place_m(self) -> Array:
        """How far along it is."""
        return self.series["position_m"][:, 0]

    @property
    def energy_j(self) -> Array:
        """Work that the wheels have done so far."""
        work = np.maximum(self.series["power_w"], 0.0).sum(axis=1) * self.step_s
        return np.asarray(np.cumsum(work))

    @property
    def electric_j(self) -> Array:
        """Energy from the battery so far, as the Roboteqs report it."""
        return np.asarray(np.cumsum(self.series["electric_w"].sum(axis=1) * self.step_s))

    @property
    def step_s(self) -> float:
        """Time between two rows."""
        return float(self.series["time_s"][1] - self.series["time_s"][0])

    @property
    def slip(self) -> Array:
        """Share of each wheel's rim speed that moves nothing, (n, 4), 0 to 1."""
        width = max(round(PEAK_OVER_S / self.step_s), 1)
        mean = np.ones(width) / width
        rim = np.column_stack([np.convolve(rim, mean, "same") for rim in self.series["rim_speed_mps"].T])
        body = np.convolve(self.series["speed_mps"], mean, "same")[:, None]
        slip = 1.0 - body / np.maximum(rim, TURNING_MPS)
        return np.asarray(np.where(rim > TURNING_MPS, np.clip(slip, 0.0, 1.0), 0.0))

    @property
    def peak_slip(self) -> float:
        """Largest slip of any wheel once it is under way."""
        return float(self.slip[self.place_m > self.place_m[0] + UNDER_WAY_M].max())

    def when(self, place_m: float) -> int | None:
        """Row of the first arrival at a place."""
        there = np.nonzero(self.place_m >= place_m)[0]
        return int(there[0]) if there.size else None


def run(seed: int = 0, all_cases: bool = True, progress: Progress = unwatched) -> Report:
    """Climb with every case, then with passive and active where the ground is gentle enough for both.

    `all_cases = False` leaves out what the two figures do not show. Raises ValueError when the robot does not
    arm or stops before it has started to climb.
    """
    scenario = load_scenario(SCENARIO)
    cases = [PASSIVE, ACTIVE] + ([ONE_SPEED, BY_LOAD] if all_cases else [])
    plan = [(case, scenario) for case in cases]
    plan += [(case, gentle(scenario)) for case in (PASSIVE, ACTIVE)] if all_cases else []
    rides = []
    for done, (case, ground) in enumerate(plan):

        def part(share: float, done: int = done) -> None:
            progress((done + share) / len(plan))

        rides.append(ride(case, ground, seed, part))
    hard = dict(zip([case.name for case in cases], rides, strict=False))
    active, passive = hard["active"], hard["passive"]
    rows = [row for name, one in hard.items() for row in _rows(name, one)]
    rows += _where_the_passive_one_ends(passive, active)
    if all_cases:
        gentle_passive, gentle_active = rides[len(cases) :]
        rows += _rows("gentle, passive", gentle_passive)
        rows += _rows("gentle, active", gentle_active)
        rows += _compared("gentle, active over passive", gentle_active, gentle_passive)
        less = hard[BY_LOAD.name].peak_slip / passive.peak_slip
        rows.append(Row("peak slip, shared by load over equal torque (strokes passive)", less, "-"))
    rows.append(Row("peak slip, active over passive", active.peak_slip / passive.peak_slip, "-"))
    rows += _solver_rows(active)
    return Report(
        "Climbing a loose slope",
        tuple(rows),
        {
            f"{name.replace(', ', '_').replace(' ', '_')}_{key}": values
            for name in ("passive", "active")
            for key, values in shown(hard[name]).items()
        },
        assumptions(scenario, hard),
    )


def assumptions(scenario: Scenario, rides: Mapping[str, Ride]) -> dict[str, str]:
    """What had to be chosen, and how equal the equal torques were."""
    hill = scenario.terrain.step[0]
    passive = rides["passive"].series["torque_nm"]
    apart = np.abs(passive[:, [0, 1]] - passive[:, [2, 3]]).mean()
    return {
        "ground": f"{scenario.soil}, {hill.height_m:g} m up within {hill.ramp_m:g} m, "
        "hollows and mounds of 60 mm",
        "strokes at the start": " ".join(f"{stroke:g}" for stroke in scenario.initial_stroke_mm or ())
        + " mm",
        "passive": "strokes held; equal torque front and rear of each side, by trims of the Roboteqs' speed "
        f"loops: they differ by {apart:.2f} Nm on average",
        "active": "mode balance; forces shared by load",
        "slip": f"1 - v/(w r) of the true speeds, mean over {PEAK_OVER_S:g} s",
        "energy": "torque times speed of each wheel as the robot measures them, driving only",
        "current": f"the safety limits of the motors' currents are {CURRENT_A:g} A: no case ends by them",
    }


def configured(case: Case) -> RobotConfig:
    """The robot of one case."""
    robot = load_robot()
    keys: dict[str, object] = {"mode": case.traction, "share": case.share}
    if case.share == "equal":
        keys |= {"slip_max": OPEN, "slip_margin_mps": OPEN, "slip_gain_per_s": 0.0}
    robot = robot.with_motor_current(CURRENT_A)
    return robot.model_copy(update={"traction": robot.traction.model_copy(update=keys)})


def gentle(scenario: Scenario) -> Scenario:
    """The same hill with shallower hollows and a frame that is less twisted."""
    bumps = tuple(b.model_copy(update={"height_m": GENTLE * b.height_m}) for b in scenario.terrain.bump)
    middle = sum(scenario.initial_stroke_mm or STILL) / 4.0
    fl, fr, rl, rr = (middle + GENTLE * (s - middle) for s in scenario.initial_stroke_mm or STILL)
    return scenario.model_copy(
        update={
            "terrain": scenario.terrain.model_copy(update={"bump": bumps}),
            "initial_stroke_mm": (fl, fr, rl, rr),
        }
    )


def ride(case: Case, scenario: Scenario, seed: int = 0, progress: Progress = unwatched) -> Ride:
    """Drive one case until the top is reached, the robot stops itself, or the time is over."""
    robot = configured(case)
    design = traction.design_traction(robot)
    rig = Rig(robot, scenario, seed)
    rig.daemon.command = Command(mode=case.suspension)
    rig.daemon.arm(PATIENCE_S)
    start_s = scenario.drive[0].at_s
    radius_m = robot.vehicle.tire.rolling_radius_m
    every = round(SAMPLE_S / robot.loop.period_s)
    rows, tasks, fault = [], [], ""
    for tick, record in enumerate(rig.run(scenario.duration_s)):
        if rig.time_s > start_s and record.state is not DaemonState.ARMED:
            fault = "; ".join(str(problem) for problem in rig.daemon.latched) or record.reason
            break
        if tick % every:
            continue
        progress(rig.time_s / scenario.duration_s)
        if rig.time_s < start_s:
            continue
        truth, forces = rig.robot.truth(), record.outputs.traction
        rows.append(
            (
                truth.time_s - start_s,
                *truth.position_m,
                *(truth.roll_deg, truth.pitch_deg, truth.yaw_deg),
                truth.speed_mps,
                *(rpm * np.pi / 30.0 * radius_m for rpm in truth.wheel_speed_rpm),
                *truth.wheel_load_n,
                *forces.torque_nm,
                *forces.power_w,
                *forces.electric_w,
                *forces.trim_rpm,
                *truth.stroke_mm,
            )
        )
        tasks.append(_task(design, forces.torque_nm, forces.friction, record.outputs.estimate))
        if truth.position_m[0] >= TOP_M:
            break
    if len(rows) < 2.0 / SAMPLE_S:
        raise ValueError(f"{case.name}: the robot did not start to climb ({fault or 'it did not arm'})")
    return Ride(_columns(np.array(rows)), tuple(tasks), design, fault)


def _task(
    design: traction.TractionDesign, torque_nm: Four, friction: float, estimate: Estimate
) -> traction.Task:
    a, b, c, d = (torque / design.radius_m for torque in torque_nm)
    return traction.task_of(
        design, (a, b, c, d), STILL, traction.wheel_loads_n(design, estimate), friction, estimate
    )


def _columns(table: Array) -> dict[str, Array]:
    series, first = {}, 0
    for name, width in COLUMNS.items():
        part = table[:, first : first + width]
        series[name] = part[:, 0] if width == 1 else part
        first += width
    return series


def shown(one: Ride) -> dict[str, Array]:
    """Series of one ride for the report."""
    return {**one.series, "slip_percent": 100.0 * one.slip, "energy_j": one.energy_j}


# ---- figures ------------------------------------------------


def _rows(name: str, one: Ride) -> list[Row]:
    """What came of one ride."""
    top = one.when(TOP_M)
    load = one.series["load_n"]
    return [
        Row(f"{name}: reached the top", float(top is not None), "1 = yes"),
        Row(f"{name}: farthest place", float(one.place_m.max()), "m"),
        Row(f"{name}: time to the top", np.nan if top is None else float(one.series["time_s"][top]), "s"),
        Row(f"{name}: work of the wheels", float(one.energy_j[-1]), "J"),
        Row(f"{name}: energy from the battery", float(one.electric_j[-1]), "J"),
        Row(f"{name}: peak slip", 100.0 * one.peak_slip, "%"),
        Row(f"{name}: least wheel load", float(load.min()), "N"),
        Row(f"{name}: largest wheel load", float(load.max()), "N"),
        Row(f"{name}: peak torque", float(one.series["torque_nm"].max()), "Nm"),
    ]


def _where_the_passive_one_ends(passive: Ride, active: Ride) -> list[Row]:
    """Time and work of both to the farthest place that the passive one reached."""
    place_m = float(passive.place_m.max()) - 0.02
    rows = [Row("to where the passive one ends: place", place_m, "m")]
    for name, one in (("passive", passive), ("active", active)):
        there = one.when(place_m)
        there = len(one.place_m) - 1 if there is None else there
        rows.append(
            Row(f"to where the passive one ends: {name}, time", float(one.series["time_s"][there]), "s")
        )
        rows.append(Row(f"to where the passive one ends: {name}, work", float(one.energy_j[there]), "J"))
    return rows


def _compared(name: str, one: Ride, other: Ride) -> list[Row]:
    """Time and energy of two rides to the top, as ratios; not a number where one did not get there."""
    tops = one.when(TOP_M), other.when(TOP_M)
    if tops[0] is None or tops[1] is None:
        return [Row(f"{name}: {what}", np.nan, "-") for what in ("time", "work", "energy from the battery")]
    a, b = tops
    return [
        Row(f"{name}: time", float(one.series["time_s"][a] / other.series["time_s"][b]), "-"),
        Row(f"{name}: work", float(one.energy_j[a] / other.energy_j[b]), "-"),
        Row(f"{name}: energy from the battery", float(one.electric_j[a] / other.electric_j[b]), "-"),
    ]


def _solver_rows(one: Ride) -> list[Row]:
    """Processor time of sharing out what this ride asked for."""
    taken = []
    for task in one.tasks * 5:
        start = time.thread_time()
        traction.allocate(one.design, task)
        taken.append(1e6 * (time.thread_time() - start))
    median, late = np.percentile(taken, [50.0, 99.0])
    return [
        Row("sharing out the forces: median", float(median), "us"),
        Row("sharing out the forces: 99th percentile", float(late), "us"),
    ]


# ---- pictures -----------------------------------------------


def frames(series: Mapping[str, Array], name: str) -> list[Frame]:
    """What a picture needs of a ride in the report's series."""
    from tiger.studies.terrain_picture import Frame

    keys = ("time_s", "position_m", "attitude_deg", "stroke_mm", "load_n")
    rows = zip(*(np.asarray(series[f"{name}_{key}"]).tolist() for key in keys), strict=True)
    return [
        Frame(at_s, tuple(place), tuple(np.radians(angles).tolist()), tuple(stroke), tuple(load))
        for at_s, place, angles, stroke, load in rows
    ]


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the climb (Figure 4.13), slip, power and load of each wheel passive (4.14) and active (4.15)."""
    from tiger.emulation.ground import make_terrain
    from tiger.studies.terrain_picture import animate, evenly, strip

    series = report.arrays()
    robot = load_robot()
    terrain = make_terrain(load_scenario(SCENARIO).terrain, robot.vehicle.body.half_track_m)
    paths = []
    for name, title in (("passive", "Passive"), ("active", "Active")):
        pictures = frames(series, name)
        path = directory / f"loose-slope-{name}-pictures.png"
        paths.append(strip(evenly(pictures, 5), terrain, path, f"{title} on the loose slope", robot.vehicle))
        paths.append(_curves(series, name, f"{title} configuration", directory / f"loose-slope-{name}.png"))
    pictures = frames(series, "active")
    path = directory / "loose-slope.gif"
    paths.append(animate(evenly(pictures, min(len(pictures), 100)), terrain, path, "Active", robot.vehicle))
    return paths


def _curves(series: Mapping[str, Array], name: str, title: str, path: Path) -> Path:
    """Draw slip, power and load of each wheel over time, and how far along the robot is."""
    with gridded():
        figure = new_figure(7.0, 7.6)
        panels = figure.subplots(4, 1, sharex=True, height_ratios=(1.0, 1.0, 1.0, 0.7))
        time_s = series[f"{name}_time_s"]
        lines = (("slip_percent", "slip (%)"), ("power_w", "power (W)"), ("load_n", "wheel load (N)"))
        for axes, (key, label) in zip(panels, lines, strict=False):
            for corner, values in zip(CORNERS, series[f"{name}_{key}"].T, strict=True):
                axes.plot(time_s, values, label=corner, lw=1.2)
            axes.set_ylabel(label)
            axes.set_ylim(bottom=0.0)
        panels[0].set_ylim(0.0, 105.0)
        legend_above(panels[0])
        panels[3].plot(time_s, series[f"{name}_position_m"][:, 0], color="0.3", lw=1.2)
        panels[3].axhline(TOP_M, color="0.6", ls="--", lw=1.0)
        panels[3].set_ylim(-1.5, 7.0)
        panels[3].set_ylabel("place (m)")
        panels[3].set_xlabel("time since the drive began (s)")
        figure.suptitle(f"Climbing a loose slope: {title}")
        return save(figure, path)
