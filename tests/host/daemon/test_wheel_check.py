"""The check at the first motion: sides and directions, before the wheels may follow commands."""

from __future__ import annotations

import pytest

from tiger.daemon.limits import RPM_PER_RADPS
from tiger.daemon.wheel_check import PATIENCE_S, PROBE_RPM, Phase, WheelCheck, step
from tiger.record import Four, Inputs, WheelSample

DT_S = 0.005
LAG = 0.2  # share of the way to the commanded speed in one step


def drive(crossing: tuple[tuple[int, float], ...], seconds: float = 5.0) -> WheelCheck:
    """Run the check on wheels FL FR RL RR that follow the motor and sign given by `crossing`."""
    check = step(WheelCheck(), True, Inputs(0.0, True), DT_S)
    rpm = [0.0] * 4
    for _ in range(round(seconds / DT_S)):
        commanded: Four = check.wheel_rpm
        rpm = [
            now + LAG * (sign * commanded[motor] - now)
            for now, (motor, sign) in zip(rpm, crossing, strict=True)
        ]
        left = WheelSample(0.0, (0, 0), (rpm[0] / RPM_PER_RADPS, rpm[2] / RPM_PER_RADPS), 0)
        right = WheelSample(0.0, (0, 0), (rpm[1] / RPM_PER_RADPS, rpm[3] / RPM_PER_RADPS), 0)
        check = step(check, True, Inputs(0.0, True, wheels_left=left, wheels_right=right), DT_S)
    return check


def test_a_body_that_rocks_is_no_wrong_wiring() -> None:
    """The far wheels roll for a moment before the driven ones have begun to turn."""
    check = step(WheelCheck(), True, Inputs(0.0, True), DT_S)
    rocking = WheelSample(0.0, (0, 0), (-8.0 / RPM_PER_RADPS, -8.0 / RPM_PER_RADPS), 0)
    still = WheelSample(0.0, (0, 0), (0.0, 0.0), 0)
    for _ in range(round(0.15 / DT_S)):
        check = step(check, True, Inputs(0.0, True, wheels_left=still, wheels_right=rocking), DT_S)
    assert check.phase is Phase.LEFT
    turning = WheelSample(0.0, (0, 0), (PROBE_RPM / RPM_PER_RADPS, PROBE_RPM / RPM_PER_RADPS), 0)
    for _ in range(round(0.1 / DT_S)):
        check = step(check, True, Inputs(0.0, True, wheels_left=turning, wheels_right=still), DT_S)
    assert check.phase in (Phase.PAUSE, Phase.RIGHT)


STRAIGHT = ((0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0))


def test_wheels_that_follow_their_motors_pass() -> None:
    assert drive(STRAIGHT).passed


def test_it_waits_until_motion_is_wanted() -> None:
    check = step(WheelCheck(), False, Inputs(0.0, True), DT_S)
    assert check.phase is Phase.IDLE
    assert check.wheel_rpm == (0.0,) * 4


def test_it_turns_the_left_side_first_and_slowly() -> None:
    check = step(WheelCheck(), True, Inputs(0.0, True), DT_S)
    assert check.wheel_rpm == (PROBE_RPM, 0.0, PROBE_RPM, 0.0)


@pytest.mark.parametrize(
    ("crossing", "words"),
    [
        (((1, 1.0), (0, 1.0), (3, 1.0), (2, 1.0)), "the two ports are swapped"),
        (((1, -1.0), (0, -1.0), (3, -1.0), (2, -1.0)), "the two ports are swapped"),
        (((0, -1.0), (1, 1.0), (2, 1.0), (3, 1.0)), "front left wheel: turns backwards"),
        (((0, 1.0), (1, 1.0), (2, -1.0), (3, 1.0)), "rear left wheel: turns backwards"),
        (((0, 1.0), (1, -1.0), (2, 1.0), (3, 1.0)), "front right wheel: turns backwards"),
        (((0, 0.0), (1, 1.0), (2, 1.0), (3, 1.0)), "front left wheel: shows no motion when driven"),
        (((0, 1.0), (1, 0.0), (2, 1.0), (3, 0.0)), "front and rear right wheel: shows no motion"),
    ],
)
def test_what_is_crossed_is_named_and_stops_the_wheels(
    crossing: tuple[tuple[int, float], ...], words: str
) -> None:
    check = drive(crossing)
    assert check.phase is Phase.FAILED
    assert check.wheel_rpm == (0.0,) * 4
    assert words in str(check.problem)


def test_a_wheel_that_does_not_stop_between_the_sides_is_named() -> None:
    check = WheelCheck(Phase.PAUSE)
    turning = WheelSample(0.0, (0, 0), (1.0, 1.0), 0)
    inputs = Inputs(0.0, True, wheels_left=turning, wheels_right=turning)
    for _ in range(round(PATIENCE_S / DT_S) + 2):
        check = step(check, True, inputs, DT_S)
    assert "do not stop" in str(check.problem)


def test_without_wheel_speeds_it_stays_where_it_is() -> None:
    check = step(WheelCheck(Phase.LEFT), True, Inputs(0.0, True), DT_S)
    assert check.phase is Phase.LEFT


def test_a_side_must_turn_for_50_ms_and_both_must_stand_for_100_before_the_check_goes_on() -> None:
    turning = WheelSample(0.0, (0, 0), (PROBE_RPM / RPM_PER_RADPS, PROBE_RPM / RPM_PER_RADPS), 0)
    still = WheelSample(0.0, (0, 0), (0.0, 0.0), 0)

    def steps(begin: Phase, left: WheelSample, right: WheelSample) -> tuple[int, Phase]:
        check, n = WheelCheck(begin), 0
        while check.phase is begin:
            n, check = n + 1, step(check, True, Inputs(0.0, True, wheels_left=left, wheels_right=right), DT_S)
        return n, check.phase

    for begin, left, right, needed_s, after in (
        (Phase.LEFT, turning, still, 0.05, Phase.PAUSE),
        (Phase.PAUSE, still, still, 0.1, Phase.RIGHT),
        (Phase.RIGHT, still, turning, 0.05, Phase.PASSED),
    ):
        n, reached = steps(begin, left, right)
        assert reached is after
        assert n * DT_S == pytest.approx(needed_s, abs=1.01 * DT_S)
