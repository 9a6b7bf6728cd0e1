r"""An emulated Roboteq HBL2360 motor controller: bytes in, bytes out, a virtual clock, no I/O.

    drive = Roboteq()
    drive.receive(b"!S 1 120\r")                  # bytes the host has put on the wire now
    drive.run(1000)                               # 1 ms passes; bytes arrive, answers leave, at 115200 baud
    drive.transmit()                              # bytes whose stop bit has left since the last call
    drive.motor_rpm                               # (2,) what the motors are driven to: the world's command
    drive.feedback(speed_rpm, current_a)          # (2,) each: what ?S (or ?BS) and ?A report
    drive.estop_input = True                      # the contact on its e-stop input
    drive.reboot()                                # power cycle: only what %EESAV saved survives

Failures to inject: `fault_flags` (?FF bits), `motor_flags[channel]` (?FM bits), `silent` (it says nothing),
`deaf` (it hears nothing), `noise` (bytes flipped, lost, inserted, doubled on the way out), `say(text)` (a
line no one asked for). Bytes leave one by one, so whoever reads in between gets a fragment.

Facts from the Advanced Digital Motor Controllers User Manual v1.8, among them the trap every driver must
defuse: when the watchdog (only "!" commands feed it) has expired, the next valid "!" command on ANY channel
resumes the speed of BOTH. The manual does not say what `!MG` does to a standing command; here it resumes it,
the worse case.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from tiger.emulation.cable import LineNoise, NoisyLine

CHANNELS = 2
BAUD = 115200
BYTE_NS = 10 * 1_000_000_000 // BAUD
LINE_LIMIT = 64
FULL_POWER = 1000
"""A motor's full speed in `!G` and `!M`."""
MOST_RPM = 65000
STILL = [0.0] * CHANNELS
NO_FLAGS = [0] * CHANNELS

FF_EMERGENCY_STOP = 16
FF_STAGE_OFF = 1 | 2 | 4 | 8 | FF_EMERGENCY_STOP | 32 | 64
"""Fault bits that switch the power stage off: heat, voltage, short, e-stop, motor sensor, MOSFET."""
FS_SERIAL, FS_STAGE_OFF = 1, 8
FM_CLEARED_AT_ZERO = 2 | 4 | 8
"""Stalled, loop error, safety stop: gone once the command is back at zero."""

FIRMWARE_ID = "Roboteq v1.8 HBL2360 08/28/2017"


@dataclass(frozen=True, slots=True)
class Setting:
    """One configuration item (`^NAME`, `~NAME`), per channel or for the whole unit."""

    default: int
    least: int
    most: int
    per_channel: bool = False


SETTINGS = {
    "RWD": Setting(1000, 0, 65000),  # watchdog, ms; 0 disables
    "ECHOF": Setting(0, 0, 1),  # 1: no echo
    "MXRPM": Setting(1000, 10, MOST_RPM, per_channel=True),  # rpm at !G 1000
    "MAC": Setting(20000, 0, 500000, per_channel=True),  # acceleration, 0.1 rpm/s
    "MDEC": Setting(20000, 0, 500000, per_channel=True),  # deceleration, 0.1 rpm/s
}


_ECHOED = re.compile(rb"[\x20-\x7e\r]+")
_INTEGER = re.compile(r"[+-]?[0-9]{1,9}")


class Refused(Exception):
    """A line the controller answers with "-"."""


class Roboteq:
    """See the top of this file."""

    def __init__(self, *, battery_v: float = 24.0, noise: LineNoise | None = None, seed: int = 0) -> None:
        self.battery_v = battery_v
        self.estop_input = False
        self.fault_flags = 0
        self.motor_flags = [0] * CHANNELS
        self.silent = False
        self.deaf = False
        self._line_out = NoisyLine(noise or LineNoise(), seed)
        self._saved = {name: [s.default] * (CHANNELS if s.per_channel else 1) for name, s in SETTINGS.items()}
        self._now_ns = 0
        self._speed_rpm = [0.0] * CHANNELS
        self._current_a = [0.0] * CHANNELS
        self.reboot()

    def reboot(self) -> None:
        """Switch off and on: commands, buffers and unsaved settings are lost."""
        self._settings = {name: list(values) for name, values in self._saved.items()}
        self._command_rpm = [0.0] * CHANNELS
        self._motor_rpm = [0.0] * CHANNELS
        self._watchdog_due_ns: int | None = None
        self._watchdog_expired = False
        self._emergency = False
        self._line = b""
        # Bytes one after the other on the wire: time of the first one's stop bit in ns, and all of them.
        self._incoming: deque[tuple[int, bytes]] = deque()
        self._outgoing: deque[tuple[int, bytes]] = deque()
        self._last_in_ns = self._last_out_ns = self._now_ns

    # ---- the serial line

    def receive(self, data: bytes) -> None:
        """Put bytes on the wire to the controller; they arrive at the baud rate."""
        if data and not self.deaf:
            self._last_in_ns = _queue(self._incoming, data, max(self._last_in_ns, self._now_ns))

    def transmit(self) -> bytes:
        """Take the bytes whose stop bit has left by now."""
        out = b""
        while self._outgoing and self._outgoing[0][0] <= self._now_ns:
            first_ns, data = self._outgoing.popleft()
            gone = (self._now_ns - first_ns) // BYTE_NS + 1
            out += data[:gone]
            if gone < len(data):
                self._outgoing.appendleft((first_ns + gone * BYTE_NS, data[gone:]))
        return self._line_out.carry(out)

    def say(self, text: str) -> None:
        """Send a line, as an answer or unasked."""
        self._send(text.encode("ascii") + b"\r", self._now_ns)

    def _send(self, data: bytes, ready_ns: int) -> None:
        """Send bytes; the first is ready then, each of the others when the one before has left."""
        if not self.silent:
            self._last_out_ns = _queue(self._outgoing, data, max(self._last_out_ns, ready_ns))

    # ---- time

    def run(self, us: int) -> None:
        """Let `us` microseconds pass."""
        end_ns = self._now_ns + us * 1000
        while self._incoming and self._incoming[0][0] <= end_ns:
            first_ns, data = self._incoming.popleft()
            n = min((end_ns - first_ns) // BYTE_NS + 1, len(data))
            n = data.find(b"\r", 0, n) + 1 or n  # a line at a time
            if n < len(data):
                self._incoming.appendleft((first_ns + n * BYTE_NS, data[n:]))
            self._hear(data[:n], first_ns)
        self._advance(end_ns)

    def path_rpm(self, steps: int, step_us: int) -> list[tuple[float, float]]:
        """Let `steps` times `step_us` pass; return the speeds that the motors are driven to before each."""
        path: list[tuple[float, float]] = []
        while len(path) < steps:
            left = steps - len(path)
            end_ns = self._now_ns + left * step_us * 1000
            if self._changes_by(end_ns):
                path.append(self.motor_rpm)
                self.run(step_us)
            else:
                path += [self.motor_rpm] * left
                self._advance(end_ns)
        return path

    def _changes_by(self, end_ns: int) -> bool:
        """Whether anything may come until then that changes the speeds."""
        if self._incoming and self._incoming[0][0] <= end_ns:
            return True
        due_ns = self._watchdog_due_ns
        if (due_ns is not None and due_ns <= end_ns) or self.stage_off:
            return True
        return self._motor_rpm != (STILL if self._watchdog_expired else self._command_rpm)

    def _advance(self, to_ns: int) -> None:
        """Ramp the motors up to a moment, with the watchdog's expiry on the way."""
        due = self._watchdog_due_ns
        if due is not None and due <= to_ns:
            self._ramp(due - self._now_ns)
            self._now_ns = due
            self._watchdog_due_ns = None
            self._watchdog_expired = True
        self._ramp(to_ns - self._now_ns)
        self._now_ns = to_ns

    def _ramp(self, span_ns: int) -> None:
        if self.estop_input:
            self._emergency = True
        targets = STILL if self._watchdog_expired else self._command_rpm
        if self._emergency or self.fault_flags & FF_STAGE_OFF:
            self._motor_rpm = list(STILL)
        elif self._motor_rpm != targets:
            for channel, target in enumerate(targets):
                speed = self._motor_rpm[channel]
                slowing = abs(target) < abs(speed) or target * speed < 0.0
                ramp = self._settings["MDEC" if slowing else "MAC"][channel]
                change = ramp * 0.1 * span_ns * 1e-9
                self._motor_rpm[channel] = max(speed - change, min(speed + change, target))
        if self.motor_flags != NO_FLAGS:
            for channel, target in enumerate(targets):
                if target == 0.0:
                    self.motor_flags[channel] &= ~FM_CLEARED_AT_ZERO

    # ---- the motors

    @property
    def stage_off(self) -> bool:
        """The power stage is off: e-stop or a fault."""
        return self._emergency or self.estop_input or self.fault_flags & FF_STAGE_OFF != 0

    @property
    def motor_rpm(self) -> tuple[float, float]:
        """Speeds the two motors are driven to at this moment."""
        return self._motor_rpm[0], self._motor_rpm[1]

    @property
    def watchdog_expired(self) -> bool:
        """The watchdog holds the motors at zero; the commands still stand behind it."""
        return self._watchdog_expired

    def feedback(self, speed_rpm: Sequence[float], current_a: Sequence[float]) -> None:
        """Tell the true motor speeds and the measured currents, (2,) each."""
        self._speed_rpm = [float(speed) for speed in speed_rpm]
        self._current_a = [float(current) for current in current_a]

    def _faults(self) -> int:
        stopped = self._emergency or self.estop_input
        return self.fault_flags | (FF_EMERGENCY_STOP if stopped else 0)

    # ---- the language

    def _hear(self, data: bytes, first_ns: int) -> None:
        """Take bytes of one line, up to its end if that is among them."""
        if not self._settings["ECHOF"][0]:
            for start, echoed in _echoes(data):
                self._send(echoed, first_ns + start * BYTE_NS)
        line = self._line + data.replace(b"\n", b"")
        if not line.endswith(b"\r"):
            self._line = line[: LINE_LIMIT + 1]  # one more marks the overflow
            return
        self._line = b""
        self._advance(first_ns + (len(data) - 1) * BYTE_NS)
        line = line[:-1]
        if not line.strip():
            return
        try:
            self.say(self._obey(line))
        except Refused:
            self.say("-")

    def _obey(self, line: bytes) -> str:
        """Carry out one line and return its answer."""
        kind, name, numbers = _parsed(line)
        match kind:
            case "!":
                return self._command(name, numbers)
            case "?":
                return self._query(name, numbers)
            case "^":
                return self._set(name, numbers)
            case "~":
                return self._get(name, numbers)
            case "%":
                return self._maintain(name, numbers)
        raise Refused

    def _command(self, name: str, numbers: tuple[int, ...]) -> str:
        match name, numbers:
            case "G", (number, power):
                self._drive(_channel(number), power)
            case "S", (number, rpm) if abs(rpm) <= MOST_RPM:
                channel = _channel(number)
                most = self._settings["MXRPM"][channel]
                self._command_rpm[channel] = float(min(max(rpm, -most), most))
            case "M", (left,):
                self._drive(0, left)
            case "M", (left, right) if abs(right) <= FULL_POWER:
                self._drive(0, left)
                self._drive(1, right)
            case "MS", (number,):
                self._command_rpm[_channel(number)] = 0.0
            case "EX", ():
                self._emergency = True
            case "MG", ():
                self._emergency = False  # a pressed input sets it again at once
            case _:
                raise Refused
        timeout_ms = self._settings["RWD"][0]
        self._watchdog_expired = False  # and whatever stood before the expiry runs again
        self._watchdog_due_ns = self._now_ns + timeout_ms * 1_000_000 if timeout_ms else None
        return "+"

    def _drive(self, channel: int, power: int) -> None:
        """Command a share of the channel's full speed."""
        if abs(power) > FULL_POWER:
            raise Refused
        self._command_rpm[channel] = power / FULL_POWER * self._settings["MXRPM"][channel]

    def _query(self, name: str, numbers: tuple[int, ...]) -> str:
        if name == "FID":
            return f"FID={FIRMWARE_ID}"
        values = self._measured(name)
        if not numbers:
            return f"{name}={':'.join(map(str, values))}"
        if len(numbers) > 1 or not 1 <= numbers[0] <= len(values):
            raise Refused
        return f"{name}={values[numbers[0] - 1]}"

    def _measured(self, name: str) -> list[int]:
        """Values of a query in the manual's units."""
        currents = self._current_a
        if name == "A":  # motor, 0.1 A
            return [round(10.0 * current) for current in currents]
        if name == "BA":  # battery, 0.1 A: the stage is a transformer
            shares = [
                speed / rpm for speed, rpm in zip(self._speed_rpm, self._settings["MXRPM"], strict=True)
            ]
            return [round(10.0 * abs(c * share)) for c, share in zip(currents, shares, strict=True)]
        if name == "V":  # driver supply and battery, 0.1 V; 5 V output, mV
            return [120, round(10.0 * self.battery_v), 5000]
        if name in ("S", "BS"):
            return [round(speed) for speed in self._speed_rpm]
        if name == "CIS":  # the speeds that it was given, 1/1000 of full scale
            full_scale = self._settings["MXRPM"]
            return [
                round(1000.0 * rpm / most) for rpm, most in zip(self._command_rpm, full_scale, strict=True)
            ]
        if name == "T":  # logic, two heat sinks
            return [32, 30, 30]
        if name == "FF":
            return [self._faults()]
        if name == "FS":
            return [FS_SERIAL | (FS_STAGE_OFF if self.stage_off else 0)]
        if name == "FM":
            return list(self.motor_flags)
        raise Refused

    def _set(self, name: str, numbers: tuple[int, ...]) -> str:
        setting = SETTINGS.get(name)
        if setting is None:
            raise Refused
        if setting.per_channel:
            if len(numbers) != 2:
                raise Refused
            index, value = _channel(numbers[0]), numbers[1]
        else:
            if len(numbers) != 1:
                raise Refused
            index, value = 0, numbers[0]
        if not setting.least <= value <= setting.most:
            raise Refused
        self._settings[name][index] = value
        if name == "RWD" and value == 0:
            self._watchdog_due_ns = None
        return "+"

    def _get(self, name: str, numbers: tuple[int, ...]) -> str:
        values = self._settings.get(name)
        if values is None or len(numbers) > 1:
            raise Refused
        if numbers:
            if not 1 <= numbers[0] <= len(values):
                raise Refused
            values = values[numbers[0] - 1 : numbers[0]]
        return f"{name}={':'.join(map(str, values))}"

    def _maintain(self, name: str, numbers: tuple[int, ...]) -> str:
        if name != "EESAV" or numbers:
            raise Refused
        self._saved = {key: list(values) for key, values in self._settings.items()}
        return "+"


def _queue(wire: deque[tuple[int, bytes]], data: bytes, after_ns: int) -> int:
    """Put bytes on a wire that is free from a time on; return when the last one's stop bit is over."""
    wire.append((after_ns + BYTE_NS, data))
    return after_ns + len(data) * BYTE_NS


@lru_cache(maxsize=256)
def _echoes(data: bytes) -> tuple[tuple[int, bytes], ...]:
    """What comes back of these bytes, and from which place on; a host says the same few again and again."""
    return tuple((found.start(), found[0]) for found in _ECHOED.finditer(data))


@lru_cache(maxsize=256)
def _parsed(line: bytes) -> tuple[str, str, tuple[int, ...]]:
    """Kind, name and numbers of a line."""
    if len(line) > LINE_LIMIT or not line.isascii():
        raise Refused
    text = line.decode("ascii").strip()
    words = text[1:].upper().split()
    if not words:
        raise Refused
    return text[0], words[0], tuple(_integer(word) for word in words[1:])


def _integer(word: str) -> int:
    if not _INTEGER.fullmatch(word):
        raise Refused
    return int(word)


def _channel(number: int) -> int:
    if not 1 <= number <= CHANNELS:
        raise Refused
    return number - 1
