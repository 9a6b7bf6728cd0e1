"""What the pages tell a reader to type is what the programs accept, and what they point to is there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from tiger.cli.answers import scenario_names
from tiger.cli.commands import COMMANDS, _command, app
from tiger.cli.study import STUDIES

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [
        ROOT / "README.md",
        ROOT / "protocol" / "README.md",
        ROOT / "firmware" / "native" / "README.md",
        *(ROOT / "docs").glob("*.md"),
    ]
)
PLACEHOLDER = re.compile(r"[A-Z]+|\.\.\.|.*\$.*|tcp://HOST:\d+")
FOLDERS = ("bench", "deploy", "docs", "firmware", "host", "protocol", "scripts", "tests")


class Line(NamedTuple):
    """Something to type, and where it stands."""

    where: str
    text: str
    whole: bool  # a line of a block; otherwise a few words in a sentence, which may leave values out

    def __str__(self) -> str:
        return f"{self.where}: {self.text}"


def code(page: Path) -> list[Line]:
    """Everything that is set as code."""
    found, fenced = [], False
    for number, text in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        where = f"{page.relative_to(ROOT)}:{number}"
        if text.startswith("```"):
            fenced = not fenced
        elif fenced or text.startswith("    "):
            found.append(Line(where, text.strip(), whole=True))
        else:
            found += [Line(where, span, whole=False) for span in re.findall(r"`([^`]+)`", text)]
    return found


CODE = [line for page in PAGES for line in code(page)]


def typed(name: str) -> list[Line]:
    """The lines that call a program, from its name on, without comments and what follows a semicolon."""
    start = re.compile(rf"(?:^|\$ |sudo -u \w+ \S+ ){name} (.*)")
    lines = []
    for line in CODE:
        found = start.match(line.text)
        if found:
            words = re.split(r"  +|\s#|; |`|,$", found.group(1), maxsplit=1)[0]
            lines.append(line._replace(text=words.strip()))
    return lines


def alternatives(text: str) -> list[list[str]]:
    r"""The words of a command line; `a\|b` stands for several lines."""
    lines: list[list[str]] = [[]]
    for word in shlex.split(text.replace("\\|", "|")):
        lines = [[*line, part] for line in lines for part in word.split("|")]
    return lines


def resolve(words: list[str]) -> tuple[Any, list[str]]:
    """The command that the first words name, and the words after them."""
    if words[0].startswith("--"):
        return typer.main.get_command(app), words
    assert words[0] in COMMANDS, f"there is no command {words[0]}"
    command, rest = _command(words[0], COMMANDS[words[0]]), words[1:]
    while hasattr(command, "list_commands") and rest and not rest[0].startswith("-"):
        sub = command.get_command(typer.Context(command), rest[0])
        assert sub is not None, f"{command.name} has no command {rest[0]}"
        command, rest = sub, rest[1:]
    return command, rest


TIGER = typed("tiger")
IDS = [str(line) for line in TIGER]


def test_the_pages_show_a_good_many_command_lines() -> None:
    """Should the pages' form change, the tests below must not pass for want of lines."""
    assert sum(line.whole for line in TIGER) > 40
    assert {words[0] for line in TIGER for words in alternatives(line.text)} >= set(COMMANDS)


@pytest.mark.parametrize("line", TIGER, ids=IDS)
def test_every_command_line_of_the_pages_is_one_that_the_program_accepts(line: Line) -> None:
    for words in alternatives(line.text):
        command, rest = resolve(words)
        options = {
            name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)
        }
        for word in rest:
            assert not word.startswith("--") or word in options | {"--help"}, f"no option {word}"
        if "--emulate" in rest[:-1]:
            scenario = rest[rest.index("--emulate") + 1]
            assert (
                scenario in scenario_names() or scenario.endswith(".toml") or PLACEHOLDER.fullmatch(scenario)
            )
        placeholders = any(PLACEHOLDER.fullmatch(word) for word in rest)
        if line.whole and not placeholders and not hasattr(command, "list_commands"):
            command.make_context(command.name, rest)  # raises what the user would see


def test_every_example_in_a_help_is_one_that_the_program_accepts() -> None:
    for entry in COMMANDS.values():
        for example in entry.examples:
            words = shlex.split(example)
            command, rest = resolve(words[1:])
            if "--help" not in rest:
                command.make_context(command.name, rest)


def test_every_task_of_make_that_the_pages_name_exists() -> None:
    rules = (ROOT / "Makefile").read_text() + (ROOT / "firmware" / "avr.mk").read_text()
    tasks = set(re.findall(r"^([a-z-]+):", rules, re.MULTILINE))
    named = {(str(line), words.split()[0]) for line in typed("make") for words in [line.text] if words}
    named |= {(str(line), task) for line in CODE for task in re.findall(r"\bmake -C \S+ (\w+)", line.text)}
    assert len(named) > 10
    assert not [where for where, task in named if task not in tasks]


def test_every_file_that_the_pages_point_to_is_there() -> None:
    missing = []
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target and not (page.parent / target).exists():
                missing.append(f"{page.name}: {target}")
    for line in CODE:
        for path in re.findall(rf"(?<![\w./-])(?:{'|'.join(FOLDERS)})/[\w./*-]*[\w*](?![{{\w])", line.text):
            if not any(ROOT.glob(path)):
                missing.append(f"{line.where}: {path}")
    assert not missing


def links(page: Path) -> list[tuple[Path, str]]:
    """What a page links to beside it in the project: the file and the heading (empty: all of it)."""
    found = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]+))?\)", page.read_text(encoding="utf-8"))
    return [(page.parent / path if path else page, part) for path, part in found if "://" not in path]


def anchors(page: Path) -> set[str]:
    """The names under which the headings of a page can be linked to."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def test_every_heading_that_the_pages_point_to_is_there() -> None:
    wanted = [(page, target, part) for page in PAGES for target, part in links(page) if part]
    assert len(wanted) > 3
    assert not [
        f"{page.name}: {target.name}#{part}"
        for page, target, part in wanted
        if target.suffix == ".md" and part not in anchors(target)
    ]


def test_every_page_and_every_picture_is_shown_on_another_page() -> None:
    shown = {target.resolve() for page in PAGES for target, _ in links(page) if target != page}
    pages_and_pictures = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "img").iterdir()]
    assert not [path.name for path in pages_and_pictures if path not in shown]


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_a_page_begins_with_its_heading(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    assert next(line for line in lines if not line.startswith("<!--")).startswith("# ")


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_is_on_a_page(study: str) -> None:
    assert any(re.search(rf"\bstudy {study}\b", line.text) for line in CODE)
