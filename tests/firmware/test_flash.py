"""`make flash`: the right part, programmer and speed for each board, and refusals that say what to do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def flash(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "firmware" / "flash.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("board", "bootloader", "part", "programmer", "baud"),
    [
        ("mega_suspension", "", "atmega2560", "wiring", "115200"),
        ("mega_speed", "", "atmega2560", "wiring", "115200"),
        ("nano_imu", "", "atmega328p", "arduino", "115200"),
        ("nano_imu", "new", "atmega328p", "arduino", "115200"),
        ("nano_imu", "old", "atmega328p", "arduino", "57600"),
    ],
)
def test_dry_run_shows_the_call_for_each_board(
    board: str, bootloader: str, part: str, programmer: str, baud: str
) -> None:
    shown = flash("run", "--board", board, "--port", "/dev/ttyX", "--bootloader", bootloader, "--dry-run")
    assert shown.returncode == 0
    assert (
        f"avrdude -p {part} -c {programmer} -P /dev/ttyX -b {baud} -D "
        f"-U flash:w:build/firmware/{board}.hex:i" in shown.stdout
    )


def test_nano_asks_for_the_wire_to_be_unplugged_first_and_others_do_not() -> None:
    nano = flash("run", "--board", "nano_imu", "--port", "/dev/ttyX", "--dry-run").stdout
    assert "unplug" in nano
    assert nano.index("unplug") < nano.index("avrdude")
    assert "unplug" not in flash("run", "--board", "mega_speed", "--port", "/dev/ttyX", "--dry-run").stdout


def test_instance_reminds_of_the_strap() -> None:
    shown = flash("run", "--board", "mega_speed", "--port", "/dev/ttyX", "--instance", "right", "--dry-run")
    assert "D30 to ground" in shown.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--board", "", "--port", "/dev/ttyX"],
            ["BOARD=(missing)", "mega_suspension, nano_imu, mega_speed"],
        ),
        (["--board", "mega", "--port", "/dev/ttyX"], ["BOARD=mega", "nano_imu"]),
        (["--board", "nano_imu", "--port", ""], ["PORT is missing", "tiger doctor"]),
        (["--board", "nano_imu", "--port", "/dev/ttyX", "--instance", "left"], ["only", "nano_imu"]),
        (
            ["--board", "mega_speed", "--port", "/dev/ttyX", "--instance", "up"],
            ["INSTANCE=left", "INSTANCE=right"],
        ),
        (["--board", "nano_imu", "--port", "/dev/ttyX", "--bootloader", "ancient"], ["BOOTLOADER=old"]),
    ],
)
def test_what_cannot_work_is_refused_with_the_next_step(arguments: list[str], words: list[str]) -> None:
    refused = flash("check", *arguments)
    assert refused.returncode != 0
    assert "Traceback" not in refused.stderr
    assert all(word in refused.stderr for word in words)
