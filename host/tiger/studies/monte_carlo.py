"""How a controller designed for one vehicle does on a thousand others, with roads, noise and delays of their
own.

Every run draws a vehicle (centre of mass, mass, springs), a delay, a road and sensor noise from its own seed,
and is compared with the nominal vehicle on the same road. Runs are independent: they go to local processes,
or to a Dask cluster through joblib's backend for it.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.config.errors import ConfigError
from tiger.control import ride_designs
from tiger.control.margins import closed_loop, margins
from tiger.control.ride import PERIOD_S, ImuNoise
from tiger.studies import ride_cases
from tiger.studies.performance import FINE_S, performance_index, simulate
from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.control.ride import RideController

    Array = NDArray[np.float64]

BODY_ROWS = (1, 3, 5)
BODY = ("heave", "pitch", "roll")
COLUMNS = (
    *(f"{body} cut" for body in BODY),
    *(f"nominal {body} cut" for body in BODY),
    "worst eta ratio",
    "peak mu",
    "largest pole",
)
DESIGNS: dict[str, tuple[ride_designs.RideTuning, bool, int]] = {
    "robust": (ride_designs.ROBUST, False, 1),
    "holding": (ride_designs.HOLDING_PLAIN, False, 0),
    "holding-preview": (ride_designs.HOLDING_PREVIEW, True, 0),
    "comfort-preview": (ride_designs.ISO_PREVIEW, True, 0),
}
"""Name -> (tuning, preview, samples of delay it is designed for)."""
BATCH = 10


def build(design: str, case: ride_cases.Case, speed_mps: float) -> RideController:
    """Design the named controller for the nominal vehicle. Raises ConfigError for an unknown name."""
    if design not in DESIGNS:
        raise ConfigError(f"design {design!r} is not known; use one of {', '.join(DESIGNS)}")
    tuning, preview, delay = DESIGNS[design]
    seen = case.car.wheelbase_m / speed_mps if preview else None
    return tuning.controller(case.car, ImuNoise(), seen, delay_samples=delay)


def sample(vehicle: str, design: str, road_class: str, spread: tuple[float, ...], seeds: list[int]) -> Array:
    """Run the given seeds and return COLUMNS, shape (len(seeds), 9); what a worker does.

    spread: fractions for the centre of mass, mass and springs, then nominal delay and its spread in
    milliseconds.
    """
    case = ride_cases.load_case(vehicle)
    controller = build(design, case, ride_cases.ISO_SPEED_MPS)
    # The road of the nominal wheelbase serves all: a moved centre of mass does not change the wheelbase.
    roads = ride_cases.iso_roads(case.car, seeds, road_class)
    late = controller.delay_samples * PERIOD_S
    runs = tuple(seeds)
    still = performance_index(case.car, case.rattle_space_m, simulate(case.car, roads, seeds=runs))
    active = simulate(case.car, roads, controller, ImuNoise(), runs, delay_s=late)
    nominal = 100 * (1 - performance_index(case.car, case.rattle_space_m, active) / still)
    return np.array(
        [
            _one(case, controller, road, spread, seed, own[list(BODY_ROWS)])
            for seed, road, own in zip(seeds, roads, nominal, strict=True)
        ]
    )


def _one(
    case: ride_cases.Case,
    controller: RideController,
    road: Array,
    spread: tuple[float, ...],
    seed: int,
    nominal: Array,
) -> list[float]:
    """Draw one vehicle and one delay, drive the road passive and active, and return COLUMNS."""
    com, mass, spring, delay_ms, delay_spread_ms = spread
    rng = np.random.default_rng([seed, 7])
    car, imu = ride_cases.perturbed(case.car, *(rng.uniform(-1, 1, 5) * [com, com, mass, spring, spring]))
    extra = rng.integers(-round(delay_spread_ms), round(delay_spread_ms), endpoint=True)
    delay_s = max(0.0, (delay_ms + float(extra)) * FINE_S)
    pole = float(np.abs(closed_loop(car, controller, delay_s, imu).poles()).max())
    if pole >= 1:
        return [np.nan] * 3 + [*nominal] + [np.nan, np.inf, pole]
    still = performance_index(car, case.rattle_space_m, simulate(car, road, imu_offset_m=imu))[0]
    run_ = simulate(car, road, controller, ImuNoise(), (seed,), imu, delay_s)
    index = performance_index(car, case.rattle_space_m, run_)[0]
    ratio = index / still
    cuts = 100 * (1 - ratio[list(BODY_ROWS)])
    return [*cuts, *nominal, float(ratio[6:10].max()), float(index[10:].max()), pole]


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
    progress: Callable[[float], None] | None = None,
) -> Report:
    """Run the Monte Carlo on ISO roads of the given class at 10 m/s.

    com, mass and spring are the half-widths of uniform relative errors. cluster: address of a Dask scheduler,
    such as tcp://127.0.0.1:8786; empty for `jobs` local processes (-1: all cores, 1: this process).
    """
    case = ride_cases.load_case(vehicle)
    controller = build(design, case, ride_cases.ISO_SPEED_MPS)
    spread = (com, mass, spring, delay_ms, delay_spread_ms)
    seeds = [
        list(range(first_seed + i, min(first_seed + i + BATCH, first_seed + runs)))
        for i in range(0, runs, BATCH)
    ]
    table = _spread_out(vehicle, design, road_class, spread, seeds, jobs, cluster, progress)
    lost = table[:, 3:6] - table[:, :3]
    rows = [
        Row("runs", len(table), "-"),
        Row("stable", 100 * float((table[:, 8] < 1).mean()), "%"),
        Row("largest pole of any run", float(table[:, 8].max()), "-"),
        Row("peak mu of any run", float(table[:, 7].max()), "-"),
        Row("worst eta, active over passive, median", float(np.nanmedian(table[:, 6])), "-"),
    ]
    for i, body in enumerate(BODY):
        rows += [
            Row(f"rms {body} cut, nominal, median", float(np.median(table[:, 3 + i])), "%"),
            Row(f"rms {body} cut, median", float(np.nanmedian(table[:, i])), "%"),
            Row(f"rms {body} cut, 5th percentile", float(np.nanpercentile(table[:, i], 5)), "%"),
            Row(f"rms {body} cut, points lost in the median", float(np.nanmedian(lost[:, i])), "%"),
        ]
    own = margins(case.car, controller)
    rows += [
        Row("disk margin, one loop at a time", own.disk_margin, "-"),
        Row("disk margin, all loops at once", own.multiloop_disk_margin, "-"),
        Row("guaranteed gain margin", own.gain_margin_db, "dB"),
        Row("guaranteed phase margin", own.phase_margin_deg, "deg"),
        Row("delay margin beyond the designed delay", 1000 * own.delay_margin_s, "ms"),
    ]
    return Report(
        f"Monte Carlo of the {design} design",
        tuple(rows),
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


def _spread_out(
    vehicle: str,
    design: str,
    road_class: str,
    spread: tuple[float, ...],
    seeds: list[list[int]],
    jobs: int,
    cluster: str,
    progress: Callable[[float], None] | None,
) -> Array:
    """Run the batches where they belong and collect them in order."""
    from joblib import Parallel, delayed, parallel_config

    context: AbstractContextManager[Any] = nullcontext()
    if cluster:
        from distributed import Client

        context = Client(cluster, timeout="10s")  # type: ignore[no-untyped-call]
    parts: list[Array] = []
    with context:
        backend = (
            {"backend": "dask"}
            if cluster
            else {"backend": "loky", "n_jobs": jobs, "inner_max_num_threads": 1}
        )
        with parallel_config(**backend):
            work = (delayed(sample)(vehicle, design, road_class, spread, batch) for batch in seeds)
            for part in Parallel(return_as="list" if cluster else "generator")(work):
                parts.append(part)
                if progress is not None:
                    progress(len(parts) / len(seeds))
    return np.concatenate(parts)


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the distributions of the cuts and of mu."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    directory.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
    for axis, body in zip(axes, BODY, strict=False):
        axis.hist(
            np.asarray(report.series[f"nominal_{body}_cut_value"]), bins=30, histtype="step", label="nominal"
        )
        axis.hist(np.asarray(report.series[f"{body}_cut_value"]), bins=30, histtype="step", label="perturbed")
        axis.set_xlabel(f"RMS {body} cut %")
    axes[0].legend()
    axes[3].hist(np.asarray(report.series["peak_mu_value"]), bins=30, histtype="step")
    axes[3].set_xlabel(r"peak $\mu$")
    path = directory / "monte_carlo.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return [path]
