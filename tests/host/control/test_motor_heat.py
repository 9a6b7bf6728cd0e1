"""Heat of the actuators' motors: as the board reckons it, and taken back in time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control import attitude, motor_heat
from tiger.control.attitude import LevelingState, Target
from tiger.control.reachable import Pose

ROBOT = load_robot(None)
CONFIG = ROBOT.leveling
FULL_DUTY = (1000.0, 1000.0, 1000.0, 1000.0)


def seconds_to_the_limit(duty_permille: float, dt: float = 0.005) -> float:
    heat, time_s = motor_heat.COLD, 0.0
    while heat[0] < 1.0:
        heat = motor_heat.step(heat, (duty_permille, 0.0, 0.0, 0.0), dt)
        time_s += dt
    assert heat[1:] == (0.0, 0.0, 0.0)
    return time_s


def test_full_drive_from_cold_is_stopped_when_the_board_would() -> None:
    """94 s, docs/mega_suspension.md."""
    assert seconds_to_the_limit(1000.0) == pytest.approx(94.0, abs=1.0)
    assert seconds_to_the_limit(-1000.0) == pytest.approx(94.0, abs=1.0)


@given(st.floats(-500.0, 500.0))
def test_half_drive_goes_on_for_ever(duty_permille: float) -> None:
    heat = motor_heat.FULL
    for _ in range(100):
        heat = motor_heat.step(heat, (duty_permille, 0.0, 500.0, -500.0), 1.0)
        assert max(heat) <= 1.0 + 1e-12
    assert heat[1] < 0.75


@given(st.tuples(*[st.floats(0.0, 2.0)] * 4), st.tuples(*[st.floats(0.0, 0.1)] * 4))
def test_a_hotter_motor_never_moves_faster(
    heat: tuple[float, float, float, float], more: tuple[float, float, float, float]
) -> None:
    fl, fr, rl, rr = (a + b for a, b in zip(heat, more, strict=True))
    for cooler, hotter in zip(
        motor_heat.rate_share(CONFIG, heat), motor_heat.rate_share(CONFIG, (fl, fr, rl, rr)), strict=True
    ):
        assert 0.0 <= hotter <= cooler <= 1.0


def test_cool_motors_move_at_full_rate_and_one_at_the_stop_not_at_all() -> None:
    assert motor_heat.rate_share(CONFIG, (CONFIG.heat_slow,) * 4) == motor_heat.FULL
    assert motor_heat.rate_share(CONFIG, (CONFIG.heat_stop, 0.0, 0.0, 1.5)) == (0.0, 1.0, 1.0, 0.0)


def test_a_hot_motor_slows_the_move_and_keeps_its_direction() -> None:
    design = attitude.design_leveling(ROBOT)
    target = Target(Pose(0.1, 0.0, design.ride_mm))

    def rates(share: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        state, strokes = LevelingState(), (35.0, 35.0, 35.0, 35.0)
        for _ in range(60):
            state, out = attitude.step(design, state, target, strokes, ROBOT.loop.period_s, share)
        return out.command_mmps

    cool, hot = rates(motor_heat.FULL), rates((0.5, 1.0, 1.0, 1.0))
    assert max(map(abs, cool)) == pytest.approx(ROBOT.actuator.max_rate_mmps, rel=0.02)
    assert abs(hot[0]) <= 0.5 * ROBOT.actuator.max_rate_mmps + 1e-9
    lift = [(m[0] - m[1] + m[2] - m[3]) for m in (cool, hot)]
    assert 0.0 < lift[1] < lift[0]
    assert hot[0] - hot[1] == pytest.approx(hot[2] - hot[3], rel=0.05)  # still a roll


def test_without_a_motor_that_may_move_nothing_does() -> None:
    design = attitude.design_leveling(ROBOT)
    target = Target(Pose(0.1, 0.05, design.ride_mm))
    state, strokes = LevelingState(), (35.0, 35.0, 35.0, 35.0)
    for _ in range(60):
        state, out = attitude.step(design, state, target, strokes, ROBOT.loop.period_s, motor_heat.COLD)
        assert out.command_mmps == (0.0, 0.0, 0.0, 0.0)
