"""mega_speed as a board: who it is, what it reports, and what it finds wrong with its sensors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import pytest

from tiger.native.boards import SpeedBoard
from tiger.protocol.frame import FrameDecoder, encode_message
from tiger.protocol.messages import (
    FROM_BOARD,
    PROTO,
    SCHEMA_HASH,
    Ack,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    ClearFaults,
    Fault,
    Health,
    Hello,
    HelloReply,
    ParamSave,
    ParamSet,
    WheelFlag,
    WheelSpeed,
)

DEAD_A, DEAD_B, SWAPPED = 1, 2, 4
TEETH = 60
TEETH_INDEX, ZERO_SPEED_INDEX = 0, 1


class Side:
    """One mega_speed, its two wheels and the host's end of its wire."""

    def __init__(self, instance: int = 0) -> None:
        self.board = SpeedBoard(instance, uid=0x5EED)
        self.decoder = FrameDecoder(FROM_BOARD[BoardKind.MEGA_SPEED])
        self.received: list[Any] = []
        self.phase = [0.0, 0.0]
        self.time_ms = 0
        self.seq = 0
        self.run(20)

    def run(self, ms: int, front_rev_per_s: float = 0.0, rear_rev_per_s: float | None = None) -> None:
        speeds = (front_rev_per_s, front_rev_per_s if rear_rev_per_s is None else rear_rev_per_s)
        for _ in range(ms):
            for channel in (0, 1):
                self.phase[channel] += speeds[channel] * TEETH * 1e-3
                self.board.set_wheel(channel, self.phase[channel])
            self.board.run(1000)
            self.time_ms += 1
            self.received += [r.message for r in self.decoder.feed(self.board.uart_read())]

    def last(self, kind: type) -> Any:
        return [m for m in self.received if isinstance(m, kind)][-1]

    def request(self, message: Any) -> Ack:
        self.board.uart_write(encode_message(message, self.seq))
        self.seq += 1
        self.run(10)
        return self.last(Ack)

    def flag(self, flag: WheelFlag, channel: int) -> bool:
        return bool(self.last(WheelSpeed).flags >> (flag + channel) & 1)

    def faults(self) -> set[Fault]:
        self.run(110)
        bits = self.last(Health).faults
        return {fault for fault in Fault if fault and bits >> fault & 1}

    def run_until_flag(self, flag: WheelFlag, channel: int, limit_ms: int, *speeds: float) -> int:
        start = self.time_ms
        while self.time_ms - start < limit_ms:
            self.run(1, *speeds)
            if self.flag(flag, channel):
                return self.time_ms - start
        raise AssertionError(f"{flag.name} was not set within {limit_ms} ms")


@pytest.fixture
def side() -> Iterator[Side]:
    fresh = Side()
    yield fresh
    fresh.board.close()


def test_it_reports_a_hundred_times_a_second_and_keeps_its_health(side: Side) -> None:
    side.received.clear()
    side.run(1000, 2.0)
    stamps = [m.t_us for m in side.received if isinstance(m, WheelSpeed)]
    assert len(stamps) in (99, 100, 101)
    assert all(9_000 <= b - a <= 11_000 for a, b in itertools.pairwise(stamps))
    healths = [m for m in side.received if isinstance(m, Health)]
    assert len(healths) in (9, 10, 11)
    assert healths[-1].overruns == 0
    assert healths[-1].watchdog_margin_ms >= 20


@pytest.mark.parametrize("instance", [0, 1])
def test_it_says_which_side_it_is_and_arms(instance: int) -> None:
    side = Side(instance)
    side.board.uart_write(encode_message(Hello(PROTO, 0, 0, 0x1234), 0))
    side.run(10)
    who = side.last(HelloReply)
    assert (who.board_kind, who.instance, who.host_nonce) == (BoardKind.MEGA_SPEED, instance, 0x1234)
    kind_hash = SCHEMA_HASH[BoardKind.MEGA_SPEED]
    assert side.request(Arm(0, kind_hash ^ 1, who.session)).status == AckStatus.BAD_SCHEMA
    assert side.request(Arm(0, kind_hash, who.session)).status == AckStatus.OK
    side.run(110)
    assert side.last(Health).state == BoardState.ARMED


@pytest.mark.parametrize("fault", [DEAD_A, DEAD_B])
@pytest.mark.parametrize("channel", [0, 1])
def test_a_dead_signal_is_found_within_100_ms_of_motion(side: Side, fault: int, channel: int) -> None:
    side.run(200, 2.0)
    side.board.set_faults(channel, fault)
    assert side.run_until_flag(WheelFlag.DEAD_CHANNEL, channel, 100, 2.0) <= 100
    assert not side.flag(WheelFlag.DEAD_CHANNEL, 1 - channel)
    assert side.faults() == {Fault.ENCODER_DEAD}
    assert side.last(Health).fault_detail == channel
    assert side.request(ClearFaults(0)).status == AckStatus.STILL_PRESENT
    side.board.set_faults(channel, 0)
    side.run(300, 2.0)
    assert not side.flag(WheelFlag.DEAD_CHANNEL, channel)
    side.request(ClearFaults(0))
    assert side.faults() == set()


def test_a_wheel_that_trembles_at_rest_is_not_dead(side: Side) -> None:
    for _ in range(20):
        side.run(2, 0.4 / TEETH / 0.002 / 2)
        side.run(2, -0.4 / TEETH / 0.002 / 2)
    assert not side.flag(WheelFlag.DEAD_CHANNEL, 0)
    assert not side.flag(WheelFlag.DEAD_CHANNEL, 1)


@pytest.mark.parametrize("channel", [0, 1])
def test_swapped_signals_are_found_within_100_ms_of_motion(side: Side, channel: int) -> None:
    side.board.set_faults(channel, SWAPPED)
    side.run(200, 0.0)
    side.run_until_flag(WheelFlag.SWAPPED, channel, 100, 2.0)
    assert side.flag(WheelFlag.REVERSE, channel)
    assert not side.flag(WheelFlag.REVERSE, 1 - channel)


def test_wheels_that_agree_are_never_called_swapped(side: Side) -> None:
    for speed in (3.0, -3.0, 0.1, -0.1, 0.0):
        side.run(300, speed)
        assert not side.flag(WheelFlag.SWAPPED, 0)


def test_wheels_below_a_crawl_tell_nothing_of_swapped_signals(side: Side) -> None:
    for front, rear in ((1.0, -0.1), (-0.1, 1.0)):  # a crawl is 1 rad/s, 0.16 turns a second
        side.run(3000, front, rear)
        assert not side.flag(WheelFlag.SWAPPED, 0)
        assert not side.flag(WheelFlag.SWAPPED, 1)
    side.run(500, 1.0, -0.3)
    assert side.flag(WheelFlag.SWAPPED, 0)


def test_each_wheel_s_newest_edge_grows_old_while_it_stands(side: Side) -> None:
    side.run(500, 1.0)
    assert max(side.last(WheelSpeed).edge_age_ms) <= 5  # 240 edges a second
    side.run(150, 0.0, 1.0)
    front, rear = side.last(WheelSpeed).edge_age_ms
    assert 140 <= front <= 160
    assert rear <= 5


def test_skipped_states_latch_a_fault_with_the_wheel_named(side: Side) -> None:
    for _ in range(5):
        side.board.interrupt(1, 3)
        side.board.interrupt(1, 0)
        side.run(10)
    assert side.faults() == {Fault.ENCODER_ILLEGAL}
    assert side.last(Health).fault_detail == 1
    assert side.last(WheelSpeed).illegal_counts[0] == 0
    assert side.last(WheelSpeed).illegal_counts[1] >= 8
    assert side.request(ClearFaults(0)).status == AckStatus.STILL_PRESENT
    side.run(1100)
    assert side.request(ClearFaults(0)).status == AckStatus.OK
    assert side.faults() == set()


def test_a_single_skip_is_counted_but_no_fault(side: Side) -> None:
    side.board.interrupt(0, 3)
    assert side.faults() == set()
    assert side.last(WheelSpeed).illegal_counts[0] == 1


def test_the_number_of_teeth_scales_the_speed_and_survives_power_off(side: Side) -> None:
    side.run(200, 1.0)
    assert side.last(WheelSpeed).speed_radps[0] == pytest.approx(2 * math.pi, rel=1e-3)
    assert side.request(ParamSet(0, TEETH_INDEX, 30)).status == AckStatus.OK
    assert side.request(ParamSave(0)).status == AckStatus.OK
    side.run(300)
    side.board.reset()
    side.run(50)
    side.run(200, 1.0)
    assert side.last(WheelSpeed).speed_radps[0] == pytest.approx(4 * math.pi, rel=1e-3)


def test_refused_parameters_change_nothing(side: Side) -> None:
    assert side.request(ParamSet(0, TEETH_INDEX, 7)).status == AckStatus.OUT_OF_RANGE
    assert side.request(ParamSet(0, 2, 0)).status == AckStatus.BAD_INDEX
    side.run(200, 1.0)
    assert side.last(WheelSpeed).speed_radps[0] == pytest.approx(2 * math.pi, rel=1e-3)


def test_the_longest_wait_for_an_edge_is_a_parameter(side: Side) -> None:
    side.request(ParamSet(0, ZERO_SPEED_INDEX, 100))
    side.run(400, 0.05)  # an edge every 83 ms
    side.received.clear()
    side.run(170)
    stopped = [m.flags & 1 for m in side.received if isinstance(m, WheelSpeed)]
    assert stopped[-1]
    assert stopped.index(1) <= 12


def test_speed_beyond_the_message_is_said_as_its_limit(side: Side) -> None:
    side.request(ParamSet(0, TEETH_INDEX, 8))
    side.run(100, 20.0)  # 150 revolutions a second of 8 teeth
    assert side.last(WheelSpeed).speed_radps[0] == 400.0
    assert sum(side.decoder.rejects) == 0


def test_clock_wrap_disturbs_neither_speed_nor_telemetry() -> None:
    side = Side()
    side.board.set_clock_start(2**32 - 300_000)
    side.board.reset()
    side.run(100, 1.0)
    side.received.clear()
    side.run(600, 1.0)
    messages = [m for m in side.received if isinstance(m, WheelSpeed)]
    assert messages[0].t_us > messages[-1].t_us
    assert len(messages) in (59, 60, 61)
    assert all(m.speed_radps[0] == pytest.approx(2 * math.pi, rel=1e-3) for m in messages)
    assert side.faults() == set()
