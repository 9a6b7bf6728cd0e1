"""Speed of the vehicle models on one core, beside named peers measured in the same run.

    python bench/vehicle_speed.py [--json FILE]

1. The 14-DOF vehicle, RK4 steps per second of processor time, against the multi-body model of the PyPI
   package commonroad-vehicle-models under the same RK4 (put into a temporary environment; left out if that
   fails).
2. The 7-DOF batch over 1 000 roads against a Python loop over scipy.signal.lsim.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lsim

from tiger.config.vehicle import load_vehicle
from tiger.models.batch import simulate_batch
from tiger.models.full_car import ROAD, FullCarParameters, full_car
from tiger.models.linear import LinearModel
from tiger.models.terrain import Terrain
from tiger.models.vehicle import Inputs, Vehicle

PEER = "commonroad-vehicle-models==3.0.2"
REPEATS = 5

# Runs in the peer's own environment; prints steps per second. The same RK4 as ours, on plain arrays.
PEER_PROGRAM = """
import time
import numpy as np
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

p = parameters_vehicle2()
u, dt, steps = [0.0, 0.0], 1e-3, 400

def rhs(x):
    return np.array(vehicle_dynamics_mb(x, u, p))

best = 0.0
for _ in range(REPEATS):
    x = np.array(init_mb([0.0, 0.0, 0.01, 15.0, 0.0, 0.0, 0.0], p))
    start = time.process_time()
    for _ in range(steps):
        k1 = rhs(x)
        k2 = rhs(x + 0.5 * dt * k1)
        k3 = rhs(x + 0.5 * dt * k2)
        k4 = rhs(x + dt * k3)
        x = x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    best = max(best, steps / (time.process_time() - start))
    assert np.isfinite(x).all()
print(best)
"""


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    target = parser.parse_args().json

    figures: dict[str, float | None] = {
        "vehicle_flat_steps_per_s": vehicle_steps_per_s("table-5-1", Terrain()),
        "vehicle_rough_terrain_steps_per_s": vehicle_steps_per_s("tiger", Terrain.random("D", 1)),
        "vehicle_one_step_per_call_per_s": single_steps_per_s(),
        "sense_per_s": senses_per_s(),
        "peer_multi_body_steps_per_s": peer_steps_per_s(),
    }
    peer = figures["peer_multi_body_steps_per_s"]
    figures["vehicle_over_peer"] = figures["vehicle_flat_steps_per_s"] / peer if peer else None
    batch, loop = batch_s_per_road(), lsim_s_per_road()
    figures |= {"batch_road_us": batch * 1e6, "lsim_road_us": loop * 1e6, "batch_over_lsim": loop / batch}
    for name, value in figures.items():
        print(f"{name:36s} {'not measured' if value is None else f'{value:14,.1f}'}")
    if target:
        target.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def fastest(action: Callable[[], object]) -> float:
    """Least processor time of a few repeats in s; the first call, which may compile, does not count."""
    action()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return min(times)


def vehicle_steps_per_s(name: str, terrain: Terrain) -> float:
    """RK4 steps of 1 ms per second, many per call, from 15 m/s (tyres slipping, wheels rolling)."""
    vehicle, inputs, steps = Vehicle(load_vehicle(name), terrain), Inputs(), 20_000
    inputs.wheel_torque_nm[:] = [2.0, 3.0, 2.0, 3.0]
    return steps / fastest(lambda: vehicle.step(vehicle.rolling(15.0), inputs, 1e-3, steps))


def single_steps_per_s() -> float:
    """Calls of `Vehicle.step` with one step each: the emulated robot's way."""
    vehicle, inputs, calls = Vehicle(load_vehicle("tiger"), Terrain.random("D", 1)), Inputs(), 5_000

    def run() -> None:
        state = vehicle.rolling(3.0)
        for _ in range(calls):
            vehicle.step(state, inputs)

    return calls / fastest(run)


def senses_per_s() -> float:
    """Calls of `Vehicle.sense`."""
    vehicle, inputs, calls = Vehicle(load_vehicle("tiger")), Inputs(), 2_000
    state = vehicle.rolling(3.0)

    def run() -> None:
        for _ in range(calls):
            vehicle.sense(state, inputs)

    return calls / fastest(run)


def peer_steps_per_s() -> float | None:
    """RK4 steps per second of the peer's multi-body model, or None where it cannot be installed."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True, system_site_packages=False)
        python = Path(folder) / "bin" / "python"
        packages = [PEER, f"numpy=={np.__version__}"]
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
        installed = subprocess.run(install, capture_output=True, text=True, check=False)
        if installed.returncode != 0:
            print(
                f"{PEER} cannot be installed here: {installed.stderr.strip().splitlines()[-1:]}",
                file=sys.stderr,
            )
            return None
        program = PEER_PROGRAM.replace("REPEATS", str(REPEATS))
        return float(
            subprocess.run([python, "-c", program], capture_output=True, text=True, check=True).stdout
        )


def batch_s_per_road(roads: int = 1000, steps: int = 2000) -> float:
    """Seconds per road of the compiled batch, body motion out, four wheel heights in, 2 s at 1 kHz."""
    model = road_model().discretise(1e-3, "foh")
    heights = road_heights(roads, steps)
    return fastest(lambda: simulate_batch(model, heights)) / roads


def lsim_s_per_road(roads: int = 5, steps: int = 2000) -> float:
    """Seconds per road of scipy.signal.lsim called road by road (every road costs the same)."""
    model, heights = road_model(), road_heights(roads, steps)
    time_s = np.arange(steps) * 1e-3
    system = (model.a, model.b, model.c, model.d)
    return fastest(lambda: [lsim(system, u, time_s) for u in heights]) / roads


def road_model() -> LinearModel:
    """The 7-DOF car of Table 6.1 from road heights to heave, pitch and roll."""
    car = full_car(FullCarParameters.from_config(load_vehicle("table-6-1")))
    return car.select(inputs=ROAD, outputs=("heave_m", "pitch_rad", "roll_rad"))


def road_heights(roads: int, steps: int) -> np.ndarray:
    """Random walks (roads, steps, 4): the filter does not care what the road looks like."""
    return np.random.default_rng(0).normal(0.0, 1e-3, (roads, steps, 4)).cumsum(axis=1)


if __name__ == "__main__":
    main()
