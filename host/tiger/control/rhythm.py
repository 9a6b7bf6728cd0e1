"""A learned oscillator: what a periodic ground will do next, and which part of it the actuators can follow.

Ground that rocks too fast for the actuators leaves the least residual when one starts to turn back before it
does: a causal follower cannot know. One axis of the ground is modelled as centre + amplitude sin(phase) by a
second-order generalised integrator with a frequency-locked loop (SOGI-FLL) and an offset state:

    x' = w (y + k e),  y' = -w x,  c' = k_c w e,  w' = g w^2 e y / (x^2 + y^2),   e = ground - c - x

It starts from two turning points, and is trusted after some periods that it predicted well.
"""

from __future__ import annotations

import math

from tiger.frozen import dataclass, replace

_GAIN = 0.8
_OFFSET_GAIN = 0.2
_FREQUENCY_GAIN = 0.08
_NO_POWER = 1e-6
_MOST_PULL = 0.02
"""Largest relative change of the frequency in one step."""
_MISS_SHARE_OF_PHASE = 0.3
"""Smoothing of the error: weight of a radian of phase."""
_TURNING_RADPS = math.radians(0.3)
"""Hysteresis of the ground's rate: turning points of less are noise."""
_STILL_S = 1.5
"""Ground that turns no more for so long has no rhythm worth knowing: it is slow enough to be followed."""
_LOWEST_RADPS, _HIGHEST_RADPS = 2.0 * math.pi * 0.02, 2.0 * math.pi * 2.0
_LEARNING_RAD = 3.0 * 2.0 * math.pi
_MISS_SHARE = 0.15
"""Largest RMS of the error, as a share of the amplitude, with which the oscillator is trusted."""


@dataclass(frozen=True, slots=True)
class Rhythm:
    """State of one axis; angles in rad. `x` and `y` are amplitude times sine and cosine of the phase."""

    x: float = 0.0
    y: float = 0.0
    centre: float = 0.0
    frequency_radps: float = 0.0
    learned_rad: float = 0.0
    """Phase gone through since the last start."""
    miss2: float = 0.0
    """Smoothed square of the error."""
    direction: int = 0
    """Which way the ground turns; 0: it stands."""
    half_period_s: float = -math.inf
    """Time since the last turning point."""
    turned_at_rad: float = 0.0
    """Where the last turning point was."""
    still_s: float = 0.0
    """How long the ground has hardly turned."""
    misfits: int = 0
    """Half periods in a row that did not fit the frequency."""

    @property
    def amplitude_rad(self) -> float:
        """Amplitude of the oscillation."""
        return math.hypot(self.x, self.y)

    @property
    def trusted(self) -> bool:
        """Whether it has predicted well for long enough to act on."""
        enough = self.learned_rad > _LEARNING_RAD and self.amplitude_rad > math.radians(0.2)
        return enough and self.miss2 < (_MISS_SHARE * self.amplitude_rad) ** 2


_STILL = Rhythm()


def learn(state: Rhythm, angle_rad: float, rate_radps: float, dt: float) -> Rhythm:
    """Advance by `dt` with the ground's present angle and rate."""
    if state.direction == 0 and abs(rate_radps) < _TURNING_RADPS:
        return _STILL
    half_period_s, still_s = state.half_period_s + dt, 0.0
    if abs(rate_radps) < _TURNING_RADPS:
        still_s = state.still_s + dt
        if still_s > _STILL_S:
            return _STILL
    elif state.direction != (1 if rate_radps > 0.0 else -1):
        state = _turned(state, angle_rad, rate_radps, half_period_s)
        half_period_s = state.half_period_s
    w = state.frequency_radps
    if w == 0.0:
        return replace(state, half_period_s=half_period_s, still_s=still_s)
    was_x, was_y, centre, phase = state.x, state.y, state.centre, w * dt
    error = angle_rad - centre - was_x
    # An exact rotation, then the corrections: Euler steps would let the amplitude grow.
    cos, sin, push = math.cos(phase), math.sin(phase), phase * error
    x = was_x * cos + was_y * sin + _GAIN * push
    y = was_y * cos - was_x * sin
    pull = _FREQUENCY_GAIN * push * y / max(x * x + y * y, _NO_POWER)
    frequency = w * (1.0 + min(_MOST_PULL, max(-_MOST_PULL, pull)))
    return Rhythm(
        x,
        y,
        centre + _OFFSET_GAIN * push,
        min(_HIGHEST_RADPS, max(_LOWEST_RADPS, frequency)),
        state.learned_rad + phase,
        state.miss2 + min(1.0, _MISS_SHARE_OF_PHASE * phase) * (error * error - state.miss2),
        state.direction,
        half_period_s,
        state.turned_at_rad,
        still_s,
        state.misfits,
    )


def _turned(state: Rhythm, angle_rad: float, rate_radps: float, half_period_s: float) -> Rhythm:
    """Take in a turning point: start from the first, and again when two in a row do not fit the frequency."""
    direction = 1 if rate_radps > 0.0 else -1
    if state.direction == 0:
        return Rhythm(direction=direction)
    known = state.frequency_radps
    measured = math.pi / half_period_s  # not positive before the first turning point
    fits = 0.75 * known < measured < 1.33 * known
    if measured <= 0.0 or fits or (known > 0.0 and state.misfits == 0):
        misfits = 0 if fits else 1
        return replace(
            state,
            direction=direction,
            half_period_s=0.0,
            turned_at_rad=angle_rad,
            misfits=misfits,
        )
    # From one turning point to the other: the ground is at the end of its swing.
    centre = 0.5 * (angle_rad + state.turned_at_rad)
    return Rhythm(
        x=angle_rad - centre,
        centre=centre,
        frequency_radps=min(_HIGHEST_RADPS, max(_LOWEST_RADPS, measured)),
        direction=direction,
        half_period_s=0.0,
        turned_at_rad=angle_rad,
    )


def followable(
    state: Rhythm, rate_limit_radps: float, delay_s: float = 0.0, lag_s: float = 0.0
) -> tuple[float, float]:
    """Return angle and rate of the rate-limited motion that is nearest to the ground in the RMS.

    A command acts `delay_s` late and then through a lag: the angle is that of `delay_s` from now, the rate
    that of `delay_s + lag_s` from now. By Pontryagin's principle the motion consists of arcs at the limit and
    arcs on the sine. By symmetry those at the limit go through the centre: while the sine's top rate is below
    pi/2 of the limit they are its chords; beyond that they join to a triangle in phase.
    """
    amplitude, w = state.amplitude_rad, state.frequency_radps
    slope = rate_limit_radps / w
    half = _chord(slope / amplitude)

    def at(phase: float) -> tuple[float, float]:
        folded = math.asin(math.sin(phase))
        rising = 1.0 if math.cos(phase) >= 0.0 else -1.0
        if half > 0.0 and abs(folded) <= half:
            return slope * folded, rising * rate_limit_radps
        return amplitude * math.sin(folded), rising * amplitude * w * math.cos(folded)

    phase = math.atan2(state.x, state.y) + w * delay_s
    return state.centre + at(phase)[0], at(phase + w * lag_s)[1]


def _chord(share: float) -> float:
    """Return the phase at which the line share * phase meets the sine, pi/2 when it does not before."""
    if share >= 1.0:
        return 0.0
    if share <= 2.0 / math.pi:
        return math.pi / 2.0
    low, high = 1e-6, math.pi / 2.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if math.sin(middle) > share * middle:
            low = middle
        else:
            high = middle
    return high
