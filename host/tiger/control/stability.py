"""How far the robot is from tipping over, and the limits on its motion that keep it from there.

With every IMU sample: the force-angle margin and the load transfer from the accelerometer (`tip_over`), the
time until the COM stands over an edge, blows along the ground (`trip`), a warning, and what of the command
may be carried out (`motion_limits`). Mass and COM are those of `Estimate.loads`, the support polygon that of
the present strokes. `stability.limiter` = "log" does all of it but leaves the command alone.
"""

from __future__ import annotations

from dataclasses import field
from math import atan2, hypot, inf
from typing import TYPE_CHECKING

from tiger.control import motion_limits, tip_over, trip
from tiger.control.motion_limits import Allowed, LimiterDesign, LimiterState
from tiger.control.tip_over import Stance
from tiger.control.trip import TripState
from tiger.devices.imu import specific_force_mps2
from tiger.frozen import dataclass, replace
from tiger.models.eam import Eam
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.models.track import Track, half_tracks_m, track_of
from tiger.record import LimitCause, Stability

if TYPE_CHECKING:
    from tiger.config.robot import RobotConfig, StabilityConfig
    from tiger.models.eam import LiftCurve
    from tiger.record import Command, Estimate, Four, ImuSample, Inputs, Loads, Three

STANCE_PERIOD_S = 0.2
"""Loads and strokes change slowly: so often the stance follows them."""

JUDGED_AFTER_S = 0.015
"""Margins and limits are worked out with every other sample: 50 Hz; a blow or a new command at once."""

LONGEST_SAMPLE_S = 0.05
FAR_RAD, SLOW_RADPS = 1.0, 0.5
NEVER_S = 1e3
CREEPING_MPS = 0.05
"""Below, rolling resistance has no direction."""
Two = tuple[float, float]
Felt = tuple[float, float, float, float, float]
STANDING: Three = (0.0, 0.0, GRAVITY_MPS2)
_AT_REST: Felt = (0.0, 0.0, GRAVITY_MPS2, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class StabilityDesign:
    """What `design_stability` computes once."""

    config: StabilityConfig
    limiter: LimiterDesign
    curve: LiftCurve
    mid_lift_mm: float
    body_mass_kg: float
    wheels_mass_kg: float
    com_height_m: float
    wheel_height_m: float
    track: Track
    front_m: float
    rear_m: float
    inertia_kgm2: tuple[float, float]
    """Roll and pitch, of the body about its COM."""
    spin_inertia_kgm2: float
    """Of all wheels about their axles."""
    rolling_resistance: float
    spring_npm: float
    """Of one wheel's spring and tyre in series."""
    imu_m: Three
    """From the empty body's COM."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What the samples of the IMU add up to, in body axes."""

    imu_t_s: float = -inf
    felt: Felt = _AT_REST
    """Specific force at the COM (m/s2), and angular acceleration in roll and pitch (rad/s2), smoothed ..."""
    felt_before: Felt = _AT_REST
    """... and smoothed once more: what it has changed by, tells what it is by now."""
    rate_radps: Two = (0.0, 0.0)
    upright_mps2: Three = STANDING
    """The reaction to gravity."""
    speed_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class Judgement:
    """What was made of it last."""

    imu_t_s: float = -inf
    stance_due_s: float = -inf
    stance: Stance = field(default_factory=Stance)
    plane_rad: Two = (0.0, 0.0)
    """Roll and pitch of the ground under the wheels."""
    limiter: LimiterState = field(default_factory=LimiterState)
    warning_hold_s: float = 0.0
    asked: Two = (0.0, 0.0)
    """Speed and yaw rate last looked at."""
    allowed: Two = (0.0, 0.0)
    shown: Stability = field(default_factory=Stability)


@dataclass(frozen=True, slots=True)
class StabilityState:
    """What a tick leaves to the next."""

    motion: Motion = field(default_factory=Motion)
    trip: TripState = field(default_factory=TripState)
    judgement: Judgement = field(default_factory=Judgement)


def design_stability(robot: RobotConfig) -> StabilityDesign:
    """Prepare margins and limits."""
    vehicle, config = robot.vehicle, robot.stability
    body = vehicle.body
    curve = Eam.from_vehicle(vehicle).curve()
    mid_mm = 0.5 * robot.actuator.stroke_max_mm
    parameters = FullCarParameters.from_config(vehicle)
    spring = float(parameters.spring_npm().mean())
    return StabilityDesign(
        config=config,
        limiter=motion_limits.design_limiter(robot),
        curve=curve,
        mid_lift_mm=curve.at(mid_mm)[0],
        body_mass_kg=body.mass_kg,
        wheels_mass_kg=2.0 * (vehicle.front.unsprung_mass_kg + vehicle.rear.unsprung_mass_kg),
        com_height_m=body.com_height_m,
        wheel_height_m=vehicle.tire.rolling_radius_m,
        track=track_of(vehicle),
        front_m=body.com_to_front_axle_m,
        rear_m=body.com_to_rear_axle_m,
        inertia_kgm2=(body.roll_inertia_kgm2, body.pitch_inertia_kgm2),
        spring_npm=1.0 / (1.0 / spring + 1.0 / vehicle.tire.vertical_stiffness_npm),
        imu_m=vehicle.imu_offset_m,
        spin_inertia_kgm2=4.0 * vehicle.tire.spin_inertia_kgm2,
        rolling_resistance=vehicle.tire.rolling_resistance,
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
    motion, tripping, judged = state.motion, state.trip, state.judgement
    if imu is None:
        return state, judged.shown, command
    was_tripped = tripping.hold_s > 0.0
    if imu.t_s > motion.imu_t_s:
        motion, tripping = _sampled(design, motion, tripping, judged, imu, estimate.odometry.speed_mps)
        state = StabilityState(motion, tripping, judged)
    if (
        motion.imu_t_s - judged.imu_t_s > JUDGED_AFTER_S
        or (asked != judged.asked and _is_new(design, judged.asked, asked))
        or (tripping.hold_s > 0.0) is not was_tripped
    ):
        judged = _judged(design, judged, motion, tripping, asked, inputs, estimate)
        state = StabilityState(motion, tripping, judged)
    if not judged.shown.limited or design.config.limiter != "on":
        return state, judged.shown, command
    speed, yaw = judged.allowed
    return state, judged.shown, replace(command, speed_mps=speed, yaw_rate_radps=yaw)


def _is_new(design: StabilityDesign, judged: Two, asked: Two) -> bool:
    """Whether a command is so far from the one judged last that it cannot wait for the next judgement."""
    limiter = design.limiter
    return abs(asked[0] - judged[0]) > limiter.crawl_mps or abs(asked[1] - judged[1]) > limiter.crawl_radps


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
    design: StabilityDesign, old: Motion, tripping: TripState, judged: Judgement, imu: ImuSample, speed: float
) -> tuple[Motion, TripState]:
    """Take a new sample of the IMU."""
    config, rate, turn = design.config, imu.rate_radps, imu.angular_accel_radps2
    force = x, y, z = tip_over.at_com(judged.stance, specific_force_mps2(imu), rate, turn)
    if old.imu_t_s == -inf:
        now = (x, y, z, turn[0], turn[1])
        return Motion(imu.t_s, now, now, rate[:2], force, speed), tripping
    dt = min(LONGEST_SAMPLE_S, imu.t_s - old.imu_t_s)
    wanted = judged.allowed[0] if config.limiter == "on" else judged.asked[0]
    tripping = trip.step(
        config, tripping, x, y - speed * rate[2], wanted, design.limiter.acceleration_mps2, dt
    )
    trust = 0.0 if tripping.hold_s else dt / config.upright_s
    upright = _upright(old.upright_mps2, force, rate, speed, speed - old.speed_mps, trust, dt)
    new = dt / (config.smooth_s + dt)
    ax, ay, az, a_roll, a_pitch = old.felt
    bx, by, bz, b_roll, b_pitch = old.felt_before
    ax += new * (x - ax)
    ay += new * (y - ay)
    az += new * (z - az)
    a_roll += new * (turn[0] - a_roll)
    a_pitch += new * (turn[1] - a_pitch)
    roll_rate, pitch_rate = old.rate_radps
    return Motion(
        imu.t_s,
        (ax, ay, az, a_roll, a_pitch),
        (
            *(bx + new * (ax - bx), by + new * (ay - by), bz + new * (az - bz)),
            *(b_roll + new * (a_roll - b_roll), b_pitch + new * (a_pitch - b_pitch)),
        ),
        (roll_rate + new * (rate[0] - roll_rate), pitch_rate + new * (rate[1] - pitch_rate)),
        upright,
        speed,
    ), tripping


def _judged(
    design: StabilityDesign,
    old: Judgement,
    motion: Motion,
    tripping: TripState,
    asked: Two,
    inputs: Inputs,
    estimate: Estimate,
) -> Judgement:
    """Look at the motion and at a command."""
    config = design.config
    dt = min(LONGEST_SAMPLE_S, motion.imu_t_s - old.imu_t_s)
    stance, due_s = old.stance, old.stance_due_s
    if inputs.now_s >= due_s and inputs.strokes is not None:
        stance = stance_of(design, estimate.loads, inputs.strokes.stroke_mm)
        due_s = inputs.now_s + STANCE_PERIOD_S
    upright, (by_strokes, pitched) = motion.upright_mps2, stance.strokes_rad
    force, turn = _by_now(config, motion)
    by_springs, dived = tip_over.spring_lean(stance, force, turn)
    lean = by_springs + by_strokes, dived + pitched
    ground_roll, ground_pitch = old.plane_rad
    new, new_along = dt / (config.slope_s + dt), dt / (config.slope_along_s + dt)
    ground_roll += new * (atan2(upright[1], upright[2]) - lean[0] - ground_roll)
    ground_pitch += new_along * (atan2(-upright[0], upright[2]) - lean[1] - ground_pitch)
    plane, is_tripped = (ground_roll, ground_pitch), tripping.hold_s > 0.0
    margin, edge, soonest, transfers = _margins(stance, lean, force, turn, motion)
    limiter, allowed = old.limiter, Allowed(*asked)
    if config.limiter != "off":
        footing = motion_limits.footing(stance, plane, config.friction_max)
        limiter, allowed = motion_limits.step(
            design.limiter, limiter, footing, asked, motion.speed_mps, is_tripped, dt
        )
    near = margin < config.warning_margin or soonest < config.warning_time_s
    hold = config.warning_hold_s if near or allowed.would_tip else max(0.0, old.warning_hold_s - dt)
    limited, cause = allowed.limited, allowed.cause
    return Judgement(
        motion.imu_t_s,
        due_s,
        stance,
        plane,
        limiter,
        hold,
        asked,
        (allowed.speed_mps, allowed.yaw_rate_radps),
        Stability(margin, edge, *transfers, soonest, hold > 0.0, is_tripped, limited, cause),
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
    half_fl, half_fr, half_rl, half_rr = half_tracks_m(design.track, stroke_mm)
    left, right = 0.5 * (half_fl + half_rl), 0.5 * (half_fr + half_rr)
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
        spin_m=design.spin_inertia_kgm2 / (mass * design.wheel_height_m),
        rolling_m=design.rolling_resistance * design.wheel_height_m,
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


def _by_now(config: StabilityConfig, motion: Motion) -> tuple[Three, Two]:
    """Specific force and angular acceleration, `late_s` further on the way that they are going."""
    more = config.late_s / config.smooth_s
    x, y, z, roll, pitch = motion.felt
    bx, by, bz, b_roll, b_pitch = motion.felt_before
    force = (x + more * (x - bx), y + more * (y - by), z + more * (z - bz))
    return force, (roll + more * (roll - b_roll), pitch + more * (pitch - b_pitch))


def _margins(
    stance: Stance, lean: Two, force: Three, turn: Two, motion: Motion
) -> tuple[float, int, float, Two]:
    """Margin and edge that is nearest, time to the balance point, and the load transfers."""
    (roll_rate, pitch_rate), gravity = motion.rate_radps, motion.upright_mps2
    places = tip_over.contacts(stance, lean)
    roll, pitch = stance.roll_gyration_m2 * turn[0], stance.pitch_gyration_m2 * turn[1]
    pitch += stance.spin_m * (force[0] - gravity[0])
    pitch += stance.rolling_m * force[2] * motion.speed_mps / (abs(motion.speed_mps) + CREEPING_MPS)
    transfers = tip_over.load_transfer(stance, places, force, (roll, pitch))
    least, edge, soonest = inf, 0, NEVER_S
    for k, (push, moment, downhill, towards, gyration) in enumerate(
        (
            (-force[1], roll, -gravity[1], -roll_rate, stance.roll_tip_gyration_m2),
            (force[1], -roll, gravity[1], roll_rate, stance.roll_tip_gyration_m2),
            (-force[0], -pitch, -gravity[0], pitch_rate, stance.pitch_tip_gyration_m2),
            (force[0], pitch, gravity[0], -pitch_rate, stance.pitch_tip_gyration_m2),
        )
    ):
        reach, depth = places[k]
        net, energy = tip_over.force_angle(reach, depth, push, moment, force[2])
        if energy < least:
            least, edge = energy, k
        if towards <= 0.0 < net or (net > FAR_RAD and towards < SLOW_RADPS):
            continue  # it falls back, or is far and slow
        still = tip_over.angle(reach, depth, downhill, gravity[2])
        soonest = min(soonest, tip_over.time_to_balance(hypot(reach, depth), gyration, still, net, towards))
        if towards > 0.0 < net:
            soonest = min(soonest, still / towards)  # the ground turns it over at this rate
    return least / stance.least_energy, edge, soonest, transfers


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
