"""Mode `balance` by the whole robot: firmware, wire, daemon, and 14 degrees of freedom on two blocks."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import WARP
from tiger.emulation.robot import EmulatedRobot
from tiger.emulation.scenarios import load_scenario
from tiger.record import Command, Mode
from tiger.rig import virtual

AT_S = 7.0


def _with_springs(vehicle, front: float, rear: float):
    axles = {"front": front, "rear": rear}
    changed = {
        name: getattr(vehicle, name).model_copy(
            update={"spring_npm": factor * getattr(vehicle, name).spring_npm}
        )
        for name, factor in axles.items()
    }
    return vehicle.model_copy(update=changed)


@pytest.mark.proof
@pytest.mark.parametrize(("front", "rear"), [(0.95, 1.05), (1.03, 0.97)])
@pytest.mark.parametrize("seed", [1, 2])
def test_two_wheels_in_the_air_are_brought_down_and_loaded_alike_within_eight_seconds(
    monkeypatch, front: float, rear: float, seed: int
) -> None:
    """The world's springs are up to 5 % off; the daemon knows nothing of that."""
    monkeypatch.setattr(
        virtual, "EmulatedRobot", lambda car, *rest: EmulatedRobot(_with_springs(car, front, rear), *rest)
    )
    rig = virtual.Rig(load_robot(), load_scenario("blocks"), seed)
    rig.daemon.command = Command(Mode.HOLD)
    rig.daemon.arm(patience_s=AT_S)
    rows = []
    for _ in rig.run(AT_S + 10.0):
        if rig.time_s >= AT_S:
            rig.daemon.command = Command(Mode.BALANCE)
        truth = rig.robot.truth()
        rows.append((rig.time_s - AT_S, truth.roll_deg, truth.pitch_deg, *truth.wheel_load_n))
    table = np.array(rows)
    time_s, attitude_deg, load_n = table[:, 0], table[:, 1:3], table[:, 3:]
    assert load_n[time_s < 0.0][-1].min() < 2.0
    after = time_s > 0.0
    in_the_air = after & (load_n.min(axis=1) < 5.0)
    difference = load_n @ np.array(WARP) / (0.5 * load_n.sum(axis=1))
    apart = after & (np.abs(difference) > 0.10)
    assert time_s[in_the_air].max(initial=0.0) < 3.0
    assert time_s[apart].max(initial=0.0) < 8.0
    assert np.abs(attitude_deg[time_s > 9.0]).max() < 0.5
