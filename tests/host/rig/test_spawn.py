"""A process beside the daemon is not ended by Ctrl-C, which a terminal sends to everything in it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

from tiger.rig.spawn import start_undisturbed


def test_sigint_does_not_reach_the_child_and_the_parent_still_takes_it() -> None:
    process = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(0.3,))
    start_undisturbed(process)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGINT)  # while Python is still being loaded, where it would be a traceback
    process.join(20.0)
    assert process.exitcode == 0
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
