"""What is wrong with a configuration file, said so that the reader can put it right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError


class ConfigError(Exception):
    """A configuration that cannot be used. `messages` holds one line per wrong key."""

    def __init__(self, messages: str | Sequence[str]) -> None:
        self.messages: tuple[str, ...] = (messages,) if isinstance(messages, str) else tuple(messages)
        super().__init__("\n".join(self.messages))

    @classmethod
    def from_validation(cls, error: ValidationError, source: str) -> ConfigError:
        """Turn pydantic's findings about `source` (a file or preset name) into one line per wrong key."""
        return cls([_explain(finding, source) for finding in error.errors()])


# What to do about a finding, by pydantic's error type; the rest is said by pydantic's own message.
_NEXT_STEP = {
    "missing": "add it",
    "extra_forbidden": "remove it or correct its spelling",
    "union_tag_invalid": "use one of the kinds named",
    "union_tag_not_found": "add `kind`",
}


def _explain(finding: object, source: str) -> str:
    assert isinstance(finding, dict)
    # A discriminated union puts its tag into the path ("actuator.rate.lag_s"); the file has no such key.
    parts = [str(part) for part in finding["loc"]]
    if len(parts) > 2 and parts[0] == "actuator" and parts[1] in ("rate", "force"):
        del parts[1]
    key = ".".join(parts)
    kind, message = finding["type"], str(finding["msg"])
    step = _NEXT_STEP.get(kind, "correct the value")
    if kind == "missing":
        return f"{source}: {key} is missing; {step}"
    if kind == "extra_forbidden":
        return f"{source}: {key} is not a known key; {step}"
    value = "" if isinstance(finding["input"], dict) else f" = {finding['input']!r}"
    message = message.removeprefix("Value error, ")
    message = f"{message[:1].lower()}{message[1:]}"
    if not parts:  # keys that contradict each other: the message says what to do
        return f"{source}: {message}"
    return f"{source}: {key}{value}: {message}; {step}"
