"""`tiger`: the command line. Lists its commands without importing them; imports the one that is asked for."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from collections.abc import Callable


class Entry(NamedTuple):
    """One command or group: where it is, and its line in `tiger --help`."""

    module: str
    attribute: str  # a function is a command, a Typer is a group
    help: str


COMMANDS = {
    "run": Entry("tiger.cli.run", "run", "Run the robot, or the emulated one: find, arm, level, drive."),
    "emulate": Entry("tiger.cli.emulate", "emulate", "Serve the emulated robot behind pseudo-terminals."),
    "calibrate": Entry("tiger.cli.calibrate", "app", "Calibrate the IMU, the potentiometers and the wheels."),
    "ctl": Entry("tiger.cli.ctl", "app", "Ask the running daemon for something: arm, mode, pose, drive."),
    "teleop": Entry("tiger.cli.teleop", "teleop", "Drive by hand, with the keyboard or a gamepad."),
    "monitor": Entry("tiger.cli.monitor", "monitor", "Watch the running robot."),
    "doctor": Entry("tiger.cli.doctor", "doctor", "Find out what keeps the robot from being reached."),
    "protocol": Entry("tiger.cli.protocol", "app", "Read frames and captures of the wire as text."),
    "log": Entry("tiger.cli.log", "app", "Look into a recorded run: plot, export, replay."),
    "identify": Entry("tiger.cli.identify", "identify", "Find how the body answers its strokes, from a log."),
    "study": Entry("tiger.cli.study", "app", "Run an experiment of the dissertation again."),
}


class _LazyGroup(TyperGroup):
    """A group whose commands are imported one at a time."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        if cmd_name not in sys.argv:  # only the list is wanted
            return TyperCommand(cmd_name, help=entry.help)
        return _command(cmd_name, entry)


def _command(name: str, entry: Entry) -> Any:
    found: typer.Typer | Callable[..., None] = getattr(importlib.import_module(entry.module), entry.attribute)
    if isinstance(found, typer.Typer):
        command = typer.main.get_command(found)
    else:
        app = typer.Typer(add_completion=False)
        app.command(name)(found)
        command = typer.main.get_command(app)
    command.name = name
    command.rich_markup_mode = None  # type: ignore[attr-defined]  # plain help everywhere, and no list that imports every command
    return command


# Plain help: the rich one takes longer to import than everything else together.
app = typer.Typer(
    name="tiger", cls=_LazyGroup, no_args_is_help=True, add_completion=False, rich_markup_mode=None
)


@app.callback()
def _root() -> None:
    """Control stack of TIGER, a four-wheel robot that levels its body."""


def main() -> None:
    """Entry point."""
    app(prog_name="tiger")


if __name__ == "__main__":
    main()
