"""Figure 6.16: reduction of RMS accelerations and tyre loads over the bumpy road from 15 to 50 m/s.

One design, scheduled over speed: the wheel delay follows the speed, and the weight on suspension travel is
raised until the springs keep to the rattle space. With fixed weights, as printed, mu < 1 is broken from 30
m/s on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.ride import ImuNoise
from tiger.studies import ride_cases
from tiger.studies.figures import new_figure, save
from tiger.studies.performance import BODY, PEAK_SUSPENSION, RMS_BODY, RMS_TIRE_LOAD, simulate
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.studies.report import Progress

    Array = NDArray[np.float64]

MEASURES = (*BODY, *(f"eta{i}" for i in range(1, 5)))
DESIGN_MU = 0.942
"""The schedule aims below the bar of 0.95 to leave room for sensor noise."""


def run(
    vehicle: str = "table-6-1",
    noise: float = 0.1,
    preview: bool = True,
    schedule: bool = True,
    slowest_mps: float = 15.0,
    fastest_mps: float = 50.0,
    step_mps: float = 5.0,
    seed: int = 0,
    progress: Progress = unwatched,
) -> Report:
    """Drive the bumpy road at every speed, passive and active.

    schedule False keeps the weights of 20 m/s, as the dissertation does. Wheel delays scale with 20 m/s over
    the speed.
    """
    if not 0.0 < slowest_mps <= fastest_mps or not step_mps > 0.0:
        raise ValueError(
            f"slowest_mps = {slowest_mps:g}, fastest_mps = {fastest_mps:g}, step_mps = {step_mps:g}: "
            "speeds go up from the slowest to the fastest; exchange them, or take a step above 0"
        )
    case = ride_cases.load_case(vehicle)
    speeds = np.arange(slowest_mps, fastest_mps + 0.5 * step_mps, step_mps)
    crossings = []
    for i, speed in enumerate(speeds):
        factor = suspension_factor(case, float(speed), noise, preview) if schedule else 1.0
        crossings.append(_cross(case, float(speed), factor, noise, preview, seed))
        progress((i + 1) / len(speeds))
    cuts = np.array([crossing.cut_percent for crossing in crossings])
    peak_mu = np.array([crossing.peak_mu for crossing in crossings])
    rows = _cut_rows("mean", cuts.mean(axis=0))
    for speed, cut, mu in zip(speeds, cuts, peak_mu, strict=True):
        rows += _cut_rows(f"{speed:g} m/s", cut)
        rows.append(Row(f"{speed:g} m/s peak mu", float(mu), "-"))
    rows.append(Row("peak mu of all speeds", float(peak_mu.max()), "-"))
    return Report(
        "Speed sweep over the bumpy road (Figure 6.16)",
        tuple(rows),
        {
            "speed_mps": speeds,
            "cut_percent": cuts,
            "peak_mu": peak_mu,
            "passive_peak_mu": np.array([crossing.passive_peak_mu for crossing in crossings]),
            "suspension_weight_factor": np.array([crossing.suspension_factor for crossing in crossings]),
            "peak_force_n": np.array([crossing.peak_force_n for crossing in crossings]),
        },
        {
            "noise factor": noise,
            "preview": preview,
            "schedule": f"suspension weight over speed, mu <= {DESIGN_MU:g} without noise"
            if schedule
            else "none, as printed",
            "wheel delays": "those of the printed table, scaled by 20 m/s over the speed",
            "model": "linear; no bump stops, no force limit",
            "seed": seed,
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Crossing:
    """The bumpy road at one speed."""

    cut_percent: Array
    """Of the RMS, active against passive, in the order of MEASURES."""
    peak_mu: float
    passive_peak_mu: float
    suspension_factor: float
    peak_force_n: float


def _cross(
    case: ride_cases.Case, speed_mps: float, factor: float, noise: float, preview: bool, seed: int
) -> _Crossing:
    """Cross the road passive and active, with `factor` on the suspension weight."""
    road = _road(speed_mps)
    controller = ride_cases.bumpy_controller(case, noise, preview, speed_mps, factor)
    driven = simulate(case.car, road, controller, ImuNoise().scaled(noise), (seed,))
    active, passive = case.index(driven)[0], case.index(simulate(case.car, road))[0]
    left = active / passive
    return _Crossing(
        cut_percent=100 * (1 - np.r_[left[RMS_BODY], left[RMS_TIRE_LOAD]]),
        peak_mu=float(active[PEAK_SUSPENSION].max()),
        passive_peak_mu=float(passive[PEAK_SUSPENSION].max()),
        suspension_factor=factor,
        peak_force_n=float(np.abs(driven.force_n).max()),
    )


def _cut_rows(name: str, cut_percent: Array) -> list[Row]:
    pairs = zip(MEASURES, cut_percent, strict=True)
    return [Row(f"{name} rms {measure} cut", float(cut), "%") for measure, cut in pairs]


def _road(speed_mps: float) -> Array:
    """The bumpy road under the wheels; a slower car takes longer over it."""
    ratio = ride_cases.BUMPY_SPEED_MPS / speed_mps
    return ride_cases.bumpy_road(speed_mps, ride_cases.BUMPY_DURATION_S * max(1.0, ratio))


def suspension_factor(case: ride_cases.Case, speed_mps: float, noise: float, preview: bool) -> float:
    """Return the least factor (from 1 up) on the suspension weight that keeps mu <= DESIGN_MU without noise.

    The most that is tried is 300: beyond, the springs are all but locked and the passive deflection is what
    remains.
    """
    road = _road(speed_mps)

    def peak(factor: float) -> float:
        controller = ride_cases.bumpy_controller(case, noise, preview, speed_mps, factor)
        run_ = simulate(case.car, road, controller)
        return float(np.abs(run_.suspension_m).max()) / case.rattle_space_m

    if peak(1.0) <= DESIGN_MU:
        return 1.0
    low, high = 1.0, 300.0
    for _ in range(9):
        middle = float(np.sqrt(low * high))
        if peak(middle) <= DESIGN_MU:
            high = middle
        else:
            low = middle
    return high


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figure 6.16."""
    s = report.arrays()
    speed, cut = s["speed_mps"], s["cut_percent"]
    figure = new_figure(12, 3.5)
    axes = figure.subplots(1, 3)
    axes[0].plot(speed, cut[:, :3], "o-", label=BODY)
    axes[1].plot(speed, cut[:, 3:], "o-", label=[rf"$\eta_{i}$" for i in range(1, 5)])
    axes[2].plot(speed, s["peak_mu"], "o-", label="active")
    axes[2].plot(speed, s["passive_peak_mu"], "s--", label="passive")
    for axis, label in zip(
        axes, ("RMS acceleration cut %", "RMS tyre load cut %", r"peak $\mu$"), strict=True
    ):
        axis.set(xlabel="speed m/s", ylabel=label)
        axis.legend()
    return [save(figure, directory / "figure_6_16_speed_sweep.png", 120)]
