"""The two-wire master of the real Nano image: speed, stretched clocks, a hung bus."""

from __future__ import annotations

from typing import Any

import pytest

from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

ABSENT, BUS_HUNG = 1, 2
TWI = 24
ISR_BUDGET_CYCLES = 130


@pytest.fixture
def measuring(pair: Any) -> Any:
    """A pair whose Nano has begun to read its sensor."""
    for _ in range(15):
        if any(m.flags >> wire.ImuFlag.GYRO_OK & 1 for m in attitudes(pair.listen(100))):
            return pair
    raise AssertionError("no attitude came within 1.5 s")


def attitudes(messages: list[wire.Message]) -> list[wire.ImuAttitude]:
    return [m for m in messages if isinstance(m, wire.ImuAttitude)]


def stale(message: wire.ImuAttitude) -> bool:
    return bool(message.flags >> wire.ImuFlag.STALE & 1)


def test_interrupt_takes_a_byte_within_its_budget(measuring: Any) -> None:
    nano = measuring.boards[1]
    nano.clear_statistics()
    measuring.listen(200)
    isr = nano.isr(TWI)
    assert 20 * 20 < isr.count < 30 * 20  # 18 bytes, addresses and starts, 100 times a second
    assert isr.max_cycles <= ISR_BUDGET_CYCLES


def test_stretched_clock_delays_a_sample_and_loses_none(measuring: Any) -> None:
    measuring.boards[1].set_stretch(1.0, 3000)
    heard = attitudes(measuring.listen(300))
    assert len(heard) >= 28
    assert not any(stale(m) for m in heard)
    assert measuring.boards[1].resets == 0


def test_hung_bus_is_freed_by_nine_clocks(measuring: Any) -> None:
    nano = measuring.boards[1]
    before = nano.bus_clocks
    nano.set_sensor_faults(BUS_HUNG)
    measuring.listen(300)
    assert nano.bus_clocks - before >= 9
    heard = attitudes(measuring.listen(200))
    assert len(heard) >= 18
    assert not stale(heard[-1])


def test_absent_sensor_is_reported_within_30_ms_and_nothing_hangs(measuring: Any) -> None:
    nano = measuring.boards[1]
    nano.set_sensor_faults(ABSENT)
    heard = measuring.listen(30) + measuring.listen(20)
    assert any(stale(m) or not m.flags >> wire.ImuFlag.GYRO_OK & 1 for m in attitudes(heard))
    assert measuring.health(node=1).faults >> wire.Fault.IMU_ABSENT & 1
    assert nano.resets == 0
