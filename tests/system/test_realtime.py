"""The shaking plate in real time: the emulated robot in its own process behind pseudo-terminals."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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
    assert lateness["ticks"] > 14 * 200 * 0.8  # a busy computer may miss ticks
    assert lateness["p99_us"] > 0.0
    assert "late by" in done.stdout
