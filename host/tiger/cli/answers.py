"""What several commands answer alike: that work goes on, and what they refuse before they begin."""

from __future__ import annotations

import errno
import json
import os
import sys
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.logs.reader import Log


JsonFile = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the figures to this file, - to the screen."),
]


def fail(message: object) -> NoReturn:
    """End the program with what cannot be done as it was asked for, why, and the next step."""
    typer.echo(str(message), err=True)
    raise typer.Exit(2)


def refuse_unwritable(file: Path | None) -> None:
    """End the program with one line if a result could not be written; better now than after the work."""
    if file is None or str(file) == "-":
        return
    folder = file.parent
    why = None
    if file.is_dir():
        why = "it is a folder"
    elif not folder.is_dir():
        why = f"there is no folder {folder}"
    elif not os.access(file if file.exists() else folder, os.W_OK):
        why = "not permitted"
    if why is not None:
        fail(f"{file}: cannot be written ({why}); choose another place")


def write_json(file: Path, data: Any, indent: int | None = 1) -> None:
    """Write figures to a file, `-`: to standard output; end the program if that cannot be done."""
    text = json.dumps(data, indent=indent, allow_nan=False)
    if str(file) == "-":
        typer.echo(text)
        return
    try:
        file.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        fail(f"{file}: cannot be written ({error.strerror}); choose another place")


@contextmanager
def aside(json_file: Path | None) -> Iterator[None]:
    """With `--json -`, what is said to a person goes to standard error: it shall not mix with the figures."""
    with redirect_stdout(sys.stderr) if str(json_file) == "-" else nullcontext():
        yield


def make_folder(folder: Path) -> None:
    """Make a folder for results; end the program with one line if they could not be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, "not permitted")
    except OSError as error:
        fail(f"{folder}: cannot be written ({error.strerror}); choose another folder")


def scenario_names() -> list[str]:
    """Names of the scenarios that come with TIGER, found without loading the emulation."""
    folder = Path(__file__).parents[1] / "emulation" / "scenarios"
    return sorted(file.stem for file in folder.glob("*.toml"))


@contextmanager
def reading(log: Log, text: str) -> Iterator[None]:
    """Show how far a log was read; on a terminal only."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=1.0)
        log.watch(lambda part: bar.update(task, completed=part))
        yield


@contextmanager
def starting(text: str) -> Iterator[None]:
    """Show that something is at work that cannot say how far it is; on a terminal only."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield
