"""`tiger study NAME`: every study module becomes a command; the parameters of its `run` become options."""

from __future__ import annotations

import importlib
import inspect
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from tiger.cli.answers import fail, make_folder, refuse_unwritable, write_json

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from tiger.studies.report import Report

STUDIES = {
    "eam": "Mechanism: stroke to ground clearance, track and motion ratio (Figures 4.3, 4.5)",
    "quarter-car": "Quarter car: modes and the 10 cm step (equation 4.5)",
    "handling": "Sine steer at 30 km/h (Figure 5.5)",
    "corner-bump": "10 cm under the front left wheel (Figure 5.6)",
    "double-bump": "Two bumps at speed, passive and active (Figures 5.7, 5.8)",
    "identification": "Identify the vehicle from one noisy IMU (Figures 6.4-6.8, 6.11)",
    "observer": "Observer with wrong initial state and IMU offset (Figures 6.12, 6.13)",
    "table-6-2": "Ride, road holding and rattle space against Table 6.2 (Figures 6.10, 6.14, 6.15)",
    "speed-sweep": "Passive and active from 15 to 50 m/s (Figure 6.16)",
    "force-limits": "Bumpy road with weak actuators: regulator beside predictive controller",
    "monte-carlo": "Robustness over seeds, roads, mass, springs, COM and delay",
    "shaking-plate": "The robot levels itself on the shaking plate (Figures 4.10, 4.11)",
    "loose-slope": "Up a loose slope, passive and active (Figures 4.13 to 4.15)",
    "tip-over": "Roll-overs at random, without and with the limiter; curbs",
    "uneven-terrain": "Driving over uneven terrain, strokes held and body levelled (Figure 4.12)",
}


class Meaning(NamedTuple):
    """What a parameter of a study is, for the study's help; the same in every study."""

    metavar: str
    help: str
    least: float | None = None


MEANINGS = {
    "vehicle": Meaning("NAME|FILE", "Preset or file of the vehicle."),
    "seed": Meaning("NUMBER", "Of everything random.", 0),
    "first_seed": Meaning("NUMBER", "Seeds count up from here.", 0),
    "noise": Meaning(
        "FACTOR", "Of the sensors' noise: 1 is 0.02 m/s2 and 0.001 rad/s per sample at 200 Hz.", 0
    ),
    "duration_s": Meaning("SECONDS", "How long each run is.", 0.1),
    "speed_kmh": Meaning("KM/H", "Constant speed.", 1),
    "step_m": Meaning("METRES", "Height of the step."),
    "dt_s": Meaning("SECONDS", "Step of the integration.", 1e-5),
    "inertia_divisor": Meaning(
        "FACTOR", "What the moments of inertia are divided by; printed figures differ in it.", 0.01
    ),
    "periods": Meaning("NUMBER", "How many periods are run.", 1),
    "runs": Meaning("NUMBER", "How many runs; of tip-over, one in five is a curb.", 1),
    "jobs": Meaning("NUMBER", "Processes; -1: one for each core, 1: this one.", -1),
    "preview": Meaning("", "The rear wheels are told what the front wheels met."),
    # eam
    "stroke_mm": Meaning("MM", "Longest stroke; section 3.3.2 has 100, the fitted motor 70."),
    "points": Meaning("NUMBER", "How many strokes are solved.", 2),
    # quarter-car
    "axle": Meaning("front|rear", "Whose corner is driven."),
    "push_n": Meaning("NEWTON", "Force of the actuator's push."),
    # handling
    "yaw_rate_amplitude_radps": Meaning("RAD/S", "Amplitude of the sine."),
    "yaw_rate_frequency_radps": Meaning("RAD/S", "Angular frequency of the sine."),
    # corner-bump, double-bump
    "step_at_s": Meaning("SECONDS", "When the step comes."),
    "bump_m": Meaning("METRES", "Height of the bumps."),
    "bump_length_m": Meaning("METRES", "Length of the bumps.", 0.01),
    "attitude_bandwidth_hz": Meaning("HERTZ", "How fast the active car returns to level.", 0),
    "damper_share_kept": Meaning("SHARE", "Part of the damper forces that is not cancelled, 0 to 1.", 0),
    "eam": Meaning("NAME|FILE", "Vehicle whose series actuators are borrowed."),
    # identification, observer
    "snr_db": Meaning("DB", "Signal-to-noise ratio of every output."),
    "simultaneous": Meaning("", "One record with orthogonal multisines at all inputs instead of eight."),
    "closed_loop": Meaning("", "Compare controllers designed from fitted and from true parameters as well."),
    "loop_roads": Meaning("NUMBER", "Roads for that comparison.", 1),
    "iso_road_seed": Meaning("NUMBER", "Of the ISO road.", 0),
    # table-6-2, speed-sweep, force-limits
    "bumpy_noise": Meaning("FACTOR", "Of the sensors' noise on the bumpy road.", 0),
    "iso_noise": Meaning("FACTOR", "Of the sensors' noise on the ISO road.", 0),
    "bumpy_seeds": Meaning("NUMBER", "Runs on the bumpy road.", 1),
    "iso_seeds": Meaning("NUMBER", "Runs on the ISO road.", 1),
    "schedule": Meaning("", "Weights follow the speed; otherwise those of 20 m/s, as in the dissertation."),
    "slowest_mps": Meaning("M/S", "First speed.", 1),
    "fastest_mps": Meaning("M/S", "Last speed.", 1),
    "step_mps": Meaning("M/S", "From one speed to the next.", 0.1),
    "rate_nps": Meaning("N/S", "How fast a force may change.", 1),
    "travel_mm": Meaning("MM", "Suspension travel that the predictive controller aims to keep.", 1),
    # monte-carlo
    "design": Meaning("NAME", "Of the controller: robust, holding, holding-preview or comfort-preview."),
    "road_class": Meaning("A-H", "Class of the road (ISO 8608)."),
    "com": Meaning("SHARE", "Half-width of the centre of mass's error, 0.2: 20 %.", 0),
    "mass": Meaning("SHARE", "Half-width of the mass's error.", 0),
    "spring": Meaning("SHARE", "Half-width of the springs' error.", 0),
    "delay_ms": Meaning("MS", "Mean delay from sensor to actuator.", 0),
    "delay_spread_ms": Meaning("MS", "Half-width of that delay.", 0),
    "cluster": Meaning(
        "ADDRESS", "Dask scheduler, such as tcp://127.0.0.1:8786; default: processes of this computer."
    ),
    # shaking-plate, loose-slope, tip-over, uneven-terrain
    "axis": Meaning("roll|pitch", "About which the plate tilts."),
    "step_deg": Meaning("DEGREES", "Height of the step."),
    "amplitude_deg": Meaning("DEGREES", "Of the rocking."),
    "frequency_hz": Meaning("HERTZ", "Of the rocking."),
    "all_cases": Meaning("", "Also what the figures do not show."),
    "keep": Meaning("FILE", "Keep every outcome here, and go on from it while the program is the same."),
    "picture": Meaning("", "Drive the case of the picture as well."),
    "speeds_kmh": Meaning("KM/H,...", "Speeds with commas between."),
}

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Run an experiment of the dissertation again.",
)


def _run(module_name: str, parameters: dict[str, Any], json_path: Path | None, plots: Path | None) -> None:
    from pydantic import ValidationError
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from tiger.config.errors import ConfigError

    refuse_unwritable(json_path)
    for parameter, value in parameters.items():
        if isinstance(value, float) and not math.isfinite(value):
            fail(
                f"--{parameter.replace('_', '-')} {value:g}: cannot be calculated with; give a finite number"
            )
        if isinstance(value, Path):
            refuse_unwritable(value)
    if plots is not None:
        make_folder(plots)
    to_screen = str(json_path) == "-"
    console = Console(stderr=to_screen)
    module, name = importlib.import_module(f"tiger.studies.{module_name}"), module_name.replace("_", "-")
    try:
        if "progress" in inspect.signature(module.run).parameters:
            columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
            with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
                task = bar.add_task(name, total=1.0)
                parameters["progress"] = lambda done: bar.update(task, completed=done)
                report: Report = module.run(**parameters)
        else:
            report = module.run(**parameters)
    except ValidationError as error:
        fail(str(ConfigError.from_validation(error, f"study {name}")))
    except OSError as error:
        fail(f"study {name}: {error.filename or 'a file'} cannot be used ({error.strerror}); choose another")
    except (ConfigError, ValueError) as error:
        fail(f"study {name}: {error}")
    console.print(report.table())
    for choice, value in report.assumptions.items():
        console.print(f"  {choice}: {value}", style="dim", markup=False, highlight=False)
    if json_path is not None:
        write_json(json_path, report.to_json(), indent=None if to_screen else 1)
    if plots is not None:
        for path in module.plot(report, plots):
            console.print(f"plot: {path}", markup=False, highlight=False)


def _command(module_name: str) -> Callable[..., None]:
    """Build the command of one study from the signature of its `run`; imports the study only now."""
    module = importlib.import_module(f"tiger.studies.{module_name}")
    signature = inspect.signature(module.run)
    own = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=_explained(parameter, module))
        for parameter in signature.parameters.values()
        if parameter.name != "progress"
    ]
    shared = [
        inspect.Parameter(
            "json_path",
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                Path | None,
                typer.Option(
                    "--json", metavar="FILE", help="Write rows, series and assumptions here, - to the screen."
                ),
            ],
        ),
        inspect.Parameter(
            "plots",
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                Path | None, typer.Option("--plots", metavar="FOLDER", help="Write the figures as PNG here.")
            ],
        ),
    ]

    def command(**values: Any) -> None:
        json_path, plots = values.pop("json_path"), values.pop("plots")
        _run(module_name, values, json_path, plots)

    command.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*own, *shared], return_annotation=None
    )
    command.__annotations__ = {p.name: p.annotation for p in [*own, *shared]}
    command.__doc__ = inspect.getdoc(module.run)
    return command


def _explained(parameter: inspect.Parameter, module: ModuleType) -> Any:
    """The type of a parameter, with its meaning for the help."""
    annotation = parameter.annotation
    if isinstance(annotation, str):  # postponed evaluation
        annotation = eval(annotation, vars(module))
    meaning = MEANINGS[parameter.name]
    return Annotated[
        annotation, typer.Option(metavar=meaning.metavar or None, help=meaning.help, min=meaning.least)
    ]


class _LazyStudies(typer.core.TyperGroup):
    """Lists the studies without importing any; imports the one that is asked for."""

    def list_commands(self, _context: Any) -> list[str]:
        return list(STUDIES)

    def get_command(self, _context: Any, name: str) -> Any:
        if name not in STUDIES:
            return None
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name, help=STUDIES[name])(_command(name.replace("-", "_")))
        return typer.main.get_command(single)

    def format_commands(self, _context: Any, formatter: Any) -> None:
        with formatter.section("Studies"):
            formatter.write_dl(list(STUDIES.items()))


@app.callback(cls=_LazyStudies)
def study() -> None:
    """Run an experiment of the dissertation again."""
