"""The loop keeps time: `tiger run` as it runs on the robot, at 200 Hz over pseudo-terminals, in adversity.

The emulated robot has the other core and a scheduling class in which no load slows it down, as none would
slow down hardware; a spinning program fills what it leaves of that core. While the loop runs, its log's
process is stalled, as by a disk that does not answer, and the process that draws the terminal is killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from tiger.devices.roboteq import PATIENCE_S
from tiger.logs.reader import LogFile
from tiger.protocol.frame import FrameDecoder
from tiger.protocol.messages import FROM_BOARD, BoardKind, Health

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.realtime

LOOP_CPU, ROBOT_CPU = 0, 1
LOOP_PRIORITY, ROBOT_PRIORITY = 40, 10
STALL_S = 4.0
START_S = 120.0  # the first start on a computer compiles the vehicle model
LATENESS_BAR_US = 1000.0
CPU_BAR = 0.15
MOST_MISSED_TICKS = 20  # the first tick opens the ports


def _punctual(process: int, priority: int) -> bool:
    """Give a process SCHED_FIFO and the robot's core; returns whether that is permitted."""
    try:
        os.sched_setscheduler(process, os.SCHED_FIFO, os.sched_param(priority))
        os.sched_setaffinity(process, {ROBOT_CPU})
    except OSError:
        return False
    return True


@pytest.fixture(autouse=True)
def permitted() -> None:
    """Leave these tests out where the operating system does not let a user be punctual."""
    with subprocess.Popen(["sleep", "10"]) as process:
        allowed = _punctual(process.pid, ROBOT_PRIORITY)
        process.kill()
    if not allowed:
        pytest.skip("needs two cores and the permission for SCHED_FIFO (docs/realtime.md)")


class Proof(NamedTuple):
    """What a run left behind."""

    summary: dict[str, Any]
    core_share: float  # processor time of the daemon's process over wall time
    health: Health  # of mega_suspension, its last
    messages: int  # in the log
    stolen_s: float  # processor time that the host of this computer gave to others meanwhile


@contextlib.contextmanager
def _program(command: list[str], **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, **options)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextlib.contextmanager
def _emulated_robot(folder: Path) -> Iterator[None]:
    """The robot behind pseudo-terminals, which no load of this computer slows down."""
    robot = ["-m", "tiger.cli.main", "emulate", "shaking-plate", "--folder", str(folder)]
    with _program([sys.executable, *robot], stdout=subprocess.DEVNULL) as process:
        deadline_s = time.monotonic() + START_S
        while not (folder / "robot.toml").exists():
            assert process.poll() is None, "the emulated robot ended"
            assert time.monotonic() < deadline_s, "the emulated robot did not start"
            time.sleep(0.1)
        _punctual(process.pid, ROBOT_PRIORITY)
        yield


@contextlib.contextmanager
def _terminal() -> Iterator[int]:
    """A terminal that someone reads."""
    master, slave = pty.openpty()

    def watch() -> None:
        with contextlib.suppress(OSError):
            while os.read(master, 65536):
                pass

    reader = threading.Thread(target=watch, daemon=True)
    reader.start()
    try:
        yield slave
    finally:
        os.close(slave)
        reader.join(5.0)
        os.close(master)


def _child(parent: int, told_by: str) -> int:
    """Process that `parent` started with `told_by` in its command."""
    for children in Path(f"/proc/{parent}/task").glob("*/children"):
        for child in children.read_text().split():
            if told_by in Path(f"/proc/{child}/cmdline").read_text().replace("\0", " "):
                return int(child)
    raise AssertionError(f"no process with {told_by!r}")


def _processor_time_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    user, system = int(fields[11]), int(fields[12])
    return (user + system) / os.sysconf("SC_CLK_TCK")


def _stolen_s() -> float:
    """Time that virtual processors of this computer were ready and not run, since it started."""
    return int(Path("/proc/stat").read_text().split("\n", 1)[0].split()[8]) / os.sysconf("SC_CLK_TCK")


def _last_health(log: Path) -> tuple[Health, int]:
    """The last HEALTH of mega_suspension in a log of any number of parts, and how many messages it has."""
    decoder = FrameDecoder(FROM_BOARD[BoardKind.MEGA_SUSPENSION])
    messages, last = 0, None
    for part in sorted(log.glob("*.mcap")):
        for logged in LogFile(part).messages():
            messages += 1
            if logged.topic.endswith("board_suspension/rx"):
                for received in decoder.feed(logged.value().data):
                    if isinstance(received.message, Health) and received.message.node == 0:
                        last = received.message
    assert last is not None, "the log has no HEALTH of mega_suspension"
    return last, messages


def _run(folder: Path, duration_s: float) -> Proof:
    """Run for so long, stall the log after a third of it and kill the screen after two thirds."""
    lines, log, report = folder / "lines", folder / "log", folder / "run.json"
    config = folder / "punctual.toml"
    spin = [sys.executable, "-c", f"import os; os.sched_setaffinity(0, {{{ROBOT_CPU}}})\nwhile True: pass"]
    with _emulated_robot(lines), _program(spin), _terminal() as terminal:
        config.write_text(
            (lines / "robot.toml").read_text()
            + f"[loop]\nrealtime_priority = {LOOP_PRIORITY}\nlock_memory = true\ncpu = {LOOP_CPU}\n"
        )
        command = [sys.executable, "-m", "tiger.cli.main", "run", "--config", str(config), "--arm"]
        own_socket = {**os.environ, "TIGER_SOCKET": str(folder / "robot.sock")}
        command += ["--duration", str(duration_s), "--log", str(log), "--json", str(report)]
        with _program(command, stdout=terminal, env=own_socket) as daemon:
            began_s = _wait_for_loop(daemon)
            time.sleep(5.0)
            measured_s, used_s = time.monotonic(), _processor_time_s(daemon.pid)
            stolen_s = _stolen_s()
            time.sleep(duration_s / 3.0 - 5.0)
            writer = _child(daemon.pid, "tiger.logs.writer")
            os.kill(writer, signal.SIGSTOP)
            time.sleep(STALL_S)
            os.kill(writer, signal.SIGCONT)
            time.sleep(duration_s / 3.0 - STALL_S)
            os.kill(_child(daemon.pid, "spawn_main"), signal.SIGKILL)
            time.sleep(max(began_s + duration_s - 2.0 - time.monotonic(), 0.0))
            used_s = _processor_time_s(daemon.pid) - used_s
            measured_s, stolen_s = time.monotonic() - measured_s, _stolen_s() - stolen_s
            assert daemon.wait(60.0) == 0, report.read_text()[:2000] if report.exists() else "no report"
    summary = json.loads(report.read_text())["summary"]
    health, messages = _last_health(log)
    return Proof(summary, used_s / measured_s, health, messages, stolen_s)


def _wait_for_loop(daemon: subprocess.Popen[bytes]) -> float:
    """Wait until the loop has its priority: the start is over by then. Returns the time."""
    deadline_s = time.monotonic() + START_S
    while os.sched_getscheduler(daemon.pid) != os.SCHED_FIFO:
        assert daemon.poll() is None, "the daemon ended"
        assert time.monotonic() < deadline_s, "the loop did not start"
        time.sleep(0.05)
    return time.monotonic()


def _demand_nothing_lost(
    proof: Proof, duration_s: float, record_figure: Callable[[str, object, str], None]
) -> None:
    late, links = proof.summary["lateness_us"], proof.summary["links"]
    what = f"loop at 200 Hz for {duration_s:g} s:"
    record_figure(f"{what} p99 lateness, us", late["p99_us"], f"<= {LATENESS_BAR_US:g}")
    record_figure(f"{what} median lateness, us", late["p50_us"], "reported")
    record_figure(f"{what} longest lateness, us", late["max_us"], "reported")
    record_figure(f"{what} setpoints lost", proof.health.seq_gaps, "0")
    record_figure(f"{what} setpoints too old", proof.health.setpoint_rejects, "0")
    record_figure(f"{what} share of a core", proof.core_share, f"<= {CPU_BAR:g}")
    record_figure(f"{what} messages in the log", proof.messages, "reported")
    record_figure(f"{what} taken by this computer's host, s", proof.stolen_s, "reported")

    assert proof.summary["stops"] == []
    assert proof.summary["state"] == "ARMED"
    assert (proof.health.seq_gaps, proof.health.setpoint_rejects) == (0, 0)
    assert sum(proof.health.rejects) == 0
    assert {name: link["refused_by_board"] for name, link in links.items()} == dict.fromkeys(links, 0)
    lost = {name: link["lost"] for name, link in links.items() if link["lost"]}
    assert not lost or proof.stolen_s > PATIENCE_S, lost


def test_keeps_time_while_a_core_spins_the_log_stalls_and_the_screen_dies(
    tmp_path: Path, record_figure: Callable[[str, object, str], None]
) -> None:
    """What the loop's speed may be is for the proof to say: this computer may be busy."""
    _demand_nothing_lost(_run(tmp_path, 24.0), 24.0, record_figure)


@pytest.mark.proof
@pytest.mark.timeout(1000)
def test_keeps_time_for_ten_minutes(
    tmp_path: Path, record_figure: Callable[[str, object, str], None]
) -> None:
    proof = _run(tmp_path, 600.0)
    _demand_nothing_lost(proof, 600.0, record_figure)
    late = proof.summary["lateness_us"]
    assert late["ticks"] >= 600.0 * 200 - MOST_MISSED_TICKS
    assert late["p99_us"] <= LATENESS_BAR_US
    assert proof.core_share <= CPU_BAR
