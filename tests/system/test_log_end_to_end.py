"""`tiger run --log` as a person uses it: killed, stalled, stopped by a fault; what is in the log then?"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tiger.logs.doctor import examine
from tiger.logs.reader import open_log
from tiger.logs.replay import replay
from tiger.logs.summary import summarise
from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import IO

pytestmark = pytest.mark.realtime

NS_PER_S = 1e9
LOST_BAR_S = 1.0
FRAMES_KEPT = 100
CABLE_CUT = """
title = "Standing, until a cable is cut"
duration_s = 8.0
model = "linear"

[[fault]]
at_s = 6.0
target = "suspension"
kind = "cut"
"""


@contextlib.contextmanager
def running(folder: Path, *options: str, scenario: str = "shaking-plate") -> Iterator[subprocess.Popen[str]]:
    """`tiger run` on the emulated robot with a log, armed."""
    command = [sys.executable, "-m", "tiger.cli.main", "run", "--emulate", scenario]
    command += ["--log", str(folder / "log"), *options]
    own_socket = {**os.environ, "TIGER_SOCKET": str(folder / "robot.sock"), "PYTHONUNBUFFERED": "1"}
    pipe, both = subprocess.PIPE, subprocess.STDOUT
    with subprocess.Popen(command, text=True, env=own_socket, stdout=pipe, stderr=both) as daemon:
        try:
            seen = []
            for line in said_by(daemon):
                seen.append(line)
                if "ARMED: armed" in line:
                    break
            else:
                pytest.fail("".join(seen))
            yield daemon
        finally:
            daemon.kill()


def said_by(daemon: subprocess.Popen[str]) -> IO[str]:
    """What it prints."""
    assert daemon.stdout is not None
    return daemon.stdout


def log_process(daemon: subprocess.Popen[str]) -> int:
    """The process that writes the daemon's log."""
    for children in Path(f"/proc/{daemon.pid}/task").glob("*/children"):
        for child in children.read_text().split():
            if "tiger.logs.writer" in Path(f"/proc/{child}/cmdline").read_text().replace("\0", " "):
                return int(child)
    raise AssertionError("the daemon has no log process")


def test_after_kill_9_of_everything_the_log_is_readable_to_its_last_second_and_replays_exactly(
    tmp_path: Path, record_figure: Callable[[str, object, str], None]
) -> None:
    with running(tmp_path) as daemon:
        writer = log_process(daemon)
        time.sleep(3.3)
        killed_ns = time.time_ns()
        os.kill(writer, signal.SIGKILL)
        os.kill(daemon.pid, signal.SIGKILL)
    log = open_log(tmp_path / "log")
    *_, (last_ns, last) = log.records()
    lost_s = (killed_ns - last_ns) / NS_PER_S
    record_figure("`tiger run --log`, kill -9 of the daemon and the log's process: lost, s", lost_s, "<= 1")
    assert last.state is DaemonState.ARMED
    assert 0.0 <= lost_s <= LOST_BAR_S
    (file,) = log.files
    assert [f for f in examine(file.path) if "no footer" not in f and "middle of a record" not in f] == []
    found = replay(log)
    record_figure(
        "  and replayed from what is left: ticks, differences", (found.ticks, found.different_ticks), "0"
    )
    assert found.exact
    assert found.ticks > 3 * 200


def test_on_a_fault_the_last_hundred_frames_of_every_link_are_in_the_log(tmp_path: Path) -> None:
    scenario = tmp_path / "cut.toml"
    scenario.write_text(CABLE_CUT)
    with running(tmp_path, "--virtual-time", scenario=str(scenario)) as daemon:
        said = "".join(said_by(daemon))
        assert daemon.wait(30.0) == 1
    assert "Stopped at" in said
    log = open_log(tmp_path / "log")
    assert [finding for file in log.files for finding in examine(file.path)] == []
    ((_, report),) = summarise(log).faults
    assert report.state is DaemonState.FAULT
    assert report.problems
    frames = Counter((frame.port, frame.sent) for frame in report.frames)
    assert len(frames) == 2 * 5  # five lines, both ways
    assert all(count == FRAMES_KEPT for (_, sent), count in frames.items() if not sent)
    assert all(count <= FRAMES_KEPT for count in frames.values())
    assert replay(log).exact


def test_what_a_stalled_log_drops_is_in_the_summary_and_said(tmp_path: Path) -> None:
    report = tmp_path / "run.json"
    with running(tmp_path, "--virtual-time", "--duration", "90", "--json", str(report)) as daemon:
        writer = log_process(daemon)
        os.kill(writer, signal.SIGSTOP)
        assert any("log: lags behind, ticks are not logged" in line for line in said_by(daemon))
        os.kill(writer, signal.SIGCONT)
        said = "".join(said_by(daemon))
        assert daemon.wait(30.0) == 0, said
    summary = json.loads(report.read_text())["summary"]
    dropped = summary["log"]["dropped_packets"]
    assert dropped > 0
    assert summary["log"]["problem"] is None
    assert f"log: goes on; {dropped} packets were dropped while it lagged behind" in said
    assert summarise(open_log(tmp_path / "log")).dropped_packets == dropped
