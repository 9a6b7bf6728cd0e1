"""Forces over four tyres: the programme against scipy, its limits, and how the trims carry it out."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize

from tiger.config.robot import load_robot
from tiger.control import traction
from tiger.control.traction import (
    Task,
    TractionDesign,
    TractionState,
    allocate,
    design_traction,
    limits_n,
    measured,
    step,
)
from tiger.logs.checkpoint import freeze, thaw
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.record import STILL, DriveSample, Estimate, Inputs, Loads, Odometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.robot import RobotConfig
    from tiger.record import Four

ROBOT = load_robot()
DT = ROBOT.loop.period_s
RADPS_PER_RPM = math.pi / 30.0
CRUISE: Four = (20.0, 20.0, 20.0, 20.0)
EVEN: Four = (196.0, 196.0, 196.0, 196.0)
CROSSWISE: Four = (40.0, 350.0, 350.0, 40.0)  # FL and RR nearly hang
SPEED_MPS = 20.0 * RADPS_PER_RPM * ROBOT.vehicle.tire.rolling_radius_m


def tuned(**keys: object) -> RobotConfig:
    return ROBOT.model_copy(update={"traction": ROBOT.traction.model_copy(update=keys)})


def designed(**keys: object) -> TractionDesign:
    return design_traction(tuned(**{"mode": "on", **keys}))


DESIGN = designed()


def task(
    pull_n: float = 0.0,
    moment_nm: float = 0.0,
    load_n: Four = EVEN,
    friction: float = 0.6,
    side_use: float = 0.0,
    speed_mps: Four = (0.3, 0.3, 0.3, 0.3),
) -> Task:
    return Task(pull_n, moment_nm, load_n, friction, side_use, speed_mps)


def of_wheels(torque_nm: Four, rpm: Four = CRUISE) -> Inputs:
    """What the Roboteqs say of wheels that turn so, with such torques."""
    motor = MotorCurrent()
    fl, fr, rl, rr = motor.true_a(torque_nm, np.array(rpm) * RADPS_PER_RPM).tolist()

    def drive(a: float, b: float, wheels: tuple[float, float]) -> DriveSample:
        return DriveSample(0.0, wheels, (a, b), (0.2 * a, 0.2 * b), 24.0, 30.0, 0, 0)

    return Inputs(
        0.0,
        armed=True,
        drive_left=drive(fl, rl, (rpm[0], rpm[2])),
        drive_right=drive(fr, rr, (rpm[1], rpm[3])),
    )


def known(load_n: Four = EVEN, speed_mps: float = SPEED_MPS, **keys: float) -> Estimate:
    where = Odometry(speed_mps=speed_mps, yaw_rate_radps=keys.pop("yaw_rate_radps", 0.0))
    return Estimate(ready=True, loads=Loads(wheel_load_n=load_n), odometry=where, **keys)


# ---- the programme ------------------------------------------

loads = st.tuples(*[st.floats(5.0, 500.0)] * 4)
tasks = st.builds(
    Task,
    pull_n=st.floats(-800.0, 800.0),
    moment_nm=st.floats(-300.0, 300.0),
    load_n=loads,
    friction=st.floats(0.2, 1.2),
    side_use=st.floats(0.0, 0.5),
    speed_mps=st.tuples(*[st.floats(-6.0, 6.0)] * 4),
)


def cost(design: TractionDesign, wanted: Task, force_n: np.ndarray) -> float:
    """The module's first two lines, in units of 100 N."""
    force = force_n / 100.0
    grip = wanted.friction * np.array(wanted.load_n) / 100.0
    side = np.array([-1.0, 1.0, -1.0, 1.0])
    missing = force.sum() - wanted.pull_n / 100.0
    turning = side @ force - wanted.moment_nm / design.half_track_m / 100.0
    return float(0.5 * np.sum(force**2 / grip) + 0.5 * 1e4 * (missing**2 + turning**2))


@settings(deadline=None, max_examples=60)
@given(tasks)
def test_the_forces_are_the_best_that_a_general_solver_finds(wanted: Task) -> None:
    most = np.array(limits_n(DESIGN, wanted))
    power = DESIGN.config.battery_power_w
    speed = np.array(wanted.speed_mps)
    found = np.array(allocate(DESIGN, wanted))
    assert (np.abs(found) <= most + 1e-3).all()
    assert abs(speed @ found) <= power + 0.1
    best = minimize(
        lambda f: cost(DESIGN, wanted, 100.0 * f),
        0.9 * np.clip(found, -most, most) / 100.0,
        bounds=list(zip(-most / 100.0, most / 100.0, strict=True)),
        constraints=LinearConstraint(speed, -power / 100.0, power / 100.0),
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    assert cost(DESIGN, wanted, found) <= best.fun * (1.0 + 1e-6) + 1e-3


@given(pull=st.floats(-200.0, 200.0), load=loads)
def test_where_nothing_limits_every_wheel_uses_the_same_part_of_its_friction(pull: float, load: Four) -> None:
    # The share of each side is given by pull and moment; a moment that fits the loads leaves all four alike.
    total = sum(load)
    share = [pull * n / total for n in load]
    moment = DESIGN.half_track_m * (share[1] + share[3] - share[0] - share[2])
    wanted = task(pull, moment, load, friction=1.0)
    if any(abs(f) > m for f, m in zip(share, limits_n(DESIGN, wanted), strict=True)):
        return
    assert allocate(DESIGN, wanted) == pytest.approx(share, abs=0.05)


@settings(deadline=None, max_examples=60)
@given(tasks)
def test_where_nothing_limits_the_solver_finds_the_same_forces(wanted: Task) -> None:
    """Away from the limits two linear equations give what the programme's solver would."""
    easy = replace(wanted, pull_n=0.05 * wanted.pull_n, moment_nm=0.05 * wanted.moment_nm)
    grip = tuple(easy.friction * load / 100.0 for load in easy.load_n)
    asked = []
    counting = replace(DESIGN, solve=lambda *args: asked.append(args) or DESIGN.solve(*args))
    found = allocate(counting, easy)
    assume(not asked)
    assert found == pytest.approx(traction._limited(DESIGN, easy, grip, limits_n(DESIGN, easy)), abs=1e-3)


def test_wheels_alike_pull_alike() -> None:
    assert allocate(DESIGN, task(120.0)) == pytest.approx((30.0,) * 4, abs=0.01)


def test_mirrored_loads_have_mirrored_forces() -> None:
    fl, fr, rl, rr = allocate(DESIGN, task(150.0, 20.0, (50.0, 200.0, 300.0, 120.0)))
    assert allocate(DESIGN, task(150.0, -20.0, (200.0, 50.0, 120.0, 300.0))) == pytest.approx(
        (fr, fl, rr, rl), abs=1e-6
    )


def test_backwards_is_forwards_with_the_sign_turned() -> None:
    ahead = allocate(DESIGN, task(150.0, 20.0, CROSSWISE))
    assert allocate(DESIGN, task(-150.0, -20.0, CROSSWISE)) == pytest.approx([-f for f in ahead], abs=1e-6)


def test_a_left_turn_pushes_with_the_right_wheels() -> None:
    fl, fr, rl, rr = allocate(DESIGN, task(0.0, 60.0))
    assert (fr, rr) == pytest.approx((25.0, 25.0), abs=0.01)
    assert (fl, rl) == pytest.approx((-25.0, -25.0), abs=0.01)


def test_a_wheel_that_hardly_carries_hardly_pulls() -> None:
    fl, fr, rl, rr = allocate(DESIGN, task(90.0, 0.0, CROSSWISE))
    assert (fl, rr) == pytest.approx((90.0 * 40.0 / 780.0,) * 2, abs=0.01)
    assert (fr, rl) == pytest.approx((90.0 * 350.0 / 780.0,) * 2, abs=0.01)


def test_pull_and_moment_are_kept_as_long_as_the_limits_let_them() -> None:
    force = np.array(allocate(DESIGN, task(120.0, 15.0, (60.0, 300.0, 250.0, 170.0))))
    assert force.sum() == pytest.approx(120.0, abs=0.02)
    assert DESIGN.half_track_m * (force[1] + force[3] - force[0] - force[2]) == pytest.approx(15.0, abs=0.02)


def test_equal_shares_take_no_notice_of_the_loads() -> None:
    design = designed(share="equal")
    assert allocate(design, task(90.0, 0.0, CROSSWISE)) == pytest.approx((22.5,) * 4, abs=0.01)


# ---- limits -------------------------------------------------


def test_too_much_is_asked_and_every_wheel_gives_what_it_can() -> None:
    wanted = task(5000.0, 0.0, CROSSWISE)
    assert allocate(DESIGN, wanted) == pytest.approx(limits_n(DESIGN, wanted), abs=1e-3)


def test_no_wheel_pulls_more_than_its_friction() -> None:
    fl, fr, rl, rr = limits_n(DESIGN, task(friction=0.1, load_n=(10.0, 100.0, 200.0, 300.0)))
    assert (fl, fr, rl, rr) == pytest.approx((1.0, 10.0, 20.0, 30.0))


@pytest.mark.parametrize(("side", "left"), [(0.0, 1.0), (0.36, 0.8), (0.6, 0.0), (0.7, 0.0)])
def test_what_holds_sideways_does_not_pull(side: float, left: float) -> None:
    wanted = task(friction=0.6, side_use=side, load_n=(20.0, 20.0, 20.0, 20.0))
    assert limits_n(DESIGN, wanted) == pytest.approx((left * 12.0,) * 4, abs=1e-9)


def test_the_motor_and_the_current_that_stops_the_robot_limit_the_pull() -> None:
    radius = ROBOT.vehicle.tire.rolling_radius_m
    torque = DESIGN.torque_max_nm
    assert torque <= 0.9 * MotorCurrent().torque_nm(ROBOT.safety.max_sustained_current_a, 1e9)
    assert limits_n(DESIGN, task(friction=1.2, load_n=(500.0,) * 4)) == pytest.approx((torque / radius,) * 4)
    strong = ROBOT.with_motor_current(100.0)
    assert design_traction(strong).torque_max_nm == pytest.approx(0.9 * ROBOT.vehicle.drive.max_torque_nm)  # type: ignore[union-attr]


def test_the_battery_limits_the_pull_at_speed() -> None:
    design = designed(battery_power_w=200.0)
    force = np.array(allocate(design, task(180.0, speed_mps=(3.0, 3.0, 3.0, 3.0))))
    assert 3.0 * force.sum() == pytest.approx(200.0, abs=0.1)
    assert force == pytest.approx((200.0 / 12.0,) * 4, abs=0.01)


@pytest.mark.parametrize("pull", [120.0, -120.0, 4000.0])
def test_a_solver_that_fails_leaves_shares_within_the_limits(pull: float) -> None:
    broken = replace(DESIGN, solve=lambda *_: (np.full(4, np.nan), 0.0, -1, {}))
    wanted = task(pull, 0.0, CROSSWISE)
    force, most = np.array(allocate(broken, wanted)), np.array(limits_n(broken, wanted))
    assert (np.abs(force) <= most + 1e-9).all()
    whole = most.sum()
    assert force.sum() == pytest.approx(math.copysign(min(abs(pull), whole), pull))


# ---- what is measured ---------------------------------------


@given(st.tuples(*[st.floats(-15.0, 15.0)] * 4), st.tuples(*[st.floats(-400.0, 400.0)] * 4))
@example((4.0, 3.0, 2.0, 1.0), (10.0, 20.0, 30.0, 40.0))
def test_torques_are_those_behind_the_currents(torque: Four, rpm: Four) -> None:
    speed, found = measured(of_wheels(torque, rpm))
    assert found == pytest.approx(torque, abs=1e-9)
    assert speed == pytest.approx(np.array(rpm) * RADPS_PER_RPM)


def test_power_is_torque_times_speed_and_volts_times_amps() -> None:
    inputs = of_wheels((4.0, 3.0, 2.0, 1.0), (10.0, 20.0, 30.0, 40.0))
    _, traction, _ = step(DESIGN, due(), CRUISE, inputs, known(), DT)
    assert traction.power_w == pytest.approx(
        [t * n * RADPS_PER_RPM for t, n in ((4.0, 10.0), (3.0, 20.0), (2.0, 30.0), (1.0, 40.0))]
    )
    assert inputs.drive_right is not None
    assert traction.electric_w[1] == pytest.approx(24.0 * inputs.drive_right.battery_current_a[0])


def test_friction_use_is_force_over_load() -> None:
    _, traction, _ = step(DESIGN, due(), CRUISE, of_wheels((4.0,) * 4), known(CROSSWISE), DT)
    radius = ROBOT.vehicle.tire.rolling_radius_m
    assert traction.friction_use == pytest.approx([4.0 / radius / load for load in CROSSWISE])


# ---- trims --------------------------------------------------


def due(state: TractionState | None = None) -> TractionState:
    """A state whose next tick shares out anew."""
    return replace(state or TractionState(), ticks=100)


def ticks(
    design: TractionDesign,
    inputs: Inputs,
    estimate: Estimate,
    seconds: float,
    wheel_rpm: Four = CRUISE,
    state: TractionState | None = None,
) -> tuple[TractionState, Four]:
    state, rpm = state or TractionState(), wheel_rpm
    for _ in range(round(seconds / DT)):
        state, _, rpm = step(design, state, wheel_rpm, inputs, estimate, DT)
    return state, rpm


@pytest.mark.parametrize("mode", ["off", "log"])
def test_off_and_log_leave_the_wheel_speeds_alone(mode: str) -> None:
    state, rpm = ticks(designed(mode=mode), of_wheels((1.0, 8.0, 8.0, 1.0)), known(), 2.0)
    assert rpm == CRUISE
    assert state.last.trim_rpm == STILL
    assert (state.last.force_n != STILL) == (mode == "log")


def test_without_drives_nothing_happens() -> None:
    state, rpm = ticks(DESIGN, Inputs(0.0, armed=True), known(), 0.1)
    assert (state, rpm) == (TractionState(), CRUISE)


def test_switching_on_is_bumpless() -> None:
    """However uneven the torques are, the first trims are those of one update."""
    state, rpm = ticks(DESIGN, of_wheels((0.0, 8.0, 8.0, 0.0)), known(), DT * DESIGN.ticks_per_update)
    most = 4.0 * ROBOT.traction.torque_gain_rpm_per_nms * DT * DESIGN.ticks_per_update
    assert rpm != CRUISE
    assert max(abs(a - b) for a, b in zip(rpm, CRUISE, strict=True)) <= most + 1e-3
    assert state.ticks == 0


def test_a_wheel_that_pulls_too_little_is_sped_up_and_its_partner_slowed_down() -> None:
    state, rpm = ticks(DESIGN, of_wheels((2.0, 4.0, 6.0, 4.0)), known(), 0.5)
    fl, fr, rl, rr = state.last.trim_rpm
    assert fl == pytest.approx(-rl, abs=1e-3)
    assert fl > 2.0
    assert abs(fr) < 1e-2 > abs(rr)
    assert rpm == pytest.approx([20.0 + t for t in state.last.trim_rpm])


@settings(deadline=None, max_examples=50)
@given(torque=st.tuples(*[st.floats(-5.0, 5.0)] * 4), load=loads, yaw=st.floats(-0.2, 0.2))
def test_trims_never_exceed_their_limits_nor_the_slip(torque: Four, load: Four, yaw: float) -> None:
    estimate = known(load, yaw_rate_radps=yaw)
    state, rpm = ticks(DESIGN, of_wheels(torque), estimate, 3.0)
    config, radius = DESIGN.config, DESIGN.radius_m
    for trim, wheel, side in zip(state.last.trim_rpm, rpm, (1.0, -1.0, 1.0, -1.0), strict=True):
        assert abs(trim) <= config.trim_max_rpm
        speed = SPEED_MPS - side * yaw * DESIGN.half_track_m
        held = max(abs(speed), SPEED_MPS)
        spread = held - abs(speed) + config.slip_max * held + config.slip_margin_mps
        rim = wheel * RADPS_PER_RPM * radius
        assert speed - spread - 1e-9 <= rim <= speed + spread + 1e-9


def test_trims_without_limits_change_neither_speed_nor_yaw_rate() -> None:
    state, _ = ticks(DESIGN, of_wheels((1.0, 6.0, 5.0, 2.0)), known(CROSSWISE), 1.0)
    fl, fr, rl, rr = state.last.trim_rpm
    assert max(map(abs, (fl, fr, rl, rr))) > 5.0
    assert fl + rl == pytest.approx(0.0, abs=0.01)
    assert fr + rr == pytest.approx(0.0, abs=0.01)


def test_a_spinning_wheel_is_slowed_to_its_slip_limit() -> None:
    """Even where the torques are as they should be."""
    spinning: Four = (100.0, 20.0, 20.0, 20.0)
    design = designed(torque_gain_rpm_per_nms=0.0)
    state, _ = ticks(design, of_wheels((2.0,) * 4, spinning), known(), 0.5)
    assert state.last.trim_rpm[0] < -10.0
    slow: Four = (30.0, 20.0, 20.0, 20.0)
    state, _ = ticks(design, of_wheels((2.0,) * 4, slow), known(), 0.5)
    assert state.last.trim_rpm == pytest.approx(STILL)


def test_slip_that_all_wheels_share_is_left_to_the_drive() -> None:
    state, rpm = ticks(DESIGN, of_wheels((6.0,) * 4), known(speed_mps=0.02), 2.0)
    assert rpm == pytest.approx(CRUISE, abs=1e-3)
    assert state.last.trim_rpm == pytest.approx(STILL, abs=1e-3)


def test_a_standing_robot_forgets_its_trims() -> None:
    state, _ = ticks(DESIGN, of_wheels((1.0, 6.0, 5.0, 2.0)), known(CROSSWISE), 1.0)
    last = state.last.trim_rpm
    largest = max(map(abs, last))
    state, rpm = ticks(DESIGN, of_wheels(STILL, STILL), known(CROSSWISE, 0.0), 0.1, STILL, state)
    assert 0.0 < max(map(abs, rpm)) < largest  # it ramps ...
    state, rpm = ticks(DESIGN, of_wheels(STILL, STILL), known(CROSSWISE, 0.0), 3.0, STILL, state)
    assert rpm == STILL  # ... and ends at exactly zero


def test_trimmed_speeds_stay_below_the_fastest_that_the_drive_may_command() -> None:
    fast: Four = (DESIGN.rpm_max,) * 4
    speed = DESIGN.rpm_max * RADPS_PER_RPM * DESIGN.radius_m
    _, rpm = ticks(DESIGN, of_wheels((1.0, 3.0, 5.0, 3.0), fast), known(speed_mps=speed), 2.0, fast)
    assert max(rpm) <= DESIGN.rpm_max


# ---- friction -----------------------------------------------


def test_wheels_that_hold_with_more_than_the_friction_known_raise_it() -> None:
    light: Four = (90.0,) * 4
    torque = 0.9 * 90.0 * DESIGN.radius_m  # friction use 0.9, known 0.6
    state, _ = ticks(DESIGN, of_wheels((torque,) * 4), known(light), 5.0)
    assert state.last.friction == pytest.approx(0.9, abs=0.01)
    state, _ = ticks(DESIGN, of_wheels((1.0,) * 4), known(light), 60.0, state=state)
    assert state.last.friction == pytest.approx(0.6, abs=0.01)  # forgotten


SPINNING: Four = (90.0, 20.0, 20.0, 20.0)


def test_a_wheel_that_slips_is_trusted_with_what_it_pulls_and_later_with_all_again() -> None:
    pull_n = 0.3 * 196.0  # half of what load and friction promise
    torque: Four = (pull_n * DESIGN.radius_m, 4.0, 4.0, 4.0)
    state, _ = ticks(DESIGN, of_wheels(torque, SPINNING), known(), 4.0)
    assert state.grip == pytest.approx((0.5, 1.0, 1.0, 1.0), abs=0.01)
    state, _ = ticks(DESIGN, of_wheels((4.0,) * 4), known(), 5.0, state=state)
    assert 0.7 < state.grip[0] < 0.9
    state, _ = ticks(DESIGN, of_wheels((4.0,) * 4), known(), 60.0, state=state)
    assert state.grip[0] == pytest.approx(1.0, abs=1e-3)


def test_a_hanging_wheel_that_spins_leaves_its_share_to_the_others_though_its_load_seems_right() -> None:
    torque: Four = (0.1, 4.0, 7.9, 4.0)
    before, _ = ticks(DESIGN, of_wheels(torque), known(), 0.02)
    state, _ = ticks(DESIGN, of_wheels(torque, SPINNING), known(), 4.0)
    assert before.last.force_n[0] == pytest.approx(4.0 / DESIGN.radius_m, abs=0.05)  # half of the left side's
    assert state.last.force_n[0] < 0.1 * state.last.force_n[2]
    assert sum(state.last.force_n) == pytest.approx(16.0 / DESIGN.radius_m, abs=0.5)


def test_a_wheel_that_is_dragged_along_keeps_its_grip() -> None:
    """It turns too slowly for a wheel that drives: that is no sign of slip by its own pull."""
    dragged: Four = (2.0, 20.0, 20.0, 20.0)
    state, _ = ticks(DESIGN, of_wheels((3.0, 4.0, 4.0, 4.0), dragged), known(), 2.0)
    assert state.grip == pytest.approx((1.0,) * 4)


# ---- logs and time ------------------------------------------


def test_a_checkpoint_goes_on_as_the_original() -> None:
    inputs, estimate = of_wheels((1.0, 6.0, 5.0, 2.0)), known(CROSSWISE)
    state, _ = ticks(DESIGN, inputs, estimate, 0.333)
    copy = thaw(TractionState(), freeze(state))
    for _ in range(50):
        state, one, rpm = step(DESIGN, state, CRUISE, inputs, estimate, DT)
        copy, other, same = step(DESIGN, copy, CRUISE, inputs, estimate, DT)
        assert (one, rpm) == (other, same)


def test_the_programme_takes_far_less_than_a_millisecond(record_figure: Callable) -> None:
    random = np.random.default_rng(1)
    taken = []
    for _ in range(2000):
        load = random.uniform(5.0, 400.0, 4)
        wanted = task(random.uniform(-300.0, 300.0), random.uniform(-60.0, 60.0), tuple(load.tolist()))  # type: ignore[arg-type]
        start = time.thread_time()
        allocate(DESIGN, wanted)
        taken.append(time.thread_time() - start)
    p99_ms = 1e3 * float(np.percentile(taken, 99))
    record_figure("sharing out the forces, 99th percentile", f"{p99_ms:.3f} ms", "<= 1 ms")
    assert p99_ms <= 1.0


def test_a_tick_costs_little(record_figure: Callable) -> None:
    inputs, estimate, state = of_wheels((1.0, 6.0, 5.0, 2.0)), known(CROSSWISE), TractionState()
    means = []
    for _ in range(5):
        start = time.thread_time()
        for _ in range(1000):
            state, _, _ = step(DESIGN, state, CRUISE, inputs, estimate, DT)
        means.append((time.thread_time() - start) / 1000.0)
    mean_us = 1e6 * min(means)
    record_figure("traction, mean of a tick", f"{mean_us:.1f} us", "<= 25 us")
    assert mean_us <= 25.0
