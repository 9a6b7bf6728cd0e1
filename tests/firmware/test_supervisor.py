"""The table of states, row by row, as a board shows it on its wire."""

from __future__ import annotations

import pytest

from tiger.protocol.messages import SCHEMA_HASH, AckStatus, Arm, BoardKind, BoardState, Estop, Fault

HASH = SCHEMA_HASH[BoardKind.MEGA_SUSPENSION]
S = BoardState


def reach(rig, state):
    """Bring a booted board into a state."""
    if state == S.DISARMED:
        return
    if state == S.FAULT:
        reach(rig, S.ARMED)
        rig.rates_mmps = None
        rig.run_ms(400)
    elif state == S.ESTOP:
        rig.request(Estop(0))
    else:
        rig.arm()
        if state == S.HOLDING:
            rig.rates_mmps = None
            rig.run_ms(90)
    rig.run_ms(11)
    assert rig.state.state == state


def arm(rig):
    rig.request(Arm(0, HASH, rig.hello().session))


def silence(rig):
    rig.rates_mmps = None
    rig.run_ms(85)


def speak(rig):
    rig.rates_mmps = (0.0,) * 4
    rig.run_ms(15)


def press_estop(rig):
    rig.estop = True
    rig.run_ms(10)


def cut_pot(rig):
    rig.read_pot = lambda corner, counts: 1023.0 if corner == 2 else counts
    rig.run_ms(60)


# state before, what happens, state after
TABLE = [
    (S.DISARMED, arm, S.ARMED),
    (S.DISARMED, lambda rig: rig.disarm(), S.DISARMED),
    (S.DISARMED, speak, S.DISARMED),
    (S.DISARMED, silence, S.DISARMED),
    (S.DISARMED, cut_pot, S.FAULT),
    (S.DISARMED, press_estop, S.ESTOP),
    (S.ARMED, arm, S.ARMED),
    (S.ARMED, lambda rig: rig.disarm(), S.DISARMED),
    (S.ARMED, silence, S.HOLDING),
    (S.ARMED, cut_pot, S.FAULT),
    (S.ARMED, press_estop, S.ESTOP),
    (S.ARMED, lambda rig: rig.clear_faults(), S.ARMED),
    (S.HOLDING, speak, S.ARMED),
    (S.HOLDING, lambda rig: rig.disarm(), S.DISARMED),
    (S.HOLDING, cut_pot, S.FAULT),
    (S.HOLDING, press_estop, S.ESTOP),
    (S.FAULT, arm, S.FAULT),
    (S.FAULT, speak, S.FAULT),
    (S.FAULT, lambda rig: rig.clear_faults(), S.FAULT),  # LINK_LOST is cleared by DISARM
    (S.FAULT, lambda rig: rig.disarm(), S.DISARMED),
    (S.FAULT, press_estop, S.ESTOP),
    (S.ESTOP, arm, S.ESTOP),
    (S.ESTOP, speak, S.ESTOP),
    (S.ESTOP, lambda rig: rig.disarm(), S.ESTOP),
    (S.ESTOP, cut_pot, S.ESTOP),
    (S.ESTOP, lambda rig: rig.clear_faults(), S.DISARMED),
]


@pytest.mark.parametrize(
    ("before", "event", "after"),
    TABLE,
    ids=[f"{before.name}-{n}-{after.name}" for n, (before, _, after) in enumerate(TABLE)],
)
def test_state_table(rig, before, event, after):
    reach(rig, before)
    event(rig)
    rig.run_ms(10)
    assert rig.state.state == after


def test_clearing_an_estop_leaves_the_other_faults(rig):
    cut_pot(rig)
    press_estop(rig)
    assert rig.faults() == {Fault.POT_OPEN, Fault.ESTOP}
    rig.estop = False
    rig.run_ms(10)
    assert rig.clear_faults().status == AckStatus.STILL_PRESENT
    assert rig.faults() == {Fault.POT_OPEN}
    assert rig.state.state == S.FAULT


def test_a_fault_names_where_it_was_seen(rig):
    cut_pot(rig)
    assert rig.health().fault_detail == 2


def test_a_fault_keeps_the_place_where_it_was_seen_first(rig):
    cut_pot(rig)
    rig.read_pot = lambda corner, counts: 1023.0 if corner in (2, 3) else counts
    rig.run_ms(60)
    assert rig.faults() == {Fault.POT_OPEN}
    assert rig.health().fault_detail == 2


def test_clearing_another_fault_leaves_a_pressed_estop_as_it_is(rig):
    cut_pot(rig)
    press_estop(rig)
    rig.read_pot = lambda corner, counts: counts
    rig.run_ms(300)
    assert rig.clear_faults().status == AckStatus.STILL_PRESENT
    assert rig.faults() == {Fault.ESTOP}
    assert rig.state.state == S.ESTOP
