"""mega_speed's estimate on the native board: gears with errors, every speed, standstill, direction."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.native.boards import SpeedBoard
from tiger.protocol.frame import FrameDecoder
from tiger.protocol.messages import FROM_BOARD, BoardKind, WheelFlag, WheelSpeed

TEETH = 60
EDGES = 4 * TEETH
FRONT = 0


class Gear:
    """A toothed wheel whose edges are not where they should be.

    `edges` are the true angles of the quarter-tooth edges, in revolutions; `phase` tells at which tooth phase
    a perfect gear would show the same edges.
    """

    def __init__(
        self, seed: int = 0, edge_error: float = 0.0, pitch_error: float = 0.0, duty: float = 0.5
    ) -> None:
        """Errors are RMS in parts of a quarter-tooth pitch (edges) and of a tooth pitch (pitch)."""
        random = np.random.default_rng(seed)
        quarters = np.ones(EDGES)
        quarters[0::4] = quarters[1::4] = 2 * duty  # A high for half of the sum of these two
        quarters[2::4] = quarters[3::4] = 2 * (1 - duty)
        quarters *= np.repeat(1 + pitch_error * random.standard_normal(TEETH), 4)
        position = np.cumsum(quarters)
        position *= EDGES / position[-1]
        position[:-1] += edge_error * random.standard_normal(EDGES - 1)
        self.edges = np.concatenate(([0.0], position / EDGES))

    def phase(self, angle_rev: float) -> float:
        """Tooth phase at a wheel angle."""
        turns = math.floor(angle_rev)
        quarter = np.interp(angle_rev - turns, self.edges, np.arange(EDGES + 1))
        return turns * TEETH + float(quarter) / 4


class Wheels:
    """A board and what its two wheels do."""

    def __init__(self, gear: Gear | None = None) -> None:
        self.board = SpeedBoard(uid=7)
        self.gear = gear or Gear()
        self.decoder = FrameDecoder(FROM_BOARD[BoardKind.MEGA_SPEED])
        self.angle_rev = [0.3, 0.3]
        self.show()
        self.board.run(1000)

    def show(self) -> None:
        for channel in (0, 1):
            self.board.set_wheel(channel, self.gear.phase(self.angle_rev[channel]))

    def run(
        self,
        seconds: float,
        rev_per_s: float | Callable[[float], float],
        rear: float | Callable[[float], float] | None = None,
        step_us: int = 500,
    ) -> list[WheelSpeed]:
        """Turn both wheels for a while; a speed may depend on time. Returns the telemetry."""
        speeds = (rev_per_s, rev_per_s if rear is None else rear)
        heard = []
        for i in range(round(seconds * 1e6 / step_us)):
            for channel, speed in enumerate(speeds):
                now = speed((i + 0.5) * step_us * 1e-6) if callable(speed) else speed
                self.angle_rev[channel] += now * step_us * 1e-6
            self.show()
            self.board.run(step_us)
            heard += [r.message for r in self.decoder.feed(self.board.uart_read())]
        return [m for m in heard if isinstance(m, WheelSpeed)]


def has(message: WheelSpeed, flag: WheelFlag, channel: int = FRONT) -> bool:
    return bool(message.flags >> (flag + channel) & 1)


def worst_error(messages: list[WheelSpeed], rev_per_s: float) -> float:
    true = 2 * math.pi * rev_per_s
    return max(abs(m.speed_radps[FRONT] / true - 1) for m in messages)


def step_for(rev_per_s: float) -> int:
    """Step in which the wheel moves by a quarter of an edge at most: within it, motion is a straight line."""
    return int(min(1000, max(10, 1e6 / (4 * EDGES * abs(rev_per_s)))))


@pytest.mark.parametrize("rev_per_s", [0.05, 0.5, 5.0, 20.0, -0.05, -2.0, -20.0])
def test_perfect_gear_is_measured_to_a_tenth_of_a_percent_at_once(rev_per_s: float) -> None:
    wheels = Wheels()
    start = 6 / (EDGES * abs(rev_per_s)) + 0.05
    wheels.run(start, rev_per_s, step_us=1000)
    messages = wheels.run(max(0.3, 10 / (EDGES * abs(rev_per_s))), rev_per_s, step_us=1000)
    assert worst_error(messages, rev_per_s) <= 1e-3
    assert has(messages[-1], WheelFlag.REVERSE) == (rev_per_s < 0)
    assert not has(messages[-1], WheelFlag.STOPPED)


@pytest.mark.parametrize("duty", [0.4, 0.6])
def test_duty_error_of_the_sensor_drops_out_before_anything_is_learned(duty: float) -> None:
    wheels = Wheels(Gear(duty=duty))
    wheels.run(0.3, 1.0, step_us=250)
    messages = wheels.run(0.5, 1.0, step_us=250)
    assert not has(messages[-1], WheelFlag.PITCH_LEARNED)
    assert worst_error(messages, 1.0) <= 2e-3


LEARNED: dict[int, Wheels] = {}


def learned(seed: int) -> Wheels:
    """Wheels that have rolled for ten revolutions on a gear with 2 % pitch and 2 % edge errors."""
    if seed not in LEARNED:
        wheels = Wheels(Gear(seed, edge_error=0.02, pitch_error=0.02))
        wheels.run(10 / 2.0, lambda t: 2.0 + 0.1 * math.sin(t), step_us=200)
        LEARNED[seed] = wheels
    return LEARNED[seed]


@pytest.mark.parametrize("rev_per_s", [20.0, 5.0, 1.0, 0.5, 0.2, 0.05])
def test_speed_is_right_to_half_a_percent_on_a_bad_gear_after_learning(
    rev_per_s: float, record_figure: Callable[[str, object, str], None]
) -> None:
    wheels = learned(3)
    wheels.run(6 / (EDGES * rev_per_s) + 0.05, rev_per_s, step_us=step_for(rev_per_s))
    messages = wheels.run(max(0.25, 30 / (EDGES * rev_per_s)), rev_per_s, step_us=step_for(rev_per_s))
    error = worst_error(messages, rev_per_s)
    record_figure(f"wheel speed error, 2 % pitch error, learned, {rev_per_s} rev/s", 100 * error, "<= 0.5 %")
    assert has(messages[-1], WheelFlag.PITCH_LEARNED)
    assert error <= 5e-3


def test_without_learning_the_same_gear_is_worse() -> None:
    """Guards the test above: the gear is bad enough to need the table."""
    wheels = Wheels(Gear(3, edge_error=0.02, pitch_error=0.02))
    wheels.run(0.2, 5.5, step_us=step_for(5.5))
    messages = wheels.run(0.3, 5.5, step_us=step_for(5.5))
    assert not has(messages[-1], WheelFlag.PITCH_LEARNED)
    assert worst_error(messages, 5.5) > 8e-3


def test_learning_survives_acceleration() -> None:
    wheels = Wheels(Gear(4, pitch_error=0.02))
    wheels.run(6.0, lambda t: 1.0 + 0.3 * t, step_us=200)
    messages = wheels.run(0.4, 3.0, step_us=100)
    assert has(messages[-1], WheelFlag.PITCH_LEARNED)
    assert worst_error(messages[5:], 3.0) <= 5e-3


def test_wild_speeds_teach_no_wrong_pitches() -> None:
    wheels = Wheels()  # a perfect gear: nothing to learn
    wheels.run(6.0, lambda t: 2.0 * (1 + 0.7 * math.sin(2 * math.pi * 1.7 * t)), step_us=500)
    assert worst_error(wheels.run(0.6, 2.0, step_us=500)[10:], 2.0) <= 2e-3


def test_an_illegal_step_makes_the_board_forget_the_table() -> None:
    wheels = Wheels(Gear(5, pitch_error=0.02))
    assert has(wheels.run(4.0, 2.0, step_us=250)[-1], WheelFlag.PITCH_LEARNED)
    wheels.board.interrupt(FRONT, 0)
    wheels.board.interrupt(FRONT, 3)
    last = wheels.run(0.05, 2.0)[-1]
    assert last.illegal_counts[FRONT] >= 1
    assert not has(last, WheelFlag.PITCH_LEARNED)


@pytest.mark.parametrize("rev_per_s", [0.05, 0.3, 3.0, -3.0])
def test_standstill_is_declared_soon_and_speed_only_falls_until_then(rev_per_s: float) -> None:
    wheels = Wheels()
    wheels.run(8 / (EDGES * abs(rev_per_s)) + 0.1, rev_per_s, step_us=1000)
    edge_s = 1 / (EDGES * abs(rev_per_s))
    messages = wheels.run(1.6 * edge_s + 0.05, 0.0)
    speeds = [abs(m.speed_radps[FRONT]) for m in messages]
    assert speeds == sorted(speeds, reverse=True)
    stopped = next(i for i, m in enumerate(messages) if has(m, WheelFlag.STOPPED))
    assert stopped * 0.010 <= 1.5 * edge_s + 0.020
    assert speeds[-1] == 0


def test_a_slow_wheel_counts_as_standing_after_the_set_time_at_most() -> None:
    wheels = Wheels()
    wheels.run(3.0, 0.008, step_us=1000)  # an edge every 0.52 s: below what is called motion
    messages = wheels.run(1.5, 0.008, step_us=1000)
    assert any(has(m, WheelFlag.STOPPED) for m in messages)


@pytest.mark.parametrize("rest_s", [0.15, 1.0])
def test_start_from_rest_needs_two_edges_and_forgets_the_rest(rest_s: float) -> None:
    wheels = Wheels()
    wheels.run(0.2, 1.0)
    wheels.run(rest_s, 0.0, step_us=1000)
    messages = wheels.run(0.1, 1.0)
    moving = [m for m in messages if not has(m, WheelFlag.STOPPED)]
    assert len(moving) >= 7
    first = (
        moving[0] if rest_s > 0.5 else moving[1]
    )  # after a short rest, the mean since the last edge before it
    assert first.speed_radps[FRONT] == pytest.approx(2 * math.pi, rel=1e-3)
    assert all(m.speed_radps[FRONT] == pytest.approx(2 * math.pi, rel=1e-3) for m in moving[3:])


def test_reversal_changes_the_sign_within_two_edges() -> None:
    wheels = Wheels()
    wheels.run(0.5, 1.0)
    messages = wheels.run(0.1, -1.0)
    assert messages[-1].speed_radps[FRONT] == pytest.approx(-2 * math.pi, rel=1e-3)
    assert sum(m.speed_radps[FRONT] > 0 for m in messages) <= 3


def test_rocking_on_one_edge_is_no_speed() -> None:
    wheels = Wheels()
    wheels.run(0.2, 0.0)
    rock = 0.6 / EDGES
    messages = wheels.run(0.5, lambda t: rock * 2 * math.pi * 20 * math.cos(2 * math.pi * 20 * t))
    assert all(abs(m.speed_radps[FRONT]) < 2 * math.pi * 0.5 for m in messages[20:])
    assert abs(messages[-1].edge_counts[FRONT] - messages[0].edge_counts[FRONT]) <= 2


@settings(max_examples=25, deadline=None)
@given(
    legs=st.lists(st.tuples(st.floats(-8, 8), st.floats(0.01, 0.1)), min_size=1, max_size=6),
    start=st.floats(-3, 3),
)
def test_count_always_equals_the_edges_travelled(legs: list[tuple[float, float]], start: float) -> None:
    wheels = Wheels()
    wheels.angle_rev = [start, start]
    wheels.show()  # the first placement was at 0.3: this is a jump within one run, edge by edge
    wheels.board.run(100_000)
    before = wheels.run(0.02, 0.0)[-1].edge_counts[FRONT]
    at = math.floor(wheels.gear.phase(wheels.angle_rev[FRONT]) * 4)
    for speed, seconds in legs:
        wheels.run(seconds, speed)
    last = wheels.run(0.03, 0.0)[-1]
    assert last.edge_counts[FRONT] - before == math.floor(wheels.gear.phase(wheels.angle_rev[FRONT]) * 4) - at
    assert last.illegal_counts == (0, 0)


def test_count_passes_sixteen_bits_without_a_jump() -> None:
    wheels = Wheels()
    messages = wheels.run(70_000 / EDGES / 40.0, 40.0, step_us=5000)
    counts = np.array([m.edge_counts[FRONT] for m in messages])
    assert counts[-1] > 65_536
    assert np.all(np.abs(np.diff(counts) - 40 * EDGES * 0.01) <= 40 * EDGES * 0.005)
