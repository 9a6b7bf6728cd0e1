"""How the studies draw: PNG files from figures of their own, with neither a window nor pyplot's globals."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import cycle
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tiger.studies.report import Report

_STYLES = ("-", "-", (0, (4, 3)))
"""Of the curves of a panel: the third is broken, for it often lies on another."""


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure that finds room for its labels by itself."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def save(figure: Figure, path: Path, dpi: int = 110) -> Path:
    """Write the figure to `path`, making its folder, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=dpi)
    return path


@contextmanager
def gridded() -> Iterator[None]:
    """Draw and save in this look: curves over time, on a faint grid, with small letters."""
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        yield


def legend_above(axis: Axes) -> None:
    """Name the curves in one row above the panel, where it covers none of them."""
    names = axis.get_legend_handles_labels()[1]
    axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(names), frameon=False, borderaxespad=0.1
    )


def save_panels(report: Report, path: Path, panels: Sequence[tuple[str, Sequence[tuple[str, str]]]]) -> Path:
    """Draw stacked panels of the report's series over its `time_s` into a PNG.

    A panel is (label of its y axis, [(series name, legend), ...]); curves named as in the panel above are
    not named again.
    """
    series = report.arrays()
    with gridded():
        figure = new_figure(7.0, 1.9 * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        above: list[str] = []
        for axis, (label, lines) in zip(axes, panels, strict=True):
            legends = [legend for _, legend in lines]
            for (name, legend), style in zip(lines, cycle(_STYLES), strict=False):
                axis.plot(series["time_s"], series[name], label=legend, lw=1.2, ls=style)
            axis.set_ylabel(label)
            if len(lines) > 1 and legends != above:
                legend_above(axis)
            above = legends
        axes[-1].set_xlabel("time (s)")
        figure.suptitle(report.title)
        return save(figure, path)
