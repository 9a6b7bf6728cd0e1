"""The clock of a board: offset and drift found through jitter, steps noticed, never backwards."""

from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.protocol.clock_sync import ClockConfig, ClockSync

WIRE_UP_S, WIRE_DOWN_S = 0.00024, 0.0004


@dataclass
class Board:
    """A board with a clock of its own at the far end of a wire with jitter."""

    offset_s: float = 1234.5
    drift_ppm: float = 0.0
    jitter_s: float = 100e-6
    rng: random.Random = field(default_factory=lambda: random.Random(1))

    def clock_us(self, host_s: float) -> int:
        return round((self.offset_s + host_s * (1 + self.drift_ppm * 1e-6)) * 1e6) % (1 << 32)

    def delay_s(self) -> float:
        """Mostly small, at times a whole scheduler slice."""
        return self.rng.expovariate(1 / self.jitter_s) + (0.004 if self.rng.random() < 0.1 else 0.0)

    def exchange(self, sync: ClockSync, host_s: float) -> bool:
        arrives_s = host_s + WIRE_UP_S + self.delay_s()
        answers_s = arrives_s + 150e-6
        back_s = answers_s + WIRE_DOWN_S + self.delay_s()
        rx_us, tx_us = self.clock_us(arrives_s), self.clock_us(answers_s)
        return sync.add(host_s, back_s, rx_us, tx_us, WIRE_UP_S, WIRE_DOWN_S)

    def run(self, sync: ClockSync, start_s: float, seconds: float) -> float:
        """A burst of eight, then one each 0.98 s; returns when it ended."""
        for i in range(8):
            self.exchange(sync, start_s + 0.03 * i)
        at_s = start_s + 0.3
        while at_s < start_s + seconds:
            self.exchange(sync, at_s)
            at_s += 0.98
        return at_s


def test_it_is_ready_after_the_burst_and_then_good_to_a_millisecond() -> None:
    sync, board = ClockSync(), Board()
    board.run(sync, 10.0, 0.3)
    assert sync.ready
    assert sync.to_host(board.clock_us(10.4)) == pytest.approx(10.4, abs=1e-3)


@pytest.mark.parametrize("drift_ppm", [-5000.0, -40.0, 0.0, 300.0, 5000.0])
def test_offset_and_drift_are_found_within_a_minute(drift_ppm: float) -> None:
    sync, board = ClockSync(), Board(drift_ppm=drift_ppm)
    end_s = board.run(sync, 0.0, 60.0)
    assert sync.drift_ppm == pytest.approx(drift_ppm, abs=20.0)
    assert sync.to_host(board.clock_us(end_s)) == pytest.approx(end_s, abs=150e-6)


@settings(max_examples=30, deadline=None)
@given(drift=st.floats(-4900, 4900), seed=st.integers(0, 1000), offset=st.floats(0, 8000))
def test_the_error_stays_within_five_of_its_exported_sigmas(drift: float, seed: int, offset: float) -> None:
    sync, board = ClockSync(), Board(offset, drift, rng=random.Random(seed))
    end_s = board.run(sync, 5.0, 30.0)
    error_s = abs(sync.to_host(board.clock_us(end_s)) - end_s)
    assert error_s < 5 * sync.sigma_at(end_s) + 1e-6  # and a rounding to microseconds
    assert sync.sigma_at(end_s) < 200e-6


def test_sigma_grows_when_no_answer_comes() -> None:
    sync, board = ClockSync(), Board()
    end_s = board.run(sync, 0.0, 30.0)
    assert sync.sigma_at(end_s) < sync.sigma_at(end_s + 10.0) < sync.sigma_at(end_s + 100.0)


def test_slow_exchanges_are_not_used() -> None:
    sync, board = ClockSync(), Board(jitter_s=10e-6)
    board.run(sync, 0.0, 20.0)
    used = sync.accepted
    rx_us = board.clock_us(20.02)
    assert not sync.add(20.0, 20.05, rx_us, rx_us, WIRE_UP_S, WIRE_DOWN_S)
    assert sync.accepted == used
    assert sync.gated >= 1


def test_a_link_that_became_slower_for_good_is_used_again() -> None:
    sync, board = ClockSync(), Board(jitter_s=10e-6)
    end_s = board.run(sync, 0.0, 20.0)
    slow = Board(board.offset_s, jitter_s=10e-6)
    slow.delay_s = lambda: 0.002 + slow.rng.random() * 1e-5  # type: ignore[method-assign]
    used = [slow.exchange(sync, end_s + 0.98 * i) for i in range(60)]
    assert any(used[30:])


def test_a_reading_five_sigmas_off_is_rejected() -> None:
    sync, board = ClockSync(), Board()
    end_s = board.run(sync, 0.0, 30.0)
    board.offset_s += 0.01
    before = sync.to_host(board.clock_us(end_s) - 10000)
    assert not any(board.exchange(sync, end_s + 0.98 * i) for i in range(1))
    assert sync.to_host(board.clock_us(end_s) - 10000) == before


def test_a_clock_that_really_jumped_is_followed_after_five_rejections() -> None:
    sync, board = ClockSync(), Board(jitter_s=10e-6)
    end_s = board.run(sync, 0.0, 30.0)
    board.offset_s += 3.0
    end_s = board.run(sync, end_s, 30.0)
    assert sync.rejected == 5
    assert sync.to_host(board.clock_us(end_s)) == pytest.approx(end_s, abs=1e-3)


def test_after_a_reset_nothing_is_remembered() -> None:
    sync, board = ClockSync(), Board()
    board.run(sync, 0.0, 30.0)
    sync.to_host(board.clock_us(30.0))
    board.offset_s += 3.0
    assert not board.exchange(sync, 31.0)
    sync.reset()
    assert vars(sync) == vars(ClockSync(sync.config))


def test_frames_of_different_length_do_not_shift_the_clock() -> None:
    sync = ClockSync()
    for k in range(20):
        sent_s = 0.5 * k
        arrived_us = round((sent_s + 0.001) * 1e6)
        sync.add(sent_s, sent_s + 0.011, arrived_us, arrived_us, wire_up_s=0.001, wire_down_s=0.010)
    assert sync.to_host(9_000_000) == pytest.approx(9.0, abs=50e-6)


def test_times_survive_the_wrap_of_the_microsecond_counter() -> None:
    sync, board = ClockSync(), Board(offset_s=4294.967296 - 20.0)
    end_s = board.run(sync, 0.0, 60.0)
    assert board.clock_us(19.0) > board.clock_us(21.0)
    assert sync.rejected == 0
    assert sync.to_host(board.clock_us(end_s)) == pytest.approx(end_s, abs=1e-3)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_later_sample_never_maps_to_an_earlier_time(seed: int) -> None:
    rng = random.Random(seed)
    sync, board = ClockSync(), Board(drift_ppm=rng.uniform(-5000, 5000), jitter_s=1e-3, rng=rng)
    at_s, last_s = 0.0, -1.0
    for _ in range(300):
        at_s += rng.uniform(0.0, 0.05)
        if rng.random() < 0.3:
            board.exchange(sync, at_s)
        if sync.ready:
            mapped_s = sync.to_host(board.clock_us(at_s))
            assert mapped_s >= last_s
            last_s = mapped_s


def test_drift_is_held_within_what_a_resonator_can_do() -> None:
    sync, board = ClockSync(ClockConfig(reject_sigmas=1e9)), Board(drift_ppm=20_000.0)
    board.run(sync, 0.0, 60.0)
    assert abs(sync.drift_ppm) <= 5000.0
