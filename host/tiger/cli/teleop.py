"""`tiger teleop`: drive by hand, with the keyboard or a gamepad, over the daemon's socket.

Nothing moves unless a key or the gamepad's dead-man button is held. Should this program die, hang or lose its
terminal, the daemon stops the robot half a second after its last word.

`Keys` and `Gamepad` turn what hands do into a motion; both are free of I/O and clocks.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import select
import stat
import struct
import sys
import termios
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from tiger.cli.answers import fail
from tiger.cli.ctl import connected
from tiger.daemon.client import Refused, Robot

if TYPE_CHECKING:
    from collections.abc import Iterator

PERIOD_S = 0.05  # between two drive commands
STATUS_EVERY = 4  # of these
LEVELS = 5
CLEAR_LINE = "\r\x1b[K"
FIRST_HOLD_S = 0.7  # a terminal repeats a held key only after a pause of up to this ...
REPEAT_HOLD_S = 0.15  # ... and then so often that this silence means it was let go

Motion = tuple[float, float]  # parts of the largest speed and yaw rate, -1 to 1
STILL: Motion = (0.0, 0.0)


class Hands(Protocol):
    """A keyboard or a gamepad."""

    level: int

    def fileno(self) -> int:
        """The descriptor to wait on."""

    def read(self, now_s: float) -> list[str]:
        """Take what arrived; returns what was asked for besides motion. Raises OSError when it is gone."""

    def motion(self, now_s: float) -> Motion:
        """The motion that is asked for now."""


# ---- keyboard -----------------------------------------------

MOVES: dict[str, Motion] = {
    "i": (1.0, 0.0),
    "k": (-1.0, 0.0),
    "j": (0.0, 1.0),
    "l": (0.0, -1.0),
    "u": (1.0, 0.5),
    "o": (1.0, -0.5),
    "\x1b[A": (1.0, 0.0),
    "\x1b[B": (-1.0, 0.0),
    "\x1b[D": (0.0, 1.0),
    "\x1b[C": (0.0, -1.0),
}
ASKS = {"a": "arm", "d": "disarm", "c": "clear", " ": "estop", "q": "quit", "\x03": "quit"}
KEYS_HELP = """hold to move:  arrows or i k j l  forward, back, left, right;  u o  in a curve
1-5 speed level   a arm   d disarm   c clear   space emergency stop   q quit"""


@dataclass
class Keys:
    """Keys held down, as far as a terminal tells: it repeats the last one that is held, and says no more."""

    level: int = 1
    _motion: Motion = STILL
    _key: str = ""
    _until_s: float = -math.inf

    def press(self, text: str, now_s: float) -> list[str]:
        """Take what the terminal sent; returns what was asked for besides motion."""
        asked = []
        for key in _split(text):
            if key in MOVES:
                is_repeat = key == self._key and now_s < self._until_s
                self._key, self._motion = key, MOVES[key]
                self._until_s = now_s + (REPEAT_HOLD_S if is_repeat else FIRST_HOLD_S)
                continue
            self._until_s = -math.inf  # any other key stops
            if key in ASKS:
                asked.append(ASKS[key])
            elif key.isdecimal() and 1 <= int(key) <= LEVELS:
                self.level = int(key)
        return asked

    def motion(self, now_s: float) -> Motion:
        """The motion of the key that is held."""
        return self._motion if now_s < self._until_s else STILL


def _split(text: str) -> Iterator[str]:
    """Single keys; an arrow is three characters."""
    while text:
        length = 3 if text.startswith("\x1b[") else 1
        yield text[:length]
        text = text[length:]


class Keyboard(Keys):
    """The terminal, with each key handed over at once. A context manager."""

    path = "/dev/tty"

    def __enter__(self) -> Keyboard:
        self._terminal = os.open(self.path, os.O_RDONLY)
        self._before = termios.tcgetattr(self._terminal)
        tty.setcbreak(self._terminal)
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(termios.error):  # of a terminal that is gone
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
        os.close(self._terminal)

    def fileno(self) -> int:
        """The descriptor to wait on."""
        return self._terminal

    def read(self, now_s: float) -> list[str]:
        """Take the keys that were pressed."""
        data = os.read(self._terminal, 64)
        if not data:
            raise OSError("the terminal was closed")
        return self.press(data.decode("ascii", "ignore"), now_s)


# ---- gamepad ------------------------------------------------

EVENT = struct.Struct("@llHHi")  # seconds, microseconds, type, code, value: the kernel's struct input_event
SYN, KEY, ABS = 0, 1, 3  # types
SYN_DROPPED = 3  # the kernel's queue ran over: events are lost
# Codes of the kernel's gamepad specification, the same for every maker.
BUTTONS = {"a": 304, "b": 305, "x": 307, "y": 308, "left-shoulder": 310, "right-shoulder": 311}
AXES = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5}
SELECT, START, DPAD_Y = 314, 315, 17
EVIOCGABS = 0x80184540  # + axis: its struct input_absinfo of six ints: value, minimum, maximum, ...
FULL = (-32768, 32767)  # range of a stick that does not tell
DEAD_ZONE = 0.08
WHERE = "/dev/input/by-id/*-event-joystick"
INPUT = 13  # major number of /dev/input
PAD_HELP = """hold {deadman} to move: left stick speed, right stick direction
D-pad up, down: speed level   start: arm   select (back): disarm
B: emergency stop   Ctrl-C quits"""


@dataclass
class Gamepad:
    """Sticks and buttons, coded as in the kernel's gamepad specification."""

    deadman: int = BUTTONS["left-shoulder"]
    speed_axis: int = AXES["y"]
    yaw_axis: int = AXES["rx"]
    level: int = 1
    asks: dict[int, str] = field(
        default_factory=lambda: {BUTTONS["b"]: "estop", SELECT: "disarm", START: "arm"}
    )
    ranges: dict[int, tuple[int, int]] = field(default_factory=dict)  # of each axis
    _held: bool = False
    _sticks: dict[int, float] = field(default_factory=dict)
    _rest: bytes = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes of /dev/input/event*; returns what was asked for besides motion."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        asked = []
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            if kind == SYN and code == SYN_DROPPED:
                self._held = False  # perhaps it was let go: it must be pressed again
            elif kind == ABS:
                self._move(code, value)
            elif kind == KEY and code == self.deadman:
                self._held = value != 0
            elif kind == KEY and value == 1 and code in self.asks:
                asked.append(self.asks[code])
        return asked

    def _move(self, axis: int, value: int) -> None:
        if axis != DPAD_Y:
            low, high = self.ranges.get(axis, FULL)
            middle, half = (low + high) / 2.0, (high - low) / 2.0
            self._sticks[axis] = min(max((value - middle) / half, -1.0), 1.0)
        elif value:  # up is negative
            self.level = min(max(self.level + (1 if value < 0 else -1), 1), LEVELS)

    def motion(self, now_s: float) -> Motion:
        """The sticks while the dead-man button is held; up and left are negative there."""
        if not self._held:
            return STILL
        return _past_dead_zone(-self._sticks.get(self.speed_axis, 0.0)), _past_dead_zone(
            -self._sticks.get(self.yaw_axis, 0.0)
        )


def _past_dead_zone(value: float) -> float:
    beyond = max(abs(value) - DEAD_ZONE, 0.0) / (1.0 - DEAD_ZONE)
    return math.copysign(beyond, value) if beyond else 0.0


class GamepadDevice(Gamepad):
    """One /dev/input/event*. A context manager once `path` is set."""

    path: Path

    def __enter__(self) -> GamepadDevice:
        self._device = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        for axis in (self.speed_axis, self.yaw_axis):
            info = bytearray(24)
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._device, EVIOCGABS + axis, info)
            low, high = struct.unpack_from("@ii", info, 4)
            if low < high:
                self.ranges[axis] = low, high
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._device)

    def fileno(self) -> int:
        """The descriptor to wait on."""
        return self._device

    def read(self, now_s: float) -> list[str]:
        """Take the events that are there."""
        data = os.read(self._device, 64 * EVENT.size)
        if not data:
            raise OSError("it is gone")
        return self.feed(data)


def _find_gamepad(path: str) -> Path:
    """Return the device that is meant; `auto` is the first one. Ends the program when there is none."""
    if path != "auto":
        _refuse_unusable(Path(path))
        return Path(path)
    found = sorted(Path("/").glob(WHERE[1:]))
    if not found:
        fail(f"no gamepad matches {WHERE}; connect it, or name its /dev/input/event*")
    return found[0]


def _refuse_unusable(path: Path) -> None:
    """End the program when hands cannot be read there; better before the robot is asked for."""
    try:
        device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        if str(path) == Keyboard.path:
            fail("there is no terminal to read keys from; run it in one, or drive with --gamepad")
        permit = "; join the group input" if isinstance(error, PermissionError) else ""
        fail(f"{path}: cannot be read ({error.strerror}){permit or '; name its /dev/input/event*'}")
    kind = os.fstat(device)
    os.close(device)
    if str(path) != Keyboard.path and not (stat.S_ISCHR(kind.st_mode) and os.major(kind.st_rdev) == INPUT):
        fail(f"{path}: is no gamepad; name its /dev/input/event*, or auto")


# ---- the program --------------------------------------------


@dataclass
class Teleop:
    """Carries motion to the robot: a `step` every 50 ms.

    `say` gets a line when something changes, `show` the motion, which changes all the time.
    """

    robot: Robot
    say: Callable[[str], None]
    show: Callable[[str], None]
    _state: str = ""
    _told: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _steps: int = 0
    _limits: dict[str, tuple[float, float]] = field(default_factory=dict)

    def step(self, motion: Motion, level: int) -> None:
        """Send one drive command if the robot is armed; zero while nothing is held."""
        if self._steps % STATUS_EVERY == 0:
            answer = self.robot.ask("status")
            self._limits = answer["limits"]
            self._state = answer["status"]["state"]
            problems = [str(p["where"]) + ": " + p["text"] for p in answer["status"]["record"]["problems"]]
            self._tell("state", f"{self._state}: {answer['status']['reason']}")
            self._tell("problems", *problems)
        self._steps += 1
        if self._state != "ARMED":
            return
        part = level / LEVELS
        speed_mps = motion[0] * part * self._limits["speed_mps"][1]
        yaw_rate_radps = motion[1] * part * self._limits["yaw_rate_radps"][1]
        if self.ask("drive", speed_mps=speed_mps, yaw_rate_radps=yaw_rate_radps):
            turning = math.degrees(yaw_rate_radps)
            self._told.pop("drive", None)  # what was refused may be refused again
            moving = f"level {level}: {speed_mps:+.2f} m/s, {turning:+.0f} degrees/s"
            if self._told.get("moving") != (moving,):
                self._told["moving"] = (moving,)
                self.show(moving)

    def ask(self, do: str, **fields: Any) -> bool:
        """Ask for something; a refusal is said, not raised."""
        try:
            answer = self.robot.ask(do, **fields)
        except Refused as refusal:
            self._tell(do, f"refused: {refusal}")
            return False
        if do != "drive":
            self.say(answer["text"])
            self._steps = 0  # look at once what came of it
        return True

    def _tell(self, what: str, *lines: str) -> None:
        """Say it unless the same was said of this last."""
        if self._told.get(what) != lines:
            self._told[what] = lines
            for line in lines:
                self.say(line)


class Lines:
    """Lines on the terminal, of which the last is written over as long as it only shows the motion."""

    def __init__(self) -> None:
        self._again = CLEAR_LINE if sys.stdout.isatty() else ""
        self._open = False

    def say(self, text: str) -> None:
        """Print a line that stays."""
        typer.echo(f"{self._again if self._open else ''}{text}")
        self._open = False

    def show(self, text: str) -> None:
        """Write over the line that was shown before."""
        typer.echo(f"{self._again if self._open else ''}{text}", nl=not self._again)
        self._open = bool(self._again)

    def end(self) -> None:
        """Leave what is shown."""
        if self._open:
            typer.echo()
            self._open = False


def operate(hands: Hands, teleop: Teleop) -> None:
    """Drive until the user quits. Raises OSError when the hands' device is gone; the robot is stopped."""
    try:
        while True:
            due_s = time.monotonic() + PERIOD_S
            while (left_s := due_s - time.monotonic()) > 0.0:
                if select.select([hands], [], [], left_s)[0]:
                    for asked in hands.read(time.monotonic()):
                        if asked == "quit":
                            return
                        teleop.ask(asked)
            teleop.step(hands.motion(time.monotonic()), hands.level)
    except KeyboardInterrupt:
        return
    finally:
        with contextlib.suppress(OSError, Refused):
            teleop.robot.ask("release")


def teleop(
    gamepad: Annotated[
        str | None,
        typer.Option(
            "--gamepad",
            metavar="DEVICE",
            help="Its device /dev/input/event*, or auto; default: the keyboard.",
        ),
    ] = None,
    level: Annotated[
        int, typer.Option("--level", metavar="NUMBER", min=1, max=LEVELS, help="Speed level to begin with.")
    ] = 1,
    deadman: Annotated[
        str, typer.Option("--deadman", metavar="BUTTON", help=f"The button to hold: {', '.join(BUTTONS)}.")
    ] = "left-shoulder",
    yaw_axis: Annotated[
        str, typer.Option("--yaw-axis", metavar="AXIS", help=f"The stick that steers: {', '.join(AXES)}.")
    ] = "rx",
) -> None:
    """Drive by hand: the robot moves while a key, or the gamepad's dead-man button, is held."""
    hands: Keyboard | GamepadDevice
    button, axis = _code(BUTTONS, deadman, "--deadman"), _code(AXES, yaw_axis, "--yaw-axis")
    if gamepad is None:
        _refuse_unusable(Path(Keyboard.path))
        where, hands, text = "the terminal", Keyboard(level), KEYS_HELP
    else:
        hands = GamepadDevice(deadman=button, yaw_axis=axis, level=level)
        hands.path, text = _find_gamepad(gamepad), PAD_HELP.format(deadman=deadman)
        where = str(hands.path)
    with connected() as robot:
        typer.echo(text)
        lines = Lines()
        try:
            with hands:
                operate(hands, Teleop(robot, lines.say, lines.show))
        except (OSError, termios.error) as error:
            if isinstance(error, ConnectionError | TimeoutError):
                raise
            typer.echo(f"{where}: {error}; the robot was told to stop. Connect it and start again.", err=True)
            raise typer.Exit(2) from None
        finally:
            lines.end()
            sys.stdout.flush()
    typer.echo("The robot stands still; whether it is armed has not changed.")


def _code(codes: dict[str, int], name: str, option: str) -> int:
    if name not in codes:
        raise typer.BadParameter(f"{name} is none of {', '.join(codes)}", param_hint=option)
    return codes[name]
