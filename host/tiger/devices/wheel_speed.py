"""mega_speed: from its messages to samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.record import WheelSample

if TYPE_CHECKING:
    from tiger.protocol.messages import WheelSpeed


def wheel_sample(message: WheelSpeed, t_s: float) -> WheelSample:
    """The sample in a `wheel_speed` taken at host time `t_s`."""
    return WheelSample(t_s, message.edge_counts, message.speed_radps, message.flags)
