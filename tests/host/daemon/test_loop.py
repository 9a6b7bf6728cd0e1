"""The loop in real time, its punctuality, and ports that come and go."""

from __future__ import annotations

import errno
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import load_robot
from tiger.daemon import loop
from tiger.daemon.clock import Lateness, MonotonicClock, VirtualClock
from tiger.daemon.connection import FIRST_PAUSE_S, LONGEST_PAUSE_S, Connection
from tiger.daemon.daemon import Daemon
from tiger.record import DaemonState, Record


class NoPorts:
    """A computer without serial devices."""

    def present(self, patterns: Any) -> list[str]:
        return []

    def same(self, path: str, other: str) -> bool:
        return path == other

    def open(self, path: str, baud: int) -> Any:
        raise OSError(errno.ENOENT, "no such file", path)


def test_ticks_keep_to_the_grid_of_the_control_period() -> None:
    robot = load_robot(None)
    clock = MonotonicClock()
    daemon = Daemon(robot, NoPorts(), clock)
    records: list[Record] = []

    def keep(record: Record) -> bool:
        records.append(record)
        return True

    lateness = loop.run(daemon, clock, keep, duration_s=0.5)
    # A busy computer may miss ticks, but never makes up for them.
    assert 20 <= len(records) <= 101
    assert lateness.ticks == len(records) - 1
    assert all(record.state is DaemonState.DISCONNECTED for record in records)


def test_a_stall_is_not_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualClock()

    monkeypatch.setattr("time.sleep", lambda seconds: clock.set(clock.now_s() + seconds + 1e-9))
    daemon = Daemon(load_robot(None), NoPorts(), clock)
    times: list[float] = []

    def keep(record: Record) -> bool:
        times.append(clock.now_s())
        if record.tick == 3:
            clock.set(clock.now_s() + 0.052)
        return True

    loop.run(daemon, clock, keep, duration_s=0.1)
    pauses_ms = [round((b - a) * 1e3) for a, b in pairwise(times)]
    assert pauses_ms[:6] == [5, 5, 5, 52, 3, 5]  # late once, then back on the grid


def test_the_loop_ends_when_told() -> None:
    clock = MonotonicClock()
    daemon = Daemon(load_robot(None), NoPorts(), clock)
    assert loop.run(daemon, clock, lambda record: record.tick < 3).ticks == 3


def test_a_computer_without_ports_is_told_what_to_do() -> None:
    clock = VirtualClock()
    daemon = Daemon(load_robot(None), NoPorts(), clock)
    for tick in range(2000):
        clock.set(tick * 0.005)
        record = daemon.tick(tick * 0.005)
    text = "\n".join(map(str, record.problems))
    assert "mega_suspension: was not found on /dev/ttyACM* /dev/ttyUSB* (no such device is there)" in text
    assert "/dev/tiger-roboteq-left: is not there" in text


def test_what_the_system_refuses_is_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(loop.os, "sched_setscheduler", refuse)
    config = load_robot(None).loop.model_copy(update={"realtime_priority": 40})
    (refused,) = loop.prepare(config)
    assert "loop.realtime_priority = 40: Operation not permitted; allow it with" in refused


@pytest.mark.parametrize(
    ("cpu", "had", "kept"),
    [(2, {0, 1, 2, 3}, [{0, 1, 3}]), (0, {0}, []), (-1, {0, 1}, []), (5, {0, 1}, [{0, 1}])],
)
def test_what_is_started_beside_the_loop_keeps_off_its_core(
    monkeypatch: pytest.MonkeyPatch, cpu: int, had: set[int], kept: list[set[int]]
) -> None:
    given_to: list[set[int]] = []
    monkeypatch.setattr(loop.os, "sched_getaffinity", lambda _: had)
    monkeypatch.setattr(loop.os, "sched_setaffinity", lambda _, cores: given_to.append(cores))
    loop.make_room(load_robot(None).loop.model_copy(update={"cpu": cpu}))
    assert given_to == kept


# ------------------------------------------------------------------------------------------------ punctuality


@given(st.lists(st.floats(0.0, 0.019), min_size=1, max_size=300))
def test_percentiles_are_right_to_a_bucket(values: list[float]) -> None:
    lateness = Lateness()
    for value in values:
        lateness.add(value)
    ordered = sorted(values)
    for percent in (50.0, 99.0, 100.0):
        index = max(-(-len(values) * int(percent) // 100) - 1, 0)
        assert lateness.percentile_us(percent) >= ordered[index] * 1e6 - 1e-6
        assert lateness.percentile_us(percent) <= ordered[index] * 1e6 + 10.0 + 1e-6
    assert lateness.max_us == pytest.approx(max(values) * 1e6)


def test_a_very_late_tick_is_not_forgotten() -> None:
    lateness = Lateness()
    for value in (0.0001, 0.5):
        lateness.add(value)
    assert lateness.summary() == {"ticks": 2, "p50_us": 110.0, "p99_us": 500000.0, "max_us": 500000.0}


# ------------------------------------------------------------------------------------------------ connections


class Plug:
    """A provider of one port that can be pulled."""

    def __init__(self) -> None:
        self.plugged = False
        self.tries = 0

    def open(self, path: str, baud: int) -> Any:
        self.tries += 1
        if not self.plugged:
            raise OSError(errno.ENOENT, "gone")
        return SimpleNamespace(name=path, backlog=0, read=self._read, write=self._write, close=lambda: None)

    def _read(self) -> bytes:
        if not self.plugged:
            raise OSError(errno.EIO, "gone")
        return b"x"

    def _write(self, data: bytes) -> None:
        self._read()


def test_a_port_is_opened_again_with_growing_pauses() -> None:
    plug = Plug()
    connection = Connection(plug, "/dev/x", 9600)  # type: ignore[arg-type]
    tries = []
    for ms in range(20_000):
        before = plug.tries
        connection.open_if_due(ms * 1e-3)
        tries += [ms * 1e-3] * (plug.tries - before)
    assert tries == pytest.approx([0.0, 0.25, 0.75, 1.75, 3.75, 7.75, 11.75, 15.75, 19.75])
    assert connection.problem is not None
    plug.plugged = True
    assert connection.open_if_due(30.0)
    assert connection.problem is None
    assert connection.read(30.0) == b"x"
    plug.plugged = False
    assert connection.read(30.1) == b""
    assert not connection.is_open
    assert "was unplugged" in str(connection.problem)
    plug.plugged = True
    assert not connection.open_if_due(30.1 + 0.5 * FIRST_PAUSE_S)
    assert connection.open_if_due(30.1 + 1.1 * FIRST_PAUSE_S)
    assert LONGEST_PAUSE_S == 4.0


def test_a_failed_write_closes_the_port() -> None:
    plug = Plug()
    plug.plugged = True
    connection = Connection(plug, "/dev/x", 9600)  # type: ignore[arg-type]
    connection.open_if_due(0.0)
    plug.plugged = False
    connection.write(b"abc", 0.0)
    assert not connection.is_open
    assert not connection.has_room
