"""What actuators that are too weak or too slow do to the bumpy road: a regulator that runs into their limits,
beside a predictive controller that plans for them.

Both use the same filter and weights, with wheelbase preview. The regulator's force is cut to the limit on
force and on its rate, and its filter knows the force that acts. The predictive controller knows the limits,
and one on suspension travel, before they are met.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control import mpc, ride_designs
from tiger.control.ride import PERIOD_S, ImuNoise, RideController, RideState
from tiger.studies import ride_cases
from tiger.studies.figures import new_figure, save
from tiger.studies.performance import FINE_PER_PERIOD, FINE_S, INDEX_NAMES, INDEX_UNITS, simulate
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from tiger.studies.performance import Controller, RideRun
    from tiger.studies.report import Progress

    Array = NDArray[np.float64]

FORCES_N = (6000.0, 5000.0, 4000.0, 3000.0)
SHOWN_N = 4000.0
"""The limit at which both are drawn over time."""
_ROWS = (0, 1, 2, 4)
"""Of the performance index: peak and RMS heave, peak pitch, peak roll."""


@dataclass(frozen=True, slots=True, eq=False)
class CutRegulator:
    """The regulator with its force cut to a limit on force and on rate."""

    controller: RideController
    limits: mpc.Limits

    def start(self, runs: int | None = None) -> RideState:
        """Return the state of a controller that knows nothing yet."""
        return self.controller.start(runs)

    def step(self, state: RideState, imu: Array) -> tuple[RideState, Array]:
        """Take one IMU sample (3, runs) and return the new state and the force that acts."""
        model = self.controller.model
        innovation = imu - model.c @ state.predicted - model.d @ state.acting_n
        estimate = state.predicted + self.controller.filter_gain @ innovation
        reach = self.limits.force_rate_nps * PERIOD_S
        force = np.clip(-self.controller.feedback @ estimate, state.acting_n - reach, state.acting_n + reach)
        force = np.clip(force, -self.limits.force_n, self.limits.force_n)
        return RideState(model.a @ estimate + model.b @ force, force, force), force


class Timed:
    """Runs a controller and keeps the CPU time of every tick."""

    def __init__(self, controller: Controller) -> None:
        """Wrap the controller."""
        self.controller, self.spent_s = controller, list[float]()

    def start(self, runs: int | None = None) -> Any:
        """Return the controller's own start."""
        return self.controller.start(runs)

    def step(self, state: Any, imu: Array) -> tuple[Any, Array]:
        """Time the controller's own step."""
        begin = time.thread_time()
        result = self.controller.step(state, imu)
        self.spent_s.append(time.thread_time() - begin)
        return result


def run(
    vehicle: str = "table-6-1",
    noise: float = 0.1,
    rate_nps: float = 60_000.0,
    travel_mm: float = 70.0,
    seed: int = 0,
    progress: Progress = unwatched,
) -> Report:
    """Drive the bumpy road with force limits of 6, 5, 4 and 3 kN.

    noise scales 0.02 m/s^2 and 0.001 rad/s. rate_nps limits how fast a force changes, travel_mm is the
    suspension travel that the predictive controller aims to keep (the rattle space of the preset is 80 mm).
    """
    case = ride_cases.load_case(vehicle)
    imu = ImuNoise().scaled(noise)
    road = ride_cases.bumpy_road()
    tuning = ride_designs.for_bumpy_road(noise, preview=True)
    regulator = tuning.controller(case.car, imu, ride_cases.BUMPY_PREVIEW_S)

    def drive(controller: Controller) -> RideRun:
        return simulate(case.car, road, controller, imu, (seed,))

    unlimited = drive(CutRegulator(regulator, mpc.Limits(np.inf, np.inf, 1e-3 * travel_mm)))
    rows = _rows(case, "regulator, no limits", unlimited)
    runs: dict[str, list[RideRun]] = {"regulator": [], "predictive": []}
    ticks_s: list[float] = []
    for done, force_n in enumerate(FORCES_N):
        progress((done + 1) / (len(FORCES_N) + 1))
        limits = mpc.Limits(force_n, rate_nps, 1e-3 * travel_mm)
        predictive = Timed(mpc.design(regulator, tuning.weights, limits))
        runs["regulator"].append(drive(CutRegulator(regulator, limits)))
        runs["predictive"].append(drive(predictive))
        ticks_s += predictive.spent_s
        for name, driven in runs.items():
            rows += _rows(case, f"{name}, {force_n / 1000:g} kN", driven[-1])
    rows += [
        Row("predictive tick, median", 1000 * float(np.median(ticks_s)), "ms"),
        Row("predictive tick, 99th percentile", 1000 * float(np.percentile(ticks_s, 99)), "ms"),
    ]
    series = {
        "limit_n": np.array(FORCES_N),
        **{
            f"{name}_peak_heave_mps2": np.array([case.index(one)[0, 0] for one in driven])
            for name, driven in runs.items()
        },
        "time_s": np.arange(len(road) - 1)[::FINE_PER_PERIOD] * FINE_S,
    }
    for name, driven in runs.items():
        series |= _series(name, driven[FORCES_N.index(SHOWN_N)])
    return Report(
        "Force limits over the bumpy road: regulator beside predictive controller",
        tuple(rows),
        series,
        {
            "noise factor": noise,
            "force rate limit (N/s)": rate_nps,
            "travel limit of the predictive controller (mm)": travel_mm,
            "horizon": "25 periods of 5 ms in 5 blocks; limits checked at the start of each block",
            "preview": ride_cases.BUMPY_PREVIEW_S,
            "tick": "CPU time of one thread",
            "seed": seed,
        },
    )


def _rows(case: ride_cases.Case, label: str, driven: RideRun) -> list[Row]:
    """Say how well a run rode, and how much travel, force and rate it used."""
    index = case.index(driven)[0]
    rate = np.abs(np.diff(driven.force_n, axis=1)).max() / PERIOD_S
    return [
        *(Row(f"{label}: {INDEX_NAMES[i]}", float(index[i]), INDEX_UNITS[i]) for i in _ROWS),
        Row(f"{label}: largest suspension travel", 1000 * float(np.abs(driven.suspension_m).max()), "mm"),
        Row(f"{label}: largest force", float(np.abs(driven.force_n).max()), "N"),
        Row(f"{label}: largest force rate", float(rate), "N/s"),
    ]


def _series(name: str, driven: RideRun) -> dict[str, Array]:
    """A run at SHOWN_N, once a control period."""
    return {
        f"{name}_4_kn_heave_mps2": driven.accelerations[0, ::FINE_PER_PERIOD, 0],
        f"{name}_4_kn_travel_m": driven.suspension_m[0, ::FINE_PER_PERIOD],
        f"{name}_4_kn_force_n": driven.force_n[0],
    }


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the peak heave acceleration over the limit, and both controllers at 4 kN."""
    s = report.arrays()
    figure = new_figure(15, 3.5)
    axes = figure.subplots(1, 4)
    for name, style in (("regulator", "s--"), ("predictive", "o-")):
        axes[0].plot(0.001 * s["limit_n"], s[f"{name}_peak_heave_mps2"], style, label=name)
        axes[1].plot(s["time_s"], s[f"{name}_4_kn_heave_mps2"], style[1:], label=name)
        axes[2].plot(s["time_s"], 1000 * s[f"{name}_4_kn_travel_m"][:, 0], style[1:], label=name)
        axes[3].plot(s["time_s"], 0.001 * s[f"{name}_4_kn_force_n"][:, 0], style[1:], label=name)
    axes[0].set(xlabel="force limit kN", ylabel="peak heave m/s$^2$")
    for axis, label in zip(axes[1:], ("heave m/s$^2$", "FL travel mm", "FL force kN"), strict=True):
        axis.set(xlabel="time s", ylabel=f"{label}, limit 4 kN", xlim=(0, 3))
    axes[0].legend()
    return [save(figure, directory / "force_limits.png")]
