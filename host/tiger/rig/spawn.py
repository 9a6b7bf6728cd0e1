"""Processes beside the daemon: whoever started them ends them, not Ctrl-C in the terminal."""

from __future__ import annotations

import signal
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess


def start_undisturbed(process: BaseProcess) -> None:
    """Start a process that never sees SIGINT: a terminal sends that to all of them at once.

    The signal is blocked, not ignored, while the process starts: a child inherits the mask from its first
    instruction on, and what arrives meanwhile reaches the parent right after.
    """
    resource_tracker.ensure_running()  # starting it would take the signal off the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
