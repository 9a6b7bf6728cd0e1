"""Boards under test: their wire, and the actuators on mega_suspension's pins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from tiger.native.boards import Board, SuspensionBoard
from tiger.protocol.frame import FrameDecoder, encode_message
from tiger.protocol.messages import (
    FROM_BOARD,
    PROTO,
    SCHEMA_HASH,
    Ack,
    AckStatus,
    Arm,
    BoardState,
    ClearFaults,
    Disarm,
    Fault,
    Health,
    Hello,
    HelloReply,
    SuspensionSetpoint,
    SuspensionState,
)


class Wire:
    """The host's end of a board's line: frames out, frames in."""

    def __init__(self, board: Board, node: int = 0) -> None:
        self.board = board
        self.node = node
        self.seq = 0
        known = dict(FROM_BOARD[board.KIND])
        self.decoder = FrameDecoder(known)
        self.received: list[Any] = []

    def send(self, message: Any, seq: int | None = None) -> int:
        """Send a message; returns the sequence number it had."""
        if seq is None:
            seq = self.seq
            self.seq = (self.seq + 1) % 256
        self.board.uart_write(encode_message(message, seq))
        return seq

    def poll(self) -> list[Any]:
        """Messages that came since the last call."""
        fresh = [received.message for received in self.decoder.feed(self.board.uart_read())]
        self.received += fresh
        return fresh

    def all(self, kind: type) -> list[Any]:
        self.poll()
        return [message for message in self.received if isinstance(message, kind)]

    def last(self, kind: type) -> Any:
        found = self.all(kind)
        assert found, f"no {kind.__name__} came"
        return found[-1]


@dataclass
class Actuator:
    """First-order lag of 50 ms to 9.4 mm/s x duty, self-locking; faults and imperfections on demand."""

    motor_mm: float = 35.0
    stroke_mm: float = 35.0
    rate_mmps: float = 0.0
    full_speed_mmps: float = 9.4
    stiction: float = 0.0  # duty below which a standing actuator does not move
    backlash_mm: float = 0.0
    gain: float = 1.0  # 0: jammed; -1: reversed
    stuck_drive: float | None = None  # a driver that no longer listens

    def step(self, duty: float, dt_s: float) -> None:
        if self.stuck_drive is not None:
            duty = self.stuck_drive
        if abs(self.rate_mmps) < 0.05 and abs(duty) < self.stiction:
            self.rate_mmps = duty = 0.0
        settled = self.full_speed_mmps * duty * self.gain
        decay = math.exp(-dt_s / 0.05)
        rate = settled + (self.rate_mmps - settled) * decay
        self.motor_mm += settled * dt_s + (self.rate_mmps - settled) * 0.05 * (1 - decay)
        self.rate_mmps = rate if self.gain != 0 else 0.0
        half = self.backlash_mm / 2
        self.stroke_mm = min(max(self.stroke_mm, self.motor_mm - half), self.motor_mm + half)


def as_it_is(corner: int, counts: float) -> float:
    """A sound potentiometer."""
    return counts


@dataclass
class SuspensionRig:
    """mega_suspension, its four actuators and a host that sends setpoints every 10 ms while it is told to."""

    board: SuspensionBoard = field(default_factory=lambda: SuspensionBoard(uid=0x51))
    actuators: list[Actuator] = field(default_factory=lambda: [Actuator() for _ in range(4)])
    time_ms: int = 0
    lower: int = 0
    upper: int = 0
    estop: bool = False
    rates_mmps: tuple[float, ...] | None = None  # None: the host is silent
    engaged: int = 1
    read_pot: Callable[[int, float], float] = as_it_is
    host_clock_ms: Callable[[int], int] = int
    watch: Callable[[], None] | None = None

    def __post_init__(self) -> None:
        self.wire = Wire(self.board)

    @staticmethod
    def counts(stroke_mm: float) -> float:
        """Reading of a potentiometer with the default calibration, in ADC counts."""
        return (818 + (15550 - 818) * stroke_mm / 70.0) / 16.0

    @property
    def strokes_mm(self) -> list[float]:
        return [actuator.stroke_mm for actuator in self.actuators]

    @property
    def state(self) -> SuspensionState:
        return self.wire.last(SuspensionState)

    def run_ms(self, ms: int) -> None:
        for _ in range(ms):
            if self.rates_mmps is not None and self.time_ms % 10 == 0:
                self.send_setpoint(self.rates_mmps)
            for actuator, duty in zip(self.actuators, self.board.drive(), strict=True):
                actuator.step(duty, 0.001)
            pots = [self.read_pot(i, self.counts(a.stroke_mm)) for i, a in enumerate(self.actuators)]
            self.board.set_inputs(pots, self.lower, self.upper, self.estop)
            self.board.run(1000)
            self.time_ms += 1
            if self.watch is not None:
                self.watch()

    def run_us(self, us: int) -> None:
        """Let time pass in one piece, the actuators standing and the host silent."""
        self.board.run(us)
        self.time_ms += us // 1000

    def send_setpoint(self, rates_mmps: tuple[float, ...], host_ms: int | None = None) -> None:
        made_ms = self.host_clock_ms(self.time_ms) if host_ms is None else host_ms
        self.wire.send(SuspensionSetpoint(made_ms & 0xFFFF, self.engaged, tuple(rates_mmps)))

    def request(self, message: Any, seq: int | None = None) -> Ack:
        """Send a config message and return its answer."""
        seq = self.wire.send(message, seq)
        self.wire.poll()
        seen = len(self.wire.received)
        for _ in range(40):
            self.run_ms(1)
            self.wire.poll()
            for answer in self.wire.received[seen:]:
                if isinstance(answer, Ack) and answer.id == message.ID and answer.seq == seq:
                    return answer
        raise AssertionError(f"no answer to {message}")

    def hello(self) -> HelloReply:
        self.wire.send(Hello(PROTO, 0, SCHEMA_HASH[self.board.KIND], 0xBEEF))
        self.run_ms(5)
        return self.wire.last(HelloReply)

    def boot(self) -> None:
        """Let the board start and its observers settle."""
        self.run_ms(400)

    def arm(self) -> None:
        """Handshake, ARM, and neutral setpoints from now on."""
        session = self.hello().session
        answer = self.request(Arm(0, SCHEMA_HASH[self.board.KIND], session))
        assert answer.status == AckStatus.OK, AckStatus(answer.status)
        self.rates_mmps = (0.0,) * 4
        self.run_ms(50)
        assert self.state.state == BoardState.ARMED

    def disarm(self) -> Ack:
        return self.request(Disarm(0))

    def clear_faults(self) -> Ack:
        return self.request(ClearFaults(0))

    def health(self) -> Health:
        """A report made after now."""
        before = len(self.wire.all(Health))
        for _ in range(150):
            self.run_ms(1)
            reports = self.wire.all(Health)
            if len(reports) > before:
                return reports[-1]
        raise AssertionError("no HEALTH came")

    def faults(self) -> set[Fault]:
        bits = self.health().faults
        return {fault for fault in Fault if fault != 0 and bits >> fault & 1}

    def run_until(self, condition: Callable[[], bool], limit_ms: int) -> int:
        """Run until the condition holds; returns how long that took. Fails beyond the limit."""
        for passed_ms in range(limit_ms + 1):
            if condition():
                return passed_ms
            self.run_ms(1)
        raise AssertionError(f"did not happen within {limit_ms} ms")

    @property
    def is_off(self) -> bool:
        return self.board.drive() == (0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def rig() -> Iterator[SuspensionRig]:
    """A booted, disarmed mega_suspension with its actuators at mid-stroke."""
    fresh = SuspensionRig()
    fresh.boot()
    yield fresh
    fresh.board.close()


@pytest.fixture
def armed(rig: SuspensionRig) -> SuspensionRig:
    """The same, armed, with neutral setpoints coming."""
    rig.arm()
    return rig


@pytest.fixture
def make_wire() -> Callable[..., Wire]:
    """The host's end of any board's line."""
    return Wire


@pytest.fixture
def make_rig() -> Iterator[Callable[..., SuspensionRig]]:
    """A mega_suspension that has not run yet, built with the given actuators and inputs."""
    made: list[SuspensionRig] = []

    def make(**settings: Any) -> SuspensionRig:
        made.append(SuspensionRig(**settings))
        return made[-1]

    yield make
    for each in made:
        each.board.close()
