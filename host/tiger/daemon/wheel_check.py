"""Are the two Roboteqs on the right ports, and do their motors turn the right way?

At the first motion after each arming one side is turned slowly, then the other, and the wheel sensors say
which wheels moved and how. Only then do the wheels follow commands. A pure table of phases; `loop.py` feeds
it.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from tiger.daemon.limits import RPM_PER_RADPS
from tiger.frozen import dataclass
from tiger.record import STILL, Problem, ProblemKind

if TYPE_CHECKING:
    from tiger.record import Four, Inputs

PROBE_RPM = 15.0
MOVING_RPM = 5.0  # a wheel that turns faster was moved
AGREED_S = 0.05  # for so long before it counts
WRONG_S = 0.2  # what must not be counts after this: a body that rocks moves wheels too
STILL_S = 0.1  # between the two sides
PATIENCE_S = 1.5


class Phase(Enum):
    """What the check is doing."""

    IDLE = "idle"  # no motion was asked for since arming
    LEFT = "left side turns"
    PAUSE = "both sides stop"
    RIGHT = "right side turns"
    PASSED = "passed"
    FAILED = "failed"


_NEXT = {Phase.LEFT: Phase.PAUSE, Phase.PAUSE: Phase.RIGHT, Phase.RIGHT: Phase.PASSED}


@dataclass(frozen=True, slots=True)
class WheelCheck:
    """State of the check; `step` returns the next one."""

    phase: Phase = Phase.IDLE
    elapsed_s: float = 0.0  # in this phase
    agreed_s: float = 0.0  # the phase's goal has held for so long
    wrong_s: float = 0.0  # what must not be has been for so long
    problem: Problem | None = None

    @property
    def passed(self) -> bool:
        """Whether commands may reach the wheels."""
        return self.phase is Phase.PASSED

    @property
    def wheel_rpm(self) -> Four:
        """The wheel speeds that the check itself commands, FL FR RL RR."""
        if self.phase is Phase.LEFT:
            return (PROBE_RPM, 0.0, PROBE_RPM, 0.0)
        if self.phase is Phase.RIGHT:
            return (0.0, PROBE_RPM, 0.0, PROBE_RPM)
        return STILL


def step(check: WheelCheck, motion_wanted: bool, inputs: Inputs, dt: float) -> WheelCheck:
    """Advance by `dt` seconds with the newest wheel speeds."""
    if check.phase is Phase.IDLE:
        return WheelCheck(Phase.LEFT) if motion_wanted else check
    if check.phase in (Phase.PASSED, Phase.FAILED):
        return check
    speeds = _speeds_rpm(inputs)
    if speeds is None:
        return check
    elapsed_s = check.elapsed_s + dt
    problem = _wrong(check.phase, speeds)
    wrong_s = check.wrong_s + dt if problem is not None else 0.0
    if wrong_s > WRONG_S:
        return WheelCheck(Phase.FAILED, problem=problem)
    needed_s = STILL_S if check.phase is Phase.PAUSE else AGREED_S
    agreed_s = check.agreed_s + dt if _reached(check.phase, speeds) else 0.0
    if agreed_s >= needed_s:
        return WheelCheck(_NEXT[check.phase])
    if elapsed_s > PATIENCE_S:
        return WheelCheck(Phase.FAILED, problem=_nothing_turns(check.phase, speeds))
    return WheelCheck(check.phase, elapsed_s, agreed_s, wrong_s)


_Speeds = tuple[tuple[float, float], tuple[float, float]]


def _speeds_rpm(inputs: Inputs) -> _Speeds | None:
    """Front and rear wheel of the left side, then of the right one."""
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is None or right is None:
        return None
    a, b = left.speed_radps
    c, d = right.speed_radps
    return (a * RPM_PER_RADPS, b * RPM_PER_RADPS), (c * RPM_PER_RADPS, d * RPM_PER_RADPS)


def _reached(phase: Phase, speeds: _Speeds) -> bool:
    left, right = speeds
    if phase is Phase.PAUSE:
        return all(abs(rpm) < MOVING_RPM for rpm in (*left, *right))
    return all(rpm > MOVING_RPM for rpm in (left if phase is Phase.LEFT else right))


def _wrong(phase: Phase, speeds: _Speeds) -> Problem | None:
    """What the wheels do that they must not."""
    if phase not in (Phase.LEFT, Phase.RIGHT):
        return None
    driven, other = speeds if phase is Phase.LEFT else speeds[::-1]
    side, far = ("left", "right") if phase is Phase.LEFT else ("right", "left")
    if all(abs(rpm) > MOVING_RPM for rpm in other) and all(abs(rpm) < MOVING_RPM for rpm in driven):
        return Problem(
            ProblemKind.WIRING,
            "wheels",
            f"the {far} wheels turn when the {side} Roboteq drives: the two ports are swapped",
            "Exchange roboteq_left and roboteq_right under [ports] (or the straps of the mega_speed boards).",
        )
    for place, rpm in zip(("front", "rear"), driven, strict=True):
        if rpm < -MOVING_RPM:
            return Problem(
                ProblemKind.WIRING,
                f"{place} {side} wheel",
                f"turns backwards ({rpm:.0f} rpm) when driven forwards",
                "Reverse its motor's direction in the Roboteq, or swap the wires A and B of its sensor.",
            )
    return None


def _nothing_turns(phase: Phase, speeds: _Speeds) -> Problem:
    if phase is Phase.PAUSE:
        text, step_text = "do not stop", "Check the Roboteqs' configuration: they must brake at zero speed."
        return Problem(ProblemKind.WIRING, "wheels", text, step_text)
    side, driven = ("left", speeds[0]) if phase is Phase.LEFT else ("right", speeds[1])
    silent = [p for p, rpm in zip(("front", "rear"), driven, strict=True) if abs(rpm) < MOVING_RPM]
    names = " and ".join(silent) or "front and rear"
    return Problem(
        ProblemKind.WIRING,
        f"{names} {side} wheel",
        "shows no motion when driven",
        "Check the motor's supply and plug, and the gap and plug of the wheel's sensor.",
    )
