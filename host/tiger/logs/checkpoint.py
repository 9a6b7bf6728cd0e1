"""A state of the controller as a row of numbers, and back: what replay needs to begin in the middle.

A state is made of dataclasses, tuples, arrays and numbers. Their shape is that of the initial state, so the
numbers alone say everything.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

T = TypeVar("T")


def freeze(state: Any) -> tuple[float, ...]:
    """All numbers of `state`, depth first; raises TypeError for what is none."""
    return tuple(_numbers(state))


def thaw(like: T, numbers: tuple[float, ...]) -> T:
    """The state of the shape of `like` with these numbers; raises ValueError when their count is wrong."""
    rest = iter(numbers)
    try:
        state: T = _filled(like, rest)
    except StopIteration:
        raise ValueError(f"{len(numbers)} numbers are too few for the state of this controller") from None
    if next(rest, None) is not None:
        raise ValueError(f"{len(numbers)} numbers are too many for the state of this controller")
    return state


def _numbers(value: Any) -> Iterator[float]:
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _numbers(getattr(value, field.name))
    elif isinstance(value, tuple):
        for element in value:
            yield from _numbers(element)
    elif isinstance(value, np.ndarray):
        yield from value.ravel().tolist()
    elif isinstance(value, int | float):
        yield float(value)
    else:
        raise TypeError(f"{value!r} is no number: the state of the controller cannot be kept")


def _filled(like: Any, rest: Iterator[float]) -> Any:
    if dataclasses.is_dataclass(like) and not isinstance(like, type):
        return type(like)(*[_filled(getattr(like, field.name), rest) for field in dataclasses.fields(like)])
    if isinstance(like, tuple):
        return tuple([_filled(element, rest) for element in like])
    if isinstance(like, np.ndarray):
        numbers = [next(rest) for _ in range(like.size)]
        return np.array(numbers, dtype=like.dtype).reshape(like.shape)
    return type(like)(next(rest))
