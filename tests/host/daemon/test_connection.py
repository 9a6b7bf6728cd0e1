"""One port: opened when due, closed by its first error, opened again with growing pauses."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import pytest

from tiger.daemon.connection import FIRST_PAUSE_S, LONGEST_PAUSE_S, Connection


@dataclass
class FakePort:
    """A serial line that can be pulled out."""

    incoming: bytes = b""
    backlog: int = 0
    gone: bool = False
    closed: bool = False
    written: list[bytes] = field(default_factory=list)

    def read(self) -> bytes:
        self._there()
        data, self.incoming = self.incoming, b""
        return data

    def write(self, data: bytes) -> None:
        self._there()
        self.written.append(data)

    def close(self) -> None:
        self.closed = True

    def _there(self) -> None:
        if self.gone:
            raise OSError(5, "Input/output error")


@dataclass
class FakePorts:
    """A computer with one socket, in which nothing or `port` is plugged."""

    port: FakePort | None = None
    tries: int = 0

    def open(self, path: str, baud: int) -> FakePort:
        self.tries += 1
        if self.port is None:
            raise FileNotFoundError(2, "No such file or directory", path)
        return self.port


def make(port: FakePort | None = None) -> tuple[Connection, FakePorts]:
    ports = FakePorts(port)
    return Connection(ports, "/dev/x", 500_000), ports  # type: ignore[arg-type]


def test_it_says_exactly_once_that_it_was_opened() -> None:
    connection, ports = make()
    assert not connection.is_open
    assert not connection.was_open
    assert not connection.open_if_due(0.0)  # nothing is plugged in
    assert "/dev/x" in str(connection.problem)
    assert not connection.was_open
    ports.port = FakePort()
    assert not connection.open_if_due(0.99 * FIRST_PAUSE_S)
    assert connection.open_if_due(FIRST_PAUSE_S)
    assert (connection.is_open, connection.was_open, connection.problem) == (True, True, None)
    assert not connection.open_if_due(2.0)


def test_the_pause_doubles_up_to_the_longest_until_something_arrives() -> None:
    connection, ports = make()
    tried_s, now_s = [], 0.0
    while now_s < 20.0:
        before = ports.tries
        connection.open_if_due(now_s)
        if ports.tries > before:
            tried_s.append(now_s)
        now_s += 1.0 / 64.0
    pauses = [b - a for a, b in pairwise(tried_s)]
    assert pauses[:6] == [0.25, 0.5, 1.0, 2.0, LONGEST_PAUSE_S, LONGEST_PAUSE_S]

    ports.port = FakePort(incoming=b"hello")
    assert connection.open_if_due(40.0)
    assert connection.read(40.0) == b"hello"
    ports.port.gone = True
    assert connection.read(41.0) == b""
    assert not connection.open_if_due(41.0 + 0.99 * FIRST_PAUSE_S)
    assert connection.open_if_due(41.0 + FIRST_PAUSE_S)


def test_a_port_that_opens_and_says_nothing_is_not_tried_ever_faster() -> None:
    connection, _ = make(FakePort(gone=True))
    for pause_s, now_s in ((0.25, 0.0), (0.5, 10.0), (1.0, 20.0)):
        assert connection.open_if_due(now_s)
        assert connection.read(now_s) == b""
        assert not connection.open_if_due(now_s + 0.99 * pause_s)


@pytest.mark.parametrize("does", ["read", "write"])
def test_the_first_error_closes_it_and_is_said(does: str) -> None:
    port = FakePort()
    connection, _ = make(port)
    connection.open_if_due(0.0)
    port.gone = True
    if does == "read":
        connection.read(0.1)
    else:
        connection.write(b"x", 0.1)
    assert port.closed
    assert not connection.is_open
    assert connection.was_open
    assert connection.problem is not None


def test_what_the_device_did_not_take_is_sent_on_and_nothing_else() -> None:
    port = FakePort()
    connection, _ = make(port)
    connection.write(b"early", 0.0)
    assert not connection.has_room
    connection.open_if_due(0.0)
    assert connection.has_room
    connection.write(b"", 0.1)
    connection.write(b"a", 0.2)
    port.backlog = 3
    assert not connection.has_room
    connection.write(b"", 0.3)
    assert port.written == [b"a", b""]
