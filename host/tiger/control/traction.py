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
the friction everywhere. `share = "equal"` leaves the friction out of it, which makes of each side an open
differential. A speed that a wheel slips at beyond its limit is taken back by the same integral, and no trim
drives a wheel out of its slip limits, so that a host that stops here leaves nothing but four steady speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

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


@dataclass(frozen=True, slots=True, eq=False)
class TractionDesign:
    """What `design_traction` computes once."""

    config: TractionConfig
    solve: Callable[..., Any] | None
    """DAQP's, None with mode = "off"."""
    radius_m: float
    half_track_m: float
    torque_max_nm: float
    static_load_n: Four
    demand: Array
    """Share of each force in the pull and, over the half track, in the moment, (2, 4)."""
    ticks_per_update: int


@dataclass(frozen=True, slots=True)
class TractionState:
    """What a tick leaves to the next."""

    ticks: int = 0  # since the last update
    last: Traction = Traction()


@dataclass(frozen=True, slots=True)
class Task:
    """What is asked of the four tyres, and what limits them."""

    pull_n: float
    moment_nm: float  # + turns left
    load_n: Four
    side_use: float  # sideways force over load, the same for all
    speed_mps: Four  # of the wheels' rims


def design_traction(robot: RobotConfig) -> TractionDesign:
    """Gather limits from the vehicle, its drives and the safety limits."""
    config, vehicle, body = robot.traction, robot.vehicle, robot.vehicle.body
    solve = None
    if config.mode != "off":
        from daqp import solve
    motor = MotorCurrent()
    motor_nm = vehicle.drive.max_torque_nm if vehicle.drive is not None else 0.0
    current_nm = (robot.safety.max_motor_current_a - motor.no_load_a) * motor.torque_per_amp_nm
    wheelbase = body.com_to_front_axle_m + body.com_to_rear_axle_m
    half = 0.5 * GRAVITY_MPS2 * body.mass_kg / wheelbase
    front = half * body.com_to_rear_axle_m + vehicle.front.unsprung_mass_kg * GRAVITY_MPS2
    rear = half * body.com_to_front_axle_m + vehicle.rear.unsprung_mass_kg * GRAVITY_MPS2
    return TractionDesign(
        config=config,
        solve=solve,
        radius_m=vehicle.tire.rolling_radius_m * robot.drive.wheel_radius_factor,
        half_track_m=body.half_track_m,
        torque_max_nm=config.torque_share_max * min(motor_nm, current_nm),
        static_load_n=(front, front, rear, rear),
        demand=np.array([[1.0] * 4, [-side for side in _SIDE]]),
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
    config = design.config
    if config.mode == "off" or inputs.drive_left is None or inputs.drive_right is None:
        return state, state.last, wheel_rpm
    ticks, last = state.ticks + 1, state.last
    if ticks >= design.ticks_per_update:
        last = _update(design, last, wheel_rpm, inputs, estimate, ticks * dt)
        ticks = 0
    return TractionState(ticks, last), last, _sum(wheel_rpm, last.trim_rpm)


def _update(
    design: TractionDesign, last: Traction, wheel_rpm: Four, inputs: Inputs, estimate: Estimate, dt: float
) -> Traction:
    """Measure, share out, trim."""
    speed_radps, torque_nm = measured(inputs)
    load_n = wheel_loads_n(design, estimate)
    task = task_of(design, torque_nm, speed_radps, load_n, estimate)
    force_n = allocate(design, task)
    trim_rpm = STILL
    if design.config.mode == "on":
        slip_rpm = _slip_limits_rpm(design, wheel_rpm, estimate)
        trim_rpm = _trim(design, last.trim_rpm, wheel_rpm, speed_radps, torque_nm, force_n, slip_rpm, dt)
    a, b, c, d = (torque / design.radius_m / load for torque, load in zip(torque_nm, load_n, strict=True))
    return Traction(
        force_n=force_n,
        torque_nm=torque_nm,
        power_w=_product(torque_nm, speed_radps),
        electric_w=_electric_w(inputs),
        friction_use=(a, b, c, d),
        trim_rpm=trim_rpm,
    )


# ---- what is measured


def measured(inputs: Inputs) -> tuple[Four, Four]:
    """Speeds of the wheels in rad/s and their torques in Nm, from the currents; zero before the first sample."""
    left, right = inputs.drive_left, inputs.drive_right
    if left is None or right is None:
        return STILL, STILL
    rpm = (left.wheel_rpm[0], right.wheel_rpm[0], left.wheel_rpm[1], right.wheel_rpm[1])
    (fl, rl), (fr, rr) = left.motor_current_a, right.motor_current_a
    a, b, c, d = (value * _RADPS_PER_RPM for value in rpm)
    speed_radps = a, b, c, d
    e, f, g, h = (_torque_nm(i, w) for i, w in zip((fl, fr, rl, rr), speed_radps, strict=True))
    return speed_radps, (e, f, g, h)


_MOTOR = MotorCurrent()


def _torque_nm(current_a: float, speed_radps: float) -> float:
    """Torque behind a current, as `MotorCurrent.torque_nm` for plain floats."""
    drag_a = _MOTOR.no_load_a * math.tanh(speed_radps / _DRAG_SPEED_RADPS)
    return (current_a - drag_a) * _MOTOR.torque_per_amp_nm


def _electric_w(inputs: Inputs) -> Four:
    """Battery voltage times each motor's battery current."""
    left, right = inputs.drive_left, inputs.drive_right
    assert left is not None
    assert right is not None
    (fl, rl), (fr, rr) = left.battery_current_a, right.battery_current_a
    return fl * left.battery_v, fr * right.battery_v, rl * left.battery_v, rr * right.battery_v


def wheel_loads_n(design: TractionDesign, estimate: Estimate) -> Four:
    """The estimated wheel loads, of at least `min_load_n`; the static ones as long as there is no estimate."""
    loads = estimate.loads.wheel_load_n
    if loads == STILL:
        loads = design.static_load_n
    least = design.config.min_load_n
    a, b, c, d = loads
    return max(a, least), max(b, least), max(c, least), max(d, least)


# ---- sharing out


def task_of(
    design: TractionDesign, torque_nm: Four, speed_radps: Four, load_n: Four, estimate: Estimate
) -> Task:
    """What the speed loops demand of the tyres together, and what else the tyres have to carry."""
    r, y = design.radius_m, design.half_track_m
    fl, fr, rl, rr = torque_nm
    odometry = estimate.odometry
    sideways_mps2 = odometry.speed_mps * estimate.yaw_rate_radps + GRAVITY_MPS2 * math.sin(estimate.roll_rad)
    a, b, c, d = speed_radps
    return Task(
        pull_n=(fl + fr + rl + rr) / r,
        moment_nm=(fr + rr - fl - rl) * y / r,
        load_n=load_n,
        side_use=abs(sideways_mps2) / GRAVITY_MPS2,
        speed_mps=(a * r, b * r, c * r, d * r),
    )


def allocate(design: TractionDesign, task: Task) -> Four:
    """Solve the programme for the forces in N, FL FR RL RR.

    It always has a solution, f = 0 at worst: the demand is a wish. Should the solver fail, each side's
    wheels get what they can of the demand in proportion to their limits.
    """
    config, unit = design.config, _FORCE_UNIT_N
    most_n = limits_n(design, task)
    if config.share == "load":
        grip = [config.friction * load / unit for load in task.load_n]
    else:
        grip = [config.friction * sum(task.load_n) / 4.0 / unit] * 4
    wish = np.array([task.pull_n, task.moment_nm / design.half_track_m]) / unit
    hessian = _WEIGHT * design.demand.T @ design.demand
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
    share = math.sqrt(max(config.friction**2 - task.side_use**2, 0.0))
    a, b, c, d = task.load_n
    return (
        min(torque_n, share * a),
        min(torque_n, share * b),
        min(torque_n, share * c),
        min(torque_n, share * d),
    )


def _in_proportion(design: TractionDesign, task: Task, most_n: Four) -> Four:
    force = []
    for side, most in zip(_SIDE, most_n, strict=True):
        of_side = 0.5 * (task.pull_n - side * task.moment_nm / design.half_track_m)
        whole = most_n[0] + most_n[2] if side > 0.0 else most_n[1] + most_n[3]
        force.append(min(1.0, max(-1.0, of_side / whole)) * most if whole > 0.0 else 0.0)
    a, b, c, d = force
    return a, b, c, d


# ---- carrying out


def _slip_limits_rpm(design: TractionDesign, wheel_rpm: Four, estimate: Estimate) -> tuple[Four, Four]:
    """Slowest and fastest that each wheel should turn at the body's speed."""
    config, odometry = design.config, estimate.odometry
    turning = odometry.yaw_rate_radps * design.half_track_m
    low, high = [], []
    for side in _SIDE:
        speed = odometry.speed_mps - side * turning
        spread = config.slip_max * abs(speed) + config.slip_margin_mps
        low.append((speed - spread) / design.radius_m / _RADPS_PER_RPM)
        high.append((speed + spread) / design.radius_m / _RADPS_PER_RPM)
    return (low[0], low[1], low[2], low[3]), (high[0], high[1], high[2], high[3])


def _trim(
    design: TractionDesign,
    trim_rpm: Four,
    wheel_rpm: Four,
    speed_radps: Four,
    torque_nm: Four,
    force_n: Four,
    slip_rpm: tuple[Four, Four],
    dt: float,
) -> Four:
    """Integrate what each wheel's torque misses of its share, and take back what slips too much."""
    config = design.config
    if wheel_rpm == STILL:
        keep = max(0.0, 1.0 - config.release_per_s * dt)
        return _four([trim * keep if abs(trim * keep) > _SNAP_RPM else 0.0 for trim in trim_rpm])
    trims, keep = [], 1.0 - config.forget_per_s * dt
    for i in range(4):
        missing_nm = force_n[i] * design.radius_m - torque_nm[i]
        turns_rpm = speed_radps[i] / _RADPS_PER_RPM
        low, high = slip_rpm[0][i], slip_rpm[1][i]
        beyond_rpm = max(turns_rpm - high, 0.0) + min(turns_rpm - low, 0.0)
        trim = keep * trim_rpm[i] + dt * (
            config.torque_gain_rpm_per_nms * missing_nm - config.slip_gain_per_s * beyond_rpm
        )
        most = config.trim_max_rpm
        # A trim may bring a wheel to its slip limit, not beyond; what the drive commands it leaves alone.
        up, down = max(high - wheel_rpm[i], 0.0), min(low - wheel_rpm[i], 0.0)
        trims.append(min(most, up, max(-most, down, trim)))
    return _four(trims)


def _four(values: list[float]) -> Four:
    a, b, c, d = values
    return a, b, c, d


def _sum(left: Four, right: Four) -> Four:
    return left[0] + right[0], left[1] + right[1], left[2] + right[2], left[3] + right[3]


def _product(left: Four, right: Four) -> Four:
    return left[0] * right[0], left[1] * right[1], left[2] * right[2], left[3] * right[3]
