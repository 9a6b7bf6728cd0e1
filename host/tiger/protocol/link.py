"""One serial line and the boards behind it, without a port and without a clock.

Bytes from the port go into `feed`, bytes for the port come out of `outgoing`, time is an argument everywhere.
A line carries one session per board: node 0 is the board on the wire, node 1 the Nano behind mega_suspension.
A session says HELLO until its board answers, checks who answered, follows its clock, counts what got lost,
and notices a reset. Config messages are stop-and-wait; a setpoint waits in a slot where the newest wins.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import field
from enum import Enum

from tiger.frozen import dataclass
from tiger.protocol.clock_sync import ClockSync
from tiger.protocol.frame import OVERHEAD_BYTES, FrameDecoder, encode_message
from tiger.protocol.messages import (
    BAUD,
    FROM_BOARD,
    INSTANCES,
    LINK_BOARDS,
    NODE,
    PROTO,
    SCHEMA_HASH,
    Ack,
    AckStatus,
    BoardKind,
    Disarm,
    Health,
    Hello,
    HelloReply,
    Message,
    Ping,
    Pong,
    node_of,
)
from tiger.record import Problem, ProblemKind

HELLO_PERIOD_S = 0.25
SILENT_AFTER_S = 0.5  # five HEALTH messages
PING_BURST = 8
PING_BURST_PERIOD_S = 0.03
PING_PERIOD_S = 0.98  # not a multiple of any board's period
ACK_TIMEOUT_S = 0.025  # and the time on the wire
CONFIG_TRIES = 5
BITS_PER_BYTE = 10

_KINDS = {kind.value: kind for kind in BoardKind}
_STATUSES = {status.value: status for status in AckStatus}


class Outcome(Enum):
    """What became of a config message."""

    WAITING = "waiting"
    ANSWERED = "answered"
    GIVEN_UP = "given up"


@dataclass(slots=True, eq=False)
class Request:
    """A config message on its way; look at `outcome`, then at `status` and `value`."""

    node: int
    message: Message
    outcome: Outcome = Outcome.WAITING
    status: AckStatus | None = None
    value: int = 0
    tries: int = 0
    _frame: bytes = b""
    _seq: int = 0
    _deadline_s: float = math.inf
    _timeout_s: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the board did what was asked."""
        return self.status is AckStatus.OK


@dataclass(frozen=True, slots=True)
class Identified:
    """A board introduced itself; `session.problem` says whether it may be used."""

    session: Session


@dataclass(frozen=True, slots=True)
class Rebooted:
    """A known board was reset or exchanged: whatever it was told is forgotten."""

    session: Session
    reply: HelloReply


@dataclass(frozen=True, slots=True)
class Lost:
    """A board fell silent."""

    session: Session


@dataclass(frozen=True, slots=True)
class Telemetry:
    """A message of an identified board; `t_s` is the host time of its sample, else of its arrival."""

    session: Session
    message: Message
    t_s: float


Event = Identified | Rebooted | Lost | Telemetry


@dataclass(slots=True, eq=False)
class Session:
    """What the host knows of one board behind a line."""

    port: str
    node: int
    expected: BoardKind | None = None  # None: whatever answers
    identity: HelloReply | None = None
    problem: Problem | None = None
    health: Health | None = None
    clock: ClockSync = field(default_factory=ClockSync)
    frames: int = 0
    seq_gaps: int = 0
    last_rx_s: float = -math.inf
    wire_up_s: float = 0.0  # PING from its first byte to the board
    wire_down_s: float = 0.0  # PONG back
    _last_seq: int | None = None
    _hello_due_s: float = 0.0
    _ping_due_s: float = math.inf
    _pings_left: int = 0
    _pings: dict[int, float] = field(default_factory=dict)

    @property
    def kind(self) -> BoardKind | None:
        """What the board says it is; None before it answered or when the host does not know that kind."""
        return None if self.identity is None else _KINDS.get(self.identity.board_kind)

    @property
    def name(self) -> str:
        """How a person calls the board: its kind, with its side where there are two."""
        if self.kind is None:
            return f"{self.expected.name.lower() if self.expected else 'board'} on {self.port}"
        sides = INSTANCES[self.kind]
        if len(sides) == 1 or self.identity is None or self.identity.instance >= len(sides):
            return self.kind.name.lower()
        return f"{self.kind.name.lower()} ({sides[self.identity.instance]})"

    @property
    def usable(self) -> bool:
        """Whether the board answered and passed every check."""
        return self.identity is not None and self.problem is None

    @property
    def round_trip_s(self) -> float:
        """Shortest PING to PONG beyond the time on the wire; infinity before the first."""
        return self.clock.best_round_trip_s

    def say_hello(self) -> None:
        """Ask the board again who it is; its answer brings the session that ARM must carry."""
        self._hello_due_s = -math.inf

    def _forget(self) -> None:
        self.identity = self.problem = self.health = None
        self.clock.reset()
        self._last_seq = None
        self._ping_due_s = math.inf
        self._pings.clear()
        self.say_hello()

    def _count(self, seq: int, now_s: float) -> None:
        """Count a frame, and those missing before it: from the introduction on, for none was owed earlier."""
        self.frames += 1
        self.last_rx_s = now_s
        if self._last_seq is not None:
            self.seq_gaps += (seq - self._last_seq - 1) & 0xFF
        if self.identity is not None:
            self._last_seq = seq

    def _start_pings(self) -> None:
        self._ping_due_s = -math.inf
        self._pings_left = PING_BURST


def check_identity(reply: HelloReply, port: str, expected: BoardKind | None) -> Problem | None:
    """What is wrong with the board that answered, or None."""
    kind = _KINDS.get(reply.board_kind)
    name = kind.name.lower() if kind else f"board of unknown kind {reply.board_kind}"
    where = f"{name} on {port}"
    if reply.proto != PROTO:
        return Problem(
            ProblemKind.PROTOCOL,
            where,
            f"speaks version {reply.proto} of the protocol, this program version {PROTO}",
            _flash(kind, port),
        )
    if kind is None or (expected is not None and kind is not expected):
        wanted = expected.name.lower() if expected else " or ".join(k.name.lower() for k in BoardKind)
        return Problem(
            ProblemKind.WRONG_BOARD,
            where,
            f"is not the {wanted} that belongs there",
            f"Put the right board there, or flash it: make flash BOARD={wanted.split(' ')[0]} PORT={port}",
        )
    if reply.schema_hash != SCHEMA_HASH[kind]:
        return Problem(
            ProblemKind.SCHEMA,
            where,
            f"was built from another description of the wire (schema {reply.schema_hash:#010x}, this program "
            f"has {SCHEMA_HASH[kind]:#010x})",
            _flash(kind, port),
        )
    if reply.instance >= len(INSTANCES[kind]):
        return Problem(
            ProblemKind.WRONG_BOARD,
            where,
            f"says it is number {reply.instance} of its kind; there are {len(INSTANCES[kind])}",
            "Check its strap pin.",
        )
    return None


def _flash(kind: BoardKind | None, port: str) -> str:
    board = kind.name.lower() if kind else "NAME"
    if kind is BoardKind.NANO_IMU:
        return f"Flash it through its own USB port: make flash BOARD={board} PORT=..."
    return f"Flash it: make flash BOARD={board} PORT={port}"


class Link:
    """One line; see the module's text."""

    def __init__(self, port: str, baud: int, nonce: int) -> None:
        """`port` is the name for messages; `nonce` tells this run's answers from those to an earlier one."""
        self.port = port
        self.baud = baud
        self.decoder = FrameDecoder(_COMMON)
        self.sessions: dict[int, Session] = {}
        self._add_session(0, None)
        self._nonce = nonce & 0xFFFF or 1
        self._seq = nonce & 0xFF
        self._requests: deque[Request] = deque()
        self._setpoint: Message | None = None

    @property
    def kind(self) -> BoardKind | None:
        """Kind of the board on the wire, once it answered."""
        return self.sessions[0].kind

    def session(self, kind: BoardKind) -> Session | None:
        """The session of a board of `kind` behind this line."""
        return next((session for session in self.sessions.values() if session.kind is kind), None)

    # ---------------------------------------------------------------------------------------------- receiving

    def feed(self, data: bytes, now_s: float) -> list[Event]:
        """Take bytes that arrived by `now_s`; returns what they mean, in order."""
        events: list[Event] = []
        for seq, message in self.decoder.each(data):
            session = self.sessions.get(node_of(message))
            if session is None:
                continue
            if isinstance(message, HelloReply):
                events += self._introduced(session, message)
                session._count(seq, now_s)
                continue
            session._count(seq, now_s)
            if isinstance(message, Pong):
                self._pong(session, message, now_s)
            elif isinstance(message, Ack):
                self._ack(session, message)
            elif session.usable:
                if isinstance(message, Health):
                    session.health = message
                events.append(Telemetry(session, message, self._sample_time(session, message, now_s)))
        return events

    def _sample_time(self, session: Session, message: Message, now_s: float) -> float:
        t_us = getattr(message, "t_us", None)
        if t_us is None or not session.clock.ready:
            return now_s
        return min(session.clock.to_host(t_us), now_s)

    def _introduced(self, session: Session, reply: HelloReply) -> list[Event]:
        before, session.identity = session.identity, reply
        if reply.host_nonce == self._nonce:
            session._hello_due_s = math.inf
        if before is not None and not _was_reset(before, reply):
            return []
        session.problem = check_identity(reply, self.port, session.expected)
        session._hello_due_s = math.inf
        session.health = None
        session.clock.reset()
        session._last_seq = None
        session._start_pings()
        if session.node == 0 and session.problem is None:
            self._extend(BoardKind(reply.board_kind))
        return [Identified(session)] if before is None else [Rebooted(session, reply), Identified(session)]

    def _extend(self, kind: BoardKind) -> None:
        """The board on the wire is known: listen to all boards of its line, and introduce those behind it."""
        boards = next(boards for boards in LINK_BOARDS.values() if boards[0] is kind)
        for board in boards:
            self.decoder.known.update(FROM_BOARD[board])
            if NODE[board] not in self.sessions:
                self._add_session(NODE[board], board)

    def _add_session(self, node: int, expected: BoardKind | None) -> None:
        session = Session(self.port, node, expected)
        session.wire_up_s = self._wire_s(Ping, node)
        session.wire_down_s = self._wire_s(Pong, node)
        self.sessions[node] = session

    def _wire_s(self, message: type[Message], node: int) -> float:
        """How long a message is under way, the second line to a board behind another one included."""
        bits = (message.SIZE + OVERHEAD_BYTES) * BITS_PER_BYTE
        return bits / self.baud + (bits / BAUD["nano_serial"] if node else 0.0)

    def _pong(self, session: Session, pong: Pong, now_s: float) -> None:
        sent_s = session._pings.pop(pong.host_us, None)
        if sent_s is not None:
            up_s, down_s = session.wire_up_s, session.wire_down_s
            session.clock.add(sent_s, now_s, pong.rx_us, pong.tx_us, up_s, down_s)

    def _ack(self, session: Session, ack: Ack) -> None:
        request = self._requests[0] if self._requests else None
        if request is None or not request.tries:
            return
        if (request.node, request.message.ID, request._seq) != (session.node, ack.id, ack.seq):
            return
        request.outcome = Outcome.ANSWERED
        request.status = _STATUSES.get(ack.status)
        request.value = ack.value
        self._requests.popleft()
        if isinstance(request.message, Disarm) or request.status is AckStatus.BAD_SESSION:
            session.say_hello()

    # ------------------------------------------------------------------------------------------------ sending

    def request(self, message: Message, urgent: bool = False) -> Request:
        """Queue a config message; an urgent one goes before all others, one under way included."""
        request = Request(node_of(message), message)
        if urgent:
            for waiting in self._requests:
                waiting.outcome = Outcome.GIVEN_UP
            self._requests.clear()
        self._requests.append(request)
        return request

    def setpoint(self, message: Message) -> None:
        """Put a setpoint into its slot; one that was not sent yet is forgotten."""
        self._setpoint = message

    def poll(self, now_s: float) -> list[Event]:
        """Let time pass: notice boards that fell silent."""
        events: list[Event] = []
        for session in self.sessions.values():
            if session.identity is not None and now_s - session.last_rx_s > SILENT_AFTER_S:
                events.append(Lost(session))
                session._forget()
        return events

    def outgoing(self, now_s: float) -> bytes:
        """The frames that are due; call it only when the port has room for them."""
        frames: list[bytes] = []
        if self._setpoint is not None:
            frames.append(self._framed(self._setpoint))
            self._setpoint = None
        self._send_request(frames, now_s)
        for session in self.sessions.values():
            if now_s >= session._hello_due_s and self._reachable(session):
                session._hello_due_s = now_s + HELLO_PERIOD_S
                expected = SCHEMA_HASH[session.expected] if session.expected else 0
                frames.append(self._framed(Hello(PROTO, session.node, expected, self._nonce)))
            if now_s >= session._ping_due_s:
                frames.append(self._ping(session, now_s))
        return b"".join(frames)

    def _reachable(self, session: Session) -> bool:
        return session.node == 0 or self.sessions[0].usable

    def _framed(self, message: Message) -> bytes:
        self._seq = (self._seq + 1) & 0xFF
        return encode_message(message, self._seq)

    def _ping(self, session: Session, now_s: float) -> bytes:
        session._pings_left -= 1
        session._ping_due_s = now_s + (PING_BURST_PERIOD_S if session._pings_left > 0 else PING_PERIOD_S)
        host_us = round(now_s * 1e6) & 0xFFFF_FFFF
        if len(session._pings) >= PING_BURST:  # unanswered ones are gone
            session._pings.clear()
        session._pings[host_us] = now_s
        return self._framed(Ping(session.node, host_us))

    def _send_request(self, frames: list[bytes], now_s: float) -> None:
        if not self._requests:
            return
        request = self._requests[0]
        if request.tries and now_s < request._deadline_s:
            return
        if request.tries == CONFIG_TRIES:
            request.outcome = Outcome.GIVEN_UP
            self._requests.popleft()
            self._send_request(frames, now_s)
            return
        if not request.tries:
            request._frame = self._framed(request.message)
            request._seq = self._seq
            wire_s = self._wire_s(type(request.message), request.node) + self._wire_s(Ack, request.node)
            request._timeout_s = ACK_TIMEOUT_S + wire_s
        request._deadline_s = now_s + request._timeout_s
        request._timeout_s *= 2
        request.tries += 1
        frames.append(request._frame)


_COMMON = {
    message_id: message
    for message_id, message in FROM_BOARD[BoardKind.MEGA_SUSPENSION].items()
    if message_id in FROM_BOARD[BoardKind.MEGA_SPEED]
}


def _was_reset(before: HelloReply, now: HelloReply) -> bool:
    """Whether two introductions lie on either side of a reset, or come from two boards."""
    same = (before.board_uid, before.boot_count) == (now.board_uid, now.boot_count)
    wrapped = before.uptime_ms - now.uptime_ms > 1 << 31  # u32 milliseconds last 49.7 days
    return not same or (now.uptime_ms < before.uptime_ms and not wrapped)
