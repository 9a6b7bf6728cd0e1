"""What outlives a reset, on the real EEPROM and .noinit."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

TEETH_INDEX = 0
STORE = 16  # first byte of the parameters; the identity is before it
SLOT_BYTES = 16  # of mega_speed's two parameters
SAVE_MS = 150


def set_and_save(speed: Any, teeth: int) -> None:
    assert speed.ask(wire.ParamSet(0, TEETH_INDEX, teeth), wire.Ack).status == wire.AckStatus.OK
    assert speed.ask(wire.ParamSave(0), wire.Ack).status == wire.AckStatus.OK


def teeth_after_power_cycle(speed: Any) -> int:
    speed.board.reset(power_on=True)
    speed.listen(60)
    return int(speed.ask(wire.ParamGet(0, TEETH_INDEX), wire.Ack).value)


def test_saved_parameters_and_identity_outlive_the_loss_of_power(speed: Any) -> None:
    uid = speed.hello().board_uid
    assert uid != 0xFFFFFFFF
    set_and_save(speed, 48)
    speed.listen(SAVE_MS)
    assert teeth_after_power_cycle(speed) == 48
    who = speed.hello()
    assert who.board_uid == uid
    assert who.boot_count == 1
    assert who.reset_cause == 1


def test_unsaved_parameters_are_gone_after_a_reset(speed: Any) -> None:
    speed.ask(wire.ParamSet(0, TEETH_INDEX, 48), wire.Ack)
    assert teeth_after_power_cycle(speed) == 60


@pytest.mark.parametrize("off_after_ms", [3, 20, 40])
def test_power_lost_while_saving_leaves_the_copy_before(speed: Any, off_after_ms: float) -> None:
    set_and_save(speed, 48)
    speed.listen(SAVE_MS)
    speed.say(wire.ParamSet(0, TEETH_INDEX, 72))
    speed.say(wire.ParamSave(0))
    speed.listen(off_after_ms)
    assert teeth_after_power_cycle(speed) == 48
    assert speed.health().faults == 0


def test_damaged_store_gives_defaults_and_says_so(speed: Any) -> None:
    set_and_save(speed, 48)
    speed.listen(SAVE_MS)
    for slot in (0, 1):
        speed.board.write_eeprom(STORE + slot * SLOT_BYTES + 5, b"\x13")
    assert teeth_after_power_cycle(speed) == 60
    assert speed.health().faults == 1 << wire.Fault.PARAMETERS
    assert speed.arm().status == wire.AckStatus.FAULTED
    set_and_save(speed, 48)
    speed.listen(SAVE_MS)
    assert speed.ask(wire.ClearFaults(0), wire.Ack).status == wire.AckStatus.OK
    assert speed.arm().status == wire.AckStatus.OK


def test_eeprom_is_written_without_missing_a_beat(speed: Any) -> None:
    speed.say(wire.ParamSet(0, TEETH_INDEX, 48))
    speed.say(wire.ParamSave(0))
    messages = [m for m in speed.listen(300) if isinstance(m, wire.WheelSpeed)]
    gaps = [b.t_us - a.t_us for a, b in itertools.pairwise(messages)]
    assert max(gaps) < 12_000
    assert speed.health().overruns == 0


def test_random_ram_at_power_on_is_not_taken_for_a_fault(
    simulated: ModuleType, make_board: Callable[[str], Any]
) -> None:
    for name in ("mega_suspension", "mega_speed"):
        host = simulated.Host([make_board(name)], (simulated.KIND[name],))
        host.listen(50)
        assert host.hello().last_fault == 0
        assert host.health().faults == 0


def test_clock_wrap_disturbs_nothing(speed: Any, simulated: ModuleType) -> None:
    """The microseconds wrap after 71 minutes: the counter of overflows is moved there in hops."""
    overflows = simulated.address_of("mega_speed", "board_clock")
    for to_us in (2**31 - 10_000_000, 2**31 + 2**30, 2**32 - 400_000):
        for i in range(4):
            speed.board.poke(overflows + i, (to_us >> 15) >> (8 * i) & 0xFF)
        speed.listen(20)
    messages = [m for m in speed.listen(700) if isinstance(m, wire.WheelSpeed)]
    stamps = [m.t_us for m in messages]
    assert stamps[0] > 2**31 > stamps[-1]
    steps = [(b - a) % 2**32 for a, b in itertools.pairwise(stamps)]
    assert all(9_000 < step < 11_000 for step in steps)
    who = speed.hello()
    assert speed.board.resets == 0
    assert who.uptime_ms == pytest.approx((2**32 + stamps[-1]) / 1000, abs=40)
