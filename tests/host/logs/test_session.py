"""The log's process: it never holds up the control loop, survives everyone, and loses at most a second."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from tiger.config.robot import load_robot
from tiger.daemon.clock import MonotonicClock
from tiger.logs.doctor import examine
from tiger.logs.errors import LogError
from tiger.logs.reader import open_log
from tiger.logs.session import TICKS_PER_PACKET, LogSession
from tiger.logs.summary import summarise
from tiger.logs.topics import WIRE, wire_topic
from tiger.protocol.frame import FrameDecoder
from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from tests.host.logs.conftest import Run

    from tiger.config.robot import RobotConfig
    from tiger.record import Record

TICK_S = 0.005
CHUNK = bytes(range(1, 33)) + b"\0"


@pytest.fixture
def robot():
    return load_robot()


def _ticks(run: Run) -> Iterator[Record]:
    """Ticks without end, numbered through."""
    number = 0
    while True:
        for record in run.records:
            yield replace(record, tick=number)
            number += 1


def _hand_over(log: LogSession, records: Iterator[Record], seconds: float, chunks: int = 4) -> list[int]:
    """Hand over ticks at 200 Hz; returns the numbers of those handed over."""
    handed = []
    end_s = due_s = time.monotonic()
    end_s += seconds
    while time.monotonic() < end_s:
        for port in range(chunks):
            log.wire(f"/dev/port{port}", CHUNK, sent=False)
        record = next(records)
        log.record(record)
        handed.append(record.tick)
        due_s += TICK_S
        time.sleep(max(due_s - time.monotonic(), 0.0))
    return handed


def _pid(log: LogSession) -> int:
    assert log._process is not None
    return log._process.pid


def test_what_was_handed_over_comes_back_exactly(run: Run) -> None:
    assert [record for _, record in open_log(run.folder).records()] == run.records


def test_a_finished_log_passes_every_check(run: Run) -> None:
    for file in open_log(run.folder).files:
        assert examine(file.path) == []


def test_times_are_those_of_the_clock(run: Run) -> None:
    times = [t_ns for t_ns, _ in open_log(run.folder).records()]
    assert times[0] == 1_700_000_000_000_000_000 + 5_000_000
    assert {b - a for a, b in pairwise(times)} == {5_000_000}


def test_the_log_says_how_it_came_about(run: Run) -> None:
    log = open_log(run.folder)
    assert log.robot() == run.rig.config
    assert {"version", "git_revision", "schema_mega_suspension", "schema_nano_imu"} <= set(log.about)
    assert "[message.imu_attitude]" in log.files[0].attachments["tiger.toml"]


def test_what_goes_out_after_the_last_tick_is_in_the_log(run: Run, robot, tmp_path: Path) -> None:
    """As the daemon ends it disarms, and ticks no more."""
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        log.record(run.records[-1])
        log.wire("/dev/port0", b"last words", sent=True)
    topic = wire_topic("/dev/port0", sent=True)
    assert [bytes(m.value().data) for m in open_log(tmp_path).messages([topic])] == [b"last words"]


def test_every_byte_of_every_line_is_in_the_log(run: Run) -> None:
    """Frames are counted twice: by the decoders of the daemon, and again from the log."""
    log = open_log(run.folder)
    for path, port in run.rig.daemon.boards.ports.items():
        topic = wire_topic(path, sent=False)
        data = b"".join(logged.value().data for logged in log.messages((topic,)))
        assert port.link is not None
        then, again = port.link.decoder, FrameDecoder(port.link.decoder.known)
        again.feed(data)
        assert again.frames + sum(again.rejects) == then.frames + sum(then.rejects) > 1000
    topics = {logged.topic for logged in log.messages() if logged.topic.startswith(WIRE)}
    assert len(topics) == 2 * 5


def test_the_last_hundred_frames_of_every_link_are_with_the_fault(run: Run) -> None:
    _, report = summarise(open_log(run.folder)).faults[-1]
    assert report.state is DaemonState.ESTOP
    received = [frame for frame in report.frames if not frame.sent]
    ports = {frame.port for frame in received}
    assert len(ports) == 5
    for port in ports:
        assert sum(frame.port == port for frame in received) == 100
    assert [f.t_ns for f in report.frames] == sorted(f.t_ns for f in report.frames)


def test_standard_messages_carry_the_samples(run: Run) -> None:
    log = open_log(run.folder)
    strokes = {r.inputs.strokes.stroke_mm for r in run.records if r.inputs.strokes}
    joints = [m.value() for m in log.messages(("/joint_states",))]
    legs = [joint for joint in joints if joint.name[0] == "stroke_fl"]
    assert {tuple(round(p * 1e3, 6) for p in leg.position) for leg in legs} == {
        tuple(round(s, 6) for s in stroke) for stroke in strokes
    }
    assert len(legs) == len({r.inputs.strokes for r in run.records if r.inputs.strokes})
    assert any(m.value().status[0].level == 2 for m in log.messages(("/diagnostics",)))


def test_a_killed_writer_loses_at_most_a_second_and_the_loop_goes_on(
    run: Run, robot, tmp_path: Path, record_figure: Callable[[str, object, str], None]
) -> None:
    ticks = _ticks(run)
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        handed = _hand_over(log, ticks, 2.3)
        os.kill(_pid(log), signal.SIGKILL)
        _hand_over(log, ticks, 0.3)
        assert log.problem is not None
        assert "nothing is logged any more" in log.problem
    found = open_log(tmp_path)
    read = [record.tick for _, record in found.records()]
    assert read == handed[: len(read)]
    lost_s = (handed[-1] - read[-1]) * TICK_S
    record_figure("log lost after kill -9, s", lost_s, "<= 1")
    assert lost_s <= 1.0
    findings = examine(found.files[0].path)
    assert len([f for f in findings if "no footer" not in f and "middle of a record" not in f]) == 0


DAEMON = """
import os, signal, sys, time
from tiger.config.robot import load_robot
from tiger.daemon.clock import MonotonicClock
from tiger.logs.session import TICKS_PER_PACKET, LogSession
from tiger.record import DaemonState, Inputs, Outputs, Record
with LogSession(sys.argv[1], load_robot(), MonotonicClock()) as log:
    for tick in range(300):
        log.record(Record(tick, DaemonState.DISARMED, "", Inputs(tick * 0.005, False), Outputs()))
        time.sleep(0.001)
    print(log._process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_daemon_leaves_a_finished_log_with_all_that_was_handed_over(tmp_path: Path) -> None:
    daemon = subprocess.run([sys.executable, "-c", DAEMON, str(tmp_path)], capture_output=True, check=False)
    assert daemon.returncode == -signal.SIGKILL, daemon.stderr
    _wait_for_end(int(daemon.stdout))
    (file,) = open_log(tmp_path).files
    assert examine(file.path) == []
    ticks = [record.tick for _, record in open_log(tmp_path).records()]
    assert ticks == list(range(len(ticks)))
    assert 300 - TICKS_PER_PACKET < len(ticks) <= 300


def _wait_for_end(pid: int) -> None:
    end_s = time.monotonic() + 20.0
    while time.monotonic() < end_s:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123  an orphan may wait for its new parent
            if stat.read().rpartition(")")[2].split()[0] == "Z":
                return
        time.sleep(0.05)
    pytest.fail("the log's process did not end")


def test_signals_meant_for_the_daemon_do_not_end_the_log(run: Run, robot, tmp_path: Path) -> None:
    ticks = _ticks(run)
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(_pid(log), number)
        handed = _hand_over(log, ticks, 0.3)
    assert [record.tick for _, record in open_log(tmp_path).records()] == handed


@pytest.mark.realtime
def test_a_stalled_writer_never_holds_up_the_loop_and_drops_are_counted(
    run: Run, robot, tmp_path: Path
) -> None:
    ticks = _ticks(run)
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        _hand_over(log, ticks, 0.3)
        os.kill(_pid(log), signal.SIGSTOP)
        time.sleep(0.1)
        worst_s = 0.0
        for _ in range(8000):  # far more than the socket holds
            start_s = time.thread_time()
            log.record(next(ticks))
            worst_s = max(worst_s, time.thread_time() - start_s)
        assert log.dropped_packets * TICKS_PER_PACKET > 4000
        assert worst_s < 0.02
        os.kill(_pid(log), signal.SIGCONT)
        time.sleep(0.5)
        _hand_over(log, ticks, 0.5)
        dropped = log.dropped_packets
        assert log.problem is None
    summary = summarise(open_log(tmp_path))
    assert summary.dropped_packets == dropped
    # Almost every packet holds four ticks; one that is sent at once, because the state changed, holds fewer.
    assert 0.98 <= summary.missing_ticks / (TICKS_PER_PACKET * dropped) <= 1.0
    assert examine(open_log(tmp_path).files[0].path) == []


def test_health_is_said_again_after_a_gap(run: Run, robot, tmp_path: Path) -> None:
    last = run.records[-1]
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        os.kill(_pid(log), signal.SIGSTOP)
        time.sleep(0.1)
        while log.dropped_packets < 10:
            log.record(last)
        os.kill(_pid(log), signal.SIGCONT)
        time.sleep(0.5)
        log.record(replace(last, tick=last.tick + 1, links=last.links[:1]))
    assert [record.links for _, record in open_log(tmp_path).records()][-1] == last.links[:1]


def with_room(robot: RobotConfig, **limits: float) -> RobotConfig:
    return robot.model_copy(update={"log": robot.log.model_copy(update=limits)})


def test_a_log_grows_in_parts_and_each_says_what_it_is_about(
    log_a_run: Callable[..., Run], tmp_path: Path
) -> None:
    again = log_a_run(tmp_path, end_s=5.0, part_mb=0.09)
    log = open_log(tmp_path)
    assert len(log.files) >= 2
    assert [record for _, record in log.records()] == again.records
    for i, file in enumerate(log.files):
        assert examine(file.path) == []
        assert file.about["part"] == str(i)
        assert set(file.attachments) == {"robot.json", "tiger.toml"}
        assert file.path.stat().st_size < 400_000
        _, first = next(open_log(file.path).records())
        assert first == again.records[first.tick]  # the links' health included
    assert summarise(log).parts_before == 0
    log.files[0].path.unlink()
    assert summarise(open_log(tmp_path)).parts_before == 1


def test_the_oldest_parts_give_way_when_all_together_are_too_large(robot, tmp_path: Path) -> None:
    old = tmp_path / "tiger-20200101-000000-000.mcap"
    old.write_bytes(bytes(2_000_000))
    mine = tmp_path / "precious.mcap"
    mine.write_bytes(bytes(2_000_000))
    with LogSession(tmp_path, with_room(robot, total_mb=1.0), MonotonicClock()):
        pass
    assert not old.exists()
    assert mine.exists()


def test_the_thousandth_part_is_newer_than_the_one_before(robot, tmp_path: Path) -> None:
    session = "tiger-20200101-000000"
    parts = [
        tmp_path / f"{session}{again}-{part:03d}.mcap" for again in ("", "_2", "_10") for part in (999, 1000)
    ]
    for part in parts:
        part.write_bytes(bytes(1_000_000))
    assert [file.path for file in open_log(tmp_path).files] == parts[-2:]
    with LogSession(tmp_path, with_room(robot, total_mb=3.5), MonotonicClock()):
        pass
    assert [part.exists() for part in parts] == [False, False, False, True, True, True]


def test_a_clock_that_was_set_back_lets_the_logs_of_later_dates_give_way(robot, tmp_path: Path) -> None:
    later = tmp_path / "tiger-29990101-000000-000.mcap"
    later.write_bytes(bytes(2_000_000))
    with LogSession(tmp_path, with_room(robot, total_mb=1.0), MonotonicClock()) as log:
        pass
    assert not later.exists()
    assert log.path.exists()


def test_a_folder_that_cannot_be_written_is_said_before_anything_runs(robot, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(LogError, match="Choose another folder"),
        LogSession(tmp_path / "file", robot, MonotonicClock()),
    ):
        pass


def test_a_full_disk_ends_the_log_and_not_the_loop(run: Run, robot, tmp_path: Path) -> None:
    """A limit of the file size stands for the full disk."""
    import resource

    ticks = _ticks(run)
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        limit = (200_000, 200_000)
        resource.prlimit(_pid(log), resource.RLIMIT_FSIZE, limit)
        _hand_over(log, ticks, 0.5, chunks=8)
        end_s = time.monotonic() + 20.0
        while log.problem is None and time.monotonic() < end_s:
            _hand_over(log, ticks, 0.5, chunks=8)
        assert log.problem is not None
        assert "nothing is logged any more" in log.problem
    assert sum(1 for _ in open_log(tmp_path).records()) > 0


@pytest.mark.realtime
def test_five_thousand_messages_a_second_are_sustained(
    run: Run, robot, tmp_path: Path, record_figure: Callable[[str, object, str], None]
) -> None:
    """25 pieces of wire with each tick, 200 ticks a second; with what is derived from them about 6 000/s."""
    ticks = _ticks(run)
    start_s = time.monotonic()
    with LogSession(tmp_path, robot, MonotonicClock()) as log:
        handed = _hand_over(log, ticks, 5.0, chunks=25)
        handed_s = time.monotonic() - start_s
        behind_s = time.monotonic()
    behind_s = time.monotonic() - behind_s
    assert log.dropped_packets == 0
    assert len(handed) > 900, "the machine is too busy to hand over at 200 Hz"
    count = sum(1 for _ in open_log(tmp_path).messages())
    record_figure("log messages per second", count / handed_s, ">= 5000")
    assert count / handed_s >= 5000
    assert behind_s < 2.0, "the writer piled up work"
