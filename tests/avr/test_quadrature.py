"""Quadrature on the real image: edge rates, lost edges, the cost of the interrupt."""

from __future__ import annotations

from typing import Any

import pytest

from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

HZ = 16_000_000
PINS = (("E4", "E5"), ("D3", "D2"))  # A and B of the front and the rear wheel
STATES = ((0, 0), (1, 0), (1, 1), (0, 1))  # A leads B
INT2, INT3, INT4, INT5 = 3, 4, 5, 6
ISR_BUDGET_CYCLES = 130


def turn(board: Any, rates_hz: tuple[float, float], edges: int, start: tuple[int, int] = (0, 0)) -> int:
    """Queue edges, `edges` on the faster wheel, negative rates backwards; return the cycle of the last."""
    begin = board.cycle + 1000
    events = []
    for wheel, rate_hz in enumerate(rates_hz):
        count = start[wheel]
        for i in range(int(edges * abs(rate_hz) / max(map(abs, rates_hz)))):
            before, count = count, count + (1 if rate_hz > 0 else -1)
            at = begin + int((i + 0.137 * wheel) * HZ / abs(rate_hz))
            for signal in (0, 1):
                if STATES[before & 3][signal] != STATES[count & 3][signal]:
                    events.append((at, PINS[wheel][signal], STATES[count & 3][signal]))
    events.sort()
    for at, pin, level in events:
        board.pin(pin, level, at)
    return int(events[-1][0])


def run_past(host: Any, cycle: int, chatter: bool) -> wire.WheelSpeed:
    """Run beyond `cycle`, with the host asking all the time if `chatter`; the last telemetry."""
    while host.board.cycle < cycle + 20 * HZ // 1000:
        if chatter:
            host.say(wire.Ping(0, host.board.cycle & 0xFFFFFFFF))
        host.listen(1)
    return [m for m in host.log if isinstance(m, wire.WheelSpeed)][-1]


@pytest.mark.parametrize("rate_hz", [25_000, 40_000])
def test_both_wheels_lose_nothing_at_high_edge_rates(speed: Any, rate_hz: int) -> None:
    """Both at once, with telemetry and a PING every millisecond, as fast as the line takes them."""
    edges = 6000
    last = run_past(speed, turn(speed.board, (rate_hz, -rate_hz), edges), chatter=True)
    assert last.edge_counts == (edges, -edges)
    assert last.illegal_counts == (0, 0)
    assert speed.board.overruns() == 0
    assert sum(speed.decoder.rejects) == 0
    assert sum(isinstance(m, wire.Pong) for m in speed.log) > 60


def test_beyond_the_limit_every_lost_pair_of_edges_is_an_illegal_step(speed: Any) -> None:
    edges = 6000
    last = run_past(speed, turn(speed.board, (57_000, 50_300), edges), chatter=True)
    assert sum(last.illegal_counts) > 0
    turned = (edges, int(edges * 50_300 / 57_000))
    for sent, count, illegal in zip(turned, last.edge_counts, last.illegal_counts, strict=True):
        assert sent - count == 2 * illegal
    assert speed.board.resets == 0


def test_edge_interrupt_stays_within_its_budget(speed: Any) -> None:
    turned = 0
    for rate in (5000, -5000):
        speed.board.clear_statistics()
        end = turn(speed.board, (rate, rate), 400, (turned, turned))
        turned += 400 if rate > 0 else -400
        run_past(speed, end, chatter=False)
        for vector in (INT2, INT3, INT4, INT5):
            isr = speed.board.isr(vector)
            assert isr.count == 200
            assert isr.max_cycles <= ISR_BUDGET_CYCLES


def test_jump_over_a_state_is_counted_as_illegal_and_moves_no_count(speed: Any) -> None:
    board = speed.board
    for i in range(5):
        at = board.cycle + 1000 + i * 16_000
        board.pin("E4", (i + 1) & 1, at)
        board.pin("E5", (i + 1) & 1, at)
    last = run_past(speed, board.cycle + 5 * 16_000, chatter=False)
    assert last.illegal_counts == (5, 0)
    assert last.edge_counts == (0, 0)


def test_speed_is_right_on_the_pins_own_clock(speed: Any) -> None:
    rate_hz = 2400.0  # 10 revolutions a second of 60 teeth
    end = turn(speed.board, (rate_hz, -rate_hz / 2), 600)
    while speed.board.cycle < end - 20 * 16_000:
        speed.listen(10)
    last = [m for m in speed.log if isinstance(m, wire.WheelSpeed)][-1]
    radps = rate_hz / 240 * 6.283185
    assert last.speed_radps == pytest.approx((radps, -radps / 2), rel=2e-4)
    assert last.flags & 0b1111 == 0b1000  # neither stopped, the rear one backwards
