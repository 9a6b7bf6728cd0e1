"""`tiger identify`: how the body answers its strokes, from a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tiger.cli.answers import JsonFile, fail, reading, refuse_unwritable, write_json

if TYPE_CHECKING:
    from tiger.calibration.identify import Identification


def identify(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log file, or a folder: its newest log.")],
    json_file: JsonFile = None,
    plots: Annotated[
        Path | None,
        typer.Option("--plots", metavar="FOLDER", help="Write the responses as a picture into this folder."),
    ] = None,
) -> None:
    """Identify how roll and pitch answer the strokes, below about 1 Hz, and say what was not excited."""
    from tiger.calibration.identify import IdentifyError, plot, read
    from tiger.calibration.identify import identify as estimate
    from tiger.logs.errors import LogError
    from tiger.logs.reader import open_log
    from tiger.models.eam import MechanismError

    refuse_unwritable(json_file)
    try:
        opened = open_log(log)
        with reading(opened, "reading"):
            recording = read(opened)
        found = estimate(recording, opened.robot())
    except (LogError, IdentifyError, MechanismError) as error:
        fail(f"{log}: {error}" if isinstance(error, IdentifyError) else error)
    for text in opened.damage:
        typer.echo(text, err=True)
    to_screen = str(json_file) == "-"
    if not to_screen:
        _show(found)
    if json_file is not None:
        write_json(json_file, found.as_json())
    try:
        if plots is not None:
            typer.echo(f"plot: {plot(found, plots)}", err=to_screen)
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); choose another place")


def _show(found: Identification) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    moved = ", ".join(f"{name} {rms:.1f}" for name, rms in found.stroke_rms_mm.items())
    console.print(f"{found.duration_s:.0f} s; strokes in mm RMS: {moved}")
    gains = Table("deg per mm", "measured", "95 %", "expected", "", box=None, header_style="bold")
    for column in gains.columns[1:4]:
        column.justify = "right"
    for gain in found.gains:
        verdict = "" if gain.agrees else f"{gain.measured - gain.expected:+.4f}"
        if not gain.agrees and abs(gain.expected) > gain.half_width:
            verdict = f"{100 * (gain.measured / gain.expected - 1):+.1f} %"
        gains.add_row(
            f"{gain.output.removesuffix('_deg')} per {gain.mode}",
            f"{gain.measured:.4f}",
            f"± {gain.half_width:.4f}",
            f"{gain.expected:.4f}",
            verdict,
            style=None if gain.agrees else "yellow",
        )
    console.print(gains)
    for mode in found.body_modes:
        console.print(
            f"{mode.axis}: first mode at {mode.frequency_hz:.2f} ± {mode.frequency_half_width_hz:.2f} Hz "
            f"(expected {mode.expected_hz:.2f}), damping {mode.damping:.2f} ± {mode.damping_half_width:.2f} "
            f"(expected {mode.expected_damping:.2f})"
        )
    for remark in found.remarks:
        console.print(f"  {remark}", style="dim", markup=False, soft_wrap=True)
