"""The stability module as the controller calls it: stance, vertical, limiter modes, a state that replays."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tiger.config.robot import RobotConfig, load_robot
from tiger.control import stability
from tiger.control.stability import StabilityDesign, StabilityState, design_stability, stance_of
from tiger.logs.checkpoint import freeze, thaw
from tiger.models.full_car import GRAVITY_MPS2 as G
from tiger.record import (
    STILL,
    Command,
    Estimate,
    ImuSample,
    Inputs,
    LimitCause,
    Loads,
    Odometry,
    Stability,
    StrokeSample,
)

ROBOT = load_robot()
MID = (35.0, 35.0, 35.0, 35.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def tall(limiter: str) -> RobotConfig:
    body = ROBOT.vehicle.body.model_copy(update={"com_height_m": 0.9})
    return ROBOT.model_copy(
        update={
            "vehicle": ROBOT.vehicle.model_copy(update={"body": body}),
            "stability": ROBOT.stability.model_copy(update={"limiter": limiter}),
        }
    )


def drive(
    design: StabilityDesign,
    command: Command,
    state: StabilityState | None = None,
    seconds: float = 1.0,
    accel: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw_rate: float = 0.0,
    speed: float = 0.0,
) -> tuple[StabilityState, Stability, Command]:
    """Steady motion on level ground; `accel` is what the board calls linear acceleration."""
    state = state or StabilityState()
    shown, allowed = Stability(), command
    strokes = StrokeSample(0.0, MID, STILL, (0, 0, 0, 0), 0)
    start = max(state.motion.imu_t_s, 0.0)
    for tick in range(1, round(seconds * 200) + 1):
        now = start + tick * 0.005
        imu = ImuSample(start + math.ceil(tick / 2) * 0.01, LEVEL, (0.0, 0.0, yaw_rate), (0.0,) * 3, accel, 0)
        estimate = Estimate(ready=True, odometry=Odometry(speed_mps=speed))
        inputs = Inputs(now_s=now, armed=True, command=command, strokes=strokes, imu=imu)
        state, shown, allowed = stability.step(design, state, command, inputs, estimate, 0.005)
    return state, shown, allowed


def test_standing_on_level_ground_has_the_whole_margin_and_nothing_to_say() -> None:
    _, shown, allowed = drive(design_stability(ROBOT), Command())
    assert shown.margin == pytest.approx(1.0, abs=0.02)
    assert shown.lateral_load_transfer == pytest.approx(0.0, abs=0.01)
    assert not shown.warning
    assert not shown.tripped
    assert stability.reason(shown) == ""
    assert allowed == Command()


def test_only_on_changes_the_command_and_log_says_the_same() -> None:
    command = Command(speed_mps=5.0, yaw_rate_radps=2.5)
    found = {mode: drive(design_stability(tall(mode)), command) for mode in ("off", "log", "on")}
    assert found["off"][2] == found["log"][2] == command
    assert 0.0 < found["on"][2].speed_mps < 5.0
    assert found["on"][1] == found["log"][1]
    assert found["on"][1].cause is LimitCause.TURN
    assert found["on"][1].warning
    assert found["off"][1].limited == 0
    assert "in this turn" in stability.reason(found["on"][1])


def test_a_new_command_is_limited_at_once_between_two_samples() -> None:
    design = design_stability(tall("on"))
    state, _, _ = drive(design, Command())
    strokes = StrokeSample(0.0, MID, STILL, (0, 0, 0, 0), 0)
    imu = ImuSample(state.motion.imu_t_s, LEVEL, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 0)
    command = Command(speed_mps=6.0, yaw_rate_radps=2.0)
    inputs = Inputs(now_s=state.motion.imu_t_s, armed=True, command=command, strokes=strokes, imu=imu)
    _, _, allowed = stability.step(design, state, command, inputs, Estimate(ready=True), 0.005)
    assert allowed.speed_mps * allowed.yaw_rate_radps < 12.0 * 0.7


def test_under_a_steady_push_neither_force_nor_trend_is_left_behind() -> None:
    """Both low passes come to what is felt, so that nothing is foreseen that does not change."""
    design = design_stability(ROBOT)
    state, _, _ = drive(design, Command())
    state, _, _ = drive(design, Command(), state, seconds=1.0, accel=(0.4, -0.3, 0.2))
    motion = state.motion
    assert motion.felt[:3] == pytest.approx((0.4, -0.3, G + 0.2), abs=1e-6)
    assert motion.felt_before == pytest.approx(motion.felt, abs=1e-6)


def test_a_long_turn_is_not_taken_for_a_slope() -> None:
    """v r = 3 m/s2 for ten seconds; the vertical stays within a degree of where the body's lean leaves it."""
    design = design_stability(ROBOT)
    state, _, _ = drive(design, Command())
    state, shown, _ = drive(design, Command(), state, 10.0, accel=(0.0, 3.0, 0.0), yaw_rate=1.0, speed=3.0)
    assert abs(math.degrees(math.atan2(state.motion.upright_mps2[1], state.motion.upright_mps2[2]))) < 1.0
    assert shown.lateral_load_transfer == pytest.approx(
        -3.0 * state.judgement.stance.height_m / G / 0.6, rel=0.1
    )


def test_a_payload_counts_when_it_is_known_and_never_lowers_the_com() -> None:
    design = design_stability(ROBOT)
    empty = stance_of(design, Loads(), MID)
    load = Loads(mass_kg=99.9, com_m=(0.0, 0.1, 0.2), com_sigma_m=(0.0,) * 3)
    known = stance_of(design, load, MID)
    assert known.height_m > empty.height_m + 0.05
    assert known.reach_m[0] < known.reach_m[1]
    unsure = stance_of(design, replace(load, mass_sigma_kg=50.0, com_sigma_m=(1.0,) * 3), MID)
    assert unsure.height_m == pytest.approx(empty.height_m)
    assert unsure.reach_m == pytest.approx(empty.reach_m)
    lower = stance_of(design, replace(load, com_m=(0.0, 0.0, -0.1)), MID)
    assert lower.height_m > empty.height_m - 0.05  # the springs sag, no more


def test_the_com_of_the_empty_robot_is_a_quarter_of_a_metre_up() -> None:
    stance = stance_of(design_stability(ROBOT), Loads(), MID)
    assert stance.height_m == pytest.approx((41.22 * 0.325 + 38.68 * 0.162) / 79.9, abs=1e-4)
    raised = stance_of(design_stability(ROBOT), Loads(), (60.0,) * 4)
    assert raised.height_m > stance.height_m + 0.02
    assert raised.reach_m[0] < stance.reach_m[0]  # and the track is narrower


def test_the_state_can_be_kept_as_numbers_and_brought_back() -> None:
    design = design_stability(tall("on"))
    state, _, _ = drive(design, Command(speed_mps=5.0, yaw_rate_radps=1.0))
    assert thaw(StabilityState(), freeze(state)) == state
