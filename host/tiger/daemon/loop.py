"""The daemon in real time: one thread that waits for bytes until the next tick is due.

This is the only place that waits. Ticks keep to a grid of the control period; how late each one began goes
into a histogram. A tick that is missed altogether is left out, not made up for.
"""

from __future__ import annotations

import ctypes
import gc
import os
import selectors
from collections.abc import Callable
from typing import TYPE_CHECKING

from tiger.daemon.clock import Lateness

if TYPE_CHECKING:
    from tiger.config.robot import LoopConfig
    from tiger.daemon.clock import Clock
    from tiger.daemon.daemon import Daemon
    from tiger.record import Record

MCL_CURRENT, MCL_FUTURE = 1, 2

Keep = Callable[["Record"], bool]


def run(daemon: Daemon, clock: Clock, on_record: Keep, duration_s: float | None = None) -> Lateness:
    """Run until `on_record` returns False or the duration is over; returns how late the ticks were.

    `on_record` is called after each tick, in this thread: it must be quick.
    """
    period_s = daemon.robot.loop.period_s
    lateness = Lateness()
    watcher = _Watcher()
    start_s = due_s = clock.now_s()
    late_s = 0.0
    while True:
        record = daemon.tick(clock.now_s(), late_s)
        if not on_record(record):
            return lateness
        due_s += period_s
        if duration_s is not None and due_s - start_s > duration_s:
            return lateness
        watcher.watch(daemon.descriptors())
        while (wait_s := due_s - clock.now_s()) > 0.0:
            if watcher.wait(wait_s):
                daemon.receive(clock.now_s())
                daemon.send_drives()
        late_s = clock.now_s() - due_s
        lateness.add(late_s)
        due_s += period_s * int(late_s / period_s)


class _Watcher:
    """Waits on a set of descriptors that seldom changes.

    `select` and not `epoll`: its time-out is in microseconds, that of `epoll` in milliseconds.
    """

    def __init__(self) -> None:
        self._selector = selectors.SelectSelector()
        self._watched: list[int] = []

    def watch(self, descriptors: list[int]) -> None:
        """Wait on these from now on."""
        if descriptors == self._watched:
            return
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
        for descriptor in descriptors:
            self._selector.register(descriptor, selectors.EVENT_READ)
        self._watched = list(descriptors)

    def wait(self, seconds: float) -> bool:
        """Wait for bytes; returns whether there are any."""
        try:
            return bool(self._selector.select(seconds))
        except OSError:  # one was closed under us; the next tick notices
            self.watch([])
            return True


def prepare(config: LoopConfig) -> list[str]:
    """Ask the operating system for punctuality; returns what it refused, in words."""
    refused: list[str] = []
    if config.cpu >= 0:
        try:
            os.sched_setaffinity(0, {config.cpu})
        except OSError as error:
            refused.append(f"loop.cpu = {config.cpu}: {error.strerror}")
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
    return refused
