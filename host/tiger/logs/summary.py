"""What a log is about, in figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tiger.daemon.clock import Lateness
from tiger.logs.cdr import CdrError
from tiger.logs.topics import FAULT, LOG_STATUS, TICK, FaultReport, LogStatus, Tick

if TYPE_CHECKING:
    from tiger.logs.reader import Log, Logged

NS_PER_S = 1e9


@dataclass
class Summary:
    """Figures of one log; times are seconds since its first message."""

    about: dict[str, str] = field(default_factory=dict)
    files: list[dict[str, Any]] = field(default_factory=list)
    start_ns: int = 0
    duration_s: float = 0.0
    parts_before: int = 0  # of the same run that are not here
    topics: dict[str, int] = field(default_factory=dict)
    ticks: int = 0
    missing_ticks: int = 0
    dropped_packets: int = 0
    changes: list[tuple[float, str, str]] = field(default_factory=list)  # time, state, reason
    faults: list[tuple[float, FaultReport]] = field(default_factory=list)
    lateness_us: dict[str, float] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """The same in plain types; of a fault's frames, how many."""
        return {
            "about": self.about,
            "files": self.files,
            "start_ns": self.start_ns,
            "duration_s": self.duration_s,
            "parts_before": self.parts_before,
            "topics": self.topics,
            "ticks": self.ticks,
            "missing_ticks": self.missing_ticks,
            "dropped_packets": self.dropped_packets,
            "changes": [{"time_s": t, "state": state, "reason": why} for t, state, why in self.changes],
            "faults": [
                {
                    "time_s": t,
                    "state": report.state.name,
                    "reason": report.reason,
                    "problems": [str(problem) for problem in report.problems],
                    "frames": dict(Counter(f.port + (" tx" if f.sent else " rx") for f in report.frames)),
                }
                for t, report in self.faults
            ],
            "lateness_us": self.lateness_us,
            "damage": self.damage,
        }


def summarise(log: Log) -> Summary:
    """Read a log through. Raises LogError."""
    summary = Summary()
    counts: Counter[str] = Counter()
    lateness = Lateness()
    state, next_tick, first_ns, last_ns = "", -1, 0, 0
    unreadable: Counter[str] = Counter()
    for logged in log.messages():
        counts[logged.topic] += 1
        first_ns, last_ns = first_ns or logged.t_ns, logged.t_ns
        time_s = (logged.t_ns - first_ns) / NS_PER_S
        value = _looked_into(logged, unreadable)
        if isinstance(value, Tick):
            lateness.add(value.lateness_s)
            summary.missing_ticks += max(value.tick - next_tick, 0) if next_tick >= 0 else 0
            next_tick = value.tick + 1
            now = f"{value.state.name}: {value.reason}"
            if now != state:
                summary.changes.append((time_s, value.state.name, value.reason))
                state = now
        elif isinstance(value, FaultReport):
            summary.faults.append((time_s, value))
        elif isinstance(value, LogStatus):
            summary.dropped_packets = max(summary.dropped_packets, value.dropped_packets)
    summary.about = log.about
    summary.parts_before = int(log.about.get("part", 0))
    summary.files = [
        {"name": file.path.name, "bytes": file.path.stat().st_size, "complete": file.complete}
        for file in log.files
    ]
    summary.start_ns = first_ns
    summary.duration_s = (last_ns - first_ns) / NS_PER_S
    summary.topics = dict(sorted(counts.items()))
    summary.ticks = counts[TICK]
    summary.lateness_us = lateness.summary() if lateness.ticks else {}
    summary.damage = log.damage + [f"{topic}: {n} messages cannot be read" for topic, n in unreadable.items()]
    return summary


def _looked_into(logged: Logged, unreadable: Counter[str]) -> Any:
    if logged.topic not in (TICK, FAULT, LOG_STATUS):
        return None
    try:
        return logged.value()
    except CdrError:
        unreadable[logged.topic] += 1
        return None
