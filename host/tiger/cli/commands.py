"""The commands of `tiger`. Lists them without importing any; imports the one that is asked for."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from collections.abc import Callable


MISTAKE = 70
"""Exit status of a program that failed by itself (EX_SOFTWARE of sysexits.h)."""
UNDOABLE = 2
"""Exit status of what cannot be done as it was asked for."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Entry(NamedTuple):
    """One command or group: where it is, its line in `tiger --help`, and examples for its own help."""

    module: str
    attribute: str  # a function is a command, a Typer is a group
    help: str
    examples: tuple[str, ...]


COMMANDS = {
    "run": Entry(
        "tiger.cli.run",
        "run",
        "Run the robot, or the emulated one: find, arm, level, drive.",
        (
            "tiger run --emulate shaking-plate --virtual-time",
            "tiger run --emulate my.toml --seed 3 --json out.json --log logs",
            "tiger run --config robot.toml --log logs",
        ),
    ),
    "emulate": Entry(
        "tiger.cli.emulate",
        "emulate",
        "Serve the emulated robot behind pseudo-terminals.",
        ("tiger emulate shaking-plate", "tiger emulate my.toml --folder lines --duration 60"),
    ),
    "calibrate": Entry(
        "tiger.cli.calibrate",
        "app",
        "Calibrate the IMU, the potentiometers and the wheels.",
        (
            "tiger calibrate imu --config robot.toml",
            "tiger calibrate wheels --arm --distance 5 --turns 2 --output wheels.toml",
            "tiger calibrate strokes --emulate smooth-floor --yes --plots plots",
        ),
    ),
    "ctl": Entry(
        "tiger.cli.ctl",
        "app",
        "Ask the running daemon for something: arm, mode, pose, drive.",
        (
            "tiger ctl status",
            "tiger ctl arm",
            "tiger ctl pose --roll 3 --pitch -2 --height 40",
            "tiger ctl drive --speed 0.5 --yaw-rate 10 --for 3",
        ),
    ),
    "teleop": Entry(
        "tiger.cli.teleop",
        "teleop",
        "Drive by hand, with the keyboard or a gamepad.",
        ("tiger teleop", "tiger teleop --gamepad auto --level 2"),
    ),
    "monitor": Entry(
        "tiger.cli.monitor", "monitor", "Watch the running robot.", ("tiger monitor", "tiger monitor --once")
    ),
    "doctor": Entry(
        "tiger.cli.doctor",
        "doctor",
        "Find out what keeps the robot from being reached.",
        ("tiger doctor --config robot.toml",),
    ),
    "protocol": Entry(
        "tiger.cli.protocol",
        "app",
        "Read frames and captures of the wire as text.",
        ("tiger protocol frame 00 02 05 11 00", "tiger protocol capture line.bin --summary"),
    ),
    "log": Entry(
        "tiger.cli.log",
        "app",
        "Look into a recorded run: plot, export, replay.",
        (
            "tiger log info logs --check",
            "tiger log plot logs --out plots",
            "tiger log export csv logs --out csv --topic /odom",
            "tiger log replay logs --config robot.toml",
        ),
    ),
    "identify": Entry(
        "tiger.cli.identify",
        "identify",
        "Find how the body answers its strokes, from a log.",
        ("tiger identify logs --plots plots",),
    ),
    "study": Entry(
        "tiger.cli.study",
        "app",
        "Run an experiment of the dissertation again.",
        (
            "tiger study shaking-plate --plots plots",
            "tiger study monte-carlo --help",
            "tiger study eam --json -",
        ),
    ),
}


class _LazyGroup(TyperGroup):
    """A group whose commands are imported one at a time."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        if cmd_name not in _words():  # only the list is wanted
            return TyperCommand(cmd_name, help=entry.help)
        return _command(cmd_name, entry)


def _words() -> list[str]:
    """The words of the command line, also while a shell completes one."""
    shells = (os.environ.get(name, "") for name in ("COMP_WORDS", "_TYPER_COMPLETE_ARGS"))
    return [*sys.argv, *" ".join(shells).split()]


def _command(name: str, entry: Entry) -> Any:
    found: typer.Typer | Callable[..., None] = getattr(importlib.import_module(entry.module), entry.attribute)
    if isinstance(found, typer.Typer):
        command = typer.main.get_command(found)
    else:
        app = typer.Typer(add_completion=False)
        app.command(name)(found)
        command = typer.main.get_command(app)
    command.name = name
    command.epilog = "\b\n" + "\n".join(("Examples:", *(f"  {line}" for line in entry.examples)))
    command.rich_markup_mode = None  # type: ignore[attr-defined]  # plain help everywhere, and no list that imports every command
    return command


# Plain help: the rich one takes longer to import than everything else together.
app = typer.Typer(name="tiger", cls=_LazyGroup, no_args_is_help=True, rich_markup_mode=None)


def _place(error: OSError) -> str:
    return str(error.filename or "the output")


def _tell_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        typer.echo(f"tiger {metadata.version('tiger-robot')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_tell_version, help="Tell the version.")
    ] = False,
) -> None:
    """Control stack of TIGER, a four-wheel robot that levels its body."""


def obey() -> None:
    """Run the command that the command line names; ends the program with its status."""
    try:
        app(prog_name="tiger")
    except Exception as error:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            typer.echo(f"{_place(error)} cannot be written ({error.strerror}); make room there", err=True)
            sys.exit(UNDOABLE)
        if os.environ.get("TIGER_TRACEBACK"):
            raise
        typer.echo(f"tiger: a mistake of the program: {type(error).__name__}: {error}", err=True)
        typer.echo("Please report it with what TIGER_TRACEBACK=1 shows for the same command.", err=True)
        sys.exit(MISTAKE)
