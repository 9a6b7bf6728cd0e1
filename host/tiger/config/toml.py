"""Reads TOML files; what is wrong with one becomes a `ConfigError`."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from tiger.config.errors import ConfigError


def read(path: str | Path) -> dict[str, Any]:
    """Return the tables of a file. Raises ConfigError when it cannot be read or is not TOML."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is no text in UTF-8; save it as such") from error
    return parsed(text, str(path))


def preset_names(*folder: str) -> tuple[str, ...]:
    """Return the sorted names of the packaged files in a folder below `presets`, without the suffix."""
    found = resources.files("tiger.config").joinpath("presets", *folder).iterdir()
    return tuple(sorted(item.name.removesuffix(".toml") for item in found if item.name.endswith(".toml")))


def read_preset(*way: str) -> dict[str, Any]:
    """Return the tables of a packaged file, by its way below `presets`, without the suffix."""
    folder = resources.files("tiger.config") / "presets"
    return tomllib.loads(folder.joinpath(*way[:-1], f"{way[-1]}.toml").read_text(encoding="utf-8"))


def parsed(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a text; raises ConfigError, which calls it `source`."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source}: is not valid TOML ({error}); correct that line") from error


def is_path(name_or_path: str | Path) -> bool:
    """Whether this is meant as a file, not as the name of a preset."""
    return isinstance(name_or_path, Path) or name_or_path.endswith(".toml") or "/" in name_or_path
