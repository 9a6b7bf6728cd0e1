"""Speed of the whole robot in virtual time on one core: firmware, wires, Roboteqs, daemon and world.

    python bench/virtual_time.py [--json FILE] [SCENARIO ...]

Each scenario is armed and run to its end. Beside it, slice by slice in the same seconds, runs the floor: the
14-DOF vehicle alone under the same RK4 of 1 ms, called once per simulated second, no sensor, board or daemon.
Both are given in simulated seconds per second of processor time; the floor also tells how fast the machine
was just then. Then where the robot's time goes, by clocks around its parts, which cost some per cent.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tiger.config.robot import load_robot
from tiger.config.vehicle import load_vehicle
from tiger.daemon import daemon
from tiger.emulation import robot, world
from tiger.emulation.scenarios import load_scenario, scenario_names
from tiger.models.terrain import Terrain
from tiger.models.vehicle import Inputs, Vehicle
from tiger.rig.virtual import Rig

SLICE_S = 1.0
PARTS = {
    "robot: all": (robot.EmulatedRobot, "run"),
    "robot: two Roboteqs": (robot.EmulatedRobot, "_run_drives"),
    "robot: IMU's noise": (world.World, "imu"),
    "daemon: all": (daemon.Daemon, "tick"),
    "daemon: receive": (daemon.Daemon, "_receive"),
    "daemon: estimate and control": (daemon.Daemon, "_compute"),
    "daemon: send": (daemon.Daemon, "_send"),
}


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=scenario_names(), metavar="SCENARIO")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args()

    figures: dict[str, Any] = {}
    print(f"{'scenario':20s} {'start, s':>9s} {'robot':>8s} {'floor':>8s} {'floor/robot':>12s}")
    for name in chosen.scenarios:
        start_s, whole, floor = speeds(name)
        figures[name] = {"start_s": start_s, "robot": whole, "floor": floor}
        print(f"{name:20s} {start_s:9.2f} {whole:8.1f} {floor:8.0f} {floor / whole:12.1f}")
    name = chosen.scenarios[-1]
    figures["us_per_tick"] = shares = parts(name)
    print(f"\nmicroseconds per tick of 5 ms in {name}")
    for part, spent_us in shares.items():
        print(f"  {part:30s} {spent_us:7.0f}")
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def speeds(name: str) -> tuple[float, float, float]:
    """Processor time of the start, and simulated seconds per second of the robot and of the floor."""
    began_s = time.process_time()
    scenario = load_scenario(name)
    rig = Rig(load_robot(None), scenario)
    start_s = time.process_time() - began_s
    vehicle, inputs = Vehicle(load_vehicle("tiger"), Terrain.random("D", 1)), Inputs()
    state = vehicle.rolling(0.5)
    steps = round(SLICE_S * 1e3)
    vehicle.step(state.copy(), inputs, 1e-3, steps)  # compiled by now
    rig.daemon.arm(scenario.duration_s)
    slices, whole_s, floor_s = round(scenario.duration_s / SLICE_S), 0.0, 0.0
    for _ in range(slices):
        whole_s += spent_s(lambda: list(rig.run(SLICE_S)))
        floor_s += spent_s(lambda: vehicle.step(state, inputs, 1e-3, steps))
    return start_s, slices * SLICE_S / whole_s, slices * SLICE_S / floor_s


def spent_s(action: Callable[[], object]) -> float:
    """Processor time of an action in s, children included."""
    before = os.times()
    began_s = time.process_time()
    action()
    own_s = time.process_time() - began_s
    after = os.times()
    return own_s + after.children_user - before.children_user + after.children_system - before.children_system


def parts(name: str, settled_s: float = 12.0, for_s: float = 8.0) -> dict[str, float]:
    """Microseconds of processor time per tick that each part takes, from its beginning to its end."""
    rig = Rig(load_robot(None), load_scenario(name))
    rig.daemon.arm(settled_s)
    list(rig.run(settled_s))
    spent = dict.fromkeys(PARTS, 0.0)

    def timed(part: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            began_s = time.thread_time()
            try:
                return method(*arguments, **options)
            finally:
                spent[part] += time.thread_time() - began_s

        return call

    kept = {part: getattr(owner, method) for part, (owner, method) in PARTS.items()}
    try:
        for part, (owner, method) in PARTS.items():
            setattr(owner, method, timed(part, kept[part]))
        ticks = sum(1 for _ in rig.run(for_s))
    finally:
        for part, (owner, method) in PARTS.items():
            setattr(owner, method, kept[part])
    return {part: 1e6 * spent_s / ticks for part, spent_s in spent.items()}


if __name__ == "__main__":
    main()
