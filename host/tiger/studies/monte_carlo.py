"""How a controller designed for one vehicle does on a thousand others, with roads, noise and delays of their
own.

Every run draws a vehicle (centre of mass, mass, springs), a delay, a road and sensor noise from its own seed,
and is compared with the nominal vehicle on the same road. Runs are independent: they go to local processes,
or to a Dask cluster through joblib's backend for it.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiger.config.errors import ConfigError
from tiger.control import ride_designs
from tiger.control.margins import closed_loop, margins
from tiger.control.ride import PERIOD_S, ImuNoise
from tiger.studies import ride_cases
from tiger.studies.figures import new_figure, save
from tiger.studies.performance import BODY, FINE_S, PEAK_SUSPENSION, RMS_BODY, RMS_TIRE_LOAD, simulate
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.control.ride import RideController
    from tiger.studies.report import Progress

    Array = NDArray[np.float64]

COLUMNS = (
    *(f"{body} cut" for body in BODY),
    *(f"nominal {body} cut" for body in BODY),
    "worst eta ratio",
    "peak mu",
    "largest pole",
)
CUT, NOMINAL_CUT = slice(0, 3), slice(3, 6)
WORST_ETA_RATIO, PEAK_MU, LARGEST_POLE = 6, 7, 8
"""Where the columns are."""
DESIGNS: dict[str, tuple[ride_designs.RideTuning, bool, int]] = {
    "robust": (ride_designs.ROBUST, False, 1),
    "holding": (ride_designs.HOLDING_PLAIN, False, 0),
    "holding-preview": (ride_designs.HOLDING_PREVIEW, True, 0),
    "comfort-preview": (ride_designs.ISO_PREVIEW, True, 0),
}
"""Name -> (tuning, preview, samples of delay it is designed for)."""
BATCH = 10


class Spread(NamedTuple):
    """How far the drawn vehicles and delays lie from the nominal ones, uniformly."""

    com: float
    mass: float
    spring: float
    """Half-widths of relative errors; the centre of mass moves in x and y."""
    delay_ms: float
    delay_spread_ms: float


def build(design: str, case: ride_cases.Case, speed_mps: float) -> RideController:
    """Design the named controller for the nominal vehicle. Raises ConfigError for an unknown name."""
    if design not in DESIGNS:
        raise ConfigError(f"design {design!r} is not known; use one of {', '.join(DESIGNS)}")
    tuning, preview, delay = DESIGNS[design]
    seen = case.car.wheelbase_m / speed_mps if preview else None
    return tuning.controller(case.car, ImuNoise(), seen, delay_samples=delay)


def sample(vehicle: str, design: str, road_class: str, spread: Spread, seeds: list[int]) -> Array:
    """Run the given seeds and return COLUMNS, shape (len(seeds), 9); what a worker does."""
    case = ride_cases.load_case(vehicle)
    controller = build(design, case, ride_cases.ISO_SPEED_MPS)
    # The road of the nominal wheelbase serves all: a moved centre of mass does not change the wheelbase.
    roads = ride_cases.iso_roads(case.car, seeds, road_class)
    late = controller.delay_samples * PERIOD_S
    runs = tuple(seeds)
    passive = case.index(simulate(case.car, roads, seeds=runs))
    active = case.index(simulate(case.car, roads, controller, ImuNoise(), runs, delay_s=late))
    nominal_cut = 100 * (1 - active / passive)[:, RMS_BODY]
    return np.array(
        [
            _one(case, controller, road, spread, seed, own)
            for seed, road, own in zip(seeds, roads, nominal_cut, strict=True)
        ]
    )


def _one(
    case: ride_cases.Case,
    controller: RideController,
    road: Array,
    spread: Spread,
    seed: int,
    nominal_cut: Array,
) -> Array:
    """Draw one vehicle and one delay, drive the road passive and active, and return COLUMNS."""
    com, mass, spring, delay_ms, delay_spread_ms = spread
    rng = np.random.default_rng([seed, 7])
    car, imu = ride_cases.perturbed(case.car, *(rng.uniform(-1, 1, 5) * [com, com, mass, spring, spring]))
    extra = rng.integers(-round(delay_spread_ms), round(delay_spread_ms), endpoint=True)
    delay_s = max(0.0, (delay_ms + float(extra)) * FINE_S)
    pole = float(np.abs(closed_loop(car, controller, delay_s, imu).poles()).max())
    if pole >= 1:
        return np.array([*(np.nan,) * 3, *nominal_cut, np.nan, np.inf, pole])
    drawn = replace(case, car=car)
    passive = drawn.index(simulate(car, road, imu_offset_m=imu))[0]
    active = drawn.index(simulate(car, road, controller, ImuNoise(), (seed,), imu, delay_s))[0]
    left = active / passive
    cut = 100 * (1 - left[RMS_BODY])
    return np.array([*cut, *nominal_cut, left[RMS_TIRE_LOAD].max(), active[PEAK_SUSPENSION].max(), pole])


def run(
    vehicle: str = "table-6-1",
    runs: int = 200,
    design: str = "robust",
    road_class: str = "C",
    com: float = 0.2,
    mass: float = 0.3,
    spring: float = 0.2,
    delay_ms: float = 5.0,
    delay_spread_ms: float = 2.0,
    first_seed: int = 0,
    jobs: int = -1,
    cluster: str = "",
    progress: Progress = unwatched,
) -> Report:
    """Run the Monte Carlo on ISO roads of the given class at 10 m/s.

    com, mass and spring are the half-widths of uniform relative errors. cluster: address of a Dask scheduler,
    such as tcp://127.0.0.1:8786; empty for `jobs` local processes (-1: all cores, 1: this process).
    """
    case = ride_cases.load_case(vehicle)
    controller = build(design, case, ride_cases.ISO_SPEED_MPS)
    spread = Spread(com, mass, spring, delay_ms, delay_spread_ms)
    seeds = range(first_seed, first_seed + runs)
    batches = [list(seeds[i : i + BATCH]) for i in range(0, runs, BATCH)]
    work = partial(sample, vehicle, design, road_class, spread)
    table = _gather(work, batches, jobs, cluster, progress)
    return Report(
        f"Monte Carlo of the {design} design",
        (*_outcome_rows(table), *_margin_rows(case, controller)),
        {name.replace(" ", "_") + "_value": table[:, i] for i, name in enumerate(COLUMNS)},
        {
            "road": f"ISO class {road_class} at {ride_cases.ISO_SPEED_MPS} m/s, one road per run",
            "spread (com x and y, mass, springs)": [com, mass, spring],
            "delay (ms)": f"{delay_ms} +- {delay_spread_ms}, whole milliseconds",
            "inertias": "grow with the mass",
            "imu": "where the nominal centre of mass is",
            "figures": "over the stable runs",
            "first seed": first_seed,
        },
    )


def _outcome_rows(table: Array) -> list[Row]:
    """What became of the drawn vehicles, from their COLUMNS (runs, 9)."""
    rows = [
        Row("runs", len(table), "-"),
        Row("stable", 100 * float((table[:, LARGEST_POLE] < 1).mean()), "%"),
        Row("largest pole of any run", float(table[:, LARGEST_POLE].max()), "-"),
        Row("peak mu of any run", float(table[:, PEAK_MU].max()), "-"),
        Row("worst eta, active over passive, median", float(np.nanmedian(table[:, WORST_ETA_RATIO])), "-"),
    ]
    for body, cut, nominal in zip(BODY, table[:, CUT].T, table[:, NOMINAL_CUT].T, strict=True):
        rows += [
            Row(f"rms {body} cut, nominal, median", float(np.median(nominal)), "%"),
            Row(f"rms {body} cut, median", float(np.nanmedian(cut)), "%"),
            Row(f"rms {body} cut, 5th percentile", float(np.nanpercentile(cut, 5)), "%"),
            Row(f"rms {body} cut, points lost in the median", float(np.nanmedian(nominal - cut)), "%"),
        ]
    return rows


def _margin_rows(case: ride_cases.Case, controller: RideController) -> list[Row]:
    """How far the loop is from instability on the very vehicle it is designed for."""
    own = margins(case.car, controller)
    return [
        Row("disk margin, one loop at a time", own.disk_margin, "-"),
        Row("disk margin, all loops at once", own.multiloop_disk_margin, "-"),
        Row("guaranteed gain margin", own.gain_margin_db, "dB"),
        Row("guaranteed phase margin", own.phase_margin_deg, "deg"),
        Row("delay margin beyond the designed delay", 1000 * own.delay_margin_s, "ms"),
    ]


def _gather(
    work: Callable[[list[int]], Array], batches: list[list[int]], jobs: int, cluster: str, progress: Progress
) -> Array:
    """Do the batches of work where they belong and return their rows in order."""
    from joblib import Parallel, delayed

    parts: list[Array] = []
    with _workers(jobs, cluster):
        run_all = Parallel(return_as="list" if cluster else "generator")
        for part in run_all(delayed(work)(batch) for batch in batches):
            parts.append(part)
            progress(len(parts) / len(batches))
    return np.concatenate(parts)


@contextmanager
def _workers(jobs: int, cluster: str) -> Iterator[None]:
    """Send joblib's work to `jobs` processes of this computer, or to the Dask scheduler of a cluster."""
    from joblib import parallel_config

    if not cluster:
        with parallel_config(backend="loky", n_jobs=jobs, inner_max_num_threads=1):
            yield
        return
    from distributed import Client

    with Client(cluster, timeout="10s"), parallel_config(backend="dask"):  # type: ignore[no-untyped-call]
        yield


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the distributions of the cuts and of mu."""
    s = report.arrays()
    figure = new_figure(13, 3.2)
    axes = figure.subplots(1, 4)
    for axis, body in zip(axes, BODY, strict=False):
        axis.hist(s[f"nominal_{body}_cut_value"], bins=30, histtype="step", label="nominal")
        axis.hist(s[f"{body}_cut_value"], bins=30, histtype="step", label="perturbed")
        axis.set_xlabel(f"RMS {body} cut %")
    axes[0].legend()
    axes[3].hist(s["peak_mu_value"], bins=30, histtype="step")
    axes[3].set_xlabel(r"peak $\mu$")
    return [save(figure, directory / "monte_carlo.png", 120)]
