"""The shaking plate in real time: the emulated robot in its own process behind pseudo-terminals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.realtime

STEP_S = 5.0
BAND_DEG = 0.5


def test_levels_in_real_time_as_in_virtual_time(
    tmp_path: Path, rate_bound_s: float, record_figure: Callable[[str, object, str], None]
) -> None:
    report = tmp_path / "run.json"
    command = [sys.executable, "-m", "tiger.cli.main", "run", "--emulate", "shaking-plate"]
    done = subprocess.run(
        [*command, "--duration", "14", "--json", str(report)], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stdout + done.stderr
    read = json.loads(report.read_text())
    summary, series = read["summary"], read["series"]
    assert summary["first_armed_s"] < STEP_S, done.stdout

    time_s = np.array(series["time_s"], dtype=float)
    tilt = np.abs(np.array([series["roll_true_deg"], series["pitch_true_deg"]], dtype=float)).max(axis=0)
    settled_s = time_s[(time_s > STEP_S) & (tilt >= BAND_DEG)].max() - STEP_S
    record_figure("real time over pseudo-terminals: time to 0.5 degrees", settled_s, "3.3 s")
    assert settled_s <= 1.25 * rate_bound_s + 0.2  # the two clocks start within 0.2 s of each other

    lateness = summary["lateness_us"]
    record_figure("control loop's p99 lateness, us", lateness["p99_us"], "reported")
    assert lateness["ticks"] > 14 * 200 * 0.9  # a busy computer may miss ticks
    assert lateness["p99_us"] > 0.0
    assert "late by" in done.stdout


def _emulated_robot_of(process: int) -> int:
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        for child in children.read_text().split():
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                return int(child)
    raise AssertionError("the emulated robot has no process")


def _stall(process: int, seconds: float) -> None:
    os.kill(process, signal.SIGSTOP)
    time.sleep(seconds)
    os.kill(process, signal.SIGCONT)


def test_a_computer_that_stalls_stops_no_emulated_robot(tmp_path: Path) -> None:
    report = tmp_path / "run.json"
    command = [sys.executable, "-m", "tiger.cli.main", "run", "--emulate", "shaking-plate"]
    command += ["--duration", "12", "--json", str(report)]
    own_socket = {**os.environ, "TIGER_SOCKET": str(tmp_path / "robot.sock"), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=own_socket) as daemon:
        assert daemon.stdout is not None
        assert any("ARMED: armed" in line for line in daemon.stdout)
        robot = _emulated_robot_of(daemon.pid)
        for stalled in (robot, daemon.pid, robot):
            time.sleep(1.0)
            _stall(stalled, 0.6)
        rest = daemon.stdout.read()
    summary = json.loads(report.read_text())["summary"]
    assert daemon.returncode == 0, rest
    assert summary["stops"] == []
    assert summary["state"] == "ARMED"
    assert summary["armed_share"] > 0.5


def test_killing_the_daemon_takes_its_emulated_robot_with_it(tmp_path: Path) -> None:
    """Nothing is left of it: no process that waits for a daemon, no lines in the temporary folder."""
    command = [sys.executable, "-m", "tiger.cli.main", "run", "--emulate", "shaking-plate"]
    own = {**os.environ, "TMPDIR": str(tmp_path), "TIGER_SOCKET": str(tmp_path / "robot.sock")}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=own
    ) as run:
        assert run.stdout is not None
        assert any("ARMED: armed" in line for line in run.stdout)
        robot = _emulated_robot_of(run.pid)
        assert list(tmp_path.glob("tiger-*"))
        run.kill()
    gone_by_s = time.monotonic() + 10.0
    while Path(f"/proc/{robot}").exists():
        assert time.monotonic() < gone_by_s, "the emulated robot outlives the daemon"
        time.sleep(0.1)
    assert not list(tmp_path.glob("tiger-*"))
