"""Mode `balance` in closed loop: the controller on a body that stands on up to four springs.

Heave, pitch and roll on four springs that are unequal by up to 5 %, under tyres that push and never pull. The
loads are known here and to nobody else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.config.robot import load_robot
from tiger.control.reachable import WARP, Suspension
from tiger.daemon import controller
from tiger.models.full_car import GRAVITY_MPS2, FullCarParameters
from tiger.record import Command, ImuSample, Inputs, Mode, StrokeSample

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.daemon.controller import ControllerDesign

    Array = NDArray[np.float64]

TICK_S, STEP_S = 0.005, 0.001
WRONG_WAY = (0.0, 70.0, 70.0, 0.0)
MID = (35.0, 35.0, 35.0, 35.0)


class Standing:
    """A rigid body on four springs that push and do not pull beyond the weight of their wheels."""

    def __init__(self, design: ControllerDesign, ground_mm: Array, seed: int) -> None:
        robot = design.robot
        self.random = np.random.default_rng(seed)
        self.suspension: Suspension = design.leveling.suspension
        car = FullCarParameters.from_config(robot.vehicle)
        stiff = 1.0 / (1.0 / car.spring_npm() + 1.0 / car.tire_stiffness_npm)
        self.stiff_npm = stiff * (1.0 + 0.05 * self.random.uniform(-1.0, 1.0, 4))
        self.static_n = car.static_tire_load_n()
        self.damping_nspm = car.damper_nspm()
        self.inertia = np.array([car.body_mass_kg, car.pitch_inertia_kgm2, car.roll_inertia_kgm2])
        above_m = (
            robot.vehicle.body.com_height_m - robot.vehicle.tire.rolling_radius_m
        )  # above the wheel centres
        lever_nm = car.body_mass_kg * GRAVITY_MPS2 * above_m
        self.lever_nm = lever_nm * np.array([0.0, 1.0, 1.0])
        self.corners = car.corner_kinematics()  # corner heights from heave, pitch, roll
        self.ground_m = 0.001 * ground_mm
        self.pose, self.rate, self.seat = np.zeros(3), np.zeros(3), None
        self.load_n = self.static_n

    def stand(self, stroke_mm: Array, duration_s: float) -> None:
        """Let time pass under these strokes, in steps of a millisecond."""
        lift = np.array([self.suspension.curve.at(s)[0] for s in stroke_mm]) * 0.001
        seat = lift - self.suspension.curve.at(35.0)[0] * 0.001 + self.ground_m
        steps = round(duration_s / STEP_S)
        seat_rate = np.zeros(4) if self.seat is None else (seat - self.seat) / duration_s
        self.seat = seat
        for _ in range(steps):
            push = self.stiff_npm * (seat - self.corners @ self.pose)
            push += self.damping_nspm * (seat_rate - self.corners @ self.rate)
            self.load_n = np.maximum(self.static_n + push, 0.0)
            force = self.corners.T @ (self.load_n - self.static_n) + self.lever_nm * self.pose
            self.rate = self.rate + STEP_S * force / self.inertia
            self.pose = self.pose + STEP_S * self.rate

    @property
    def attitude_rad(self) -> tuple[float, float]:
        return float(self.pose[2]), float(self.pose[1])


@dataclass
class Run:
    """One row a tick."""

    time_s: Array
    load_n: Array
    attitude_deg: Array
    stroke_mm: Array
    reasons: list[str] = field(repr=False)

    @property
    def difference(self) -> Array:
        """Of the mean loads of the two diagonals, over the mean load."""
        return np.asarray((self.load_n @ np.array(WARP)) / (0.5 * self.load_n.sum(axis=1)))

    def until_s(self, bad: Array) -> float:
        """Time until something is over for good."""
        return float(self.time_s[bad][-1]) if bad.any() else 0.0


def run(
    design: ControllerDesign,
    ground_mm: Array,
    seed: int,
    stroke_mm: tuple[float, ...] = MID,
    duration_s: float = 9.0,
    mode: Mode = Mode.BALANCE,
) -> Run:
    """Stand in `hold` for two seconds, then change the mode."""
    body = Standing(design, ground_mm, seed)
    stroke, rate = np.array(stroke_mm), np.zeros(4)
    body.stand(stroke, 5.0)
    state = controller.initial_state(design)
    lag = math.exp(-TICK_S / design.robot.actuator.lag_s)
    rows, reasons = [], []
    for tick in range(-400, round(duration_s / TICK_S)):
        body.stand(stroke, TICK_S)
        roll, pitch = body.attitude_rad
        noise = math.radians(0.05) * body.random.standard_normal(2)
        now = tick * TICK_S
        sample = None
        if tick % 2 == 0:
            q = _quaternion(roll + noise[0], pitch + noise[1])
            sample = ImuSample(
                now, q, (float(body.rate[2]), float(body.rate[1]), 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0
            )
        strokes = StrokeSample(now, tuple(stroke), tuple(rate), (0, 0, 0, 0), 0)
        command = Command(mode if tick >= 0 else Mode.HOLD)
        inputs = Inputs(now, True, command, strokes, sample)
        state, outputs = controller.step(design, state, inputs, TICK_S)
        rate = lag * rate + (1.0 - lag) * np.array(outputs.stroke_rate_mmps)
        stroke = np.clip(stroke + rate * TICK_S, 0.0, 70.0)
        if tick >= 0:
            rows.append((now, *body.load_n, math.degrees(roll), math.degrees(pitch), *stroke))
            reasons.append(outputs.reason)
    table = np.array(rows)
    return Run(table[:, 0], table[:, 1:5], table[:, 5:7], table[:, 7:11], reasons)


def _quaternion(roll: float, pitch: float) -> tuple[float, float, float, float]:
    a, b, c, d = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return a * c, b * c, a * d, -b * d


def twisted(twist_mm: float) -> Array:
    """Ground raised by `twist_mm` under FL and RR, lowered as much under the others."""
    return twist_mm * np.array(WARP)


@pytest.fixture(scope="module")
def design() -> ControllerDesign:
    return controller.design_controller(load_robot())


# ---- Figure 4.14: two wheels in the air ------------------------


@pytest.mark.parametrize("seed", [1, 2, 3, 4])  # springs of seed 0: it hangs by 1 mm, which is too little
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_two_wheels_in_the_air_are_all_loaded_and_balanced_within_eight_seconds(design, side, seed) -> None:
    stroke = WRONG_WAY if side < 0.0 else tuple(70.0 - s for s in WRONG_WAY)
    result = run(design, twisted(side * 60.0) + seed, seed, stroke)
    start = np.sort(result.load_n[0])
    assert start[0] == 0.0
    assert start[1] < 0.1 * start[2]
    assert result.until_s(result.load_n.min(axis=1) < 5.0) < 2.0
    assert result.until_s(np.abs(result.difference) > 0.10) < 8.0
    assert np.abs(result.attitude_deg[-200:]).max() < 0.3


def test_the_attitude_stays_near_level_once_four_wheels_touch(design) -> None:
    result = run(design, twisted(-60.0), 5, WRONG_WAY)
    touching = result.time_s > 2.0
    assert np.abs(result.attitude_deg[touching]).max() < 0.5


@pytest.mark.parametrize(
    ("twist_mm", "roll_deg", "pitch_deg", "seed"),
    [(70.0, 1.0, 0.0, 1), (75.0, 0.0, -1.5, 2), (80.0, -1.0, 1.0, 3)],
)
def test_a_hanging_wheel_is_brought_down_on_a_slope(design, twist_mm, roll_deg, pitch_deg, seed) -> None:
    x, y = np.array([500, 500, -500, -500.0]), np.array([600, -600, 600, -600.0])
    slope = y * math.radians(roll_deg) - x * math.radians(pitch_deg)
    result = run(design, twisted(-twist_mm) + slope, seed, WRONG_WAY)
    assert result.load_n[-1].min() > 60.0
    beyond = max(0.0, twist_mm - design.leveling.suspension.warp_most_mm)
    assert abs(result.difference[-1]) < 0.10 + 2.0 * beyond * 1.6 / 196.0


def test_it_says_which_wheel_hangs_while_it_does(design) -> None:
    result = run(design, twisted(-75.0), 1, WRONG_WAY)
    hanging = [reason for reason in result.reasons if "in the air" in reason]
    assert hanging
    named = hanging[0].split(", ")[1].split()[0]
    lifted = ("FL", "FR", "RL", "RR").index(named)
    at = result.reasons.index(hanging[0])
    assert result.load_n[at, lifted] < 5.0
    assert result.reasons[-1].startswith("balance: balanced")


# ---- four wheels on the ground ------------------------------------


def test_on_flat_ground_it_only_probes(design) -> None:
    result = run(design, twisted(0.0), 1)
    assert np.abs(result.difference).max() < 0.12
    assert np.abs(result.difference[-1]) < 0.02
    assert np.abs(result.stroke_mm[-1] - 35.0).max() < 1.0
    assert np.ptp(result.stroke_mm[-400:], axis=0).max() < 0.05


def test_strokes_left_twisted_on_flat_ground_are_straightened(design) -> None:
    result = run(design, twisted(0.0), 1, WRONG_WAY)
    assert abs(result.difference[-1]) < 0.10


def test_a_twist_that_lifts_no_wheel_cannot_be_seen_at_a_standstill_and_is_left_alone(design) -> None:
    result = run(design, twisted(20.0), 1)
    assert result.difference[-1] == pytest.approx(result.difference[0], abs=0.04)
    assert result.load_n.min() > 100.0


def test_leaving_the_mode_takes_the_twist_out_again(design) -> None:
    level = run(design, twisted(0.0), 1, WRONG_WAY, mode=Mode.LEVEL)
    assert abs(level.difference[-1]) < abs(level.difference[0])
