"""What every study returns, and how it reaches a person (table), a program (JSON) and a page (plots)."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray
    from rich.table import Table

    Progress = Callable[[float], None]
    """Is told how much of a study is done, 0 to 1."""

CORNERS = ("FL", "FR", "RL", "RR")
"""As rows and legends name them."""


def unwatched(_done: float) -> None:
    """Stand for a `Progress` that nobody looks at."""


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of a study; `printed` is the dissertation's, in the same unit, None where it prints none."""

    name: str
    value: float
    unit: str
    printed: float | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """Result of a study: the rows of its table, the series behind its plots, and what had to be assumed.

    `series` maps a name that ends in its unit (`roll_deg`) to an array of any shape; `assumptions` maps the
    name of a choice the dissertation leaves open to the value chosen (number or text).
    """

    title: str
    rows: tuple[Row, ...]
    series: Mapping[str, ArrayLike] = field(default_factory=dict)
    assumptions: Mapping[str, Any] = field(default_factory=dict)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the series as arrays, for the plots."""
        return {name: np.asarray(values) for name, values in self.series.items()}

    def table(self) -> Table:
        """Render the rows beside the dissertation's figures."""
        from rich.table import Table

        table = Table(title=self.title)
        table.add_column("quantity")
        table.add_column("value", justify="right")
        table.add_column("printed", justify="right")
        table.add_column("unit")
        for row in self.rows:
            printed = "" if row.printed is None else _shown(row.printed)
            table.add_row(row.name, _shown(row.value), printed, row.unit)
        return table

    def to_json(self) -> dict[str, Any]:
        """Return title, rows (name, value, unit, printed), series and assumptions as plain types."""
        return {
            "title": self.title,
            "rows": [
                {"name": r.name, "value": _plain(r.value), "unit": r.unit, "printed": r.printed}
                for r in self.rows
            ],
            "series": {name: _plain(values) for name, values in self.arrays().items()},
            "assumptions": {name: _plain(value) for name, value in self.assumptions.items()},
        }

    def write_json(self, path: Path) -> None:
        """Write `to_json()` to `path`; a figure that is not finite becomes null, for JSON knows no NaN."""
        path.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _shown(value: float) -> str:
    """A figure for the table; a dash where nothing happened that it could be of."""
    return f"{value:.4g}" if np.isfinite(value) else "-"


def _plain(value: Any) -> Any:
    """Turn numpy values into JSON types, and what is not finite into None."""
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()] if value.ndim else _plain(value.item())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value
