"""A robot without its boards: the 14-DOF vehicle driven over terrain, seen through sensors with their noise.

For estimators alone: no firmware, no wire, no daemon, so that a minute of driving costs seconds. The speed
loops of the wheels are those of the emulated Roboteqs; the attitude is without an attitude filter's error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import cos, pi, sin
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from tiger.emulation.vehicle_body import VehicleBody
from tiger.models.eam import Eam
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.motor_current import MotorCurrent
from tiger.record import STILL, DriveSample, Four, ImuSample, Inputs, StrokeSample, WheelSample

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.emulation.body import Motion
    from tiger.emulation.scenarios import Scenario

TICK_S, STEP_S, STEPS = 0.005, 0.001, 5
ACCEL_NOISE_MPS2, ACCEL_STEP_MPS2, GYRO_NOISE_RADPS = 0.012, 0.01, 0.0015  # a BNO055 in its bandwidth
AIM_PER_M = 0.3  # how sharply it steers back
CURRENTS_EVERY, CURRENTS_LATE = 16, 3  # ticks between two readings of a Roboteq's currents, and their age


class Tick(NamedTuple):
    """What the estimators get, and what is true."""

    inputs: Inputs
    truth: Motion
    attitude_rad: tuple[float, float, float]


@pytest.fixture(scope="session")
def roll() -> Callable[..., Iterator[Tick]]:
    """Return `rolling`."""
    return rolling


def rolling(
    robot: RobotConfig,
    scenario: Scenario,
    commanded: Callable[[float], tuple[float, float]],
    seed: int = 0,
    strokes: Callable[[float], Four] | None = None,
    along_x: bool = False,
) -> Iterator[Tick]:
    """Yield a tick every 5 ms. `commanded(time_s)` is (speed in m/s, yaw rate in rad/s), taken as it is.

    Strokes stand in the middle, or where `strokes(time_s)` puts them. `along_x` steers back to the x axis: a
    road has its two tracks there.
    """
    random = np.random.default_rng(seed)
    vehicle, motor = robot.vehicle, MotorCurrent()
    rpm_per_mps, half_track = 30.0 / pi / vehicle.tire.rolling_radius_m, vehicle.body.half_track_m
    curve = Eam.from_vehicle(vehicle).curve()
    mid = 0.5 * robot.actuator.stroke_max_mm
    datum = curve.at(mid)[0]

    def pose(time_s: float) -> tuple[Four, list[float]]:
        stroke = (mid, mid, mid, mid) if strokes is None else strokes(time_s)
        return stroke, [1e-3 * (curve.at(s)[0] - datum) for s in stroke]

    body = VehicleBody(vehicle, scenario, (0.0, 0.0), pose(0.0)[1])
    body.prepare(STEP_S)
    before, sample = np.array(body.rate_radps), None
    current = reading = np.zeros(4)
    for tick in range(round(scenario.duration_s / TICK_S)):
        now_s = tick * TICK_S
        stroke, lift = pose(now_s)
        back = 0.0
        if along_x:
            back = AIM_PER_M * (body.attitude_rad[2] + AIM_PER_M * body.motion().position_m[1])
        for step in range(STEPS):  # a command in stairs of 5 ms would make a saw of the torque
            speed, yaw_rate = commanded(now_s + STEP_S * step)
            yaw_rate -= speed * back
            left, right = ((speed - yaw_rate * y) * rpm_per_mps for y in (half_track, -half_track))
            body.advance((0.0, 0.0), lift, (left, right, left, right))
        if tick % 2 == 0:
            rate = np.array(body.rate_radps)
            sample = _imu(now_s, body, (rate - before) / (2.0 * TICK_S), random)
            before = rate
        if tick % CURRENTS_EVERY == 0:
            reading = motor.measured_a(motor.true_a(body.wheel_torque_nm, body.wheel_radps), random)
        if tick % CURRENTS_EVERY == CURRENTS_LATE:
            current = reading
        yield Tick(_inputs(now_s, body, stroke, sample, current), body.motion(), body.attitude_rad)


def _imu(
    now_s: float, body: VehicleBody, turn: NDArray[np.float64], random: np.random.Generator
) -> ImuSample:
    a, b, c = (0.5 * angle for angle in body.attitude_rad)
    w = cos(a) * cos(b) * cos(c) + sin(a) * sin(b) * sin(c)
    x = sin(a) * cos(b) * cos(c) - cos(a) * sin(b) * sin(c)
    y = cos(a) * sin(b) * cos(c) + sin(a) * cos(b) * sin(c)
    z = cos(a) * cos(b) * sin(c) - sin(a) * sin(b) * cos(c)
    up = np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
    felt = body.accel_mps2 + ACCEL_NOISE_MPS2 * random.standard_normal(3)
    lx, ly, lz = (np.rint(felt / ACCEL_STEP_MPS2) * ACCEL_STEP_MPS2 - GRAVITY_MPS2 * up).tolist()
    p, q, r = (body.rate_radps + GYRO_NOISE_RADPS * random.standard_normal(3)).tolist()
    pp, qq, rr = turn.tolist()
    return ImuSample(now_s, (w, x, y, z), (p, q, r), (pp, qq, rr), (lx, ly, lz), 0)


def _inputs(
    now_s: float, body: VehicleBody, stroke: Four, imu: ImuSample | None, current_a: NDArray[np.float64]
) -> Inputs:
    fl, fr, rl, rr = body.wheel_radps
    i_fl, i_fr, i_rl, i_rr = current_a.tolist()
    rpm = 30.0 / pi
    return Inputs(
        now_s=now_s,
        armed=True,
        strokes=StrokeSample(now_s, stroke, STILL, (0, 0, 0, 0), 0),
        imu=imu,
        wheels_left=WheelSample(now_s, (0, 0), (fl, rl), 0),
        wheels_right=WheelSample(now_s, (0, 0), (fr, rr), 0),
        drive_left=DriveSample(now_s, (fl * rpm, rl * rpm), (i_fl, i_rl), (0.0, 0.0), 24.0, None, 0, 0),
        drive_right=DriveSample(now_s, (fr * rpm, rr * rpm), (i_fr, i_rr), (0.0, 0.0), 24.0, None, 0, 0),
    )
