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
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from tiger.record import DaemonState
from tiger.rig.spawn import start_undisturbed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection

    from rich.console import ConsoleOptions, RenderResult

    from tiger.daemon.overview import Overview
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
J_PER_WH = 3600.0
MOST_LOG_LINES = 4
LEAVE_SCREEN = "\x1b[?1049l\x1b[?25h"  # xterm: back to the screen before, cursor shown
ROUGHNESS = "ABCDEFGH"  # ISO 8608


class Page:
    """A picture as tall as the place it is drawn on: what matters least is left out first."""

    def __init__(
        self, record: Record, overview: Overview, log_lines: list[str], title: str, keys: bool
    ) -> None:
        self._picture = partial(picture, record, overview, title=title, keys=keys)
        self._log_lines = log_lines[-MOST_LOG_LINES:]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw it."""
        height = options.height  # None: as tall as it likes
        if height is None and console.is_alt_screen:
            height = console.height
        free = options.update(height=None)
        for brief in (False, True):
            lines = console.render_lines(self._picture(brief=brief), free)
            if height is None or len(lines) <= height:
                break
        room = MOST_LOG_LINES if height is None else max(height - len(lines), 0)
        for text in self._log_lines[max(len(self._log_lines) - room, 0) :]:
            line = Text(text, style="dim", no_wrap=True, overflow="ellipsis")
            lines += console.render_lines(line, free)
        for drawn in lines[:height]:
            yield from drawn
            yield Segment.line()


def picture(record: Record, overview: Overview, title: str, keys: bool, brief: bool = False) -> Group:
    """Everything about one record that a person wants to see; `brief`: 24 lines hold it and four problems."""
    state = Text.assemble(
        (f" {record.state.name} ", STATE_STYLE[record.state]), f"  {record.reason}; {record.outputs.reason}"
    )
    parts: list[RenderableType] = [_one_line(title, "bold")]
    if keys:
        parts.append(Text(KEYS, style="dim"))
    parts.append(state)
    for problem in record.problems:
        text = f"! {problem.where}: {problem.text}." if brief else f"! {problem}"
        parts.append(_one_line(text, "red") if brief else Text(text, style="red"))
    parts += [_body(record), _corners(record, overview, brief), _battery(record, overview)]
    parts.append(_links(record.links))
    return Group(*parts)


def _one_line(text: str, style: str) -> Text:
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def _body(record: Record) -> Table:
    estimate = record.outputs.estimate
    table = Table(box=None, padding=(0, 2))
    for heading in ("", "roll", "pitch", "roll rate", "pitch rate", "odometry"):
        table.add_column(heading, justify="right", no_wrap=True)
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
    where = estimate.odometry
    body = [f"{value:+.2f}°{unit}" if known else "-" for value, unit in _with_units(degrees)]
    table.add_row("body", *body, f"{where.x_m:+.2f} {where.y_m:+.2f} m")
    ground = [math.degrees(estimate.plate_roll_rad), math.degrees(estimate.plate_pitch_rad)]
    slope = [f"{value:+.2f}°" if known else "-" for value in ground]
    moving = f"{math.degrees(where.yaw_rad):+.1f}° {where.speed_mps:+.2f} m/s"
    stands = f"margin {estimate.stability.margin:.2f}" if known else ""
    number = estimate.roughness.class_number
    rough = f"class {ROUGHNESS[number]}" if number >= 0 else ""
    table.add_row("ground", *slope, stands, rough, moving)
    return table


def _with_units(degrees: list[float]) -> Iterator[tuple[float, str]]:
    return zip(degrees, ("", "", "/s", "/s"), strict=True)


def _corners(record: Record, overview: Overview, brief: bool) -> Table:
    inputs, outputs = record.inputs, record.outputs
    table = Table(box=None, padding=(0, 2))
    for heading in ("", *CORNERS):
        table.add_column(heading, justify="right", no_wrap=True)
    if inputs.strokes is not None:
        table.add_row("stroke mm", *(f"{value:.2f}" for value in inputs.strokes.stroke_mm))
    table.add_row("rate mm/s", *(f"{value:+.2f}" for value in outputs.stroke_rate_mmps))
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is not None and right is not None:
        radps = (left.speed_radps[0], right.speed_radps[0], left.speed_radps[1], right.speed_radps[1])
        table.add_row("wheel rpm", *(f"{value * 30.0 / math.pi:+.1f}" for value in radps))
        table.add_row("command rpm", *(f"{value:+.1f}" for value in outputs.wheel_rpm))
    if inputs.drive_left is not None and inputs.drive_right is not None:
        table.add_row("current A", *(f"{value:+.1f}" for value in overview.current_a))
        if brief:
            return table
        table.add_row("torque Nm", *(f"{value:+.2f}" for value in overview.torque_nm))
        table.add_row("power W", *(f"{value:+.0f}" for value in overview.power_w))
    return table


def _battery(record: Record, overview: Overview) -> Text:
    """Battery and reach on one line."""
    parts = []
    volts = [d.battery_v for d in (record.inputs.drive_left, record.inputs.drive_right) if d is not None]
    if volts:
        parts.append(
            f"battery {min(volts):.1f} V, {sum(overview.electric_w):.0f} W, {_energy(overview)} taken"
        )
    if overview.reach_used is not None:
        roll, pitch = (math.degrees(most) for most in overview.reachable_rad)
        parts.append(f"reach ±{roll:.1f}° roll ±{pitch:.1f}° pitch, {100.0 * overview.reach_used:.0f} % used")
    return Text("; ".join(parts), no_wrap=True, overflow="ellipsis")


def _energy(overview: Overview) -> str:
    taken_wh = sum(overview.energy_j) / J_PER_WH
    return f"{taken_wh:.{2 if taken_wh < 10.0 else 0}f} Wh"


def _links(links: tuple[LinkStatus, ...]) -> Table:
    """Short headings and short numbers: it must fit into 80 columns after a day."""
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim")
    for heading in ("device", "state"):
        table.add_column(heading, no_wrap=True)
    for heading in ("frames", "refused", "lost", "trip ms", "ppm", "± µs", "V"):
        table.add_column(heading, justify="right", no_wrap=True)
    for link in links:
        clock: tuple[str, ...] = ("", "", "")
        if link.clock_sigma_us > 0.0:
            clock = (
                f"{link.round_trip_ms:.1f}",
                f"{link.drift_ppm:+.0f}",
                _short(round(link.clock_sigma_us)),
            )
        refused = _short(link.rejects) + (f"+{_short(link.board_rejects)}" if link.board_rejects else "")
        table.add_row(
            link.name,
            Text(_state(link), style="" if link.connected else "red"),
            _short(link.rx_frames),
            refused,
            _short(link.seq_gaps),
            *clock,
            f"{link.supply_v:.1f}" if link.supply_v else "",
        )
    return table


def _state(link: LinkStatus) -> str:
    """A board that only measures has nothing to arm: `disarmed` would look like something missing."""
    only_measures = link.name.startswith(("nano_imu", "mega_speed"))
    return "running" if only_measures and link.state == "disarmed" else link.state


def _short(count: int) -> str:
    """A count in five characters at most."""
    for size, unit in ((1, ""), (1_000, "k"), (1_000_000, "M"), (1_000_000_000, "G")):
        if count < 10_000 * size:
            return f"{count // size}{unit}"
    return "many"


class Screen:
    """Draws in this process: for virtual time, where nobody minds the milliseconds."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._live = whole_terminal()

    def __enter__(self) -> Screen:
        self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.__exit__(None, None, None)

    def show(self, record: Record, overview: Overview, log_lines: list[str]) -> None:
        """Draw a record."""
        self._live.update(Page(record, overview, log_lines, self._title, keys=False), refresh=True)


def whole_terminal() -> Live:
    """A picture on a screen of its own: stray output and a change of size last until the next drawing."""
    return Live(console=Console(), auto_refresh=False, screen=True)


class ScreenProcess:
    """Draws in a process of its own, which also reads the keys."""

    def __init__(self, title: str) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._asked = select.poll()  # the pipe's own poll() makes one of these each time
        self._asked.register(self._pipe.fileno(), select.POLLIN)
        self._terminal = _settings()
        self._process = context.Process(target=_draw, args=(theirs, title), daemon=True)
        start_undisturbed(self._process)
        theirs.close()

    def __enter__(self) -> ScreenProcess:
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(OSError):
            self._pipe.send(None)
        self._process.join(timeout=2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._process.exitcode and self._terminal is not None:  # it could not tidy up
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(sys.stdout, termios.TCSADRAIN, self._terminal)
                sys.stdout.write(LEAVE_SCREEN)
                sys.stdout.flush()

    def exchange(self, record: Record, look: Callable[[Record], Overview], log_lines: list[str]) -> str:
        """Hand over the newest record and its overview if one was asked for; returns the keys pressed."""
        keys = ""
        try:
            while self._asked.poll(0):
                keys += self._pipe.recv()
                self._pipe.send((record, look(record), log_lines))
        except (OSError, EOFError):  # the screen is gone; the robot goes on
            return ""
        return keys


def _settings() -> Any:
    """How the terminal is set; None where there is none."""
    try:
        return termios.tcgetattr(sys.stdout)
    except (OSError, termios.error):
        return None


def _draw(pipe: Connection, title: str) -> None:
    """Body of the drawing process: ask for a record, draw it, wait a fifth of a second for keys."""
    with contextlib.suppress(OSError), _keyboard() as keyboard, whole_terminal() as live:
        live.update(_one_line(title, "bold"), refresh=True)
        keys = ""
        while True:
            try:
                pipe.send(keys)
                news = pipe.recv()
            except (OSError, EOFError):
                return
            if news is None:
                return
            record, overview, log_lines = news
            live.update(Page(record, overview, log_lines, title, keys=keyboard is not None), refresh=True)
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
        with contextlib.suppress(termios.error):  # of a terminal that is gone, or a shell's again
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        os.close(descriptor)


def _pressed(keyboard: int | None, seconds: float) -> str:
    """Keys pressed within a time. Raises OSError when the terminal was closed."""
    ready, _, _ = select.select([] if keyboard is None else [keyboard], [], [], seconds)
    if keyboard is None or not ready:
        return ""
    data = os.read(keyboard, 64)
    if not data:
        raise OSError("the terminal was closed")
    return data.decode("ascii", "ignore")


def is_terminal() -> bool:
    """Whether someone is watching."""
    return sys.stdout.isatty()
