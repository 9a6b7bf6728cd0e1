"""Pictures of a log: attitude, strokes, wheels, links."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.figure import Figure

    from tiger.logs.reader import Log
    from tiger.record import Record

CORNERS = ("FL", "FR", "RL", "RR")
WIDTH_IN, ROW_IN = 10.0, 2.4
MOST_POINTS = 20_000  # of one curve; a longer log is thinned
SHADES = {  # behind the curves: what the robot was meanwhile
    DaemonState.ARMED: ("armed", "#e8f5e9"),
    DaemonState.FAULT: ("fault", "#ffebee"),
    DaemonState.ESTOP: ("emergency stop", "#ffcdd2"),
}

Series = dict[str, dict[str, list[float]]]  # panel -> curve -> values
Curve = tuple[str, str, float]  # panel, curve, value


def plot(log: Log, folder: Path) -> list[Path]:
    """Write attitude.png, strokes.png, wheels.png and links.png; returns their paths. Raises LogError."""
    times: list[float] = []
    states: list[DaemonState] = []
    sheets: dict[str, Series] = {name: defaultdict(lambda: defaultdict(list)) for name in SHEETS}
    first_ns = None
    for t_ns, record in log.records():
        first_ns = t_ns if first_ns is None else first_ns
        times.append((t_ns - first_ns) / 1e9)
        states.append(record.state)
        for name, curves in SHEETS.items():
            for panel, curve, value in curves(record):
                values = sheets[name][panel][curve]
                values += [math.nan] * (len(times) - 1 - len(values))
                values.append(value)
    folder.mkdir(parents=True, exist_ok=True)
    return [_draw(folder / f"{name}.png", times, states, series) for name, series in sheets.items() if series]


# ------------------------------------------------------------------------------------- what is on which sheet


def _attitude(record: Record) -> list[Curve]:
    estimate, command = record.outputs.estimate, record.inputs.command
    if not estimate.ready:
        return []
    degrees = math.degrees
    curves = [
        ("roll, degrees", "ground", degrees(estimate.plate_roll_rad)),
        ("roll, degrees", "body", degrees(estimate.roll_rad)),
        ("roll, degrees", "wanted", degrees(command.roll_rad)),
        ("pitch, degrees", "ground", degrees(estimate.plate_pitch_rad)),
        ("pitch, degrees", "body", degrees(estimate.pitch_rad)),
        ("pitch, degrees", "wanted", degrees(command.pitch_rad)),
        ("rates, degrees/s", "roll", degrees(estimate.roll_rate_radps)),
        ("rates, degrees/s", "pitch", degrees(estimate.pitch_rate_radps)),
    ]
    return curves


def _strokes(record: Record) -> list[Curve]:
    curves: list[Curve] = []
    sample = record.inputs.strokes
    for i, corner in enumerate(CORNERS):
        if sample is not None:
            curves.append(("stroke, mm", corner, sample.stroke_mm[i]))
            curves.append(("measured rate, mm/s", corner, sample.rate_mmps[i]))
            curves.append(("duty, %", corner, sample.duty_permille[i] / 10.0))
        curves.append(("commanded rate, mm/s", corner, record.outputs.stroke_rate_mmps[i]))
    return curves


def _wheels(record: Record) -> list[Curve]:
    curves: list[Curve] = []
    left, right = record.inputs.drive_left, record.inputs.drive_right
    for i, corner in enumerate(CORNERS):
        curves.append(("commanded, rpm", corner, record.outputs.wheel_rpm[i]))
        sample = (left, right)[i % 2]
        if sample is not None:
            curves.append(("measured, rpm", corner, sample.wheel_rpm[i // 2]))
            curves.append(("motor current, A", corner, sample.motor_current_a[i // 2]))
    for side, sample in (("left", left), ("right", right)):
        if sample is not None:
            curves.append(("battery, V", side, sample.battery_v))
    return curves


def _links(record: Record) -> list[Curve]:
    curves: list[Curve] = [("tick late by, ms", "", record.lateness_s * 1e3)]
    for link in record.links:
        curves.append(
            ("lost or refused frames", link.name, link.rejects + link.board_rejects + link.seq_gaps)
        )
        if link.clock_sigma_us:
            curves.append(("round trip, ms", link.name, link.round_trip_ms))
            curves.append(("clock uncertainty, us", link.name, link.clock_sigma_us))
        curves.append(("supply, V", link.name, link.supply_v))
    return curves


SHEETS: dict[str, Callable[[Record], list[Curve]]] = {
    "attitude": _attitude,
    "strokes": _strokes,
    "wheels": _wheels,
    "links": _links,
}

# ------------------------------------------------------------------------------------------------- drawing


def _draw(path: Path, times: list[float], states: list[DaemonState], series: Series) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(series)), layout="constrained")
    FigureCanvasAgg(figure)
    rows: Any = figure.subplots(len(series), 1, sharex=True, squeeze=False)
    every = max(len(times) // MOST_POINTS, 1)
    names = dict.fromkeys(name for curves in series.values() for name in curves)
    colours = {name: f"C{number}" for number, name in enumerate(names)}  # the same in every panel
    for axes, (panel, curves) in zip(rows[:, 0], series.items(), strict=True):
        for name, values in curves.items():
            axes.plot(times[: len(values) : every], values[::every], colours[name], linewidth=0.8, label=name)
        axes.set_ylabel(panel, fontsize=8)
        axes.grid(visible=True, linewidth=0.3)
        if any(curves):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7, frameon=False)
        _shade(axes, times, states)
    _explain_shades(figure, states)
    rows[-1, 0].set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    return path


def _shade(axes: Any, times: list[float], states: list[DaemonState]) -> None:
    """Colour the time that was spent armed (green) or stopped (red)."""
    start = 0
    for i in range(1, len(states) + 1):
        if i == len(states) or states[i] is not states[start]:
            if states[start] in SHADES:
                _, colour = SHADES[states[start]]
                axes.axvspan(times[start], times[min(i, len(times) - 1)], color=colour, linewidth=0)
            start = i


def _explain_shades(figure: Figure, states: list[DaemonState]) -> None:
    """A legend above all panels, of the shades that were used."""
    from matplotlib.patches import Patch

    seen = set(states)
    patches = [Patch(color=colour, label=text) for state, (text, colour) in SHADES.items() if state in seen]
    if patches:
        figure.legend(handles=patches, loc="outside upper center", ncols=len(patches), fontsize=8)
