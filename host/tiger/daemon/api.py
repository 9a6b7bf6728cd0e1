"""The local socket through which any program of this user can watch and drive the robot.

    api = Api(robot)                         # listens; raises ApiError
    ...
    api.poll(daemon, record, now_s)          # after every tick: never waits, and is the only I/O
    ...
    api.close()

Three parts: `Session` turns the bytes of one client into checked requests, `Desk` carries requests out and
keeps who may, `Api` owns the sockets. The first two are free of I/O and of clocks. What one client can cost a
tick is bounded: bytes read, requests carried out, bytes kept. Who exceeds that is told why and hung up on.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import socket
import stat
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, BinaryIO

from pydantic import ValidationError
from pydantic_core import from_json

from tiger.control.reachable import Suspension
from tiger.daemon.api_messages import (
    REQUEST,
    REQUEST_ID,
    Accepted,
    ArmRequest,
    ClearRequest,
    DisarmRequest,
    DriveRequest,
    EstopRequest,
    ModeRequest,
    PoseRequest,
    Refusal,
    ReleaseRequest,
    Reply,
    Request,
    RideHeightRequest,
    Status,
    StatusReply,
    StatusRequest,
    SubscribeRequest,
)
from tiger.daemon.client import socket_path
from tiger.daemon.overview import overview
from tiger.record import DaemonState, Mode

if TYPE_CHECKING:
    from pathlib import Path

    from tiger.config.robot import RobotConfig
    from tiger.daemon.daemon import Daemon
    from tiger.record import Record

DRIVE_LIFE_S = 0.5  # a drive command not repeated within this is over; so is a silent client's helm
MAX_CLIENTS = 8
MAX_LINE_BYTES = 1024
MAX_UNREAD_BYTES = 65536  # answers that a client does not fetch
REQUESTS_PER_S = 250.0  # of one client, for long
REQUESTS_AT_ONCE = 5.0  # of one client, after a pause
SEND_BUFFER_BYTES = 16384  # small: telemetry that waits in the kernel is old
NOTES = 10


class ApiError(Exception):
    """The socket cannot be served; the text says why and what to do."""


# ---- one client's bytes -------------------------------------


class Session:
    """From the bytes of one client to requests. Pure: time is an argument."""

    def __init__(self, now_s: float) -> None:
        self.closing: Refusal | None = None
        """Why this client is hung up on, once it is."""
        self._rest = b""
        self._allowance = REQUESTS_AT_ONCE
        self._now_s = now_s

    def feed(self, data: bytes, now_s: float) -> list[Request | Refusal]:
        """Take bytes; returns a checked request, or why it is refused, for each complete line in order."""
        self._allowance += (now_s - self._now_s) * REQUESTS_PER_S
        self._allowance = min(self._allowance, REQUESTS_AT_ONCE)
        self._now_s = now_s
        *lines, self._rest = (self._rest + data).split(b"\n")
        found: list[Request | Refusal] = []
        for line in lines:
            self._allowance -= 1.0
            if self._allowance < 0.0:
                self._close(f"more than {REQUESTS_PER_S:g} requests a second", "Send fewer.")
            elif len(line) > MAX_LINE_BYTES:
                self._close_oversized()
            if self.closing is not None:
                return found
            found.append(_request(line))
        if len(self._rest) > MAX_LINE_BYTES:
            self._close_oversized()
        return found

    def _close_oversized(self) -> None:
        self._close(f"a line of more than {MAX_LINE_BYTES} bytes", "Send one JSON object a line.")

    def _close(self, reason: str, next_step: str) -> None:
        self.closing = Refusal(reason=reason, next_step=next_step, closing=True)
        self._rest = b""


def _request(line: bytes) -> Request | Refusal:
    try:
        return REQUEST.validate_json(line)
    except ValidationError as error:
        reason, next_step = _explain(error)
        return Refusal(id=_readable_id(line), reason=reason, next_step=next_step)


def _readable_id(line: bytes) -> int | str | None:
    """Return the id of a request that is wrong in other ways."""
    try:
        said = from_json(line)
        return REQUEST_ID.validate_python(said["id"]) if isinstance(said, dict) else None
    except (ValueError, KeyError):
        return None


_NEXT_STEP = {
    "json_invalid": "Send one JSON object a line",
    "union_tag_invalid": "Ask for one of these",
    "union_tag_not_found": 'Say what to do: {"id": 1, "do": "status"}',
    "missing": "Add it",
    "extra_forbidden": "Remove it",
}
LONGEST_TEXT = 200


def _explain(error: ValidationError) -> tuple[str, str]:
    """What is wrong with a request first of all, and the next step."""
    finding, *more = error.errors(include_url=False, include_context=False)
    key = finding["loc"][:2]
    told = " or ".join([finding["msg"], *(other["msg"] for other in more if other["loc"][:2] == key)])
    where = ".".join(str(part) for part in key[1:])
    text = f"{where}: {told}" if where else told
    step = _NEXT_STEP.get(finding["type"], "Correct it")
    return text[:LONGEST_TEXT], f"{step}; docs/api.md lists every request."


# ---- what is asked for --------------------------------------


@dataclass(frozen=True, slots=True)
class Moment:
    """Who asks, and the robot at that time."""

    client: str
    daemon: Daemon
    record: Record
    now_s: float


@dataclass(frozen=True, slots=True)
class Bound:
    """Lowest and highest value of a request's field, and the key of the config that sets it."""

    low: float
    high: float
    key: str


def bounds(robot: RobotConfig) -> dict[str, Bound]:
    """Return the bounds of every bounded field."""
    speed, yaw_rate = robot.drive.max_speed_mps, math.radians(robot.drive.max_yaw_rate_degps)
    angle = math.radians(robot.leveling.max_angle_deg)
    return {
        "speed_mps": Bound(-speed, speed, "drive.max_speed_mps"),
        "yaw_rate_radps": Bound(-yaw_rate, yaw_rate, "drive.max_yaw_rate_degps"),
        "roll_rad": Bound(-angle, angle, "leveling.max_angle_deg"),
        "pitch_rad": Bound(-angle, angle, "leveling.max_angle_deg"),
        "ride_stroke_mm": Bound(*robot.stroke_range_mm, "leveling.stroke_margin_mm"),
    }


class Desk:
    """Carries requests out on the daemon, for one client at a time where they move the robot.

    Whoever first asks for motion has the helm until it releases it, hangs up or is silent for half a second.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self.helm: str | None = None
        """Who may move the robot."""
        self.notes: deque[str] = deque(maxlen=NOTES)
        """What clients did lately."""
        self._robot = robot
        self._bounds = bounds(robot)
        self._suspension = Suspension.from_config(robot)
        self._limits = self._find_limits()
        self._heard_s = -math.inf
        self._drive_until_s = -math.inf
        self._is_driving = False

    def status(self, daemon: Daemon, record: Record) -> Status:
        """Return everything that is known now."""
        lines = [*daemon.log_lines, *self.notes]
        return Status(
            state=record.state.name,
            reason=record.reason,
            helm=self.helm,
            log_lines=lines,
            record=record,
            overview=overview(record, daemon.energy, self._suspension),
        )

    def _find_limits(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and highest value of each field, and how far the strokes reach in one axis."""
        roll, pitch = self._suspension.limits()
        return {name: (bound.low, bound.high) for name, bound in self._bounds.items()} | {
            "reachable_roll_rad": (-roll, roll),
            "reachable_pitch_rad": (-pitch, pitch),
        }

    def carry_out(self, request: Request, moment: Moment) -> Reply:
        """Do what a client asks for, or say why not; a refused request changes nothing."""
        action = _ACTIONS[type(request)]
        if action.needs_helm and self.helm not in (None, moment.client):
            step = f"Wait until it releases the helm or is silent for {DRIVE_LIFE_S:g} s."
            return Refusal(id=request.id, reason=f"{self.helm} has the helm", next_step=step)
        reply = self._out_of_bounds(request) or action.carry_out(self, request, moment)
        if reply.ok and action.needs_helm:
            self.helm, self._heard_s = moment.client, moment.now_s
        if reply.ok and action.is_noted:
            self.notes.append(f"{moment.client}: {request.do}")
        return reply

    def tick(self, daemon: Daemon, now_s: float) -> None:
        """Stop what is not asked for any longer."""
        if self._is_driving and (now_s > self._drive_until_s or daemon.state is not DaemonState.ARMED):
            self._stop(daemon)
        if self.helm is not None and now_s > self._heard_s + DRIVE_LIFE_S:
            self.helm = None

    def leave(self, client: str, daemon: Daemon) -> None:
        """A client is gone, or gives up the helm: what it drove stops."""
        if self.helm == client:
            self.helm = None
            self._stop(daemon)

    def reserve(self, name: str) -> None:
        """Give the helm to someone who does not come over the socket, for good."""
        self.helm, self._heard_s = name, math.inf

    def _stop(self, daemon: Daemon) -> None:
        if self._is_driving:
            self._is_driving = False
            daemon.command = replace(daemon.command, speed_mps=0.0, yaw_rate_radps=0.0)

    def _out_of_bounds(self, request: Request) -> Refusal | None:
        for name, bound in self._bounds.items():
            value = getattr(request, name, None)
            if value is not None and not bound.low <= value <= bound.high:
                reason = f"{name} = {value:g} is outside {bound.low:.4g} to {bound.high:.4g} ({bound.key})"
                return Refusal(id=request.id, reason=reason, next_step="Ask for less, or change the config.")
        return None

    # ------------------------------------------------------------------------------------ one request each

    def _arm(self, request: ArmRequest, moment: Moment) -> Reply:
        daemon = moment.daemon
        if daemon.state is DaemonState.ARMED:
            return Accepted(id=request.id, text="armed already")
        if daemon.state in (DaemonState.FAULT, DaemonState.ESTOP):
            why = str(daemon.latched[0]) if daemon.latched else daemon.reason
            reason = f"the robot is in {daemon.state.name}: {why}"
            return Refusal(id=request.id, reason=reason, next_step="Make it safe, then clear, then arm.")
        daemon.arm()
        return Accepted(id=request.id, text="arming; status tells when, or why not")

    def _disarm(self, request: DisarmRequest, moment: Moment) -> Reply:
        self._stop(moment.daemon)
        moment.daemon.disarm()
        return Accepted(id=request.id, text="disarming")

    def _estop(self, request: EstopRequest, moment: Moment) -> Reply:
        self._stop(moment.daemon)
        moment.daemon.estop()
        return Accepted(id=request.id, text="emergency stop: everything is off until it is cleared")

    def _clear(self, request: ClearRequest, moment: Moment) -> Reply:
        if moment.daemon.state is DaemonState.ARMED:
            return Accepted(id=request.id, text="nothing to clear: the robot is armed")
        moment.daemon.clear()
        return Accepted(id=request.id, text="clearing; what has no cause any longer goes away")

    def _mode(self, request: ModeRequest, moment: Moment) -> Reply:
        daemon = moment.daemon
        daemon.command = replace(daemon.command, mode=request.mode, roll_rad=0.0, pitch_rad=0.0)
        return Accepted(id=request.id, text=f"mode {request.mode}")

    def _pose(self, request: PoseRequest, moment: Moment) -> Reply:
        daemon = moment.daemon
        ride_mm = request.ride_stroke_mm
        if ride_mm is None:
            ride_mm = daemon.command.ride_stroke_mm
        roll, pitch = self._suspension.nearest(request.roll_rad, request.pitch_rad)
        beyond = abs(roll - request.roll_rad) + abs(pitch - request.pitch_rad) > 1e-9
        text = "mode pose"
        if beyond:
            nearest = f"roll {math.degrees(roll):.2f} and pitch {math.degrees(pitch):.2f} degrees"
            if self._robot.leveling.out_of_reach == "refuse":
                reason = f"the strokes do not reach this attitude; the nearest is {nearest}"
                return Refusal(id=request.id, reason=reason, next_step=f"Ask for less: {self._reach}.")
            text = f"mode pose, clipped to what the strokes reach: {nearest} ({self._reach})"
        elif self._ride_gives_way(roll, pitch, request.ride_stroke_mm):
            text = "mode pose; the ride height gives way to the attitude"
        daemon.command = replace(
            daemon.command,
            mode=Mode.POSE,
            roll_rad=roll,
            pitch_rad=pitch,
            ride_stroke_mm=ride_mm,
        )
        return Accepted(id=request.id, text=text)

    @property
    def _reach(self) -> str:
        """The reachable set in words."""
        roll, pitch = (math.degrees(most) for most in self._suspension.limits())
        return f"|roll|/{roll:.1f} + |pitch|/{pitch:.1f} up to 1, in degrees"

    def _ride_gives_way(self, roll_rad: float, pitch_rad: float, stroke_mm: float | None) -> bool:
        if stroke_mm is None:
            return False
        low, high = self._suspension.ride_range_mm(roll_rad, pitch_rad)
        return not low <= self._suspension.curve.at(stroke_mm)[0] <= high

    def _ride_height(self, request: RideHeightRequest, moment: Moment) -> Reply:
        daemon = moment.daemon
        daemon.command = replace(daemon.command, ride_stroke_mm=request.ride_stroke_mm)
        ride_mm = request.ride_stroke_mm
        ride_mm = self._robot.leveling.ride_stroke_mm if ride_mm is None else ride_mm
        return Accepted(id=request.id, text=f"ride height: mean stroke {ride_mm:g} mm")

    def _drive(self, request: DriveRequest, moment: Moment) -> Reply:
        daemon = moment.daemon
        if not self._robot.drive.enabled:
            step = "Set drive.enabled = true in robot.toml."
            return Refusal(id=request.id, reason="this robot has no drive", next_step=step)
        if daemon.state is not DaemonState.ARMED:
            reason = f"the robot is in {daemon.state.name}: {daemon.reason}"
            return Refusal(id=request.id, reason=reason, next_step="Arm it first.")
        daemon.command = replace(
            daemon.command, speed_mps=request.speed_mps, yaw_rate_radps=request.yaw_rate_radps
        )
        self._is_driving, self._drive_until_s = True, moment.now_s + DRIVE_LIFE_S
        return Accepted(id=request.id, text=f"driving for {DRIVE_LIFE_S:g} s")

    def _status(self, request: StatusRequest, moment: Moment) -> Reply:
        status = self.status(moment.daemon, moment.record)
        return StatusReply(id=request.id, text=status.state, status=status, limits=self._limits)

    def _subscribe(self, request: SubscribeRequest, moment: Moment) -> Reply:
        return Accepted(id=request.id, text=f"telemetry at {request.rate_hz:g} Hz")

    def _release(self, request: ReleaseRequest, moment: Moment) -> Reply:
        self.leave(moment.client, moment.daemon)
        return Accepted(id=request.id, text="released")


@dataclass(frozen=True, slots=True)
class _Action:
    """What a request does, and who may ask for it."""

    carry_out: Callable[[Desk, Any, Moment], Reply]
    needs_helm: bool = False
    is_noted: bool = False


_ACTIONS: dict[type[Request], _Action] = {
    ArmRequest: _Action(Desk._arm, needs_helm=True, is_noted=True),
    DisarmRequest: _Action(Desk._disarm, is_noted=True),
    EstopRequest: _Action(Desk._estop, is_noted=True),
    ClearRequest: _Action(Desk._clear, needs_helm=True, is_noted=True),
    ModeRequest: _Action(Desk._mode, needs_helm=True),
    PoseRequest: _Action(Desk._pose, needs_helm=True),
    RideHeightRequest: _Action(Desk._ride_height, needs_helm=True),
    DriveRequest: _Action(Desk._drive, needs_helm=True),
    StatusRequest: _Action(Desk._status),
    SubscribeRequest: _Action(Desk._subscribe),
    ReleaseRequest: _Action(Desk._release),
}


# ---- sockets ------------------------------------------------


@dataclass(slots=True, eq=False)
class _Client:
    """One connection."""

    socket: socket.socket
    name: str
    session: Session
    unread: bytearray = field(default_factory=bytearray)
    """Lines that the kernel did not take yet."""
    telemetry_every: int = 0
    """Ticks between two lines of telemetry; 0: none."""
    dropped: int = 0


class Api:
    """The socket; see the module's text."""

    def __init__(self, robot: RobotConfig, path: Path | None = None) -> None:
        """Listen on `path`, by default `client.socket_path()`. Raises ApiError."""
        self.path = path or socket_path()
        self.desk = Desk(robot)
        self._rate_hz = robot.loop.rate_hz
        self._clients: dict[int, _Client] = {}
        self._accepted = 0
        self._lock, self._listener = _listen(self.path)
        self._watch = select.poll()
        self._watch.register(self._listener, select.POLLIN)

    def poll(self, daemon: Daemon, record: Record, now_s: float) -> None:
        """Take what clients ask for, stop what has lapsed, hand out telemetry. Call it after every tick."""
        ready = self._watch.poll(0)
        if ready:
            self._receive([number for number, _ in ready], daemon, record, now_s)
        if self.desk.helm is not None:
            self.desk.tick(daemon, now_s)
        if self._clients:
            self._publish(daemon, record)
            self._send(daemon)

    def close(self, daemon: Daemon) -> None:
        """Hang up on everyone, and stop what they drove."""
        for client in list(self._clients.values()):
            self._hang_up(client, daemon)
        self._listener.close()
        self.path.unlink(missing_ok=True)
        self._lock.close()

    # ---------------------------------------------------------------------------------------------- receiving

    def _receive(self, ready: list[int], daemon: Daemon, record: Record, now_s: float) -> None:
        for number in ready:
            client = self._clients.get(number)
            if client is None:
                self._accept(now_s)
                continue
            try:
                data = client.socket.recv(MAX_LINE_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            if data:
                self._answer(client, data, Moment(client.name, daemon, record, now_s))
            else:
                self._hang_up(client, daemon)

    def _accept(self, now_s: float) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        connection.setblocking(False)
        if len(self._clients) >= MAX_CLIENTS:
            step = "Close one of them first."
            reason = f"there are {MAX_CLIENTS} clients already"
            _say_goodbye(connection, Refusal(reason=reason, next_step=step, closing=True))
            return
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._accepted += 1
        name = f"client {self._accepted} (process {_process_of(connection)})"
        self._clients[connection.fileno()] = _Client(connection, name, Session(now_s))
        self._watch.register(connection, select.POLLIN)

    def _answer(self, client: _Client, data: bytes, moment: Moment) -> None:
        for request in client.session.feed(data, moment.now_s):
            reply: Reply
            if isinstance(request, Refusal):
                reply = request
            else:
                reply = self.desk.carry_out(request, moment)
                if isinstance(request, SubscribeRequest):
                    hz = request.rate_hz
                    client.telemetry_every = math.ceil(self._rate_hz / hz) if hz > 0.0 else 0
            client.unread += _line(reply)
        if client.session.closing is not None:
            self._hang_up(client, moment.daemon, client.session.closing)

    # ------------------------------------------------------------------------------------------------ sending

    def _publish(self, daemon: Daemon, record: Record) -> None:
        text = b""  # the same for all who are due now: made once
        for client in self._clients.values():
            if not client.telemetry_every or record.tick % client.telemetry_every:
                continue
            if client.unread:
                client.dropped += 1
                continue
            text = text or self.desk.status(daemon, record).model_dump_json().encode()
            client.unread += b'{"dropped":%d,"telemetry":%b}\n' % (client.dropped, text)

    def _send(self, daemon: Daemon) -> None:
        for client in list(self._clients.values()):
            if not client.unread:
                continue
            try:
                del client.unread[: client.socket.send(client.unread)]
            except BlockingIOError:
                pass
            except OSError:
                self._hang_up(client, daemon)
                continue
            if len(client.unread) > MAX_UNREAD_BYTES:
                reason = f"{MAX_UNREAD_BYTES} bytes of answers were not read"
                self._hang_up(
                    client, daemon, Refusal(reason=reason, next_step="Read the answers.", closing=True)
                )

    def _hang_up(self, client: _Client, daemon: Daemon, why: Refusal | None = None) -> None:
        self.desk.leave(client.name, daemon)
        self._watch.unregister(client.socket)
        del self._clients[client.socket.fileno()]
        if why is None:
            client.socket.close()
            return
        self.desk.notes.append(f"{client.name} was hung up on: {why.reason}")
        _say_goodbye(client.socket, why, bytes(client.unread))


def _line(reply: Reply) -> bytes:
    return reply.model_dump_json().encode() + b"\n"


def _say_goodbye(connection: socket.socket, why: Refusal, before: bytes = b"") -> None:
    """Tell the reason, as far as the kernel takes it at once, and close."""
    with connection, contextlib.suppress(OSError):
        connection.send(before + _line(why))


def _process_of(connection: socket.socket) -> int:
    """Return the process at the other end."""
    process, _, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return int(process)


def _listen(path: Path) -> tuple[BinaryIO, socket.socket]:
    """Return the lock of the only daemon, and a listening socket that only its owner may use."""
    with contextlib.ExitStack() as undo:
        try:
            _make_private(path.parent)
            lock = undo.enter_context(_lock(path.with_suffix(".lock"), path))
            if path.is_socket():  # left behind by a daemon that was killed
                path.unlink()
            listener = undo.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            listener.setblocking(False)
            listener.bind(str(path))
            path.chmod(0o600)
            listener.listen(MAX_CLIENTS)
        except OSError as error:
            raise ApiError(
                f"{path}: cannot listen there ({error.strerror or error}); {_ANOTHER_SOCKET}"
            ) from error
        undo.pop_all()
        return lock, listener


_ANOTHER_SOCKET = "name another socket with TIGER_SOCKET"


def _make_private(folder: Path) -> None:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    mode = stat.S_IMODE(found.st_mode)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or mode & 0o077:
        raise ApiError(
            f"{folder}: is no folder of this user alone (user {found.st_uid}, mode {mode:04o}); "
            f"chmod 700 it, or {_ANOTHER_SOCKET}"
        )


def _lock(file: Path, path: Path) -> BinaryIO:
    """Lock out other daemons. A lock ends with its holder, however that dies; a socket's file does not."""
    lock = file.open("ab")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise ApiError(f"{path}: another daemon listens there; stop it, or {_ANOTHER_SOCKET}") from None
    return lock
