"""`tiger doctor`: what keeps the robot from being reached, or the loop from being punctual."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import sys
import textwrap
from dataclasses import asdict, dataclass
from enum import Enum
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tiger.cli.answers import JsonFile, refuse_unwritable, write_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from tiger.config.robot import RobotConfig

BEST_LATENCY_TIMER_MS = 1
INDENT = 7  # of everything but the grade
SYS = Path("/sys")
PROC = Path("/proc")


class Grade(Enum):
    """How bad a finding is."""

    GOOD = "ok"
    NOTE = "note"
    BAD = "BAD"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at, and what to do about it when it is not good."""

    grade: Grade
    what: str
    next_step: str = ""


def doctor(
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="robot.toml whose ports are looked at.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Look at ports, permissions, compiled extensions and scheduling; exit 1 when something is bad."""
    from tiger.config.errors import ConfigError
    from tiger.config.robot import load_robot

    try:
        robot = load_robot(config)
    except ConfigError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    refuse_unwritable(json_file)
    findings = [*_software(), *_ports(robot), *_latency_timers(SYS), *_disturbers(PROC), *_scheduling()]
    for finding in findings if str(json_file) != "-" else ():
        _show(f"{finding.grade.value:>5}  ", finding.what)
        if finding.next_step:
            _show(" " * INDENT, finding.next_step)
    if json_file is not None:
        write_json(json_file, [asdict(finding) | {"grade": finding.grade.value} for finding in findings])
    raise typer.Exit(1 if any(finding.grade is Grade.BAD for finding in findings) else 0)


def _show(start: str, text: str) -> None:
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 1000
    typer.echo(textwrap.fill(text, width, initial_indent=start, subsequent_indent=" " * INDENT))


def _software() -> Iterator[Finding]:
    version = platform.python_version()
    yield Finding(Grade.GOOD, f"Python {version} on {platform.system()} {platform.machine()}")
    # Both packages fall back to pure Python in silence when no compiler was there at their installation.
    for package, module in (("crcmod", "crcmod._crcfunext"), ("cobs", "cobs.cobs._cobs_ext")):
        if _has_module(module):
            yield Finding(Grade.GOOD, f"{package} {metadata.version(package)} with its C extension")
        else:
            step = f"Install a C compiler, then: {sys.executable} -m pip install --force-reinstall {package}"
            yield Finding(Grade.BAD, f"{package} runs in pure Python, 25 to 50 times slower", step)
    if _has_module("tiger.native._core"):
        yield Finding(Grade.GOOD, "emulated boards are compiled")
    else:
        yield Finding(Grade.NOTE, "emulated boards are not compiled", "Run `make setup` to use --emulate.")


def _has_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ImportError:
        return False


def _ports(robot: RobotConfig) -> Iterator[Finding]:
    from tiger.devices.ports import SerialPorts

    ports = SerialPorts()
    boards = ports.present(robot.ports.boards)
    drives = [robot.ports.roboteq_left, robot.ports.roboteq_right] if robot.drive.enabled else []
    boards = [path for path in boards if not any(ports.same(path, drive) for drive in drives)]
    if not boards:
        yield Finding(
            Grade.BAD,
            f"no port matches ports.boards = {', '.join(robot.ports.boards)}",
            "Plug the boards in; `ls /dev/serial/by-id` shows what the computer sees.",
        )
    for path in boards:
        yield _port(path, "a board may be here")
    for name, path in zip(("roboteq_left", "roboteq_right"), drives, strict=False):
        if Path(path).exists():
            yield _port(path, name)
        else:
            step = "Plug it in, install the udev rules (README), or correct the path under [ports]."
            yield Finding(Grade.BAD, f"{path} ({name}) is not there", step)


def _port(path: str, role: str) -> Finding:
    """Whether a port can be opened, without opening it: that would reset an Arduino."""
    what = f"{path} ({role})"
    real = Path(path).resolve()
    if not real.is_char_device():
        return Finding(Grade.BAD, f"{what} is no serial device", "Correct the path under [ports].")
    if not os.access(real, os.R_OK | os.W_OK):
        group = _group(real)
        step = f"sudo usermod -aG {group} $USER, then log in again"
        return Finding(Grade.BAD, f"{what} may not be opened by this user (group {group})", step)
    user = _user_of(real)
    if user:
        return Finding(Grade.BAD, f"{what} is in use by {user}", "Close that program.")
    return Finding(Grade.GOOD, f"{what} may be opened")


def _group(path: Path) -> str:
    try:
        return path.group()
    except (KeyError, OSError):
        return "dialout"


def _user_of(device: Path) -> str | None:
    """The program that has a device open, of those that this user may look at."""
    for descriptors in PROC.glob("[0-9]*/fd"):
        try:
            for link in descriptors.iterdir():
                if link.readlink() == device:
                    pid = descriptors.parent.name
                    return f"{(descriptors.parent / 'comm').read_text().strip()} (process {pid})"
        except OSError:
            continue
    return None


def _latency_timers(sys_root: Path) -> Iterator[Finding]:
    """FTDI chips hold bytes back for up to 16 ms unless told otherwise."""
    for file in sorted(sys_root.glob("bus/usb-serial/devices/*/latency_timer")):
        try:
            timer_ms = int(file.read_text())
        except (OSError, ValueError):
            continue
        what = f"/dev/{file.parent.name} hands bytes over after {timer_ms} ms"
        if timer_ms <= BEST_LATENCY_TIMER_MS:
            yield Finding(Grade.GOOD, what)
        else:
            step = f"echo 1 | sudo tee {file}, or install the udev rules (README)"
            yield Finding(Grade.NOTE, what, step)


def _disturbers(proc_root: Path) -> Iterator[Finding]:
    """ModemManager opens every new serial port and writes to it."""
    for file in proc_root.glob("[0-9]*/comm"):
        try:
            name = file.read_text().strip()
        except OSError:
            continue
        if name == "ModemManager":
            step = "sudo systemctl disable --now ModemManager, or install the udev rules (README)"
            yield Finding(Grade.BAD, "ModemManager runs: it writes to boards that are plugged in", step)
            return
    yield Finding(Grade.GOOD, "no ModemManager")


def _scheduling() -> Iterable[Finding]:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except OSError as error:
        reason = "not permitted" if error.errno == errno.EPERM else str(error.strerror)
        yield Finding(
            Grade.NOTE,
            f"real-time scheduling (SCHED_FIFO) is {reason}: ticks may be some ms late under load",
            "Add `@dialout - rtprio 50` to /etc/security/limits.conf, or run it as the service (README).",
        )
    else:
        yield Finding(Grade.GOOD, "real-time scheduling (SCHED_FIFO) is permitted: loop.realtime_priority")
    cores = len(os.sched_getaffinity(0))
    grade = Grade.GOOD if cores > 1 else Grade.NOTE
    yield Finding(grade, f"{cores} processor core{'s' if cores > 1 else ''}")
