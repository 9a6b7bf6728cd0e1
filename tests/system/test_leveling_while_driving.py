"""Levelling on the move: the whole robot speeds up over rough ground and knows which way is up."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.config.vehicle import PayloadConfig
from tiger.emulation.scenarios import RoughConfig, Roughness, Scenario, Start, TerrainConfig
from tiger.estimation.attitude_observer import attitude_rad
from tiger.record import Command, Mode
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

DRIVE_AT_S, END_S = 8.0, 18.0


def ride(
    speed_mps: float, mode: Mode, roughness: Roughness = "C", payload: PayloadConfig | None = None
) -> Array:
    """Start at once to a speed; one row a tick: time, true pitch, the Nano's, the estimate's, four duties."""
    rough = RoughConfig(roughness=roughness, size_m=(60.0, 20.0), shortest_wave_m=1.0, seed=5)
    scenario = Scenario(
        title="a start",
        duration_s=END_S,
        start=Start(x_m=5.0),
        terrain=TerrainConfig(rough=rough),
        payload=payload,
    )
    rig = Rig(load_robot(None), scenario, 0)
    rig.daemon.command = Command(mode)
    rig.daemon.arm(patience_s=DRIVE_AT_S)
    rows = []
    for record in rig.run(END_S):
        rig.daemon.command = Command(mode, speed_mps=speed_mps if rig.time_s > DRIVE_AT_S else 0.0)
        imu, strokes = record.inputs.imu, record.inputs.strokes
        if imu is None or strokes is None:
            continue
        nano, known = attitude_rad(imu.quaternion)[1], record.outputs.estimate.pitch_rad
        pitch = rig.robot.truth().pitch_deg
        rows.append((rig.time_s, pitch, math.degrees(nano), math.degrees(known), *strokes.duty_permille))
    return np.array(rows)


@pytest.fixture(scope="module")
def start() -> Array:
    return ride(10.0 / 3.6, Mode.LEVEL)


def test_a_start_to_10_kmh_bends_the_attitude_filter_and_not_the_estimate(
    start: Array, record_figure: Callable
) -> None:
    driving = start[start[:, 0] > DRIVE_AT_S]
    nano = float(np.abs(driving[:, 2] - driving[:, 1]).max())
    known = float(np.abs(driving[:, 3] - driving[:, 1]).max())
    record_figure("pitch of the Nano, worst, start to 10 km/h", nano, "-")
    record_figure("pitch as estimated, worst, start to 10 km/h", known, "0.6 degrees")
    assert nano > 2.0
    assert known < 0.6


def test_no_slope_is_made_of_the_start(start: Array) -> None:
    while_speeding_up = (start[:, 0] > DRIVE_AT_S) & (start[:, 0] < DRIVE_AT_S + 5.0)
    assert abs(start[while_speeding_up, 1].mean()) < 0.3


def test_at_a_walk_the_body_is_level_and_its_actuators_stay_cool(record_figure: Callable) -> None:
    rows = ride(0.3, Mode.LEVEL)
    walking = rows[rows[:, 0] > DRIVE_AT_S + 3.0]
    rms = float(walking[:, 1].std())
    heat = float(((walking[:, 4:] / 1000.0) ** 2).mean(axis=0).max())
    record_figure("pitch RMS at 0.3 m/s over class C", rms, "0.05 degrees")
    record_figure("mean square duty at 0.3 m/s over class C", heat, "0.1")
    assert rms < 0.05
    assert heat < 0.1


def test_a_high_load_swinging_on_its_springs_is_not_taken_for_ground(record_figure: Callable) -> None:
    """Else it comes back a wheelbase later, as ground ahead, and rocks the body for good."""
    load = PayloadConfig(mass_kg=20.0, place_m=(0.0, 0.0, 0.25))
    rows = ride(0.5, Mode.LEVEL, "A", load)
    rms = float(rows[rows[:, 0] > DRIVE_AT_S + 4.0, 1].std())
    record_figure("pitch RMS at 0.5 m/s over class A, 20 kg on top", rms, "0.05 degrees")
    assert rms < 0.05
