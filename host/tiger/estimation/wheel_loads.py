"""Loads of the four wheels, with the mass and the centre of mass of whatever the robot carries.

Three equations hold on any ground: the forces along the body's z axis and the moments about its x and y axes
that the body's accelerations ask for. With the specific force f at the body, the angular accelerations, mass
and first moments of the load (`payload`) and the lever H = sum of mass x height above the ground,

    sum F   = m_body f_z + m_wheels g
    sum x F = m x f_z - H f_x - I_y q' - W r pitch - T
    sum y F = m y f_z - H f_y + I_x p' + W r roll - h yaw rate

Pitch and roll are those of the body against the ground, by strokes and springs: the wheels stay upright under
it, which moves their contacts by the tilt times the radius r under the weight W. T is the torque that the
motors spend on spinning the wheels up and on rolling them, which presses the tail down; h is the wheels'
spin, which a turn turns round with the robot: that presses the outer side down.

The fourth is the twist: ground and strokes together load one diagonal and relieve the other, through spring
and tyre in series. The ground's share is inferred elsewhere (`contact`). A twist that would pull at a wheel
takes only what load there is: three wheels carry, and the three equations say how much each.

What wheels do on their springs between bumps is not seen by an IMU on the body: these are the loads of slow
motion, smoothed over `_SMOOTH_S`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tiger.control import traction
from tiger.control.reachable import WARP
from tiger.devices.imu import specific_force_mps2
from tiger.estimation import payload, tilt_error
from tiger.estimation.payload import Measured, PayloadDesign, PayloadState
from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.record import STILL, Loads

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig
    from tiger.control.reachable import Pose
    from tiger.estimation.payload import Payload
    from tiger.estimation.tilt_error import TiltError
    from tiger.record import Estimate, Four, Inputs, Three

_SMOOTH_S = 0.05
_PERIOD_S = 0.015
"""A sample of the IMU that comes sooner after the last one is left out: fifty a second are enough."""
_LONGEST_S = 0.1
"""Between two samples of the IMU; a longer gap counts as this."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadsDesign:
    """What `design_loads` computes once."""

    payload: PayloadDesign
    empty: Loads
    shares: tuple[Three, Three, Three, Three]
    """Of each wheel: load per unit of the sum of forces, of the moment ahead and of that to the left."""
    wheels_kg: float
    inertia_kgm2: tuple[float, float]
    """Of the empty body, roll and pitch."""
    half_track_m: float
    corner_npm: float
    """Spring and tyre in series."""
    noise_n: float


@dataclass(frozen=True, slots=True, eq=False)
class LoadsState:
    """What a tick leaves to the next."""

    payload: PayloadState
    load: Payload
    load_sigma_n: float
    """Of one wheel's load, by what is not known of the payload."""
    force_mps2: Three = (0.0, 0.0, GRAVITY_MPS2)
    turn_radps2: tuple[float, float] = (0.0, 0.0)
    wheels_nm: tuple[float, float] = (0.0, 0.0)
    """Moments that the wheels' spin and rolling take: of pitch, pressing the tail down, and of roll."""
    current_a: Four = STILL
    """Last readings, left then right, front then rear."""
    read: tuple[bool, bool] = (False, False)
    """Which side's currents were read since they were last used."""
    imu_t_s: float = -math.inf
    """Time of the IMU sample last used."""


def design_loads(robot: RobotConfig) -> LoadsDesign:
    """Prepare the estimators for one vehicle, empty as the config has it."""
    vehicle = robot.vehicle
    parameters = FullCarParameters.from_config(vehicle)
    weights = parameters.static_tire_load_n()
    fl, fr, rl, rr = weights.tolist()
    places = np.vstack([np.ones(4), parameters.corner_positions_m().T])
    # Of all loads with these three sums, the ones nearest to equal: no twist in them.
    a, b, c, d = ((row[0], row[1], row[2]) for row in np.linalg.pinv(places).tolist())
    spring, tyre = float(parameters.spring_npm().mean()), parameters.tire_stiffness_npm
    design = payload.design_payload(robot)
    return LoadsDesign(
        payload=design,
        empty=Loads(wheel_load_n=(fl, fr, rl, rr), mass_kg=design.empty_kg),
        shares=(a, b, c, d),
        wheels_kg=float(parameters.wheel_mass_kg().sum()),
        inertia_kgm2=(parameters.roll_inertia_kgm2, parameters.pitch_inertia_kgm2),
        half_track_m=vehicle.body.half_track_m,
        corner_npm=spring * tyre / (spring + tyre),
        noise_n=robot.loads.load_noise_n,
    )


def initial_state(design: LoadsDesign) -> LoadsState:
    """Return the state before the first tick: an empty robot, more or less."""
    nothing = payload.initial_state(design.payload)
    load = payload.payload(design.payload, nothing)
    return LoadsState(nothing, load, _load_sigma_n(design, load))


def step(
    design: LoadsDesign,
    state: LoadsState,
    inputs: Inputs,
    estimate: Estimate,
    off: TiltError,
    dt: float,
) -> tuple[LoadsState, Loads]:
    """Advance with every other sample of the IMU; `dt` is the time that the first one stands for.

    `estimate` has the odometry of this tick, and the loads of the last one with the ground's warp; `off` is
    what the IMU's attitude is off by.
    """
    imu, strokes = inputs.imu, inputs.strokes
    if imu is None or strokes is None:
        return state, design.empty
    if imu.t_s < state.imu_t_s + _PERIOD_S:
        return state, estimate.loads
    if state.imu_t_s > -math.inf:
        dt = min(_LONGEST_S, imu.t_s - state.imu_t_s)
    force, rate = specific_force_mps2(imu), imu.rate_radps
    wheels_mps, wheels_radps = _wheels(design, inputs)
    slipping = True in estimate.odometry.slipping
    turning = max(abs(rate[2]), abs(wheels_radps)) > design.payload.turning_radps
    roll, pitch = tilt_error.corrected_rad(off, imu)
    current_a, left_read, right_read = _read(state, inputs)
    fresh = left_read and right_read
    drive_n, yaw_nm = _driving(design, inputs) if fresh else (0.0, 0.0)
    at = design.payload.suspension.curve.at
    fl, fr, rl, rr = strokes.stroke_mm
    posed = design.payload.suspension.pose((at(fl)[0], at(fr)[0], at(rl)[0], at(rr)[0]))
    measured = Measured(
        roll - posed.roll_rad,
        pitch - posed.pitch_rad,
        posed.roll_rad,
        posed.pitch_rad,
        force[0],
        force[1],
        rate[1],
        rate[2],
        wheels_mps,
        drive_n,
        yaw_nm,
        fresh,
        straight=not (slipping or turning),
    )
    carrying = payload.step(design.payload, state.payload, measured, dt)
    load, load_sigma_n = state.load, state.load_sigma_n
    if carrying.mean is not state.payload.mean:
        load = payload.payload(design.payload, carrying)
        load_sigma_n = _load_sigma_n(design, load)
    share = dt / (dt + _SMOOTH_S)
    (fx, fy, fz), (p, q) = state.force_mps2, state.turn_radps2
    turn = imu.angular_accel_radps2
    smooth = fx + share * (force[0] - fx), fy + share * (force[1] - fy), fz + share * (force[2] - fz)
    spin_kgm, gained_mps2 = design.payload.spin_kgm, smooth[0] + GRAVITY_MPS2 * pitch
    ahead = wheels_mps / design.payload.config.moving_mps
    if abs(ahead) > 1.0:
        ahead = math.copysign(1.0, ahead)
    wheels_nm = spin_kgm * gained_mps2 + ahead * load.rolling_nm, spin_kgm * wheels_mps * rate[2]
    swing = p + share * (turn[0] - p), q + share * (turn[1] - q)
    read = (False, False) if fresh else (left_read, right_read)
    after = LoadsState(carrying, load, load_sigma_n, smooth, swing, wheels_nm, current_a, read, imu.t_s)
    return after, _loads(design, after, estimate.loads, posed)


def _wheels(design: LoadsDesign, inputs: Inputs) -> tuple[float, float]:
    """Mean speed of the four wheels' circumference, and the yaw rate at which they would turn the robot.

    By the sensors of mega_speed, where there are any.
    """
    left, right = inputs.wheels_left, inputs.wheels_right
    if left is None or right is None:
        fl, fr, rl, rr = traction.measured(inputs)[0]
    else:
        (fl, rl), (fr, rr) = left.speed_radps, right.speed_radps
    left_mps, right_mps = 0.5 * design.payload.radius_m * (fl + rl), 0.5 * design.payload.radius_m * (fr + rr)
    return 0.5 * (left_mps + right_mps), 0.5 * (right_mps - left_mps) / design.half_track_m


def _driving(design: LoadsDesign, inputs: Inputs) -> tuple[float, float]:
    """Force of the four motors, and the moment to the right of the left ones against the right ones."""
    fl, fr, rl, rr = traction.measured(inputs)[1]
    radius = design.payload.radius_m
    return (fl + fr + rl + rr) / radius, (fl + rl - fr - rr) * design.half_track_m / radius


def _read(state: LoadsState, inputs: Inputs) -> tuple[Four, bool, bool]:
    """The newest currents, and which side's were read: a new reading differs, if only by its noise."""
    left, right = inputs.drive_left, inputs.drive_right
    if left is None or right is None:
        return STILL, False, False
    now, before = (*left.motor_current_a, *right.motor_current_a), state.current_a
    return now, state.read[0] or now[:2] != before[:2], state.read[1] or now[2:] != before[2:]


def _loads(design: LoadsDesign, state: LoadsState, known: Loads, posed: Pose) -> Loads:
    load = state.load
    twist_m = 0.25 * known.ground_warp_m + 0.001 * posed.warp_mm
    sigma = math.hypot(state.load_sigma_n, 0.25 * design.corner_npm * known.ground_warp_sigma_m)
    return Loads(
        wheel_load_n=_twisted(_three_equations(design, state, posed), design.corner_npm * twist_m),
        wheel_load_sigma_n=(sigma, sigma, sigma, sigma),
        hanging=known.hanging,
        ground_warp_m=known.ground_warp_m,
        ground_warp_sigma_m=known.ground_warp_sigma_m,
        mass_kg=design.payload.empty_kg + load.mass_kg,
        mass_sigma_kg=load.mass_sigma_kg,
        com_m=load.com_m,
        com_sigma_m=load.com_sigma_m,
        payload_kg=load.mass_kg,
        payload_m=load.place_m,
        payload_sigma_m=load.place_sigma_m,
    )


def _three_equations(design: LoadsDesign, state: LoadsState, posed: Pose) -> Four:
    """Loads that carry the body as it moves, without any twist."""
    fx, fy, fz = state.force_mps2
    load = state.load
    x, y, _ = load.moment_kgm
    lever = load.lever_kgm
    total = (design.payload.body_kg + load.mass_kg) * fz + design.wheels_kg * GRAVITY_MPS2
    upright = load.upright_nmprad
    (p, q), (tail_nm, outer_nm) = state.turn_radps2, state.wheels_nm
    ahead = x * fz - lever * fx - design.inertia_kgm2[1] * q - upright * posed.pitch_rad - tail_nm
    left = y * fz - lever * fy + design.inertia_kgm2[0] * p + upright * posed.roll_rad - outer_nm
    ahead *= design.payload.pitch_nmprad / (design.payload.pitch_nmprad + upright)
    left *= design.payload.roll_nmprad / (design.payload.roll_nmprad + upright)
    fl, fr, rl, rr = (a * total + b * ahead + c * left for a, b, c in design.shares)
    return fl, fr, rl, rr


def _twisted(carried: Four, twist_n: float) -> Four:
    """Load FL and RR by a twist, or as much of it as leaves no wheel pulling."""
    fl, fr, rl, rr = carried
    most, least = min(fr, rl), -min(fl, rr)
    twist = max(least, min(most, twist_n)) if least <= most else 0.5 * (least + most)
    a, b, c, d = (max(0.0, load + sign * twist) for load, sign in zip(carried, WARP, strict=True))
    return a, b, c, d


def _load_sigma_n(design: LoadsDesign, load: Payload) -> float:
    """Standard deviation of one wheel's load when the ground's twist is known."""
    a, b, c = design.shares[0]
    weight = GRAVITY_MPS2 * a * load.mass_sigma_kg
    ahead = GRAVITY_MPS2 * b * load.moment_sigma_kgm[0]
    left = GRAVITY_MPS2 * c * load.moment_sigma_kgm[1]
    return math.hypot(weight, ahead, left, design.noise_n)
