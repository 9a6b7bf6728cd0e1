# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles the simavr wrapper into build/avr when its sources are newer, and imports it."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import cffi

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
OUT = ROOT / "build" / "avr"
NATIVE = ROOT / "firmware" / "native"
CORE = ROOT / "firmware" / "libraries" / "TigerCore" / "src"
MODULE = "_simavr"


def sources() -> list[Path]:
    """C++ files of the wrapper, the shared BNO055 model included."""
    return [HERE / "avr_board.cpp", HERE / "bno055_device.cpp", NATIVE / "bno055_model.cpp"]


def compile_wrapper() -> Path:
    """Build the extension module and return its path."""
    builder = cffi.FFI()
    declarations = (HERE / "avr_board.h").read_text(encoding="utf-8")
    builder.cdef(re.sub(r"^//.*\n", "", declarations, flags=re.MULTILINE))
    builder.set_source(
        MODULE,
        '#include <stdint.h>\nextern "C" {\n#include "avr_board.h"\n}\n',
        source_extension=".cpp",
        sources=[str(path) for path in sources()],
        include_dirs=[str(HERE), str(NATIVE), str(CORE), "/usr/include/simavr"],
        libraries=["simavr", "elf"],
        extra_compile_args=["-O2", "-std=gnu++14", "-Wall", "-Wno-unused-function"],
    )
    OUT.mkdir(parents=True, exist_ok=True)
    return Path(builder.compile(tmpdir=str(OUT), verbose=False))


def load() -> ModuleType:
    """Return the module with `ffi` and `lib`, compiled afresh if a source changed."""
    inputs = [*HERE.glob("*.h"), *HERE.glob("*.cpp"), Path(__file__), *NATIVE.glob("bno055*")]
    built = next(iter(OUT.glob(f"{MODULE}*.so")), None)
    if built is None or any(path.stat().st_mtime > built.stat().st_mtime for path in inputs):
        built = compile_wrapper()
    spec = importlib.util.spec_from_file_location(MODULE, built)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    print(compile_wrapper())
