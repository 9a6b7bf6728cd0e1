"""A serial cable with two ends: bytes in order, and on demand the noise and the breaks of a real one.

A cable carries bytes between the daemon's end (a `Port`: non-blocking read and write) and the board's end.
Baud rate and buffers belong to the boards (firmware/native paces its UARTs); a cable is the copper between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class LineNoise:
    """Chance of each kind of damage per byte. Zero everywhere is a perfect line."""

    flip: float = 0.0  # one random bit of the byte changes
    drop: float = 0.0  # the byte is lost
    insert: float = 0.0  # a random byte comes before it
    duplicate: float = 0.0  # the byte comes twice

    @classmethod
    def everything(cls, rate: float) -> LineNoise:
        """Damage of every kind at the same `rate` per byte."""
        return cls(flip=rate, drop=rate, insert=rate, duplicate=rate)

    @property
    def clean(self) -> bool:
        """True when no byte is ever damaged."""
        return self.flip == self.drop == self.insert == self.duplicate == 0.0


class NoisyLine:
    """Damages the bytes that pass, reproducibly from a seed, and counts what it did."""

    def __init__(self, noise: LineNoise, seed: int) -> None:
        self.is_clean = noise.clean
        self._noise = noise
        self._random = np.random.default_rng(seed)
        self.damaged_bytes = 0

    def carry(self, data: bytes) -> bytes:
        """Return what comes out at the far end when `data` goes in."""
        if self.is_clean or not data:
            return data
        noise = self._noise
        draws = self._random.random((len(data), 4))
        hits = draws < (noise.flip, noise.drop, noise.insert, noise.duplicate)
        if not hits.any():
            return data
        out = bytearray()
        for byte, (flip, drop, insert, duplicate) in zip(data, hits.tolist(), strict=True):
            self.damaged_bytes += flip or drop or insert or duplicate
            if insert:
                out.append(int(self._random.integers(256)))
            if drop:
                continue
            value = byte ^ (1 << int(self._random.integers(8))) if flip else byte
            out.append(value)
            if duplicate:
                out.append(value)
        return bytes(out)


class Cable:
    """Two-way serial line: `host_…` methods are the daemon's end, `board_…` methods the emulated board's.

    `cut()` breaks the line: bytes on both sides vanish and the host's port reports an error until `mend()`.
    While `is_silent`, the port stays open but nothing comes through, as with a hung USB bridge.
    """

    def __init__(self, noise: LineNoise = LineNoise(), seed: int = 0) -> None:
        self._to_board = bytearray()
        self._to_host = bytearray()
        self._down = NoisyLine(noise, seed=2 * seed)
        self._up = NoisyLine(noise, seed=2 * seed + 1)
        self.is_cut = False
        self.is_silent = False

    @property
    def damaged_bytes(self) -> int:
        """Bytes damaged so far, both ways."""
        return self._down.damaged_bytes + self._up.damaged_bytes

    def cut(self) -> None:
        """Pull the plug."""
        self.is_cut = True
        self._to_board.clear()
        self._to_host.clear()

    def mend(self) -> None:
        """Put the plug back."""
        self.is_cut = False

    def host_write(self, data: bytes) -> None:
        """Send bytes from the daemon to the board."""
        if not (self.is_cut or self.is_silent):
            self._to_board += self._down.carry(data)

    def host_read(self) -> bytes:
        """Take all bytes that have reached the daemon's end."""
        data = bytes(self._to_host)
        self._to_host.clear()
        return data

    def board_write(self, data: bytes) -> None:
        """Send bytes from the board to the daemon."""
        if data and not (self.is_cut or self.is_silent):
            self._to_host += self._up.carry(data)

    def board_read(self) -> bytes:
        """Take all bytes that have reached the board's end."""
        data = bytes(self._to_board)
        self._to_board.clear()
        return data
