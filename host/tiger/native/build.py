"""Compiles the firmware's board templates into the extension module `tiger.native._core`.

Every `firmware/native/*.cpp` is compiled; the C declarations of `tiger_native.h` and of every `*_api.h`
become Python functions. `setup.py` uses `ffibuilder`; run as a script, it builds in place, beside this file.
"""

import re
import shutil
import tempfile
from pathlib import Path

from cffi import FFI

ROOT = Path(__file__).resolve().parents[3]
NATIVE = Path("firmware/native")
TIGER_CORE = Path("firmware/libraries/TigerCore/src")
MODULE = "tiger.native._core"
WARNINGS = ["-Wall", "-Wextra", "-Wshadow", "-Wconversion"]


def declarations(header: Path) -> str:
    """The C declarations of a header, without the lines that only the compiler understands."""
    text = re.sub(r"#ifdef __cplusplus.*?#endif", "", header.read_text(), flags=re.DOTALL)
    return "\n".join(line for line in text.splitlines() if not line.startswith("#"))


def make_builder(root: Path) -> FFI:
    """An `FFI` that knows every source; paths are relative to `root`, where the compiler must run."""
    headers = [root / NATIVE / "tiger_native.h", *sorted((root / NATIVE).glob("*_api.h"))]
    builder = FFI()
    builder.cdef("\n".join(declarations(header) for header in headers))
    builder.set_source(
        MODULE,
        "\n".join(f'#include "{header.name}"' for header in headers),
        source_extension=".cpp",
        sources=[str(path.relative_to(root)) for path in sorted((root / NATIVE).glob("*.cpp"))],
        include_dirs=[str(NATIVE), str(TIGER_CORE)],
        extra_compile_args=["-std=gnu++17", "-O2", "-g0", *WARNINGS],
    )
    return builder


ffibuilder = make_builder(ROOT)


def build_in_place() -> Path:
    """Compile beside this file; the old module stays whole until the new one is complete."""
    with tempfile.TemporaryDirectory() as scratch:
        for source in (NATIVE, TIGER_CORE):  # object files land beside the sources: beside copies, then
            shutil.copytree(ROOT / source, Path(scratch) / source)
        built = Path(ffibuilder.compile(tmpdir=scratch))
        target = Path(__file__).parent / built.name
        fresh = target.with_suffix(".fresh")
        shutil.copy(built, fresh)
        fresh.replace(target)
    return target


if __name__ == "__main__":
    print(build_in_place())
