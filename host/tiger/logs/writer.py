"""The log's own process: `python -m tiger.logs.writer FD`.

It takes packets from a socket that the control loop never waits for, and writes them to files. It ends when
the other end of the socket is closed, however the daemon died, with everything written. Signals meant for the
daemon do not end it.

One thread only receives, so that a stalled disk does not stop the socket; what it may pile up is limited.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import socket
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from tiger.logs import cdr, packets, ros
from tiger.logs.frames import LastFrames
from tiger.logs.store import LogFiles
from tiger.logs.topics import CHECKPOINT, FAULT, HEALTH, TICK, WIRE, FaultReport, Health, Tick, WireBytes
from tiger.record import DaemonState

if TYPE_CHECKING:
    from tiger.logs.packets import Entry, Start

READY = b"ready"
LONGEST_PACKET_BYTES = 4_000_000
BACKLOG_BYTES = 64_000_000
FLUSH_PERIOD_S = 0.5
DIAGNOSTICS_PERIOD_NS = 1_000_000_000
OVERDUE = 1.1  # a part may outgrow its size by this while it waits for a checkpoint to end at
NICENESS = 5
STOPPED = (DaemonState.FAULT, DaemonState.ESTOP)


class Receiver(threading.Thread):
    """Moves packets from the socket to a queue; stops taking them while the queue is too long."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(name="receiver", daemon=True)
        self.packets: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._connection = connection
        self._received = self._taken = 0

    def run(self) -> None:
        """Receive until the other end is closed; then put None."""
        space = bytearray(LONGEST_PACKET_BYTES)
        view = memoryview(space)
        while True:
            while self._received - self._taken > BACKLOG_BYTES:
                time.sleep(0.05)
            try:
                size = self._connection.recv_into(space)
            except OSError:
                size = 0
            if size == 0:
                self.packets.put(None)
                return
            self._received += size
            self.packets.put(bytes(view[:size]))

    def take(self, timeout_s: float) -> bytes | None:
        """The next packet, empty after `timeout_s` without one, None at the end."""
        try:
            packet = self.packets.get(timeout=max(timeout_s, 0.0))
        except queue.Empty:
            return b""
        self._taken += len(packet or b"")
        return packet


class LogWriter:
    """Turns entries into messages in files."""

    def __init__(self, start: Start) -> None:
        self._start = start
        self._files = LogFiles(start)
        self._frames = LastFrames()
        self._newness = ros.Newness()
        self._health = Health((), ())
        self._health_data = b""
        self._state = DaemonState.DISCONNECTED
        self._diagnosed_ns = 0

    def take(self, entry: Entry) -> None:
        """Write one entry, and what follows from it."""
        t_ns, topic, data = entry
        if topic.startswith(WIRE):
            self._wire(t_ns, topic, data)
            return
        if topic == CHECKPOINT:
            self._rotate(self._start.part_bytes, t_ns)
        self._files.write(topic, t_ns, data)
        if topic == TICK:
            self._tick(t_ns, cdr.message(Tick).unpack(data))
        elif topic == HEALTH:
            self._health, self._health_data = cdr.message(Health).unpack(data), data

    def flush(self) -> None:
        """Bring everything to the disk."""
        self._files.flush()

    def close(self) -> None:
        """Finish the file."""
        self._files.close()

    def _wire(self, t_ns: int, topic: str, data: bytes) -> None:
        port, _, direction = topic.removeprefix(WIRE).rpartition("/")
        self._frames.feed(port, data, t_ns, sent=direction == "tx")
        self._write(topic, t_ns, WireBytes(data))

    def _tick(self, t_ns: int, tick: Tick) -> None:
        for topic, sample_ns, value in ros.messages(tick, self._newness, self._start.epoch_ns):
            self._write(topic, t_ns, value, sample_ns)
        changed, self._state = tick.state is not self._state, tick.state
        if changed and tick.state in STOPPED:
            frames = self._frames.report()
            report = FaultReport(tick.tick, tick.state, tick.reason, self._health.problems, frames)
            self._write(FAULT, t_ns, report)
            self.flush()
        if changed or t_ns - self._diagnosed_ns >= DIAGNOSTICS_PERIOD_NS:
            self._diagnosed_ns = t_ns
            drives = (tick.inputs.drive_left, tick.inputs.drive_right)
            topic, at_ns, value = ros.diagnostics(tick, self._health, drives, t_ns)
            self._write(topic, t_ns, value, at_ns)
            self._rotate(int(self._start.part_bytes * OVERDUE), t_ns)

    def _write(self, topic: str, t_ns: int, value: Any, sample_ns: int | None = None) -> None:
        kind: cdr.Message[Any] = cdr.message(type(value))
        self._files.write(topic, t_ns, kind.pack(value), sample_ns)

    def _rotate(self, limit_bytes: int, t_ns: int) -> None:
        if self._files.size < limit_bytes:
            return
        self._files.next_part()
        if self._health_data:
            self._files.write(HEALTH, t_ns, self._health_data)


def serve(connection: socket.socket) -> None:
    """Write a log until the other end of `connection` is closed. Raises OSError when the disk fails."""
    start = packets.Start.unpack(connection.recv(LONGEST_PACKET_BYTES))
    writer = LogWriter(start)
    connection.send(READY)
    receiver = Receiver(connection)
    receiver.start()
    due_s = time.monotonic() + FLUSH_PERIOD_S
    while (packet := receiver.take(due_s - time.monotonic())) is not None:
        for entry in packets.unpack(packet):
            writer.take(entry)
        if time.monotonic() >= due_s:
            writer.flush()
            due_s = time.monotonic() + FLUSH_PERIOD_S
    writer.close()


def _be_modest() -> None:
    """Give back what was inherited from a real-time process, and yield to everyone."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    with contextlib.suppress(OSError):
        os.nice(NICENESS)


def main(descriptor: int) -> int:
    """Serve the socket behind a descriptor; returns the exit status."""
    _be_modest()
    connection = socket.socket(fileno=descriptor)
    try:
        serve(connection)
    except OSError as error:
        text = f"log: {error.strerror or error} ({error.filename or 'the log file'})"
        try:
            connection.send(text.encode())  # the daemon tells it
        except OSError:
            print(text, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
