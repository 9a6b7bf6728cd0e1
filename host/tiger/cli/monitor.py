"""`tiger monitor`: the running robot in the terminal, seen through the daemon's socket."""

from __future__ import annotations

import functools
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.daemon.client import Refused, Robot

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from rich.console import RenderableType

    from tiger.daemon.api_messages import Status

RETRY_S = 1.0


def monitor(
    once: Annotated[bool, typer.Option("--once", help="Print it once and end.")] = False,
) -> None:
    """Watch the running robot: attitude, strokes, wheels, links, problems. It only looks."""
    if once:
        from rich.console import Console

        from tiger.cli.ctl import connected

        with connected() as robot:
            Console().print(page(robot.ask("status")["status"]))
        return
    from tiger.cli.live import is_terminal

    if not is_terminal():
        typer.echo(
            "there is no terminal to draw on; try: tiger monitor --once, tiger ctl status --json", err=True
        )
        raise typer.Exit(2)
    try:
        _watch()
    except KeyboardInterrupt:
        return


def _watch() -> None:
    """Draw what arrives, and wait for a daemon while there is none."""
    from tiger.cli.live import FRAMES_PER_S, whole_terminal

    with whole_terminal() as live:
        while True:
            try:
                with Robot() as robot:
                    robot.ask("subscribe", rate_hz=FRAMES_PER_S)
                    while True:
                        live.update(page(robot.telemetry()["telemetry"]), refresh=True)
            except Refused as refusal:
                live.update(f"The daemon hung up: {refusal}", refresh=True)
            except OSError as error:
                from tiger.daemon.client import socket_path

                why = error.strerror or error
                live.update(f"Waiting for a daemon on {socket_path()} ({why}); Ctrl-C ends.", refresh=True)
            time.sleep(RETRY_S)


def page(status: dict[str, Any]) -> RenderableType:
    """Draw one status; the same picture as that of `tiger run`."""
    from tiger.cli.live import Page

    read = _model().validate_python(status)
    title = f"TIGER; helm: {read.helm or 'free'}"
    return Page(read.record, read.overview, read.log_lines, title, keys=False)


@functools.cache
def _model() -> TypeAdapter[Status]:
    from pydantic import TypeAdapter

    from tiger.daemon.api_messages import Status

    return TypeAdapter(Status)
