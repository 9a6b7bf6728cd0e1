"""Shared by all tests: the figures that `make proof` writes down."""

from __future__ import annotations

import datetime
import platform
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable


class Figure(NamedTuple):
    """One measured figure and the bar it was held against."""

    test: str
    what: str
    value: str
    bar: str


FIGURES = pytest.StashKey[list[Figure]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--proof-page", metavar="FILE", help="write the recorded figures to this Markdown page")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[FIGURES] = []


@pytest.fixture
def record_figure(request: pytest.FixtureRequest) -> Callable[[str, object, str], None]:
    """Return `record(what, value, bar)`: keeps a measured figure for the proof page."""

    def record(what: str, value: object, bar: str = "") -> None:
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        request.config.stash[FIGURES].append(Figure(request.node.name, what, shown, bar))

    return record


def pytest_sessionfinish(session: pytest.Session) -> None:
    page = session.config.getoption("--proof-page")
    figures = session.config.stash[FIGURES]
    if not page or not figures:
        return
    lines = [
        "# Proof",
        "",
        "Written by `make proof`: what is too long for `make test`, with the figures it measured.",
        "",
        f"{datetime.date.today():%Y-%m-%d}, {platform.machine()}, Python {platform.python_version()}.",
        "",
        "| what | figure | bar | test |",
        "|---|---|---|---|",
        *(f"| {f.what} | {f.value} | {f.bar} | `{f.test}` |" for f in figures),
        "",
    ]
    Path(page).write_text("\n".join(lines), encoding="utf-8")
