"""The Roboteq link under fire: lost and damaged lines, fragments, echo on and off, against the emulated unit.

A million exchanges each in `make proof`, a short run in `make test`. Truth is what the emulated controller
did: every answer that it gave is logged there, every command that it obeyed is compared with what was sent.
"""

from __future__ import annotations

import math
import random
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pytest

from tiger.devices.roboteq import DEADLINE_S, SPEED_JUMP_RPM, Phase
from tiger.devices.roboteq import Roboteq as Driver
from tiger.emulation.cable import LineNoise, NoisyLine
from tiger.emulation.roboteq import Roboteq as Controller

if TYPE_CHECKING:
    from collections.abc import Callable

WATCHDOG_MS = 150
TOP_RPM = 120
BLACKOUT_EVERY_MS = 5000  # the cable goes dead for longer than the watchdog's time, or power fails
STEP_US = 1000
RECENT_ANSWERS = 24  # of one query: those of a few deadlines


class TruthfulController(Controller):
    """The emulated unit, with a log of the readings that it gave and the speeds that it obeyed."""

    def __init__(self, seed: int, echo: bool) -> None:
        super().__init__(seed=seed)
        self.given: dict[str, deque[tuple[int, ...]]] = {}
        self.resumed = 0  # commands that brought back a speed from before the watchdog's expiry
        self.obeyed: list[tuple[int, float]] = []  # (channel, rpm) since the last look
        if not echo:
            self.receive(b"^ECHOF 1\r%EESAV\r")
            self.run(10_000)
            self.transmit()

    def _measured(self, name: str) -> list[int]:
        values = super()._measured(name)
        self.given.setdefault(name, deque(maxlen=RECENT_ANSWERS)).append(tuple(values))
        return values

    def _command(self, name: str, numbers: tuple[int, ...]) -> str:
        standing = self.commands_rpm if self.watchdog_expired else (0.0, 0.0)
        before = self.commands_rpm
        answer = super()._command(name, numbers)
        now = self.commands_rpm
        woken = [c for c in range(2) if standing[c] != 0.0 and standing[c] == now[c]]
        self.resumed += bool(woken)
        if name == "S":
            self.obeyed.append((numbers[0] - 1, now[numbers[0] - 1]))
        else:
            self.obeyed += [(c, rpm) for c, rpm in enumerate(now) if rpm != before[c]]
        self.obeyed += [(c, math.nan) for c in woken]  # whatever it is, nobody means it any more
        return answer

    @property
    def commands_rpm(self) -> tuple[float, float]:
        """The speeds that it means to run at."""
        return self._command_rpm[0], self._command_rpm[1]


@dataclass
class LossyLine:
    """One direction of the cable: loses whole lines, damages bytes, delivers in pieces."""

    random: random.Random
    loss: float
    noise: NoisyLine
    cut: bool = False
    _line: bytes = b""
    _queue: bytes = b""

    def put(self, data: bytes) -> None:
        """Take bytes; a line is lost as a whole or not at all."""
        *lines, self._line = (self._line + data).split(b"\r")
        for line in lines:
            if not self.cut and self.random.random() >= self.loss:
                self._queue += self.noise.carry(line + b"\r")

    def lose(self) -> None:
        """Nobody is there to take what is on its way."""
        self._line = self._queue = b""

    def take(self) -> bytes:
        """The next fragment."""
        size = self.random.choice((0, 1, 3, 7, 40, 40))
        piece, self._queue = self._queue[:size], self._queue[size:]
        return piece


@dataclass
class Tally:
    """What happened, by the controller's own account."""

    exchanges: int = 0  # begun
    completed: int = 0
    readings: int = 0
    wrong_readings: int = 0  # used, but never given by the controller
    off_readings: int = 0  # of them: off by more than the last digit
    worst_ms: float = 0.0  # longest exchange
    commands: int = 0  # confirmed
    unnoticed: int = 0  # confirmed, but the controller runs at something else
    wrong_ms: int = 0  # longest time at a speed that was never sent
    changed: int = 0  # obeyed, but never sent
    resumed: int = 0  # brought back a speed from before the watchdog's expiry
    stops: int = 0
    gaps: int = 0
    reboots: int = 0
    used: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    largest_error: Counter[str] = field(default_factory=Counter)  # of each query, in its own units

    def note_duration(self, exchange_s: float) -> None:
        """So long an exchange has been under way, to the nanosecond: time is counted in milliseconds here."""
        self.worst_ms = max(self.worst_ms, round(1e3 * exchange_s, 6))


@dataclass
class Ordeal:
    """Driver and controller on a bad cable."""

    seed: int
    echo: bool
    loss: float = 0.01
    noise: LineNoise = field(default_factory=LineNoise)

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.controller = TruthfulController(self.seed, self.echo)
        self.driver = Driver("roboteq (left)", "/dev/left", WATCHDOG_MS, 50.0, 20.0)
        self.driver.connected(0.0)
        # The controller's answers to echoes come byte by byte, so damage is per direction and per line.
        self.down = LossyLine(self.random, self.loss, NoisyLine(self.noise, 2 * self.seed))
        self.up = LossyLine(self.random, self.loss, NoisyLine(self.noise, 2 * self.seed + 1))
        self.tally = Tally()
        self._now_ms = 0
        self._sent_rpm: deque[tuple[int, int]] = deque([(0, 0)], maxlen=3)
        self._wrong_since_ms: list[int | None] = [None, None]
        self._dark_until_ms = 0
        self._rebooted_s = -1.0

    def run(self, exchanges: int) -> Tally:
        """Go on until so many exchanges have begun."""
        while self.tally.exchanges < exchanges:
            self._blackouts()
            self._millisecond()
        self.tally.gaps, self.tally.stops = self.driver.gaps, self.driver.changed_commands
        self.tally.completed, self.tally.resumed = self.driver.exchanges, self.controller.resumed
        return self.tally

    def _blackouts(self) -> None:
        if self._now_ms % BLACKOUT_EVERY_MS == BLACKOUT_EVERY_MS - 1:
            self.down.cut = self.up.cut = True
            self._dark_until_ms = self._now_ms + self.random.randrange(20, 400)
            if self.random.random() < 0.3:
                self.controller.reboot()
                self.down.lose()
                self._rebooted_s = self._now_ms * 1e-3
                self._wrong_since_ms = [None, None]  # with its power it lost its commands
                self.tally.reboots += 1
        if self._now_ms >= self._dark_until_ms:
            self.down.cut = self.up.cut = False

    def _millisecond(self) -> None:
        self._now_ms += 1
        now_s = self._now_ms * 1e-3
        controller = self.controller
        data = self.down.take()
        if data:
            controller.receive(data)
        controller.run(STEP_US)
        # Speeds never repeat themselves for long, so that a stale or misplaced reading shows.
        wobble = self._now_ms // 7 % 5
        front, rear = controller.motor_rpm
        controller.feedback((front + wobble, rear - wobble), (0.1 * front, 0.1 * rear))
        self.up.put(controller.transmit())
        self._hear(self.up.take(), now_s)
        self._steer()
        self._say(now_s)
        self._watch()

    def _hear(self, data: bytes, now_s: float) -> None:
        """Feed byte by byte, so that every completed exchange is seen."""
        driver = self.driver
        for byte in data:
            exchange, completed, changed = driver._exchange, driver.exchanges, driver.changed_commands
            driver.feed(bytes((byte,)), now_s)
            if exchange is None or driver.exchanges == completed or driver.changed_commands > changed:
                continue
            self.tally.note_duration(now_s - exchange.sent_s)
            self._check(exchange.lines[0], lost_power=exchange.sent_s <= self._rebooted_s)

    def _check(self, line: str, lost_power: bool) -> None:
        if line.startswith("!S"):
            self.tally.commands += 1
            # A unit that lost its power after it had answered has forgotten the command; nobody can know yet.
            if lost_power:
                return
            self.tally.unnoticed += self.controller.commands_rpm != tuple(map(float, self._sent_rpm[-1]))
        elif line.startswith("?") and line[1:] in self.driver.readings:
            name = line[1:]
            used = self.driver.readings[name]
            self.tally.readings += 1
            self.tally.used[name] += 1
            given = self.controller.given.get(name, ())
            columns = list(zip(*given, strict=True))
            errors = [min(abs(v - c) for c in column) for v, column in zip(used, columns, strict=True)]
            if any(errors):
                self.tally.wrong_readings += 1
                self.tally.off_readings += max(errors) > 1
                self.tally.wrong[name] += 1
                self.tally.largest_error[name] = max(self.tally.largest_error[name], *errors)

    def _steer(self) -> None:
        """Another speed now and then; release the drive whenever it is ready."""
        driver = self.driver
        if driver.phase is not Phase.RUNNING:
            if self._now_ms % 300 == 0:
                driver.clear()
                driver.release()
        elif self._now_ms % 50 == 0:
            driver.command(self.random.randint(-TOP_RPM, TOP_RPM), self.random.randint(-TOP_RPM, TOP_RPM))

    def _say(self, now_s: float) -> None:
        out = self.driver.outgoing(now_s)
        if out:
            self.tally.exchanges += 1
            self.down.put(out)
            if out.startswith(b"!S"):
                front, rear = (int(line.split()[2]) for line in out.decode("ascii").split("\r")[:2])
                self._sent_rpm.append((front, rear))
        exchange = self.driver._exchange
        if exchange is not None:
            self.tally.note_duration(now_s - exchange.sent_s)

    def _watch(self) -> None:
        """Does each motor run at a speed that was sent to it?"""
        controller, tally = self.controller, self.tally
        for channel, rpm in controller.obeyed:
            sent = rpm == 0.0 or any(rpm == pair[channel] for pair in self._sent_rpm)
            tally.changed += not sent
            self._wrong_since_ms[channel] = None if sent else self._now_ms
        controller.obeyed.clear()
        if controller.watchdog_expired or controller.stage_off:
            self._wrong_since_ms = [None, None]
        for since_ms in self._wrong_since_ms:
            if since_ms is not None:
                tally.wrong_ms = max(tally.wrong_ms, self._now_ms - since_ms + 1)


TRAFFIC = ("exchanges", "completed", "readings", "commands", "gaps", "stops", "reboots")
COUNTS = (*TRAFFIC, "wrong_readings", "off_readings", "unnoticed", "changed", "resumed")


def _ordeals(exchanges: int, noise: LineNoise) -> Tally:
    """Half with the echo switched on from the start, half with it saved as off; the sum of both."""
    total = Tally()
    for seed, echo in enumerate((True, False)):
        tally = Ordeal(seed=seed, echo=echo, noise=noise).run(exchanges // 2)
        for name in COUNTS:
            setattr(total, name, getattr(total, name) + getattr(tally, name))
        for name in ("worst_ms", "wrong_ms"):
            setattr(total, name, max(getattr(total, name), getattr(tally, name)))
        total.used += tally.used
        total.wrong += tally.wrong
        total.largest_error |= tally.largest_error
    return total


SHORT, LONG = 20_000, 1_000_000
CORRUPTED = LineNoise(flip=0.01)
# Looked at once a millisecond, from the one in which it came.
CHANGE_LIMIT_MS = round(1e3 * Driver("", "", WATCHDOG_MS, 50.0, 20.0).wrong_speed_s) + 2


def _expect_no_error(tally: Tally) -> None:
    assert tally.wrong_readings == 0
    assert tally.unnoticed == tally.changed == 0
    assert tally.stops <= tally.reboots  # power lost in the middle of a line cuts its echo
    assert tally.resumed == 0
    assert tally.worst_ms <= 1e3 * DEADLINE_S + 1e-3 * STEP_US
    assert tally.gaps > tally.exchanges / 5000  # the blackouts did bite
    assert tally.completed > 0.85 * tally.exchanges


def _expect_every_error_noticed(tally: Tally) -> None:
    assert tally.resumed <= 1e-2 * tally.gaps  # one bit makes of a zero for both one for one
    assert tally.changed > tally.exchanges / 1000  # the damage did bite
    assert tally.stops > tally.changed
    assert tally.unnoticed == 0
    assert tally.wrong_ms <= CHANGE_LIMIT_MS
    assert tally.wrong_readings <= 5e-4 * tally.readings
    assert tally.largest_error["S"] <= SPEED_JUMP_RPM
    assert tally.worst_ms <= 1e3 * DEADLINE_S + 1e-3 * STEP_US


def test_lost_lines_fragments_and_blackouts_cause_no_wrong_value_and_no_resumed_speed() -> None:
    _expect_no_error(_ordeals(SHORT, LineNoise()))


def test_with_damaged_bytes_changed_commands_are_noticed_and_implausible_values_not_used() -> None:
    _expect_every_error_noticed(_ordeals(SHORT, CORRUPTED))


@pytest.mark.proof
@pytest.mark.timeout(1800)
def test_a_million_exchanges_with_losses(record_figure: Callable[[str, object, str], None]) -> None:
    tally = _ordeals(LONG, LineNoise())
    what = f"Roboteq link, {tally.exchanges} exchanges, 1 % of lines lost, fragments, echo on and off"
    record_figure(f"{what}: wrong values", tally.wrong_readings, "0")
    record_figure(f"{what}: commands obeyed that were not sent", tally.changed, "0")
    record_figure(f"{what}: old speeds resumed over {tally.gaps} gaps", tally.resumed, "0")
    record_figure(
        f"{what}: longest exchange, ms", round(tally.worst_ms, 3), "<= 20, looked at once a millisecond"
    )
    record_figure(f"{what}: completed at once, %", 100.0 * tally.completed / tally.exchanges, "> 85")
    _expect_no_error(tally)


@pytest.mark.proof
@pytest.mark.timeout(1800)
def test_a_million_exchanges_with_damaged_bytes(record_figure: Callable[[str, object, str], None]) -> None:
    tally = _ordeals(LONG, CORRUPTED)
    what = f"Roboteq link, {tally.exchanges} exchanges, 1 % of bytes damaged and of lines lost"
    errors = ", ".join(f"{name} {most}" for name, most in sorted(tally.largest_error.items()))
    record_figure(f"{what}: readings used", tally.readings, "")
    record_figure(
        f"{what}: of them wrong, per million", 1e6 * tally.wrong_readings / tally.readings, "<= 500"
    )
    record_figure(f"{what}: of these off by more than the last digit", tally.off_readings, "")
    record_figure(f"{what}: largest error (rpm, 0.1 A, 0.1 V, degrees, bits)", errors, "S <= 60")
    record_figure(f"{what}: commands confirmed", tally.commands, "")
    record_figure(f"{what}: obeyed as other ones", tally.changed, "")
    record_figure(f"{what}: of them unnoticed", tally.unnoticed, "0")
    record_figure(f"{what}: longest time at a wrong speed, ms", tally.wrong_ms, f"<= {CHANGE_LIMIT_MS}")
    record_figure(f"{what}: old speeds resumed over {tally.gaps} gaps", tally.resumed, "<= 1 %")
    _expect_every_error_noticed(tally)
