"""Table 6.2: ride comfort, road holding and rattle space on the bumpy and the ISO road, passive beside
active.

Prints every row beside the printed one, for the bumpy road (worst and mean over noise seeds) and for ISO
class C (mean over roads). The ISO road is driven by three designs: one for comfort, which like the printed
table lets rear tyre loads grow; one that keeps every tyre load at or below the passive one; and that one with
wheelbase preview.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tiger.control import ride_designs
from tiger.control.margins import margins
from tiger.control.ride import ImuNoise
from tiger.control.ride_schedule import ScheduledRide
from tiger.studies import ride_cases
from tiger.studies.figures import new_figure, save
from tiger.studies.performance import (
    BODY,
    FINE_PER_PERIOD,
    FINE_S,
    INDEX_NAMES,
    INDEX_UNITS,
    PEAK_SUSPENSION,
    RMS_BODY,
    RMS_TIRE_LOAD,
    simulate,
)
from tiger.studies.report import CORNERS, Report, Row, unwatched

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.studies.performance import RideRun
    from tiger.studies.report import Progress

    Array = NDArray[np.float64]
    Series = dict[str, Array]

PANELS = {
    "acceleration_si": ("heave m/s$^2$", "pitch rad/s$^2$", "roll rad/s$^2$"),
    "suspension_m": tuple(f"{corner} m" for corner in CORNERS),
    "relative_tire_load": (r"$\eta_1$", r"$\eta_2$", r"$\eta_3$", r"$\eta_4$"),
}


def run(
    vehicle: str = "table-6-1",
    bumpy_noise: float = 0.03,
    iso_noise: float = 1.0,
    preview: bool = True,
    first_seed: int = 0,
    bumpy_seeds: int = 20,
    iso_seeds: int = 40,
    progress: Progress = unwatched,
) -> Report:
    """Drive both roads, passive and active.

    The noises scale 0.02 m/s^2 and 0.001 rad/s per sample at 200 Hz. preview: rear wheels are told what the
    front wheels met. Without it the bumpy road takes the bank for the nominal IMU, which is told how far
    apart the lanes meet a wave but not which lane is first. Seeds count up from first_seed.
    """
    case = ride_cases.load_case(vehicle)
    noises = tuple(range(first_seed, first_seed + bumpy_seeds))
    bumpy_rows, bumpy_series = _bumpy(case, bumpy_noise, preview, noises)
    progress(0.2)
    imu_rows = _other_imus(case, noises)
    progress(0.4)
    roads = tuple(range(first_seed, first_seed + iso_seeds))
    iso_rows, iso_series = _iso(case, iso_noise, preview, roads)
    progress(0.9)
    bumpy, iso = compare_schedule(vehicle)
    return Report(
        "Table 6.2: simulation results for the two road profiles",
        (
            *bumpy_rows,
            *imu_rows,
            *iso_rows,
            Row(
                "one scheduled controller over the separate design, worst bumpy row", float(bumpy.max()), "-"
            ),
            Row("one scheduled controller over the separate design, worst iso row", float(iso.max()), "-"),
            *_margin_rows(case),
        ),
        bumpy_series | iso_series,
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
    case: ride_cases.Case, factor: float, preview: bool, seeds: tuple[int, ...]
) -> tuple[list[Row], Series]:
    """Drive the bumpy road passive and active, one run a noise seed."""
    noise = ImuNoise().scaled(factor)
    road = ride_cases.bumpy_road()
    controller = ride_cases.bumpy_controller(case, factor, preview, max_force_n=case.max_force_n)
    passive = simulate(case.car, road)
    active = simulate(case.car, road, controller, noise, seeds)
    index = case.index(active)
    ratio = index / np.array(ride_cases.PRINTED["bumpy active"])
    inside = float((ratio.max(axis=1) <= 1.003).mean())
    rows = [
        *_index_rows("bumpy passive", case.index(passive)[0]),
        *_index_rows("bumpy active", index.mean(axis=0)),
        Row("bumpy active, worst mean row over printed", float(ratio.mean(axis=0).max()), "-"),
        Row("bumpy active, worst row of any seed over printed", float(ratio.max()), "-"),
        Row("bumpy active, seeds with every row <= 1.003 x printed", inside, "-"),
        Row("bumpy active, peak force", float(np.abs(active.force_n).max()), "N"),
    ]
    return rows, _series("bumpy", case, road, passive, active)


def _other_imus(case: ride_cases.Case, seeds: tuple[int, ...]) -> list[Row]:
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
    rows = []
    for name, factor, controller in designs:
        index = case.index(simulate(case.car, road, controller, ImuNoise().scaled(factor), seeds))
        ratio = index.mean(axis=0) / np.array(ride_cases.PRINTED["bumpy active"])
        rows.append(Row(f"bumpy active, {name}, worst mean row over printed", float(ratio.max()), "-"))
    return rows


def _iso(
    case: ride_cases.Case, factor: float, preview: bool, seeds: tuple[int, ...]
) -> tuple[list[Row], Series]:
    """Drive ISO roads passive and with the three designs, one road a seed."""
    noise = ImuNoise().scaled(factor)
    roads = ride_cases.iso_roads(case.car, seeds)

    def drive(tuning: ride_designs.RideTuning, sees: bool) -> RideRun:
        preview_s = case.iso_preview_s if sees else None
        controller = tuning.controller(case.car, noise, preview_s, max_force_n=case.max_force_n)
        return simulate(case.car, roads, controller, noise, seeds)

    passive = simulate(case.car, roads, seeds=seeds)
    comfort = drive(ride_designs.ISO_PREVIEW if preview else ride_designs.ISO_PLAIN, preview)
    active = {
        "iso active": comfort,
        "iso holding": drive(ride_designs.HOLDING_PLAIN, False),
        "iso holding preview": drive(ride_designs.HOLDING_PREVIEW, True),
    }
    still = case.index(passive)
    rows = [
        *_index_rows("iso passive", still.mean(axis=0)),
        *_index_rows("iso active", case.index(comfort).mean(axis=0)),
    ]
    for name, run_ in active.items():
        rows += _ratio_rows(name, case.index(run_), still)
    return rows, _series("iso", case, roads[0], passive, comfort)


def compare_schedule(
    vehicle: str = "table-6-1", bumpy_noise: float = 0.1, seeds: int = 10
) -> tuple[Array, Array]:
    """Return rows of the scheduled controller over those of the two separate designs: (14,) bumpy, (14,) ISO.

    The schedule is told neither the road nor the speed's meaning: it feels how rough the road is.
    """
    case = ride_cases.load_case(vehicle)
    runs = tuple(range(seeds))

    def compared(road: Array, noise: ImuNoise, preview_s: float, is_bumpy: bool) -> Array:
        long_waves = ride_designs.BUMPY_PREVIEW.controller(case.car, noise, preview_s)
        rough = ride_designs.ISO_PREVIEW.controller(case.car, noise, preview_s)
        scheduled, separate = (
            case.index(simulate(case.car, road, controller, noise, runs)).mean(axis=0)
            for controller in (ScheduledRide(long_waves, rough), long_waves if is_bumpy else rough)
        )
        return np.asarray(scheduled / separate)

    bumpy_imu = ImuNoise().scaled(bumpy_noise)
    return (
        compared(ride_cases.bumpy_road(), bumpy_imu, ride_cases.BUMPY_PREVIEW_S, True),
        compared(ride_cases.iso_roads(case.car, runs), ImuNoise(), case.iso_preview_s, False),
    )


def _margin_rows(case: ride_cases.Case) -> list[Row]:
    """Say how fragile each design is on the very vehicle it is designed for."""
    tau = case.iso_preview_s
    designs = (
        ("bumpy preview x0.03", ride_designs.BUMPY_PREVIEW_TACTICAL, 0.03, ride_cases.BUMPY_PREVIEW_S, 0),
        ("bumpy preview x0.1", ride_designs.BUMPY_PREVIEW, 0.1, ride_cases.BUMPY_PREVIEW_S, 0),
        ("bumpy plain x1", ride_designs.BUMPY_PLAIN, 1.0, None, 0),
        ("iso comfort preview", ride_designs.ISO_PREVIEW, 1.0, tau, 0),
        ("iso holding", ride_designs.HOLDING_PLAIN, 1.0, None, 0),
        ("iso holding preview", ride_designs.HOLDING_PREVIEW, 1.0, tau, 0),
        ("robust", ride_designs.ROBUST, 1.0, None, 1),
    )
    rows = []
    for name, tuning, factor, preview_s, late in designs:
        controller = tuning.controller(case.car, ImuNoise().scaled(factor), preview_s, delay_samples=late)
        own = margins(case.car, controller)
        rows += [
            Row(f"{name}: disk margin, one loop at a time", own.disk_margin, "-"),
            Row(f"{name}: disk margin, all loops at once", own.multiloop_disk_margin, "-"),
            Row(f"{name}: delay margin beyond the designed delay", 1000 * own.delay_margin_s, "ms"),
        ]
    return rows


def _index_rows(name: str, index: Array) -> list[Row]:
    """The fourteen rows of a column of the table, beside the printed ones."""
    lines = zip(INDEX_NAMES, index, INDEX_UNITS, ride_cases.PRINTED[name], strict=True)
    return [Row(f"{name} {label}", float(value), unit, printed) for label, value, unit, printed in lines]


def _ratio_rows(name: str, index: Array, still: Array) -> list[Row]:
    """Active over passive, mean over roads, beside the printed table's own ratios."""
    printed_active = np.array(ride_cases.PRINTED["iso active"])
    printed = printed_active / np.array(ride_cases.PRINTED["iso passive"])
    ratio = (index / still).mean(axis=0)
    bodies = zip(BODY, ratio[RMS_BODY], printed[RMS_BODY], strict=True)
    tires = zip(INDEX_NAMES[RMS_TIRE_LOAD], ratio[RMS_TIRE_LOAD], printed[RMS_TIRE_LOAD], strict=True)
    return [
        *(
            Row(f"{name} rms {body} cut", 100 * (1 - float(ours)), "%", 100 * (1 - float(theirs)))
            for body, ours, theirs in bodies
        ),
        *(
            Row(f"{name} {eta}, active over passive", float(ours), "-", float(theirs))
            for eta, ours, theirs in tires
        ),
        Row(
            f"{name} peak mu of any road",
            float(index[:, PEAK_SUSPENSION].max()),
            "-",
            float(printed_active[PEAK_SUSPENSION].max()),
        ),
    ]


def _series(name: str, case: ride_cases.Case, road: Array, passive: RideRun, active: RideRun) -> Series:
    """What Figures 6.10, 6.14 and 6.15 draw, once a control period."""
    every = slice(None, None, FINE_PER_PERIOD)
    series = {
        f"{name}_time_s": np.arange(passive.outputs.shape[1], dtype=np.float64)[every] * FINE_S,
        f"{name}_road_m": road[:-1][every],
    }
    scale = case.car.tire_stiffness_npm / case.car.static_tire_load_n()
    for label, run_ in (("passive", passive), ("active", active)):
        series[f"{name}_{label}_acceleration_si"] = run_.accelerations[0, every]
        series[f"{name}_{label}_suspension_m"] = run_.suspension_m[0, every]
        series[f"{name}_{label}_relative_tire_load"] = run_.tire_m[0, every] * scale
    series[f"{name}_force_n"] = active.force_n[0]
    return series


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figures 6.10 (roads), 6.14 (bumpy) and 6.15 (ISO): accelerations, deflections, tyre loads."""
    series = report.arrays()
    paths = []
    for name, number in (("bumpy", "6_14"), ("iso", "6_15")):
        paths.append(_draw_road(series, name, directory / f"figure_6_10_{name}.png"))
        for quantity, labels in PANELS.items():
            path = directory / f"figure_{number}_{quantity}.png"
            paths.append(_draw_both(series, name, quantity, labels, path))
    return paths


def _draw_road(series: Series, name: str, path: Path) -> Path:
    figure = new_figure(7, 2.5)
    axis = figure.subplots()
    axis.plot(series[f"{name}_time_s"], series[f"{name}_road_m"], label=CORNERS)
    axis.set(xlabel="time s", ylabel="road m", title=f"Figure 6.10: {name} road")
    axis.legend(ncols=4)
    return save(figure, path, 120)


def _draw_both(series: Series, name: str, quantity: str, labels: tuple[str, ...], path: Path) -> Path:
    """Draw a quantity over time, a panel a column, passive beside active."""
    figure = new_figure(7, 1.7 * len(labels))
    axes = figure.subplots(len(labels), 1, sharex=True)
    for suspension, style in (("passive", "--"), ("active", "-")):
        values = series[f"{name}_{suspension}_{quantity}"]
        for axis, column in zip(axes, values.T, strict=True):
            axis.plot(series[f"{name}_time_s"], column, style, label=suspension)
    for axis, text in zip(axes, labels, strict=True):
        axis.set_ylabel(text)
    axes[0].legend(ncols=2)
    axes[-1].set_xlabel("time s")
    return save(figure, path, 120)
