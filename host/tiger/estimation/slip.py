"""Which wheels slip: what each wheel says of the robot's speed, held against what inertia says.

A wheel that rolls without slip moves its axle at (w + q) r, w being its speed against the body and q the
body's pitch rate. In a turn a skid-steered wheel scrubs: it runs faster or slower than its place in the turn
asks for by a factor that both sides share (the effective track over the geometric one, learned here), so that
the mean of left and right stays true where one side alone is not.

slip ratio = (surface speed - speed over ground)/|speed over ground| of each wheel (erratum of eq. 5.13).
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from tiger.frozen import dataclass
from tiger.record import STILL

if TYPE_CHECKING:
    from tiger.config.robot import OdometryConfig
    from tiger.record import Four

FourBools = tuple[bool, bool, bool, bool]
NONE: FourBools = (False, False, False, False)
ALL: FourBools = (True, True, True, True)
_SIDE: Four = (1.0, -1.0, 1.0, -1.0)  # left +


@dataclass(frozen=True, slots=True)
class SlipState:
    """What lasts from one wheel sample to the next. Wheels FL, FR, RL, RR."""

    scrub: float = 1.0  # effective over geometric track
    apart_s: Four = STILL  # for how long a wheel has been beyond the threshold (+) or within it (-)
    slipping: FourBools = NONE
    ratio: Four = STILL
    coasting_s: float = 0.0  # since a wheel was believed
    parted: bool = False  # since all were believed, wheels have told different speeds
    together_s: float = 0.0  # for how long they have told the same


@dataclass(frozen=True, slots=True)
class Wheels:
    """Wheel speeds as speeds of the body, had none slipped."""

    surface_mps: Four  # of each tread, over its axle
    told_mps: Four  # speed of the body's middle that each tells, scrub taken off
    half_track_m: Four


def told(
    surface_mps: Four, half_track_m: Four, drive_slip: float, yaw_rate_radps: float, scrub: float
) -> Wheels:
    """Return what the wheels tell; `surface_mps` of each tread, half the track at each wheel.

    `drive_slip`: by how much of their speed the wheels slip because they push.
    """
    turning, rolls = yaw_rate_radps * scrub, 1.0 - drive_slip
    a, b, c, d = surface_mps
    fl, fr, rl, rr = half_track_m
    middle = (
        rolls * a + turning * fl,
        rolls * b - turning * fr,
        rolls * c + turning * rl,
        rolls * d - turning * rr,
    )
    return Wheels(surface_mps, middle, half_track_m)


def trusted(
    config: OdometryConfig,
    state: SlipState,
    wheels: Wheels,
    speed_mps: float,
    speed_sigma_mps: float,
    yaw_rate_radps: float,
) -> FourBools:
    """Tell which wheels agree with the speed that inertia gives, within what either may be off.

    A wheel that slipped must come closer before it is believed again, and a speed that has been coasting
    for long is only a weak reason to believe a wheel that is further off. The two wheels of a side scrub
    alike: if they disagree, the one further off slips. Wheels that told different speeds and now all tell the
    same hold again, whatever the speed has become meanwhile.
    """
    if _hold_again(config, state):
        return ALL
    noise = _noise_mps(config, speed_mps)
    spread = hypot(noise, config.scrub_noise * yaw_rate_radps * wheels.half_track_m[0])
    most, closer = _gates(config, state, spread, speed_sigma_mps)
    off = [abs(told - speed_mps) for told in wheels.told_mps]
    good = [far < (closer if slipped else most) for far, slipped in zip(off, state.slipping, strict=True)]
    for front, rear in ((0, 2), (1, 3)):
        if abs(wheels.told_mps[front] - wheels.told_mps[rear]) > config.gate_sigmas * noise:
            good[front if off[front] > off[rear] else rear] = False
    if abs(yaw_rate_radps) > config.scrub_least_radps:
        _, closer = _gates(config, state, noise + config.scrub_speed_m * abs(yaw_rate_radps), speed_sigma_mps)
        for left, right in ((0, 1), (2, 3)):
            if _only_scrubs(config, wheels, left, right, yaw_rate_radps) and closer > abs(
                0.5 * (wheels.told_mps[left] + wheels.told_mps[right]) - speed_mps
            ):
                good[left] = good[right] = True
    return _bools(good)


def _learned_scrub(
    config: OdometryConfig, scrub: float, wheels: Wheels, yaw_rate_radps: float, dt: float
) -> float:
    """Follow how much faster than the body a skid-steered robot's sides turn it."""
    a, b, c, d = wheels.surface_mps
    apart = (b + d - a - c) / sum(wheels.half_track_m)
    seen = min(max(apart / yaw_rate_radps, 1.0), config.scrub_most)
    return scrub + config.scrub_learning_per_rad * abs(yaw_rate_radps) * dt * (seen - scrub)


def _only_scrubs(
    config: OdometryConfig, wheels: Wheels, left: int, right: int, yaw_rate_radps: float
) -> bool:
    """Tell whether the two wheels of an axle are as far apart as a turn may set them."""
    track_m = wheels.half_track_m[left] + wheels.half_track_m[right]
    apart_mps = wheels.surface_mps[right] - wheels.surface_mps[left]
    return 1.0 <= apart_mps / (track_m * yaw_rate_radps) <= config.scrub_most


def _noise_mps(config: OdometryConfig, speed_mps: float) -> float:
    """How far a wheel that holds may be off by itself."""
    return config.wheel_noise_mps + config.wheel_noise_ratio * abs(speed_mps)


def _hold_again(config: OdometryConfig, state: SlipState) -> bool:
    return state.parted and state.together_s >= config.agree_s


def _gates(
    config: OdometryConfig, state: SlipState, spread_mps: float, speed_sigma_mps: float
) -> tuple[float, float]:
    """How far off a wheel may be, and one that slipped; after long coasting the speed is doubted instead."""
    if state.coasting_s > config.longest_slip_s:
        most = config.gate_sigmas * (spread_mps + speed_sigma_mps)
        return most, most
    coasting = config.coasting_sigmas * speed_sigma_mps
    return config.gate_sigmas * spread_mps + coasting, config.regain_sigmas * spread_mps + coasting


def plausible(
    config: OdometryConfig,
    state: SlipState,
    mean_mps: float,
    speed_mps: float,
    speed_sigma_mps: float,
    yaw_rate_radps: float,
) -> bool:
    """Tell whether the mean of both sides, in which scrub cancels, agrees with inertia."""
    if _hold_again(config, state):
        return True
    spread = _noise_mps(config, speed_mps) + config.scrub_speed_m * abs(yaw_rate_radps)
    most, closer = _gates(config, state, spread, speed_sigma_mps)
    return abs(mean_mps - speed_mps) < (closer if any(state.slipping) else most)


def mean_of(told_mps: Four, good: FourBools) -> tuple[float, bool]:
    """Return the speed that the good wheels tell, and whether both sides are among them (scrub cancels).

    At least one wheel must be good.
    """
    left = [told_mps[i] for i in (0, 2) if good[i]]
    right = [told_mps[i] for i in (1, 3) if good[i]]
    if left and right:
        return 0.5 * (sum(left) / len(left) + sum(right) / len(right)), True
    one = left or right
    return sum(one) / len(one), False


def step(
    config: OdometryConfig,
    state: SlipState,
    wheels: Wheels,
    good: FourBools,
    speed_mps: float,
    speed_sigma_mps: float,
    yaw_rate_radps: float,
    dt: float,
) -> SlipState:
    """Compute slip ratios and events for a motion, and learn the scrub from wheels that hold."""
    ratios, slipping, times = [], [], []
    sure_mps = max(config.event_speed_mps, config.event_sigmas * speed_sigma_mps)
    for i, side in enumerate(_SIDE):
        ground = speed_mps - side * yaw_rate_radps * wheels.half_track_m[i]
        slip_mps = wheels.surface_mps[i] - ground
        ratio = slip_mps / max(abs(ground), config.least_speed_mps)
        beyond = abs(ratio) > config.event_ratio and abs(slip_mps) > sure_mps
        within = abs(ratio) < config.event_over_ratio or abs(slip_mps) < 0.5 * config.event_speed_mps
        was, since = state.slipping[i], state.apart_s[i]
        changes = within if was else beyond
        since = since + dt if changes else 0.0
        if since > (config.event_over_s if was else config.event_s):
            was, since = not was, 0.0
        ratios.append(ratio)
        slipping.append(was)
        times.append(since)
    scrub = state.scrub
    if abs(yaw_rate_radps) > config.scrub_least_radps and all(good):
        scrub = _learned_scrub(config, scrub, wheels, yaw_rate_radps, dt)
    coasting_s = 0.0 if any(good) else state.coasting_s + dt
    spread = hypot(
        _noise_mps(config, speed_mps), config.scrub_noise * yaw_rate_radps * wheels.half_track_m[0]
    )
    lowest, highest = min(wheels.told_mps), max(wheels.told_mps)
    together_s = state.together_s + dt if highest - lowest < config.agree_sigmas * spread else 0.0
    settled = all(good) and abs(0.5 * (lowest + highest) - speed_mps) < spread
    parted = not settled and (state.parted or highest - lowest > config.gate_sigmas * spread)
    return SlipState(scrub, _four(times), _bools(slipping), _four(ratios), coasting_s, parted, together_s)


def _four(values: list[float]) -> Four:
    a, b, c, d = values
    return a, b, c, d


def _bools(values: list[bool]) -> FourBools:
    a, b, c, d = values
    return a, b, c, d
