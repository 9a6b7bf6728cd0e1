"""Find the weights of the chapter 6 ride controllers: CMA-ES over logarithms, one goal per design.

    python scripts/tune_ride.py NAME [--minutes 3] [--start '{"parameters": [...]}']

Prints the best parameters after every improvement; the winners are copied into
`tiger/control/ride_designs.py`. Training seeds are 1000 and up, so that the studies (seeds 0 and up) judge on
roads and noise never trained on.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control import ride
from tiger.control.margins import closed_loop
from tiger.control.ride import ImuNoise, RideWeights, RoadPrior
from tiger.control.ride_bank import oblique
from tiger.control.ride_designs import RideTuning
from tiger.studies import ride_cases
from tiger.studies.performance import PEAK_SUSPENSION, RMS_BODY, RMS_TIRE_LOAD, simulate

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.control.ride import RideController
    from tiger.control.ride_bank import RideBank

    Array = NDArray[np.float64]

CASE = ride_cases.load_case("table-6-1")
CAR = CASE.car
PRINTED_ACTIVE_BUMPY = np.array(ride_cases.PRINTED["bumpy active"])
START = np.log([1.33, 5.02, 0.77, 0.89, 0.04, 7.95, 2.95, 2.21, 8.73, 3.2e-10, 0.1, 0.0046, 2.54, 0.5])
START_ISO = np.log([1.0, 1.0, 1.0, 1.0, 1.0, 100.0, 100.0, 2000.0, 2000.0, 1e-9, 0.0225, 0.02, 100.0, 0.05])
EXTRA = {"robust": [10.0, 3.0], "bumpy-plain-x1": [1.0, 1.0], "bumpy-oblique-x1": [1.0, 1.0, 0.3]}
"""Where the optional parameters of `tuning_of` start."""
SEED = 1000
MU_GOAL = 0.9
"""Of the rattle space that may be used."""


def tuning_of(parameters: Array) -> RideTuning:
    """Turn log-parameters into a tuning.

    Ten weights, noise, leak and bandwidth of the road, then the inverse hyperbolic tangent of a correlation.
    Optional: two factors on what the filter assumes of the IMU, to keep the loop's gain down; damping of the
    road, and then the correlation is that of the axles.
    """
    w = [float(x) for x in np.exp(parameters)]
    correlation = float(np.tanh(w[13]))
    prior = RoadPrior(w[10], w[11], w[12], lane_correlation=correlation)
    if len(w) > 16:
        prior = RoadPrior(w[10], w[11], w[12], axle_correlation=correlation, damping=w[16])
    return RideTuning(RideWeights(*w[:10]), prior, *w[14:16])


@dataclass
class Bumpy:
    """Worst row against the printed active column, over a few noise seeds."""

    factor: float
    preview_s: float | None
    seeds: int = 12
    judge_mean: bool = False
    oblique: bool = False
    power: float = 60.0

    def __post_init__(self) -> None:
        self.noise = ImuNoise().scaled(self.factor)
        self.road = ride_cases.bumpy_road()

    def __call__(self, x: Array) -> float:
        tuning = tuning_of(x)
        controller: RideController | RideBank = (
            oblique(tuning, CAR, self.noise, ride_cases.BUMPY_LANE_LAG_S)
            if self.oblique
            else tuning.controller(CAR, self.noise, self.preview_s)
        )
        run = simulate(CAR, self.road, controller, self.noise, tuple(range(SEED, SEED + self.seeds)))
        ratio = CASE.index(run) / PRINTED_ACTIVE_BUMPY
        if self.judge_mean:
            ratio = ratio.mean(axis=0, keepdims=True)
        return float(np.log(np.sum(ratio**self.power) / len(ratio)) / self.power)


@dataclass
class Iso:
    """Rows of active / passive against their goals, mean over several roads."""

    goals: Array
    preview_s: float | None
    roads: int = 6
    delay: int = 0
    power: float = 30.0

    def __post_init__(self) -> None:
        self.noise = ImuNoise()
        self.run_seeds = tuple(range(SEED, SEED + self.roads))
        self.road = ride_cases.iso_roads(CAR, self.run_seeds)
        self.passive = CASE.index(simulate(CAR, self.road, seeds=self.run_seeds))

    def __call__(self, x: Array) -> float:
        controller = tuning_of(x).controller(CAR, self.noise, self.preview_s, delay_samples=self.delay)
        run = simulate(
            CAR, self.road, controller, self.noise, self.run_seeds, delay_s=self.delay * ride.PERIOD_S
        )
        index = CASE.index(run)
        left = (index / self.passive).mean(axis=0)
        ratio = np.r_[left[RMS_BODY], left[RMS_TIRE_LOAD]] / self.goals
        mu = index[:, PEAK_SUSPENSION].max() / MU_GOAL
        rows = np.append(ratio, mu)
        return float(np.log(np.sum(rows**self.power)) / self.power)


@dataclass
class Robust(Iso):
    """The goals of the ISO road, for a design that keeps a dozen wrong vehicles and delays stable with room
    to spare."""

    radius: float = 0.9995

    def __call__(self, x: Array) -> float:
        controller = tuning_of(x).controller(CAR, self.noise, self.preview_s, delay_samples=self.delay)
        rng = np.random.default_rng(SEED)
        worst = 0.0
        for signs in np.sign(rng.standard_normal((12, 6))):
            wrong, imu = ride_cases.perturbed(CAR, *(signs[:5] * [0.2, 0.2, 0.3, 0.2, 0.2]))
            loop = closed_loop(wrong, controller, 0.005 + 0.002 * signs[5], imu)
            worst = max(worst, float(np.abs(loop.poles()).max()))
        if worst > 1.05:
            return 10 * worst
        return super().__call__(x) + 200 * max(0.0, worst - self.radius)


GOALS: dict[str, Callable[[], Bumpy | Iso]] = {
    "bumpy-preview-x0.03": lambda: Bumpy(0.03, ride_cases.BUMPY_PREVIEW_S, seeds=60),
    "bumpy-preview-x0.1": lambda: Bumpy(0.1, ride_cases.BUMPY_PREVIEW_S, seeds=40, judge_mean=True),
    "bumpy-plain-x1": lambda: Bumpy(1.0, None, seeds=6, judge_mean=True),
    "bumpy-oblique-x1": lambda: Bumpy(1.0, None, seeds=12, judge_mean=True, oblique=True),
    "iso-preview": lambda: Iso(np.array([0.375, 0.33, 0.365, 0.97, 0.97, 1.31, 1.31]), CASE.iso_preview_s),
    "iso-plain": lambda: Iso(np.array([0.375, 0.33, 0.365, 0.97, 0.97, 1.31, 1.31]), None),
    "holding-plain": lambda: Iso(np.array([0.51, 0.45, 0.56, 0.99, 0.99, 0.99, 0.99]), None),
    "holding-preview": lambda: Iso(np.array([0.45, 0.38, 0.48, 1.0, 1.0, 0.75, 0.75]), CASE.iso_preview_s),
    "robust": lambda: Robust(np.array([0.55, 0.5, 0.6, 1.0, 1.0, 1.0, 1.0]), None, delay=1, roads=3),
}


def minimise(goal: Callable[[Array], float], start: Array, step: float, minutes: float, name: str) -> Array:
    """Run CMA-ES (Hansen 2016, default constants) until the time is up; a design that fails costs
    infinity."""
    rng = np.random.default_rng(SEED)
    n = len(start)
    size = 4 + int(3 * np.log(n))
    parents = size // 2
    weight = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weight /= weight.sum()
    effective = 1 / np.sum(weight**2)
    c_sigma = (effective + 2) / (n + effective + 5)
    damping = 1 + 2 * max(0.0, np.sqrt((effective - 1) / (n + 1)) - 1) + c_sigma
    c_path = (4 + effective / n) / (n + 4 + 2 * effective / n)
    c_one = 2 / ((n + 1.3) ** 2 + effective)
    c_mu = min(1 - c_one, 2 * (effective - 2 + 1 / effective) / ((n + 2) ** 2 + effective))
    expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    mean, covariance, path_sigma, path = start.copy(), np.eye(n), np.zeros(n), np.zeros(n)
    best, best_cost, generation = start, np.inf, 0
    deadline = time.monotonic() + 60 * minutes
    while time.monotonic() < deadline:
        generation += 1
        values, vectors = np.linalg.eigh(covariance)
        scale = np.sqrt(np.maximum(values, 1e-20))
        steps = rng.standard_normal((size, n)) * scale @ vectors.T
        costs = np.array([_try(goal, mean + step * s) for s in steps])
        order = np.argsort(costs)
        if costs[order[0]] < best_cost:
            best, best_cost = mean + step * steps[order[0]], costs[order[0]]
            found = {"name": name, "cost": best_cost, "gen": generation, "step": step}
            print(json.dumps(found | {"parameters": best.tolist()}), flush=True)
        move = weight @ steps[order[:parents]]
        mean = mean + step * move
        whitened = vectors @ ((vectors.T @ move) / scale)
        path_sigma = (1 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * effective) * whitened
        length = np.linalg.norm(path_sigma)
        on = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (n + 1)) * expected
        path = (1 - c_path) * path + on * np.sqrt(c_path * (2 - c_path) * effective) * move
        chosen = steps[order[:parents]]
        covariance = (
            (1 - c_one - c_mu) * covariance
            + c_one * np.outer(path, path)
            + c_mu * (chosen.T * weight) @ chosen
        )
        step *= np.exp(c_sigma / damping * (length / expected - 1))
    return best


def _try(goal: Callable[[Array], float], x: Array) -> float:
    try:
        with np.errstate(all="ignore"):
            cost = goal(x)
    except (ValueError, np.linalg.LinAlgError):
        return np.inf
    return cost if np.isfinite(cost) else np.inf


def main() -> None:
    """Tune the named design and print its parameters."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=GOALS)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--start", help="JSON with the parameters to start from")
    parser.add_argument("--step", type=float, default=0.2)
    parser.add_argument(
        "--power", type=float, help="norm over the rows: low to find the way, high to level them"
    )
    arguments = parser.parse_args()
    default = START if arguments.name.startswith("bumpy") else START_ISO
    start = default if arguments.start is None else np.array(json.loads(arguments.start)["parameters"])
    goal = GOALS[arguments.name]()
    if arguments.power is not None:
        goal.power = arguments.power
    start = np.append(start, np.log(EXTRA.get(arguments.name, ()))[len(start) - 14 :])
    minimise(goal, start, arguments.step, arguments.minutes, arguments.name)


if __name__ == "__main__":
    main()
