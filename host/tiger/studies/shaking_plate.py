"""Figures 4.10 and 4.11: the robot levels itself on a plate that tilts under it, by a step and harmonically.

The whole stack takes part: the firmware of the boards, the wire, the daemon and the emulated robot, in
virtual time. The figures print curves and no numbers; the yardstick is the rate bound, the least time in
which actuators of this speed can do it at all, and for the harmonic the least residual that any motion at
this speed can leave.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tiger.config.robot import load_robot
from tiger.control.attitude import design_leveling
from tiger.control.reachable import Pose, rate_bound_s
from tiger.control.rhythm import Rhythm, followable
from tiger.emulation.scenarios import PlateSegment, Scenario
from tiger.record import DaemonState
from tiger.rig.virtual import Rig
from tiger.studies.figures import gridded, legend_above, new_figure, save
from tiger.studies.report import CORNERS, Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.control.reachable import Suspension
    from tiger.studies.report import Progress

    Array = NDArray[np.float64]

BAND_DEG = 0.5
"""Levelled means within this."""
NUDGE_DEG = 0.19
"""A disturbance that should move nothing once the body is level, as far as the IMU can tell."""
STEP_AT_S, BACK_AT_S, NUDGE_AT_S, NUDGE_BACK_AT_S, HARMONIC_AT_S = 6.0, 14.0, 22.0, 24.5, 27.0
REST_S = 3.0
"""At the end of each step: the body should be level and quiet."""
RISE_S = 0.3
LEARNING_PERIODS = 5
_SCALARS = (
    *("time_s", "roll_deg", "pitch_deg", "plate_roll_deg", "plate_pitch_deg"),
    *("roll_est_deg", "pitch_est_deg"),
)
_PER_CORNER = ("stroke_mm", "stroke_rate_mmps", "rate_cmd_mmps", "duty_permille")


def run(
    axis: str = "roll",
    step_deg: float = 5.0,
    amplitude_deg: float = 2.0,
    frequency_hz: float = 0.05,
    periods: int = 3,
    seed: int = 1,
    progress: Progress = unwatched,
) -> Report:
    """Step the plate by `step_deg` and back, nudge it, then rock it; "roll" or "pitch".

    Above the frequency that the actuators can follow, the residual counts after five more periods, in which
    the rhythm is learned. Raises ValueError for another axis, or when the robot does not arm.
    """
    if axis not in ("roll", "pitch"):
        raise ValueError(f'axis = {axis!r}: take "roll" or "pitch"')
    if amplitude_deg <= 0.0 or frequency_hz <= 0.0 or periods < 1:
        raise ValueError("amplitude_deg, frequency_hz and periods must be positive")
    robot = load_robot()
    design = design_leveling(robot)
    top_degps = math.degrees(design.turn_limits_radps[0 if axis == "roll" else 1])
    overspeed = amplitude_deg * 2.0 * math.pi * frequency_hz / top_degps
    counted_s = HARMONIC_AT_S + (LEARNING_PERIODS if overspeed > 1.0 else 1) / frequency_hz
    end_s = counted_s + periods / frequency_hz
    segments: tuple[dict[str, float], ...] = (
        {"at_s": STEP_AT_S, "to_deg": step_deg, "over_s": RISE_S},
        {"at_s": BACK_AT_S, "to_deg": 0.0, "over_s": RISE_S},
        {"at_s": NUDGE_AT_S, "to_deg": NUDGE_DEG, "over_s": RISE_S},
        {"at_s": NUDGE_BACK_AT_S, "to_deg": 0.0, "over_s": RISE_S},
        {"at_s": HARMONIC_AT_S, "amplitude_deg": amplitude_deg, "frequency_hz": frequency_hz},
    )
    plate = tuple(PlateSegment.model_validate({"axis": axis, **segment}) for segment in segments)
    scenario = Scenario(title=f"Shaking plate, {axis}", duration_s=end_s, model="linear", plate=plate)
    series = _ride(Rig(robot, scenario, seed), end_s, progress)
    rows = [
        *_step_rows("step", series, STEP_AT_S, _bound_s(design.suspension, axis, step_deg, 0.0)),
        *_step_rows("step back", series, BACK_AT_S, _bound_s(design.suspension, axis, 0.0, step_deg)),
        _nudge_row(series),
        *_harmonic_rows(series, axis, counted_s, amplitude_deg, overspeed),
    ]
    assumptions = {
        "actuators": f"{robot.actuator.max_rate_mmps:g} mm/s at any load, lag {robot.actuator.lag_s:g} s",
        "plate": f"{step_deg:g} degrees as a raised cosine over {RISE_S:g} s",
        "levelled": f"roll and pitch within {BAND_DEG:g} degrees",
        "sensors": "noise and biases of the data sheets; the daemon calibrates the gyroscope at rest",
    }
    return Report(f"Levelling on a shaking plate ({axis})", tuple(rows), series, assumptions)


def _ride(rig: Rig, end_s: float, progress: Progress) -> dict[str, Array]:
    """Run the rig, armed as soon as it may be, and return its series."""
    rig.daemon.arm(patience_s=STEP_AT_S)
    rows = []
    for record in rig.run(end_s):
        if rig.time_s > STEP_AT_S and record.state is not DaemonState.ARMED:
            problems = "; ".join(str(problem) for problem in record.problems)
            raise ValueError(f"the robot is {record.state.name} ({record.reason}) {problems}")
        truth, estimate, strokes = rig.robot.truth(), record.outputs.estimate, record.inputs.strokes
        rows.append(
            (
                *(rig.time_s, truth.roll_deg, truth.pitch_deg, truth.plate_roll_deg, truth.plate_pitch_deg),
                *(math.degrees(estimate.roll_rad), math.degrees(estimate.pitch_rad)),
                *truth.stroke_mm,
                *truth.stroke_rate_mmps,
                *record.outputs.stroke_rate_mmps,
                *(strokes.duty_permille if strokes is not None else (0,) * 4),
            )
        )
        if len(rows) % 200 == 0:
            progress(rig.time_s / end_s)
    table = np.array(rows)
    series = {name: table[:, column] for column, name in enumerate(_SCALARS)}
    fours = np.split(table[:, len(_SCALARS) :], len(_PER_CORNER), axis=1)
    return series | dict(zip(_PER_CORNER, fours, strict=True))


def _bound_s(suspension: Suspension, axis: str, to_deg: float, from_deg: float) -> float:
    """Rate bound of a step of the plate, from the strokes that level it before the step."""
    turn = math.radians(math.copysign(max(abs(to_deg - from_deg) - BAND_DEG, 0.0), from_deg - to_deg))
    before = math.radians(-from_deg)
    ride_mm = suspension.curve.at(suspension.curve.stroke_max_mm / 2.0)[0]
    pose = Pose(before, 0.0, ride_mm) if axis == "roll" else Pose(0.0, before, ride_mm)
    fl, fr, rl, rr = (float(suspension.curve.stroke_mm(lift)) for lift in suspension.lifts_mm(pose))
    return rate_bound_s(suspension, (fl, fr, rl, rr), *((turn, 0.0) if axis == "roll" else (0.0, turn)))


def _nudge_row(series: Mapping[str, Array]) -> Row:
    here = (series["time_s"] >= NUDGE_AT_S) & (series["time_s"] < HARMONIC_AT_S)
    largest = float(np.abs(series["duty_permille"][here]).max())
    return Row(f"disturbance of {NUDGE_DEG:g} degrees: largest PWM", largest, "permille")


def _motion_rows(name: str, series: Mapping[str, Array], here: NDArray[np.bool_]) -> list[Row]:
    """What the upper half of each figure shows: strokes and their rates."""
    strokes, rates = series["stroke_mm"][here], series["stroke_rate_mmps"][here]
    return [
        Row(f"{name}: shortest stroke", float(strokes.min()), "mm"),
        Row(f"{name}: longest stroke", float(strokes.max()), "mm"),
        Row(f"{name}: fastest stroke rate", float(np.abs(rates).max()), "mm/s"),
    ]


def _step_rows(name: str, series: Mapping[str, Array], at_s: float, bound_s: float) -> list[Row]:
    time = series["time_s"]
    here = (time >= at_s) & (time < at_s + BACK_AT_S - STEP_AT_S)
    attitude = np.column_stack([series["roll_deg"], series["pitch_deg"]])[here]
    since = time[here] - at_s
    outside = np.abs(attitude).max(axis=1) >= BAND_DEG
    level_s = float(since[outside][-1]) if outside.any() else 0.0
    # Which way the plate throws the body: what it overshoots is the other way.
    thrown = np.sign(attitude[np.argmax(np.abs(attitude).max(axis=1))])
    beyond = float(np.max(-attitude * thrown))
    resting = since > since[-1] - REST_S
    driven = np.abs(series["duty_permille"][here]).max(axis=1) > 0
    return [
        Row(f"{name}: rate bound to {BAND_DEG:g} degrees", bound_s, "s"),
        Row(f"{name}: time to {BAND_DEG:g} degrees", level_s, "s"),
        Row(f"{name}: over the bound", level_s / bound_s, "-"),
        Row(f"{name}: largest tilt", float(np.abs(attitude).max()), "deg"),
        Row(f"{name}: beyond level", max(beyond, 0.0), "deg"),
        Row(f"{name}: mean error at rest", float(np.abs(attitude[resting].mean(axis=0)).max()), "deg"),
        Row(f"{name}: last PWM after", float(since[driven][-1]) if driven.any() else 0.0, "s"),
        *_motion_rows(name, series, here),
    ]


def _harmonic_rows(
    series: Mapping[str, Array], axis: str, from_s: float, amplitude_deg: float, overspeed: float
) -> list[Row]:
    late = series["time_s"] >= from_s
    residual = series[f"{axis}_deg"][late]
    half = len(residual) // 2
    drift = float(residual[half:].mean() - residual[:half].mean())
    residual = residual - residual.mean()
    share = float(np.sqrt(np.mean(residual**2)) / (amplitude_deg / math.sqrt(2.0)))
    rows = [
        Row("harmonic: top rate over the actuators'", overspeed, "-"),
        Row("harmonic: residual RMS", float(np.sqrt(np.mean(residual**2))), "deg"),
        Row("harmonic: residual peak", float(np.abs(residual).max()), "deg"),
        Row("harmonic: residual share", share, "-"),
        Row("harmonic: mean error, later half less earlier", drift, "deg"),
        *_motion_rows("harmonic", series, late),
    ]
    if overspeed > 1.0:
        rows.append(Row("harmonic: over the least residual", share / _least_share(overspeed), "-"))
    return rows


def _least_share(overspeed: float) -> float:
    """RMS that the best rate-limited motion leaves of a harmonic, over that of the harmonic."""
    phase = np.linspace(0.0, 2.0 * math.pi, 2000, endpoint=False)
    left = []
    for angle in phase.tolist():
        ground = Rhythm(x=math.sin(angle), y=math.cos(angle), frequency_radps=1.0)
        left.append(ground.x - followable(ground, 1.0 / overspeed)[0])
    return float(np.sqrt(2.0 * np.mean(np.square(left))))


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the step and the harmonic as the dissertation does: strokes, rates, and the body's attitude."""
    series = report.arrays()
    plate = max(("plate_roll", "plate_pitch"), key=lambda line: np.ptp(series[f"{line}_deg"]))
    spans = {
        "shaking-plate-step.png": (STEP_AT_S - 2.0, NUDGE_AT_S),
        "shaking-plate-harmonic.png": (HARMONIC_AT_S, float(series["time_s"][-1])),
    }
    paths = []
    for name, (start, end) in spans.items():
        within = (series["time_s"] >= start) & (series["time_s"] < end)
        shown = {key: values[within] for key, values in series.items()}
        paths.append(_draw(shown, plate, report.title, directory / name))
    return paths


def _draw(series: Mapping[str, Array], plate: str, title: str, path: Path) -> Path:
    """Draw strokes, their rates, and the body's attitude beside that of the plate."""
    time_s = series["time_s"]
    with gridded():
        figure = new_figure(7.0, 6.4)
        strokes, rates, attitude = figure.subplots(3, 1, sharex=True)
        for corner, label in enumerate(CORNERS):
            strokes.plot(time_s, series["stroke_mm"][:, corner], label=label, lw=1.2)
            rates.plot(time_s, series["stroke_rate_mmps"][:, corner], label=label, lw=1.0)
        attitude.plot(time_s, series[f"{plate}_deg"], "--", color="0.5", label="plate", lw=1.2)
        for line in ("roll", "pitch"):
            attitude.plot(time_s, series[f"{line}_deg"], label=line, lw=1.2)
        attitude.axhspan(-BAND_DEG, BAND_DEG, color="0.9", zorder=0)
        strokes.set_ylabel("stroke (mm)")
        rates.set_ylabel("stroke rate (mm/s)")
        attitude.set_ylabel("attitude (degrees)")
        attitude.set_xlabel("time (s)")
        legend_above(strokes)
        legend_above(attitude)
        figure.suptitle(title)
        return save(figure, path)
