"""Mass and place of what the robot carries, from the way it drives.

Three things give a load away, and one hides it:

* **Drive force.** On any slope, force over mass is what the robot gains in speed and height,

      (F - J w')/M = a + g (climb) + c g sign(v),

  F from the motor currents, J w' for the wheels' own spin, c the rolling resistance. The acceleration a of
  the centre of all masses comes from the accelerometer, whose place is above it, with the pitch against
  gravity: a body that pitches on its springs carries its accelerometer to and fro. This gives the mass M.
* **Tilt.** The springs give way: off the middle a load tilts the body against its wheels by its moment over
  the stiffness of the four corners, spring and tyre in series. The strokes' share of the tilt is known.
* **Starts, stops and turns** tilt the body by (specific force) x (mass x height): this gives the height. The
  wheels stay upright on the ground under a body that leans: their contacts go back by r d, which makes the
  springs stiffer by the robot's weight times r. What the motors spend on spinning up and on rolling presses
  the tail down besides. And where the left wheels push and the right ones hold back, as they do in a turn and
  for some metres after it, the tyres' side forces that answer them act in front at another height under a
  pitched body than behind: their moment times the pitch is a moment about the roll axis, and under a leaning
  body times the roll about the pitch axis. The wheels' spin, turned round in a turn, leans the body outward.
* **The ground's slope** tilts the body as well. Rough ground averages out with the distance; a steady slope
  keeps its direction in the world, so it turns round under a robot that turns. And along x it is in the drive
  force too. What this leaves: ahead and the mass are known after some starts and stops, the side only after a
  turn on ground of unknown cross slope, or on level ground. The standard deviations say it.

An extended Kalman filter on nine numbers, four times a second: the payload's mass and its three first
moments, the ground's mean slope and its local deviation (each ahead and to the left), the rolling
resistance. The local deviation forgets itself over a length of ground; how large it is, is measured on the
way. Forces and motion are compared by their means from one reading of the currents to another: springs
swing and speed loops settle in between, and the means do not care. At rest nothing is learned; a start with
another tilt than the stop is another load, and all about the load is open again. A drive force that nothing
explains is soft ground: its resistance is open. A measurement beyond three standard deviations, a kerb,
counts as one of three.
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

_UPDATE_S = 0.2
"""An update comes with the first reading of the currents after this time, or after twice as long."""
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
    spin_kgm: float
    """And over their radius: torque for each m/s2, and what a turn takes for each m/s and rad/s."""
    radius_m: float
    imu_height_m: float
    """Above the ground."""
    turning_radps: float
    lag_s: float
    """Of the tilt behind the force: damping over stiffness."""
    mean: Array
    covariance: Array
    """(9, 9), before anything is known."""


@dataclass(frozen=True, slots=True)
class Span:
    """What is gathered from one update to the next: where it began, and sums over its samples."""

    from_radps: float
    """Pitch rate and drive force when it began."""
    from_n: float
    tells: bool
    """It began with a reading of the currents, and the robot has rolled straight on since."""
    time_s: float = 0.0
    samples: int = 0
    readings: int = 0
    """Of the currents."""
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    posed_roll_rad: float = 0.0
    posed_pitch_rad: float = 0.0
    ahead_mps2: float = 0.0
    """Of the accelerometer as it is, then as the tilt follows it."""
    tilting_ahead_mps2: float = 0.0
    tilting_left_mps2: float = 0.0
    drive_n: float = 0.0
    yaw_nm: float = 0.0
    direction: float = 0.0
    """Samples that rolled ahead, less those that rolled back."""
    turned_rad: float = 0.0
    travelled_m: float = 0.0


NO_SPAN = Span(math.nan, 0.0, tells=False)
"""Nothing was gathered yet."""


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
    span: Span = NO_SPAN
    tilting_mps2: tuple[float, float] = (0.0, 0.0)
    """f_x and f_y as the tilt follows them."""
    drive_n: float = 0.0
    """Last reading."""
    yaw_nm: float = 0.0
    segment: Segment = Segment()
    stood: bool = True
    """Nothing has moved up to the last update."""


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
    pitch_rate_radps: float
    yaw_rate_radps: float
    wheels_mps: float
    drive_n: float
    """Sum of the four motors' torques over the radius, where `fresh`."""
    yaw_nm: float
    """Moment to the right of the left wheels' forces and the right ones', where `fresh`."""
    fresh: bool
    """The currents are a new reading."""
    straight: bool
    """The wheels neither slip nor turn the robot."""


@dataclass(frozen=True, slots=True)
class Payload:
    """What is known of the load; `place_m` ahead, left and up of the empty body's COM, 0 without a load."""

    mass_kg: float = 0.0
    mass_sigma_kg: float = 0.0
    place_m: Three = (0.0, 0.0, 0.0)
    place_sigma_m: Three = (0.0, 0.0, 0.0)
    moment_kgm: Three = (0.0, 0.0, 0.0)
    moment_sigma_kgm: Three = (0.0, 0.0, 0.0)
    com_m: Three = (0.0, 0.0, 0.0)
    """Of body and load, from the empty body's."""
    com_sigma_m: Three = (0.0, 0.0, 0.0)
    lever_kgm: float = 0.0
    """Sum of mass x height above the ground, of robot and load: what accelerations tilt it with."""
    upright_nmprad: float = 0.0
    """Weight x radius: what brings a leaning body back because its wheels stay upright."""
    rolling_nm: float = 0.0
    """Torque that rolling takes: it presses the tail down."""


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
        spin_kgm=4.0 * vehicle.tire.spin_inertia_kgm2 / radius,
        radius_m=radius,
        imu_height_m=vehicle.body.com_height_m + vehicle.imu_offset_m[2],
        turning_radps=math.radians(config.turning_degps),
        lag_s=float((parameters.damper_nspm() / spring).mean()),
        mean=mean,
        covariance=_prior(config, vehicle.tire.rolling_resistance),
    )


def initial_state(design: PayloadDesign) -> PayloadState:
    """Nothing is known but what the config expects."""
    return PayloadState(design.mean, design.covariance)


def step(design: PayloadDesign, state: PayloadState, now: Measured, dt: float) -> PayloadState:
    """Advance by `dt` seconds: gather a sample, and update when enough is gathered."""
    fx, fy = now.ahead_mps2, now.left_mps2
    begun, wheels_mps = state.span, now.wheels_mps
    if math.isnan(begun.from_radps):
        span = Span(now.pitch_rate_radps, 0.0, tells=False)
        return PayloadState(state.mean, state.covariance, span, (fx, fy))
    share = dt / (dt + design.lag_s)
    ahead, left = state.tilting_mps2
    ahead, left = ahead + share * (fx - ahead), left + share * (fy - left)
    direction = 0.0
    if abs(wheels_mps) > design.config.moving_mps:
        direction = 1.0 if wheels_mps > 0.0 else -1.0
    span = Span(
        begun.from_radps,
        begun.from_n,
        begun.tells and direction != 0.0 and now.straight,
        begun.time_s + dt,
        begun.samples + 1,
        begun.readings + now.fresh,
        begun.roll_rad + now.roll_rad,
        begun.pitch_rad + now.pitch_rad,
        begun.posed_roll_rad + now.posed_roll_rad,
        begun.posed_pitch_rad + now.posed_pitch_rad,
        begun.ahead_mps2 + fx,
        begun.tilting_ahead_mps2 + ahead,
        begun.tilting_left_mps2 + left,
        begun.drive_n + state.drive_n,
        begun.yaw_nm + state.yaw_nm,
        begun.direction + direction,
        begun.turned_rad + dt * now.yaw_rate_radps,
        begun.travelled_m + dt * abs(wheels_mps),
    )
    drive_n, yaw_nm = (now.drive_n, now.yaw_nm) if now.fresh else (state.drive_n, state.yaw_nm)
    mean, covariance, segment, stood = state.mean, state.covariance, state.segment, state.stood
    if span.time_s >= (_UPDATE_S if now.fresh else 2.0 * _UPDATE_S):
        stands = span.travelled_m < _STANDS_M
        if not stands or math.isnan(segment.travelled_m):
            means = _means(design, span, now, drive_n)
            mean, covariance, segment = _updated(design, mean, covariance, segment, means, stood)
        span, stood = Span(now.pitch_rate_radps, drive_n, now.fresh), stands
    return PayloadState(mean, covariance, span, (ahead, left), drive_n, yaw_nm, segment, stood)


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
    mass_kg, (_, sx, sy, sz) = max(0.0, m), sigmas
    body_kg = design.body_kg + mass_kg
    return Payload(
        mass_kg=mass_kg,
        mass_sigma_kg=sigmas[0],
        place_m=(place[0], place[1], place[2]),
        place_sigma_m=(spread[0], spread[1], spread[2]),
        moment_kgm=(x, y, z),
        moment_sigma_kgm=(sx, sy, sz),
        com_m=(x / body_kg, y / body_kg, z / body_kg),
        com_sigma_m=(sx / body_kg, sy / body_kg, sz / body_kg),
        lever_kgm=_lever(design, state.mean)[0],
        upright_nmprad=_upright(design, state.mean),
        rolling_nm=_rolling_nm(design, state.mean),
    )


# ---- the filter ---------------------------------------------


_CURRENT_LAG_S = 0.02
"""A reading of the currents is so old when it arrives, or somewhat less."""


class _Means(NamedTuple):
    """A span's means, and what it adds up to."""

    roll_rad: float
    pitch_rad: float
    posed_roll_rad: float
    posed_pitch_rad: float
    tilting_ahead_mps2: float
    tilting_left_mps2: float
    turn_radps2: float
    """Acceleration of the pitch."""
    gained_mps2: float
    """Acceleration at the accelerometer's place, along the body's x axis."""
    spin_mps2: float
    """Acceleration of the wheels' centres, which is that of their spin."""
    drive_n: float
    yaw_nm: float
    direction: float
    turned_rad: float
    travelled_m: float
    gyroscopic_nm: float
    """Moment of the spinning wheels that a turn leans the body with, to the right in a turn to the left."""
    tells: bool
    """The drive force tells of the mass."""


def _means(design: PayloadDesign, span: Span, now: Measured, drive_n: float) -> _Means:
    """A reading of the currents stands until the next one: its mean is that of half an interval before."""
    n, time = float(span.samples), span.time_s
    pitch, posed = span.pitch_rad / n, span.posed_pitch_rad / n
    turn = (now.pitch_rate_radps - span.from_radps) / time
    gained = span.ahead_mps2 / n + GRAVITY_MPS2 * math.sin(pitch + posed)
    late = _CURRENT_LAG_S / time + 0.5 / max(1, span.readings)
    return _Means(
        span.roll_rad / n,
        pitch,
        span.posed_roll_rad / n,
        posed,
        span.tilting_ahead_mps2 / n,
        span.tilting_left_mps2 / n,
        turn,
        gained,
        gained - (design.imu_height_m - design.radius_m) * turn,
        span.drive_n / n + late * (drive_n - span.from_n),
        span.yaw_nm / n,
        span.direction / n,
        span.turned_rad,
        span.travelled_m,
        design.spin_kgm * span.direction / n * span.travelled_m / time * span.turned_rad / time,
        span.tells and now.fresh,
    )


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


def _lever(design: PayloadDesign, mean: Array) -> tuple[float, float]:
    """Sum of mass x height above the ground in kg m, and how it grows with the payload's mass."""
    m, up = float(mean[MASS]), float(mean[UP])
    sag = GRAVITY_MPS2 / design.heave_npm  # the springs give way by this for each kilogram
    lever = design.lever_kgm + m * design.com_height_m + up - sag * m * (design.body_kg + m)
    return lever, design.com_height_m - sag * (design.body_kg + 2.0 * m)


def _driven(design: PayloadDesign, mean: Array, seen: _Means) -> tuple[Array, float]:
    """Derivatives (9,) of the acceleration by load, ground and resistance; the drive force foretells it."""
    mass = design.empty_kg + float(mean[MASS])
    pulled = (seen.drive_n - design.spin_kg * seen.spin_mps2) / mass
    row = np.zeros(STATES)
    row[MASS] = -pulled / mass
    row[CLIMB] = row[CLIMB_HERE] = -GRAVITY_MPS2
    row[ROLLING] = -GRAVITY_MPS2 * seen.direction
    return row, pulled + float(row[CLIMB:] @ mean[CLIMB:])


def _gained_mps2(design: PayloadDesign, mean: Array, seen: _Means) -> float:
    """Acceleration of the centre of all masses along the body's x axis."""
    height = _lever(design, mean)[0] / (design.empty_kg + float(mean[MASS]))
    return seen.gained_mps2 - (design.imu_height_m - height) * seen.turn_radps2


def _updated(
    design: PayloadDesign, mean: Array, covariance: Array, segment: Segment, seen: _Means, stood: bool
) -> tuple[Array, Array, Segment]:
    """Let the ground pass by, then compare tilt against the wheels and acceleration with what is foretold."""
    config = design.config
    mean, covariance = _moved(config, mean, covariance, segment, seen.turned_rad, seen.travelled_m)
    fx, fy = seen.tilting_ahead_mps2, seen.tilting_left_mps2
    variance = math.radians(config.attitude_noise_deg) ** 2
    # Torque of the motors that no force on the ground comes of: spinning the wheels up, and rolling them.
    spent_nm = design.spin_kgm * seen.spin_mps2 + seen.direction * _rolling_nm(design, mean)
    along, foretold = _pitched(design, mean, seen, spent_nm)
    across, rolled = _rolled(design, mean, seen, spent_nm)
    if stood and (
        _beyond(covariance, along, seen.pitch_rad - foretold, variance, config.changed_sigmas)
        or _beyond(covariance, across, seen.roll_rad - rolled, variance, config.changed_sigmas)
    ):
        covariance = covariance + _open(design)
    mean, covariance = _corrected(mean, covariance, along, seen.pitch_rad - foretold, variance)
    across, rolled = _rolled(design, mean, seen, spent_nm)
    mean, covariance = _corrected(mean, covariance, across, seen.roll_rad - rolled, variance)
    if seen.tells:
        row, pulled = _driven(design, mean, seen)
        off, variance = _gained_mps2(design, mean, seen) - pulled, config.force_noise_mps2**2
        if _beyond(covariance, row, off, variance, config.changed_sigmas):
            covariance = covariance + _open(design)
            covariance[ROLLING, ROLLING] += config.soft_resistance**2
        mean, covariance = _corrected(mean, covariance, row, off, variance)
    lever, _ = _lever(design, mean)
    climb = -seen.pitch_rad - (fx * lever + spent_nm) / design.pitch_nmprad
    rise = seen.roll_rad - fy * lever / design.roll_nmprad
    return mean, covariance, _roughness(config, segment, seen.travelled_m, climb, rise)


def _pitched(design: PayloadDesign, mean: Array, seen: _Means, spent_nm: float) -> tuple[Array, float]:
    """Derivatives (9,) of the pitch by ground and load, and the pitch itself beside the strokes' own."""
    lean = seen.posed_roll_rad + _leant(design, mean, seen)
    spent_nm += seen.yaw_nm * lean
    row, pitch = _pressed_forward(design, mean, seen.tilting_ahead_mps2, seen.posed_pitch_rad, spent_nm)
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


def _leant(design: PayloadDesign, mean: Array, seen: _Means) -> float:
    """Roll of the body on its springs, as long as it does not pitch."""
    upright = _upright(design, mean)
    moment = seen.tilting_left_mps2 * _lever(design, mean)[0] - GRAVITY_MPS2 * float(mean[LEFT])
    moment += seen.gyroscopic_nm - upright * seen.posed_roll_rad
    return moment / (design.roll_nmprad + upright)


def _rolling_nm(design: PayloadDesign, mean: Array) -> float:
    """Torque of the motors that rolling takes."""
    weight = GRAVITY_MPS2 * (design.empty_kg + float(mean[MASS]))
    return design.radius_m * float(mean[ROLLING]) * weight


def _rolled(design: PayloadDesign, mean: Array, seen: _Means, spent_nm: float) -> tuple[Array, float]:
    """Derivatives (9,) of the roll by ground and load, and the roll itself beside the strokes' own."""
    fx, fy = seen.tilting_ahead_mps2, seen.tilting_left_mps2
    per_kg = _lever(design, mean)[1]
    give = 1.0 / (design.roll_nmprad + _upright(design, mean))
    row = np.zeros(STATES)
    row[RISE] = row[RISE_HERE] = 1.0
    row[LEFT], row[MASS], row[UP] = -GRAVITY_MPS2 * give, fy * per_kg * give, fy * give
    pitch = _pressed_forward(design, mean, fx, seen.posed_pitch_rad, spent_nm)[1] + seen.posed_pitch_rad
    rolled = _leant(design, mean, seen) - give * seen.yaw_nm * pitch
    return row, float(mean[RISE] + mean[RISE_HERE]) + rolled


def _upright(design: PayloadDesign, mean: Array) -> float:
    """Moment in Nm/rad that brings a leaning body back because its wheels stay upright."""
    return GRAVITY_MPS2 * design.radius_m * (design.empty_kg + float(mean[MASS]))


def _open(design: PayloadDesign) -> Array:
    """What another load adds to the covariance (9, 9)."""
    more = np.zeros((STATES, STATES))
    more[: UP + 1, : UP + 1] = design.covariance[: UP + 1, : UP + 1]
    return more


def _moved(
    config: LoadsConfig,
    mean: Array,
    covariance: Array,
    segment: Segment,
    turned_rad: float,
    travelled_m: float,
) -> tuple[Array, Array]:
    """New ground, seen from another heading."""
    if travelled_m == 0.0 == turned_rad:
        return mean, covariance
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    keep = math.exp(-travelled_m / config.slope_length_m)
    passed = _SAME.copy()
    passed[CLIMB, CLIMB] = passed[RISE, RISE] = cos
    passed[CLIMB, RISE], passed[RISE, CLIMB] = sin, -sin
    passed[CLIMB_HERE, CLIMB_HERE] = passed[RISE_HERE, RISE_HERE] = keep
    covariance = passed @ covariance @ passed.T
    drift = math.radians(config.slope_drift_deg) ** 2 * travelled_m
    new = segment.variance_rad2 * (1.0 - keep * keep)
    for mean_slope, here in ((CLIMB, CLIMB_HERE), (RISE, RISE_HERE)):
        covariance[mean_slope, mean_slope] += drift
        covariance[here, here] += new
    return passed @ mean, covariance


_SAME = np.eye(STATES)


def _corrected(
    mean: Array, covariance: Array, row: Array, off: float, variance: float
) -> tuple[Array, Array]:
    """Correct by one measurement that is `off` from what was foretold."""
    toward = covariance @ row
    expected = float(row @ toward) + variance
    most = _MOST_SIGMAS * math.sqrt(expected)
    gain = toward / expected
    return mean + min(most, max(-most, off)) * gain, covariance - toward[:, None] * gain


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
