"""How far the robot is from tipping over, and the limits on its motion that keep it from there.

With every IMU sample: the force-angle margin and the load transfer from the accelerometer (`tip_over`), the
time until the COM stands over an edge, blows along the ground (`trip`), a warning, and what of the command
may be carried out (`motion_limits`). Mass and COM are those of `Estimate.loads`, the support polygon that of
the present strokes. `stability.limiter` = "log" does all of it but leaves the command alone.
"""

from __future__ import annotations

from dataclasses import field
from math import atan2, exp, inf, sqrt
from typing import TYPE_CHECKING

from tiger.control import motion_limits, tip_over, trip
from tiger.control.drive import design_drive, half_track_m
from tiger.control.motion_limits import Allowed, LimiterDesign, LimiterState
from tiger.control.tip_over import Stance
from tiger.control.trip import TripState
from tiger.frozen import dataclass, replace
from tiger.models.eam import Eam
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.record import LimitCause, Stability

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig, StabilityConfig
    from tiger.control.drive import DriveDesign
    from tiger.control.tip_over import Contacts
    from tiger.models.eam import LiftCurve
    from tiger.record import Command, Estimate, Four, ImuSample, Inputs, Loads, Three

STANCE_PERIOD_S = 0.1
"""Loads and strokes change slowly: so often the stance follows them."""

LONGEST_SAMPLE_S = 0.05
NEVER_S = 1e3
STANDING: Three = (0.0, 0.0, GRAVITY_MPS2)


@dataclass(frozen=True, slots=True, eq=False)
class StabilityDesign:
    """What `design_stability` computes once."""

    config: StabilityConfig
    limiter: LimiterDesign
    drive: DriveDesign
    curve: LiftCurve
    mid_lift_mm: float
    mid_half_track_m: float
    body_mass_kg: float
    wheels_mass_kg: float
    com_height_m: float
    wheel_height_m: float
    half_track_m: float
    front_m: float
    rear_m: float
    inertia_kgm2: tuple[float, float]
    """Roll and pitch, of the body about its COM."""
    spring_npm: float
    """Of one wheel's spring and tyre in series."""
    imu_m: Three
    """From the empty body's COM."""


@dataclass(frozen=True, slots=True)
class StabilityState:
    """What a tick leaves to the next."""

    imu_t_s: float = -inf
    stance_due_s: float = -inf
    stance: Stance = field(default_factory=Stance)
    force_mps2: Three = STANDING
    """Specific force at the COM, smoothed."""
    turn_radps2: tuple[float, float] = (0.0, 0.0)
    rate_radps: tuple[float, float] = (0.0, 0.0)
    upright_mps2: Three = STANDING
    """The reaction to gravity in body axes."""
    speed_mps: float = 0.0
    plane_rad: tuple[float, float] = (0.0, 0.0)
    """Roll and pitch of the ground under the wheels."""
    trip: TripState = field(default_factory=TripState)
    limiter: LimiterState = field(default_factory=LimiterState)
    warning_hold_s: float = 0.0
    asked: tuple[float, float] = (0.0, 0.0)
    """Speed and yaw rate last looked at."""
    allowed: tuple[float, float] = (0.0, 0.0)
    shown: Stability = field(default_factory=Stability)


def design_stability(robot: RobotConfig) -> StabilityDesign:
    """Prepare margins and limits."""
    vehicle, config = robot.vehicle, robot.stability
    body = vehicle.body
    curve = Eam.from_vehicle(vehicle).curve()
    mid_mm = 0.5 * robot.actuator.stroke_max_mm
    parameters = FullCarParameters.from_config(vehicle)
    spring = float(parameters.spring_npm().mean())
    drive = design_drive(robot)
    return StabilityDesign(
        config=config,
        limiter=motion_limits.design_limiter(robot),
        drive=drive,
        curve=curve,
        mid_lift_mm=curve.at(mid_mm)[0],
        mid_half_track_m=half_track_m(drive, mid_mm),
        body_mass_kg=body.mass_kg,
        wheels_mass_kg=2.0 * (vehicle.front.unsprung_mass_kg + vehicle.rear.unsprung_mass_kg),
        com_height_m=body.com_height_m,
        wheel_height_m=vehicle.tire.rolling_radius_m,
        half_track_m=body.half_track_m,
        front_m=body.com_to_front_axle_m,
        rear_m=body.com_to_rear_axle_m,
        inertia_kgm2=(body.roll_inertia_kgm2, body.pitch_inertia_kgm2),
        spring_npm=1.0 / (1.0 / spring + 1.0 / vehicle.tire.vertical_stiffness_npm),
        imu_m=vehicle.imu_offset_m,
    )


def step(
    design: StabilityDesign,
    state: StabilityState,
    command: Command,
    inputs: Inputs,
    estimate: Estimate,
    dt: float,
) -> tuple[StabilityState, Stability, Command]:
    """Advance by `dt` seconds; return the command as far as it is safe. `estimate` has odometry and loads."""
    imu, asked = inputs.imu, (command.speed_mps, command.yaw_rate_radps)
    if imu is not None and (imu.t_s > state.imu_t_s or asked != state.asked):
        state = _sampled(design, state, asked, imu, inputs, estimate)
    if design.config.limiter != "on" or state.allowed == asked:
        return state, state.shown, command
    speed, yaw = state.allowed
    return state, state.shown, replace(command, speed_mps=speed, yaw_rate_radps=yaw)


def reason(stability: Stability) -> str:
    """What is limited and why, in a few words; empty when nothing is."""
    words = [word for bit, word in _WORDS.items() if stability.limited & bit]
    return f"{' and '.join(words)} limited: {_WHY[stability.cause]}" if words else ""


_WORDS = {
    motion_limits.SPEED: "speed",
    motion_limits.CURVATURE: "turning",
    motion_limits.ACCELERATION: "acceleration",
}
_WHY = {
    LimitCause.NOTHING: "",
    LimitCause.TURN: "it would tip over in this turn",
    LimitCause.SLOPE: "it would tip over on this slope",
    LimitCause.BRAKING: "it would tip over when braking or speeding up harder",
    LimitCause.TRIP: "it ran into something",
}


def _sampled(
    design: StabilityDesign,
    state: StabilityState,
    asked: tuple[float, float],
    imu: ImuSample,
    inputs: Inputs,
    estimate: Estimate,
) -> StabilityState:
    """Take a new sample of the IMU, or look at a new command with the one there is."""
    config, is_new = design.config, imu.t_s > state.imu_t_s
    dt = min(LONGEST_SAMPLE_S, imu.t_s - state.imu_t_s)
    stance, due_s = state.stance, state.stance_due_s
    if inputs.now_s >= due_s and inputs.strokes is not None:
        stance = stance_of(design, estimate.loads, inputs.strokes.stroke_mm)
        due_s = inputs.now_s + STANCE_PERIOD_S
    force, turn, rate, plane, tripping = (
        *(state.force_mps2, state.turn_radps2, state.rate_radps, state.plane_rad, state.trip),
    )
    upright, speed = state.upright_mps2, state.speed_mps
    if is_new:
        felt = tip_over.at_com(stance, _felt(imu), imu.rate_radps, imu.angular_accel_radps2)
        speed = estimate.odometry.speed_mps
        across, driving = felt[1] - speed * imu.rate_radps[2], design.limiter.acceleration_mps2
        tripping = trip.step(config, tripping, felt[0], across, driving, dt)
        if state.imu_t_s == -inf:
            upright = felt
        else:
            trust = 0.0 if tripping.hold_s else dt / config.upright_s
            upright = _upright(upright, felt, imu.rate_radps, speed, speed - state.speed_mps, trust, dt)
        smooth = 1.0 - exp(-dt / config.smooth_s)
        force = _towards3(force, felt, smooth)
        turn = _towards2(turn, imu.angular_accel_radps2[:2], smooth)
        rate = _towards2(rate, imu.rate_radps[:2], smooth)
    by_springs, by_strokes = tip_over.spring_lean(stance, force), stance.strokes_rad
    lean = by_springs[0] + by_strokes[0], by_springs[1] + by_strokes[1]
    if is_new:
        roll, pitch = atan2(upright[1], upright[2]), atan2(-upright[0], upright[2])
        ground = roll - lean[0], pitch - lean[1]
        plane = _towards2(plane, ground, 1.0 - exp(-dt / config.slope_s))
    shown = _margins(stance, tip_over.contacts(stance, lean), force, turn, rate, upright)
    limiter, allowed = state.limiter, Allowed(*asked)
    if config.limiter != "off":
        footing = motion_limits.footing(stance, plane, config.friction_max)
        limiter, allowed = motion_limits.step(
            *(design.limiter, limiter, footing, asked, speed, tripping.hold_s > 0.0),
            dt if is_new else 0.0,
        )
    near = shown.margin < config.warning_margin or shown.time_to_balance_s < config.warning_time_s
    hold = config.warning_hold_s if near or allowed.would_tip else max(0.0, state.warning_hold_s - dt)
    return StabilityState(
        imu_t_s=imu.t_s,
        stance_due_s=due_s,
        stance=stance,
        force_mps2=force,
        turn_radps2=turn,
        rate_radps=rate,
        upright_mps2=upright,
        speed_mps=speed,
        plane_rad=plane,
        trip=tripping,
        limiter=limiter,
        warning_hold_s=hold,
        asked=asked,
        allowed=(allowed.speed_mps, allowed.yaw_rate_radps),
        shown=replace(
            shown,
            warning=hold > 0.0,
            tripped=tripping.hold_s > 0.0,
            limited=allowed.limited,
            cause=allowed.cause,
        ),
    )


# ---- stance: where the COM and the edges are --------------------------------------------------


def stance_of(design: StabilityDesign, loads: Loads, stroke_mm: Four) -> Stance:
    """Return COM and support polygon with the present load on the present strokes.

    The load sags the springs, the strokes lift the body and move the wheels sideways as the mechanism does.
    What the estimator is not sure of is not taken up, nor is a COM lower than the vehicle's file has it.
    """
    config, wheels = design.config, design.wheels_mass_kg
    more = max(0.0, loads.mass_kg - wheels - design.body_mass_kg)
    more *= _trust(loads.mass_sigma_kg, config.load_sigma_kg)
    body = design.body_mass_kg + more
    mass = body + wheels
    com_x, com_y, com_z = com = tuple(
        place * _trust(sigma, config.load_sigma_m)
        for place, sigma in zip(loads.com_m, loads.com_sigma_m, strict=True)
    )
    com_z = max(0.0, com_z)
    lift = [(design.curve.at(stroke)[0] - design.mid_lift_mm) * 1e-3 for stroke in stroke_mm]
    fl, fr, rl, rr = lift
    sag = more * GRAVITY_MPS2 / (4.0 * design.spring_npm)
    ride = design.com_height_m + 0.25 * (fl + fr + rl + rr) - sag  # the empty body's COM above the ground
    height = (body * (ride + com_z) + wheels * design.wheel_height_m) / mass
    share = body / mass
    x, y = share * com_x, share * com_y  # the wheels' COM is under the empty body's
    tracks = [
        design.half_track_m + half_track_m(design.drive, stroke) - design.mid_half_track_m
        for stroke in stroke_mm
    ]
    left, right = 0.5 * (tracks[0] + tracks[2]), 0.5 * (tracks[1] + tracks[3])
    above = ride + com_z - height  # body's COM over that of everything
    below = height - design.wheel_height_m
    load2 = sum(place * place for place in com) * body * body / more if more > 1.0 else 0.0
    roll = design.inertia_kgm2[0] + load2 + body * above * above + wheels * below * below
    pitch = design.inertia_kgm2[1] + load2 + body * above * above + wheels * below * below
    wide, long = 0.5 * (left + right), 0.5 * (design.front_m + design.rear_m)
    imu_x, imu_y, imu_z = design.imu_m
    return Stance(
        height_m=height,
        reach_m=(left - y, right + y, design.front_m - x, design.rear_m + x),
        roll_gyration_m2=roll / mass,
        pitch_gyration_m2=pitch / mass,
        roll_tip_gyration_m2=(roll + wheels * wide * wide) / mass,
        pitch_tip_gyration_m2=(pitch + wheels * long * long) / mass,
        roll_sway_s2pm=mass * height / (4.0 * design.spring_npm * wide * wide),
        pitch_sway_s2pm=mass * height / (4.0 * design.spring_npm * long * long),
        wheel_radius_m=design.wheel_height_m,
        imu_m=(imu_x - x, imu_y - y, imu_z + ride - height),
        strokes_rad=(
            (fl - fr + rl - rr) / (2.0 * (left + right)),
            (rl - fl + rr - fr) / (4.0 * long),
        ),
    )


def _trust(sigma: float, trusted: float) -> float:
    """1 up to a standard deviation of `trusted`, 0 from twice that on."""
    return min(1.0, max(0.0, 2.0 - sigma / trusted))


# ---- margins --------------------------------------------------


def _margins(
    stance: Stance,
    places: Contacts,
    force: Three,
    turn: tuple[float, float],
    rate: tuple[float, float],
    upright: Three,
) -> Stability:
    """Margin, load transfer and time to the balance point, of the edge that is nearest."""
    lateral, longitudinal = tip_over.load_transfer(stance, places, force, turn)
    pushes, moments = tip_over.outward(stance, force, turn)
    downhill = (-upright[1], upright[1], -upright[0], upright[0])
    towards = (-rate[0], rate[0], rate[1], -rate[1])
    least, edge, soonest = inf, 0, NEVER_S
    for k, (reach, depth) in enumerate(places):
        net, energy = tip_over.force_angle(reach, depth, pushes[k], moments[k], force[2])
        if energy < least:
            least, edge = energy, k
        if net > 1.0 and towards[k] < 0.5:
            continue  # far, and not coming near
        still = atan2(reach, depth) - atan2(downhill[k], upright[2])
        gyration = stance.roll_tip_gyration_m2 if k < 2 else stance.pitch_tip_gyration_m2
        lever = sqrt(reach * reach + depth * depth)
        soonest = min(soonest, tip_over.time_to_balance(lever, gyration, still, net, towards[k]))
        if towards[k] > 0.0 and net > 0.0:
            soonest = min(soonest, still / towards[k])  # the ground turns it over at this rate
    return Stability(
        margin=least / stance.least_energy,
        edge=edge,
        lateral_load_transfer=lateral,
        longitudinal_load_transfer=longitudinal,
        time_to_balance_s=soonest,
    )


def _felt(imu: ImuSample) -> Three:
    """Specific force at the IMU, calibrated: its linear acceleration and what it took away (m/s2)."""
    w, x, y, z = imu.quaternion
    ahead, left, up = imu.linear_accel_mps2
    g = GRAVITY_MPS2
    return (
        ahead + 2.0 * g * (x * z - w * y),
        left + 2.0 * g * (y * z + w * x),
        up + g * (1.0 - 2.0 * (x * x + y * y)),
    )


def _upright(
    old: Three, felt: Three, rate: Three, speed: float, faster: float, trust: float, dt: float
) -> Three:
    """Follow the reaction to gravity: it turns against the gyro and drifts to what driving does not explain.

    The accelerations of driving are v', v r and -v q. The board's own attitude does not know the speed: it
    takes a long turn or a long start for a slope.
    """
    x, y, z = old
    p, q, r = rate
    dt_per_trust = trust / dt
    ahead = felt[0] * trust - faster * dt_per_trust
    side, up = (felt[1] - speed * r) * trust, (felt[2] + speed * q) * trust
    keep = 1.0 - trust
    return (
        keep * (x - dt * (q * z - r * y)) + ahead,
        keep * (y - dt * (r * x - p * z)) + side,
        keep * (z - dt * (p * y - q * x)) + up,
    )


def _towards2(old: tuple[float, float], new: tuple[float, ...], gain: float) -> tuple[float, float]:
    return old[0] + gain * (new[0] - old[0]), old[1] + gain * (new[1] - old[1])


def _towards3(old: Three, new: tuple[float, ...], gain: float) -> Three:
    return (
        old[0] + gain * (new[0] - old[0]),
        old[1] + gain * (new[1] - old[1]),
        old[2] + gain * (new[2] - old[2]),
    )
