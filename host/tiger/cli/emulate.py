"""`tiger emulate SCENARIO`: the emulated robot in real time behind pseudo-terminals."""

from __future__ import annotations

import fcntl
import os
import signal
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tiger.cli.answers import make_folder, scenario_names

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.emulation.robot import EmulatedRobot


def default_folder() -> Path:
    """Where the links to the pseudo-terminals go: a place of this user's own."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "tiger" if runtime else Path(tempfile.gettempdir()) / f"tiger-{os.getuid()}"


def emulate(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            autocompletion=scenario_names,
            help=f"A .toml file, or {', '.join(scenario_names())}.",
        ),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Where the links to the serial lines go (default: a runtime folder)."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="NUMBER", min=0, help="Seed of everything random.")] = 0,
    duration: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="How long; default: until interrupted.", min=0.1)
    ] = None,
    vehicle: Annotated[str, typer.Option(metavar="NAME|FILE", help="Vehicle preset or file.")] = "tiger",
) -> None:
    """Run the emulated robot in real time; its serial lines appear as links in a folder."""
    from rich.console import Console

    from tiger.config.errors import ConfigError
    from tiger.config.vehicle import load_vehicle
    from tiger.emulation.robot import EmulatedRobot
    from tiger.emulation.scenarios import load_scenario
    from tiger.emulation.serve import LINKS, PtyRobot
    from tiger.models.eam import MechanismError

    console = Console(highlight=False)
    try:
        robot = EmulatedRobot(load_vehicle(vehicle), load_scenario(scenario), seed=seed)
    except (ConfigError, MechanismError) as error:
        Console(stderr=True).print(str(error), style="red", markup=False)
        raise typer.Exit(2) from None

    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)

    where = default_folder() if folder is None else folder
    with _alone(where), PtyRobot(robot, where) as served, console.status("") as status:
        console.print(f"{robot.scenario.title}", markup=False)
        for link in LINKS.values():
            console.print(f"  {where / link}", markup=False)
        console.print(f"In another terminal: tiger run --config {served.folder / 'robot.toml'} --arm")

        def each_step(now: EmulatedRobot) -> bool:
            if round(now.time_s * 1000) % 200 == 0:
                status.update(_line(now))
            return not stopped

        served.run(float("inf") if duration is None else duration, each_step)
    if served.skipped_s:
        console.print(f"This computer was too busy: {served.skipped_s:.2f} s were skipped.")


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Refuse a folder whose links belong to another emulated robot; the lock ends with the program."""
    make_folder(folder)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            typer.echo(f"{folder}: another emulated robot is served there; name another --folder", err=True)
            raise typer.Exit(2) from None
        yield


def _line(robot: EmulatedRobot) -> str:
    truth = robot.truth()
    strokes = " ".join(f"{stroke:5.1f}" for stroke in truth.stroke_mm)
    return (
        f"{truth.time_s:7.1f} s  plate {truth.plate_roll_deg:+5.2f} {truth.plate_pitch_deg:+5.2f} deg"
        f"  body {truth.roll_deg:+5.2f} {truth.pitch_deg:+5.2f} deg  strokes {strokes} mm"
    )
