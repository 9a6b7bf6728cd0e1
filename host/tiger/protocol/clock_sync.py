"""The clock of a board as seen from the host: offset and drift from PING and PONG, with their uncertainty.

A pure estimator: times come in, times go out. Each exchange gives one reading of (board clock - host clock),
good to half the round trip that cannot be explained. Exchanges much slower than the best are not used; the
rest feed a regression on offset and drift that forgets (a two-state Kalman filter whose drift wanders), which
rejects what is five standard deviations off and never lets a later sample of the board map to an earlier host
time.
"""

from __future__ import annotations

import math

from tiger.frozen import dataclass

WRAP_US = 1 << 32  # board clocks are u32 microseconds


@dataclass(frozen=True, slots=True)
class ClockConfig:
    """How clocks and links behave."""

    drift_max: float = 5000e-6  # ceramic resonators stay within
    drift_sigma: float = 2000e-6  # before the first exchange
    drift_walk_per_root_s: float = 1e-6  # temperature
    reading_sigma_s: float = 20e-6  # of an exchange without any delay
    reject_sigmas: float = 5.0
    reset_after_rejects: int = 5  # in a row: the board's clock is another one now
    ready_after: int = 4  # exchanges


class ClockSync:
    """Maps times of one board to host times."""

    def __init__(self, config: ClockConfig | None = None) -> None:
        self.config = config or ClockConfig()
        self.reset()

    def reset(self) -> None:
        """Forget everything: the board was reset."""
        self.accepted = 0
        self.gated = 0  # exchanges too slow to use
        self.rejected = 0  # exchanges that contradict the estimate
        self.best_round_trip_s = math.inf
        self._rejects_in_a_row = 0
        self._offset_s = 0.0  # board - host at _at_s
        self._drift = 0.0
        self._at_s = 0.0
        self._p = (math.inf, 0.0, self.config.drift_sigma**2)  # covariance: offset, cross, drift
        self._anchor_us = 0  # extended board time of the newest reading, to extend the u32
        self._last_mapped = (-1, -math.inf)  # extended board time and host time of the latest mapping

    @property
    def ready(self) -> bool:
        """Whether `to_host` may be trusted."""
        return self.accepted >= self.config.ready_after

    @property
    def drift_ppm(self) -> float:
        """How much faster the board's clock runs, in parts per million."""
        return self._drift * 1e6

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the offset at the newest reading."""
        return math.sqrt(self._p[0])

    def sigma_at(self, host_s: float) -> float:
        """Standard deviation of the offset at a host time."""
        return math.sqrt(self._predicted(host_s)[1][0])

    def add(
        self,
        sent_s: float,
        received_s: float,
        board_rx_us: int,
        board_tx_us: int,
        wire_up_s: float = 0.0,
        wire_down_s: float = 0.0,
    ) -> bool:
        """Take one exchange; returns whether it was used.

        `sent_s` and `received_s` are host times of the PING's first and the PONG's last byte; `wire_up_s` and
        `wire_down_s` are how long the two frames take on the wire, which differs because their lengths do.
        """
        rx_us = self._extended(board_rx_us)
        tx_us = rx_us + ((board_tx_us - board_rx_us) % WRAP_US)
        there_s, back_s = sent_s + wire_up_s, received_s - wire_down_s
        round_trip_s = max((back_s - there_s) - (tx_us - rx_us) * 1e-6, 0.0)
        if not self._fast_enough(round_trip_s):
            self.gated += 1
            return False
        host_s = (there_s + back_s) / 2
        board_s = (rx_us + tx_us) / 2 * 1e-6
        # Nobody knows how the delay is shared between there and back: uniform within half of it either way.
        sigma_s = math.hypot(self.config.reading_sigma_s, round_trip_s / math.sqrt(12.0))
        used = self._update(host_s, board_s - host_s, sigma_s)
        if used:
            self._anchor_us = rx_us
        return used

    def to_host(self, board_us: int) -> float:
        """Host time in seconds of a board time; never earlier than that of an earlier board time."""
        extended = self._extended(board_us)
        board_s = extended * 1e-6
        # board = host + offset + drift * (host - at)
        host_s = self._at_s + (board_s - self._offset_s - self._at_s) / (1.0 + self._drift)
        if extended >= self._last_mapped[0]:
            host_s = max(host_s, self._last_mapped[1])
            self._last_mapped = (extended, host_s)
        return host_s

    def _extended(self, board_us: int) -> int:
        """The u32 board time as a count that does not wrap: the one nearest to the newest reading."""
        ahead = (board_us - self._anchor_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2
        return self._anchor_us + ahead

    def _fast_enough(self, round_trip_s: float) -> bool:
        """Gate on the shortest round trip, which ages so that a link that became slower is used again."""
        if round_trip_s <= 1.5 * self.best_round_trip_s + 200e-6:
            self.best_round_trip_s = min(self.best_round_trip_s * 1.01, round_trip_s)
            return True
        self.best_round_trip_s = self.best_round_trip_s * 1.1 + 20e-6
        return False

    def _predicted(self, host_s: float) -> tuple[float, tuple[float, float, float]]:
        """Offset and covariance at `host_s`."""
        if not self.accepted:
            return self._offset_s, self._p
        dt = host_s - self._at_s
        p00, p01, p11 = self._p
        walk = self.config.drift_walk_per_root_s**2 * abs(dt)
        p = (p00 + dt * (2 * p01 + dt * p11) + walk * dt * dt / 3, p01 + dt * p11, p11 + walk)
        return self._offset_s + self._drift * dt, p

    def _update(self, host_s: float, reading_s: float, sigma_s: float) -> bool:
        variance = sigma_s**2
        if not self.accepted:
            self._offset_s, self._at_s = reading_s, host_s
            self._p = (variance, 0.0, self.config.drift_sigma**2)
            self.accepted = 1
            return True
        offset_s, (p00, p01, p11) = self._predicted(host_s)
        innovation_s = reading_s - offset_s
        if innovation_s**2 > self.config.reject_sigmas**2 * (p00 + variance):
            self._reject()
            return False
        gain_offset, gain_drift = p00 / (p00 + variance), p01 / (p00 + variance)
        limit = self.config.drift_max
        self._offset_s = offset_s + gain_offset * innovation_s
        self._drift = min(max(self._drift + gain_drift * innovation_s, -limit), limit)
        self._p = ((1 - gain_offset) * p00, (1 - gain_offset) * p01, p11 - gain_drift * p01)
        self._at_s = host_s
        self.accepted += 1
        self._rejects_in_a_row = 0
        return True

    def _reject(self) -> None:
        self.rejected += 1
        self._rejects_in_a_row += 1
        if self._rejects_in_a_row >= self.config.reset_after_rejects:
            rejected, gated = self.rejected, self.gated
            self.reset()
            self.rejected, self.gated = rejected, gated
