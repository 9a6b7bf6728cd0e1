"""Traction: forces distributed over the four tyres, carried out as trims of the four wheel speeds.

The Roboteqs close each wheel's speed. Left alone that is a car with every differential locked: the wheels run
at one speed whatever they carry, and what each pulls is left to the ground. Here the pull that the speed
loops find necessary (the sum of the measured torques, and its moment about the vertical) is taken as given,
shared out anew, and a slow integral of each wheel's speed command brings its torque to its share.

The share is a quadratic programme of the four forces f_i,

    minimise    sum f_i^2 / (mu N_i)
                + w (sum f_i - F)^2 + w (sum y_i f_i - M)^2 / y^2
    subject to  |f_i| <= sqrt((mu N_i)^2 - F_yi^2)                (the friction ellipse at the sideways force)
                |f_i| <= motor's and controller's torque / r
                |sum v_i f_i| <= battery's power

whose first line is the power lost in slip where slip grows with f/(mu N): its minimum uses the same part of
the friction everywhere. Both wishes are heavy weights, not constraints: f = 0 is always feasible. The
sideways force is known, so the ellipse is an interval for f_i. `share = "equal"` leaves friction out of it,
which makes of each side an open differential. Most of the time nothing limits: then the minimum is that of
two linear equations, and no solver is asked.

What a wheel slips beyond its limit the same integral takes back, and no trim drives a wheel out of its slip
limits: a host that stops here leaves four bounded, steady speeds. A wheel that slips too much has no more
grip than it pulls with, whatever load and friction say: its share goes to the others until it is trusted
again. The friction is the config's, raised to what wheels that hold have shown to use.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.control.drive import design_drive
from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.record import STILL, Traction

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig, TractionConfig
    from tiger.record import Estimate, Four, Inputs

    Array = NDArray[np.float64]

_SIDE: Four = (1.0, -1.0, 1.0, -1.0)  # left +
_RADPS_PER_RPM = math.pi / 30.0
_DRAG_SPEED_RADPS = 0.5  # the motor's own friction is all there from here on
_FORCE_UNIT_N = 100.0  # numbers of the programme are near one
_WEIGHT = 1e4  # of the demand, over the cost of slip
_SNAP_RPM = 0.05  # a trim below this is none
_LEAST_GRIP = 0.02  # of what load and friction promise, however much a wheel slips
_FULL_GRIP: Four = (1.0, 1.0, 1.0, 1.0)
_TELLING_LOAD = 0.5  # of the mean one: below, a wheel's use of friction is mostly noise


@dataclass(frozen=True, slots=True, eq=False)
class TractionDesign:
    """What `design_traction` computes once."""

    config: TractionConfig
    solve: Callable[..., Any] | None
    """DAQP's, None with mode = "off"."""
    radius_m: float
    half_track_m: float
    torque_max_nm: float
    rpm_max: float
    static_load_n: Four
    demand: Array
    """Share of each force in the pull and, over the half track, in the moment, (2, 4)."""
    demand_hessian: Array
    """What they add to the programme's matrix, (4, 4)."""
    ticks_per_update: int


@dataclass(frozen=True, slots=True)
class TractionState:
    """What a tick leaves to the next."""

    ticks: int = 0  # since the last update
    friction: float = 0.0  # over the config's
    grip: Four = _FULL_GRIP  # of what load and friction promise
    last: Traction = field(default_factory=Traction)


@dataclass(frozen=True, slots=True)
class Task:
    """What is asked of the four tyres, and what limits them."""

    pull_n: float
    moment_nm: float  # + turns left
    load_n: Four  # as far as it gives grip
    friction: float
    side_use: float  # sideways force over load, the same for all
    speed_mps: Four  # of the wheels' rims


def design_traction(robot: RobotConfig) -> TractionDesign:
    """Gather limits from the vehicle, its drives and the safety limits."""
    config, vehicle, body = robot.traction, robot.vehicle, robot.vehicle.body
    solve = None
    if config.mode != "off":
        import daqp

        solve = daqp.solve
    motor = MotorCurrent()
    motor_nm = vehicle.drive.max_torque_nm if vehicle.drive is not None else 0.0
    current_nm = (robot.safety.max_sustained_current_a - motor.no_load_a) * motor.torque_per_amp_nm
    wheelbase = body.com_to_front_axle_m + body.com_to_rear_axle_m
    half = 0.5 * GRAVITY_MPS2 * body.mass_kg / wheelbase
    front = half * body.com_to_rear_axle_m + vehicle.front.unsprung_mass_kg * GRAVITY_MPS2
    rear = half * body.com_to_front_axle_m + vehicle.rear.unsprung_mass_kg * GRAVITY_MPS2
    demand = np.array([[1.0] * 4, [-side for side in _SIDE]])
    return TractionDesign(
        config=config,
        solve=solve,
        radius_m=vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor,
        half_track_m=body.half_track_m,
        torque_max_nm=config.torque_share_max * min(motor_nm, current_nm),
        rpm_max=design_drive(robot).rpm_max,
        static_load_n=(front, front, rear, rear),
        demand=demand,
        demand_hessian=_WEIGHT * demand.T @ demand,
        ticks_per_update=round(robot.loop.rate_hz / robot.loop.drive_rate_hz),
    )


def step(
    design: TractionDesign,
    state: TractionState,
    wheel_rpm: Four,
    inputs: Inputs,
    estimate: Estimate,
    dt: float,
) -> tuple[TractionState, Traction, Four]:
    """Advance by `dt` seconds; returns the wheel speeds in rpm, trimmed with mode = "on".

    The forces are shared out anew as often as the drives are told their speeds; in between nothing changes.
    """
    if design.config.mode == "off" or inputs.drive_left is None or inputs.drive_right is None:
        return state, state.last, wheel_rpm
    if state.ticks + 1 < design.ticks_per_update:
        state = TractionState(state.ticks + 1, state.friction, state.grip, state.last)
    else:
        state = _update(design, state, wheel_rpm, inputs, estimate, dt * design.ticks_per_update)
    return state, state.last, _trimmed(design, wheel_rpm, state.last.trim_rpm)


def _update(
    design: TractionDesign,
    state: TractionState,
    wheel_rpm: Four,
    inputs: Inputs,
    estimate: Estimate,
    dt: float,
) -> TractionState:
    """Measure, share out, trim."""
    config, radius_m = design.config, design.radius_m
    speed_radps, torque_nm = measured(inputs)
    load_n = wheel_loads_n(design, estimate)
    a, b, c, d = torque_nm
    pull_n = a / radius_m, b / radius_m, c / radius_m, d / radius_m
    p, q, r, s = pull_n
    fl, fr, rl, rr = load_n
    use = p / fl, q / fr, r / rl, s / rr
    v, w, x, y = speed_radps
    power_w = a * v, b * w, c * x, d * y
    turning_rpm = v / _RADPS_PER_RPM, w / _RADPS_PER_RPM, x / _RADPS_PER_RPM, y / _RADPS_PER_RPM
    slow_rpm, fast_rpm = slip_limits_rpm(design, turning_rpm, estimate)
    beyond_rpm = _beyond(turning_rpm, slow_rpm, fast_rpm)
    above = _learn_friction(config, state.friction, use, load_n, beyond_rpm, dt)
    friction = config.friction + above
    grip = _learn_grip(config, state.grip, use, friction, beyond_rpm, dt)
    p, q, r, s = grip
    gripping_n = p * fl, q * fr, r * rl, s * rr
    task = task_of(design, pull_n, speed_radps, gripping_n, friction, estimate)
    force_n = allocate(design, task)
    trim_rpm = STILL
    if config.mode == "on":
        missing_nm = _four([f * design.radius_m - t for f, t in zip(force_n, torque_nm, strict=True)])
        trim_rpm = _trim(config, state.last.trim_rpm, wheel_rpm, missing_nm, beyond_rpm, dt)
        trim_rpm = _within(config.trim_max_rpm, trim_rpm, wheel_rpm, slow_rpm, fast_rpm)
    last = Traction(
        force_n=force_n,
        torque_nm=torque_nm,
        power_w=power_w,
        electric_w=electric_w(inputs),
        friction_use=use,
        friction=friction,
        grip=grip,
        trim_rpm=trim_rpm,
    )
    return TractionState(0, above, grip, last)


# ---- what is measured


def measured(inputs: Inputs) -> tuple[Four, Four]:
    """Speeds of the wheels in rad/s and, from the currents, their torques in Nm; zero without a sample."""
    left, right = inputs.drive_left, inputs.drive_right
    if left is None or right is None:
        return STILL, STILL
    (a, c), (b, d) = left.wheel_rpm, right.wheel_rpm
    (fl, rl), (fr, rr) = left.motor_current_a, right.motor_current_a
    a, b, c, d = a * _RADPS_PER_RPM, b * _RADPS_PER_RPM, c * _RADPS_PER_RPM, d * _RADPS_PER_RPM
    return (a, b, c, d), (_torque_nm(fl, a), _torque_nm(fr, b), _torque_nm(rl, c), _torque_nm(rr, d))


_NO_LOAD_A, _TORQUE_PER_AMP_NM = MotorCurrent().no_load_a, MotorCurrent().torque_per_amp_nm


def _torque_nm(current_a: float, speed_radps: float) -> float:
    """Torque behind a current, as `MotorCurrent.torque_nm` for plain floats."""
    return (current_a - _NO_LOAD_A * math.tanh(speed_radps / _DRAG_SPEED_RADPS)) * _TORQUE_PER_AMP_NM


def electric_w(inputs: Inputs) -> Four:
    """Battery voltage times each motor's battery current; zero without a sample."""
    left, right = inputs.drive_left, inputs.drive_right
    if left is None or right is None:
        return STILL
    (fl, rl), (fr, rr) = left.battery_current_a, right.battery_current_a
    return fl * left.battery_v, fr * right.battery_v, rl * left.battery_v, rr * right.battery_v


def wheel_loads_n(design: TractionDesign, estimate: Estimate) -> Four:
    """The estimated wheel loads, of at least `min_load_n`; the static ones while there is no estimate."""
    loads = estimate.loads.wheel_load_n
    if loads == STILL:
        loads = design.static_load_n
    least = design.config.min_load_n
    a, b, c, d = loads
    return max(a, least), max(b, least), max(c, least), max(d, least)


def _sideways_mps2(estimate: Estimate) -> float:
    """What the tyres hold against sideways: the turn's acceleration and the slope's pull."""
    turning = estimate.odometry.speed_mps * estimate.odometry.yaw_rate_radps
    return abs(turning + GRAVITY_MPS2 * math.sin(estimate.roll_rad))


def _learn_friction(
    config: TractionConfig, above: float, use: Four, load_n: Four, beyond_rpm: Four, dt: float
) -> float:
    """What wheels that hold show the friction to have over the config's; without a new proof it fades."""
    telling = _TELLING_LOAD * 0.25 * sum(load_n)
    shown = max(
        abs(used) if load > telling and beyond == 0.0 else 0.0
        for used, load, beyond in zip(use, load_n, beyond_rpm, strict=True)
    )
    if shown - config.friction > above:
        return above + min(1.0, config.friction_gain_per_s * dt) * (shown - config.friction - above)
    return above * max(0.0, 1.0 - config.forget_per_s * dt)


def _learn_grip(
    config: TractionConfig, grip: Four, use: Four, friction: float, beyond_rpm: Four, dt: float
) -> Four:
    """Of what load and friction promise, the share that each wheel has: all, less what slip has refuted."""
    learned = []
    for share, used, beyond in zip(grip, use, beyond_rpm, strict=True):
        if used * beyond > 0.0:
            has = min(share, max(abs(used) / friction, _LEAST_GRIP))
            learned.append(share + min(1.0, config.friction_gain_per_s * dt) * (has - share))
        else:
            learned.append(share + min(1.0, config.trust_per_s * dt) * (1.0 - share))
    return _four(learned)


# ---- sharing out


def task_of(
    design: TractionDesign,
    pull_n: Four,
    speed_radps: Four,
    load_n: Four,
    friction: float,
    estimate: Estimate,
) -> Task:
    """What the drives' speed loops ask of the tyres together, as their torques show it."""
    fl, fr, rl, rr = pull_n
    v, w, x, y = speed_radps
    radius_m = design.radius_m
    return Task(
        pull_n=fl + fr + rl + rr,
        moment_nm=(fr + rr - fl - rl) * design.half_track_m,
        load_n=load_n,
        friction=friction,
        side_use=_sideways_mps2(estimate) / GRAVITY_MPS2,
        speed_mps=(v * radius_m, w * radius_m, x * radius_m, y * radius_m),
    )


def allocate(design: TractionDesign, task: Task) -> Four:
    """Solve the programme for the forces in N, FL FR RL RR.

    It always has a solution, f = 0 at worst: the demand is a wish. Should the solver fail, each side's
    wheels get what they can of the demand in proportion to their limits.
    """
    most_n = limits_n(design, task)
    fl, fr, rl, rr = task.load_n
    friction = task.friction / _FORCE_UNIT_N
    if design.config.share == "load":
        grip = (friction * fl, friction * fr, friction * rl, friction * rr)
    else:
        each = friction * (fl + fr + rl + rr) / 4.0
        grip = (each, each, each, each)
    force_n = _unlimited(design, task, grip)
    if _allowed(design, task, force_n, most_n):
        return force_n
    return _limited(design, task, grip, most_n)


def _unlimited(design: TractionDesign, task: Task, grip: Four) -> Four:
    """Forces in N at which the cost is least, whatever limits them: f_i = grip_i (a + s_i b), s = -1 left, 1
    right, where a and b are the weight times what pull and moment miss."""
    fl, fr, rl, rr = grip
    left, right = fl + rl, fr + rr
    both, more = left + right + 1.0 / _WEIGHT, right - left
    pull, turn = task.pull_n, task.moment_nm / design.half_track_m
    scale = 1.0 / (both * both - more * more)
    a, b = scale * (both * pull - more * turn), scale * (both * turn - more * pull)
    return fl * (a - b), fr * (a + b), rl * (a - b), rr * (a + b)


def _allowed(design: TractionDesign, task: Task, force_n: Four, most_n: Four) -> bool:
    """Tell whether these forces keep all limits."""
    a, b, c, d = force_n
    p, q, r, s = most_n
    if not (-p <= a <= p and -q <= b <= q and -r <= c <= r and -s <= d <= s):
        return False
    v, w, x, y = task.speed_mps
    return abs(v * a + w * b + x * c + y * d) <= design.config.battery_power_w


def _limited(design: TractionDesign, task: Task, grip: Four, most_n: Four) -> Four:
    """Solve the programme where something limits."""
    config, unit = design.config, _FORCE_UNIT_N
    wish = np.array([task.pull_n, task.moment_nm / design.half_track_m]) / unit
    hessian = design.demand_hessian.copy()
    hessian.flat[::5] += [1.0 / g for g in grip]
    upper = np.array([*(most / unit for most in most_n), config.battery_power_w / unit])
    solution, _, flag, _ = design.solve(  # type: ignore[misc]
        hessian, -_WEIGHT * design.demand.T @ wish, np.array([task.speed_mps]), upper, -upper, _NO_SENSE
    )
    if flag < 1:
        return _in_proportion(design, task, most_n)
    a, b, c, d = solution.tolist()
    return a * unit, b * unit, c * unit, d * unit


_NO_SENSE = np.zeros(5, dtype=np.int32)


def limits_n(design: TractionDesign, task: Task) -> Four:
    """The most that each wheel may pull or brake with."""
    config, torque_n = design.config, design.torque_max_nm / design.radius_m
    if config.share == "equal":
        return torque_n, torque_n, torque_n, torque_n
    along = math.sqrt(max(task.friction**2 - task.side_use**2, 0.0))
    a, b, c, d = task.load_n
    return (
        min(torque_n, along * a),
        min(torque_n, along * b),
        min(torque_n, along * c),
        min(torque_n, along * d),
    )


def _in_proportion(design: TractionDesign, task: Task, most_n: Four) -> Four:
    force = []
    for side, most in zip(_SIDE, most_n, strict=True):
        of_side = 0.5 * (task.pull_n - side * task.moment_nm / design.half_track_m)
        whole = most_n[0] + most_n[2] if side > 0.0 else most_n[1] + most_n[3]
        force.append(min(1.0, max(-1.0, of_side / whole)) * most if whole > 0.0 else 0.0)
    return _four(force)


# ---- carrying out


def slip_limits_rpm(design: TractionDesign, turning_rpm: Four, estimate: Estimate) -> tuple[Four, Four]:
    """Slowest and fastest that each wheel should turn at the body's speed and yaw rate.

    Slip that all four wheels have is what this ground takes, and the drive's to decide: the limit counts from
    the slowest wheel where that is faster than the body.
    """
    config, odometry = design.config, estimate.odometry
    rpm_per_mps = 1.0 / (design.radius_m * _RADPS_PER_RPM)
    turning = odometry.yaw_rate_radps * design.half_track_m
    slowest = min(map(abs, turning_rpm)) / rpm_per_mps
    limits = []
    for speed in (odometry.speed_mps - turning, odometry.speed_mps + turning):
        held = max(abs(speed), slowest)
        spread = held - abs(speed) + config.slip_max * held + config.slip_margin_mps
        limits.append(((speed - spread) * rpm_per_mps, (speed + spread) * rpm_per_mps))
    (slow_left, fast_left), (slow_right, fast_right) = limits
    return (slow_left, slow_right, slow_left, slow_right), (fast_left, fast_right, fast_left, fast_right)


def _beyond(rpm: Four, slow_rpm: Four, fast_rpm: Four) -> Four:
    """How far each wheel is out of its slip limits, with sign."""
    a, b, c, d = (
        turning - fast if turning > fast else turning - slow if turning < slow else 0.0
        for turning, slow, fast in zip(rpm, slow_rpm, fast_rpm, strict=True)
    )
    return a, b, c, d


def _trim(
    config: TractionConfig, trim_rpm: Four, wheel_rpm: Four, missing_nm: Four, beyond_rpm: Four, dt: float
) -> Four:
    """Integrate what each wheel's torque misses of its share, less what it slips beyond its limit.

    What both wheels of a side have in common would change speed or yaw rate, which are the drive's: it fades.
    """
    if wheel_rpm == STILL:
        left_over = max(0.0, 1.0 - config.release_per_s * dt)
        return _four([left_over * trim if abs(trim) > _SNAP_RPM else 0.0 for trim in trim_rpm])
    fl, fr, rl, rr = trim_rpm
    left, right = 0.5 * (fl + rl), 0.5 * (fr + rr)
    fade, keep = config.forget_per_s * dt, config.speed_keeping_per_s * dt
    torque, slip = config.torque_gain_rpm_per_nms * dt, config.slip_gain_per_s * dt
    return _four(
        [
            trim - fade * (trim - both) - keep * both + torque * missing - slip * beyond
            for trim, both, missing, beyond in zip(
                trim_rpm, (left, right, left, right), missing_nm, beyond_rpm, strict=True
            )
        ]
    )


def _within(most_rpm: float, trim_rpm: Four, wheel_rpm: Four, slow_rpm: Four, fast_rpm: Four) -> Four:
    """Keep trims from driving a wheel out of its slip limits; what the drive commands they leave alone."""
    return _four(
        [
            min(most_rpm, max(fast - rpm, 0.0), max(-most_rpm, min(slow - rpm, 0.0), trim))
            for trim, rpm, slow, fast in zip(trim_rpm, wheel_rpm, slow_rpm, fast_rpm, strict=True)
        ]
    )


def _trimmed(design: TractionDesign, wheel_rpm: Four, trim_rpm: Four) -> Four:
    """Wheel speeds with their trims, none beyond the fastest that the drive may command."""
    if trim_rpm == STILL:
        return wheel_rpm
    most = design.rpm_max
    return _four([min(most, max(-most, a + b)) for a, b in zip(wheel_rpm, trim_rpm, strict=True)])


def _four(values: list[float]) -> Four:
    a, b, c, d = values
    return a, b, c, d
