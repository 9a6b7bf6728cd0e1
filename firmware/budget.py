"""Flash and RAM of the images, and what they cost while they run, against budgets.

`sizes` needs only avr-size and is part of `make firmware`. `write` measures in simavr and writes
firmware/BUDGET.md (`make budget`). Both fail above a budget.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple


class Limit(NamedTuple):
    """What the program may take of a board's memory, in bytes."""

    flash: int
    static_ram: int
    ram: int


# Flash: what the bootloaders leave. RAM: variables may take what leaves the stack its margin.
LIMITS = {
    "mega_suspension": Limit(253952, 4096, 8192),
    "nano_imu": Limit(30720, 1400, 2048),
    "mega_speed": Limit(253952, 4608, 8192),
}


class Size(NamedTuple):
    """Bytes of an image."""

    flash: int
    static_ram: int


def size_of(elf: Path) -> Size:
    """Return the memory an image takes, from avr-size."""
    tool = os.environ.get("AVR_SIZE", "avr-size")
    listing = subprocess.run([tool, "-A", str(elf)], check=True, capture_output=True, text=True).stdout
    rows = (line.split() for line in listing.splitlines())
    sections = {row[0]: int(row[1]) for row in rows if row and row[0].startswith(".")}
    data = sections.get(".data", 0)
    return Size(
        flash=sections.get(".text", 0) + data,
        static_ram=data + sections.get(".bss", 0) + sections.get(".noinit", 0),
    )


def report_sizes(images: list[Path]) -> int:
    """Print the table of `make firmware`; return how many budgets are exceeded."""
    exceeded = 0
    print(f"{'board':<16}{'flash':>8}{'of':>9}{'RAM':>8}{'of':>7}   (bytes; RAM without the stack)")
    for image in images:
        size, limit = size_of(image), LIMITS[image.stem]
        over = [
            f"{what} is {value - most} bytes over its budget"
            for what, value, most in (
                ("flash", size.flash, limit.flash),
                ("RAM", size.static_ram, limit.static_ram),
            )
            if value > most
        ]
        exceeded += len(over)
        print(
            f"{image.stem:<16}{size.flash:>8}{limit.flash:>9}{size.static_ram:>8}{limit.static_ram:>7}"
            f"   {'; '.join(over) or 'ok'}"
        )
    return exceeded


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("step", choices=("sizes", "write"))
    parser.add_argument("images", nargs="*", type=Path)
    arguments = parser.parse_args()
    if arguments.step == "sizes":
        sys.exit(report_sizes(arguments.images) and "budget: an image is too large for its board")
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "avr"))
    import measure  # only there once the simulator is built

    sys.exit(measure.write_budget(Path("firmware/BUDGET.md")))


if __name__ == "__main__":
    main()
