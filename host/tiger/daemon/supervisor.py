"""What the robot may do: a table of states. Pure; `daemon.py` finds the facts and carries out the states.

Rows are tried from the top; the first whose condition holds gives the next state. Nothing but the row from
DISARMED to ARMED ever lets the robot move, and it needs devices that report themselves armed. FAULT and ESTOP
are left only by `clear`, and only when their cause is gone; then everything is looked at anew, from
DISCONNECTED up.
"""

from __future__ import annotations

from collections.abc import Callable

from tiger.frozen import dataclass
from tiger.record import DaemonState


@dataclass(frozen=True, slots=True)
class Facts:
    """What the table looks at."""

    missing: bool = False  # a device that the robot needs is not there
    unknown: bool = False  # a device has not introduced itself, or is not the right one
    estop: bool = False  # an emergency stop is pressed or latched somewhere
    fault: bool = False  # a device latched a fault, or a limit is exceeded while armed
    armed: bool = False  # every device that moves something reports that it is armed
    disarm: bool = False  # the user wants it disarmed
    clear: bool = False  # the user wants faults cleared


@dataclass(frozen=True, slots=True)
class Row:
    """From `state` to `next_state` when `condition` holds, for a `reason`."""

    state: DaemonState
    condition: Callable[[Facts], bool]
    next_state: DaemonState
    reason: str


TABLE = (
    Row(DaemonState.DISCONNECTED, lambda f: not f.missing, DaemonState.HANDSHAKE, "every port is open"),
    Row(DaemonState.HANDSHAKE, lambda f: f.missing, DaemonState.DISCONNECTED, "a device is missing"),
    Row(DaemonState.HANDSHAKE, lambda f: not f.unknown, DaemonState.DISARMED, "every device is known"),
    Row(DaemonState.DISARMED, lambda f: f.estop, DaemonState.ESTOP, "emergency stop"),
    Row(DaemonState.DISARMED, lambda f: f.fault, DaemonState.FAULT, "a fault"),
    Row(DaemonState.DISARMED, lambda f: f.missing, DaemonState.DISCONNECTED, "a device went missing"),
    Row(DaemonState.DISARMED, lambda f: f.unknown, DaemonState.HANDSHAKE, "a device must introduce itself"),
    Row(DaemonState.DISARMED, lambda f: f.armed and not f.disarm, DaemonState.ARMED, "armed"),
    Row(DaemonState.ARMED, lambda f: f.estop, DaemonState.ESTOP, "emergency stop"),
    Row(DaemonState.ARMED, lambda f: f.fault, DaemonState.FAULT, "a fault while armed"),
    Row(DaemonState.ARMED, lambda f: f.missing, DaemonState.FAULT, "a device was lost while armed"),
    Row(DaemonState.ARMED, lambda f: f.unknown, DaemonState.FAULT, "a device stopped answering while armed"),
    Row(DaemonState.ARMED, lambda f: f.disarm, DaemonState.DISARMED, "disarmed"),
    Row(DaemonState.ARMED, lambda f: not f.armed, DaemonState.FAULT, "a device disarmed by itself"),
    Row(DaemonState.FAULT, lambda f: f.estop, DaemonState.ESTOP, "emergency stop"),
    Row(DaemonState.FAULT, lambda f: f.clear and not f.fault, DaemonState.DISCONNECTED, "cleared"),
    Row(DaemonState.ESTOP, lambda f: f.clear and not f.estop, DaemonState.DISCONNECTED, "cleared"),
)
_ROWS = {state: tuple(row for row in TABLE if row.state is state) for state in DaemonState}


def step(state: DaemonState, facts: Facts) -> tuple[DaemonState, str | None]:
    """The next state, and why it changed; None when it did not."""
    for row in _ROWS[state]:
        if row.condition(facts):
            return row.next_state, row.reason
    return state, None
