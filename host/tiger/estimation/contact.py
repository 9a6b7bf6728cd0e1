"""Which wheels touch the ground, and how far it is twisted under them: from strokes, attitude and currents.

A twist of the four strokes is seen by no IMU while all four springs are loaded: it moves load from one
diagonal to the other, and the body nowhere. Once it has taken all load off a wheel, that wheel hangs, the
body stands on three, and every further millimetre turns it about the diagonal that carries it. So whether
the attitude answers tells on which side of lift-off the twist of ground and strokes together is, and the
twist at lift-off is known from weight and springs: (4.6) at rest with `Fz = max(0, ...)`.

Only one number is unknown, the ground's twist g: +g under FL and RR, -g under FR and RL. A Bayes filter
keeps its probability on a grid. Each candidate foretells how roll and pitch follow the strokes, beyond an
offset (the slope of the ground) that it learns for itself. The wheel that hangs may be the front or the
rear one of its diagonal, or, as on a tightrope, both: all three are carried along, and pass into each
other. A motor that pushes proves that its wheel is on the ground. Driving brings new ground: what was known
gives way, with the distance, to what the front wheels have told of it (`ground_track`).

Twists are amplitudes in mm at each corner, a quarter of FL - FR - RL + RR.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from tiger.control import traction
from tiger.control.reachable import WARP, Suspension
from tiger.estimation import ground_track
from tiger.estimation.ground_track import TrackDesign, TrackState
from tiger.frozen import dataclass, replace
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.record import Mode

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import ContactConfig, RobotConfig
    from tiger.record import Estimate, Four, Inputs, Loads

    Array = NDArray[np.float64]

_GRID_MM = 2.5
_REACH_OF_GRID_MM = 160.0
_SIDES = 3
_CANDIDATES = 2 * round(_REACH_OF_GRID_MM / _GRID_MM) + 1
_TIPS = 0.05
"""How readily, at each update in which the strokes twist, the body tips over the diagonal it stands on."""
_STILL_MM = 0.3
_QUARTILES = (0.25, 0.5, 0.75)
_QUARTILES_OF_SIGMA = 1.349
"""Distance of the quartiles of a normal distribution, in standard deviations."""
_CREEP_MPS = 0.03
"""Wheels that the twisting body rolls to and fro bring no new ground."""
_TIGHTROPE = 0.2
"""How likely it then stands on two wheels alone."""
_SURE_MM = 8.0
"""Of two wheels of a diagonal, the one that lifts off so much before the other is the one that hangs."""
_LEAST_LOG = -6.0
"""Of what one update says: no single moment decides."""
_MODEL_SHARE = 0.1
"""Of a turn by the strokes: what the weight's lever and unequal springs may add to it."""
_SWING_S = 0.04
"""The body swings about its strokes by what they move in this time. One that turns beyond them topples from
one wheel to another: it is as far from where it will stand as it turns in this time."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactDesign:
    """What `design_contact` computes once."""

    config: ContactConfig
    suspension: Suspension
    track: TrackDesign
    grid_mm: Array
    """Candidates (n,) for the ground's twist."""
    expected: Array
    """Their probability (n,) before anything is known."""
    kept: Array
    """The least probability (3, n) that noise leaves them, see `_kept`."""
    stiffness_npmm: float
    """Load that a twist of 1 mm moves at each corner: spring and tyre in series."""
    mass_kg: float
    com_height_m: float
    """Of the whole robot above the wheel centres: the ground carries a wheel straight below its own."""
    turn_rad_per_mm: Array
    """Roll and pitch (2, 2, 1) by 1 mm of twist beyond lift-off of the front, and of the rear wheel: (4.8) on
    three wheels."""
    pitch_per_mm: float
    """The larger of them."""
    noise_rad2: float
    drift_rad2: float
    slope_rad2_per_m: float
    x_m: Four
    y_m: Four
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is thought of each candidate: its probability (3, n), the front, the rear or both wheels of the
    diagonal hanging, and the slope of the ground it takes, in roll and pitch (2, 3, n). The variance is zero
    before the first attitude."""

    probability: Array
    offset_rad: Array
    variance_rad2: float = 0.0


@dataclass(frozen=True, slots=True)
class Contact:
    """What is known of contact."""

    ground_warp_mm: float = 0.0
    """The median: as likely more as less."""
    sigma_mm: float = 0.0
    hanging: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Probability that a wheel carries nothing, FL FR RL RR."""
    lifted: float = 0.0
    """Probability that some wheel of the diagonal FL-RR hangs, less that of FR-RL."""
    lift_off_mm: tuple[float, float] = (0.0, 0.0)
    """Twist of ground and strokes together at which a wheel of the lighter diagonal lifts off, - and +."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactState:
    """What a tick leaves to the next."""

    belief: Belief
    track: TrackState
    contact: Contact = field(default_factory=Contact)
    twist_mm: float = 0.0
    """Twist of the strokes that the body has followed by now."""
    posed_rad: tuple[float, float] = (0.0, 0.0)
    """Roll and pitch by the strokes at the last update."""
    travelled_m: float = 0.0
    """At the last update."""
    carried: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Mass of the robot in kg, 0 if unknown, and how far ahead and to the left its COM is, as of the last
    drive: at a standstill a body on three wheels looks as if it carried something."""
    at_s: float = -1e9
    """Time of the last update."""


def design_contact(robot: RobotConfig) -> ContactDesign:
    """Lay out the grid and derive stiffness and levers from the vehicle."""
    config, vehicle = robot.contact, robot.vehicle
    body, tire = vehicle.body, vehicle.tire
    parameters = FullCarParameters.from_config(vehicle)
    springs = 1.0 / (1.0 / parameters.spring_npm() + 1.0 / parameters.tire_stiffness_npm)
    x, y = parameters.corner_positions_m().T
    unsprung_kg = float(parameters.wheel_mass_kg().sum())
    mass_kg = body.mass_kg + unsprung_kg
    roll, pitch = 0.001 / body.half_track_m, 0.002 / body.wheelbase_m
    stiffness_npmm = 0.001 * float(springs.mean())
    grid_mm = np.linspace(-_REACH_OF_GRID_MM, _REACH_OF_GRID_MM, _CANDIDATES)
    expected = _tent(grid_mm, config.expected_twist_mm)
    return ContactDesign(
        config=config,
        suspension=Suspension.from_config(robot),
        track=ground_track.design_track(robot),
        grid_mm=grid_mm,
        expected=expected,
        kept=_kept(robot, grid_mm, expected, 0.25 * mass_kg * GRAVITY_MPS2 / stiffness_npmm),
        stiffness_npmm=stiffness_npmm,
        mass_kg=mass_kg,
        com_height_m=body.mass_kg * (body.com_height_m - tire.rolling_radius_m) / mass_kg,
        turn_rad_per_mm=np.array([[[-roll], [roll]], [[-pitch], [pitch]]]),
        pitch_per_mm=pitch,
        noise_rad2=math.radians(config.attitude_noise_deg) ** 2,
        drift_rad2=math.radians(config.slope_drift_deg) ** 2,
        slope_rad2_per_m=math.radians(config.slope_per_metre_deg) ** 2,
        x_m=tuple(x.tolist()),
        y_m=tuple(y.tolist()),
        radius_m=tire.rolling_radius_m,
    )


def _kept(robot: RobotConfig, grid_mm: Array, expected: Array, lift_off_mm: float) -> Array:
    """Return the least probability (3, n) of each candidate: noise and a wrong model rule none out for good.

    With such a floor the filter is a test of CUSUM's kind, which takes a wheel for hanging when its
    likelihood has grown from the floor to the odds at which mode balance acts. If no wheel hangs, a
    likelihood ratio has the mean one, and by the inequality of Doob that takes, on average, no less than
    odds / floor updates (Lorden 1971). The floor is as high, and the filter as quick to think again, as the
    time between two false alarms lets it.
    """
    odds = robot.balance.sure / (1.0 - robot.balance.sure)
    updates = robot.contact.false_alarm_s / robot.contact.period_s
    hanging = float(expected[np.abs(grid_mm) > lift_off_mm].sum())
    share = min(1.0, odds / updates / max(hanging, 1e-6))
    return np.stack([expected] * _SIDES) * (share / _SIDES)


def initial_state(design: ContactDesign) -> ContactState:
    """Return the state before the first attitude: the ground is about as flat as expected."""
    probability = np.stack([design.expected] * _SIDES) / _SIDES
    belief = Belief(probability, np.zeros((2, _SIDES, _CANDIDATES)))
    return ContactState(belief, ground_track.initial_state(design.track))


def step(
    design: ContactDesign, state: ContactState, inputs: Inputs, estimate: Estimate, loads: Loads, dt: float
) -> tuple[ContactState, Contact]:
    """Advance by `dt` seconds; `estimate` has attitude and odometry of this tick, `loads` mass and COM.

    The attitude is compared every `contact.period_s` in mode balance, every `contact.idle_period_s` in any
    other; the ground's track at every length it is kept at.
    """
    strokes = inputs.strokes
    if strokes is None or not estimate.ready:
        return state, state.contact
    track, config = state.track, design.config
    period_s = config.period_s if inputs.command.mode is Mode.BALANCE else config.idle_period_s
    due = inputs.now_s - state.at_s > period_s - 0.5 * dt
    if estimate.odometry.distance_m - track.travelled_m >= design.track.step_m:
        track = ground_track.step(design.track, track, estimate)
    elif not due:
        return state, state.contact
    if not due:
        return replace(state, track=track), state.contact
    state = _updated(design, state, track, inputs, strokes.stroke_mm, estimate, loads)
    return state, state.contact


def _updated(
    design: ContactDesign,
    state: ContactState,
    track: TrackState,
    inputs: Inputs,
    stroke_mm: Four,
    estimate: Estimate,
    loads: Loads,
) -> ContactState:
    """Compare the attitude with what each candidate foretells, and say where the wheels stand."""
    at = design.suspension.curve.at
    fl, fr, rl, rr = stroke_mm
    pose = design.suspension.pose((at(fl)[0], at(fr)[0], at(rl)[0], at(rr)[0]))
    posed_rad, attitude_rad = (pose.roll_rad, pose.pitch_rad), (estimate.roll_rad, estimate.pitch_rad)
    first = state.belief.variance_rad2 == 0.0
    creeps = abs(estimate.odometry.speed_mps) < _CREEP_MPS
    travelled_m = estimate.odometry.distance_m
    driven_m = 0.0 if creeps else travelled_m - state.travelled_m
    carried = state.carried
    if first or driven_m > 0.0:
        carried = loads.mass_kg, loads.com_m[0], loads.com_m[1]
    lift_off_mm = _lift_off_mm(design, attitude_rad, carried)
    belief, candidates = state.belief, design.grid_mm + pose.warp_mm
    turned = _turned(design, _excess_mm(design, candidates, lift_off_mm))
    slope_rad = _slope(attitude_rad, posed_rad, turned)
    if first:
        belief = Belief(belief.probability, slope_rad, design.noise_rad2)
    else:
        probability = _driven(design, belief.probability, track, driven_m)
        probability = _proved(design, probability, candidates, lift_off_mm, inputs)
        probability = np.maximum(probability, design.kept)
        belief = Belief(probability, belief.offset_rad, belief.variance_rad2)
        twisted_mm = abs(pose.warp_mm - state.twist_mm)
        moved_rad = max(
            abs(posed_rad[0] - state.posed_rad[0]),
            abs(posed_rad[1] - state.posed_rad[1]),
            design.pitch_per_mm * twisted_mm,
        )
        since_s = inputs.now_s - state.at_s
        swing_rad = _SWING_S * math.hypot(
            moved_rad / since_s,
            estimate.roll_rate_radps - (posed_rad[0] - state.posed_rad[0]) / since_s,
            estimate.pitch_rate_radps - (posed_rad[1] - state.posed_rad[1]) / since_s,
        )
        belief = _compared(design, belief, slope_rad, moved_rad, swing_rad, driven_m)
        if twisted_mm > _STILL_MM:
            belief = _tipped(belief, pose.warp_mm, lift_off_mm)
    contact = _found(design, belief.probability, pose.warp_mm, lift_off_mm)
    return ContactState(belief, track, contact, pose.warp_mm, posed_rad, travelled_m, carried, inputs.now_s)


# ---- what lifts a wheel off -----------------------------------


def _lift_off_mm(
    design: ContactDesign, attitude_rad: tuple[float, float], carried: tuple[float, float, float]
) -> Four:
    """Twist at which each wheel would lift off: its load without any, over the stiffness.

    The weight leans to the side to which the body is tilted, by the height of the COM.
    """
    mass_kg, ahead_m, left_m = carried
    roll_rad, pitch_rad = attitude_rad
    weight_n = (mass_kg if mass_kg > 0.0 else design.mass_kg) * GRAVITY_MPS2
    ahead_m += design.com_height_m * math.tan(pitch_rad)
    left_m -= design.com_height_m * math.tan(roll_rad)
    x, y = design.x_m, design.y_m
    # Forces of four equal springs under a plane: the mean of both shares, not their product.
    along = (ahead_m - 0.5 * (x[0] + x[2])) / (x[0] - x[2])
    across = 0.5 * left_m / y[0]
    per_mm = 0.5 * weight_n / design.stiffness_npmm
    fl, fr = per_mm * (0.5 + along + across), per_mm * (0.5 + along - across)
    rl, rr = per_mm * (0.5 - along + across), per_mm * (0.5 - along - across)
    return max(fl, 0.0), max(fr, 0.0), max(rl, 0.0), max(rr, 0.0)


def _excess_mm(design: ContactDesign, twist_mm: Array, lift_off_mm: Four) -> Array:
    """How far each candidate's twist (n,) is beyond lift-off of the front, and of the rear wheel (2, n).

    With its sign: + when FR or RL hangs. The lift-off is that at the attitude as it is, which has the tilt in
    it that the hanging wheel has brought about.
    """
    fl, fr, rl, rr = lift_off_mm
    low, high = np.array([[-fl], [-rr]]), np.array([[fr], [rl]])
    excess: Array = twist_mm - np.minimum(np.maximum(twist_mm, low), high)
    return excess


def _turned(design: ContactDesign, excess_mm: Array) -> Array:
    """Roll and pitch (2, 2, n) by which the body leans over when the front, or the rear wheel hangs.

    A hanging corner goes up: FL +roll -pitch, FR -roll -pitch, RL +roll +pitch, RR -roll +pitch. On both
    wheels of its diagonal alone it does not lean.
    """
    both = np.empty((2, *excess_mm.shape))
    both[0] = excess_mm
    np.abs(excess_mm, out=both[1])
    both *= design.turn_rad_per_mm
    return both


# ---- evidence ---------------------------------------------------


def _slope(attitude_rad: tuple[float, float], posed_rad: tuple[float, float], turned_rad: Array) -> Array:
    """Roll and pitch (2, 3, n) that strokes and hanging wheels leave to the ground."""
    slope = np.empty((2, _SIDES, turned_rad.shape[2]))
    for axis in (0, 1):
        rest = attitude_rad[axis] - posed_rad[axis]
        np.subtract(rest, turned_rad[axis], out=slope[axis, :2])
        slope[axis, 2] = rest
    return slope


def _compared(
    design: ContactDesign,
    belief: Belief,
    slope_rad: Array,
    moved_rad: float,
    swing_rad: float,
    driven_m: float,
) -> Belief:
    """Weigh each candidate by how well it foretold roll and pitch, and let it learn the slope.

    `moved_rad`: how far the strokes have turned the body since the last time, or may have; `swing_rad`: how
    far it may be from where it comes to rest.
    """
    missed = slope_rad - belief.offset_rad
    squares = missed * missed
    wrong = squares[0] + squares[1]
    # Under strokes that stand still, what no candidate explains is another motion, and speaks for none.
    other_rad2 = float(wrong.min()) if moved_rad < _STILL_MM * design.pitch_per_mm else 0.0
    slope_rad2 = design.drift_rad2 + (_MODEL_SHARE * moved_rad) ** 2 + design.slope_rad2_per_m * driven_m
    prior = belief.variance_rad2 + slope_rad2 + other_rad2
    noise = design.noise_rad2 + swing_rad * swing_rad
    gain = prior / (prior + noise)
    wrong -= wrong.min()
    wrong *= -0.5 / (prior + noise)
    probability = belief.probability * np.exp(np.maximum(wrong, _LEAST_LOG))
    probability /= probability.sum()
    missed *= gain
    missed += belief.offset_rad
    return Belief(probability, missed, (1.0 - gain) * prior)


def _tipped(belief: Belief, strokes_mm: float, lift_off_mm: Four) -> Belief:
    """Let a little of each candidate tip over; it takes along what it knows of the slope.

    Mixing as in an interacting-multiple-model filter (Blom and Bar-Shalom 1988).
    """
    fl, fr, rl, rr = lift_off_mm
    below = _index(-strokes_mm)
    probability, offset = belief.probability, belief.offset_rad
    total = probability[0] + probability[1] + probability[2]
    tipped = np.empty_like(probability)
    for part, front in ((slice(None, below), _first_off(fl, rr)), (slice(below, None), _first_off(fr, rl))):
        np.multiply(total[part], _TIPS * (1.0 - _TIGHTROPE) * front, out=tipped[0, part])
        np.multiply(total[part], _TIPS * (1.0 - _TIGHTROPE) * (1.0 - front), out=tipped[1, part])
    np.multiply(total, _TIPS * _TIGHTROPE, out=tipped[2])
    mixed = (1.0 - _TIPS) * probability + tipped
    mean_rad = (probability * offset).sum(axis=1, keepdims=True) / total
    offset_rad = np.where(tipped > 0.5 * mixed, mean_rad, offset)
    return Belief(mixed, offset_rad, belief.variance_rad2)


def _first_off(front_mm: float, rear_mm: float) -> float:
    """Probability that the front wheel of a diagonal lifts off before the rear one."""
    return 0.5 * (1.0 + math.tanh((rear_mm - front_mm) / _SURE_MM))


def _proved(
    design: ContactDesign, probability: Array, twist_mm: Array, lift_off_mm: Four, inputs: Inputs
) -> Array:
    """A wheel that pushes has load: no less than its force over the most grip there is."""
    noise_mm = design.config.push_noise_mm
    least = 1.0 / (design.config.grip_max * design.radius_m * design.stiffness_npmm)
    log = None
    for sign, torque, off in zip(WARP, traction.measured(inputs)[1], lift_off_mm, strict=True):
        proved_mm = abs(torque) * least - noise_mm
        if proved_mm <= 0.0:
            continue
        missing = np.maximum(proved_mm - np.maximum(off + sign * twist_mm, 0.0), 0.0) / noise_mm
        log = -0.5 * missing * missing + (0.0 if log is None else log)
    if log is None:
        return probability
    weighed = probability * np.exp(np.maximum(log, _LEAST_LOG))
    return np.asarray(weighed / weighed.sum())


def _driven(design: ContactDesign, probability: Array, track: TrackState, driven_m: float) -> Array:
    """Let what was known of the ground fade into what its track tells, as new ground comes."""
    if driven_m <= 0.0:
        return probability
    fade = 1.0 - math.exp(-driven_m / design.config.fade_m)
    twist_mm, sigma_mm = ground_track.twist(design.track, track)
    ahead = _bell(design.grid_mm, twist_mm, sigma_mm)
    return (1.0 - fade) * probability + (fade / _SIDES) * ahead


# ---- result -----------------------------------------------------


def _found(design: ContactDesign, probability: Array, twist_mm: float, lift_off_mm: Four) -> Contact:
    """`probability` adds up to one."""
    fl, fr, rl, rr = lift_off_mm
    summed = np.cumsum(probability, axis=1)
    low_mm, middle_mm, high_mm = _quantiles(summed[0] + summed[1] + summed[2])
    low = [_below(summed[side], -mm - twist_mm) for side, mm in enumerate((fl, rr, max(fl, rr)))]
    high = [
        float(summed[side, -1]) - _below(summed[side], mm - twist_mm)
        for side, mm in enumerate((fr, rl, max(fr, rl)))
    ]
    return Contact(
        ground_warp_mm=middle_mm,
        sigma_mm=(high_mm - low_mm) / _QUARTILES_OF_SIGMA,
        hanging=(low[0] + low[2], high[0] + high[2], high[1] + high[2], low[1] + low[2]),
        lifted=sum(low) - sum(high),
        lift_off_mm=(-min(fl, rr), min(fr, rl)),
    )


def _index(twist_mm: float) -> int:
    """First candidate of no less than this twist."""
    return min(max(math.ceil((twist_mm + _REACH_OF_GRID_MM) / _GRID_MM), 0), _CANDIDATES)


def _below(summed: Array, twist_mm: float) -> float:
    """Probability of the candidates below a twist, from their running sum."""
    end = _index(twist_mm)
    return float(summed[end - 1]) if end > 0 else 0.0


def _quantiles(summed: Array) -> tuple[float, float, float]:
    """Quartiles and median of a distribution on the grid, linear between its points."""
    found = []
    for share, k in zip(_QUARTILES, summed.searchsorted(_QUARTILES).tolist(), strict=True):
        k = min(k, _CANDIDATES - 1)
        before = float(summed[k - 1]) if k > 0 else 0.0
        # A point's probability lies about it, half to each side.
        part = (share - before) / max(float(summed[k]) - before, 1e-12)
        found.append(_GRID_MM * (k + min(part, 1.0) - 0.5) - _REACH_OF_GRID_MM)
    low, middle, high = found
    return low, middle, high


def _tent(grid_mm: Array, scale_mm: float) -> Array:
    """Two-sided exponential probabilities: most ground is nearly flat, some is not at all."""
    weight = np.exp(-np.abs(grid_mm) / scale_mm)
    expected: Array = weight / weight.sum()
    return expected


def _bell(grid_mm: Array, mean_mm: float, sigma_mm: float) -> Array:
    """Normal probabilities of the candidates, which add up to one."""
    away = (grid_mm - mean_mm) * (math.sqrt(0.5) / sigma_mm)
    weight = np.exp(-away * away)
    weight /= weight.sum()
    return weight
