"""What a simulated second costs, counted in calls: a busy machine changes no count."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import pytest

from tiger.config.robot import load_robot
from tiger.emulation import robot as emulated
from tiger.emulation.cable import LineNoise
from tiger.emulation.scenarios import Scenario
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable

MOST_CALLS_OF_THE_ROBOT = 430
"""Per tick of 5 ms, in Python and out of it, most by the Roboteqs. A loop over milliseconds took 940."""


def rig_of(model: str, noise: LineNoise = LineNoise()) -> Rig:  # noqa: B008  frozen
    scenario = Scenario.model_validate({"title": "stands", "duration_s": 60.0, "model": model})
    rig = Rig(load_robot(None), scenario, noise=noise)
    list(rig.run(3.0))  # every device has introduced itself
    return rig


def calls(action: Callable[[], object]) -> int:
    """How many functions run during an action, Python's and built-in ones."""
    count = 0

    def note(_frame: object, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize("model", ["linear", "vehicle"])
def test_the_emulated_robot_is_no_loop_in_python(model: str) -> None:
    rig = rig_of(model)
    spent = 0
    for _ in range(100):
        spent += calls(lambda: rig.robot.run(5))
        rig.clock.set(rig.robot.time_s)
        rig.daemon.tick(rig.robot.time_s)
    assert spent / 100 < MOST_CALLS_OF_THE_ROBOT


def test_boards_and_world_run_five_milliseconds_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    class Counting:
        steps: list[int] = []  # noqa: RUF012

        def __getattr__(self, name: str) -> Any:
            return getattr(native, name)

        def tiger_robot_run(self, robot: object, steps: int, *rest: object) -> None:
            self.steps.append(steps)
            native.tiger_robot_run(robot, steps, *rest)

    native, counting = emulated.lib, Counting()  # type: ignore[attr-defined]
    monkeypatch.setattr(emulated, "lib", counting)
    rig = rig_of("linear")
    counting.steps.clear()
    list(rig.run(1.0))
    assert counting.steps == [5] * 200


def test_in_however_many_calls_time_passes_the_robot_does_the_same() -> None:
    rigs = [rig_of("linear") for _ in range(3)]
    for _ in range(100):
        rigs[0].robot.run(5)
        for _ in range(5):
            rigs[1].robot.run()
        rigs[2].robot.run(2)
        rigs[2].robot.run(3)
        for rig in rigs:
            rig.clock.set(rig.robot.time_s)
        first, *others = (rig.daemon.tick(rig.robot.time_s) for rig in rigs)
        assert all(repr(other) == repr(first) for other in others)
    assert rigs[0].robot.truth() == rigs[1].robot.truth() == rigs[2].robot.truth()


def test_a_planned_failure_begins_at_its_millisecond() -> None:
    fault = {"at_s": 1.0017, "target": "estop", "kind": "press"}
    scenario = Scenario.model_validate(
        {"title": "pressed", "duration_s": 9.0, "model": "linear", "fault": [fault]}
    )
    rig = Rig(load_robot(None), scenario)
    rig.robot.run(1000)
    pressed = []
    for _ in range(5):
        rig.robot.run()
        pressed.append(rig.robot.estop_pressed)
    assert pressed == [False, False, True, True, True]
    again = Rig(load_robot(None), scenario).robot
    again.run(1005)
    assert again.truth() == rig.robot.truth()


def test_a_noisy_wire_between_boards_is_carried_millisecond_by_millisecond() -> None:
    rig = rig_of("linear", LineNoise.everything(1e-3))
    damaged = rig.robot.damaged_bytes
    list(rig.run(1.0))
    assert rig.robot.damaged_bytes > damaged
