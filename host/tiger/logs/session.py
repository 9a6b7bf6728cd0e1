"""A log of one run of the daemon.

    with LogSession(folder, robot, clock) as log:
        daemon = Daemon(robot, log.tap(ports), clock)
        ...
        log.record(daemon.tick(now_s))

The writing is done by another process. Handing over some ticks is one `send` that never waits: when that
process lags so far that the socket is full, they are dropped and counted. Should it die, the robot runs on
unlogged.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import platform
import socket
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Self

from tiger.logs import cdr, packets
from tiger.logs.checkpoint import freeze
from tiger.logs.errors import LogError
from tiger.logs.store import part_name
from tiger.logs.tap import TappedPorts
from tiger.logs.topics import (
    CHECKPOINT,
    HEALTH,
    LOG_STATUS,
    TICK,
    Checkpoint,
    Health,
    LogStatus,
    Tick,
    wire_topic,
)
from tiger.logs.writer import READY
from tiger.protocol.messages import PROTO, SCHEMA_HASH
from tiger.record import DaemonState

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.daemon.clock import Clock
    from tiger.daemon.controller import ControllerState
    from tiger.devices.ports import PortProvider
    from tiger.record import LinkStatus, Problem, Record

SOCKET_BYTES = 4_000_000  # asked for; the kernel's limit is net.core.wmem_max
PENDING_BYTES = 100_000  # of the wire between two packets; a packet must fit into the socket
TICKS_PER_PACKET = 12  # handing over costs more than packing: 60 ms of ticks go together
FULL = (errno.EAGAIN, errno.EMSGSIZE, errno.ENOBUFS)  # the socket takes nothing now
START_TIME_S = 20.0
END_TIME_S = 20.0
_TICKS = cdr.message(Tick)
_TICK, _HEALTH, _CHECKPOINT, _LOG_STATUS = (t.encode() for t in (TICK, HEALTH, CHECKPOINT, LOG_STATUS))
HEALTH_PERIOD_NS = 1_000_000_000
CHECKPOINT_PERIOD_NS = 10_000_000_000
NS_PER_S = 1_000_000_000


class LogSession:
    """See the module's text.

    Args:
        folder: where the files go; made if it is not there.
        robot: the configuration that the daemon runs with: it goes into the log, and replay uses it. Its
            `log` limits the room that logs take.
        clock: the daemon's clock.
        about: more to know about this run, such as the command line.
        epoch_ns: when the clock was zero, in ns since 1970; the computer's time says so by default.
    """

    def __init__(
        self,
        folder: str | Path,
        robot: RobotConfig,
        clock: Clock,
        about: dict[str, str] | None = None,
        epoch_ns: int | None = None,
    ) -> None:
        self.folder = Path(folder).absolute()
        self.dropped_packets = 0
        self.dropped_bytes = 0
        self.problem: str | None = None
        self._clock = clock
        self._epoch_ns = time.time_ns() - round(clock.now_s() * NS_PER_S) if epoch_ns is None else epoch_ns
        self._start = packets.Start(
            folder=str(self.folder),
            name=_session_name(self.folder),
            epoch_ns=self._epoch_ns,
            metadata={**_circumstances(), **(about or {})},
            attachments={"robot.json": robot.model_dump_json(indent=1), **_wire_description()},
            part_bytes=round(robot.log.part_mb * 1e6),
            total_bytes=round(robot.log.total_mb * 1e6),
            free_bytes=round(robot.log.free_mb * 1e6),
        )
        self._socket: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._packet: list[bytes] = []  # its parts
        self._pending_bytes = 0
        self._topics: dict[tuple[str, bool], bytes] = {}
        self._problems: tuple[Problem, ...] | None = None
        self._links: tuple[LinkStatus, ...] | None = None
        self._wired: list[tuple[bytes, bytes]] = []  # bytes since the last tick
        self._health_ns = self._checkpoint_ns = 0
        self._reported = -1
        self._ticks_kept = 0
        self._state = DaemonState.DISCONNECTED

    @property
    def path(self) -> Path:
        """The first file."""
        return self.folder / part_name(self._start.name, 0)

    @property
    def trouble(self) -> str | None:
        """What someone who watches the robot should know of the log: it lags, lagged, or ended."""
        if self.problem is not None or self.dropped_packets == 0:
            return self.problem
        if self.dropped_packets != self._reported:
            return "log: lags behind, ticks are not logged"
        return f"log: goes on; {self.dropped_packets} packets were dropped while it lagged behind"

    def tap(self, ports: PortProvider) -> PortProvider:
        """The same ports, with all bytes logged."""
        return TappedPorts(ports, self.wire)

    def wire(self, port: str, data: bytes, *, sent: bool) -> None:
        """Keep bytes of a port for the next tick: it reads and writes all of them within its millisecond."""
        topic = self._topics.get((port, sent))
        if topic is None:
            topic = self._topics[port, sent] = wire_topic(port, sent=sent).encode()
        self._wired.append((topic, data))

    def record(self, record: Record, control: ControllerState | None = None) -> None:
        """Keep a tick and the bytes since the last one; hand them over every few ticks, without waiting.

        With `control`, the state that the controller has after this tick, now and then a checkpoint is
        written, from which replay can begin.
        """
        now_ns = self._now_ns()
        self._take_wired(now_ns)
        self._health(record, now_ns)
        tick = Tick(
            record.tick, record.state, record.reason, record.inputs, record.outputs, record.lateness_s
        )
        self._add(now_ns, _TICK, _TICKS.pack(tick))
        if control is not None and now_ns - self._checkpoint_ns >= CHECKPOINT_PERIOD_NS:
            self._checkpoint_ns = now_ns
            self._checkpoint(record.tick + 1, control, now_ns)
        self._ticks_kept += 1
        if self._ticks_kept >= TICKS_PER_PACKET or record.state is not self._state:
            self._ticks_kept, self._state = 0, record.state
            self._send(now_ns)

    def _take_wired(self, now_ns: int) -> None:
        for topic, data in self._wired:
            self._add(now_ns, topic, data)
        self._wired.clear()

    def _health(self, record: Record, now_ns: int) -> None:
        same = record.problems is self._problems and record.links is self._links
        if same and now_ns - self._health_ns < HEALTH_PERIOD_NS:
            return
        self._problems, self._links, self._health_ns = record.problems, record.links, now_ns
        self._add(now_ns, _HEALTH, cdr.message(Health).pack(Health(record.problems, record.links)))

    def _checkpoint(self, tick: int, control: ControllerState, now_ns: int) -> None:
        try:
            point = Checkpoint(tick, freeze(control))
        except TypeError as error:  # the robot must not stop for that
            self.problem = f"log: no checkpoints: {error}"
            return
        self._add(now_ns, _CHECKPOINT, cdr.message(Checkpoint).pack(point))

    def _add(self, t_ns: int, topic: bytes, data: bytes) -> None:
        if self._socket is None:
            return
        if self._pending_bytes > PENDING_BYTES:
            self._drop()
        self._packet += packets.parts(t_ns, topic, data)
        self._pending_bytes += len(data)

    def _send(self, now_ns: int) -> None:
        if self._socket is None:
            return
        if self.dropped_packets != self._reported:
            status = LogStatus(self.dropped_packets, self.dropped_bytes)
            self._add(now_ns, _LOG_STATUS, cdr.message(LogStatus).pack(status))
        try:
            self._socket.send(b"".join(self._packet))
        except OSError as error:
            if error.errno in FULL:
                self._drop()
            else:
                self._stopped()
            return
        if self.dropped_packets != self._reported:
            self._reported = self.dropped_packets
            self._checkpoint_ns = 0  # after a gap, replay needs a state to begin with
        self._packet, self._pending_bytes = [], 0

    def _drop(self) -> None:
        self.dropped_packets += 1
        self.dropped_bytes += self._pending_bytes
        self._packet, self._pending_bytes = [], 0
        self._problems = None  # health is said again as soon as someone listens

    def _stopped(self) -> None:
        """The log's process is gone: say what it said last, and go on without it."""
        said = b""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                said = self._socket.recv(4096)
            self._socket.close()
        self._socket = None
        self._packet, self._pending_bytes = [], 0
        self.problem = f"{said.decode() or 'log: its process ended'}: nothing is logged any more"

    def _now_ns(self) -> int:
        return self._epoch_ns + round(self._clock.now_s() * NS_PER_S)

    # ------------------------------------------------------------------------------------- the other process

    def __enter__(self) -> Self:
        """Start the log's process and wait until its file is open. Raises LogError."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        command = [sys.executable, "-m", "tiger.logs.writer", str(theirs.fileno())]
        with theirs:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(),), start_new_session=True
            )
        ours.settimeout(START_TIME_S)
        try:
            ours.send(self._start.pack())
            answer = ours.recv(4096)
        except TimeoutError:
            answer = f"log: its process did not start within {START_TIME_S:g} s".encode()
        except OSError as error:
            answer = f"log: its process did not start ({error.strerror})".encode()
        if answer != READY:
            ours.close()
            self._process.wait()
            text = answer.decode() or "log: its process ended at once"
            raise LogError(f"{text}. Choose another folder with --log, or run without it.")
        ours.setblocking(False)
        self._socket = ours
        return self

    def __exit__(self, *_: object) -> None:
        """Let the log's process finish its file, and wait for that."""
        self._take_wired(self._now_ns())  # the daemon's last words come after its last tick
        if self._packet:
            self._send(self._now_ns())
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._process is not None:
            try:
                self._process.wait(END_TIME_S)
            except subprocess.TimeoutExpired:
                self.problem = f"log: still writing after {END_TIME_S:g} s; it ends by itself"


def _session_name(folder: Path) -> str:
    now = datetime.datetime.now(datetime.UTC)
    name = f"tiger-{now:%Y%m%d-%H%M%S}"
    again = 0
    while (folder / part_name(name + (f"_{again}" if again else ""), 0)).exists():
        again += 1
    return name + (f"_{again}" if again else "")


def _circumstances() -> dict[str, str]:
    """Versions: what one asks first about a log."""
    return {
        "version": _version(),
        "git_revision": _git_revision(),
        "protocol": str(PROTO),
        **{f"schema_{board.name.lower()}": f"{value:#010x}" for board, value in SCHEMA_HASH.items()},
        "host": platform.node(),
        "python": platform.python_version(),
    }


def _version() -> str:
    try:
        return metadata.version("tiger-robot")
    except metadata.PackageNotFoundError:  # runs from its sources
        return "sources"


def _git_revision() -> str:
    """Commit of the checkout that runs, with "-dirty" when it was changed; "" outside a checkout."""
    trust = ["-c", "safe.directory=*"]  # as a service it belongs to root, and git would not read it
    here = ["-C", str(Path(__file__).parent)]
    command = ["git", *trust, *here, "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip()


def _wire_description() -> dict[str, str]:
    """The description of the wire, to read the bytes in ten years; an installed package has none with it."""
    path = Path(__file__).parents[3] / "protocol" / "tiger.toml"
    try:
        return {"tiger.toml": path.read_text(encoding="utf-8")}
    except OSError:
        return {}
