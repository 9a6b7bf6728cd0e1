"""Mass and place of what the robot carries, from the way it drives.

Three things give a load away, and one hides it:

* **Drive force.** On any slope, force over mass is what an accelerometer feels along the ground,

      (F - J a)/M = f_x + g d + c g sign(v),

  F from the motor currents, J the wheels' spin inertia, d the pitch of the body against the ground, c the
  rolling resistance. The ground's slope is not in it. This gives the mass M.
* **Tilt.** The springs give way: off the middle a load tilts the body against its wheels by its moment over
  the stiffness of the four corners, spring and tyre in series. The strokes' share of the tilt is known.
* **Starts, stops and turns** tilt the body by (specific force) x (mass x height): this gives the height. The
  wheels stay upright on the ground under a body that leans: their contacts go back by r d, which makes the
  springs stiffer by the robot's weight times r. What the motors spend on spinning up and on rolling presses
  the tail down besides.
* **The ground's slope** tilts the body as well. Rough ground averages out with the distance; a steady slope
  keeps its direction in the world, so it turns round under a robot that turns. And along x the tilt is in
  the drive force too. What this leaves: ahead and the mass are known after some starts and stops, the side
  only after a turn on ground of unknown cross slope, or on level ground. The standard deviations say it.

An extended Kalman filter on nine numbers, ten times a second: the payload's mass and its three first
moments, the ground's mean slope and its local deviation (each ahead and to the left), the rolling
resistance. The local deviation forgets itself over a length of ground; how large it is, is measured on the
way. At rest nothing is learned; a start with another tilt than the stop is another load, and all about the
load is open again. A measurement beyond three standard deviations, a kerb, counts as one of three.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tiger.control.reachable import Suspension
from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import LoadsConfig, RobotConfig
    from tiger.record import Three

    Array = NDArray[np.float64]

MASS, AHEAD, LEFT, UP, CLIMB, RISE, CLIMB_HERE, RISE_HERE, ROLLING = range(9)
"""The state: payload in kg, its moments m x, m y, m z about the empty body's COM in kg m; slopes of the
ground ahead (climbing +) and to the left (rising +), mean and local; rolling resistance."""
STATES = 9
UNKNOWN_M = 10.0
"""Standard deviation of a place that means nothing."""

_UPDATE_S = 0.1
_STANDS_M = 0.002
"""Wheels that turn no further in this time stand."""
_MOST_SIGMAS = 3.0
_SEGMENT_M = 0.3
_MEMORY_SEGMENTS = 10.0
"""How rough the ground is, is told from the last ten pieces of it."""
_FIRST_ROUGHNESS_RAD = math.radians(0.5)
_LEAST_ROUGHNESS_RAD = math.radians(0.05)


@dataclass(frozen=True, slots=True, eq=False)
class PayloadDesign:
    """What `design_payload` computes once; masses in kg, stiffnesses against the ground."""

    config: LoadsConfig
    suspension: Suspension
    body_kg: float
    empty_kg: float
    """Of the whole robot."""
    com_height_m: float
    lever_kgm: float
    """Moment of the empty robot's masses about the ground."""
    roll_nmprad: float
    pitch_nmprad: float
    heave_npm: float
    spin_kg: float
    """Spin inertia of the wheels over their radius squared."""
    radius_m: float
    turning_radps: float
    lag_s: float
    """Of the tilt behind the force: damping over stiffness."""
    mean: Array
    covariance: Array
    """(9, 9), before anything is known."""


@dataclass(frozen=True, slots=True)
class Sums:
    """What a tenth of a second gathers."""

    time_s: float = 0.0
    samples: int = 0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    posed_roll_rad: float = 0.0
    posed_pitch_rad: float = 0.0
    ahead_mps2: float = 0.0
    left_mps2: float = 0.0
    accel_mps2: float = 0.0
    ahead: float = 0.0
    """Samples that rolled ahead, less those that rolled back."""
    turned_rad: float = 0.0
    travelled_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Segment:
    """How rough the ground is: the variance of its local slope, and where a piece of it began."""

    variance_rad2: float = _FIRST_ROUGHNESS_RAD**2
    travelled_m: float = math.nan  # before the first piece
    climb_rad: float = 0.0
    rise_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PayloadState:
    """What a tick leaves to the next: mean (9,) and covariance (9, 9) of the filter, and what is gathered."""

    mean: Array
    covariance: Array
    began: bool = False
    ahead_mps2: float = 0.0
    """f_x, a, and wheel speed as the currents are read."""
    accel_mps2: float = 0.0
    speed_mps: float = 0.0
    tilting_mps2: tuple[float, float] = (0.0, 0.0)
    """f_x and f_y as the tilt follows them."""
    sums: Sums = Sums()
    segment: Segment = Segment()
    stood: bool = True
    """Nothing has moved in the last tenth of a second."""


class Measured(NamedTuple):
    """One sample: the body's tilt against its wheels, as far as the strokes leave it, forces and wheels."""

    roll_rad: float
    pitch_rad: float
    posed_roll_rad: float
    posed_pitch_rad: float
    """The strokes' own share of the tilt."""
    ahead_mps2: float
    left_mps2: float
    """Specific force along the body's x and y axes."""
    yaw_rate_radps: float
    wheels_mps: float
    drive_n: float
    """Sum of the four motors' torques over the radius, where `fresh`."""
    fresh: bool
    """The currents are a new reading."""
    gripping: bool


@dataclass(frozen=True, slots=True)
class Payload:
    """What is known of the load; `place_m` ahead, left and up of the empty body's COM, 0 without a load."""

    mass_kg: float = 0.0
    mass_sigma_kg: float = 0.0
    place_m: Three = (0.0, 0.0, 0.0)
    place_sigma_m: Three = (0.0, 0.0, 0.0)
    moment_kgm: Three = (0.0, 0.0, 0.0)
    moment_sigma_kgm: Three = (0.0, 0.0, 0.0)
    lever_kgm: float = 0.0
    """Sum of mass x height above the ground, of robot and load: what accelerations tilt it with."""
    upright_nmprad: float = 0.0
    """Weight x radius: what brings a leaning body back because its wheels stay upright."""
    rolling_resistance: float = 0.0


def design_payload(robot: RobotConfig) -> PayloadDesign:
    """Prepare the filter for one vehicle, empty as the config has it."""
    config, vehicle = robot.loads, robot.vehicle
    parameters = FullCarParameters.from_config(vehicle)
    spring, tyre = parameters.spring_npm(), parameters.tire_stiffness_npm
    corner = spring * tyre / (spring + tyre)
    x, y = parameters.corner_positions_m().T
    wheels_kg = float(parameters.wheel_mass_kg().sum())
    radius = vehicle.tire.rolling_radius_m
    mean = np.zeros(STATES)
    mean[ROLLING] = vehicle.tire.rolling_resistance
    return PayloadDesign(
        config=config,
        suspension=Suspension.from_config(robot),
        body_kg=parameters.body_mass_kg,
        empty_kg=parameters.body_mass_kg + wheels_kg,
        com_height_m=vehicle.body.com_height_m,
        lever_kgm=parameters.body_mass_kg * vehicle.body.com_height_m + wheels_kg * radius,
        roll_nmprad=float(corner @ y**2),
        pitch_nmprad=float(corner @ x**2),
        heave_npm=float(corner.sum()),
        spin_kg=4.0 * vehicle.tire.spin_inertia_kgm2 / radius**2,
        radius_m=radius,
        turning_radps=math.radians(config.turning_degps),
        lag_s=float((parameters.damper_nspm() / spring).mean()),
        mean=mean,
        covariance=_prior(config, vehicle.tire.rolling_resistance),
    )


def initial_state(design: PayloadDesign) -> PayloadState:
    """Nothing is known but what the config expects."""
    return PayloadState(design.mean, design.covariance)


def step(design: PayloadDesign, state: PayloadState, now: Measured, dt: float) -> PayloadState:
    """Advance by `dt` seconds: gather a sample, update with each reading of the currents and each 0.1 s."""
    fx, fy = now.ahead_mps2, now.left_mps2
    if state.began:
        quick, slow = dt / (dt + _CURRENT_LAG_S), dt / (dt + design.lag_s)
        ahead = state.ahead_mps2 + quick * (fx - state.ahead_mps2)
        accel = state.accel_mps2 + quick * ((now.wheels_mps - state.speed_mps) / dt - state.accel_mps2)
        before = state.tilting_mps2
        tilting = before[0] + slow * (fx - before[0]), before[1] + slow * (fy - before[1])
    else:
        ahead, accel, tilting = fx, 0.0, (fx, fy)
    mean, covariance = state.mean, state.covariance
    if now.fresh and _tells(design, now, ahead - tilting[0]):
        row, foretold = _driven(design, mean, now, tilting[0], accel)
        variance = design.config.force_noise_mps2**2
        mean, covariance = _corrected(mean, covariance, row, ahead - foretold, variance)
    sums = state.sums
    sums = Sums(
        sums.time_s + dt,
        sums.samples + 1,
        sums.roll_rad + now.roll_rad,
        sums.pitch_rad + now.pitch_rad,
        sums.posed_roll_rad + now.posed_roll_rad,
        sums.posed_pitch_rad + now.posed_pitch_rad,
        sums.ahead_mps2 + tilting[0],
        sums.left_mps2 + tilting[1],
        sums.accel_mps2 + accel,
        sums.ahead + _direction(design, now.wheels_mps),
        sums.turned_rad + dt * now.yaw_rate_radps,
        sums.travelled_m + dt * abs(now.wheels_mps),
    )
    segment, stood = state.segment, state.stood
    if sums.time_s >= _UPDATE_S:
        stands = sums.travelled_m < _STANDS_M
        if not stands or math.isnan(segment.travelled_m):
            mean, covariance, segment = _updated(design, mean, covariance, segment, sums, stood)
        sums, stood = Sums(), stands
    return PayloadState(mean, covariance, True, ahead, accel, now.wheels_mps, tilting, sums, segment, stood)


def payload(design: PayloadDesign, state: PayloadState) -> Payload:
    """What the state says of the load. A mass below zero is none."""
    m, *moments = state.mean[: UP + 1].tolist()
    rows = state.covariance[: UP + 1, : UP + 1].tolist()
    sigmas = [math.sqrt(rows[i][i]) for i in range(UP + 1)]
    place, spread = [0.0, 0.0, 0.0], [UNKNOWN_M, UNKNOWN_M, UNKNOWN_M]
    if m > sigmas[MASS]:  # else there may be none
        for axis, moment in enumerate(moments):
            at = moment / m
            variance = rows[axis + 1][axis + 1] - 2.0 * at * rows[0][axis + 1] + at * at * rows[0][0]
            place[axis], spread[axis] = at, min(UNKNOWN_M, math.sqrt(max(0.0, variance)) / m)
    x, y, z = moments
    return Payload(
        mass_kg=max(0.0, m),
        mass_sigma_kg=sigmas[0],
        place_m=(place[0], place[1], place[2]),
        place_sigma_m=(spread[0], spread[1], spread[2]),
        moment_kgm=(x, y, z),
        moment_sigma_kgm=(sigmas[1], sigmas[2], sigmas[3]),
        lever_kgm=_lever(design, state.mean)[0],
        upright_nmprad=_upright(design, state.mean),
        rolling_resistance=float(state.mean[ROLLING]),
    )


# ---- the filter ---------------------------------------------


_CURRENT_LAG_S = 0.02
"""A reading of the currents is so old when it arrives, or somewhat less."""


def _prior(config: LoadsConfig, rolling_resistance: float) -> Array:
    sigmas = np.zeros(STATES)
    sigmas[MASS] = config.payload_kg
    sigmas[[AHEAD, LEFT]] = config.payload_kg * config.payload_place_m
    sigmas[UP] = config.payload_kg * config.payload_height_spread_m
    sigmas[[CLIMB, RISE]] = math.radians(config.slope_deg)
    sigmas[[CLIMB_HERE, RISE_HERE]] = _FIRST_ROUGHNESS_RAD
    sigmas[ROLLING] = config.rolling_spread * rolling_resistance
    lies = np.eye(STATES)
    lies[UP, MASS] = config.payload_height_m  # on the deck, whatever its mass
    return lies @ np.diag(sigmas**2) @ lies.T


def _direction(design: PayloadDesign, speed_mps: float) -> float:
    """1 rolling ahead, -1 back, 0 at rest."""
    return math.copysign(1.0, speed_mps) if abs(speed_mps) > design.config.moving_mps else 0.0


def _tells(design: PayloadDesign, now: Measured, changing_mps2: float) -> bool:
    """Whether the drive forces say something of the mass: rolling steadily, straight on, without slip."""
    config = design.config
    steady = abs(now.wheels_mps) > config.moving_mps and abs(changing_mps2) < config.steady_mps2
    return steady and now.gripping and abs(now.yaw_rate_radps) < design.turning_radps


def _lever(design: PayloadDesign, mean: Array) -> tuple[float, float]:
    """Sum of mass x height above the ground in kg m, and how it grows with the payload's mass."""
    m, up = float(mean[MASS]), float(mean[UP])
    sag = GRAVITY_MPS2 / design.heave_npm  # the springs give way by this for each kilogram
    lever = design.lever_kgm + m * design.com_height_m + up - sag * m * (design.body_kg + m)
    return lever, design.com_height_m - sag * (design.body_kg + 2.0 * m)


def _driven(
    design: PayloadDesign,
    mean: Array,
    now: Measured,
    tilting_mps2: float,
    accel_mps2: float,
) -> tuple[Array, float]:
    """Foretell f_x from the drive force, and its derivatives (9,)."""
    mass = design.empty_kg + float(mean[MASS])
    ahead = math.copysign(1.0, now.wheels_mps)
    pulled = (now.drive_n - design.spin_kg * accel_mps2) / mass
    spent_nm = _spent_nm(design, mean, accel_mps2, ahead)
    row, pitch = _pressed_forward(design, mean, tilting_mps2, now.posed_pitch_rad, spent_nm)
    row *= -GRAVITY_MPS2
    row[MASS] -= pulled / mass
    row[ROLLING] = -GRAVITY_MPS2 * ahead
    rolling = GRAVITY_MPS2 * ahead * float(mean[ROLLING])
    return row, pulled - GRAVITY_MPS2 * (now.posed_pitch_rad + pitch) - rolling


def _updated(
    design: PayloadDesign, mean: Array, covariance: Array, segment: Segment, sums: Sums, stood: bool
) -> tuple[Array, Array, Segment]:
    """Let the ground pass by, then compare the body's tilt against its wheels with what is foretold."""
    config, n = design.config, float(sums.samples)
    mean, covariance = _moved(config, mean, covariance, segment, sums)
    fx, fy = sums.ahead_mps2 / n, sums.left_mps2 / n
    pitch, roll = sums.pitch_rad / n, sums.roll_rad / n
    variance = math.radians(config.attitude_noise_deg) ** 2
    posed_pitch, posed_roll = sums.posed_pitch_rad / n, sums.posed_roll_rad / n
    spent_nm = _spent_nm(design, mean, sums.accel_mps2 / n, sums.ahead / n)
    along, foretold = _pitched(design, mean, fx, posed_pitch, spent_nm)
    across, rolled = _rolled(design, mean, fy, posed_roll)
    if stood and (
        _beyond(covariance, along, pitch - foretold, variance, config.changed_sigmas)
        or _beyond(covariance, across, roll - rolled, variance, config.changed_sigmas)
    ):
        covariance = covariance + _open(design)
    mean, covariance = _corrected(mean, covariance, along, pitch - foretold, variance)
    across, rolled = _rolled(design, mean, fy, posed_roll)
    mean, covariance = _corrected(mean, covariance, across, roll - rolled, variance)
    lever, _ = _lever(design, mean)
    climb = -pitch - (fx * lever + spent_nm) / design.pitch_nmprad
    rise = roll - fy * lever / design.roll_nmprad
    return mean, covariance, _roughness(config, segment, sums.travelled_m, climb, rise)


def _pitched(
    design: PayloadDesign, mean: Array, fx: float, posed_rad: float, spent_nm: float
) -> tuple[Array, float]:
    """Derivatives (9,) of the pitch by ground and load, and the pitch itself beside the strokes' own."""
    row, pitch = _pressed_forward(design, mean, fx, posed_rad, spent_nm)
    row[CLIMB] = row[CLIMB_HERE] = -1.0
    return row, pitch - float(mean[CLIMB] + mean[CLIMB_HERE])


def _pressed_forward(
    design: PayloadDesign, mean: Array, fx: float, posed_rad: float, spent_nm: float
) -> tuple[Array, float]:
    """Derivatives (9,) of the pitch of the body on its springs, and this pitch itself."""
    lever, per_kg = _lever(design, mean)
    upright = _upright(design, mean)
    give = 1.0 / (design.pitch_nmprad + upright)
    row = np.zeros(STATES)
    row[AHEAD], row[MASS], row[UP] = GRAVITY_MPS2 * give, -fx * per_kg * give, -fx * give
    return row, give * (GRAVITY_MPS2 * float(mean[AHEAD]) - fx * lever - upright * posed_rad - spent_nm)


def _spent_nm(design: PayloadDesign, mean: Array, accel_mps2: float, ahead: float) -> float:
    """Torque of the motors that no force on the ground comes of: spinning the wheels up, and rolling them."""
    weight = GRAVITY_MPS2 * (design.empty_kg + float(mean[MASS]))
    return design.radius_m * (design.spin_kg * accel_mps2 + ahead * float(mean[ROLLING]) * weight)


def _rolled(design: PayloadDesign, mean: Array, fy: float, posed_rad: float) -> tuple[Array, float]:
    """Derivatives (9,) of the roll by ground and load, and the roll itself beside the strokes' own."""
    lever, per_kg = _lever(design, mean)
    upright = _upright(design, mean)
    give = 1.0 / (design.roll_nmprad + upright)
    row = np.zeros(STATES)
    row[RISE] = row[RISE_HERE] = 1.0
    row[LEFT], row[MASS], row[UP] = -GRAVITY_MPS2 * give, fy * per_kg * give, fy * give
    rise = float(mean[RISE] + mean[RISE_HERE])
    return row, rise + give * (fy * lever - GRAVITY_MPS2 * float(mean[LEFT]) - upright * posed_rad)


def _upright(design: PayloadDesign, mean: Array) -> float:
    """Moment in Nm/rad that brings a leaning body back because its wheels stay upright."""
    return GRAVITY_MPS2 * design.radius_m * (design.empty_kg + float(mean[MASS]))


def _open(design: PayloadDesign) -> Array:
    """What another load adds to the covariance (9, 9)."""
    more = np.zeros((STATES, STATES))
    more[: UP + 1, : UP + 1] = design.covariance[: UP + 1, : UP + 1]
    return more


def _moved(
    config: LoadsConfig, mean: Array, covariance: Array, segment: Segment, sums: Sums
) -> tuple[Array, Array]:
    """New ground, seen from another heading."""
    if sums.travelled_m == 0.0 == sums.turned_rad:
        return mean, covariance
    cos, sin = math.cos(sums.turned_rad), math.sin(sums.turned_rad)
    keep = math.exp(-sums.travelled_m / config.slope_length_m)
    passed = np.eye(STATES)
    passed[CLIMB, CLIMB] = passed[RISE, RISE] = cos
    passed[CLIMB, RISE], passed[RISE, CLIMB] = sin, -sin
    passed[CLIMB_HERE, CLIMB_HERE] = passed[RISE_HERE, RISE_HERE] = keep
    covariance = passed @ covariance @ passed.T
    drift = math.radians(config.slope_drift_deg) ** 2 * sums.travelled_m
    covariance[CLIMB, CLIMB] += drift
    covariance[RISE, RISE] += drift
    new = segment.variance_rad2 * (1.0 - keep * keep)
    covariance[CLIMB_HERE, CLIMB_HERE] += new
    covariance[RISE_HERE, RISE_HERE] += new
    return passed @ mean, covariance


def _corrected(
    mean: Array, covariance: Array, row: Array, off: float, variance: float
) -> tuple[Array, Array]:
    """Correct by one measurement that is `off` from what was foretold."""
    toward = covariance @ row
    expected = float(row @ toward) + variance
    most = _MOST_SIGMAS * math.sqrt(expected)
    return mean + min(most, max(-most, off)) / expected * toward, covariance - np.outer(
        toward, toward / expected
    )


def _beyond(covariance: Array, row: Array, off: float, variance: float, sigmas: float) -> bool:
    return off * off > sigmas * sigmas * (float(row @ covariance @ row) + variance)


def _roughness(
    config: LoadsConfig, segment: Segment, travelled_m: float, climb_rad: float, rise_rad: float
) -> Segment:
    """Learn from how much the slope has changed over a piece of the way how rough the ground is."""
    if math.isnan(segment.travelled_m):
        return Segment(segment.variance_rad2, 0.0, climb_rad, rise_rad)
    travelled_m += segment.travelled_m
    if travelled_m < _SEGMENT_M:
        return Segment(segment.variance_rad2, travelled_m, segment.climb_rad, segment.rise_rad)
    squares = (climb_rad - segment.climb_rad) ** 2 + (rise_rad - segment.rise_rad) ** 2
    alike = math.exp(-travelled_m / config.slope_length_m)
    variance = (
        segment.variance_rad2 + (0.25 * squares / (1.0 - alike) - segment.variance_rad2) / _MEMORY_SEGMENTS
    )
    return Segment(max(_LEAST_ROUGHNESS_RAD**2, variance), 0.0, climb_rad, rise_rad)
