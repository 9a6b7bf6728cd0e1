"""The whole robot finds its way: firmware, daemon, 14-DOF vehicle, scored against the world's truth."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, hypot, inf, radians, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tiger.config.robot import RobotConfig, load_robot
from tiger.emulation.scenarios import Scenario
from tiger.record import Command, DaemonState, Mode
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Recorder = Callable[[str, object, str], None]

LOOP = [
    *((20.0, 0.0, 1.0), (40.0, 3.0, 1.5), (52.0, -4.0, 2.0), (54.0, -12.0, 0.7), (44.0, -16.0, 0.5)),
    *((28.0, -10.0, 1.2), (14.0, 6.0, 1.8), (2.0, 14.0, 1.0), (-8.0, 8.0, 0.7), (-6.0, -2.0, 1.5)),
]
"""Waypoints and speeds of a mixed course: straights, bends to both sides, over two hills and a side slope."""
PATCHES_M = (4.0, 10.0, 15.0, 33.0, 38.0, 46.0)
ONSET_RATIO = 0.10
RATIO_ERROR = 0.03
"""What a slip ratio may be off by: one that touches the onset and goes back is not told from one below it."""
CLEARLY_NOT = 0.04
ROLLING_MPS = 0.45
"""Slower it is stopping: 10 % of slip are then less than the 4 cm/s that wheel sensors resolve in time."""


def robot() -> RobotConfig:
    """The default, but for the current limit: 17 Nm, which bends at low speed take, are 59 A."""
    return load_robot(None).with_motor_current(70.0)


def course(seed: int, *, slippery: bool, waypoints: list[tuple[float, float, float]] = LOOP) -> Scenario:
    terrain: dict[str, Any] = {
        "rough": {"roughness": "D", "size_m": (70.0, 44.0), "shortest_wave_m": 1.0, "seed": seed + 1},
        "climb_deg": 1.0,
        "left_up_deg": 1.5,
        "bump": [
            {"height_m": 0.5, "start_m": 8.0, "length_m": 20.0},
            {"height_m": 0.7, "start_m": 30.0, "length_m": 24.0},
        ],
    }
    if slippery:
        terrain["slippery"] = [
            {"friction_factor": 0.22, "start_m": place, "length_m": 2.5} for place in PATCHES_M
        ]
    return Scenario.model_validate(
        {
            "title": "a mixed course",
            "duration_s": 2000.0,
            "terrain": terrain,
            "friction": 0.6,
            "waypoint": [{"x_m": x, "y_m": y, "speed_mps": speed} for x, y, speed in waypoints],
            "route": {"at_s": 8.0, "laps": 10, "lookahead_m": 2.5, "max_yaw_rate_degps": 25.0},
        }
    )


@dataclass
class Score:
    """What a drive was like; arrays have one row a tick."""

    distance_m: float
    drift_percent: float  # at the end
    heading_deg: float  # worst
    inside: Array  # share of ticks within 3 sigma: x, y, yaw, speed
    slip_error: Array  # of wheels that roll
    slip: Array
    onset_s: list[float]  # from true slip beyond the threshold to the flag, inf if it never came
    false_flags: float  # share of ticks and wheels flagged though they clearly did not slip


def drive(scenario: Scenario, seed: int, distance_m: float) -> Score:
    """Follow the course for a distance with the strokes held and compare belief with truth at every tick."""
    rig = Rig(robot(), scenario, seed)
    rig.daemon.command = Command(mode=Mode.HOLD)
    rig.daemon.arm(20.0)
    start = rig.robot.truth()
    x0, y0, _ = start.position_m
    yaw0 = radians(start.yaw_deg)
    place, gone, yaw, last_yaw = (x0, y0), 0.0, 0.0, start.yaw_deg
    rows, slips, told, flags = [], [], [], []
    for record in rig.run(scenario.duration_s):
        truth, believed = rig.robot.truth(), record.outputs.estimate.odometry
        x, y, _ = truth.position_m
        gone += hypot(x - place[0], y - place[1])
        place = x, y
        yaw += radians((truth.yaw_deg - last_yaw + 180.0) % 360.0 - 180.0)
        last_yaw = truth.yaw_deg
        ahead = cos(yaw0) * (x - x0) + sin(yaw0) * (y - y0)
        left = cos(yaw0) * (y - y0) - sin(yaw0) * (x - x0)
        c = believed.covariance
        rows.append(
            (
                truth.speed_mps,
                *(believed.x_m - ahead, believed.y_m - left, believed.yaw_rad - yaw),
                believed.speed_mps - truth.speed_mps,
                *(sqrt(c[0]), sqrt(c[3]), sqrt(c[5]), believed.speed_sigma_mps),
            )
        )
        slips.append(truth.slip_ratio)
        told.append(believed.slip_ratio)
        flags.append(believed.slipping)
        assert record.state is not DaemonState.FAULT, [str(p) for p in record.problems + rig.daemon.latched]
        if gone >= distance_m:
            break
    table, slip, flag = np.array(rows), np.array(slips), np.array(flags)
    rolls = table[:, 0] > ROLLING_MPS
    return Score(
        distance_m=gone,
        drift_percent=100.0 * hypot(table[-1, 1], table[-1, 2]) / gone,
        heading_deg=degrees(np.abs(table[rolls, 3]).max()),
        inside=(np.abs(table[rolls, 1:5]) <= 3.0 * table[rolls, 5:9]).mean(axis=0),
        slip_error=(np.array(told) - slip)[rolls],
        slip=slip[rolls],
        onset_s=_onsets(slip, flag, rolls),
        false_flags=float((flag[rolls] & (np.abs(slip[rolls]) < CLEARLY_NOT)).mean()),
    )


def _onsets(slip: Array, flag: Array, rolls: Array) -> list[float]:
    """Time from the onset of each slip to its flag; infinite where it is missed.

    A slip lasts 150 ms and goes beyond the onset by more than a slip ratio may be off.
    """
    ticks, times = 30, []
    size = np.abs(slip)
    beyond = size > ONSET_RATIO
    for wheel in range(4):
        starts = np.flatnonzero(beyond[1:, wheel] & ~beyond[:-1, wheel] & rolls[1:]) + 1
        for at in starts:
            lasts = int(np.argmin(np.append(beyond[at:, wheel], False)))
            most = size[at : at + lasts, wheel].max()
            if flag[at, wheel]:
                times.append(0.0)
            elif lasts >= ticks and most > ONSET_RATIO + RATIO_ERROR:
                seen = np.flatnonzero(flag[at : at + 2 * ticks, wheel])
                times.append(0.005 * float(seen[0]) if len(seen) else inf)
    return times


def test_only_slips_that_last_and_stand_out_are_scored() -> None:
    slip = np.zeros((200, 4))
    slip[50:75, 0] = 0.3  # short
    slip[50:150, 1] = 0.12  # hardly beyond the onset
    slip[50:150, 2] = 0.15
    slip[50:150, 3] = -0.15
    flag = np.zeros(slip.shape, dtype=bool)
    flag[66:, 2] = True
    assert _onsets(slip, flag, np.ones(200, dtype=bool)) == [pytest.approx(0.08), inf]


def test_a_short_course_with_slippery_patches_is_not_lost(record_figure: Recorder) -> None:
    scenario = course(1, slippery=True, waypoints=[(7.0, 0.0, 1.0), (20.0, 3.0, 1.5)])
    score = drive(scenario, 1, 20.0)
    record_figure("drift over 20 m with slippery patches", score.drift_percent, "2 %")
    assert score.drift_percent < 2.0
    assert score.heading_deg < 1.0
    assert (score.inside >= 0.99).all(), score.inside
    assert max(score.onset_s, default=0.0) <= 0.15
    assert np.abs(score.slip).max() > 0.1  # they do slip


@pytest.mark.proof
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", [201, 202, 203])
@pytest.mark.parametrize(("slippery", "most_percent"), [(False, 1.0), (True, 2.0)])
def test_500_m_of_mixed_course(
    slippery: bool, most_percent: float, seed: int, record_figure: Recorder
) -> None:
    score = drive(course(seed, slippery=slippery), seed, 500.0)
    ground = f"{'slippery' if slippery else 'firm'}, seed {seed}"
    small = np.abs(score.slip) < 0.3
    record_figure(f"drift over 500 m ({ground})", score.drift_percent, f"{most_percent:g} %")
    record_figure(f"worst heading error, degrees ({ground})", score.heading_deg, "1")
    record_figure(f"inside 3 sigma: x y yaw speed ({ground})", score.inside.round(4).tolist(), "0.99")
    flagged = float(np.mean(np.array(score.onset_s or [0.0]) <= 0.15))
    record_figure(f"slips flagged within 0.15 s, of {len(score.onset_s)} ({ground})", flagged, "0.99")
    record_figure(f"flags without slip ({ground})", score.false_flags, "0.02")
    error = float(np.sqrt(np.mean(score.slip_error[small] ** 2)))
    record_figure(f"slip ratio error, RMS for slip below 0.3 ({ground})", error, "0.03")
    assert score.drift_percent <= most_percent
    assert score.heading_deg <= 1.0
    assert (score.inside >= 0.99).all(), score.inside
    assert flagged >= 0.99
    assert score.false_flags <= 0.02
    assert error <= RATIO_ERROR
