"""The firmware's boards on virtual pins, as Python objects.

Time only passes in `Board.run`. Bytes travel at the baud rate of their line, outputs hold until the program
changes them. Boards share nothing: wire them by moving what `uart_read` gives into another's `uart_write`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tiger.native._core import ffi, lib
from tiger.protocol.messages import BoardKind

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self

HOST_PORT = 0
"""The line to the host (on the Nano: to the Mega)."""

PEER_PORT = 1
"""The line from mega_suspension to the Nano."""

POWER_ON, EXTERNAL, BROWN_OUT, WATCHDOG = 1, 2, 4, 8
"""Causes of a reset, as in MCUSR."""

_READ_AT_ONCE = 4096


class Board:
    """A board of one kind; the classes below add its pins.

    Args:
        instance: its strap: which of two boards of a kind.
        uid: its identity, as written into its EEPROM.
    """

    KIND: BoardKind

    def __init__(self, instance: int = 0, uid: int = 1) -> None:
        board = lib.tiger_board_new(int(self.KIND), instance, uid)
        if board == ffi.NULL:
            raise ValueError(f"{self.KIND.name} is not built into tiger.native._core: run `make setup`")
        self._board: Any = ffi.gc(board, lib.tiger_board_free)
        self._buffer = ffi.new("uint8_t[]", _READ_AT_ONCE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the board now instead of when it is collected; it must not be used afterwards."""
        ffi.release(self._board)

    def run(self, us: int) -> None:
        """Let `us` microseconds pass."""
        lib.tiger_board_run(self._board, us)

    def set_turn(self, us: int) -> None:
        """Let every turn of the program's main loop take `us` microseconds; 250 unless told."""
        lib.tiger_board_turn(self._board, us)

    def reset(self, cause: int = POWER_ON) -> None:
        """Reset the chip: RAM and outputs are lost, EEPROM is kept."""
        lib.tiger_board_reset(self._board, cause)

    def hang(self, interrupts_off: bool = False) -> None:
        """Stop the program where it is, until the watchdog resets the board."""
        lib.tiger_board_hang(self._board, interrupts_off)

    @property
    def handle(self) -> Any:
        """The `tiger_board *` itself, for compiled code that works on several boards."""
        return self._board

    def uart_write(self, data: bytes, port: int = HOST_PORT, delay_us: int = 0) -> None:
        """Send bytes to the board; they arrive one after the other at the baud rate, after `delay_us`."""
        lib.tiger_uart_write(self._board, port, data, len(data), delay_us)

    def uart_read(self, port: int = HOST_PORT) -> bytes:
        """The bytes that have left the board, stop bit included, since the last call."""
        n = lib.tiger_uart_read(self._board, port, self._buffer, _READ_AT_ONCE)
        if n == 0:
            return b""
        first = bytes(ffi.buffer(self._buffer, n))
        return first if n < _READ_AT_ONCE else first + self.uart_read(port)

    def set_clock_ppm(self, ppm: float) -> None:
        """Let the board's resonator run fast by `ppm` parts in a million."""
        lib.tiger_clock_ppm(self._board, ppm)

    def set_clock_start(self, us: int) -> None:
        """What the board's clock reads after its next reset: 2**32 - 1 is a microsecond before it wraps."""
        lib.tiger_clock_start(self._board, us)

    @property
    def clock_us(self) -> int:
        """The board's own clock, 0 to 2**32 - 1."""
        return int(lib.tiger_clock_micros(self._board))

    @property
    def eeprom(self) -> memoryview:
        """The EEPROM itself, writable."""
        size = lib.tiger_eeprom_size(self._board)
        return memoryview(ffi.buffer(lib.tiger_eeprom(self._board), size))


class SuspensionBoard(Board):
    """mega_suspension; corners FL FR RL RR."""

    KIND = BoardKind.MEGA_SUSPENSION

    def __init__(self, instance: int = 0, uid: int = 1) -> None:
        super().__init__(instance, uid)
        self._duty = ffi.new("double[4]")

    def set_inputs(
        self, adc_counts: Sequence[float], lower: int = 0, upper: int = 0, estop: bool = False
    ) -> None:
        """Set what the pins show.

        Args:
            adc_counts: 4 potentiometers, 0 to 1023 with fractions, as they will be at the end of the next
                run (in between they move in a straight line).
            lower, upper: bit n: the limit switch of corner n is pressed.
            estop: the emergency stop is pressed.
        """
        lib.tiger_suspension_set(self._board, adc_counts, lower, upper, estop)

    def set_noise(self, rms_counts: float) -> None:
        """Root mean square of the noise of one ADC conversion; 0.5 counts unless told."""
        lib.tiger_suspension_noise(self._board, rms_counts)

    def drive(self) -> tuple[float, float, float, float]:
        """Signed duties, -1 to 1, positive raises the body; 0 when the outputs are off."""
        duty = self._duty
        lib.tiger_suspension_drive(self._board, duty)
        return duty[0], duty[1], duty[2], duty[3]


class ImuBoard(Board):
    """nano_imu on its model of the BNO055; vectors in the chip's own axes."""

    KIND = BoardKind.NANO_IMU

    def set_inputs(
        self,
        accel_mps2: Sequence[float],
        gyro_radps: Sequence[float],
        mag_ut: Sequence[float],
        temperature_celsius: float = 25.0,
    ) -> None:
        """Set what the sensor feels, until the next call; at rest the accelerometer shows +g upwards."""
        lib.tiger_imu_set(self._board, accel_mps2, gyro_radps, mag_ut, temperature_celsius)

    def set_faults(self, faults: int) -> None:
        """Switch faults of the chip on and off: bits as in `native_imu_api.h`."""
        lib.tiger_imu_fault(self._board, faults)

    @property
    def faults(self) -> int:
        """Faults that are on; a hung bus that was freed is no longer among them."""
        return int(lib.tiger_imu_faults(self._board))

    def power_cycle_sensor(self) -> None:
        """Let the sensor alone lose its supply for a moment."""
        lib.tiger_imu_power_cycle(self._board)

    def set_dither(self, counts_rms: float) -> None:
        """Noise of the output registers in counts; 1 unless told."""
        lib.tiger_imu_dither(self._board, counts_rms)

    def set_stretch(self, probability: float, longest_us: int) -> None:
        """How often the chip stretches the clock of a transaction, and how long at most."""
        lib.tiger_imu_stretch(self._board, probability, longest_us)


class SpeedBoard(Board):
    """mega_speed; channel 0 is the front wheel of its side, 1 the rear one; instance 0 left, 1 right."""

    KIND = BoardKind.MEGA_SPEED

    def set_wheel(self, channel: int, tooth_phase: float) -> None:
        """Turn of the gear in teeth, as it will be at the end of the next run; edges come at their times."""
        lib.tiger_wheel_set(self._board, channel, tooth_phase)

    def set_faults(self, channel: int, faults: int) -> None:
        """Faults of a sensor that are on: 1 signal A dead, 2 signal B dead, 4 A and B swapped."""
        lib.tiger_wheel_fault(self._board, channel, faults)

    def interrupt(self, channel: int, pins: int) -> None:
        """Raise the edge interrupt now, with A in bit 0 and B in bit 1 of `pins`."""
        lib.tiger_wheel_interrupt(self._board, channel, pins)
