"""The one decorator under which physics is compiled: numba, cached on disk.

Compiled functions take scalars, arrays, records (rows of structured arrays) and tuples of these. Parameters
travel as structured arrays of one row made by `record`, so that a field is read as `row.field` compiled and
interpreted alike: NUMBA_DISABLE_JIT=1 runs the same source as plain Python, some two hundred times slower.

numba compiles a cached function anew when its own file has changed, but not when what it calls has: each
state of the sources here has its own folder of machine code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

_Function = TypeVar("_Function", bound=Callable[..., Any])

Record = NDArray[np.void]
"""Parameters: a structured array of one row."""


class Row(Protocol):
    """One row of a `Record` of floats."""

    def __getattr__(self, name: str) -> float:
        """Return the field `name`."""


def _folder_of_machine_code() -> str:
    """Below NUMBA_CACHE_DIR or beside the sources; numba finds another place where it cannot write."""
    sources = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        text = path.read_bytes()
        if b"@jit" in text:
            sources.update(text)
    chosen: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    folder = Path(chosen) if chosen else Path(__file__).parent / "__pycache__"
    return str(folder / f"compiled-{sources.hexdigest()[:12]}")


numba.config.CACHE_DIR = _folder_of_machine_code()  # type: ignore[attr-defined]


def jit(function: _Function) -> _Function:
    """Compile `function` without Python objects and keep the machine code on disk (NUMBA_CACHE_DIR)."""
    # Fused multiply-add is the one liberty taken with IEEE: NaN and infinity keep their meaning.
    return cast("_Function", numba.njit(cache=True, error_model="numpy", fastmath={"contract"})(function))


def c_function(signature: Any) -> Callable[[Callable[..., None]], Any]:
    """Compile a function of pointers that C code may call at its `address`; always compiled, and cached."""
    return cast(
        "Callable[[Callable[..., None]], Any]",
        numba.cfunc(signature, cache=True, error_model="numpy", fastmath={"contract"}),
    )


def record(dtype: np.dtype[np.void], values: Mapping[str, Any]) -> Record:
    """Return a structured array of one row; `values` must name every field of `dtype`.

    Raises KeyError for a field without a value, ValueError for a value without a field.
    """
    unknown = set(values) - set(dtype.names or ())
    if unknown:
        raise ValueError(f"no such field: {', '.join(sorted(unknown))}")
    row = np.zeros(1, dtype)
    for name in dtype.names or ():
        row[name] = values[name]
    # Interpreted code reads `row.field` only from a record array; compiled code is dispatched faster without.
    return cast("Record", row.view(np.recarray)) if _interpreted() else row


def _interpreted() -> bool:
    return bool(numba.config.DISABLE_JIT)  # type: ignore[attr-defined]
