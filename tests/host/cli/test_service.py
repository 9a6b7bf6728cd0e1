"""The service in deploy/: systemd understands it, and the command line understands its command."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from tiger.cli.run import run
from tiger.config.robot import load_robot

UNIT = Path(__file__).parents[3] / "deploy" / "tiger.service"


def settings() -> dict[str, str]:
    lines = (line for line in UNIT.read_text().splitlines() if "=" in line and not line.startswith("#"))
    return {name: value for name, _, value in (line.partition("=") for line in lines)}


def test_the_service_starts_a_command_that_exists_and_does_not_arm() -> None:
    _, *words = settings()["ExecStart"].split()
    app = typer.Typer()
    app.command("run")(run)
    app.callback()(lambda: None)
    command = typer.main.get_command(app).commands["run"]
    parameters = command.make_context("run", words[1:]).params
    assert parameters["config"] == Path("/etc/tiger/robot.toml")
    assert parameters["log"] == Path("/var/log") / settings()["LogsDirectory"]
    assert not parameters["arm"]


def test_the_service_permits_what_robot_toml_may_ask_for() -> None:
    found = settings()
    assert int(found["CPUSchedulingPriority"]) <= int(found["LimitRTPRIO"])
    assert load_robot(None).loop.realtime_priority <= int(found["LimitRTPRIO"])
    assert found["LimitMEMLOCK"] == "infinity"
    assert found["Environment"] == f"TIGER_SOCKET=/run/{found['RuntimeDirectory']}/robot.sock"


def test_a_wrong_configuration_is_not_tried_again_and_again() -> None:
    assert settings()["RestartPreventExitStatus"] == "2"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd")
def test_systemd_finds_nothing_wrong(tmp_path: Path) -> None:
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("/opt/tiger/.venv/bin/tiger", sys.executable))
    result = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True)
    mine = [line for line in result.stderr.splitlines() if UNIT.name in line]
    assert mine == []
