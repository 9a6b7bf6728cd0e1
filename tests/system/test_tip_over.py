"""Does the whole robot warn before it tips over, keep itself from it, and notice what it runs into?"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.config.vehicle import load_vehicle
from tiger.emulation.scenarios import DriveEvent, RoadConfig, Scenario, Start, TerrainConfig
from tiger.models import vehicle_kernel as kernel
from tiger.models.terrain import FLAT
from tiger.models.vehicle import Inputs, Vehicle
from tiger.record import DaemonState
from tiger.rig.virtual import Rig
from tiger.studies import tip_over
from tiger.studies.tip_over_runs import transfers

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.robot import RobotConfig
    from tiger.studies.tip_over import Tally

    Figure = Callable[[str, object, str], None]


@pytest.mark.parametrize("friction", [1.0, 1.2])
def test_tiger_itself_slides_before_it_tips_on_flat_ground(friction: float, record_figure: Figure) -> None:
    """Thrown sideways at 5 m/s, all grip used at once: it rocks, slides and stops, far from its edges."""
    vehicle = load_vehicle("tiger")
    grippy = vehicle.model_copy(update={"tire": vehicle.tire.model_copy(update={"friction": friction})})
    plant = Vehicle(grippy, FLAT)
    inputs = Inputs()
    inputs.wheel_speed_radps[:] = 0.0
    state = plant.settle(plant.at_rest(), inputs=inputs)
    state[kernel.VELOCITY.start + 1] = 5.0
    sliding, most_rad = [], 0.0
    for step in range(1500):
        plant.step(state, inputs, 1e-3)
        fl, fr, rl, rr = plant.sense(state, inputs).wheel_load_n
        if 250 < step < 450:  # the first blow is over, it still slides
            sliding.append(abs(fl - fr + rl - rr) / (fl + fr + rl + rr))
        w, x, y, z = state[kernel.ATTITUDE]
        most_rad = max(most_rad, abs(math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))))
    transfer = float(np.mean(sliding))
    record_figure(f"TIGER sliding sideways at grip {friction}: load transfer", f"{transfer:.2f}", "< 1")
    record_figure(f"TIGER sliding sideways at grip {friction}: most roll, deg", math.degrees(most_rad), "68")
    assert abs(state[kernel.VELOCITY.start + 1]) < 0.5  # the ground has stopped it
    assert 0.3 < transfer < 0.7
    assert most_rad < math.radians(10.0)


def judge(found: Tally, record_figure: Figure, everything: bool) -> None:
    name = f"{found.runs} runs"
    record_figure(f"{name}: unfit / tipped when nothing limits", f"{found.unfit} / {found.tipped}", "")
    share = 100.0 / max(found.tipped, 1)
    record_figure(f"{name}: warned >= 0.5 s before the balance point, %", found.warned * share, ">= 99")
    record_figure(f"{name}: prevented by the limiter, %", found.prevented * share, ">= 98")
    record_figure(
        f"{name}: impacts flagged within 100 ms, %", 100.0 * found.flagged / max(found.impacts, 1), "100"
    )
    record_figure(f"{name}: to be looked at", "; ".join(found.late) or "none", "")
    assert found.tipped > 0.25 * (found.runs - found.impacts - found.unfit), "too harmless to prove anything"
    assert found.impacts > 0
    assert found.unfit <= 0.1 * found.runs
    limits = (0.99, 0.98) if everything else (1.0, 1.0)
    assert found.warned >= limits[0] * found.tipped, found.late
    assert found.prevented >= limits[1] * found.tipped, found.late
    assert found.flagged == found.impacts, found.late


@pytest.mark.timeout(600)
def test_twenty_runs_are_warned_of_and_prevented(record_figure: Figure) -> None:
    judge(tip_over.tally(tip_over.gather(tip_over.drawn(20), jobs=1)), record_figure, everything=False)


@pytest.mark.proof
@pytest.mark.timeout(7200)
def test_a_thousand_runs_are_warned_of_and_prevented(record_figure: Figure) -> None:
    """What an interrupted proof has run is kept in build/, and counts while the program is the same."""
    keep = Path(__file__).parents[2] / "build" / "proof" / "tip-over.jsonl"
    pairs = tip_over.gather(tip_over.drawn(1000), keep=keep)
    errors = np.array([p.logged.transfer_error for p in pairs if p.kind in ("slope", "hill", "brake")])
    record_figure("load transfer error on slopes, RMS, median of runs", np.median(errors, axis=0), "0.05")
    judge(tip_over.tally(pairs), record_figure, everything=True)


def steady(robot: RobotConfig, terrain: TerrainConfig, speed_mps: float, duration_s: float) -> Rig:
    """A robot that has driven straight on for a while, on an armed daemon."""
    drive = (DriveEvent(at_s=4.0, speed_mps=speed_mps),)
    scenario = Scenario(
        title="straight on", duration_s=duration_s, terrain=terrain, start=Start(x_m=1.0), drive=drive
    )
    rig = Rig(robot, scenario, seed=5)
    rig.daemon.arm(8.0)
    return rig


def test_load_transfer_is_known_within_five_percent(record_figure: Figure) -> None:
    """At rest, driving and in a turn, across a slope of 8 degrees."""
    drive = (
        DriveEvent(at_s=4.0, speed_mps=1.0),
        DriveEvent(at_s=9.0, speed_mps=1.0, yaw_rate_degps=20.0),
    )
    terrain = TerrainConfig(left_up_deg=8.0)
    scenario = Scenario(title="across a slope", duration_s=13.0, terrain=terrain, drive=drive)
    patient = load_robot(None).with_motor_current(100.0)  # it turns uphill
    rig = Rig(patient, scenario, seed=2)
    rig.daemon.arm(8.0)
    errors = []
    for record in rig.run(13.0):
        if record.state is DaemonState.ARMED and rig.time_s > 5.0:
            lateral, longitudinal, _ = transfers(rig.robot.truth())
            shown = record.outputs.estimate.stability
            errors.append(
                (shown.lateral_load_transfer - lateral, shown.longitudinal_load_transfer - longitudinal)
            )
    assert rig.daemon.state is DaemonState.ARMED, rig.daemon.reason
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    record_figure("load transfer error across 8 degrees, RMS lateral, longitudinal", rms, "0.05")
    assert max(rms) <= 0.05


def alarms(robot: RobotConfig, speed_mps: float, duration_s: float, seed: int) -> dict[str, int]:
    """How often the robot was limited, warned and tripped on a road of class D."""
    road = RoadConfig(roughness="D", length_m=speed_mps * duration_s + 20.0, seed=seed)
    rig = steady(robot, TerrainConfig(road=road), speed_mps, duration_s)
    count = {"limited": 0, "warned": 0, "tripped": 0}
    before = (False, False, False)
    for record in rig.run(duration_s):
        if rig.time_s < 6.0:
            continue
        shown = record.outputs.estimate.stability
        now = (bool(shown.limited), shown.warning, shown.tripped)
        for name, was, is_so in zip(count, before, now, strict=True):
            count[name] += is_so and not was
        before = now
    assert rig.daemon.state is DaemonState.ARMED, [rig.daemon.reason, *map(str, rig.daemon.latched)]
    return count


def tall(robot: RobotConfig) -> RobotConfig:
    """TIGER with its COM at 0.6 m: one that can tip."""
    body = robot.vehicle.body.model_copy(update={"com_height_m": 0.6})
    return robot.model_copy(update={"vehicle": robot.vehicle.model_copy(update={"body": body})})


@pytest.mark.parametrize("height", ["low", "tall"])
def test_rough_ground_of_class_d_raises_no_alarm(height: str) -> None:
    robot = load_robot(None)
    found = alarms(tall(robot) if height == "tall" else robot, 2.0, 40.0, seed=1)
    assert found == {"limited": 0, "warned": 0, "tripped": 0}


@pytest.mark.proof
@pytest.mark.timeout(3600)
def test_an_hour_on_class_d_has_at_most_one_false_stop(record_figure: Figure) -> None:
    """Twelve roads, for each repeats itself after 100 m: five minutes each, on every other one as built."""
    low = load_robot(None)
    high, total = tall(low), Counter[str]()
    for road in range(12):
        total.update(alarms(high if road % 2 else low, 2.0, 300.0, seed=70 + road))
    record_figure("an hour on class D at 2 m/s: false stops, warnings, trips", dict(total), "<= 1 stop")
    assert total["limited"] + total["tripped"] <= 1
