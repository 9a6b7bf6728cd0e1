"""How the studies draw: PNG files from figures of their own, with neither a window nor pyplot's globals."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from tiger.studies.report import Report


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


def save_panels(report: Report, path: Path, panels: Sequence[tuple[str, Sequence[tuple[str, str]]]]) -> Path:
    """Draw stacked panels of the report's series over its `time_s` into a PNG.

    A panel is (label of its y axis, [(series name, legend), ...]).
    """
    series = report.arrays()
    with gridded():
        figure = new_figure(7.0, 1.9 * len(panels))
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for axis, (label, lines) in zip(axes, panels, strict=True):
            for name, legend in lines:
                axis.plot(series["time_s"], series[name], label=legend, lw=1.2)
            axis.set_ylabel(label)
            if len(lines) > 1:
                axis.legend(loc="upper right", ncols=len(lines))
        axes[-1].set_xlabel("time (s)")
        figure.suptitle(report.title)
        return save(figure, path)
