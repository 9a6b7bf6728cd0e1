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
from tiger.control.reachable import Suspension
from tiger.estimation import ground_track
from tiger.estimation.ground_track import TrackDesign, TrackState
from tiger.frozen import dataclass, replace
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters

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
_KEPT = 0.2
"""Of what was expected at first: no candidate is ever ruled out by noise."""
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
    stiffness_npmm: float
    """Load that a twist of 1 mm moves at each corner: spring and tyre in series."""
    mass_kg: float
    com_height_m: float
    """Of the whole robot above the ground."""
    roll_per_mm: float
    pitch_per_mm: float
    """Turn of the body by 1 mm of twist beyond lift-off, (4.8) on three wheels, with the weight's lever."""
    noise_rad2: float
    drift_rad2: float
    x_m: Four
    y_m: Four
    radius_m: float
    ticks: int


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What is thought of each candidate: its probability (3, n), the front, the rear or both wheels of the
    diagonal hanging, and the slope of the ground it takes, in roll and pitch (2, 3, n) with its variance."""

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
    ticks: int = -1
    """Since the last update; -1 before the first."""


def design_contact(robot: RobotConfig) -> ContactDesign:
    """Lay out the grid and derive stiffness and levers from the vehicle."""
    config, vehicle = robot.contact, robot.vehicle
    body, tire = vehicle.body, vehicle.tire
    parameters = FullCarParameters.from_config(vehicle)
    springs = 1.0 / (1.0 / parameters.spring_npm() + 1.0 / parameters.tire_stiffness_npm)
    x, y = parameters.corner_positions_m().T
    unsprung_kg = float(parameters.wheel_mass_kg().sum())
    mass_kg = body.mass_kg + unsprung_kg
    # Beyond lift-off one spring holds the body on its diagonal, against the lever of its own weight.
    arm_m = body.wheelbase_m * body.half_track_m / math.hypot(0.5 * body.wheelbase_m, body.half_track_m)
    spring = float(springs.mean())
    lean = 1.0 / (1.0 - body.mass_kg * GRAVITY_MPS2 * body.com_height_m / (spring * arm_m**2))
    grid_mm = np.linspace(-_REACH_OF_GRID_MM, _REACH_OF_GRID_MM, _CANDIDATES)
    return ContactDesign(
        config=config,
        suspension=Suspension.from_config(robot),
        track=ground_track.design_track(robot),
        grid_mm=grid_mm,
        expected=_tent(grid_mm, config.expected_twist_mm),
        stiffness_npmm=0.001 * spring,
        mass_kg=mass_kg,
        com_height_m=(body.mass_kg * body.com_height_m + unsprung_kg * tire.rolling_radius_m) / mass_kg,
        roll_per_mm=lean * 0.001 / body.half_track_m,
        pitch_per_mm=lean * 0.002 / body.wheelbase_m,
        noise_rad2=math.radians(config.attitude_noise_deg) ** 2,
        drift_rad2=math.radians(config.slope_drift_deg) ** 2,
        x_m=tuple(x.tolist()),
        y_m=tuple(y.tolist()),
        radius_m=tire.rolling_radius_m,
        ticks=round(config.period_s * robot.loop.rate_hz),
    )


def initial_state(design: ContactDesign) -> ContactState:
    """Return the state before the first attitude: the ground is about as flat as expected."""
    probability = np.stack([design.expected] * _SIDES) / _SIDES
    belief = Belief(probability, np.zeros((2, _SIDES, _CANDIDATES)))
    return ContactState(belief, ground_track.initial_state(design.track))


def step(
    design: ContactDesign, state: ContactState, inputs: Inputs, estimate: Estimate, loads: Loads, dt: float
) -> tuple[ContactState, Contact]:
    """Advance by `dt` seconds; `estimate` has attitude and odometry of this tick, `loads` mass and COM.

    The attitude is compared every `contact.period_s`, the ground's track at every length it is kept at.
    """
    if inputs.strokes is None or not estimate.ready:
        return state, state.contact
    track = ground_track.step(design.track, state.track, estimate)
    ticks = state.ticks + 1
    if 0 < ticks < design.ticks:
        return replace(state, track=track, ticks=ticks), state.contact
    at = design.suspension.curve.at
    fl, fr, rl, rr = (at(stroke)[0] for stroke in inputs.strokes.stroke_mm)
    pose = design.suspension.pose((fl, fr, rl, rr))
    # The body swings after the strokes: it is compared with where they were half a period ago.
    twist_mm = pose.warp_mm if ticks == 0 else 0.5 * (state.twist_mm + pose.warp_mm)
    posed_rad = pose.roll_rad, pose.pitch_rad
    attitude_rad = estimate.roll_rad - posed_rad[0], estimate.pitch_rad - posed_rad[1]
    turned_rad = max(abs(a - b) for a, b in zip(posed_rad, state.posed_rad, strict=True))
    travelled_m = estimate.odometry.distance_m
    creeps = abs(estimate.odometry.speed_mps) < _CREEP_MPS
    driven_m = 0.0 if creeps else travelled_m - state.travelled_m
    lift_off_mm = _lift_off_mm(design, estimate, loads)
    belief = state.belief
    if ticks > 0:
        belief = _driven(design, belief, track, driven_m)
        belief = _proved(design, belief, twist_mm, lift_off_mm, inputs)
    moved = abs(pose.warp_mm - state.twist_mm) > _STILL_MM
    kept = np.maximum(belief.probability, _KEPT / _SIDES * design.expected)
    belief = _compared(
        design,
        replace(belief, probability=kept / kept.sum()),
        twist_mm,
        lift_off_mm,
        attitude_rad,
        turned_rad,
        driven_m,
        first=ticks == 0,
        moved=moved,
    )
    contact = _found(design, belief, twist_mm, lift_off_mm)
    return ContactState(belief, track, contact, pose.warp_mm, posed_rad, travelled_m, 0), contact


# ---- what lifts a wheel off -----------------------------------


def _lift_off_mm(design: ContactDesign, estimate: Estimate, loads: Loads) -> Four:
    """Twist at which each wheel would lift off: its load without any, over the stiffness.

    On a slope the weight leans to the lower side by the height of the COM.
    """
    mass_kg = loads.mass_kg if loads.mass_kg > 0.0 else design.mass_kg
    weight_n = mass_kg * GRAVITY_MPS2
    ahead_m = loads.com_m[0] + design.com_height_m * math.tan(estimate.plate_pitch_rad)
    left_m = loads.com_m[1] - design.com_height_m * math.tan(estimate.plate_roll_rad)
    x, y = design.x_m, design.y_m
    middle_m = 0.5 * (x[0] + x[2])
    along, across = (ahead_m - middle_m) / (x[0] - x[2]), 0.5 * left_m / y[0]
    front, rear = 0.5 + along, 0.5 - along
    left, right = 0.5 + across, 0.5 - across
    per_mm = weight_n / design.stiffness_npmm
    # Forces of four equal springs under a plane: the mean of both shares, not their product.
    share = (front + left, front + right, rear + left, rear + right)
    fl, fr, rl, rr = (max(0.0, per_mm * 0.5 * (s - 0.5)) for s in share)
    return fl, fr, rl, rr


def _excess_mm(twist_mm: Array, lift_off_mm: Four) -> Array:
    """How far each candidate's twist (n,) is beyond lift-off, with its sign: + when FR or RL hangs."""
    fl, fr, rl, rr = lift_off_mm
    beyond: Array = np.maximum(twist_mm - min(fr, rl), 0.0) + np.minimum(twist_mm + min(fl, rr), 0.0)
    return beyond


# ---- evidence ---------------------------------------------------


def _compared(
    design: ContactDesign,
    belief: Belief,
    twist_mm: float,
    lift_off_mm: Four,
    attitude_rad: tuple[float, float],
    turned_rad: float,
    driven_m: float,
    *,
    first: bool,
    moved: bool,
) -> Belief:
    """Weigh each candidate by how well it foretold roll and pitch, and let it learn the slope."""
    excess = _excess_mm(design.grid_mm + twist_mm, lift_off_mm)
    # A hanging corner goes up: FL +roll -pitch, FR -roll -pitch, RL +roll +pitch, RR -roll +pitch.
    size = np.abs(excess)
    roll, pitch = design.roll_per_mm * excess, design.pitch_per_mm * size
    neither = np.zeros_like(roll)
    foretold = np.array([[-roll, roll, neither], [-pitch, pitch, neither]])  # axis, side, candidate
    seen = np.array(attitude_rad)[:, None, None] - foretold
    if first:
        return Belief(belief.probability, seen, design.noise_rad2)
    slope = math.radians(design.config.slope_per_metre_deg)
    drift = design.drift_rad2 + (_MODEL_SHARE * turned_rad) ** 2 + slope**2 * driven_m
    prior = belief.variance_rad2 + drift
    missed = seen - belief.offset_rad
    gain = prior / (prior + design.noise_rad2)
    log = (-0.5 / (prior + design.noise_rad2)) * (missed * missed).sum(axis=0)
    log = np.maximum(log - log.max(), _LEAST_LOG)
    return _mixed(
        belief.probability * np.exp(log),
        belief.offset_rad + gain * missed,
        (1.0 - gain) * prior,
        lift_off_mm,
        design.grid_mm + twist_mm,
        tips=_TIPS if moved else 0.0,
    )


def _mixed(
    probability: Array,
    offset_rad: Array,
    variance_rad2: float,
    lift_off_mm: Four,
    twist_mm: Array,
    *,
    tips: float,
) -> Belief:
    """Normalise, and let a little of each candidate tip over; it takes along what it knows of the slope.

    Mixing as in an interacting-multiple-model filter (Blom and Bar-Shalom 1988).
    """
    fl, fr, rl, rr = lift_off_mm
    front = np.where(twist_mm > 0.0, _first_off(fr, rl), _first_off(fl, rr))
    share = np.stack(
        [(1.0 - _TIGHTROPE) * front, (1.0 - _TIGHTROPE) * (1.0 - front), np.full_like(front, _TIGHTROPE)]
    )
    tipped = tips * share * probability.sum(axis=0)
    mixed = (1.0 - tips) * probability + tipped
    mean_rad = (probability * offset_rad).sum(axis=1, keepdims=True) / probability.sum(axis=0)
    part = tipped / mixed
    return Belief(mixed / mixed.sum(), (1.0 - part) * offset_rad + part * mean_rad, variance_rad2)


def _first_off(front_mm: float, rear_mm: float) -> float:
    """Probability that the front wheel of a diagonal lifts off before the rear one."""
    return 0.5 * (1.0 + math.tanh((rear_mm - front_mm) / _SURE_MM))


def _proved(
    design: ContactDesign, belief: Belief, twist_mm: float, lift_off_mm: Four, inputs: Inputs
) -> Belief:
    """A wheel that pushes has load: no less than its force over the most grip there is."""
    _, torque_nm = traction.measured(inputs)
    twist = design.grid_mm + twist_mm
    least = 1.0 / (design.config.grip_max * design.radius_m * design.stiffness_npmm)
    log = np.zeros(_CANDIDATES)
    for sign, torque, off in zip((1.0, -1.0, -1.0, 1.0), torque_nm, lift_off_mm, strict=True):
        missing = abs(torque) * least - design.config.push_noise_mm - np.maximum(off + sign * twist, 0.0)
        log -= 0.5 * (np.maximum(missing, 0.0) / design.config.push_noise_mm) ** 2
    if not log.any():
        return belief
    probability = belief.probability * np.exp(np.maximum(log, _LEAST_LOG))
    return replace(belief, probability=probability / probability.sum())


def _driven(design: ContactDesign, belief: Belief, track: TrackState, driven_m: float) -> Belief:
    """Let what was known of the ground fade into what its track tells, as new ground comes."""
    fade = 1.0 - math.exp(-driven_m / design.config.fade_m)
    if fade <= 0.0:
        return belief
    twist_mm, sigma_mm = ground_track.twist(design.track, track)
    ahead = (1.0 / _SIDES) * _bell(design.grid_mm, twist_mm, sigma_mm)
    return replace(belief, probability=(1.0 - fade) * belief.probability + fade * ahead)


# ---- result -----------------------------------------------------


def _found(design: ContactDesign, belief: Belief, twist_mm: float, lift_off_mm: Four) -> Contact:
    total = belief.probability.sum(axis=0)
    quantiles = np.interp([0.25, 0.5, 0.75], np.cumsum(total) - 0.5 * total, design.grid_mm)
    low_mm, middle_mm, high_mm = quantiles.tolist()
    excess = _excess_mm(design.grid_mm + twist_mm, lift_off_mm)
    low, high = (
        belief.probability[:, excess < 0.0].sum(axis=1),
        belief.probability[:, excess > 0.0].sum(axis=1),
    )
    fl, rr = float(low[0] + low[2]), float(low[1] + low[2])
    fr, rl = float(high[0] + high[2]), float(high[1] + high[2])
    return Contact(
        ground_warp_mm=middle_mm,
        sigma_mm=(high_mm - low_mm) / _QUARTILES_OF_SIGMA,
        hanging=(fl, fr, rl, rr),
        lifted=float(low.sum() - high.sum()),
        lift_off_mm=(-min(lift_off_mm[0], lift_off_mm[3]), min(lift_off_mm[1], lift_off_mm[2])),
    )


def _tent(grid_mm: Array, scale_mm: float) -> Array:
    """Two-sided exponential probabilities: most ground is nearly flat, some is not at all."""
    weight = np.exp(-np.abs(grid_mm) / scale_mm)
    expected: Array = weight / weight.sum()
    return expected


def _bell(grid_mm: Array, mean_mm: float, sigma_mm: float) -> Array:
    """Normal probabilities of the candidates, which add up to one."""
    weight = np.exp(-0.5 * ((grid_mm - mean_mm) / sigma_mm) ** 2)
    normal: Array = weight / weight.sum()
    return normal
