"""Planned faults: each is carried out where it says, when it says; what the robot cannot have is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tiger.config.errors import ConfigError
from tiger.config.vehicle import load_vehicle
from tiger.emulation.faults import Failure, Plan, table_of_failures
from tiger.emulation.robot import EmulatedRobot
from tiger.emulation.scenarios import FaultEvent, Scenario

TIGER = load_vehicle("tiger")
DOCS = Path(__file__).parents[3] / "docs" / "scenarios.md"


def robot(*events: FaultEvent) -> EmulatedRobot:
    scenario = Scenario(title="faults", duration_s=5.0, model="linear", sensor_noise=False, fault=events)
    return EmulatedRobot(TIGER, scenario, seed=0)


def fault(target: str, kind: str, **more: float) -> FaultEvent:
    return FaultEvent(target=target, kind=kind, at_s=more.pop("at_s", 0.1), **more)


def test_a_fault_begins_and_ends_when_it_says() -> None:
    happened: list[tuple[str, float]] = []
    failure = Failure(
        lambda value: happened.append(("begins", value)), lambda value: happened.append(("ends", value))
    )
    plan = Plan((fault("thing", "breaks", at_s=1.0, for_s=0.5, value=7.0),), {("thing", "breaks"): failure})
    assert plan.next_us == 1_000_000
    plan.act(999_999)
    assert happened == []
    plan.act(1_000_000)
    assert happened == [("begins", 7.0)]
    plan.act(1_499_999)
    assert len(happened) == 1
    plan.act(1_600_000)
    assert happened[1] == ("ends", 7.0)
    assert plan.next_us is None


def test_faults_happen_in_the_order_of_time_not_of_the_file() -> None:
    order: list[float] = []
    failure = Failure(order.append, lambda value: order.append(-value))
    events = tuple(
        fault("a", "b", at_s=at_s, for_s=for_s, value=value)
        for at_s, for_s, value in ((2.0, 1.0, 2.0), (1.0, 5.0, 1.0))
    )
    Plan(events, {("a", "b"): failure}).act(10_000_000)
    assert order == [1.0, 2.0, -2.0, -1.0]


def test_an_unknown_target_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        ConfigError, match=r"no 'cut' of 'antenna'; targets are actuators, estop, .*suspension"
    ):
        robot(fault("antenna", "cut"))


def test_an_unknown_kind_is_refused_with_those_the_target_knows() -> None:
    with pytest.raises(ConfigError, match="nano_imu knows brown_out, hang, hang_hard, reset"):
        robot(fault("nano_imu", "melt"))


def test_a_fault_without_the_number_it_needs_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'battery_v' of 'roboteq_left' needs a number; add `value = ...`"):
        robot(fault("roboteq_left", "battery_v"))


def test_every_failure_of_the_table_begins_and_ends_on_a_running_robot() -> None:
    broken = robot()
    for failure in table_of_failures(broken).values():
        failure.begin(1.0)
        broken.run(3)
        failure.end(1.0)
        broken.run(3)
    assert broken.motor_signs == (1.0, 1.0, 1.0, 1.0)
    assert not broken.estop_pressed
    assert not broken.cables["suspension"].is_cut
    assert broken.world.native.max_rate_mmps == TIGER.actuator.max_rate_mmps  # type: ignore[union-attr]
    assert broken.drives["left"].battery_v == 24.0


def test_the_page_lists_exactly_the_failures_there_are() -> None:
    section = DOCS.read_text(encoding="utf-8").split("## Planned faults")[1].split("\n## ")[0]
    listed = set()
    for row in re.findall(r"^\| `(.+?)` \| `(.+?)` \|", section, re.MULTILINE):
        targets, kinds = (cell.split("`, `") for cell in row)
        listed |= {(target, kind) for target in targets for kind in kinds}
    assert listed == set(table_of_failures(robot()))


def test_a_cut_cable_carries_nothing_until_it_is_mended() -> None:
    broken = robot(fault("suspension", "cut", at_s=0.5, for_s=0.5))
    cable = broken.cables["suspension"]
    broken.run(500)
    assert cable.host_read()
    broken.run(400)
    assert cable.is_cut
    broken.run(200)
    assert not cable.is_cut


@pytest.mark.parametrize(("kind", "shown"), [("open", 1023.0), ("short", 0.0)])
def test_a_broken_potentiometer_shows_the_end_of_its_range_and_then_its_stroke_again(
    kind: str, shown: float
) -> None:
    broken = robot(fault("potentiometer_rl", kind, for_s=0.2))
    broken.run(50)
    healthy = list(broken._native.shown_counts)
    broken.run(100)
    assert broken._native.shown_counts[2] == shown
    assert [broken._native.shown_counts[i] for i in (0, 1, 3)] == [healthy[i] for i in (0, 1, 3)]
    broken.run(200)
    assert broken._native.shown_counts[2] == pytest.approx(healthy[2])


def test_jammed_actuators_do_not_move_and_slow_ones_move_slower() -> None:
    def moved_mm(*events: FaultEvent) -> float:
        moving = robot(*events)
        world = moving.world
        for _ in range(1000):
            moving._plan.act(world.time_us)
            world.step(0.001, (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0))
        return world.stroke_mm[0] - 35.0

    assert moved_mm() == pytest.approx(9.4, abs=0.6)
    assert moved_mm(fault("actuators", "slow", at_s=0.0, value=4.7)) == pytest.approx(4.7, abs=0.4)
    assert moved_mm(fault("actuators", "jam", at_s=0.0)) == 0.0
    assert moved_mm(fault("actuators", "weak", at_s=0.0, value=10.0)) == pytest.approx(0.0, abs=0.05)
    assert moved_mm(fault("actuators", "jam", at_s=0.0, for_s=0.5)) == pytest.approx(4.5, abs=0.5)


def test_a_crossed_motor_turns_backwards() -> None:
    broken = robot(fault("motor_fr", "crossed", for_s=0.3))
    broken.run(150)
    assert broken.motor_signs == (1.0, -1.0, 1.0, 1.0)
    broken.run(300)
    assert broken.motor_signs == (1.0, 1.0, 1.0, 1.0)


def test_the_e_stop_is_pressed_and_released() -> None:
    broken = robot(fault("estop", "press", for_s=0.2))
    broken.run(150)
    assert broken.estop_pressed
    assert broken.drives["left"].estop_input
    broken.run(200)
    assert not broken.estop_pressed
