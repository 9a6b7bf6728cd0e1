"""`dataclasses.replace` for the control tick, which calls it a dozen times: a third of its time.

The fields are copied slot by slot, past the `__init__` that would take each of them as a keyword.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_Record = TypeVar("_Record")
_Setters = dict[str, "Callable[[Any, Any], None]"]


def replace(record: _Record, **changes: Any) -> _Record:
    """Return a copy of a dataclass with slots and without `__post_init__`, some of its fields changed.

    Raises TypeError for a field that it does not have.
    """
    kind: Any = type(record)
    copy, setters = _tools(kind)
    changed: _Record = copy(record)
    for name, value in changes.items():
        if name not in setters:
            raise TypeError(f"{kind.__name__} has no field {name!r}")
        setters[name](changed, value)
    return changed


@cache
def _tools(kind: type[Any]) -> tuple[Callable[[Any], Any], _Setters]:
    """Return what copies an instance, and what sets each of its slots, frozen or not."""
    if hasattr(kind, "__post_init__"):
        raise TypeError(f"{kind.__name__} has a __post_init__, which must run: use dataclasses.replace")
    setters: _Setters = {field.name: kind.__dict__[field.name].__set__ for field in fields(kind)}
    lines = [f"    set_{name}(copied, record.{name})" for name in setters]
    source = "\n".join(["def copy(record):", "    copied = new(kind)", *lines, "    return copied"])
    scope: dict[str, Any] = {"new": object.__new__, "kind": kind}
    scope |= {f"set_{name}": setter for name, setter in setters.items()}
    exec(source, scope)  # as dataclasses itself makes __init__
    return scope["copy"], setters
