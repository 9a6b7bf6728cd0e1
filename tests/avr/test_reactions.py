"""The reaction times of the architecture, on the real image: what the pins do and when."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

CYCLES_PER_MS = 16_000
PWM_PINS = ("B5", "B6", "E3", "E4")
MOVING = (3.0, -3.0, 3.0, -3.0)


@pytest.fixture
def driving(armed: Any) -> tuple[Any, list[int]]:
    """A mega_suspension whose four motors run, and the watches of their pins."""
    watches = [armed.board.watch(pin) for pin in PWM_PINS]
    armed.command(MOVING, 100)
    assert all(armed.board.watched(watch).rises > 1000 for watch in watches)
    return armed, watches


def last_activity_ms(host: Any, watches: list[int], since: int) -> float:
    """Time from cycle `since` to the last edge on any motor pin, all of which must be low now."""
    pins = [host.board.watched(watch) for watch in watches]
    assert all(pin.level == 0 for pin in pins)
    return float(max(pin.last_change - since for pin in pins) / CYCLES_PER_MS)


def test_silent_host_stops_the_motion_within_100_ms_and_the_outputs_within_300(
    driving: tuple[Any, list[int]],
) -> None:
    host, watches = driving
    strokes_mm = host.world.__self__.stroke_mm
    silent_since = host.board.cycle
    host.listen(100)
    held_mm = list(strokes_mm)
    heard = host.listen(300)
    assert strokes_mm == pytest.approx(held_mm, abs=0.15)  # it holds where it was, then stays
    assert last_activity_ms(host, watches, silent_since) < 300
    assert [m for m in heard if isinstance(m, wire.SuspensionState)][-1].state == wire.BoardState.FAULT
    assert host.health().faults >> wire.Fault.LINK_LOST & 1
    host.command(MOVING, 60)  # a host that comes back does not move it
    assert last_activity_ms(host, watches, silent_since) < 300


def test_estop_input_switches_everything_off_within_20_ms(driving: tuple[Any, list[int]]) -> None:
    host, watches = driving
    pressed_at = host.board.cycle
    host.board.pin("E5", 1)
    heard = host.command(MOVING, 60)
    assert last_activity_ms(host, watches, pressed_at) < 20
    assert [m for m in heard if isinstance(m, wire.SuspensionState)][-1].state == wire.BoardState.ESTOP
    host.board.pin("E5", 0)  # released: nothing moves until the faults are cleared and it is armed again
    host.command(MOVING, 60)
    assert last_activity_ms(host, watches, pressed_at) < 20


def test_hung_program_loses_its_outputs_at_the_watchdog_interrupt(driving: tuple[Any, list[int]]) -> None:
    host, watches = driving
    host.board.hang()
    hung_at = host.board.cycle
    host.listen(150)
    assert last_activity_ms(host, watches, hung_at) <= 33
    assert host.board.resets == 1
    assert (host.board.last_reset - hung_at) / CYCLES_PER_MS <= 64
    who = host.hello()
    assert who.reset_cause == 8
    assert who.last_fault == wire.Fault.WATCHDOG
    assert host.arm().status == wire.AckStatus.FAULTED
    host.command(MOVING, 60)
    assert last_activity_ms(host, watches, hung_at) <= 33


def test_hang_with_interrupts_off_resets_at_the_second_time_out(driving: tuple[Any, list[int]]) -> None:
    host, watches = driving
    host.board.hang(interrupts_off=True)
    hung_at = host.board.cycle
    host.listen(150)
    assert host.board.resets == 1
    reset_after_ms = (host.board.last_reset - hung_at) / CYCLES_PER_MS
    assert 32 < reset_after_ms <= 65
    assert last_activity_ms(host, watches, hung_at) <= 65
    who = host.hello()
    assert who.reset_cause == 8
    assert who.last_fault == wire.Fault.WATCHDOG
    assert host.arm().status == wire.AckStatus.FAULTED


@pytest.mark.parametrize("interrupts_off", [False, True])
def test_speed_board_recovers_from_a_hang_and_says_so(speed: Any, interrupts_off: bool) -> None:
    speed.board.hang(interrupts_off=interrupts_off)
    speed.listen(150)
    assert speed.board.resets == 1
    who = speed.hello()
    assert (who.reset_cause, who.last_fault) == (8, wire.Fault.WATCHDOG)
    assert speed.ask(wire.ClearFaults(0), wire.Ack).status == wire.AckStatus.OK
    assert speed.arm().status == wire.AckStatus.OK


def test_nano_recovers_from_a_hang_and_says_so(pair: Any) -> None:
    pair.listen(900)
    nano = pair.boards[1]
    nano.hang()
    pair.listen(200)
    assert nano.resets == 1
    who = pair.hello(node=1)
    assert (who.reset_cause, who.last_fault) == (8, wire.Fault.WATCHDOG)


def test_reset_button_is_told_from_power_on_and_keeps_no_fault(speed: Any) -> None:
    assert speed.hello().reset_cause == 1
    speed.board.reset()
    speed.listen(50)
    who = speed.hello()
    assert (who.reset_cause, who.last_fault) == (2, 0)


def test_motor_pins_stay_low_through_power_on(make_board: Callable[[str], Any]) -> None:
    board = make_board("mega_suspension")
    watches = [board.watch(pin) for pin in PWM_PINS]
    board.run_ms(500)
    assert all(board.watched(watch).rises == 0 for watch in watches)
