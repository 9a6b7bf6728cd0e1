"""The robot's boards while they are calibrated: time passes, messages come in, requests are answered.

    station = Station(robot.ports, SerialPorts(), RealTime())        # the real robot
    station = Station(EMULATED_PORTS, rig.ports, VirtualTime(rig))   # the emulated one
    station.connect(BoardKind.NANO_IMU)
    messages = station.advance()
    value = station.call(BoardKind.NANO_IMU, ParamGet(1, 0))

Nothing moves but in `move`, which arms the board, moves, and disarms it again whatever happens.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol

from tiger.calibration.procedure import CalibrationError
from tiger.daemon.discovery import Boards, role_name
from tiger.daemon.limits import board_faults
from tiger.devices.suspension import ENGAGED_STATES, setpoint
from tiger.protocol.link import Outcome, Telemetry
from tiger.protocol.messages import (
    ACK_TEXT,
    SCHEMA_HASH,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    Disarm,
    SuspensionFlag,
    SuspensionMove,
    SuspensionState,
)
from tiger.record import STILL

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.robot import PortsConfig
    from tiger.devices.ports import PortProvider
    from tiger.protocol.link import Request
    from tiger.protocol.messages import Message
    from tiger.record import Four
    from tiger.rig.virtual import Rig

PERIOD_S = 0.01
CONNECT_PATIENCE_S = 8.0
BUSY_PATIENCE_S = 3.0
ARM_PATIENCE_S = 2.0
MOVE_PATIENCE_S = 30.0
_NEUTRAL_SEEN = 1 << SuspensionFlag.NEUTRAL_SEEN
_MOVING_TO = 1 << SuspensionFlag.MOVING_TO


class Time(Protocol):
    """A clock that can be waited on."""

    def now_s(self) -> float:
        """Seconds since some moment in the past."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""


class RealTime:
    """The computer's time."""

    def now_s(self) -> float:
        """Seconds of the monotonic clock."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)


class VirtualTime:
    """The time of an emulated robot, which runs while it is waited on."""

    def __init__(self, rig: Rig) -> None:
        from tiger.emulation.robot import STEP_S

        self._rig = rig
        self._step_s = STEP_S

    def now_s(self) -> float:
        """Seconds since its start."""
        return self._rig.robot.time_s

    def wait(self, seconds: float) -> None:
        """Let the robot live so long."""
        for _ in range(round(seconds / self._step_s)):
            self._rig.robot.run()
        self._rig.clock.set(self._rig.robot.time_s)


class Station:
    """See the module's text."""

    def __init__(self, config: PortsConfig, ports: PortProvider, clock: Time, nonce: int = 1) -> None:
        """Prepare; ports are opened in `connect`."""
        self.clock = clock
        self.state: SuspensionState | None = None
        needed = ((BoardKind.MEGA_SUSPENSION, 0), (BoardKind.NANO_IMU, 0))
        self._boards = Boards(ports, config, needed, nonce, clock.now_s())
        self._engaged: bool | None = None  # what setpoints say; None: none are sent

    @property
    def stroke_mm(self) -> Four | None:
        """Strokes as the board measures them; None before the first."""
        return self.state.stroke_mm if self.state is not None else None

    def connect(self, *kinds: BoardKind) -> None:
        """Wait until boards of these kinds answer. Raises CalibrationError that says why one does not."""
        deadline_s = self.clock.now_s() + CONNECT_PATIENCE_S
        while any((kind, 0) not in self._boards.roles for kind in kinds):
            self.advance()
            if self.clock.now_s() > deadline_s:
                problems = self._boards.problems(self.clock.now_s())
                names = " and ".join(role_name((kind, 0)) for kind in kinds)
                raise CalibrationError(
                    "\n".join(map(str, problems)) or f"{names}: no answer; run `tiger doctor`"
                )

    def advance(self) -> tuple[tuple[float, Message], ...]:
        """Let a hundredth of a second pass; returns what arrived, with its times."""
        self.clock.wait(PERIOD_S)
        now_s = self.clock.now_s()
        self._boards.step(now_s)
        arrived = [event for event in self._boards.receive(now_s) if isinstance(event, Telemetry)]
        for _ in self._boards.poll(now_s):  # boards that fell silent are forgotten
            pass
        for event in arrived:
            if isinstance(event.message, SuspensionState):
                self.state = event.message
        place = self._boards.roles.get((BoardKind.MEGA_SUSPENSION, 0))
        if self._engaged is not None and place is not None and place[0].link is not None:
            place[0].link.setpoint(setpoint(STILL, self._engaged, now_s))
        self._boards.send(self.clock.now_s())
        return tuple((event.t_s, event.message) for event in arrived)

    def faults(self, kind: BoardKind) -> int:
        """Latched faults of a board, as bits; 0 while it has sent no HEALTH."""
        session = self._boards.session((kind, 0))
        return session.health.faults if session is not None and session.health is not None else 0

    def forget_health(self, kind: BoardKind) -> None:
        """Wait for a HEALTH that was sent from now on."""
        session = self._boards.session((kind, 0))
        if session is None:
            raise CalibrationError(f"{role_name((kind, 0))}: was lost; check its cable and start again")
        session.health = None
        self._until(lambda: session.health is not None, 2.0, f"{session.name}: sends no HEALTH")

    def call(self, kind: BoardKind, message: Message) -> int:
        """Send a config message and return the value answered. Raises CalibrationError on a refusal."""
        deadline_s = self.clock.now_s() + BUSY_PATIENCE_S
        while True:
            request = self._ask(kind, message)
            if request.ok:
                return request.value
            if request.status is not AckStatus.BUSY or self.clock.now_s() > deadline_s:
                raise CalibrationError(self._refusal(kind, message, request))

    def _ask(self, kind: BoardKind, message: Message) -> Request:
        link = self._boards.link((kind, 0))
        if link is None:
            raise CalibrationError(f"{role_name((kind, 0))}: was lost; check its cable and start again")
        request = link.request(message)
        deadline_s = self.clock.now_s() + BUSY_PATIENCE_S
        while request.outcome is Outcome.WAITING and self.clock.now_s() < deadline_s:
            self.advance()
        return request

    def _refusal(self, kind: BoardKind, message: Message, request: Request) -> str:
        what = f"{role_name((kind, 0))}: {message.NAME}"
        if request.status is None:
            return f"{what} is not answered; check the cable, run `tiger doctor`"
        text = f"{what} is refused: {ACK_TEXT[request.status]}"
        session = self._boards.session((kind, 0))
        faults = board_faults(session) if session is not None and session.health is not None else []
        return "\n".join([text, *map(str, faults)])

    # ------------------------------------------------------------------------------------------------- motion

    def move(self, stroke_mm: Four, show: Callable[[str], None] = lambda text: None) -> None:
        """Arm the suspension, bring all strokes to `stroke_mm`, disarm it. Raises CalibrationError.

        The caller has a person's leave to do so.
        """
        suspension = BoardKind.MEGA_SUSPENSION
        self._engaged = True
        try:
            self._arm()
            self.call(suspension, SuspensionMove(stroke_mm))
            self._until(lambda: self._flag(_MOVING_TO), 1.0, "mega_suspension: does not begin to move")
            deadline_s = self.clock.now_s() + MOVE_PATIENCE_S
            while self._flag(_MOVING_TO):
                self.advance()
                self._must_be_engaged()
                now = " ".join(f"{value:.1f}" for value in self.stroke_mm or ())
                show(f"moving, strokes {now} mm")
                if self.clock.now_s() > deadline_s:
                    text = f"has not arrived after {MOVE_PATIENCE_S:g} s; look for what blocks it"
                    raise CalibrationError(f"mega_suspension: {text}")
        finally:
            self._engaged = False
            self._disarm()
            self._engaged = None

    def _arm(self) -> None:
        deadline_s = self.clock.now_s() + ARM_PATIENCE_S
        while True:
            session = self._boards.session((BoardKind.MEGA_SUSPENSION, 0))
            if session is not None and session.identity is not None:
                arm = Arm(0, SCHEMA_HASH[BoardKind.MEGA_SUSPENSION], session.identity.session)
                request = self._ask(BoardKind.MEGA_SUSPENSION, arm)
                if request.ok:
                    break
                known = request.status in (AckStatus.BAD_SESSION, AckStatus.NOT_READY)
                if not known or self.clock.now_s() > deadline_s:
                    raise CalibrationError(self._refusal(BoardKind.MEGA_SUSPENSION, arm, request))
            self.advance()
        self._until(
            lambda: self._flag(_NEUTRAL_SEEN), ARM_PATIENCE_S, "mega_suspension: does not report itself armed"
        )
        self._must_be_engaged()

    def _disarm(self) -> None:
        link = self._boards.link((BoardKind.MEGA_SUSPENSION, 0))
        if link is None:
            return  # its own link-loss ladder has switched the outputs off
        request = link.request(Disarm(0), urgent=True)
        deadline_s = self.clock.now_s() + 1.0
        while request.outcome is Outcome.WAITING and self.clock.now_s() < deadline_s:
            self.advance()
        for _ in range(5):  # the answer to HELLO brings the session for the next ARM
            self.advance()

    def _flag(self, mask: int) -> bool:
        return self.state is not None and bool(self.state.flags & mask)

    def _must_be_engaged(self) -> None:
        if self.state is None or self.state.state in ENGAGED_STATES:
            return
        session = self._boards.session((BoardKind.MEGA_SUSPENSION, 0))
        faults = board_faults(session) if session is not None and session.health is not None else []
        stopped = f"mega_suspension: stopped by itself ({BoardState(self.state.state).name.lower()})"
        raise CalibrationError("\n".join([stopped, *map(str, faults)]))

    def _until(self, condition: Callable[[], bool], patience_s: float, complaint: str) -> None:
        deadline_s = self.clock.now_s() + patience_s
        while not condition():
            self.advance()
            if self.clock.now_s() > deadline_s:
                raise CalibrationError(f"{complaint}; run `tiger doctor`")

    def close(self) -> None:
        """Give the ports back."""
        for port in self._boards.ports.values():
            port.connection.close()
