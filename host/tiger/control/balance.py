"""Mode `balance`: which twist of the four strokes lets all four wheels carry their share (Figure 4.15).

The fourth motion of the strokes, warp, which levelling keeps at zero, follows the twist of the ground; roll,
pitch and ride are levelled as far as that leaves them. `estimation.contact` says what is known of the ground,
a table of four phases what to do with it:

    probe   nothing has been tried yet: a small twist shows whether a wheel hangs
    search  a wheel hangs: twist it down, as far as it takes
    centre  all wheels touch: go to the twist that loads both diagonals alike
    hold    there: rest until what is known of the ground has changed by enough
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

from tiger.frozen import dataclass, replace

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.robot import BalanceConfig
    from tiger.estimation.contact import Contact


_TRIED = 1.8
"""Of the probe's amplitude: both sides have been seen."""


class Phase(IntEnum):
    """What the mode is doing."""

    PROBE = 0
    SEARCH = 1
    CENTRE = 2
    HOLD = 3


FEELING = (Phase.PROBE, Phase.SEARCH)
"""What the attitude answers is looked at, and nothing but the twist should move it."""


@dataclass(frozen=True, slots=True)
class BalanceState:
    """What a tick leaves to the next. Twists are those of the strokes, mm of lift at each corner."""

    phase: int = Phase.PROBE
    wanted_mm: float = 0.0
    """The twist to go to."""
    lowest_mm: float = 1e9
    highest_mm: float = -1e9
    """Twists been through while probing."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What the phases look at."""

    contact: Contact
    warp_mm: float
    """Twist of the strokes now."""
    most_mm: float
    """The most twist that the strokes have, to either side."""

    @property
    def level_mm(self) -> float:
        """The twist that would load both diagonals alike, as far as it is known and within reach."""
        return self.clip(-self.contact.ground_warp_mm)

    def clip(self, warp_mm: float) -> float:
        """Return the nearest twist within reach."""
        return min(max(warp_mm, -self.most_mm), self.most_mm)


def step(config: BalanceConfig, state: BalanceState, now: Situation) -> BalanceState:
    """Advance by one tick: at most one change of phase, then the twist that this phase wants."""
    row = _PHASES[Phase(state.phase)]
    state = replace(
        state,
        lowest_mm=min(state.lowest_mm, now.warp_mm),
        highest_mm=max(state.highest_mm, now.warp_mm),
    )
    phase = row.next(config, state, now)
    wanted_mm = now.clip(_PHASES[phase].wanted_mm(config, state, now))
    return replace(state, phase=int(phase), wanted_mm=wanted_mm)


def reason(state: BalanceState, contact: Contact) -> str:
    """Say in a few words what the mode is doing."""
    text = _PHASES[Phase(state.phase)].text
    wheels = zip(("FL", "FR", "RL", "RR"), contact.hanging, strict=True)
    hanging = [name for name, share in wheels if share > 0.5]
    return f"{text}, {' and '.join(hanging)} in the air" if hanging else text


# ---- phases -----------------------------------------------------


def _after_probe(config: BalanceConfig, state: BalanceState, now: Situation) -> Phase:
    if abs(now.contact.lifted) > config.sure:
        return Phase.SEARCH
    tried_mm = state.highest_mm - state.lowest_mm
    return Phase.CENTRE if tried_mm >= _TRIED * config.probe_mm else Phase.PROBE


def _after_search(config: BalanceConfig, state: BalanceState, now: Situation) -> Phase:
    return Phase.SEARCH if abs(now.contact.lifted) > 1.0 - config.sure else Phase.CENTRE


def _after_centre(config: BalanceConfig, state: BalanceState, now: Situation) -> Phase:
    if abs(now.contact.lifted) > config.sure:
        return Phase.SEARCH
    return Phase.HOLD if abs(now.level_mm - now.warp_mm) < config.settle_mm else Phase.CENTRE


def _after_hold(config: BalanceConfig, state: BalanceState, now: Situation) -> Phase:
    if abs(now.contact.lifted) > config.sure:
        return Phase.SEARCH
    return Phase.CENTRE if abs(now.level_mm - state.wanted_mm) > config.wake_mm else Phase.HOLD


def _probing_mm(config: BalanceConfig, state: BalanceState, now: Situation) -> float:
    """From far off, the way that has to be gone anyway; from near by, up and then down."""
    level, probe = now.level_mm, config.probe_mm
    if abs(now.warp_mm - level) > probe:
        return level
    return level - probe if state.highest_mm >= level + 0.9 * probe else level + probe


def _searching_mm(config: BalanceConfig, state: BalanceState, now: Situation) -> float:
    return math.copysign(now.most_mm, now.contact.lifted)


def _centring_mm(config: BalanceConfig, state: BalanceState, now: Situation) -> float:
    return now.level_mm


def _holding_mm(config: BalanceConfig, state: BalanceState, now: Situation) -> float:
    return state.wanted_mm


@dataclass(frozen=True, slots=True)
class _Row:
    """What a phase wants, when it ends, and how it is told."""

    wanted_mm: Callable[[BalanceConfig, BalanceState, Situation], float]
    next: Callable[[BalanceConfig, BalanceState, Situation], Phase]
    text: str


_PHASES = {
    Phase.PROBE: _Row(_probing_mm, _after_probe, "probing for contact"),
    Phase.SEARCH: _Row(_searching_mm, _after_search, "lowering a wheel"),
    Phase.CENTRE: _Row(_centring_mm, _after_centre, "sharing the load"),
    Phase.HOLD: _Row(_holding_mm, _after_hold, "balanced"),
}
