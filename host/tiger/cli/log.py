"""`tiger log`: what a run left behind."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.cli.answers import JsonFile, fail, make_folder, reading, refuse_unwritable, starting, write_json

if TYPE_CHECKING:
    from tiger.logs.replay import Replayed
    from tiger.logs.summary import Summary
    from tiger.logs.topics import WireFrame

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Read logs: figures, plots, CSV, replay.",
)
export = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Write a log as files for other programs.",
)
app.add_typer(export, name="export")

LogPath = Annotated[Path, typer.Argument(metavar="LOG", help="A log file, or a folder: its newest log.")]


@app.command()
def info(
    log: LogPath,
    json_file: JsonFile = None,
    check: Annotated[
        bool, typer.Option("--check", help="Examine every message, checksum and index.")
    ] = False,
) -> None:
    """Say what a log holds, what happened, and whether it is sound."""
    from tiger.logs.doctor import examine
    from tiger.logs.errors import LogError
    from tiger.logs.reader import open_log
    from tiger.logs.summary import summarise

    refuse_unwritable(json_file)
    try:
        opened = open_log(log)
        with reading(opened, "reading"):
            summary = summarise(opened)
        with starting("examining"):
            findings = (
                [f"{f.path.name}: {text}" for f in opened.files for text in examine(f.path)] if check else []
            )
    except LogError as error:
        fail(error)
    if json_file is not None:
        write_json(json_file, summary.as_json() | ({"findings": findings} if check else {}))
    if str(json_file) != "-":
        _show(summary)
        if check:
            typer.echo("\n".join(findings) if findings else "Every message, checksum and index is right.")
    if findings:
        raise typer.Exit(1)


def _show(summary: Summary) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False)
    start = datetime.datetime.fromtimestamp(summary.start_ns / 1e9, datetime.UTC)
    console.print(f"{start:%Y-%m-%d %H:%M:%S} UTC, {summary.duration_s:.1f} s, {summary.ticks} ticks")
    for file in summary.files:
        end = "" if file["complete"] else ", not finished"
        console.print(f"  {file['name']}: {file['bytes'] / 1e6:.2f} MB{end}", markup=False)
    if summary.parts_before:
        gone = f"It begins with part {summary.parts_before} of its run; the parts before are not here."
        console.print(gone, style="yellow")
    for name, value in summary.about.items():
        console.print(f"  {name}: {value}", style="dim", markup=False)

    topics = Table("topic", "messages", "per second", box=None, header_style="bold")
    for column in topics.columns[1:]:
        column.justify = "right"
    for topic, count in summary.topics.items():
        rate = count / summary.duration_s if summary.duration_s else 0.0
        topics.add_row(escape(topic), str(count), f"{rate:.1f}")
    console.print(topics)

    happened = Table("time", "state", "reason", box=None, header_style="bold")
    for time_s, state, reason in summary.changes:
        happened.add_row(f"{time_s:.3f} s", state.lower(), escape(reason))
    console.print(happened)
    for time_s, report in summary.faults:
        console.print(f"{time_s:.3f} s: {report.state.name}: {report.reason}", style="red", markup=False)
        for problem in report.problems:
            console.print(f"  {problem}", markup=False)
        console.print(f"  the last {len(report.frames)} frames of all links: tiger log frames", style="dim")

    if summary.lateness_us:
        late = summary.lateness_us
        p50, p99, worst = (f"{late[name] / 1e3:.2f} ms" for name in ("p50_us", "p99_us", "max_us"))
        shown = f"{p50} (median), {p99} (99 %), {worst} (worst)"
        console.print(f"Ticks late by {shown}")
    if summary.missing_ticks or summary.dropped_packets:
        console.print(
            f"{summary.missing_ticks} ticks are missing, {summary.dropped_packets} packets were dropped "
            "while the log lagged",
            style="yellow",
        )
    for text in summary.damage:
        console.print(text, style="yellow", markup=False)


@app.command()
def plot(
    log: LogPath,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder for the pictures.")] = Path(),
) -> None:
    """Draw attitude, strokes, wheels and links as PNG."""
    from tiger.logs.errors import LogError
    from tiger.logs.plots import plot as draw
    from tiger.logs.reader import open_log

    make_folder(out)
    try:
        opened = open_log(log)
        with reading(opened, "reading, then drawing"):
            paths = draw(opened, out)
    except LogError as error:
        fail(error)
    except OSError as error:
        fail(f"{out}: cannot be written ({error.strerror}); choose another folder with --out")
    if not paths:
        fail(f"{log}: holds no ticks, so there is nothing to draw")
    for path in paths:
        typer.echo(path)


@export.command("csv")
def export_csv(
    log: LogPath,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Folder for the files, one for each topic.")
    ] = Path(),
    topic: Annotated[
        list[str] | None, typer.Option("--topic", metavar="TOPIC", help="Only this topic; may be repeated.")
    ] = None,
) -> None:
    """Write each topic as CSV: times in ns since 1970, then every field."""
    from tiger.logs.cdr import CdrError
    from tiger.logs.errors import LogError
    from tiger.logs.export import csv_file, csv_files
    from tiger.logs.reader import open_log

    make_folder(out)
    try:
        opened = open_log(log)
        with reading(opened, "reading, then again writing"):
            rows = csv_files(opened, out, topic or None)
    except (LogError, CdrError) as error:
        fail(error)
    except OSError as error:
        fail(f"{out}: cannot be written ({error.strerror}); choose another folder with --out")
    for path, count in rows.items():
        typer.echo(f"{path}: {count} rows")
    absent = [name for name in topic or [] if csv_file(out, name) not in rows]
    if absent or not rows:
        fail(f"{log}: has no messages on {', '.join(absent or ['any topic'])}; `tiger log info` lists topics")


@export.command("wire")
def export_wire(
    log: LogPath,
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Folder for the files, two for each line.")
    ] = Path(),
) -> None:
    """Write the bytes of each line, for `tiger protocol capture`."""
    from tiger.logs.errors import LogError
    from tiger.logs.export import wire_files
    from tiger.logs.reader import open_log

    make_folder(out)
    try:
        opened = open_log(log)
        with reading(opened, "writing"):
            sizes = wire_files(opened, out)
    except LogError as error:
        fail(error)
    except OSError as error:
        fail(f"{out}: cannot be written ({error.strerror}); choose another folder with --out")
    for path, size in sizes.items():
        typer.echo(f"{path}: {size} bytes")


@app.command()
def frames(log: LogPath) -> None:
    """Print the last frames of every link before each fault."""
    from tiger.logs.errors import LogError
    from tiger.logs.reader import open_log
    from tiger.logs.topics import FAULT

    try:
        opened = open_log(log)
        with reading(opened, "looking for stops"):
            reports = [logged.value() for logged in opened.messages((FAULT,))]
    except LogError as error:
        fail(error)
    if not reports:
        typer.echo("The robot never stopped by itself.")
    for report in reports:
        typer.echo(f"tick {report.tick}: {report.state.name}: {report.reason}")
        last_ns = report.frames[-1].t_ns if report.frames else 0
        for frame in report.frames:
            typer.echo(f"{(frame.t_ns - last_ns) / 1e6:10.3f} ms  {_readable(frame)}")


def _readable(frame: WireFrame) -> str:
    """A frame on one line: its message, its text, or its bytes."""
    from tiger.cli.protocol import EVERY_MESSAGE, one_line
    from tiger.protocol.frame import FrameDecoder

    way = f"{frame.port} {'<' if frame.sent else '>'}"  # to the device, from it
    if frame.data.endswith(b"\r"):
        return f"{way} {frame.data.decode('ascii', errors='backslashreplace').strip()}"
    received = FrameDecoder(EVERY_MESSAGE).feed(b"\0" + frame.data)
    return f"{way} {one_line(*received[0]) if received else frame.data.hex(' ')}"


@app.command()
def replay(
    log: LogPath,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="FILE", help="robot.toml to replay with instead of the one in the log."
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Step the controller on the logged inputs.

    Exits with 1 if it commands anything else than it did.
    """
    from tiger.config.errors import ConfigError
    from tiger.config.robot import load_robot
    from tiger.logs.errors import LogError
    from tiger.logs.reader import open_log
    from tiger.logs.replay import replay as step_again

    refuse_unwritable(json_file)
    try:
        opened = open_log(log)
        robot = None if config is None else load_robot(config)
        with reading(opened, "stepping"):
            found = step_again(opened, robot)
    except (LogError, ConfigError) as error:
        fail(error)
    if json_file is not None:
        write_json(json_file, _replay_json(found, opened.damage))
    if str(json_file) != "-":
        _show_replay(found, opened.damage)
    if not found.exact:
        raise typer.Exit(1)


def _replay_json(found: Replayed, damage: list[str]) -> dict[str, Any]:
    return {
        "exact": found.exact,
        "ticks": found.ticks,
        "different_ticks": found.different_ticks,
        "skipped_ticks": found.skipped,
        "missing_ticks": found.missing,
        "worst": found.worst,
        "first": [
            {"tick": d.tick, "time_s": d.time_s, "name": d.name, "logged": d.logged, "replayed": d.replayed}
            for d in found.first
        ],
        "damage": damage,
    }


def _show_replay(found: Replayed, damage: list[str]) -> None:
    for text in damage:
        typer.echo(text, err=True)
    if found.missing:
        typer.echo(f"{found.missing} ticks are not in the log.")
    if found.skipped:
        typer.echo(f"{found.skipped} ticks have no state to begin with before the next checkpoint.")
    if found.ticks == 0:
        typer.echo("Nothing could be replayed.")
    elif found.exact:
        typer.echo(f"{found.ticks} ticks replayed: every output is the same to the last bit.")
    else:
        typer.echo(f"{found.ticks} ticks replayed: {found.different_ticks} differ.")
        for name, worst in sorted(found.worst.items(), key=lambda item: -item[1]):
            typer.echo(f"  {name} differs by up to {worst:.3g}")
        for difference in found.first:
            typer.echo(f"  {difference}")
