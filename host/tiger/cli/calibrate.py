"""`tiger calibrate`: IMU, mounting, potentiometers and wheels; on the robot, or on the emulated one."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.cli.answers import (
    JsonFile,
    aside,
    fail,
    make_folder,
    refuse_unwritable,
    scenario_names,
    write_json,
)
from tiger.cli.main import INTERRUPTED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress

    from tiger.calibration.person import Person
    from tiger.calibration.procedure import Confirm, Measure, Procedure, Result, Turn
    from tiger.calibration.station import Station
    from tiger.config.robot import RobotConfig
    from tiger.rig.virtual import Rig

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Measure what the robot's parameters should be, and store them on its boards.",
)

Config = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="robot.toml; the packaged one when left out.")
]
Emulate = Annotated[
    str | None,
    typer.Option(
        metavar="SCENARIO", autocompletion=scenario_names, help="On the emulated robot, in virtual time."
    ),
]
Seed = Annotated[int, typer.Option(metavar="NUMBER", min=0, help="Of the emulated robot's noise.")]
Yes = Annotated[bool, typer.Option("--yes", help="Store the result without asking.")]


@app.command()
def imu(
    config: Config = None,
    emulate: Emulate = None,
    seed: Seed = 0,
    yes: Yes = False,
    json_file: JsonFile = None,
    seconds: Annotated[
        float, typer.Option(metavar="SECONDS", min=2.0, max=600.0, help="Length of the rest.")
    ] = 10.0,
) -> None:
    """Bias and noise of the gyroscope at rest."""
    from tiger.calibration.imu import imu_procedure

    _calibrate(_Wishes(config, emulate, seed, yes, json_file), lambda robot: imu_procedure(seconds))


@app.command()
def accel(
    config: Config = None,
    emulate: Emulate = None,
    seed: Seed = 0,
    yes: Yes = False,
    json_file: JsonFile = None,
) -> None:
    """Offset and scale of the accelerometer."""
    from tiger.calibration.accel import accel_procedure

    _calibrate(_Wishes(config, emulate, seed, yes, json_file), lambda robot: accel_procedure())


@app.command()
def level(
    config: Config = None,
    emulate: Emulate = None,
    seed: Seed = 0,
    yes: Yes = False,
    json_file: JsonFile = None,
    turn: Annotated[
        bool, typer.Option("--turn", help="Measure twice, turned round, so that the ground may slope.")
    ] = False,
    arm: Annotated[
        bool, typer.Option("--arm", help="Let the robot bring all strokes to ride height first.")
    ] = False,
) -> None:
    """Mounting of the IMU, from gravity on level ground."""
    from tiger.calibration.level import level_procedure

    _calibrate(
        _Wishes(config, emulate, seed, yes, json_file),
        lambda robot: level_procedure(turn, robot.leveling.ride_stroke_mm if arm else None),
    )


@app.command()
def strokes(
    config: Config = None,
    emulate: Emulate = None,
    seed: Seed = 0,
    yes: Yes = False,
    json_file: JsonFile = None,
    positions: Annotated[
        int, typer.Option(metavar="NUMBER", min=2, max=20, help="How many strokes are measured.")
    ] = 5,
    arm: Annotated[
        bool, typer.Option("--arm", help="Let the robot move its actuators; the emulated one always does.")
    ] = False,
    plots: Annotated[
        Path | None,
        typer.Option("--plots", metavar="FOLDER", help="Draw stroke against potentiometer into this folder."),
    ] = None,
) -> None:
    """Potentiometers, against a ruler (Figure 3.9)."""
    from tiger.calibration.strokes import plot, positions_mm, strokes_procedure

    if plots is not None:
        make_folder(plots)
    moves = arm or emulate is not None
    wishes = _Wishes(config, emulate, seed, yes, json_file)
    result = _calibrate(
        wishes,
        lambda robot: strokes_procedure(positions_mm(robot.actuator.stroke_max_mm, positions, moves), moves),
        draw=None if plots is None else lambda found: typer.echo(f"drew {plot(found, plots)}"),
    )
    assert result is not None


@app.command()
def wheels(
    config: Config = None,
    emulate: Emulate = None,
    seed: Seed = 0,
    json_file: JsonFile = None,
    distance: Annotated[
        float, typer.Option(metavar="METRES", min=0.5, max=100.0, help="How far to drive ahead.")
    ] = 5.0,
    turns: Annotated[
        int, typer.Option(metavar="NUMBER", min=-10, max=10, help="Full turns, + to the left.")
    ] = 2,
    turn_speed: Annotated[
        float, typer.Option(metavar="M/S", min=0.0, max=2.0, help="Speed while turning; 0: on the spot.")
    ] = 0.0,
    arm: Annotated[bool, typer.Option("--arm", help="Let the robot drive, each time you agree.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="FILE", help="Write the [drive] factors here.")
    ] = None,
) -> None:
    """Wheel radius and yaw scale.

    From a straight drive and full turns; prints them for robot.toml.
    """
    from tiger.calibration.driving import Course, calibrate_wheels
    from tiger.calibration.wheels import as_toml

    if not (arm or emulate):
        fail("wheels: the robot has to drive for it; give --arm when its way is clear")
    if turns == 0:
        fail("wheels: --turns 0 turns nothing; ask for at least one")
    refuse_unwritable(output)
    wishes = _Wishes(config, emulate, seed, True, json_file)
    course = Course(distance, turns, turn_speed)
    with _told(), aside(json_file), _Screen() as screen:
        robot = _load(wishes)
        if emulate is not None:
            from tiger.calibration.driving import virtual_ticks
            from tiger.calibration.person import EmulatedPerson

            rig = _rig(robot, emulate, seed)
            person = EmulatedPerson(rig, seed, screen.say, screen.show)
            found = calibrate_wheels(robot, rig.daemon, virtual_ticks(rig), person, course)
        else:
            from tiger.calibration.driving import real_ticks
            from tiger.daemon.clock import MonotonicClock
            from tiger.daemon.daemon import Daemon
            from tiger.devices.ports import SerialPorts

            clock = MonotonicClock()
            daemon = Daemon(robot, SerialPorts(), clock, nonce=_nonce())
            try:
                found = calibrate_wheels(robot, daemon, real_ticks(daemon, clock), screen, course)
            finally:
                daemon.close()
    fragment = as_toml(found)
    with aside(json_file):
        _show("wheels", found)
        typer.echo(f"\nFor your robot.toml:\n\n{fragment}")
    _keep("wheels", found, wishes)
    if output is not None:
        _write(output, fragment)


# ------------------------------------------------------------------------------------------ what all share


@dataclass(frozen=True)
class _Wishes:
    config: Path | None
    emulate: str | None
    seed: int
    yes: bool
    json_file: Path | None


def _calibrate(wishes: _Wishes, make: Any, draw: Any = None) -> Result:
    """Run a procedure of one board, show what it found, store it when the user agrees."""
    from tiger.calibration import parameters
    from tiger.calibration.runner import run

    with _told():
        robot = _load(wishes)
        procedure: Procedure = make(robot)
        station, person, screen = _bench(robot, wishes)
        try:
            with aside(wishes.json_file):
                with screen:
                    result = run(procedure, station, person)
                _show(procedure.name, result)
                if draw is not None:
                    draw(result)
            _keep(procedure.name, result, wishes)
            with aside(wishes.json_file):
                board = procedure.board.name.lower()
                if not (
                    wishes.yes or typer.confirm(f"\nStore this in the EEPROM of {board}?", default=False)
                ):
                    typer.echo("Nothing was stored.")
                    raise typer.Exit(1)
                station.connect(procedure.board)
                parameters.store(station, procedure.board, result.parameters)
                typer.echo(f"Stored on {board}, read back and compared.")
        finally:
            station.close()
    return result


def _bench(robot: RobotConfig, wishes: _Wishes) -> tuple[Station, Person, _Screen]:
    from tiger.calibration.station import RealTime, Station, VirtualTime

    screen = _Screen()
    if wishes.emulate is None:
        from tiger.devices.ports import SerialPorts

        return Station(robot.ports, SerialPorts(), RealTime(), _nonce()), screen, screen
    from tiger.calibration.person import EmulatedPerson

    rig = _rig(robot, wishes.emulate, wishes.seed)
    station = Station(rig.config.ports, rig.ports, VirtualTime(rig))
    return station, EmulatedPerson(rig, wishes.seed, screen.say, screen.show), screen


def _nonce() -> int:
    return int(time.monotonic() * 1e3) & 0xFFFF


def _rig(robot: RobotConfig, scenario: str, seed: int) -> Rig:
    from tiger.emulation.scenarios import load_scenario
    from tiger.rig.virtual import Rig

    return Rig(robot, load_scenario(scenario, robot.drive), seed)


def _load(wishes: _Wishes) -> RobotConfig:
    from tiger.config.robot import load_robot

    refuse_unwritable(wishes.json_file)
    return load_robot(wishes.config)


@contextmanager
def _told() -> Iterator[None]:
    """Say what went wrong instead of showing a traceback."""
    from tiger.calibration.procedure import CalibrationError
    from tiger.config.errors import ConfigError
    from tiger.models.eam import MechanismError

    try:
        yield
    except (ConfigError, MechanismError) as error:
        fail(str(error))
    except CalibrationError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    except (KeyboardInterrupt, typer.Abort) as error:  # at a prompt, Ctrl-C and the input's end are one
        if isinstance(error.__context__, EOFError):
            fail("\nThe input ended before the answer: nothing was stored; run it in a terminal")
        typer.echo("\nEnded by you: everything is disarmed, nothing was stored.", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _show(name: str, result: Result) -> None:
    """The table and the notes."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"calibrate {name}", title_justify="left")
    for heading, side in (("what", "left"), ("found", "right"), ("unit", "left"), ("limit", "right")):
        table.add_column(heading, justify=side)  # type: ignore[arg-type]
    table.add_column("")
    for finding in result.findings:
        limit = "" if finding.limit is None else f"{finding.limit:.4g}"
        mark = "" if finding.limit is None else "ok" if finding.good else "BEYOND"
        table.add_row(finding.name, f"{finding.value:.5g}", finding.unit, limit, mark)
    Console().print(table)
    for note in result.notes:
        typer.echo(f"note: {note}")


def _keep(name: str, result: Result, wishes: _Wishes) -> None:
    """The file that --json asks for."""
    if wishes.json_file is not None:
        report = {"calibration": name, "emulated": wishes.emulate, **asdict(result)}
        write_json(wishes.json_file, report)


def _write(file: Path, text: str) -> None:
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        fail(f"{file}: cannot be written ({error.strerror}); choose another place")


class _Screen:
    """The person at the terminal: a progress bar, prompts and questions. A `Person`."""

    def __init__(self) -> None:
        self._progress: Progress | None = None
        self._shown = ""

    def __enter__(self) -> _Screen:
        self._start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop()

    def _start(self) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        columns = (BarColumn(40), TextColumn("{task.percentage:>3.0f} %"), TextColumn("{task.description}"))
        self._progress = Progress(*columns, transient=True)
        self._task = self._progress.add_task("connecting", total=1.0)
        self._progress.start()

    def _stop(self) -> None:
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """The bar makes room for a question."""
        self._stop()
        yield
        self._start()

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        if self._progress is not None:
            self._progress.console.print(text, highlight=False)
        else:
            typer.echo(text)

    def show(self, turn: Turn) -> None:
        """Move the bar."""
        if self._progress is not None:
            self._progress.update(self._task, completed=turn.progress, description=turn.text)

    def confirm(self, ask: Confirm) -> None:
        """Ask for something to be done."""
        with self._asking():
            typer.prompt(f"{ask.text}\nThen press Enter", default="", show_default=False)

    def permit(self, text: str) -> bool:
        """Ask for leave to move; anything but yes is no."""
        with self._asking():
            return typer.confirm(text, default=False)

    def measure(self, ask: Measure) -> tuple[float, ...]:
        """Ask for numbers until they are numbers."""
        with self._asking():
            while True:
                words = typer.prompt(ask.text).replace(",", " ").split()
                try:
                    values = tuple(float(word) for word in words)
                except ValueError:
                    values = ()
                if len(values) == ask.what.count:
                    return values
                typer.echo(f"That needs {ask.what.count} number(s) with spaces between, such as 12.5.")
