"""Logs as files that other programs read: a CSV for each topic, the raw bytes of each line."""

from __future__ import annotations

import csv
import dataclasses
import json
from contextlib import ExitStack
from enum import Enum
from itertools import islice
from typing import TYPE_CHECKING, Any

from tiger.logs.topics import WIRE, WireBytes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from io import BufferedWriter
    from pathlib import Path

    from tiger.logs.reader import Log


def columns(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield a message's leaves with their names, such as inputs.strokes.stroke_mm.0.

    What may have any number of elements is one cell of JSON; what is absent has no cell. Floats keep every
    digit.
    """
    if value is None:
        return
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from columns(getattr(value, field.name), f"{name}.{field.name}".lstrip("."))
    elif isinstance(value, tuple) and value and all(isinstance(v, int | float) for v in value):
        for i, element in enumerate(value):
            yield f"{name}.{i}", element
    elif isinstance(value, tuple):
        yield name, json.dumps(value, default=_plain) if value else ""
    elif isinstance(value, Enum):
        yield name, value.name.lower()
    elif isinstance(value, bytes):
        yield name, value.hex()
    else:
        yield name, value


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return value.hex()


def csv_files(log: Log, folder: Path, topics: Collection[str] | None = None) -> dict[Path, int]:
    """Write one CSV for each topic, time first; returns how many rows each has. Raises LogError, OSError.

    A cell stays empty where a message says nothing. The log is read twice: the columns of a topic are known
    only at its end.
    """
    names: dict[str, dict[str, None]] = {}
    count = 0
    for logged in log.messages(topics):
        count += 1
        names.setdefault(logged.topic, {}).update(dict.fromkeys(n for n, _ in columns(logged.value())))
    folder.mkdir(parents=True, exist_ok=True)
    paths = {topic: csv_file(folder, topic) for topic in names}
    rows = dict.fromkeys(paths.values(), 0)
    with ExitStack() as stack:
        writers = {}
        for topic, path in paths.items():
            file = stack.enter_context(path.open("w", newline="", encoding="utf-8"))
            head = ["log_time_ns", "sample_time_ns", *sorted(names[topic], key=_natural(names[topic]))]
            writers[topic] = csv.DictWriter(file, head, restval="")
            writers[topic].writeheader()
        for logged in islice(log.messages(topics), count):  # a log that is still written has grown meanwhile
            times = {"log_time_ns": logged.t_ns, "sample_time_ns": logged.sample_ns}
            cells = dict(columns(logged.value()))
            writers[logged.topic].writerow(times | cells)
            rows[paths[logged.topic]] += 1
    return rows


def csv_file(folder: Path, topic: str) -> Path:
    """Where `csv_files` writes a topic."""
    return folder / f"{_file_name(topic)}.csv"


def _natural(names: dict[str, None]) -> Any:
    """Sort the columns of a field together, in the order in which fields appeared."""
    first: dict[str, int] = {}
    for i, name in enumerate(names):
        first.setdefault(name.split(".")[0], i)
    order = {name: (first[name.split(".")[0]], i) for i, name in enumerate(names)}
    return order.__getitem__


def wire_files(log: Log, folder: Path) -> dict[Path, int]:
    """Write the bytes of each line and direction, as `tiger protocol capture` reads them; returns sizes."""
    folder.mkdir(parents=True, exist_ok=True)
    sizes: dict[Path, int] = {}
    with ExitStack() as stack:
        files: dict[str, tuple[Path, BufferedWriter]] = {}
        for logged in log.messages():
            if not logged.topic.startswith(WIRE):
                continue
            if logged.topic not in files:
                path = folder / f"{_file_name(logged.topic)}.bin"
                files[logged.topic] = path, stack.enter_context(path.open("wb"))
            path, file = files[logged.topic]
            value = logged.value()
            assert isinstance(value, WireBytes)
            sizes[path] = sizes.get(path, 0) + file.write(value.data)
    return sizes


def _file_name(topic: str) -> str:
    return topic.strip("/").replace("/", "-")
