"""Chapter 6: a Kalman filter on one noisy IMU and a linear-quadratic regulator over what it estimates.

Measured are [heave acceleration at the IMU, pitch rate, roll rate]. The filter estimates the 14 states of the
car and the road: four independent wheel roads, or fewer of which one wheel shows another its road a while
later: front to rear along a track (preview), or one lane to the other where waves lie askew (lane lag). The
regulator weighs body accelerations and rates, suspension and tyre deflections, and forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag, expm

from tiger.control.lqr import dlqr, output_weights
from tiger.estimation.kalman import steady_state_gain
from tiger.models.full_car import (
    BODY_ACCELERATION,
    BODY_RATE,
    FORCE,
    IMU,
    ROAD,
    SUSPENSION,
    TIRE,
    full_car,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.models.full_car import FullCarParameters
    from tiger.models.linear import LinearModel

    Array = NDArray[np.float64]

PERIOD_S = 0.005
CAR_STATES = 14
REGULATED = (*BODY_ACCELERATION, *BODY_RATE, *SUSPENSION, *TIRE)


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Standard deviation per sample of the accelerometer and of the two gyros."""

    accel_mps2: float = 0.02
    rate_radps: float = 0.001

    def scaled(self, factor: float) -> ImuNoise:
        """Return the same IMU with `factor` times the noise."""
        return ImuNoise(self.accel_mps2 * factor, self.rate_radps * factor)

    def covariance(self) -> Array:
        """Return the measurement covariance, shape (3, 3)."""
        return np.diag([self.accel_mps2, self.rate_radps, self.rate_radps]) ** 2


@dataclass(frozen=True, slots=True)
class RoadPrior:
    """What the filter believes of a road: q' = v - leak q, with the rate v of the road a shaped white noise.

    damping None: v' = bandwidth (noise w - v), w white of unit intensity. Otherwise v is of second order with
    natural frequency `bandwidth_radps`, v'' = bandwidth^2 (noise w - v) - 2 damping bandwidth v': below 1 a
    swell with a preferred wavelength, whose slope has no steps.
    `noise` (m/sqrt(s)) is the road rate's density well below `bandwidth_radps`; a class C road at 10 m/s has
    0.0225.
    """

    noise: float
    leak_radps: float
    bandwidth_radps: float
    lane_correlation: float = 0.0
    """Between the noise of the left and of the right lane: 0 for two roads, near 1 for bumps across the
    road."""
    axle_correlation: float = 0.0
    """Between the noise at the front and at the rear axle, where no preview joins them."""
    damping: float | None = None

    def dynamics(self) -> tuple[Array, Array]:
        """Return A (n, n) and the noise input (n,) of [q, v] or [q, v, v']."""
        leak, w = self.leak_radps, self.bandwidth_radps
        if self.damping is None:
            return np.array([[-leak, 1.0], [0.0, -w]]), np.array([0.0, w * self.noise])
        a = np.array([[-leak, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -(w**2), -2 * self.damping * w]])
        return a, np.array([0.0, 0.0, w**2 * self.noise])


@dataclass(frozen=True, slots=True)
class RideWeights:
    """Cost of the square of each quantity, relative to (m/s^2)^2 of heave acceleration.

    Accelerations per (rad/s^2)^2, rates per (m/s)^2 and (rad/s)^2, deflections per m^2, force per N^2.
    """

    pitch_accel: float
    roll_accel: float
    heave_rate: float
    pitch_rate: float
    roll_rate: float
    suspension_front: float
    suspension_rear: float
    tire_front: float
    tire_rear: float
    force: float
    heave_accel: float = 1.0

    def of_outputs(self) -> Array:
        """Return the weights in the order of REGULATED, shape (14,)."""
        deflection = np.repeat(
            [self.suspension_front, self.suspension_rear, self.tire_front, self.tire_rear], 2
        )
        body = [self.heave_accel, self.pitch_accel, self.roll_accel]
        rates = [self.heave_rate, self.pitch_rate, self.roll_rate]
        return np.concatenate([body, rates, deflection])


@dataclass(frozen=True, slots=True, eq=False)
class RideModel:
    """The car on its road, sampled: s = [car (14), road], s[k+1] = A s + B F + w, IMU = C s + D F, regulated
    = H s + J F.

    F acts from one sample to the next. The road part is out of reach of F. `process` is the covariance of w.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    h: Array
    j: Array
    process: Array
    period_s: float


@dataclass(frozen=True, slots=True, eq=False)
class RideController:
    """Gains of filter and regulator over `model`, and how late its force acts.

    innovation (3, 3) is the covariance that the filter expects of its innovations.
    delay_samples 0: the force computed from a measurement acts at once; 1: it acts a period later, and the
    regulator works on the state predicted for that time.
    """

    model: RideModel
    filter_gain: Array
    feedback: Array
    innovation: Array
    delay_samples: int = 0
    max_force_n: float = np.inf

    def start(self, runs: int | None = None) -> RideState:
        """Return the state of a controller that knows nothing yet, or of `runs` of them side by side."""
        tail = () if runs is None else (runs,)
        return RideState(np.zeros((len(self.model.a), *tail)), np.zeros((4, *tail)), np.zeros((4, *tail)))

    def step(self, state: RideState, imu: Array) -> tuple[RideState, Array]:
        """Take one measurement; see the function `step`."""
        return step(self, state, imu)


@dataclass(frozen=True, slots=True, eq=False)
class RideState:
    """Model state predicted for the next measurement, the force acting until then, and the one to act after
    it."""

    predicted: Array
    acting_n: Array
    pending_n: Array


def step(controller: RideController, state: RideState, imu: Array) -> tuple[RideState, Array]:
    """Take one measurement [heave accel, pitch rate, roll rate] and return the new state and the force, N.

    imu is (3,) and the force (4,), or (3, runs) and (4, runs) for runs side by side. (6.22)-(6.23) with the
    gain in filter form. The force is limited to `max_force_n`, and the filter knows the limited one.
    """
    model, limit = controller.model, controller.max_force_n
    innovation = imu - model.c @ state.predicted - model.d @ state.acting_n
    estimate = state.predicted + controller.filter_gain @ innovation
    if controller.delay_samples:
        acting = state.pending_n
        predicted = model.a @ estimate + model.b @ acting
        force = np.clip(-controller.feedback @ predicted, -limit, limit)
    else:
        acting = force = np.clip(-controller.feedback @ estimate, -limit, limit)
        predicted = model.a @ estimate + model.b @ force
    return RideState(predicted, acting, force), force


def ride_model(
    p: FullCarParameters,
    prior: RoadPrior,
    preview_s: float | None = None,
    imu_offset_m: tuple[float, float] = (0.0, 0.0),
    period_s: float = PERIOD_S,
    lane_lag_s: float | None = None,
) -> RideModel:
    """Sample the car together with its road.

    preview_s and lane_lag_s None: four independent roads. preview_s: two tracks, and each rear wheel meets
    its track `preview_s` after the front wheel. lane_lag_s: what one lane meets the other meets
    `abs(lane_lag_s)` later, the right one if positive, the left one if negative. Delays need not be whole
    numbers of samples, but must be at least one.
    """
    car = full_car(p, imu_offset_m)
    imu = car.select(inputs=FORCE, outputs=IMU)
    regulated = car.select(inputs=(*ROAD, *FORCE), outputs=REGULATED)
    leads, delays = _delays(preview_s, lane_lag_s, period_s)
    late = [wheel for wheel in range(4) if wheel not in leads]
    a, from_late, noise, height = _car_on_roads(car, prior, leads, late)
    size = len(a)
    forces = np.vstack([imu.b, np.zeros((size - CAR_STATES, 4))])
    transition, constant, ramp = hold(a, np.hstack([forces, from_late]), period_s)
    shift, now, then = _tapped(height, size, delays, late, period_s)
    shift[:size, :size] = transition
    shift[:size] += (constant[:, 4:] - ramp[:, 4:]) @ now[late] + ramp[:, 4:] @ then[late]
    remembered = len(shift) - size
    b = np.vstack([constant[:, :4], np.zeros((remembered, 4))])
    process = block_diag(_sampled_noise(a, noise @ noise.T, period_s), np.zeros((remembered, remembered)))
    return _assemble(shift, b, imu, regulated, now, process, period_s)


def _car_on_roads(
    car: LinearModel, prior: RoadPrior, leads: list[int], late: list[int]
) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Join car and shaping filters to one continuous system: the road is then exact between the samples.

    Returns its matrix (n, n), what the heights under the late wheels do to it (n, late), the factor of its
    noise (n, leads), and the places of the leading wheels' heights among its states (leads,).
    """
    track, drive = prior.dynamics()
    order, sources = len(track), len(leads)
    size = CAR_STATES + order * sources
    height = np.arange(CAR_STATES, size, order)
    to_wheels = car.select(inputs=ROAD).b
    a, noise = np.zeros((size, size)), np.zeros((size, sources))
    a[:CAR_STATES, :CAR_STATES] = car.a
    a[:CAR_STATES, height] = to_wheels[:, leads]
    a[CAR_STATES:, CAR_STATES:] = np.kron(np.eye(sources), track)
    together = np.kron(_joint_noise(prior.axle_correlation), _joint_noise(prior.lane_correlation))
    covariance = (together @ together.T)[np.ix_(leads, leads)]
    noise[CAR_STATES:] = np.kron(np.linalg.cholesky(covariance), drive[:, None])
    from_late = np.zeros((size, len(late)))
    from_late[:CAR_STATES] = to_wheels[:, late]
    return a, from_late, noise, height


def _tapped(
    height: NDArray[np.intp], size: int, delays: list[tuple[int, float]], late: list[int], period_s: float
) -> tuple[Array, Array, Array]:
    """Remember the heights that late wheels will meet: tap j of a source holds its height j samples ago.

    Returns the shift of the taps (n, n), where n counts `size` states and the taps after them, and the
    heights under the wheels, (4, n) each, now and a sample later. A late wheel lies between two taps.
    """
    depth = int(max(delay for _, delay in delays) / period_s)
    taps = depth + 1 if late else 0
    total = size + len(height) * taps
    shift, now, then = np.zeros((total, total)), np.zeros((4, total)), np.zeros((4, total))
    lines = [np.r_[first, size + i * taps + np.arange(taps)] for i, first in enumerate(height)]
    for line in lines:
        shift[line[1:], line[:-1]] = 1.0
    for wheel, (source, delay) in enumerate(delays):
        whole, part = divmod(delay / period_s, 1.0)
        tap, line = int(whole), lines[source]
        if wheel in late:
            now[wheel, line[tap : tap + 2]] = 1 - part, part
            then[wheel, line[tap - 1 : tap + 1]] = 1 - part, part
        else:
            now[wheel, line[0]] = 1.0
    return shift, now, then


def _delays(
    preview_s: float | None, lane_lag_s: float | None, period_s: float
) -> tuple[list[int], list[tuple[int, float]]]:
    """Return the wheels with a road of their own, and for every wheel which of those roads it meets and how
    late."""
    for name, delay in (("preview", preview_s), ("lane lag", lane_lag_s)):
        if delay is not None and abs(delay) < period_s:
            raise ValueError(f"the {name} of {delay} s is shorter than one period of {period_s} s")
    lag = lane_lag_s or 0.0
    lane_delay, axle_delay = (max(0.0, -lag), max(0.0, lag)), (0.0, preview_s or 0.0)
    leading_lanes = [lane for lane in (0, 1) if lane_delay[lane] == 0]
    leading_axles = [axle for axle in (0, 1) if axle_delay[axle] == 0]
    leads = [2 * axle + lane for axle in leading_axles for lane in leading_lanes]
    delays = []
    for wheel in range(4):
        axle, lane = divmod(wheel, 2)
        leader = 2 * (axle if axle in leading_axles else 0) + (
            lane if lane in leading_lanes else leading_lanes[0]
        )
        delays.append((leads.index(leader), axle_delay[axle] + lane_delay[lane]))
    return leads, delays


def _joint_noise(correlation: float) -> Array:
    """Return a factor (2, 2) of the covariance of two unit noises."""
    return np.array([[1.0, 0.0], [correlation, np.sqrt(1 - correlation**2)]])


def design(
    model: RideModel,
    weights: RideWeights,
    noise: ImuNoise,
    delay_samples: int = 0,
    max_force_n: float = np.inf,
) -> RideController:
    """Solve both Riccati equations. Raises ValueError where filter or regulator has no stabilising
    solution."""
    if delay_samples not in (0, 1):
        raise ValueError(f"the force may act 0 or 1 samples late, not {delay_samples}")
    filtered = steady_state_gain(model.a, model.c, model.process, noise.covariance())
    feedback = regulate(model, weights).gain
    return RideController(model, filtered.gain, feedback, filtered.innovation, delay_samples, max_force_n)


@dataclass(frozen=True, slots=True, eq=False)
class Feedback:
    """Force = -gain @ s, gain (4, n), and the least cost s' cost s from state s of the car on its road, (n,
    n)."""

    gain: Array
    cost: Array


def regulate(model: RideModel, weights: RideWeights) -> Feedback:
    """Return the feedback of car states together with the feed-forward of road states.

    The road is out of reach, so the Riccati equation is that of the car's 14 states alone; the blocks of the
    cost that join car and road, and road and road, then follow from linear equations P = A' P S + Q.
    """
    n = CAR_STATES
    car, from_road, road = model.a[:n, :n], model.a[:n, n:], model.a[n:, n:]
    b = model.b[:n]
    q, r, cross = output_weights(model.h, model.j, weights.of_outputs(), np.eye(4) * weights.force)
    regulator = dlqr(car, b, q[:n, :n], r, cross[:n])
    constant = (
        regulator.closed_loop.T @ regulator.cost @ from_road + q[:n, n:] - regulator.gain.T @ cross[n:].T
    )
    joint = _stein(regulator.closed_loop.T, road, constant)
    inner = r + b.T @ regulator.cost @ b
    drive = b.T @ (regulator.cost @ from_road + joint @ road) + cross[n:].T
    gain = np.hstack([regulator.gain, np.linalg.solve(inner, drive)])
    seen = joint.T @ from_road
    rest = (
        from_road.T @ regulator.cost @ from_road + road.T @ seen + seen.T @ road + q[n:, n:]
    ) - drive.T @ np.linalg.solve(inner, drive)
    road_cost = _stein(road.T, road, rest)
    return Feedback(gain, np.block([[regulator.cost, joint], [joint.T, road_cost]]))


def _stein(left: Array, right: Array, constant: Array) -> Array:
    """Solve P = left P right + constant for stable left and right, by squaring (Smith 1968)."""
    total = constant
    for _ in range(60):
        increment = left @ total @ right
        total = total + increment
        if np.abs(increment).max() <= 1e-13 * np.abs(total).max():
            return total
        left, right = left @ left, right @ right
    raise ValueError("the road model does not settle: give the prior a leak and a bandwidth above zero")


def hold(a: Array, b: Array, period_s: float) -> tuple[Array, Array, Array]:
    """Sample x' = a x + b u: return transition, effect of a held input, and of one rising from 0 to 1."""
    n, m = b.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = a * period_s, b * period_s
    block[n : n + m, n + m :] = np.eye(m)
    power = expm(block)
    return power[:n, :n], power[:n, n : n + m], power[:n, n + m :]


def _sampled_noise(a: Array, intensity: Array, period_s: float) -> Array:
    """Return the covariance that white noise of `intensity` leaves after a period (Van Loan 1978)."""
    n = len(a)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -a, intensity, a.T
    power = expm(block * period_s)
    covariance = power[n:, n:].T @ power[:n, n:]
    return np.asarray(0.5 * (covariance + covariance.T))


def _assemble(
    a: Array,
    b: Array,
    imu: LinearModel,
    regulated: LinearModel,
    road: Array,
    process: Array,
    period_s: float,
) -> RideModel:
    """Put measured and regulated outputs, which see the car's states, the road (4, n) and the force, on the
    model."""
    rest = np.zeros((1, len(a) - CAR_STATES))
    c = np.hstack([imu.c, np.repeat(rest, len(imu.c), axis=0)])
    h = np.hstack([regulated.c, np.repeat(rest, len(regulated.c), axis=0)]) + regulated.d[:, :4] @ road
    return RideModel(a, b, c, imu.d, h, regulated.d[:, 4:], process, period_s)
