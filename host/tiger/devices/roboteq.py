"""One Roboteq HBL2360: two motors behind an ASCII line, without a port and without a clock.

Bytes from the port go into `feed`, bytes for it come out of `outgoing`. One exchange is under way at a time:
what the controller echoes is compared with what was sent, its answer is matched by name against a strict
grammar, and what does not come within the deadline is asked again. (Advanced Digital Motor Controllers User
Manual v1.8.)

The trap this driver must defuse: when the controller's watchdog has stopped the motors, the next valid
command makes BOTH run on at the speed they had. So the first command after any gap is `!M 0 0`, a zero for
both motors in one line that arrives whole or not at all, and no other speed is sent until zeros are confirmed
and `release` was called again. Until the watchdog was read back, the motors hear nothing but these zeros.

The line has no checksum. So every query is asked three times in one write and a reading is what two answers
agree on; a speed that jumps waits for the next reading to confirm it. A command is confirmed by its echo and
by the speeds that the controller reads back (`?CIS`). One that became another is answered by `!M 0 0` at
once; a second one within a second, or a stop that is not confirmed, is a fault that holds the motors until
`clear` and `release`.

A stop can be damaged too: one that stops nothing still feeds the watchdog. So commands that stay unconfirmed
are repeated for `PATIENCE_S` only. From then on the driver merely asks, which feeds nothing, until it knows
again what stands, or until the watchdog has stopped the motors: silence cannot be damaged.
"""

from __future__ import annotations

import math
import re
from collections import deque
from enum import Enum, IntFlag
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from tiger.frozen import dataclass
from tiger.record import DriveSample, Problem, ProblemKind

if TYPE_CHECKING:
    from collections.abc import Iterator

SpeedQuery = Literal["S", "BS"]
BAUD = 115_200
DEADLINE_S = 0.020  # of one exchange
LINE_LIMIT = 64
ASKED = 3  # times that each query is asked in one write
PATIENCE_S = 0.030  # of commands not confirmed: one deadline and one repeat, at ticks of 5 ms
NO_ANSWER_AFTER_S = 1.0
RETRY_S = 0.1  # pause between attempts to configure
RPM_LIMIT = 65_000  # of !S
FULL_SCALE = 1000  # of ?CIS: the controller's MXRPM
GAP_SHARE = 0.95  # of the watchdog's time since the last confirmed command was sent counts as a gap
SPEED_JUMP_RPM = 60  # a speed that jumps further between two readings is believed when the next one agrees
CHANGED_AGAIN_S = 1.0  # two commands changed on the way within this time: stop for good
STOP_BOTH = "!M 0 0"
READ_BACK = "?CIS"
WATCHDOG = "~RWD"
STALE_LINES = 24  # of abandoned exchanges, remembered for as long as their answers may come
RESYNC = "?\r"  # makes of half a line in the controller's buffer one that it refuses


class FaultFlag(IntFlag):
    """Bits of ?FF."""

    OVERHEAT = 1
    OVERVOLTAGE = 2
    UNDERVOLTAGE = 4
    SHORT_CIRCUIT = 8
    EMERGENCY_STOP = 16
    MOTOR_SENSOR = 32
    MOSFET = 64
    DEFAULT_CONFIG = 128


class StatusFlag(IntFlag):
    """Bits of ?FS."""

    SERIAL_MODE = 1
    PULSE_MODE = 2
    ANALOG_MODE = 4
    POWER_STAGE_OFF = 8
    STALL = 16
    AT_LIMIT = 32
    SCRIPT_RUNNING = 128
    TUNING = 256  # later firmware


class MotorFlag(IntFlag):
    """Bits of ?FM, per motor."""

    AMPS_LIMIT = 1
    STALLED = 2
    LOOP_ERROR = 4
    SAFETY_STOP = 8
    FORWARD_LIMIT = 16
    REVERSE_LIMIT = 32
    AMPS_TRIGGER = 64


CHANGED = "commands arrived as other ones"
CHANGED_REMEDY = (
    "Check its cable, shield and ground, and keep it away from the motors' wires; then clear and arm again. "
    "If every speed does it, its firmware reads speeds back otherwise: roboteq_read_back = false in [safety]."
)
MOTOR_FAULTS = MotorFlag.STALLED | MotorFlag.LOOP_ERROR | MotorFlag.SAFETY_STOP
MOTOR_REMEDY = "Check for a blocked wheel; a safety stop comes from one of the controller's inputs."

REMEDY = {
    FaultFlag.OVERHEAT: "Let it cool.",
    FaultFlag.OVERVOLTAGE: "Check the battery's voltage and that it takes the braking current.",
    FaultFlag.UNDERVOLTAGE: "Charge the battery.",
    FaultFlag.SHORT_CIRCUIT: "Check the motor phases for a short before switching it on again.",
    FaultFlag.EMERGENCY_STOP: "Make the robot safe, release the button, then clear the faults.",
    FaultFlag.MOTOR_SENSOR: "Check the Hall sensors' plugs.",
    FaultFlag.MOSFET: "Replace the controller.",
    FaultFlag.DEFAULT_CONFIG: "It lost its configuration: load the robot's with the maker's tool.",
}


def decode_flags(flags: int, kind: type[IntFlag]) -> list[str]:
    """Names of the bits that are set; a bit this program does not know is `bit N`."""
    known = {flag.value: (flag.name or "").lower().replace("_", " ") for flag in kind}
    return [known.get(1 << bit, f"bit {bit}") for bit in range(16) if flags & (1 << bit)]


class Phase(Enum):
    """Where the driver stands."""

    CONFIGURING = "configuring"  # echo on, watchdog set and read back
    ZEROING = "zeroing"  # zeros sent after a gap, not confirmed yet
    HOLDING = "holding"  # zeros confirmed again and again
    RUNNING = "running"  # released: follows `command`
    STOPPED = "stopped"  # emergency stop by command


@dataclass(frozen=True, slots=True)
class _Query:
    """A query and what a right answer to it looks like, in the controller's units."""

    name: str
    counts: tuple[int, ...]  # how many values it may have
    low: int
    high: int
    within: tuple[int, ...] = (0, 0, 0, 0)  # how far two answers a millisecond apart may differ


_QUERIES = {
    query.name: query
    for query in (
        _Query("S", (2,), -RPM_LIMIT, RPM_LIMIT, within=(6, 6)),  # of encoders
        _Query("BS", (2,), -RPM_LIMIT, RPM_LIMIT, within=(6, 6)),  # of brushless motors' Hall sensors
        _Query("A", (2,), -5000, 5000, within=(50, 50)),
        _Query("BA", (2,), -5000, 5000, within=(50, 50)),
        _Query("V", (3,), 0, 10_000, within=(5, 5, 50)),
        _Query("FF", (1,), 0, 0xFFFF),
        _Query("FS", (1,), 0, 0xFFFF),
        _Query("FM", (2,), 0, 0xFFFF),
        _Query("T", (2, 3, 4), -60, 200, within=(1, 1, 1, 1)),
        _Query("CIS", (2,), -FULL_SCALE, FULL_SCALE),
        _Query("RWD", (1,), 0, 65_000),
        _Query("MXRPM", (2,), 10, RPM_LIMIT),
    )
}
# One of these follows the speeds in each cycle: fault flags every other time, motor currents every fourth, as
# the load and the wheels' forces are told from them. The watchdog is among the rest, twice, because a
# controller that lost power for a moment, unnoticed, is back at the one it came with.
_SLOW_QUERIES = tuple(
    line for slow in ("?V", "~RWD", "?FM", "?BA", "~RWD", "?FS", "?T") for line in ("?FF", "?A", "?FF", slow)
)
_NUMBER = rb"(?:0|-?[1-9][0-9]{0,4})"  # as the controller writes it: no leading zero, no minus zero
_ANSWER = re.compile(rb"([A-Z]{1,5})=(%b(?::%b){0,3})" % (_NUMBER, _NUMBER))
_SETTING = (b"!", b"^")
_COMMAND_START = (*_SETTING, b"?", b"~")


class _Exchange:
    """Lines sent, and for each its echo and its answer expected back."""

    def __init__(
        self, lines: list[str], sent_s: float, stale: frozenset[bytes], echo_may_be_off: bool = False
    ) -> None:
        """`stale` are lines of abandoned exchanges whose echoes and answers may still come before ours."""
        self.lines = lines
        self.sent = [line.encode("ascii") for line in lines]
        self.sent_s = sent_s
        self.deadline_s = sent_s + DEADLINE_S
        self._stale = stale
        self._echo_may_be_off = echo_may_be_off
        self._place = 0
        self._echoed = False
        self.answers: list[tuple[int, ...]] = []
        self.failed = False
        self.refused = False
        self.wrong_echo = False

    @property
    def done(self) -> bool:
        return self._place == len(self.lines)

    def hear(self, line: bytes) -> bool:
        """Take one line; returns whether it belonged here."""
        sent = self.sent[self._place]
        if self._echoed:
            return self._answer(sent, line)
        if line == sent:
            self._echoed = True
            return True
        if self._echo_may_be_off:
            # Half a line from before may be answered first; of a command, only a "+" can be ours.
            return (line == b"+" or sent[:1] == b"?") and self._answer(sent, line)
        # Perhaps our command arrived as another one; and an answer without its echo confirms nothing.
        if line in self._stale:
            return False
        skipped = line in self.sent
        self.wrong_echo = line[:1] in _COMMAND_START and not skipped
        self.failed = self.wrong_echo or skipped or (line in (b"+", b"-") and not self._stale)
        return False

    def _answer(self, sent: bytes, line: bytes) -> bool:
        if sent[:1] in _SETTING:
            right = line == b"+"
            self.failed = line == b"-" or line[:1] in _COMMAND_START
        else:
            values = _values(sent, line)
            right = values is not None
            self.failed = not right
            self.refused = line == b"-"
            if values is not None:
                self.answers.append(values)
        if right:
            self._place += 1
            self._echoed = False
        return right


@lru_cache(maxsize=1024)  # every query is asked three times, and most answers are those of before
def _values(sent: bytes, line: bytes) -> tuple[int, ...] | None:
    """The numbers of the answer to the query that was sent; None unless the line is exactly such an
    answer."""
    match = _ANSWER.fullmatch(line)
    if match is None or match[1] != sent[1:]:
        return None
    query = _QUERIES[sent[1:].decode("ascii")]
    values = tuple(int(value) for value in match[2].split(b":"))
    plausible = len(values) in query.counts and all(query.low <= value <= query.high for value in values)
    return values if plausible else None


def _agreed(name: str, answers: list[tuple[int, ...]]) -> tuple[int, ...] | None:
    """One reading from the answers to a query asked three times, or None when they contradict each other."""
    first = answers[0]
    if answers.count(first) == len(answers):
        return first
    if len({len(answer) for answer in answers}) > 1:
        return None
    columns = zip(*answers, _QUERIES[name].within[: len(answers[0])], strict=True)
    values = [_two_of_three(*column) for column in columns]
    return None if None in values else tuple(values)  # type: ignore[arg-type]


def _two_of_three(a: int, b: int, c: int, within: int) -> int | None:
    """What two say alike; of a value on the move the middle one, so that a damaged digit is outvoted.

    Flags, which do not move, must be alike in all three: a wrong one would stop the robot.
    """
    if not within:
        return a if a == b == c else None
    if b in (a, c):
        return b
    if a == c:
        return a
    low, middle, high = sorted((a, b, c))
    return middle if high - low <= within else None


class Roboteq:
    """One controller; see the module's text."""

    def __init__(
        self,
        name: str,
        port: str,
        watchdog_ms: int,
        rate_hz: float,
        sustained_s: float,
        read_back: bool = True,
        speed_query: SpeedQuery = "S",
    ) -> None:
        """`name` and `port` are for messages; commands are refreshed at `rate_hz`, and read back or not.

        The squares of the motors' currents are smoothed over `sustained_s`; `speed_query` asks for their
        speeds.
        """
        self.name = name
        self.port = port
        self.watchdog_ms = watchdog_ms
        self.period_s = 1.0 / rate_hz
        self.gap_s = GAP_SHARE * watchdog_ms * 1e-3
        self.silence_s = DEADLINE_S + watchdog_ms * 1e-3  # without a command: then the motors stand still
        self.exchanges = 0  # completed
        self.timeouts = 0
        self.wrong_echoes = 0
        self.garbled = 0  # lines that belonged to nothing
        self.gaps = 0  # times that a released drive lost its commands
        self.contradictions = 0  # readings dropped because the answers differed
        self.changed_commands = 0  # speeds that arrived as other ones, answered by a stop
        self.fault: Problem | None = None  # why the motors are held until `clear`
        self._read_back = read_back
        self._speed_query = speed_query
        self._sustained_s = sustained_s
        self._mean_square_a2 = (0.0, 0.0)  # outlives a lost connection, as the motors' heat does
        self._current_s = -math.inf  # when the currents were read last
        self._emergency = False  # asked for and not taken back; outlives a lost connection
        self._said_s = -math.inf  # when a command was sent last, whatever became of it
        self.connected(-math.inf)

    def connected(self, now_s: float) -> None:
        """The port was opened (again): nothing is known, nothing moves."""
        self.phase = Phase.CONFIGURING
        self.sample: DriveSample | None = None
        self.problem: Problem | None = None
        self.flags: dict[str, int] = {"FF": 0, "FS": 0, "FM1": 0, "FM2": 0}
        self._opened_s = now_s
        self._exchange: _Exchange | None = None
        self._stale: deque[bytes] = deque(maxlen=STALE_LINES)
        self._stale_until_s = -math.inf
        self._partial = b""
        self._step = 0
        self._retry_s = max(now_s, self._said_s + self.silence_s)
        self._wanted_rpm = (0, 0)
        self._sent_rpm = (0, 0)
        self._meant_rpm = [(0, 0)]  # what may stand: the speeds confirmed last, and those sent since
        self._unsure_s = math.inf  # when the first command was sent of those not confirmed
        self._full_scale_rpm = (RPM_LIMIT, RPM_LIMIT)
        self._confirmed_s = -math.inf
        self._heard_s = -math.inf
        self._motor_due_s = now_s
        self._queries: deque[str] = deque()
        self._slow = 0
        self.readings: dict[str, tuple[int, ...]] = {}  # last one of each query, in the controller's units
        self._stop = self._emergency
        self._go = False
        self._quench = False  # both motors must be stopped before anything else is said
        self._changed_s = -math.inf

    # ------------------------------------------------------------------------------------------- what to do

    @property
    def ready(self) -> bool:
        """Whether `release` would be obeyed: configured, zeros confirmed, speeds and flags known."""
        known = self.sample is not None and self.problem is None and self.fault is None
        return self.phase is Phase.HOLDING and known

    @property
    def wrong_speed_s(self) -> float:
        """How long a motor may run at a speed that nobody meant, on a line that delivers within a deadline.

        From the first command that may have arrived as another one, `PATIENCE_S` until the last that may feed
        the watchdog is sent, a deadline until it arrives, and the watchdog's time.
        """
        return PATIENCE_S + self.silence_s

    @property
    def answering(self) -> bool:
        """Whether the controller was configured and answers."""
        return self.phase is not Phase.CONFIGURING

    def release(self) -> bool:
        """Let `command` reach the motors, from zero; False when the driver is not ready."""
        if not self.ready:
            return False
        self._wanted_rpm = (0, 0)
        self.phase = Phase.RUNNING
        return True

    def hold(self) -> None:
        """Zeros from now on."""
        self._wanted_rpm = (0, 0)
        if self.phase is Phase.RUNNING:
            self.phase = Phase.ZEROING
            self._motor_due_s = -math.inf

    def command(self, front_rpm: float, rear_rpm: float) -> None:
        """Speeds of the two motors; without effect unless released."""
        if self.phase is Phase.RUNNING:
            front_most, rear_most = self._full_scale_rpm
            self._wanted_rpm = (_whole_rpm(front_rpm, front_most), _whole_rpm(rear_rpm, rear_most))

    def emergency_stop(self) -> None:
        """Switch the power stage off (`!EX`) until `clear`."""
        self._emergency = self._stop = True
        self._step = 0
        self._go = False
        self._wanted_rpm = (0, 0)
        self._abandon()

    def clear(self) -> None:
        """Forget the fault, and take the emergency stop back (`!MG`) once zeros are confirmed.

        The motors stay at zero.
        """
        self.fault = None
        self._changed_s = -math.inf
        if self._emergency:
            self._abandon()
            self._step = 0  # the lines that configure are other ones
        self._emergency = self._stop = False
        self._go = True
        if self.phase is Phase.STOPPED:
            self.phase = Phase.ZEROING

    # --------------------------------------------------------------------------------------------- receiving

    def feed(self, data: bytes, now_s: float) -> None:
        """Take bytes that arrived by `now_s`."""
        *lines, rest = (self._partial + data).replace(b"\n", b"").split(b"\r")
        self._partial = rest[-LINE_LIMIT:]
        for line in lines:
            if line:
                self._line(line.strip(b" "), now_s)

    def _line(self, line: bytes, now_s: float) -> None:
        exchange = self._exchange
        if exchange is None or not exchange.hear(line):
            self.garbled += 1
        if exchange is None:
            return
        if exchange.failed:
            self.wrong_echoes += exchange.wrong_echo
            if exchange.wrong_echo and exchange.lines[0].startswith("!S"):
                self._changed(now_s)
            if exchange.refused and self.phase is Phase.CONFIGURING:
                self._unable(exchange.lines[-1])
            self._failed(now_s)
        elif exchange.done:
            self._exchange = None
            self.exchanges += 1
            self._heard_s = now_s
            self._completed(exchange, now_s)

    def _completed(self, exchange: _Exchange, now_s: float) -> None:
        first = exchange.lines[0]
        if self.phase is Phase.CONFIGURING:
            self._configured(first, exchange, now_s)
        elif first == "!EX":
            self.phase, self._stop = Phase.STOPPED, False
            self._unsure_s = math.inf  # whatever stands: without power nothing turns
        elif first == "!MG":
            self._go = False
        elif first[:2] in ("!M", "!S") and not self._as_sent(exchange):
            self._changed(now_s)
            self._motor_due_s = now_s
        elif first == STOP_BOTH:
            self._quench = False
            self._confirmed((0, 0), exchange.sent_s)
            self._motor_due_s = now_s
        elif first.startswith("!S"):
            self._confirmed(self._sent_rpm, exchange.sent_s)
            if self.phase is Phase.ZEROING and self._sent_rpm == (0, 0):
                self.phase = Phase.HOLDING
        elif first == READ_BACK:
            self._stands(exchange.answers[:ASKED], exchange.answers[ASKED:], now_s)
        else:
            self._answered(first[1:], exchange.answers, now_s)

    def _as_sent(self, exchange: _Exchange) -> bool:
        """Whether the controller says that it was given the speeds that were sent."""
        if not self._read_back:
            return True
        speeds = (0, 0) if exchange.lines[0] == STOP_BOTH else self._sent_rpm
        return all(self._is_given(speeds, exchange.answers[0]))

    def _is_given(self, speeds: tuple[int, int], given: tuple[int, ...]) -> Iterator[bool]:
        """Of each motor: does what ?CIS answered mean this speed?"""
        for rpm, thousandths, most_rpm in zip(speeds, given, self._full_scale_rpm, strict=True):
            yield abs(FULL_SCALE * rpm - thousandths * most_rpm) < most_rpm

    def _confirmed(self, speeds: tuple[int, int], sent_s: float) -> None:
        """These speeds stand; the controller's watchdog may run from the moment of sending on."""
        self._confirmed_s = sent_s
        self._unsure_s = math.inf
        self._meant_rpm = [speeds]

    def _stands(self, given: list[tuple[int, ...]], watchdog: list[tuple[int, ...]], now_s: float) -> None:
        """Take what stands after commands that stayed unconfirmed: if it was meant, go on commanding."""
        self._answered("RWD", watchdog, now_s)
        speeds = _agreed("CIS", given)
        if self.phase is Phase.CONFIGURING or speeds is None or _agreed("RWD", watchdog) is None:
            return
        meant = [self._is_given(pair, speeds) for pair in ((0, 0), *self._meant_rpm)]
        if all(any(motor) for motor in zip(*meant, strict=True)):
            self._unsure_s = math.inf
            self._quench = False
            self._motor_due_s = now_s

    def _changed(self, now_s: float) -> None:
        """A command may have arrived as another one: stop both motors now; if that repeats, for good."""
        self.changed_commands += 1
        self._quench = True
        if now_s - self._changed_s < CHANGED_AGAIN_S:
            self.hold()
            self._blame_line()
        self._changed_s = now_s

    def _blame_line(self) -> None:
        where = f"{self.name} on {self.port}"
        self.fault = Problem(ProblemKind.FAULT, where, CHANGED, CHANGED_REMEDY)

    def _unable(self, line: str) -> None:
        self.problem = Problem(
            ProblemKind.REFUSED,
            f"{self.name} on {self.port}",
            f"does not answer {line}",
            "Set roboteq_read_back = false under [safety], or renew its firmware.",
        )

    def _configured(self, line: str, exchange: _Exchange, now_s: float) -> None:
        if line == "!EX":
            self._unsure_s = math.inf
        elif line == STOP_BOTH:
            if not self._as_sent(exchange):
                self._try_again(now_s)
                return
            self._confirmed((0, 0), exchange.sent_s)
        if line.startswith("~") and len(set(exchange.answers)) > 1:
            self._retry_s = now_s + RETRY_S
            return
        if line == "~MXRPM":
            front_rpm, rear_rpm = exchange.answers[0]
            self._full_scale_rpm = (front_rpm, rear_rpm)
        if line == WATCHDOG and exchange.answers[0] != (self.watchdog_ms,):
            self._try_again(now_s)
            self.problem = Problem(
                ProblemKind.REFUSED,
                f"{self.name} on {self.port}",
                f"keeps its watchdog at {exchange.answers[0][0]} ms instead of {self.watchdog_ms} ms",
                "Check that no script on the controller sets RWD.",
            )
            return
        self._step += 1
        if self._step == len(self._configuration):
            self.phase = Phase.ZEROING
            self.problem = None
            self._motor_due_s = self._confirmed_s = now_s

    @property
    def _configuration(self) -> tuple[str, ...]:
        first = "!EX" if self._emergency else STOP_BOTH
        scale = ("~MXRPM",) if self._read_back else ()
        return (first, "^ECHOF 0", f"^RWD {self.watchdog_ms}", WATCHDOG, *scale)

    def _try_again(self, now_s: float) -> None:
        """Configure again; a stop that failed is repeated for a while, then after a silence."""
        if self._step > 0:
            # The motors stand. What ^RWD has become is not known: no command before ~RWD has answered.
            self._step = 1
            self._retry_s = now_s + RETRY_S
        elif self._is_unsure(now_s):
            self._retry_s = self._said_s + self.silence_s
            self._unsure_s = math.inf  # the motors stand by then

    def _answered(self, name: str, answers: list[tuple[int, ...]], now_s: float) -> None:
        last = self.readings.get(name)
        values = _agreed(name, answers)
        if values is None:
            self.contradictions += 1
            return
        self.readings[name] = values
        if name in ("FF", "FS"):
            self.flags[name] = values[0]
        elif name == "FM":
            self.flags["FM1"], self.flags["FM2"] = values
        elif name == "A":
            self._warm(values, now_s)
        elif name == "RWD" and values[0] != self.watchdog_ms:
            self._begin_anew(now_s)
            self._retry_s = now_s  # no silence: the watchdog of a controller that lost power is a long one
        elif name == self._speed_query:
            plausible = last is not None and _near(values, last)
            if plausible and {"V", "FF"} <= self.readings.keys():
                self.sample = self._sampled(values, now_s)

    def _warm(self, tenths_a: tuple[int, ...], now_s: float) -> None:
        """Take the motors' currents into the mean of their squares; a long gap counts as one at this one."""
        share = 1.0 - math.exp(-(now_s - self._current_s) / self._sustained_s)
        front, rear = self._mean_square_a2
        if self._current_s == -math.inf:
            share = 0.0  # since when, no one knows
        self._current_s = now_s
        self._mean_square_a2 = (
            front + share * (0.01 * tenths_a[0] ** 2 - front),
            rear + share * (0.01 * tenths_a[1] ** 2 - rear),
        )

    def _sampled(self, speeds: tuple[int, ...], now_s: float) -> DriveSample:
        motor = self.readings.get("A", (0, 0))
        battery = self.readings.get("BA", (0, 0))
        temperatures = self.readings.get("T")
        return DriveSample(
            t_s=now_s,
            wheel_rpm=(float(speeds[0]), float(speeds[1])),
            motor_current_a=(motor[0] / 10.0, motor[1] / 10.0),
            battery_current_a=(battery[0] / 10.0, battery[1] / 10.0),
            battery_v=self.readings["V"][1] / 10.0,
            controller_temperature_celsius=float(max(temperatures)) if temperatures else None,
            fault_flags=self.flags["FF"],
            status_flags=self.flags["FS"],
            sustained_current_a=(math.sqrt(self._mean_square_a2[0]), math.sqrt(self._mean_square_a2[1])),
        )

    # ----------------------------------------------------------------------------------------------- sending

    def outgoing(self, now_s: float) -> bytes:
        """The bytes that are due; nothing while an exchange is under way."""
        self._notice_gap(now_s)
        if self._exchange is not None:
            if now_s < self._exchange.deadline_s:
                return b""
            self.timeouts += 1
            self._failed(now_s)
        lines = self._next(now_s)
        if not lines:
            return b""
        configuring = self.phase is Phase.CONFIGURING
        if now_s > self._stale_until_s:
            self._stale.clear()
        if lines[0].startswith("!"):
            self._said_s = now_s
            self._unsure_s = min(self._unsure_s, now_s)
        self._exchange = _Exchange(
            lines, now_s, frozenset(self._stale), echo_may_be_off=configuring and self._step < 2
        )
        resync = RESYNC if configuring and self._step == 0 else ""
        return (resync + "".join(f"{line}\r" for line in lines)).encode("ascii")

    def _next(self, now_s: float) -> list[str]:
        """The lines to send now."""
        if self.phase is Phase.CONFIGURING:
            is_due = now_s >= self._retry_s or (self._emergency and self._step == 0)
            return self._configuring() if is_due else []
        if self._stop:
            return ["!EX"]
        read_back = [READ_BACK] if self._read_back else []
        silent = self._read_back and self._is_unsure(now_s)
        if self._quench and not silent:
            return [STOP_BOTH, *read_back]
        if now_s >= self._motor_due_s:
            self._plan_cycle(now_s)
            if silent:
                return [READ_BACK] * ASKED + [WATCHDOG] * ASKED
            self._sent_rpm = self._wanted_rpm
            self._meant_rpm.append(self._sent_rpm)
            speeds = [f"!S {channel} {rpm}" for channel, rpm in enumerate(self._sent_rpm, start=1)]
            return speeds + read_back
        if self._go and self.phase is Phase.HOLDING and not silent:
            return ["!MG"]
        return [self._queries.popleft()] * ASKED if self._queries else []

    def _is_unsure(self, now_s: float) -> bool:
        """Whether commands have gone unconfirmed for so long that one more might do harm."""
        return now_s - self._unsure_s > PATIENCE_S

    def _configuring(self) -> list[str]:
        line = self._configuration[self._step]
        if line == STOP_BOTH and self._read_back:
            return [line, READ_BACK]
        return [line] * ASKED if line[0] == "~" else [line]

    def _plan_cycle(self, now_s: float) -> None:
        """The next command comes a period later; until then there is time for two queries."""
        due_s = self._motor_due_s + self.period_s
        self._motor_due_s = due_s if due_s > now_s else now_s + self.period_s
        self._queries = deque((f"?{self._speed_query}", _SLOW_QUERIES[self._slow]))
        self._slow = (self._slow + 1) % len(_SLOW_QUERIES)

    def _failed(self, now_s: float) -> None:
        """An exchange failed: commands are repeated at once, everything else in its turn."""
        exchange = self._abandon()
        if exchange is not None and exchange.lines[0].startswith(("!S", READ_BACK)):
            self._motor_due_s = now_s
        if self.phase is not Phase.CONFIGURING:
            return
        self._try_again(now_s)
        if self.problem is None and now_s - max(self._opened_s, self._heard_s) > NO_ANSWER_AFTER_S:
            self.problem = Problem(
                ProblemKind.NO_ANSWER,
                f"{self.name} on {self.port}",
                "does not answer",
                "Check its power, its cable, that it is the controller's RS-232 or USB port, and its path "
                "under [ports].",
            )

    def _abandon(self) -> _Exchange | None:
        """Wait no longer for the exchange under way; what it still brings belongs to nothing."""
        exchange, self._exchange = self._exchange, None
        if exchange is not None:
            self._stale.extend(exchange.sent)
            self._stale_until_s = exchange.deadline_s + DEADLINE_S
        return exchange

    def _notice_gap(self, now_s: float) -> None:
        """Without confirmed commands the watchdog has stopped the motors, or power was lost: begin anew."""
        if self.phase is Phase.CONFIGURING or now_s - self._confirmed_s < self.gap_s:
            return
        self._begin_anew(now_s)

    def _begin_anew(self, now_s: float) -> None:
        self.gaps += self.phase is Phase.RUNNING
        if self._quench:
            self._blame_line()
        self.connected(now_s)


def _near(speeds: tuple[int, ...], others: tuple[int, ...]) -> bool:
    return all(abs(a - b) <= SPEED_JUMP_RPM for a, b in zip(speeds, others, strict=True))


def _whole_rpm(rpm: float, most: int) -> int:
    return round(min(max(rpm, -most), most)) if math.isfinite(rpm) else 0
