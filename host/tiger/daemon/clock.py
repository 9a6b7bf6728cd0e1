"""The time that the daemon lives by, and how punctual it is."""

from __future__ import annotations

import time
from typing import Protocol

BUCKET_US = 10
BUCKETS = 2000  # to 20 ms; the rest is one bucket


class Clock(Protocol):
    """A monotonic clock."""

    def now_s(self) -> float:
        """Seconds since some moment in the past."""


class MonotonicClock:
    """The computer's monotonic clock."""

    def now_s(self) -> float:
        """Seconds since some moment in the past."""
        return time.monotonic()


class VirtualClock:
    """A clock that someone else moves."""

    def __init__(self, now_s: float = 0.0) -> None:
        self._now_s = now_s

    def now_s(self) -> float:
        """Seconds since the start."""
        return self._now_s

    def set(self, now_s: float) -> None:
        """Move the clock."""
        self._now_s = now_s


class Lateness:
    """Histogram of how late ticks began, in constant memory."""

    def __init__(self) -> None:
        self.ticks = 0
        self.max_us = 0.0
        self._buckets = [0] * (BUCKETS + 1)

    def add(self, lateness_s: float) -> None:
        """Count one tick."""
        late_us = max(lateness_s * 1e6, 0.0)
        self.ticks += 1
        self.max_us = max(self.max_us, late_us)
        self._buckets[min(int(late_us / BUCKET_US), BUCKETS)] += 1

    def percentile_us(self, percent: float) -> float:
        """Lateness that so many percent of the ticks did not exceed, to a bucket's width."""
        wanted = self.ticks * percent / 100.0
        seen = 0
        for bucket, count in enumerate(self._buckets):
            seen += count
            if seen >= wanted:
                return min((bucket + 1.0) * BUCKET_US, self.max_us) if bucket < BUCKETS else self.max_us
        return self.max_us

    def summary(self) -> dict[str, float]:
        """Ticks, and median, 99th percentile and largest lateness in microseconds."""
        return {
            "ticks": self.ticks,
            "p50_us": round(self.percentile_us(50.0), 1),
            "p99_us": round(self.percentile_us(99.0), 1),
            "max_us": round(self.max_us, 1),
        }
