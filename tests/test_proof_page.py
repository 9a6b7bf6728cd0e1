"""The page of proofs: what ran replaces what was known of it, the rest stays."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import pytest

@pytest.mark.parametrize("size", [1, 2])
def test_size(size, record_figure):
    record_figure("size | of it", size * 1.0, "<= 1")
    record_figure("twice", {factor} * size)
    assert size <= 1

def test_quiet():
    pass
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path / "conftest.py")
    return tmp_path


def prove(folder: Path, *options: str) -> dict[tuple[str, str], tuple[str, str]]:
    """Run pytest; return figure and outcome by test and what was measured."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(folder)]
    subprocess.run(
        [*command, "--proof-page", "page.md", *options], cwd=folder, check=False, capture_output=True
    )
    rows = {}
    for line in (folder / "page.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("| test_"):
            cells = line.replace("\\|", "/")[2:-2].split(" | ")
            assert len(cells) == 6
            rows[cells[0], cells[1]] = cells[2], cells[4]
    return rows


@pytest.mark.parametrize("processes", ["0", "2"])
def test_every_figure_is_there_with_what_became_of_its_test(folder: Path, processes: str) -> None:
    (folder / "test_it.py").write_text(TESTS.format(factor=2), encoding="utf-8")
    assert prove(folder, "-n", processes) == {
        ("test_size[1]", "size / of it"): ("1", "passed"),
        ("test_size[1]", "twice"): ("2", "passed"),
        ("test_size[2]", "size / of it"): ("2", "failed"),
        ("test_size[2]", "twice"): ("4", "failed"),
        ("test_quiet", "-"): ("", "passed"),
    }


def test_what_ran_again_replaces_what_was_known_of_it(folder: Path) -> None:
    (folder / "test_it.py").write_text(TESTS.format(factor=2), encoding="utf-8")
    before = prove(folder)
    order = list(before)
    (folder / "test_it.py").write_text(TESTS.format(factor=3), encoding="utf-8")
    after = prove(folder, "-k", "size and 1")
    assert list(after) == order
    assert after == before | {("test_size[1]", "twice"): ("3", "passed")}
