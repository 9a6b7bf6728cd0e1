"""Frozen dataclasses at a price that a control tick can pay: the type checker guards them.

A tick makes some two hundred small records. A frozen dataclass sets every field of each past a `__setattr__`
that would refuse it, four times as dear as setting them, and `dataclasses.replace` takes all fields through
that `__init__` again, by keyword. Here

    @dataclass(frozen=True, slots=True)

is the dataclass of the standard library to the type checker, which refuses what changes one; at run time the
same class comes without the guard. It stays hashable, and equal to what has the same fields.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass as dataclass
else:
    import dataclasses

    def dataclass(*, frozen=False, slots=False, eq=True):
        """Return a decorator; see the module's text."""
        return dataclasses.dataclass(slots=slots, eq=eq, unsafe_hash=frozen and eq)


_Record = TypeVar("_Record")


def replace(record: _Record, **changes: Any) -> _Record:
    """Return a copy of a dataclass with slots and without `__post_init__`, some of its fields changed.

    Raises TypeError for a field that it does not have.
    """
    kind: Any = type(record)
    changed: _Record = _copier(kind)(record)
    set_field = setattr
    try:
        for name, value in changes.items():
            set_field(changed, name, value)
    except AttributeError:
        raise TypeError(f"{kind.__name__} has no field {name!r}") from None
    return changed


@cache
def _copier(kind: type[Any]) -> Callable[[Any], Any]:
    """Return what copies an instance slot by slot, past the `__init__` that would take each as a keyword."""
    if hasattr(kind, "__post_init__"):
        raise TypeError(f"{kind.__name__} has a __post_init__, which must run: use dataclasses.replace")
    if kind.__dataclass_params__.frozen:
        raise TypeError(f"{kind.__name__} guards its fields: take its decorator from tiger.frozen")
    lines = [f"    copied.{field.name} = record.{field.name}" for field in fields(kind)]
    source = "\n".join(["def copy(record):", "    copied = new(kind)", *lines, "    return copied"])
    scope: dict[str, Any] = {"new": object.__new__, "kind": kind}
    exec(source, scope)  # as dataclasses itself makes __init__
    copier: Callable[[Any], Any] = scope["copy"]
    return copier
