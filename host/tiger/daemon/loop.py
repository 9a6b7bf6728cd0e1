"""The daemon in real time: one thread that sleeps from tick to tick.

This is the only place that waits. Ticks keep to a grid of the control period; how late each one began goes
into a histogram. A tick that is missed altogether is left out, not made up for.

Ports are read at each tick and not in between: boards stamp their samples themselves, so that nothing would
be known sooner by it, and to read twice as often costs a fifth more, to wake at every byte twice as much.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from tiger.daemon.clock import Lateness

if TYPE_CHECKING:
    from tiger.config.robot import LoopConfig
    from tiger.daemon.clock import Clock
    from tiger.daemon.daemon import Daemon
    from tiger.record import Record

MCL_CURRENT, MCL_FUTURE = 1, 2
TIDY_S = 1.0
"""How often garbage is collected, right after a tick, where there is time for it."""

Keep = Callable[["Record"], bool]


def run(daemon: Daemon, clock: Clock, on_record: Keep, duration_s: float | None = None) -> Lateness:
    """Run until `on_record` returns False or the duration is over; returns how late the ticks were.

    `on_record` is called after each tick, in this thread: it must be quick.
    """
    period_s = daemon.robot.loop.period_s
    lateness = Lateness()
    start_s = due_s = clock.now_s()
    tidy_s = start_s + TIDY_S
    late_s = 0.0
    while True:
        record = daemon.tick(clock.now_s(), late_s)
        if not on_record(record):
            return lateness
        due_s += period_s
        if duration_s is not None and due_s - start_s > duration_s:
            return lateness
        if due_s >= tidy_s:
            tidy_s += TIDY_S
            gc.collect(1)  # only what is younger than a second
        _sleep_until(due_s, clock)
        late_s = clock.now_s() - due_s
        lateness.add(late_s)
        due_s += period_s * int(late_s / period_s)


def _sleep_until(moment_s: float, clock: Clock) -> None:
    while (wait_s := moment_s - clock.now_s()) > 0.0:
        time.sleep(wait_s)


def make_room(config: LoopConfig) -> None:
    """Leave the loop's core to the loop: processes started from now on keep to the others.

    A log that is compressed between two ticks takes the caches that the next tick needs. Call it before they
    are started, and `prepare` after.
    """
    others = os.sched_getaffinity(0) - {config.cpu}
    if config.cpu >= 0 and others:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, others)


def prepare(config: LoopConfig) -> list[str]:
    """Ask the operating system for punctuality; returns what it refused, in words."""
    refused: list[str] = []
    if config.cpu >= 0:
        try:
            os.sched_setaffinity(0, {config.cpu})
        except OSError as error:
            cores = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
            refused.append(f"loop.cpu = {config.cpu}: {error.strerror}; this program may use {cores}")
    if config.realtime_priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(config.realtime_priority))
        except OSError as error:
            refused.append(
                f"loop.realtime_priority = {config.realtime_priority}: {error.strerror}; allow it with "
                "`LimitRTPRIO=` in the service or a line `rtprio` in /etc/security/limits.conf"
            )
    if config.lock_memory and ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE):
        refused.append(f"loop.lock_memory: {os.strerror(ctypes.get_errno())}")
    gc.collect()
    gc.freeze()  # what was built so far is never looked at again
    gc.disable()  # from now on `run` says when
    return refused
