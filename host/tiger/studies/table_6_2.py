"""Table 6.2: ride comfort, road holding and rattle space on the bumpy and the ISO road, passive beside
active.

Prints every row beside the printed one, for the bumpy road (worst and mean over noise seeds) and for ISO
class C (mean over roads). The ISO road is driven by three designs: one for comfort, which like the printed
table lets rear tyre loads grow; one that keeps every tyre load at or below the passive one; and that one with
wheelbase preview.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.control import ride_designs
from tiger.control.margins import margins
from tiger.control.ride import ImuNoise
from tiger.control.ride_schedule import ScheduledRide
from tiger.studies import ride_cases
from tiger.studies.performance import FINE_S, INDEX_NAMES, INDEX_UNITS, performance_index, simulate
from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.studies.performance import RideRun

    Array = NDArray[np.float64]

CUTS = ((1, "heave"), (3, "pitch"), (5, "roll"))


def run(
    vehicle: str = "table-6-1",
    bumpy_noise: float = 0.03,
    iso_noise: float = 1.0,
    preview: bool = True,
    first_seed: int = 0,
    bumpy_seeds: int = 20,
    iso_seeds: int = 40,
    progress: Callable[[float], None] | None = None,
) -> Report:
    """Drive both roads, passive and active.

    The noises scale 0.02 m/s^2 and 0.001 rad/s per sample at 200 Hz. preview: rear wheels are told what the
    front wheels met. Without it the bumpy road takes the bank for the nominal IMU, which is told how far
    apart the lanes meet a wave but not which lane is first. Seeds count up from first_seed.
    """
    case = ride_cases.load_case(vehicle)
    rows: list[Row] = []
    series: dict[str, Any] = {}
    _bumpy(case, bumpy_noise, preview, range(first_seed, first_seed + bumpy_seeds), rows, series)
    _report(progress, 0.2)
    _other_imus(case, range(first_seed, first_seed + bumpy_seeds), rows)
    _report(progress, 0.4)
    _iso(case, iso_noise, preview, range(first_seed, first_seed + iso_seeds), rows, series, progress)
    bumpy, iso = compare_schedule(vehicle)
    rows += [
        Row("one scheduled controller over the separate design, worst bumpy row", float(bumpy.max()), "-"),
        Row("one scheduled controller over the separate design, worst iso row", float(iso.max()), "-"),
    ]
    _margins(rows, case)
    return Report(
        "Table 6.2: simulation results for the two road profiles",
        tuple(rows),
        series,
        {
            "imu noise at x1": "0.02 m/s^2 and 0.001 rad/s, 1 sigma per sample at 200 Hz (none is printed)",
            "bumpy noise factor": bumpy_noise,
            "iso noise factor": iso_noise,
            "wheel delays on the bumpy road (s)": list(ride_cases.BUMPY_DELAYS_S),
            "lane lag on the bumpy road, told where there is no preview (s)": ride_cases.BUMPY_LANE_LAG_S,
            "bumpy window (s)": ride_cases.BUMPY_DURATION_S,
            "iso road": "class C, G_d(0.1) = 256e-6 m^3, independent lanes, rear delayed by (a+b)/V",
            "iso band (cycles/m)": list(ride_cases.ISO_BAND_CYCLES_PER_M),
            "iso window (s)": ride_cases.ISO_DURATION_S,
            "seeds": [first_seed, bumpy_seeds, iso_seeds],
            "preview": preview,
            "model": "linear; no bump stops, no tyre lift-off",
        },
    )


def _bumpy(
    case: ride_cases.Case, factor: float, preview: bool, seeds: range, rows: list[Row], series: dict[str, Any]
) -> None:
    noise = ImuNoise().scaled(factor)
    road = ride_cases.bumpy_road()
    controller = ride_cases.bumpy_controller(case, factor, preview, max_force_n=case.max_force_n)
    passive = simulate(case.car, road)
    active = simulate(case.car, road, controller, noise, tuple(seeds))
    index = performance_index(case.car, case.rattle_space_m, active)
    _rows(rows, "bumpy passive", performance_index(case.car, case.rattle_space_m, passive)[0])
    _rows(rows, "bumpy active", index.mean(axis=0))
    ratio = index / np.array(ride_cases.PRINTED["bumpy active"])
    rows.append(Row("bumpy active, worst mean row over printed", float(ratio.mean(axis=0).max()), "-"))
    rows.append(Row("bumpy active, worst row of any seed over printed", float(ratio.max()), "-"))
    inside = float((ratio.max(axis=1) <= 1.003).mean())
    rows.append(Row("bumpy active, seeds with every row <= 1.003 x printed", inside, "-"))
    rows.append(Row("bumpy active, peak force", float(np.abs(active.force_n).max()), "N"))
    _series(series, "bumpy", case, road, passive, active)


def _other_imus(case: ride_cases.Case, seeds: range, rows: list[Row]) -> None:
    """Say how the bumpy road goes with worse IMUs: the worst of the fourteen rows, mean over the seeds."""
    limit = case.max_force_n
    designs = (
        ("noise x0.1, preview", 0.1, ride_cases.bumpy_controller(case, 0.1, True, max_force_n=limit)),
        ("noise x1, no preview", 1.0, ride_cases.bumpy_controller(case, 1.0, False, max_force_n=limit)),
        (
            "noise x1, no preview, lane lag unknown",
            1.0,
            ride_designs.BUMPY_PLAIN.controller(case.car, ImuNoise(), max_force_n=limit),
        ),
    )
    road = ride_cases.bumpy_road()
    for name, factor, controller in designs:
        active = simulate(case.car, road, controller, ImuNoise().scaled(factor), tuple(seeds))
        index = performance_index(case.car, case.rattle_space_m, active)
        ratio = index.mean(axis=0) / np.array(ride_cases.PRINTED["bumpy active"])
        rows.append(Row(f"bumpy active, {name}, worst mean row over printed", float(ratio.max()), "-"))


def _iso(
    case: ride_cases.Case,
    factor: float,
    preview: bool,
    seeds: range,
    rows: list[Row],
    series: dict[str, Any],
    progress: Callable[[float], None] | None,
) -> None:
    noise = ImuNoise().scaled(factor)
    roads = ride_cases.iso_roads(case.car, seeds)
    _report(progress, 0.5)
    delay = case.car.wheelbase_m / ride_cases.ISO_SPEED_MPS
    passive = simulate(case.car, roads, seeds=tuple(seeds))
    still = performance_index(case.car, case.rattle_space_m, passive)
    _rows(rows, "iso passive", still.mean(axis=0))
    designs = [
        ("iso active", ride_designs.ISO_PREVIEW if preview else ride_designs.ISO_PLAIN, preview),
        ("iso holding", ride_designs.HOLDING_PLAIN, False),
        ("iso holding preview", ride_designs.HOLDING_PREVIEW, True),
    ]
    for i, (name, tuning, sees) in enumerate(designs):
        controller = tuning.controller(case.car, noise, delay if sees else None, max_force_n=case.max_force_n)
        active = simulate(case.car, roads, controller, noise, tuple(seeds))
        index = performance_index(case.car, case.rattle_space_m, active)
        if name == "iso active":
            _rows(rows, name, index.mean(axis=0))
            _series(series, "iso", case, roads[0], passive, active)
        _ratios(rows, name, index, still)
        _report(progress, 0.6 + 0.13 * (i + 1))


def compare_schedule(
    vehicle: str = "table-6-1", bumpy_noise: float = 0.1, seeds: int = 10
) -> tuple[Array, Array]:
    """Return rows of the scheduled controller over those of the two separate designs: (14,) bumpy, (14,) ISO.

    The schedule is told neither the road nor the speed's meaning: it feels how rough the road is.
    """
    case = ride_cases.load_case(vehicle)
    result = []
    runs = tuple(range(seeds))
    for bumpy in (True, False):
        noise = ImuNoise().scaled(bumpy_noise if bumpy else 1.0)
        preview = ride_cases.BUMPY_PREVIEW_S if bumpy else case.car.wheelbase_m / ride_cases.ISO_SPEED_MPS
        road = ride_cases.bumpy_road() if bumpy else ride_cases.iso_roads(case.car, runs)
        long_waves = ride_designs.BUMPY_PREVIEW.controller(case.car, noise, preview)
        rough = ride_designs.ISO_PREVIEW.controller(case.car, noise, preview)
        index = [
            performance_index(case.car, case.rattle_space_m, simulate(case.car, road, c, noise, runs)).mean(
                axis=0
            )
            for c in (ScheduledRide(long_waves, rough), long_waves if bumpy else rough)
        ]
        result.append(index[0] / index[1])
    return result[0], result[1]


def _margins(rows: list[Row], case: ride_cases.Case) -> None:
    """Say how fragile each design is on the very vehicle it is designed for."""
    tau = case.car.wheelbase_m / ride_cases.ISO_SPEED_MPS
    designs = (
        ("bumpy preview x0.03", ride_designs.BUMPY_PREVIEW_TACTICAL, 0.03, ride_cases.BUMPY_PREVIEW_S, 0),
        ("bumpy preview x0.1", ride_designs.BUMPY_PREVIEW, 0.1, ride_cases.BUMPY_PREVIEW_S, 0),
        ("bumpy plain x1", ride_designs.BUMPY_PLAIN, 1.0, None, 0),
        ("iso comfort preview", ride_designs.ISO_PREVIEW, 1.0, tau, 0),
        ("iso holding", ride_designs.HOLDING_PLAIN, 1.0, None, 0),
        ("iso holding preview", ride_designs.HOLDING_PREVIEW, 1.0, tau, 0),
        ("robust", ride_designs.ROBUST, 1.0, None, 1),
    )
    for name, tuning, factor, preview, late in designs:
        controller = tuning.controller(case.car, ImuNoise().scaled(factor), preview, delay_samples=late)
        own = margins(case.car, controller)
        rows += [
            Row(f"{name}: disk margin, one loop at a time", own.disk_margin, "-"),
            Row(f"{name}: disk margin, all loops at once", own.multiloop_disk_margin, "-"),
            Row(f"{name}: delay margin beyond the designed delay", 1000 * own.delay_margin_s, "ms"),
        ]


def _rows(rows: list[Row], name: str, index: Array) -> None:
    printed = ride_cases.PRINTED[name]
    for label, value, unit, figure in zip(INDEX_NAMES, index, INDEX_UNITS, printed, strict=True):
        rows.append(Row(f"{name} {label}", float(value), unit, figure))


def _ratios(rows: list[Row], name: str, index: Array, still: Array) -> None:
    """Add active over passive, mean over roads, beside the printed table's own ratios."""
    printed = np.array(ride_cases.PRINTED["iso active"]) / np.array(ride_cases.PRINTED["iso passive"])
    ratio = (index / still).mean(axis=0)
    for i, body in CUTS:
        rows.append(Row(f"{name} rms {body} cut", 100 * (1 - float(ratio[i])), "%", 100 * (1 - printed[i])))
    for i in range(6, 10):
        label = f"{name} {INDEX_NAMES[i]}, active over passive"
        rows.append(Row(label, float(ratio[i]), "-", float(printed[i])))
    rows.append(
        Row(
            f"{name} peak mu of any road",
            float(index[:, 10:].max()),
            "-",
            max(ride_cases.PRINTED["iso active"][10:]),
        )
    )


def _series(
    series: dict[str, Any], name: str, case: ride_cases.Case, road: Array, passive: RideRun, active: RideRun
) -> None:
    """Keep what Figures 6.10, 6.14 and 6.15 draw, every 5 ms."""
    every = slice(None, None, 5)
    series[f"{name}_time_s"] = np.arange(passive.outputs.shape[1])[every] * FINE_S
    series[f"{name}_road_m"] = road[:-1][every]
    scale = case.car.tire_stiffness_npm / case.car.static_tire_load_n()
    for label, run_ in (("passive", passive), ("active", active)):
        series[f"{name}_{label}_acceleration_si"] = run_.accelerations[0, every]
        series[f"{name}_{label}_suspension_m"] = run_.suspension_m[0, every]
        series[f"{name}_{label}_relative_tire_load"] = run_.tire_m[0, every] * scale
    series[f"{name}_force_n"] = active.force_n[0]


def _report(progress: Callable[[float], None] | None, fraction: float) -> None:
    if progress is not None:
        progress(fraction)


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figures 6.10 (roads), 6.14 (bumpy) and 6.15 (ISO): accelerations, deflections, tyre loads."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    panels = (
        ("acceleration_si", ("heave m/s$^2$", "pitch rad/s$^2$", "roll rad/s$^2$")),
        ("suspension_m", ("FL m", "FR m", "RL m", "RR m")),
        ("relative_tire_load", (r"$\eta_1$", r"$\eta_2$", r"$\eta_3$", r"$\eta_4$")),
    )
    for name, figure_number in (("bumpy", "6_14"), ("iso", "6_15")):
        time_s = np.asarray(report.series[f"{name}_time_s"])
        figure, axis = plt.subplots(figsize=(7, 2.5), layout="constrained")
        axis.plot(time_s, np.asarray(report.series[f"{name}_road_m"]), label=["FL", "FR", "RL", "RR"])
        axis.set(xlabel="time s", ylabel="road m", title=f"Figure 6.10: {name} road")
        axis.legend(ncols=4)
        paths.append(directory / f"figure_6_10_{name}.png")
        figure.savefig(paths[-1], dpi=120)
        plt.close(figure)
        for quantity, labels in panels:
            figure, axes = plt.subplots(
                len(labels), 1, sharex=True, figsize=(7, 1.7 * len(labels)), layout="constrained"
            )
            for label, style in (("passive", "--"), ("active", "-")):
                values = np.asarray(report.series[f"{name}_{label}_{quantity}"])
                for i, axis in enumerate(axes):
                    axis.plot(time_s, values[:, i], style, label=label)
            for axis, text in zip(axes, labels, strict=True):
                axis.set_ylabel(text)
            axes[0].legend(ncols=2)
            axes[-1].set_xlabel("time s")
            paths.append(directory / f"figure_{figure_number}_{quantity}.png")
            figure.savefig(paths[-1], dpi=120)
            plt.close(figure)
    return paths
