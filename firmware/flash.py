"""Puts an image on a board with avrdude: the right part, programmer and speed for each (for `make flash`).

Only the standard library: flashing must work before anything is set up.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple, NoReturn


class Programmer(NamedTuple):
    """How avrdude reaches a bootloader."""

    part: str
    protocol: str
    baud: int


MEGA = Programmer("atmega2560", "wiring", 115200)
NANO = {
    "new": Programmer("atmega328p", "arduino", 115200),
    "old": Programmer("atmega328p", "arduino", 57600),
}
BOARDS = ("mega_suspension", "nano_imu", "mega_speed")
IMAGES = Path("build/firmware")
UNPLUG = (
    "Before you go on: unplug the wire from the Mega's TX1 (D18) to the Nano's RX (D0).\n"
    "The Nano's bootloader listens on that pin. Plug it in again afterwards."
)
STRAP = {
    "left": "Left board: leave the strap pin D30 open.",
    "right": "Right board: connect the strap pin D30 to ground.",
}


def fail(message: str) -> NoReturn:
    """End with a message and no traceback."""
    sys.exit(f"make flash: {message}")


def programmer(board: str, bootloader: str) -> Programmer:
    """Return how to reach `board`; `bootloader` matters on the Nano only."""
    if board != "nano_imu":
        return MEGA
    if bootloader not in NANO:
        fail(f"BOOTLOADER={bootloader} is not known: use BOOTLOADER=new or BOOTLOADER=old")
    return NANO[bootloader]


def command(board: str, port: str, bootloader: str) -> list[str]:
    """Return the avrdude call that writes and verifies the image of `board`."""
    how = programmer(board, bootloader)
    return [
        "avrdude",
        "-p",
        how.part,
        "-c",
        how.protocol,
        "-P",
        port,
        "-b",
        str(how.baud),
        "-D",  # these bootloaders cannot erase the whole chip; they erase page by page
        "-U",
        f"flash:w:{IMAGES / board}.hex:i",
    ]


def check(board: str, port: str, instance: str) -> None:
    """Refuse what cannot work, before anything is built."""
    if board not in BOARDS:
        fail(
            f"BOARD={board or '(missing)'} is not one of {', '.join(BOARDS)}, "
            "e.g. make flash BOARD=nano_imu PORT=/dev/ttyUSB0"
        )
    if not port:
        fail(
            f"PORT is missing, e.g. make flash BOARD={board} PORT=/dev/ttyACM0; "
            "`tiger doctor` lists the ports"
        )
    if instance and board != "mega_speed":
        fail(f"INSTANCE={instance} is for mega_speed only: there is one {board}")
    if instance and instance not in STRAP:
        fail(f"INSTANCE={instance} is not known: use INSTANCE=left or INSTANCE=right")


def main() -> None:
    """Command line of `make flash`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("step", choices=("check", "run"))
    parser.add_argument("--board", default="")
    parser.add_argument("--port", default="")
    parser.add_argument("--bootloader", default="")
    parser.add_argument("--instance", default="")
    parser.add_argument("--dry-run", action="store_true")
    arguments = parser.parse_args()
    bootloader = arguments.bootloader or "new"
    check(arguments.board, arguments.port, arguments.instance)
    call = command(arguments.board, arguments.port, bootloader)
    if arguments.step == "check":
        return
    if arguments.board == "nano_imu":
        print(UNPLUG)
    if arguments.instance:
        print(STRAP[arguments.instance])
    print(shlex.join(call))
    if arguments.dry_run:
        return
    if not Path(arguments.port).exists():
        fail(f"{arguments.port} is not there: plug the board in, or see `tiger doctor` for the ports")
    if arguments.board == "nano_imu" and sys.stdin.isatty():
        input("Press Enter when the wire is unplugged. ")
    if subprocess.run(call, check=False).returncode == 0:
        print(f"{arguments.board} is on {arguments.port}")
        return
    hint = ""
    if arguments.board == "nano_imu":
        other = "new" if bootloader == "old" else "old"
        hint = f" If it does not answer, try BOOTLOADER={other}, and check that the wire to RX is unplugged."
    fail(f"avrdude could not write {arguments.board} on {arguments.port}.{hint}")


if __name__ == "__main__":
    main()
