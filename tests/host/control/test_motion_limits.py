"""The limiter takes what would tip and leaves everything else."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.control import motion_limits
from tiger.control.motion_limits import ACCELERATION, CURVATURE, SPEED, Allowed, LimiterState
from tiger.control.tip_over import FRONT, LEFT, REAR, RIGHT, Stance
from tiger.models.full_car import GRAVITY_MPS2 as G
from tiger.record import LimitCause

ROBOT = load_robot()
DESIGN = motion_limits.design_limiter(ROBOT)
SHARE = DESIGN.load_transfer_max
TALL = Stance(height_m=0.8, reach_m=(0.6, 0.6, 0.5, 0.5))
LOW = Stance(height_m=0.25, reach_m=(0.6, 0.6, 0.5, 0.5))
DT = 0.01


def limit(
    stance: Stance,
    speed: float,
    yaw: float,
    plane: tuple[float, float] = (0.0, 0.0),
    moving: float | None = None,
    state: LimiterState | None = None,
    tripped: bool = False,
) -> Allowed:
    ground = motion_limits.footing(stance, plane, DESIGN.friction_max)
    now = speed if moving is None else moving
    before = state or LimiterState(speed_mps=now)
    return motion_limits.step(DESIGN, before, ground, (speed, yaw), now, tripped, DT)[1]


@given(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_tiger_itself_is_never_limited_on_flat_ground(speed: float, yaw: float) -> None:
    """It slides first: nothing to limit."""
    allowed = limit(LOW, speed, yaw)
    assert (allowed.speed_mps, allowed.yaw_rate_radps, allowed.limited) == (speed, yaw, 0)
    assert not allowed.would_tip


@given(st.floats(-8.0, 8.0), st.floats(-2.0, 2.0), st.floats(-0.25, 0.25))
def test_no_allowed_turn_takes_more_than_its_share(speed: float, yaw: float, roll: float) -> None:
    allowed = limit(TALL, speed, yaw, (roll, 0.0))
    turn = speed * allowed.yaw_rate_radps  # at the speed that it has now
    for acceleration in (turn, allowed.speed_mps * allowed.yaw_rate_radps):
        push = acceleration + G * math.sin(roll)
        transfer = 0.8 * abs(push) / (G * math.cos(roll)) / 0.6
        at_rest = 0.8 * math.tan(abs(roll)) / 0.6
        crawling = DESIGN.crawl_mps * DESIGN.crawl_radps / G
        assert transfer <= max(SHARE, at_rest) + 2.0 * crawling + 1e-9


def test_a_turn_too_fast_keeps_its_curvature_at_a_lower_speed() -> None:
    allowed = limit(TALL, 5.0, 1.5, moving=0.0)
    assert allowed.yaw_rate_radps / allowed.speed_mps == pytest.approx(1.5 / 5.0)
    assert allowed.speed_mps * allowed.yaw_rate_radps == pytest.approx(SHARE * G * 0.6 / 0.8)
    assert allowed.limited == SPEED
    assert allowed.cause is LimitCause.TURN
    assert allowed.would_tip


def test_until_it_is_slower_it_turns_less() -> None:
    allowed = limit(TALL, 5.0, 1.5, moving=5.0)
    assert allowed.limited == SPEED | CURVATURE
    assert 5.0 * allowed.yaw_rate_radps == pytest.approx(SHARE * G * 0.6 / 0.8)


def test_turning_downhill_out_is_allowed_less_than_uphill_out() -> None:
    falls_right = (math.radians(10.0), 0.0)  # left side up
    left_turn, right_turn = limit(TALL, 4.0, 2.0, falls_right), limit(TALL, 4.0, -2.0, falls_right)
    assert abs(left_turn.yaw_rate_radps) < abs(right_turn.yaw_rate_radps)


def test_bounds_mirror_and_add_up_with_the_slope() -> None:
    ground = motion_limits.footing(TALL, (0.1, 0.05), 5.0)
    assert ground.bound(LEFT, 1.0) - ground.bound(RIGHT, 1.0) == pytest.approx(2.0 * G * math.sin(0.1))
    assert ground.bound(REAR, 1.0) - ground.bound(FRONT, 1.0) == pytest.approx(2.0 * G * math.sin(0.05))


def test_soft_springs_and_a_com_off_the_middle_lower_the_bound() -> None:
    rigid = motion_limits.footing(TALL, (0.0, 0.0), 5.0)
    soft = Stance(0.8, (0.6, 0.6, 0.5, 0.5), roll_sway_s2pm=0.03, pitch_sway_s2pm=0.03)
    off = Stance(0.8, (0.7, 0.5, 0.5, 0.5))
    assert motion_limits.footing(soft, (0.0, 0.0), 5.0).bound(RIGHT, 1.0) < rigid.bound(RIGHT, 1.0)
    assert motion_limits.footing(off, (0.0, 0.0), 5.0).bound(RIGHT, 1.0) < rigid.bound(RIGHT, 1.0)
    assert motion_limits.footing(off, (0.0, 0.0), 5.0).bound(LEFT, 1.0) > rigid.bound(LEFT, 1.0)


def test_a_slope_that_gets_steeper_stops_it_and_lets_it_go_back() -> None:
    state = LimiterState(speed_mps=1.0)
    place = 0.0
    speed = 1.0
    for _ in range(1500):
        ground = motion_limits.footing(TALL, (0.0, 0.1 * place), 5.0)
        state, allowed = motion_limits.step(DESIGN, state, ground, (1.0, 0.0), speed, False, DT)
        speed += min(DT, max(-DT, allowed.speed_mps - speed))  # 1 m/s2
        place += speed * DT
    assert speed == pytest.approx(0.0, abs=0.02)
    used = max(motion_limits.footing(TALL, (0.0, 0.1 * place), 5.0).at_rest())
    assert SHARE - 0.1 < used < SHARE + 0.05
    assert allowed.cause is LimitCause.SLOPE
    ground = motion_limits.footing(TALL, (0.0, 0.1 * place), 5.0)
    _, back = motion_limits.step(DESIGN, state, ground, (-0.5, 0.0), 0.0, False, DT)
    assert back.speed_mps < 0.0


def test_it_does_not_turn_into_a_heading_that_the_slope_does_not_allow() -> None:
    oblique = (
        math.radians(12.0),
        math.radians(19.0),
    )  # falls ahead and to the right: straight down is too steep
    down, away = limit(TALL, 0.0, -1.0, oblique), limit(TALL, 0.0, 1.0, oblique)
    assert down.limited == CURVATURE
    assert down.cause is LimitCause.SLOPE
    assert -1.0 < down.yaw_rate_radps <= 0.0
    assert away.yaw_rate_radps == 1.0


def test_it_brakes_no_harder_than_the_load_allows() -> None:
    state = LimiterState(speed_mps=3.0)
    steep = (0.0, math.radians(17.0))  # nose down
    ground = motion_limits.footing(TALL, steep, 5.0)
    assert ground.bound(FRONT, SHARE) < DESIGN.acceleration_mps2
    state, allowed = motion_limits.step(DESIGN, state, ground, (0.0, 0.0), 3.0, False, DT)
    assert allowed.limited & ACCELERATION
    assert 0.0 < 3.0 - allowed.speed_mps <= DESIGN.acceleration_mps2 * DT


def test_a_limited_speed_does_not_run_away_from_a_robot_that_lags() -> None:
    """What it lags behind, its speed loop would make up for with more than the limit."""
    steep = motion_limits.footing(TALL, (0.0, math.radians(17.0)), 5.0)
    state = LimiterState(speed_mps=3.0, used=steep.at_rest())
    for _ in range(200):  # two seconds in which the robot does not brake at all
        state, allowed = motion_limits.step(DESIGN, state, steep, (0.0, 0.0), 3.0, False, DT)
    hardest = steep.bound(FRONT, SHARE)
    assert allowed.speed_mps == pytest.approx(3.0 - hardest * (motion_limits.LEAD_S + DT), abs=0.05)


def test_driving_rocks_the_body_and_is_no_slope() -> None:
    """Swinging once a second by a degree hardly slows down a robot on a constant slope."""
    state, least = LimiterState(speed_mps=1.0), 1.0
    for k in range(500):
        plane = (0.0, math.radians(9.0 + 1.0 * math.sin(2.0 * math.pi * k * DT)))
        ground = motion_limits.footing(TALL, plane, 5.0)
        state, allowed = motion_limits.step(DESIGN, state, ground, (1.0, 0.0), 1.0, False, DT)
        least = min(least, allowed.speed_mps)
    assert least > 0.8


def test_braking_that_would_tip_it_is_said_so() -> None:
    hard, steep = replace(DESIGN, acceleration_mps2=5.0), (0.0, math.radians(10.0))
    ground = motion_limits.footing(TALL, steep, 5.0)
    assert ground.bound(FRONT, 1.0) < 5.0 < ground.bound(REAR, 1.0)

    def told(now: float, wanted: float) -> bool:
        state = LimiterState(speed_mps=now, used=ground.at_rest())
        return motion_limits.step(hard, state, ground, (wanted, 0.0), now, False, DT)[1].would_tip

    assert told(3.0, 0.0)
    assert told(0.0, -2.0)  # backwards is braking, to the front edge
    assert not told(0.0, 2.0)
    assert not told(2.0, 1.7)  # over before it tips


def test_what_a_side_slope_uses_is_not_there_for_braking() -> None:
    """Over a corner both ways count."""
    state = LimiterState(speed_mps=3.0)
    brakes = []
    for roll in (0.0, math.radians(10.0), math.radians(-10.0)):
        ground = motion_limits.footing(TALL, (roll, 0.0), 5.0)
        slower, _ = motion_limits.step(
            replace(DESIGN, acceleration_mps2=9.0), state, ground, (0.0, 0.0), 3.0, False, DT
        )
        brakes.append((3.0 - slower.speed_mps) / DT)
    assert brakes[0] == pytest.approx(SHARE * G * 0.5 / 0.8)
    assert brakes[1] == pytest.approx(brakes[2])
    used = math.tan(math.radians(10.0)) * 0.8 / 0.6
    assert brakes[1] == pytest.approx(brakes[0] * (1.0 - used) * math.cos(math.radians(10.0)))


@pytest.mark.parametrize(
    ("pitch_deg", "per_m", "limited"), [(9.0, 0.08, 0), (9.0, 0.3, SPEED), (2.0, 0.2, 0)]
)
def test_only_a_slope_that_is_one_is_taken_to_go_on_and_not_for_ever(
    pitch_deg: float, per_m: float, limited: int
) -> None:
    ground = motion_limits.footing(TALL, (0.0, math.radians(pitch_deg)), 5.0)
    state = LimiterState(speed_mps=1.0, used=ground.at_rest(), per_m=(per_m, 0.0))
    allowed = motion_limits.step(DESIGN, state, ground, (1.0, 0.0), 1.0, False, DT)[1]
    assert allowed.limited & SPEED == limited


def test_after_a_trip_it_stops() -> None:
    allowed = limit(LOW, 2.0, 0.5, tripped=True)
    assert allowed.speed_mps == 0.0
    assert allowed.yaw_rate_radps == 0.0
    assert allowed.cause is LimitCause.TRIP
