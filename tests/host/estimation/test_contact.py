"""What attitude, strokes and currents tell of contact, fed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import WARP
from tiger.estimation import contact
from tiger.estimation.contact import Contact, ContactDesign, ContactState
from tiger.record import STILL, Command, DriveSample, Estimate, Inputs, Loads, Mode, Odometry, StrokeSample

TICKS, TICK_S = 20, 0.005
BALANCE = Command(Mode.BALANCE)


@pytest.fixture(scope="module")
def design() -> ContactDesign:
    return contact.design_contact(load_robot())


def strokes_of(design: ContactDesign, twist_mm: float) -> tuple[float, ...]:
    curve = design.suspension.curve
    middle = curve.at(35.0)[0]
    return tuple(float(curve.stroke_mm(middle + sign * twist_mm)) for sign in WARP)


def look(
    design: ContactDesign,
    state: ContactState,
    twist_mm: float,
    attitude_rad: tuple[float, float] = (0.0, 0.0),
    loads: Loads = Loads(),  # noqa: B008  frozen
    current_a: tuple[float, float, float, float] = STILL,
    distance_m: float = 0.0,
) -> tuple[ContactState, Contact]:
    """Let one period pass with these strokes and this attitude."""
    fl, fr, rl, rr = current_a
    drives = [
        DriveSample(0.0, (0.0, 0.0), pair, (0.0, 0.0), 24.0, None, 0, 0) for pair in ((fl, rl), (fr, rr))
    ]
    strokes = StrokeSample(0.0, strokes_of(design, twist_mm), STILL, (0, 0, 0, 0), 0)  # type: ignore[arg-type]
    estimate = replace(
        Estimate(ready=True),
        roll_rad=attitude_rad[0],
        pitch_rad=attitude_rad[1],
        odometry=Odometry(distance_m=distance_m, speed_mps=0.2),
    )
    start_s, found = max(state.at_s + TICKS * TICK_S, 0.0), state.contact
    for tick in range(TICKS):
        now_s = start_s + TICK_S * tick
        inputs = Inputs(now_s, True, BALANCE, strokes=strokes, drive_left=drives[0], drive_right=drives[1])
        state, found = contact.step(design, state, inputs, estimate, loads, TICK_S)
    return state, found


def answer(design: ContactDesign, twist_mm: float, hangs: str = "FL") -> tuple[float, float]:
    """Roll and pitch of a body with that wheel in the air, at this twist of ground and strokes together."""
    wheel = ("FL", "FR", "RL", "RR").index(hangs)
    half_m, base_m = design.y_m[0], design.x_m[0] - design.x_m[2]
    roll = pitch = 0.0
    for _ in range(30):  # the tilt makes the lighter wheel lighter
        off = contact._lift_off_mm(design, (roll, pitch), (0.0, 0.0, 0.0))[wheel]
        excess_m = 0.001 * max(0.0, abs(twist_mm) - off)
        roll = excess_m / half_m * (1.0 if hangs in ("FL", "RL") else -1.0)
        pitch = 2.0 * excess_m / base_m * (-1.0 if hangs in ("FL", "FR") else 1.0)
    return roll, pitch


def ride(design: ContactDesign, ground_mm: float, way: tuple[float, ...], hangs: str = "FL") -> Contact:
    """Twist the strokes along `way`; the attitude answers as it does with that wheel in the air."""
    state, found = contact.initial_state(design), Contact()
    for twist in way:
        state, found = look(design, state, twist, answer(design, ground_mm + twist, hangs))
    return found


def test_lift_off_is_where_the_static_load_is_used_up(design) -> None:
    _, found = look(design, contact.initial_state(design), 0.0)
    weight = 9.80665 * design.mass_kg / 4.0
    assert found.lift_off_mm[1] == pytest.approx(weight / design.stiffness_npmm)
    assert found.lift_off_mm[0] == pytest.approx(-found.lift_off_mm[1])


def test_payload_in_a_corner_makes_the_opposite_corner_lift_first(design) -> None:
    loads = Loads(mass_kg=design.mass_kg + 20.0, com_m=(0.05, 0.03, 0.0))
    _, found = look(design, contact.initial_state(design), 0.0, loads=loads)
    low, high = contact._lift_off_mm(design, (0.0, 0.0), (loads.mass_kg, 0.05, 0.03))[3], found.lift_off_mm[1]
    assert -found.lift_off_mm[0] == pytest.approx(low)
    assert low < high


@pytest.mark.parametrize(("ground_mm", "hangs"), [(-75.0, "FL"), (-75.0, "RR"), (75.0, "FR"), (75.0, "RL")])
def test_the_wheel_that_hangs_is_found_by_the_way_the_body_turns(design, ground_mm, hangs) -> None:
    start = math.copysign(66.0, ground_mm)
    way = tuple(start - math.copysign(2.0, start) * k for k in range(5))
    found = ride(design, ground_mm, way, hangs)
    assert max(found.hanging) > 0.8
    assert ("FL", "FR", "RL", "RR")[int(np.argmax(found.hanging))] == hangs


def test_touchdown_tells_the_twist_of_the_ground(design) -> None:
    way = tuple(-66.0 + 2.0 * k for k in range(16))
    found = ride(design, -70.0, way)
    assert found.ground_warp_mm == pytest.approx(-70.0, abs=3.0)
    assert found.sigma_mm < 4.0
    assert max(found.hanging) < 0.05


def test_no_answer_leaves_the_middle_likeliest(design) -> None:
    found = ride(design, 0.0, (0.0, 2.0, 4.0, 2.0, 0.0, -2.0, -4.0, -2.0, 0.0))
    assert abs(found.ground_warp_mm) < 2.0
    assert max(found.hanging) < 0.05
    assert found.sigma_mm > 25.0


def test_a_robot_tilted_by_hand_with_still_strokes_says_nothing_of_contact(design) -> None:
    state, _ = look(design, contact.initial_state(design), 0.0)
    before = state.contact
    for k in range(1, 6):
        state, found = look(design, state, 0.0, (0.01 * k, -0.01 * k))
    assert found.ground_warp_mm == pytest.approx(before.ground_warp_mm, abs=1.0)
    assert max(found.hanging) < 0.05


def test_a_motor_that_pushes_proves_its_wheel_is_on_the_ground(design) -> None:
    way = tuple(-66.0 + 2.0 * k for k in range(5))
    hanging = ride(design, -75.0, way)
    assert hanging.hanging[0] > 0.8
    state = contact.initial_state(design)
    for twist in way:
        state, found = look(design, state, twist, current_a=(60.0, 60.0, 60.0, 60.0))
    assert max(found.hanging) < 0.01


def test_driving_lets_what_was_known_fade(design) -> None:
    state, found = contact.initial_state(design), Contact()
    for twist in (-66.0, -64.0, -62.0, -60.0, -58.0, -50.0, -40.0):
        state, found = look(design, state, twist, answer(design, twist - 70.0))
    assert found.sigma_mm < 5.0
    _, later = look(design, state, -40.0, distance_m=0.5)
    assert later.sigma_mm > 2.0 * found.sigma_mm
