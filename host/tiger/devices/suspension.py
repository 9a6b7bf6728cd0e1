"""mega_suspension: from its messages to samples, from stroke rates to its setpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.protocol.messages import BoardState, SuspensionSetpoint
from tiger.record import StrokeSample

if TYPE_CHECKING:
    from tiger.protocol.messages import SuspensionState
    from tiger.record import Four

RATE_MAX_MMPS = 12.0  # limit of suspension_setpoint.rate_mmps; a test holds it against the spec
ENGAGED_STATES = frozenset({BoardState.ARMED, BoardState.HOLDING})


def stroke_sample(message: SuspensionState, t_s: float) -> StrokeSample:
    """The sample in a `suspension_state` taken at host time `t_s`."""
    return StrokeSample(t_s, message.stroke_mm, message.rate_mmps, message.duty_permille, message.flags)


def setpoint(rate_mmps: Four, engaged: bool, now_s: float) -> SuspensionSetpoint:
    """Stroke rates as the board wants them: within the spec's limits, marked with the time they were made."""
    a, b, c, d = [min(max(rate, -RATE_MAX_MMPS), RATE_MAX_MMPS) for rate in rate_mmps]
    return SuspensionSetpoint(int(now_s * 1000.0) & 0xFFFF, int(engaged), (a, b, c, d))
