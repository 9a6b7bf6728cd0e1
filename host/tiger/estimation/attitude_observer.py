"""Kalman observer of the real TIGER: body and ground attitude from the IMU and the four measured strokes.

The model is the 7-DOF car (4.9) with the strokes as known inputs: a stroke lifts the spring's upper seat,
which is the force K lift + C lift_rate at its corner. To its 14 states come the slope of the ground under the
wheels (roll, pitch and their rates, driven by white acceleration) and the two gyro biases. Heave and warp of
the ground leave no trace in a single IMU and are no states.

(4.12)-(4.19) print an observer gain without noise covariances; this is the steady-state Kalman gain of the
sampled model, designed once at start-up. Every tick predicts. A sample corrects the moment it was taken: it
is compared with the output predicted for then, and the correction is carried forward to now, which is exact
for a linear model.
"""

from __future__ import annotations

import math
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from tiger.estimation.kalman import steady_state_gain
from tiger.frozen import dataclass
from tiger.models.full_car import FORCE, ROAD, STATES, FullCarParameters, full_car
from tiger.models.linear import LinearModel
from tiger.record import Estimate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.record import Four, ImuSample

    Array = NDArray[np.float64]

PLATE = ("plate_roll_rad", "plate_roll_rate_radps", "plate_pitch_rad", "plate_pitch_rate_radps")
BIAS = ("gyro_bias_x_radps", "gyro_bias_y_radps")
MEASURED = ("roll_rad", "pitch_rad", "gyro_x_radps", "gyro_y_radps", "imu_heave_accel_mps2")

_INDEX = {name: i for i, name in enumerate((*STATES, *PLATE, *BIAS))}
_SHOWN = itemgetter(  # in the order of the fields of `Estimate`
    *[_INDEX[n] for n in ("roll_rad", "pitch_rad", "roll_rate_radps", "pitch_rate_radps")],
    *[_INDEX[n] for n in (PLATE[0], PLATE[2], PLATE[1], PLATE[3], *BIAS)],
)


@dataclass(frozen=True, slots=True, eq=False)
class ObserverDesign:
    """What `design_observer` computes once: n = 20 states, p = 5 outputs, h ticks of history."""

    period_s: float
    transition: Array
    """A of one tick (n, n)."""
    output: Array
    """C (p, n)."""
    feedthrough: Array
    """D (p, 4)."""
    tick: Array
    """(n + p, n + 4): next state and its outputs from state and seat forces, in one product."""
    corrections: tuple[tuple[Array, ...], ...]
    """For a sample j ticks old: what its innovation adds to the state, (n, p), and to each of the j
    predictions since, (p, p), newest first."""
    at_rest: Array
    """(n, 6): state at rest on a plate of given roll and pitch under given seat forces."""
    spring_npm: Four
    damper_nspm: Four
    nominal: Array
    """Static roll and pitch of the body under unit seat forces (2, 4)."""
    sigma_rad: float
    """Standard deviation of roll or pitch, whichever is worse, under the assumed noise."""


@dataclass(frozen=True, slots=True, eq=False)
class ObserverState:
    """The state (n,) and the outputs predicted for the last h ticks, (p,) each, newest first."""

    x: Array
    predicted: tuple[Array, ...]
    ready: bool


def design_observer(robot: RobotConfig) -> ObserverDesign:
    """Sample the model and design the gain, in milliseconds; raises ValueError where no filter exists."""
    noise, period = robot.observer, robot.loop.period_s
    parameters = observed_car(robot)
    model = _augmented(parameters, robot.vehicle.imu_offset_m[:2])
    sampled = model.discretise(period)
    forces, roads = range(4), range(4, 8)
    transition, from_force, feedthrough = sampled.a, sampled.b[:, list(forces)], sampled.d[:, list(forces)]

    ticks = max(1, round(robot.loop.rate_hz / noise.imu_rate_hz))
    process = _process_noise(robot, sampled.b[:, list(roads)])
    between, total = np.eye(len(transition)), np.zeros_like(transition)
    for _ in range(ticks):
        total = transition @ total @ transition.T + process
        between = transition @ between
    sigma = np.array(
        [math.radians(noise.attitude_noise_deg)] * 2
        + [math.radians(noise.rate_noise_degps)] * 2
        + [noise.acceleration_noise_mps2]
    )
    filtered = steady_state_gain(between, sampled.c, total, np.diag(sigma**2))
    attitude = [_INDEX["roll_rad"], _INDEX["pitch_rad"]]
    settled = np.linalg.solve(-model.a[:14, :14], np.hstack([model.a[:14, [14, 16]], model.b[:14, :4]]))
    at_rest = np.zeros((len(_INDEX), 6))
    at_rest[:14], at_rest[14, 0], at_rest[16, 1] = settled, 1.0, 1.0
    return ObserverDesign(
        period_s=period,
        transition=transition,
        output=sampled.c,
        feedthrough=feedthrough,
        tick=np.block(
            [[transition, from_force], [sampled.c @ transition, sampled.c @ from_force + feedthrough]]
        ),
        corrections=_corrections(
            filtered.gain, transition, sampled.c, history=round(noise.history_ms / 1000.0 / period)
        ),
        at_rest=at_rest,
        spring_npm=tuple(parameters.spring_npm().tolist()),
        damper_nspm=tuple(parameters.damper_nspm().tolist()),
        nominal=np.asarray(settled[attitude, 2:]),
        sigma_rad=float(np.sqrt(np.diag(filtered.posterior)[attitude].max())),
    )


def _corrections(
    gain: Array, transition: Array, output: Array, history: int
) -> tuple[tuple[Array, ...], ...]:
    """What the innovation of a sample 0, 1, ... ticks late adds to the state, and to the outputs since."""
    corrections, carried = [], [gain]
    for _ in range(history):
        later_predictions = [output @ correction for correction in reversed(carried[1:])]
        corrections.append((carried[-1], *later_predictions))
        carried.append(transition @ carried[-1])
    return tuple(corrections)


def observed_car(robot: RobotConfig) -> FullCarParameters:
    """Return the car of (4.9) with a body that rolls about the ground, where the tyres hold it sideways.

    (4.6) has it roll about its centre of mass, as on ice. That is twice as fast as it does, and each stroke
    would look like ground that rocks.
    """
    parameters, height_m = FullCarParameters.from_config(robot.vehicle), robot.vehicle.body.com_height_m
    inertia = parameters.roll_inertia_kgm2 + parameters.body_mass_kg * height_m**2
    return replace(parameters, roll_inertia_kgm2=inertia)


def initial_state(design: ObserverDesign) -> ObserverState:
    """Return the state before the first sample."""
    n, p = design.transition.shape[0], design.output.shape[0]
    return ObserverState(np.zeros(n), (np.zeros(p),) * len(design.corrections), ready=False)


def step(
    design: ObserverDesign,
    state: ObserverState,
    lift_m: Four,
    lift_rate_mps: Four,
    sample: ImuSample | None,
    age_s: float = 0.0,
    tilt_error_rad: tuple[float, float] = (0.0, 0.0),
) -> tuple[ObserverState, Estimate]:
    """Advance by one tick: predict, and correct if there is a new sample.

    `lift_m` is how far each stroke lifts the spring's seat, from any fixed zero; `lift_rate_mps` its rate. A
    sample `age_s` older than the history is left out; `tilt_error_rad` is added to roll and pitch.
    """
    (fl, fr, rl, rr), (v, w, x, y) = lift_m, lift_rate_mps
    (k_fl, k_fr, k_rl, k_rr), (c_fl, c_fr, c_rl, c_rr) = design.spring_npm, design.damper_nspm
    force = k_fl * fl + c_fl * v, k_fr * fr + c_fr * w, k_rl * rl + c_rl * x, k_rr * rr + c_rr * y
    if not state.ready:
        return _first(design, state, np.array(force), sample, tilt_error_rad)
    known = np.empty(design.tick.shape[1])
    known[: -len(force)], known[-len(force) :] = state.x, force
    after = design.tick.dot(known)
    n = len(state.x)
    now, predicted = after[:n], (after[n:], *state.predicted[:-1])
    if sample is None or (ticks := max(0, round(age_s / design.period_s))) >= len(design.corrections):
        return ObserverState(now, predicted, ready=True), _estimate(design, now)
    innovation = _measured(sample, tilt_error_rad) - predicted[ticks]
    to_state, *to_predictions = design.corrections[ticks]
    now = now + to_state.dot(innovation)
    corrected = [old + change.dot(innovation) for old, change in zip(predicted, to_predictions, strict=False)]
    state = ObserverState(now, (*corrected, *predicted[ticks:]), ready=True)
    return state, _estimate(design, now, tuple(innovation.tolist()))


def _estimate(design: ObserverDesign, x: Array, innovation: tuple[float, ...] = ()) -> Estimate:
    roll, pitch, roll_rate, pitch_rate, *plate, bias_x, bias_y = _SHOWN(x.tolist())
    return Estimate(
        ready=True,
        roll_rad=roll,
        pitch_rad=pitch,
        roll_rate_radps=roll_rate,
        pitch_rate_radps=pitch_rate,
        plate_roll_rad=plate[0],
        plate_pitch_rad=plate[1],
        plate_roll_rate_radps=plate[2],
        plate_pitch_rate_radps=plate[3],
        sigma_rad=design.sigma_rad,
        gyro_bias_radps=(bias_x, bias_y),
        innovation=innovation,
    )


def _first(
    design: ObserverDesign,
    state: ObserverState,
    force: Array,
    sample: ImuSample | None,
    tilt_error_rad: tuple[float, float],
) -> tuple[ObserverState, Estimate]:
    """Start at rest in the attitude of the first sample."""
    if sample is None:
        return state, Estimate(ready=False)
    plate = _measured(sample, tilt_error_rad)[:2] - design.nominal @ force
    x = design.at_rest @ np.concatenate([plate, force])
    output = design.output @ x + design.feedthrough @ force
    return ObserverState(x, (output,) * len(state.predicted), ready=True), _estimate(design, x)


def attitude_rad(quaternion: Four) -> tuple[float, float]:
    """Return roll and pitch (Z-Y-X angles) of a unit quaternion w x y z, body to earth."""
    w, x, y, z = quaternion
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    return roll, pitch


def _measured(sample: ImuSample, tilt_error_rad: tuple[float, float]) -> Array:
    """Bring a sample into the model's coordinates: roll, pitch, their rates, and vertical acceleration."""
    w, x, y, z = sample.quaternion
    roll, pitch = attitude_rad(sample.quaternion)
    roll, pitch = roll + tilt_error_rad[0], pitch + tilt_error_rad[1]
    p, q, r = sample.rate_radps
    sin, cos = math.sin(roll), math.cos(roll)
    turning = q * sin + r * cos
    ax, ay, az = sample.linear_accel_mps2
    up = 2.0 * (x * z - w * y) * ax + 2.0 * (y * z + w * x) * ay + (1.0 - 2.0 * (x * x + y * y)) * az
    return np.array([roll, pitch, p + math.tan(pitch) * turning, q * cos - r * sin, up])


def _augmented(parameters: FullCarParameters, imu_xy_m: tuple[float, float]) -> LinearModel:
    """Build the 20-state model: inputs FORCE (seat forces) and ROAD (what is no slope), outputs MEASURED."""
    outputs = ("roll_rad", "pitch_rad", "roll_rate_radps", "pitch_rate_radps", "imu_heave_accel_mps2")
    car = full_car(parameters, imu_xy_m).select(inputs=(*FORCE, *ROAD), outputs=outputs)
    n = len(_INDEX)
    x_m, y_m = parameters.corner_positions_m().T
    slope = np.zeros((4, len(PLATE)))  # heights under the wheels from the states of the plate
    slope[:, 0], slope[:, 2] = y_m, -x_m
    a, b, c = np.zeros((n, n)), np.zeros((n, 8)), np.zeros((5, n))
    a[:14, :14], a[:14, 14:18] = car.a, car.b[:, 4:] @ slope
    a[14, 15] = a[16, 17] = 1.0
    b[:14] = car.b
    c[:, :14], c[:, 14:18] = car.c, car.d[:, 4:] @ slope
    c[2, _INDEX[BIAS[0]]] = c[3, _INDEX[BIAS[1]]] = 1.0
    return LinearModel(a, b, c, car.d, tuple(_INDEX), (*FORCE, *ROAD), MEASURED)


def _process_noise(robot: RobotConfig, from_road: Array) -> Array:
    """Covariance that one tick adds, (n, n). The plate's acceleration has its sigma per IMU period."""
    noise, period = robot.observer, robot.loop.period_s
    process = (noise.ground_noise_mm / 1000.0) ** 2 * from_road @ from_road.T
    density = math.radians(noise.plate_acceleration_degps2) ** 2 / noise.imu_rate_hz
    turn = np.array([[period**3 / 3.0, period**2 / 2.0], [period**2 / 2.0, period]]) * density
    process[14:16, 14:16] += turn
    process[16:18, 16:18] += turn
    drift = math.radians(noise.gyro_bias_drift_degps) ** 2 * period
    process[18, 18] += drift
    process[19, 19] += drift
    return process
