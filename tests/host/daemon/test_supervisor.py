"""The supervisor's table, row by row and as a whole."""

from __future__ import annotations

from dataclasses import fields
from itertools import product

import pytest

from tiger.daemon.supervisor import TABLE, Facts, Row, step
from tiger.record import DaemonState

NAMES = [field.name for field in fields(Facts)]
ALL_FACTS = [Facts(*values) for values in product((False, True), repeat=len(NAMES))]
D = DaemonState


@pytest.mark.parametrize(
    ("state", "facts", "expected"),
    [
        (D.DISCONNECTED, Facts(missing=True), D.DISCONNECTED),
        (D.DISCONNECTED, Facts(), D.HANDSHAKE),
        (D.HANDSHAKE, Facts(unknown=True), D.HANDSHAKE),
        (D.HANDSHAKE, Facts(missing=True), D.DISCONNECTED),
        (D.HANDSHAKE, Facts(), D.DISARMED),
        (D.DISARMED, Facts(), D.DISARMED),
        (D.DISARMED, Facts(armed=True), D.ARMED),
        (D.DISARMED, Facts(armed=True, disarm=True), D.DISARMED),
        (D.DISARMED, Facts(fault=True, armed=True), D.FAULT),
        (D.DISARMED, Facts(estop=True, fault=True), D.ESTOP),
        (D.DISARMED, Facts(missing=True), D.DISCONNECTED),
        (D.DISARMED, Facts(unknown=True), D.HANDSHAKE),
        (D.ARMED, Facts(armed=True), D.ARMED),
        (D.ARMED, Facts(armed=True, disarm=True), D.DISARMED),
        (D.ARMED, Facts(armed=True, missing=True), D.FAULT),
        (D.ARMED, Facts(armed=True, unknown=True), D.FAULT),
        (D.ARMED, Facts(armed=True, fault=True), D.FAULT),
        (D.ARMED, Facts(armed=True, estop=True), D.ESTOP),
        (D.ARMED, Facts(armed=False), D.FAULT),
        (D.FAULT, Facts(), D.FAULT),
        (D.FAULT, Facts(fault=True, clear=True), D.FAULT),
        (D.FAULT, Facts(clear=True), D.DISCONNECTED),
        (D.ESTOP, Facts(), D.ESTOP),
        (D.ESTOP, Facts(estop=True, clear=True), D.ESTOP),
        (D.ESTOP, Facts(clear=True), D.DISCONNECTED),
    ],
)
def test_each_row(state: DaemonState, facts: Facts, expected: DaemonState) -> None:
    assert step(state, facts)[0] is expected


def test_only_the_row_from_disarmed_lets_the_robot_move() -> None:
    entries = {(row.state, row.next_state) for row in TABLE if row.next_state is D.ARMED}
    assert entries == {(D.DISARMED, D.ARMED)}
    for facts in ALL_FACTS:
        after, _ = step(D.DISARMED, facts)
        trouble = facts.estop or facts.fault or facts.missing or facts.unknown or facts.disarm
        assert (after is D.ARMED) == (facts.armed and not trouble)


def test_armed_is_left_at_once_for_every_trouble() -> None:
    for facts in ALL_FACTS:
        calm = facts.armed and not (
            facts.estop or facts.fault or facts.missing or facts.unknown or facts.disarm
        )
        assert (step(D.ARMED, facts)[0] is D.ARMED) == calm


@pytest.mark.parametrize("state", [D.FAULT, D.ESTOP])
def test_what_is_latched_stays_without_clear(state: DaemonState) -> None:
    for facts in ALL_FACTS:
        if not facts.clear:
            assert step(state, facts)[0] in (D.FAULT, D.ESTOP)


def test_clearing_leads_back_to_the_start_and_never_to_armed() -> None:
    for state, facts in product((D.FAULT, D.ESTOP), ALL_FACTS):
        assert step(state, facts)[0] in (D.FAULT, D.ESTOP, D.DISCONNECTED)


def test_a_reason_is_given_exactly_when_the_state_changes() -> None:
    for state, facts in product(D, ALL_FACTS):
        after, reason = step(state, facts)
        assert (reason is not None) == (after is not state)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.state.name}-{row.next_state.name}-{row.reason}")
def test_every_row_is_reachable(row: Row) -> None:
    assert any(step(row.state, facts) == (row.next_state, row.reason) for facts in ALL_FACTS)
