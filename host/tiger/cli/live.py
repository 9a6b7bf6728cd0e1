"""The picture of a run in the terminal: attitude, strokes, speeds, state, and the health of every link.

Drawing takes milliseconds, so on the real robot a process of its own draws, and reads the keys; the control
thread only hands it the newest record when it asks for one, and never waits for it.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import select
import sys
import termios
import tty
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

    from tiger.record import LinkStatus, Record

FRAMES_PER_S = 5.0
STATE_STYLE = {
    DaemonState.DISCONNECTED: "yellow",
    DaemonState.HANDSHAKE: "yellow",
    DaemonState.DISARMED: "cyan",
    DaemonState.ARMED: "bold green",
    DaemonState.FAULT: "bold red",
    DaemonState.ESTOP: "bold white on red",
}
KEYS = "a arm   d disarm   c clear faults   space emergency stop   q quit"
CORNERS = ("FL", "FR", "RL", "RR")


def picture(record: Record, log_lines: list[str], title: str, keys: bool) -> Group:
    """Everything about one record that a person wants to see."""
    state = Text.assemble(
        (f" {record.state.name} ", STATE_STYLE[record.state]), f"  {record.reason}; {record.outputs.reason}"
    )
    parts: list[RenderableType] = [
        Text(title, style="bold"),
        state,
        _body(record),
        _corners(record),
        _links(record.links),
    ]
    parts += [Text(f"! {problem}", style="red") for problem in record.problems]
    parts += [Text(line, style="dim") for line in log_lines[-4:]]
    if keys:
        parts.append(Text(KEYS, style="dim"))
    return Group(*parts)


def _body(record: Record) -> Table:
    estimate = record.outputs.estimate
    table = Table(box=None, padding=(0, 2))
    for heading in ("", "roll", "pitch", "roll rate", "pitch rate"):
        table.add_column(heading, justify="right")
    degrees = [
        math.degrees(value)
        for value in (
            estimate.roll_rad,
            estimate.pitch_rad,
            estimate.roll_rate_radps,
            estimate.pitch_rate_radps,
        )
    ]
    known = estimate.ready
    table.add_row("body", *(f"{value:+.2f}°{unit}" if known else "-" for value, unit in _with_units(degrees)))
    ground = [math.degrees(estimate.plate_roll_rad), math.degrees(estimate.plate_pitch_rad)]
    table.add_row("ground", *(f"{value:+.2f}°" if known else "-" for value in ground), "", "")
    return table


def _with_units(degrees: list[float]) -> Iterator[tuple[float, str]]:
    return zip(degrees, ("", "", "/s", "/s"), strict=True)


def _corners(record: Record) -> Table:
    inputs, outputs = record.inputs, record.outputs
    table = Table(box=None, padding=(0, 2))
    for heading in ("", *CORNERS):
        table.add_column(heading, justify="right")
    if inputs.strokes is not None:
        table.add_row("stroke mm", *(f"{value:.2f}" for value in inputs.strokes.stroke_mm))
    table.add_row("rate mm/s", *(f"{value:+.2f}" for value in outputs.stroke_rate_mmps))
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is not None and right is not None:
        radps = (left.speed_radps[0], right.speed_radps[0], left.speed_radps[1], right.speed_radps[1])
        table.add_row("wheel rpm", *(f"{value * 30.0 / math.pi:+.1f}" for value in radps))
        table.add_row("command rpm", *(f"{value:+.1f}" for value in outputs.wheel_rpm))
    return table


def _links(links: tuple[LinkStatus, ...]) -> Table:
    table = Table(box=None, padding=(0, 1), header_style="dim")
    for heading in ("device", "state"):
        table.add_column(heading, no_wrap=True)
    for heading in ("frames", "refused", "lost", "trip ms", "drift ppm", "± µs", "V"):
        table.add_column(heading, justify="right", no_wrap=True)
    for link in links:
        clock: tuple[str, ...] = ("", "", "")
        if link.clock_sigma_us > 0.0:
            clock = (f"{link.round_trip_ms:.1f}", f"{link.drift_ppm:+.0f}", f"{link.clock_sigma_us:.0f}")
        refused = f"{link.rejects}+{link.board_rejects}" if link.board_rejects else str(link.rejects)
        table.add_row(
            link.name,
            Text(link.state, style="" if link.connected else "red"),
            str(link.rx_frames),
            refused,
            str(link.seq_gaps),
            *clock,
            f"{link.supply_v:.1f}" if link.supply_v else "",
        )
    return table


class Screen:
    """Draws in this process: for virtual time, where nobody minds the milliseconds."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._live = Live(console=Console(), auto_refresh=False, transient=True)

    def __enter__(self) -> Screen:
        self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.__exit__(None, None, None)

    def show(self, record: Record, log_lines: list[str]) -> None:
        """Draw a record."""
        self._live.update(picture(record, log_lines, self._title, keys=False), refresh=True)


class ScreenProcess:
    """Draws in a process of its own, which also reads the keys."""

    def __init__(self, title: str) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_draw, args=(theirs, title), daemon=True)
        self._process.start()
        theirs.close()

    def __enter__(self) -> ScreenProcess:
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.kill()

    def exchange(self, record: Record, log_lines: list[str]) -> str:
        """Hand over the newest record if one was asked for; returns the keys that were pressed."""
        keys = ""
        try:
            while self._pipe.poll():
                keys += self._pipe.recv()
                self._pipe.send((record, log_lines))
        except (OSError, EOFError):  # the screen is gone; the robot goes on
            return ""
        return keys


def _draw(pipe: Connection, title: str) -> None:
    """Body of the drawing process: ask for a record, draw it, wait a fifth of a second for keys."""
    with _keyboard() as keyboard, Live(console=Console(), auto_refresh=False, transient=True) as live:
        keys = ""
        while True:
            try:
                pipe.send(keys)
                news = pipe.recv()
            except (OSError, EOFError, KeyboardInterrupt):
                return
            if news is None:
                return
            record, log_lines = news
            live.update(picture(record, log_lines, title, keys=keyboard is not None), refresh=True)
            keys = _pressed(keyboard, 1.0 / FRAMES_PER_S)


@contextlib.contextmanager
def _keyboard() -> Iterator[int | None]:
    """The terminal with each key handed over at once; None when there is no terminal."""
    try:
        descriptor = os.open("/dev/tty", os.O_RDONLY)
    except OSError:
        yield None
        return
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield descriptor
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        os.close(descriptor)


def _pressed(keyboard: int | None, seconds: float) -> str:
    """Keys pressed within a time."""
    try:
        ready, _, _ = select.select([] if keyboard is None else [keyboard], [], [], seconds)
    except KeyboardInterrupt:
        return "q"
    return os.read(keyboard, 64).decode("ascii", "ignore") if ready and keyboard is not None else ""


def is_terminal() -> bool:
    """Whether someone is watching."""
    return sys.stdout.isatty()
