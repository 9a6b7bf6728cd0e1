"""Levelling on rough ground goes on for longer than its motors could at full rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tiger.config.robot import load_robot
from tiger.emulation.scenarios import Scenario
from tiger.record import DaemonState
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

    Figure = Callable[[str, object, str], None]


@pytest.mark.proof
def test_a_fast_ride_over_class_d_warms_the_actuators_and_goes_on(record_figure: Figure) -> None:
    """At full rate the board would stop this ride after three minutes."""
    robot = load_robot(None).with_motor_current(70.0)  # bends at low speed take 59 A
    scenario = Scenario.model_validate(
        {
            "title": "a fast ride on class D",
            "duration_s": 400.0,
            "friction": 0.6,
            "start": {"x_m": 60.0},
            "terrain": {
                "rough": {"roughness": "D", "size_m": [160.0, 160.0], "shortest_wave_m": 1.0, "seed": 3}
            },
            "drive": [{"at_s": 12.0, "speed_mps": 1.5, "yaw_rate_degps": 3.0}],
        }
    )
    rig = Rig(robot, scenario, 0)
    rig.daemon.arm(20.0)
    hottest = slowed_s = 0.0
    for record in rig.run(scenario.duration_s):
        hottest = max(hottest, *rig.daemon.control_state.heat)
        slowed_s += robot.loop.period_s * ("hot" in record.outputs.reason)
    record_figure("400 s of class D at 1.5 m/s: hottest motor, of the board's limit", f"{hottest:.2f}", "< 1")
    record_figure("of which with actuators taken back, s", round(slowed_s), "")
    assert record.state is DaemonState.ARMED, record.reason
    assert robot.leveling.heat_slow < hottest < robot.leveling.heat_stop
