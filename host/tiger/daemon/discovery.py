"""Finds our boards by HELLO among the ports that the config allows, and keeps their lines open.

No other port is ever touched. Two kinds of line have two baud rates, so a port that says nothing is tried
with the other one in turn. Who sits on which port is asked anew after each replug.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.daemon.connection import Connection
from tiger.protocol.link import Event, Link
from tiger.protocol.messages import BAUD, INSTANCES, LINK_BOARDS, BoardKind
from tiger.record import Problem, ProblemKind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.config.robot import PortsConfig
    from tiger.devices.ports import PortProvider
    from tiger.protocol.link import Session

LOOK_PERIOD_S = 0.5  # while a board is missing ...
LOOK_AGAIN_S = 2.0  # ... and when all are there
ANSWER_TIME_S = 2.5  # a Mega that was reset by the opening of its port needs two seconds to speak
GRACE_S = 6.0  # before a board is called missing
BAUDS = tuple(dict.fromkeys(BAUD[link] for link, boards in LINK_BOARDS.items() if link.endswith("_usb")))

Role = tuple[BoardKind, int]  # kind and instance


def role_name(role: Role) -> str:
    """How a person calls the board: its kind, with its side where there are two."""
    kind, instance = role
    sides = INSTANCES[kind]
    return kind.name.lower() + (f" ({sides[instance]})" if len(sides) > 1 else "")


class BoardPort:
    """One allowed port: its connection, and the link over it while it is open."""

    def __init__(self, ports: PortProvider, path: str, nonce: int) -> None:
        self.connection = Connection(ports, path, BAUDS[0])
        self.link: Link | None = None
        self.bauds_tried = 0
        self._nonce = nonce
        self._answer_due_s = 0.0

    def step(self, now_s: float) -> None:
        """Open it when due, and try another baud rate when nothing answers."""
        if self.connection.open_if_due(now_s):
            self.link = Link(self.connection.path, self.connection.baud, self._nonce + self.bauds_tried)
            self._answer_due_s = now_s + ANSWER_TIME_S
        if not self.connection.is_open:
            self.link = None
        elif self.link is not None and self.link.sessions[0].identity is not None:
            self.bauds_tried = 0
            self._answer_due_s = now_s + ANSWER_TIME_S
        elif now_s > self._answer_due_s:
            self.bauds_tried += 1
            self.connection.baud = BAUDS[self.bauds_tried % len(BAUDS)]
            self.connection.close()
            self.link = None

    def problem(self) -> Problem | None:
        """Why no board on this port can be used, or None."""
        if self.connection.problem is not None:
            return self.connection.problem
        if self.bauds_tried < len(BAUDS):
            return None
        return Problem(
            ProblemKind.NO_ANSWER,
            self.connection.path,
            "nothing here answers HELLO",
            "Flash the board if it is one of ours (make flash BOARD=... PORT=...); otherwise leave this port "
            "out of `boards` under [ports].",
        )


class Boards:
    """All board ports, and who sits where."""

    def __init__(
        self, ports: PortProvider, config: PortsConfig, needed: tuple[Role, ...], nonce: int, now_s: float
    ) -> None:
        self.ports: dict[str, BoardPort] = {}
        self.needed = needed
        self.roles: dict[Role, tuple[BoardPort, Session]] = {}
        self.duplicates: dict[Role, list[str]] = {}
        self.crew: tuple[Session, ...] = ()
        """Of the boards that the robot needs, those that are there and usable ..."""
        self.complete = False
        """... and whether that is each of them, once."""
        self._provider = ports
        self._config = config
        self._nonce = nonce
        self._look_s = now_s
        self._grace_until_s = now_s + GRACE_S

    def step(self, now_s: float) -> None:
        """Look for new ports, open what is due, and see who is where."""
        if now_s >= self._look_s:
            self._look_s = now_s + (LOOK_AGAIN_S if self.complete else LOOK_PERIOD_S)
            self._look()
        for port in self.ports.values():
            port.step(now_s)
        self._assign()

    def _look(self) -> None:
        present = self._provider.present(self._config.boards)
        drives = (self._config.roboteq_left, self._config.roboteq_right)
        allowed = [p for p in present if not any(self._provider.same(p, drive) for drive in drives)]
        for path in allowed:
            if path not in self.ports:
                self.ports[path] = BoardPort(self._provider, path, self._nonce)
        for path in [p for p, port in self.ports.items() if p not in allowed and not port.connection.is_open]:
            del self.ports[path]

    def _assign(self) -> None:
        found: dict[Role, list[tuple[BoardPort, Session]]] = {}
        for port in self.ports.values():
            for session in port.link.sessions.values() if port.link else ():
                kind, identity = session.kind, session.identity
                if session.usable and kind is not None and identity is not None:
                    found.setdefault((kind, identity.instance), []).append((port, session))
        self.roles = {role: places[0] for role, places in found.items() if len(places) == 1}
        self.duplicates = {
            role: [port.connection.path for port, _ in places]
            for role, places in found.items()
            if len(places) > 1
        }
        self.crew = tuple(self.roles[role][1] for role in self.needed if role in self.roles)
        self.complete = not self.duplicates and len(self.crew) == len(self.needed)

    def receive(self, now_s: float) -> Iterator[Event]:
        """Read every port; yields what arrived."""
        for port in self.ports.values():
            if port.link is not None and (data := port.connection.read(now_s)):
                yield from port.link.feed(data, now_s)

    def poll(self, now_s: float) -> Iterator[Event]:
        """Yields who fell silent."""
        for port in self.ports.values():
            if port.link is not None:
                yield from port.link.poll(now_s)

    def send(self, now_s: float) -> None:
        """Write what is due on every port that has room."""
        for port in self.ports.values():
            if port.link is not None:
                data = port.link.outgoing(now_s) if port.connection.has_room else b""
                port.connection.write(data, now_s)

    def session(self, role: Role) -> Session | None:
        """The session of the board in a role; None unless it is there and usable."""
        place = self.roles.get(role)
        return place[1] if place else None

    def link(self, role: Role) -> Link | None:
        """The link to the board in a role."""
        place = self.roles.get(role)
        return place[0].link if place else None

    def problems(self, now_s: float) -> list[Problem]:
        """Everything that is wrong with boards and their ports; nothing while all needed ones work."""
        problems = [_duplicate(role, paths) for role, paths in self.duplicates.items()]
        problems += [
            session.problem
            for port in self.ports.values()
            if port.link
            for session in port.link.sessions.values()
            if session.problem
        ]
        missing = [role for role in self.needed if role not in self.roles and role not in self.duplicates]
        if missing:
            problems += [problem for port in self.ports.values() if (problem := port.problem())]
        if missing and now_s >= self._grace_until_s:
            problems += [self._missing(role) for role in missing]
        return problems

    def _missing(self, role: Role) -> Problem:
        where = ", ".join(self.ports) or f"{' '.join(self._config.boards)} (no such device is there)"
        if role[0] is BoardKind.NANO_IMU:
            text = "does not answer through mega_suspension"
            step = "Check the Nano's power and its two wires to the Mega's Serial1."
            return Problem(ProblemKind.MISSING, role_name(role), text, step)
        return Problem(
            ProblemKind.MISSING,
            role_name(role),
            f"was not found on {where}",
            "Connect it, or add its port to `boards` under [ports].",
        )


def _duplicate(role: Role, paths: list[str]) -> Problem:
    step = (
        "Set the strap pin of the one on the other side (README, wiring)."
        if len(INSTANCES[role[0]]) > 1
        else "Unplug one of them."
    )
    return Problem(ProblemKind.DUPLICATE, role_name(role), f"is there twice: {' and '.join(paths)}", step)
