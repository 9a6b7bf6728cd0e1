"""Shared by all tests: the figures that `make proof` writes down.

The page keeps a table for each test file. What ran replaces what was known of the same test, as soon as it
has run; all other rows stay. So a proof may be interrupted or run in parts, and each row says when it was
true.
"""

from __future__ import annotations

import datetime
import platform
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

HEAD = """# Proof

Written by `make proof`: what is too long for `make test`, with the figures it measured. The last column says
when and with which commit a test last ran (+: with changes on top), on which machine and Python.
"""
COLUMNS = "| test | what | figure | bar | outcome | last run |"
RULE = "|---|---|---|---|---|---|"


class Row(NamedTuple):
    """One measured figure, the bar it was held against, and the test that did it."""

    test: str
    what: str
    figure: str
    bar: str
    outcome: str
    last_run: str

    def __str__(self) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in self) + " |"


class ProofPage:
    """The page, kept up to date while tests run."""

    def __init__(self, path: Path, last_run: str) -> None:
        self._path = path
        self._last_run = last_run

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the figures of a test that has run, here or in another process."""
        if report.when == "call" or (report.when == "setup" and report.failed):
            file, _, test = report.nodeid.partition("::")
            found: list[Any] = [value for key, value in report.user_properties if key == "figure"]
            rows = [Row(test, *cells, report.outcome, self._last_run) for cells in found or [("-", "", "")]]
            tables = read_tables(self._path)
            others = [row for row in tables.get(file, []) if row.test != test]
            at = next((i for i, row in enumerate(tables.get(file, [])) if row.test == test), len(others))
            tables[file] = [*others[:at], *rows, *others[at:]]
            write_tables(self._path, tables)


def read_tables(path: Path) -> dict[str, list[Row]]:
    """Return the rows of a page by test file; none of a page that is not there."""
    tables: dict[str, list[Row]] = {}
    file = ""
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        if line.startswith("## "):
            file = line[3:].strip("`")
        elif line.startswith("| ") and line != COLUMNS:
            cells = line.replace("\\|", "\0")[2:-2].split(" | ")
            tables.setdefault(file, []).append(Row(*(cell.replace("\0", "|") for cell in cells)))
    return tables


def write_tables(path: Path, tables: dict[str, list[Row]]) -> None:
    """Write a page."""
    parts = [HEAD]
    for file, rows in sorted(tables.items()):
        parts += [f"## `{file}`\n", "\n".join([COLUMNS, RULE, *map(str, rows)]) + "\n"]
    path.write_text("\n".join(parts), encoding="utf-8")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--proof-page", metavar="FILE", help="keep the recorded figures on this Markdown page")


def pytest_configure(config: pytest.Config) -> None:
    page = config.getoption("--proof-page")
    if page and not hasattr(config, "workerinput"):  # of several processes, one writes
        config.pluginmanager.register(ProofPage(Path(page), _last_run()))


@pytest.fixture
def record_figure(request: pytest.FixtureRequest) -> Callable[[str, object, str], None]:
    """Return `record(what, value, bar)`: keeps a measured figure for the proof page."""

    def record(what: str, value: object, bar: str = "") -> None:
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        request.node.user_properties.append(("figure", (what, shown, bar)))

    return record


def _last_run() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+", "--exclude=*"]
    revision = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    return f"{datetime.date.today():%Y-%m-%d}, {revision or 'no checkout'}, {machine}"
