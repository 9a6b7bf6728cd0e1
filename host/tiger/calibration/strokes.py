"""Potentiometers against measured strokes (Figure 3.9).

At each of any number of positions the four strokes are measured with a ruler or a caliper. The board keeps a
curve of four straight pieces per actuator: the potentiometer sums at both ends of the stroke, and how far
those at its quarters are off the line between them. With few positions only the line is fitted. How far the
measurements are from the curve is said, and drawn.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiger.calibration.procedure import (
    CalibrationError,
    Confirm,
    Finding,
    Measure,
    Move,
    Procedure,
    Result,
    Stage,
    Values,
    What,
    Window,
)
from tiger.protocol.messages import PARAMS, BoardKind, Message, SuspensionRaw

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.calibration.procedure import Array

CORNERS = ("FL", "FR", "RL", "RR")
POSITION_S = 2.0
MOVES_FROM = 0.12  # of the full stroke: how near the ends the robot goes by itself
NOISE_MOST_SUMS = 64.0  # four counts of the converter, in sums of 16
RESIDUAL_MOST_MM = 0.5
BEYOND_BELIEF = 1.5  # of the longest stroke that is asked for: what was typed is in another unit
SPREAD_LEAST = 0.5  # of the full stroke that the positions must cover
PIECES = 4
POSITIONS_FOR_A_CURVE = 6  # fewer do not tell a bow from a slip of the ruler
STRAIGHTNESS = 0.1  # how strongly the curve keeps straight where no position says otherwise
QUARTERS = ("pot_quarter_counts", "pot_half_counts", "pot_three_quarters_counts")
SPAN_LEAST_SUMS = 2800  # what the board needs between stroke 0 and full stroke

_LIMITS = {param.name: param for param in PARAMS[BoardKind.MEGA_SUSPENSION]}


def channels(message: Message) -> tuple[float, ...] | None:
    """The four potentiometer sums of a `suspension_raw`."""
    return tuple(map(float, message.pot_counts)) if isinstance(message, SuspensionRaw) else None


def unrest(readings: Array) -> str | None:
    """Why potentiometer sums (N, 4) are not those of actuators at rest; None when they are."""
    noise = readings.std(axis=0)
    worst = int(noise.argmax())
    if noise[worst] > NOISE_MOST_SUMS:
        return (
            f"potentiometer {CORNERS[worst]} varies by {noise[worst]:.0f} sums RMS, at most "
            f"{NOISE_MOST_SUMS:g}; wait until it stands, check its wires"
        )
    return None


def solve(windows: tuple[Window, ...], before: Values) -> Result:
    """A curve per corner through (sum, measured stroke) of every position, (N, 4) sums each."""
    sums = np.array([window.mean for window in windows])  # (positions, corners)
    strokes = np.array([window.measured for window in windows])
    (full,) = before["stroke_full_mm"]
    findings, notes = [], []
    curves = np.zeros((len(CORNERS), PIECES + 1))
    for corner, name in enumerate(CORNERS):
        stroke, reading = strokes[:, corner], sums[:, corner]
        _refuse_little_spread(name, stroke, full)
        if abs(np.ptp(reading)) < 1.0:
            raise CalibrationError(
                f"strokes: potentiometer {name} reads {reading[0]:.0f} at every position; check its wires"
            )
        curve = np.round(fit_curve(stroke / full, reading))
        low, high = int(curve[0]), int(curve[-1])
        _refuse_what_cannot_be_stored(name, low, high)
        curves[corner] = curve
        left = stroke - _strokes_mm(curve, reading, full)
        worst, rms = float(np.abs(left).max()), float(np.sqrt(np.mean(left**2)))
        findings += [
            Finding(f"{name} at stroke 0", low, "sums"),
            Finding(f"{name} at {full:g} mm", high, "sums"),
            Finding(f"{name} bow", float(np.abs(_bow(curve)).max()), "sums"),
            Finding(f"{name} from the curve", rms, "mm RMS"),
            Finding(f"{name} farthest", worst, "mm", RESIDUAL_MOST_MM, worst <= RESIDUAL_MOST_MM),
        ]
        if worst > RESIDUAL_MOST_MM:
            notes.append(
                f"{name} is up to {worst:.2f} mm from its curve: measure again"
                + (f", at {POSITIONS_FOR_A_CURVE} positions or more." if _is_line(stroke) else ".")
            )
    if len(windows) == 2:
        notes.append("Two positions always lie on a line: more of them would show how straight it is.")
    series = {
        name: [[float(s), float(r)] for s, r in zip(strokes[:, k], sums[:, k], strict=True)]
        for k, name in enumerate(CORNERS)
    }
    bows = np.array([_bow(curve) for curve in curves])
    parameters = {
        "pot_low_counts": tuple(curves[:, 0].tolist()),
        "pot_high_counts": tuple(curves[:, -1].tolist()),
        **{name: tuple(bows[:, k].tolist()) for k, name in enumerate(QUARTERS)},
        "stroke_full_mm": (full,),
    }
    return Result(tuple(findings), parameters, tuple(notes), series)


def _is_line(stroke: Array) -> bool:
    return len(stroke) < POSITIONS_FOR_A_CURVE


def fit_curve(share: Array, reading: Array) -> Array:
    """Sums at 0, 1/4, 1/2, 3/4 and 1 of the stroke, (5,), that fit the sums read at shares of it, (N,) each.

    Least squares over straight pieces between those points; a line through all when there are few positions.
    """
    knots = np.linspace(0.0, 1.0, PIECES + 1)
    if _is_line(share):
        slope, start = np.polyfit(share, reading, 1)
        return np.asarray(start + slope * knots, dtype=np.float64)
    pieces = np.array([np.interp(share, knots, unit) for unit in np.eye(PIECES + 1)]).T
    straight = STRAIGHTNESS * np.diff(np.eye(PIECES + 1), n=2, axis=0)
    both = np.vstack([pieces, straight])
    aim = np.concatenate([reading, np.zeros(len(straight))])
    return np.asarray(np.linalg.lstsq(both, aim, rcond=None)[0], dtype=np.float64)


def _bow(curve: Array) -> Array:
    """Sums at the three inner points above the line between the ends, whole numbers."""
    line = np.linspace(curve[0], curve[-1], PIECES + 1)
    return np.asarray(np.round(curve - np.trunc(line))[1:-1])


def _strokes_mm(curve: Array, reading: Array, full_mm: float) -> Array:
    """What the board makes of sums: it goes on straight beyond the ends."""
    order = np.argsort(curve)
    strokes = np.linspace(0.0, full_mm, PIECES + 1)
    inner = np.interp(reading, curve[order], strokes[order])
    low_slope = (strokes[1] - strokes[0]) / (curve[1] - curve[0])
    high_slope = (strokes[-1] - strokes[-2]) / (curve[-1] - curve[-2])
    rising = 1.0 if curve[-1] > curve[0] else -1.0
    inner = np.where(rising * (reading - curve[0]) < 0, (reading - curve[0]) * low_slope, inner)
    beyond = rising * (reading - curve[-1]) > 0
    return np.asarray(np.where(beyond, full_mm + (reading - curve[-1]) * high_slope, inner))


def _refuse_little_spread(corner: str, stroke: Array, full: float) -> None:
    spread = float(np.ptp(stroke))
    if spread < SPREAD_LEAST * full:
        raise CalibrationError(
            f"strokes: {corner} was measured over {spread:.1f} mm only, at least {SPREAD_LEAST * full:g}; "
            "measure positions near both ends"
        )


def _refuse_what_cannot_be_stored(corner: str, low: int, high: int) -> None:
    limit = _LIMITS["pot_low_counts"]
    if not (limit.min <= low <= limit.max and limit.min <= high <= limit.max):
        raise CalibrationError(
            f"strokes: the line of {corner} goes from {low} to {high} sums, outside {limit.min:g} to "
            f"{limit.max:g}; measure again, check the wiring"
        )
    if abs(high - low) < SPAN_LEAST_SUMS:
        raise CalibrationError(
            f"strokes: {corner} changes by {abs(high - low)} sums over its stroke, at least "
            f"{SPAN_LEAST_SUMS}; check the potentiometer's supply"
        )


def positions_mm(full_mm: float, count: int, moves: bool) -> list[float]:
    """Strokes to measure at, from low to high.

    A person goes from end to end. The robot stays clear of the ends: with potentiometers that are not
    calibrated yet it would press against them.
    """
    low, high = (MOVES_FROM, 1.0 - MOVES_FROM) if moves else (0.0, 1.0)
    return [round(float(share) * full_mm, 1) for share in np.linspace(low, high, count)]


def strokes_procedure(positions: Sequence[float], moves: bool) -> Procedure:
    """Walk through these strokes, from end to end; the robot goes there itself when `moves`."""
    if len(positions) < 2:
        raise CalibrationError("strokes: a line needs two positions; ask for at least two")
    stages = []
    for number, stroke in enumerate(positions, 1):
        by_hand = f"Bring all four actuators to about {stroke:g} mm (drives off the board, or by hand)."
        stages.append(
            Stage(
                f"position {number} of {len(positions)}, {stroke:g} mm",
                POSITION_S,
                unrest,
                Move((stroke, stroke, stroke, stroke)) if moves else Confirm(by_hand),
                Measure(
                    "Measure the strokes of FL, FR, RL, RR in mm, from fully retracted.",
                    What.STROKES,
                    partial(_wrong_strokes, most_mm=BEYOND_BELIEF * max(positions)),
                ),
            )
        )
    return Procedure("strokes", BoardKind.MEGA_SUSPENSION, tuple(stages), channels, solve)


def _wrong_strokes(strokes_mm: tuple[float, ...], most_mm: float) -> str | None:
    for corner, stroke in zip(CORNERS, strokes_mm, strict=True):
        if abs(stroke) > most_mm:
            beyond = f"{corner} at {stroke:g} mm is beyond ±{most_mm:.0f} mm"
            return f"strokes: {beyond}; measure again, in millimetres"
    return None


def plot(result: Result, folder: Path) -> Path:
    """Draw Figure 3.9, motor stroke against potentiometer value, into `folder`; returns the file."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    low, high = result.parameters["pot_low_counts"], result.parameters["pot_high_counts"]
    bows = np.array([result.parameters[name] for name in QUARTERS])
    (full,) = result.parameters["stroke_full_mm"]
    for k, name in enumerate(CORNERS):
        points = np.array(result.series[name])
        curve = np.linspace(low[k], high[k], PIECES + 1)
        curve[1:-1] += bows[:, k]
        (line,) = axes.plot(curve, np.linspace(0.0, full, PIECES + 1), linewidth=1.0)
        axes.plot(points[:, 1], points[:, 0], "o", color=line.get_color(), label=name)
    axes.set_xlabel("potentiometer value, sums of 16 conversions")
    axes.set_ylabel("motor stroke, mm")
    axes.grid(alpha=0.3)
    axes.legend()
    file = folder / "figure-3-9.png"
    figure.savefig(file, dpi=150)
    return file
