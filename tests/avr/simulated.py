# SPDX-License-Identifier: GPL-3.0-or-later
"""The real images in simavr, and a host that talks to them in frames."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import build_simavr

from tiger.protocol import messages as wire
from tiger.protocol.frame import FrameDecoder, encode_message

HZ = 16_000_000
CYCLES_PER_MS = HZ // 1000
WORLD_STEP_MS = 1.0
QUANTUM_CYCLES = 200  # below the 640 cycles a byte takes on the Nano's wire
MOST_TURNS = 1_000_000
IMAGES = build_simavr.ROOT / "build" / "firmware"
MCU = {"mega_suspension": "atmega2560", "nano_imu": "atmega328p", "mega_speed": "atmega2560"}
KIND = {name: wire.BoardKind[name.upper()] for name in MCU}
Answer = TypeVar("Answer", bound=wire.Message)
_simavr = build_simavr.load()
_ffi, _lib = _simavr.ffi, _simavr.lib


class Isr(NamedTuple):
    """How often an interrupt ran, its cycles with entry and return, and how long it had to wait."""

    count: int
    mean_cycles: float
    max_cycles: int
    max_wait_cycles: int
    wait_pc: int


class Pin(NamedTuple):
    """What a watched pin did since the watch began."""

    rises: int
    falls: int
    high_cycles: int
    last_change: int
    level: int


class Turns(NamedTuple):
    """Turns of the main loop, in cycles; the median one is idle."""

    count: int
    idle_cycles: int
    max_cycles: int
    total_cycles: int

    @property
    def load(self) -> float:
        """Share of the time that is more than idle turns."""
        return 1.0 - self.count * self.idle_cycles / self.total_cycles


class Board:
    """One AVR with its image, powered on at cycle 0."""

    def __init__(self, name: str, image: Path | None = None) -> None:
        self.name = name
        path = image or IMAGES / f"{name}.elf"
        self._board = _lib.avr_board_new(MCU[name].encode(), str(path).encode())
        if self._board == _ffi.NULL:
            raise FileNotFoundError(f"{path}: build it with `make firmware`")
        self._bytes = _ffi.new("uint8_t[]", 65536)
        self._stamps = _ffi.new("uint64_t[]", 65536)
        self._turns = _ffi.new("uint32_t[]", MOST_TURNS)

    def close(self) -> None:
        """Free the simulated chip."""
        _lib.avr_board_free(self._board)

    @property
    def cycle(self) -> int:
        """CPU cycles since power-on."""
        return int(_lib.avr_board_cycle(self._board))

    @property
    def resets(self) -> int:
        """Resets since power-on."""
        return int(_lib.avr_board_resets(self._board))

    @property
    def last_reset(self) -> int:
        """Cycle of the last reset."""
        return int(_lib.avr_board_last_reset(self._board))

    def run_ms(self, ms: float) -> None:
        """Let time pass."""
        run([self], ms)

    def reset(self, *, power_on: bool = False) -> None:
        """Press the reset button, or switch off and on."""
        _lib.avr_board_reset(self._board, power_on)

    def hang(self, *, interrupts_off: bool = False) -> None:
        """Let the program stop in a loop of one instruction until the next reset."""
        _lib.avr_board_hang(self._board, interrupts_off)

    def send(self, data: bytes, port: int = 0, at: int = 0) -> None:
        """Bytes on the receive line, one after the other, not before cycle `at`."""
        _lib.avr_uart_send(self._board, port, data, len(data), at)

    def receive(self, port: int = 0) -> bytes:
        """Bytes the program has sent since the last call."""
        n = _lib.avr_uart_receive(self._board, port, self._bytes, self._stamps, 65536)
        return bytes(_ffi.buffer(self._bytes, n))

    def overruns(self, port: int = 0) -> int:
        """Received bytes lost because the program did not fetch them in time."""
        return int(_lib.avr_uart_overruns(self._board, port))

    def connect(self, port: int, other: Board, other_port: int) -> None:
        """Cross two UARTs."""
        _lib.avr_uart_connect(self._board, port, other._board, other_port)

    def adc(self, channel: int, code: int) -> None:
        """What the ADC reads on a channel, 0 to 1023."""
        _lib.avr_adc_code(self._board, channel, code)

    def pin(self, name: str, level: int, at: int | None = None) -> None:
        """Drive an input such as "E4", now or at a cycle (in order of time)."""
        if at is None:
            _lib.avr_pin_set(self._board, name[0].encode(), int(name[1]), level)
        else:
            _lib.avr_pin_at(self._board, at, name[0].encode(), int(name[1]), level)

    def watch(self, name: str) -> int:
        """Begin to watch a pin such as "B5"; `watched` reads it."""
        return int(_lib.avr_pin_watch(self._board, name[0].encode(), int(name[1])))

    def watched(self, watch: int) -> Pin:
        """What a watched pin did."""
        pin = _lib.avr_pin_read(self._board, watch)
        return Pin(pin.rises, pin.falls, pin.high_cycles, pin.last_change, pin.level)

    def isr(self, vector: int) -> Isr:
        """Statistics of an interrupt since the last `clear_statistics`."""
        isr = _lib.avr_isr_read(self._board, vector)
        return Isr(
            isr.count, isr.total_cycles / max(isr.count, 1), isr.max_cycles, isr.max_wait_cycles, isr.wait_pc
        )

    def turns(self) -> Turns:
        """Statistics of the main loop since the last `clear_statistics`."""
        n = _lib.avr_turns_read(self._board, self._turns, MOST_TURNS)
        cycles = sorted(self._turns[0:n]) or [0]
        return Turns(n, cycles[len(cycles) // 2], cycles[-1], sum(cycles))

    def clear_statistics(self) -> None:
        """Begin counting afresh."""
        _lib.avr_isr_clear(self._board)
        _lib.avr_turns_clear(self._board)

    def eeprom(self, offset: int, n: int) -> bytes:
        """Bytes of the EEPROM."""
        _lib.avr_eeprom(self._board, 0, offset, self._bytes, n)
        return bytes(_ffi.buffer(self._bytes, n))

    def write_eeprom(self, offset: int, data: bytes) -> None:
        """Overwrite bytes of the EEPROM behind the program's back."""
        _lib.avr_eeprom(self._board, 1, offset, data, len(data))

    def peek(self, address: int) -> int:
        """A byte of the data space."""
        return int(_lib.avr_peek(self._board, address))

    def poke(self, address: int, value: int) -> None:
        """Change a byte of the data space."""
        _lib.avr_poke(self._board, address, value)

    def add_bno055(self, address: int = 0x28) -> None:
        """Put the sensor's model on the two-wire bus, at rest with z up."""
        _lib.avr_bno055_add(self._board, address)

    def set_motion(
        self, accel_mps2: Sequence[float], gyro_radps: Sequence[float], mag_ut: Sequence[float]
    ) -> None:
        """What the sensor feels, in its own axes."""
        _lib.avr_bno055_motion(self._board, list(accel_mps2), list(gyro_radps), list(mag_ut))

    def set_sensor_faults(self, faults: int) -> None:
        """Faults of the sensor that are on: bits as in firmware/native/native_imu_api.h."""
        _lib.avr_bno055_faults(self._board, faults)

    def set_stretch(self, probability: float, longest_us: int) -> None:
        """How often the sensor stretches the clock, and how long at most."""
        _lib.avr_bno055_stretch(self._board, probability, longest_us)

    def set_dither(self, counts_rms: float) -> None:
        """Noise of the sensor's registers in counts."""
        _lib.avr_bno055_dither(self._board, counts_rms)

    @property
    def bus_clocks(self) -> int:
        """Clock pulses the program has made by hand to free the two-wire bus."""
        return int(_lib.avr_twi_clocks(self._board))


def address_of(name: str, variable: str) -> int:
    """Data address of a variable in an image, by a part of its symbol."""
    listing = subprocess.run(
        ["avr-nm", str(IMAGES / f"{name}.elf")], check=True, capture_output=True, text=True
    ).stdout
    for line in listing.splitlines():
        address, _, symbol = line.partition(" ")
        if variable in symbol:
            return int(address, 16) & 0xFFFF
    raise KeyError(f"{name} has no variable {variable}")


def run(boards: Iterable[Board], ms: float) -> None:
    """Let time pass for boards that are wired together, in lock-step."""
    together = list(boards)
    pointers = _ffi.new("avr_board *[]", [board._board for board in together])
    until = min(board.cycle for board in together) + round(ms * CYCLES_PER_MS)
    state = _lib.avr_board_run(pointers, len(together), until, QUANTUM_CYCLES)
    if state != 0:
        raise RuntimeError(f"the simulated program crashed (simavr state {state})")


class Actuators:
    """Four actuators of 9.4 mm/s behind the motor pins of a mega_suspension, potentiometers on A0-A3."""

    FULL_SPEED_MMPS = 9.4
    LAG_MS = 50.0
    DUTY_OF_TOP = 799

    def __init__(self, board: Board, stroke_mm: float = 35.0) -> None:
        self.board = board
        self.stroke_mm = [stroke_mm] * 4
        self.rate_mmps = [0.0] * 4
        self._show()

    def duty(self, corner: int) -> float:
        """Signed duty at a motor, from the timer's registers: 0 while its pin is disconnected."""
        control, compare = ((0x80, 0x88), (0x80, 0x8A), (0x90, 0x98), (0x90, 0x9A))[corner]
        connected = self.board.peek(control) & (0x80, 0x20, 0x80, 0x20)[corner]
        if not connected:
            return 0.0
        duty = (self.board.peek(compare) | self.board.peek(compare + 1) << 8) / self.DUTY_OF_TOP
        return duty if self.board.peek(0x22) >> corner & 1 else -duty

    def step(self, ms: float) -> None:
        """Move on."""
        for corner in range(4):
            wanted = self.FULL_SPEED_MMPS * self.duty(corner)
            self.rate_mmps[corner] += (wanted - self.rate_mmps[corner]) * ms / self.LAG_MS
            self.stroke_mm[corner] += self.rate_mmps[corner] * ms / 1000
        self._show()

    def _show(self) -> None:
        for corner, stroke_mm in enumerate(self.stroke_mm):
            counts = (818 + (15550 - 818) * stroke_mm / 70.0) / 16.0  # default calibration
            self.board.adc(corner, round(counts))


@dataclass
class Host:
    """The host's end of one board's wire."""

    boards: list[Board]
    kinds: tuple[wire.BoardKind, ...]
    seq: int = 0
    log: list[wire.Message] = field(default_factory=list)
    world: Callable[[float], None] | None = None  # called with the milliseconds that passed

    def __post_init__(self) -> None:
        known: dict[int, type[wire.Message]] = {}
        for kind in self.kinds:
            known |= wire.FROM_BOARD[kind]
        self.decoder = FrameDecoder(known)

    @property
    def board(self) -> Board:
        """The board at the other end of the wire."""
        return self.boards[0]

    def say(self, message: wire.Message) -> int:
        """Queue a message; its sequence number."""
        seq = self.seq
        self.board.send(encode_message(message, seq))
        self.seq = (seq + 1) & 0xFF
        return seq

    def listen(self, ms: float) -> list[wire.Message]:
        """Let time pass and return what came meanwhile."""
        if self.world is None:
            run(self.boards, ms)
        else:
            for _ in range(round(ms / WORLD_STEP_MS)):
                run(self.boards, WORLD_STEP_MS)
                self.world(WORLD_STEP_MS)
        heard = [received.message for received in self.decoder.feed(self.board.receive())]
        self.log += heard
        return heard

    def ask(self, message: wire.Message, answer: type[Answer], ms: float = 30) -> Answer:
        """Say something and return the answer of that type from the node it was meant for."""
        node = wire.node_of(message)
        self.say(message)
        heard = [m for m in self.listen(ms) if isinstance(m, answer) and wire.node_of(m) == node]
        assert heard, f"{self.board.name} did not answer {message} with {answer.__name__} in {ms} ms"
        return heard[-1]

    def hello(self, node: int = 0) -> wire.HelloReply:
        """Ask a node who it is."""
        return self.ask(wire.Hello(wire.PROTO, node, 0, 0xBEEF), wire.HelloReply)

    def arm(self, node: int = 0) -> wire.Ack:
        """Arm a node with the hash and the session it gave."""
        who = self.hello(node)
        return self.ask(wire.Arm(node, who.schema_hash, who.session), wire.Ack)

    def health(self, node: int = 0) -> wire.Health:
        """Return a report made after now."""
        reports = [m for m in self.listen(210) if isinstance(m, wire.Health) and m.node == node]
        return reports[-1]

    def command(self, rates_mmps: Sequence[float], ms: int) -> list[wire.Message]:
        """Send suspension setpoints every 10 ms for a while."""
        heard: list[wire.Message] = []
        for _ in range(0, ms, 10):
            host_ms = (self.board.cycle // CYCLES_PER_MS) & 0xFFFF
            self.say(wire.SuspensionSetpoint(host_ms, 1, (*rates_mmps,)))
            heard += self.listen(10)
        return heard
