# SPDX-License-Identifier: GPL-3.0-or-later
"""What the images cost while they work: stack, interrupts, main loop, against budgets (`make budget`)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import build_simavr
import simulated

from tiger.protocol import messages as wire

sys.path.insert(0, str(build_simavr.ROOT / "firmware"))
import budget  # sizes of the images

CYCLES_PER_SECOND = simulated.HZ
CYCLES_PER_TICK = simulated.HZ // 100
SECONDS = 1.0


class Row(NamedTuple):
    """One figure and the most (or least) it may be."""

    what: str
    value: float
    limit: float
    unit: str
    least: bool = False

    @property
    def ok(self) -> bool:
        """Whether the budget is kept."""
        return self.value >= self.limit if self.least else self.value <= self.limit

    def markdown(self) -> str:
        """Return the row of a table."""
        sign = ">=" if self.least else "<="
        shown = f"{self.value:.1f}" if self.unit == "%" else f"{self.value:.0f}"
        return (
            f"| {self.what} | {shown} {self.unit} | {sign} {self.limit:g} | {'' if self.ok else '**over**'} |"
        )


class Interrupt(NamedTuple):
    """An interrupt of an image and the cycles it may take, entry and return included."""

    name: str
    vector: int
    budget_cycles: int


MEGA_COMMON = (
    Interrupt("time base overflow", 50, 90),
    Interrupt("host UART receive", 25, 90),
    Interrupt("host UART send", 26, 90),
)
INTERRUPTS = {
    "mega_suspension": (
        *MEGA_COMMON,
        Interrupt("Nano UART receive", 36, 90),
        Interrupt("Nano UART send", 37, 90),
        Interrupt("ADC", 29, 200),
    ),
    "nano_imu": (
        Interrupt("time base overflow", 13, 90),
        Interrupt("Mega UART receive", 18, 90),
        Interrupt("Mega UART send", 19, 90),
        Interrupt("two-wire bus", 24, 130),
    ),
    "mega_speed": (
        *MEGA_COMMON,
        Interrupt("front wheel, signal A", 5, 130),
        Interrupt("front wheel, signal B", 6, 130),
        Interrupt("rear wheel, signal A", 4, 130),
        Interrupt("rear wheel, signal B", 3, 130),
    ),
}
# Least stack never touched, most CPU beyond an idle main loop, longest turn of it.
STACK_BYTES = {"mega_suspension": 2048, "nano_imu": 600, "mega_speed": 2048}
LOAD_PERCENT = {"mega_suspension": 60.0, "nano_imu": 60.0, "mega_speed": 60.0}
TURN_CYCLES = {"mega_suspension": 40_000, "nano_imu": 110_000, "mega_speed": 40_000}


def rest(board: simulated.Board) -> None:
    """Set the inputs of a board that stands still and is not stopped."""
    if board.name == "mega_suspension":
        for pin in ("A4", "A5", "A6", "A7", "C4", "C5", "C6", "C7", "E5"):
            board.pin(pin, 0)
    elif board.name == "mega_speed":
        for pin in ("E4", "E5", "D2", "D3"):
            board.pin(pin, 0)
    else:
        board.add_bno055()


def busy_suspension() -> tuple[simulated.Host, simulated.Board]:
    """Both suspension boards armed, four actuators moving, the Nano's frames passing through."""
    mega, nano = simulated.Board("mega_suspension"), simulated.Board("nano_imu")
    rest(mega)
    rest(nano)
    mega.connect(1, nano, 0)
    host = simulated.Host([mega, nano], (wire.BoardKind.MEGA_SUSPENSION, wire.BoardKind.NANO_IMU))
    host.world = simulated.Actuators(mega).step
    host.listen(3500)
    for node in (1, 0):
        status = host.arm(node).status
        assert status == wire.AckStatus.OK, f"node {node} does not arm: status {status}"
    host.command((0, 0, 0, 0), 100)
    for board in host.boards:
        board.clear_statistics()
    for i in range(round(SECONDS * 4)):
        host.say(wire.Ping(i & 1, 0))
        rate = 6.0 if i % 2 == 0 else -6.0
        host.command((rate, -rate, rate, -rate), 250)
    return host, nano


def busy_speed() -> simulated.Host:
    """Both wheels of a side at 800 rpm, then at the speeds where pitches are learned."""
    board = simulated.Board("mega_speed")
    rest(board)
    host = simulated.Host([board], (wire.BoardKind.MEGA_SPEED,))
    host.listen(50)
    assert host.arm().status == wire.AckStatus.OK
    board.clear_statistics()
    states = ((0, 0), (1, 0), (1, 1), (0, 1))
    pins = (("E4", "E5"), ("D3", "D2"))
    count = 0
    for rate_hz in (3200, 1200):
        begin, events = board.cycle + 1000, []
        for i in range(round(SECONDS / 2 * rate_hz)):
            before, count = count, count + 1
            for wheel in (0, 1):
                at = begin + int((i + 0.137 * wheel) * simulated.HZ / rate_hz)
                for signal in (0, 1):
                    if states[before & 3][signal] != states[count & 3][signal]:
                        events.append((at, pins[wheel][signal], states[count & 3][signal]))
        for at, pin, level in sorted(events):
            board.pin(pin, level, at)
        for _ in range(round(SECONDS / 2 * 20)):
            host.say(wire.Ping(0, 0))
            host.listen(50)
    return host


def rows_of(board: simulated.Board, host: simulated.Host, node: int) -> list[Row]:
    """Return the figures of one board after its busy second."""
    name = board.name
    turns = board.turns()
    interrupts = [(each, board.isr(each.vector)) for each in INTERRUPTS[name]]
    in_interrupts = sum(isr.count * isr.mean_cycles for _, isr in interrupts)
    health = host.health(node)
    size, limit = budget.size_of(simulated.IMAGES / f"{name}.elf"), budget.LIMITS[name]
    rows = [
        Row("flash", size.flash, limit.flash, "bytes"),
        Row("RAM, variables", size.static_ram, limit.static_ram, "bytes"),
        Row("stack never touched", health.ram_free_bytes, STACK_BYTES[name], "bytes", least=True),
        Row("CPU beyond idle turns", 100 * turns.load, LOAD_PERCENT[name], "%"),
        Row("CPU in interrupts", 100 * in_interrupts / turns.total_cycles, 25.0, "%"),
        Row("longest turn of the main loop", turns.max_cycles, TURN_CYCLES[name], "cycles"),
        Row("smallest watchdog margin", health.watchdog_margin_ms, 10, "ms", least=True),
        Row("missed deadlines", health.overruns, 0, ""),
    ]
    for each, isr in interrupts:
        rows.append(Row(f"interrupt: {each.name}", isr.max_cycles, each.budget_cycles, "cycles"))
        if each.name == "ADC":
            share = 100 * isr.count * isr.mean_cycles / turns.total_cycles
            rows.append(Row("interrupt: ADC, share of the CPU", share, 5.0, "%"))
    return rows


def measure() -> dict[str, list[Row]]:
    """Return the figures of every board."""
    pair, nano = busy_suspension()
    speed = busy_speed()
    return {
        "mega_suspension": rows_of(pair.board, pair, 0),
        "nano_imu": rows_of(nano, pair, 1),
        "mega_speed": rows_of(speed.board, speed, 0),
    }


def page(figures: dict[str, list[Row]]) -> str:
    """Return firmware/BUDGET.md."""
    lines = [
        "# Budget of the images",
        "",
        "Written by `make budget`: the images run in simavr at 16 MHz, one second at work after start-up",
        "(all armed, four actuators moving, wheels at 800 rpm and at the speeds where tooth pitches are",
        "learned, telemetry and pings on). Cycles of an interrupt include its entry and return; a turn of",
        "the main loop includes the interrupts that fall into it; the CPU beyond idle turns is what is left",
        "of the time when every turn costs the median one. A figure over its budget fails the command.",
    ]
    for name, rows in figures.items():
        lines += ["", f"## {name}", "", "| what | measured | budget | |", "|---|---|---|---|"]
        lines += [row.markdown() for row in rows]
    return "\n".join([*lines, ""])


def write_budget(path: Path, say: Callable[[str], None] = print) -> int:
    """Write the page; return how many budgets are exceeded."""
    figures = measure()
    path.write_text(page(figures), encoding="utf-8")
    over = [(name, row) for name, rows in figures.items() for row in rows if not row.ok]
    for name, row in over:
        relation = "below" if row.least else "above"
        say(f"budget: {name}: {row.what} is {row.value:.0f} {row.unit}, {relation} {row.limit:g}")
    say(f"{path}: {sum(map(len, figures.values()))} figures, {len(over)} over budget")
    return min(math.ceil(len(over)), 1)
