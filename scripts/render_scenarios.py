"""Draws the pictures of docs/scenarios.md from the emulated robot, and prints what the page says of them.

python scripts/render_scenarios.py [SCENARIO ...]
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tiger.config.robot import load_robot
from tiger.emulation.scenarios import load_scenario
from tiger.rig.virtual import Rig
from tiger.studies.figures import gridded, legend_above, new_figure, save
from tiger.studies.report import CORNERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tiger.emulation.world import Truth

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "img"
LOOK_EVERY = 10  # ticks of 5 ms

RIGHT = {  # what the second panel shows of each scenario: field of the truth, label of the axis
    "side-slope": ("speed_mps", "speed (m/s)"),
    "twist": ("wheel_load_n", "wheel load (N)"),
    "curb": ("rise_cm", "rise of the COM (cm)"),
    "uneven-terrain": ("wheel_load_n", "wheel load (N)"),
    "loose-slope": ("slip_ratio", "slip ratio (-)"),
    "iso-road": ("wheel_load_n", "wheel load (N)"),
}


def ride(name: str) -> tuple[list[Truth], list[float]]:
    """The truth every 50 ms of a run with seed 0, and the largest motor current at each of these moments."""
    scenario = load_scenario(name)
    rig = Rig(load_robot(None), scenario)
    rig.daemon.arm(scenario.duration_s)
    truths, currents_a = [], []
    for tick, record in enumerate(rig.run(scenario.duration_s)):
        if tick % LOOK_EVERY == 0:
            truths.append(rig.robot.truth())
            drives = (record.inputs.drive_left, record.inputs.drive_right)
            pairs = [drive.motor_current_a for drive in drives if drive is not None]
            currents_a.append(max((abs(a) for pair in pairs for a in pair), default=0.0))
    return truths, currents_a


def draw(name: str, truths: Sequence[Truth], moments_s: Sequence[float]) -> Path:
    """Roll and pitch on the left, what matters of the scenario on the right; moments are dotted."""
    time_s = np.array([truth.time_s for truth in truths])
    what, label = RIGHT[name]
    with gridded():
        figure = new_figure(9.0, 2.6)
        left, right = figure.subplots(1, 2)
        for axis in ("roll", "pitch"):
            left.plot(time_s, [getattr(truth, f"{axis}_deg") for truth in truths], label=axis, lw=1.2)
        left.set_ylabel("attitude (degrees)")
        legend_above(left)
        if what == "rise_cm":
            start_m = truths[0].position_m[2]
            right.plot(time_s, [100.0 * (truth.position_m[2] - start_m) for truth in truths], lw=1.2)
        elif what == "speed_mps":
            right.plot(time_s, [truth.speed_mps for truth in truths], lw=1.2)
        else:
            for corner, values in zip(
                CORNERS, zip(*(getattr(t, what) for t in truths), strict=True), strict=True
            ):
                right.plot(time_s, values, label=corner, lw=0.9)
            legend_above(right)
        if what == "slip_ratio":
            right.set_ylim(-0.2, 0.8)
        right.set_ylabel(label)
        for panel in (left, right):
            panel.set_xlabel("time (s)")
            for moment_s in moments_s:
                panel.axvline(moment_s, color="0.3", lw=0.8, ls=":")
        return save(figure, IMAGES / f"scenario-{name}.png")


def main() -> None:
    """Run, draw, and print the figures while the planned drive lasts."""
    for name in sys.argv[1:] or RIGHT:
        truths, currents_a = ride(name)
        moments_s = [event.at_s for event in load_scenario(name).drive]
        path = draw(name, truths, moments_s)
        driven = [t for t in truths if moments_s[0] <= t.time_s <= moments_s[-1] + 1.0]
        print(path)
        for axis in ("roll", "pitch"):
            degrees = np.array([getattr(truth, f"{axis}_deg") for truth in driven])
            rms = np.sqrt(np.mean(degrees**2))
            print(f"  {axis}: RMS {rms:.2f}, {degrees.min():.2f} to {degrees.max():.2f} degrees")
        loads = np.array([truth.wheel_load_n for truth in driven])
        slips = np.array([truth.slip_ratio for truth in driven])
        print(f"  wheel loads {loads.min():.0f} to {loads.max():.0f} N, slip at most {slips.max():.2f}")
        print(f"  motor current at most {max(currents_a):.1f} A")


if __name__ == "__main__":
    main()
