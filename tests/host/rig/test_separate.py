"""The emulated robot in its own process: whose time the daemon's clock keeps to."""

from __future__ import annotations

import time

from tiger.emulation.serve import MOST_BEHIND_S
from tiger.rig.separate import RobotClock, _Shared


def test_the_clock_waits_for_a_robot_that_stalls_and_not_for_one_that_died() -> None:
    shared = _Shared()
    shared.began_s.value = began_s = time.monotonic() - 10.0
    shared.truth[0] = 2.0
    assert RobotClock(shared, lambda: True).now_s() == began_s + 2.0 + MOST_BEHIND_S
    assert RobotClock(shared, lambda: False).now_s() >= began_s + 10.0
