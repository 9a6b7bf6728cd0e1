"""`tiger study NAME`: every study module becomes a command; the parameters of its `run` become options."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Run an experiment of the dissertation again.",
)


def _run(module_name: str, parameters: dict[str, Any], json_path: Path | None, plots: Path | None) -> None:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from tiger.config.errors import ConfigError

    console = Console()
    module = importlib.import_module(f"tiger.studies.{module_name}")
    try:
        if "progress" in inspect.signature(module.run).parameters:
            columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
            with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
                task = bar.add_task(module_name.replace("_", "-"), total=1.0)
                parameters["progress"] = lambda done: bar.update(task, completed=done)
                report: Report = module.run(**parameters)
        else:
            report = module.run(**parameters)
    except (ConfigError, ValueError) as error:
        Console(stderr=True).print(
            f"study {module_name.replace('_', '-')}: {error}", style="red", markup=False
        )
        raise typer.Exit(2) from None
    console.print(report.table())
    for name, value in report.assumptions.items():
        console.print(f"  {name}: {value}", style="dim", markup=False, highlight=False)
    if json_path is not None:
        report.write_json(json_path)
    if plots is not None:
        plots.mkdir(parents=True, exist_ok=True)
        for path in module.plot(report, plots):
            console.print(f"plot: {path}", markup=False, highlight=False)


def _command(module_name: str) -> Callable[..., None]:
    """Build the command of one study from the signature of its `run`; imports the study only now."""
    module = importlib.import_module(f"tiger.studies.{module_name}")
    signature = inspect.signature(module.run)
    own = [
        parameter.replace(
            kind=inspect.Parameter.KEYWORD_ONLY, annotation=_evaluated(parameter.annotation, module)
        )
        for parameter in signature.parameters.values()
        if parameter.name != "progress"
    ]
    shared = [
        inspect.Parameter(
            "json_path",
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                Path | None, typer.Option("--json", help="Write rows, series and assumptions here.")
            ],
        ),
        inspect.Parameter(
            "plots",
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[Path | None, typer.Option("--plots", help="Write the figures as PNG here.")],
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


def _evaluated(annotation: Any, module: ModuleType) -> Any:
    """Return the type behind an annotation of `module`, which may be text (postponed evaluation)."""
    return eval(annotation, vars(module)) if isinstance(annotation, str) else annotation


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
