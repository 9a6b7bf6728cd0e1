"""Heat of the four actuators' motors, and how fast they may go on without being switched off.

mega_suspension adds up the square of each motor's duty with a time constant of 5.6 minutes, and beyond what
a motor stands for ever, a quarter of full duty, it stops the robot (docs/mega_suspension.md, OVERHEAT).
Levelling on rough ground gets there in minutes. Here the same sum is kept from the duties that the board
reports, as a share of its limit, and the rates are taken back in time: the robot levels more slowly, and goes
on. Neither knows of what was before its own start: a motor that is hot by then counts as cold in both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiger.config.robot import LevelingConfig
    from tiger.record import Four

TIME_CONSTANT_S = 327.68  # of thermal.h; a test holds both against the board
CONTINUOUS_DUTY2 = 0.25

COLD: Four = (0.0, 0.0, 0.0, 0.0)
FULL: Four = (1.0, 1.0, 1.0, 1.0)


def step(heat: Four, duty_permille: Four, dt: float) -> Four:
    """Advance by `dt` seconds at these duties; 1 is the limit of the board."""
    (fl, fr, rl, rr), (d_fl, d_fr, d_rl, d_rr) = heat, duty_permille
    gain = dt / TIME_CONSTANT_S
    keep, warms = 1.0 - gain, 1e-6 * gain / CONTINUOUS_DUTY2
    return (
        keep * fl + warms * d_fl * d_fl,
        keep * fr + warms * d_fr * d_fr,
        keep * rl + warms * d_rl * d_rl,
        keep * rr + warms * d_rr * d_rr,
    )


def rate_share(config: LevelingConfig, heat: Four) -> Four:
    """Share of its full rate that each actuator may use: all of it while cool, none at `heat_stop`."""
    slow, stop = config.heat_slow, config.heat_stop
    if max(heat) <= slow:
        return FULL
    fl, fr, rl, rr = (min(1.0, max(0.0, (stop - hot) / (stop - slow))) for hot in heat)
    return fl, fr, rl, rr
