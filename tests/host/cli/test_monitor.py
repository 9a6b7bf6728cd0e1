"""`tiger monitor`: the robot's page from the socket."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from tiger.cli import monitor as monitor_module
from tiger.cli.monitor import monitor, page
from tiger.daemon.client import Robot

APP = typer.Typer()
APP.command()(monitor)


def drawn(content: Any) -> str:
    console = Console(width=120, file=io.StringIO())
    with console.capture() as capture:
        console.print(content)
    return capture.get()


def test_once_prints_one_page(running: Any) -> None:
    result = CliRunner().invoke(APP, ["--once"])
    assert result.exit_code == 0
    for text in ("helm: free", "DISARMED", "stroke mm", "margin", "mega_suspension", "roboteq"):
        assert text in result.output


def test_the_page_names_who_has_the_helm(running: Any) -> None:
    with Robot() as robot:
        robot.ask("mode", mode="level")
        assert "helm: client " in drawn(page(robot.ask("status")["status"]))


def test_without_a_daemon_it_waits_and_without_patience_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TIGER_SOCKET", str(tmp_path / "none.sock"))
    assert CliRunner().invoke(APP, ["--once"]).exit_code == 2
    tries = []

    def robot() -> Robot:
        tries.append(1)
        if len(tries) == 3:
            raise KeyboardInterrupt
        return Robot()

    monkeypatch.setattr("tiger.cli.live.is_terminal", lambda: True)
    monkeypatch.setattr(monitor_module, "RETRY_S", 0.0)
    monkeypatch.setattr(monitor_module, "Robot", robot)
    assert CliRunner().invoke(APP, []).exit_code == 0
    assert len(tries) == 3


def test_it_draws_telemetry_at_five_a_second_at_most(running: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ticks: list[int] = []

    def keep(status: dict[str, Any]) -> str:
        ticks.append(status["record"]["tick"])
        if len(ticks) == 5:
            raise KeyboardInterrupt
        return ""

    monkeypatch.setattr("tiger.cli.live.is_terminal", lambda: True)
    monkeypatch.setattr(monitor_module, "page", keep)
    CliRunner().invoke(APP, [])
    assert {later - earlier for earlier, later in pairwise(ticks)} == {40}


def test_without_a_terminal_it_names_what_prints_the_same() -> None:
    result = CliRunner().invoke(APP, [])
    assert result.exit_code == 2
    assert "tiger monitor --once" in result.output
