"""A robot that drives on paper: exact motion in, samples of noisy sensors out, for tests of dead reckoning."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import cos, pi, radians, sin

import numpy as np

from tiger.record import Estimate, Four, ImuRawSample, Inputs, StrokeSample, WheelSample

G = 9.80665
RADIUS_M = 0.162
HALF_TRACK_M = 0.61
PERIOD_S = 0.01
NO_SLIP: Four = (0.0, 0.0, 0.0, 0.0)
_SIDE = (1.0, -1.0, 1.0, -1.0)


@dataclass
class Truth:
    """What the robot really did at the last sample."""

    time_s: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    travelled_m: float = 0.0
    slip: Four = NO_SLIP


def still(_: float) -> float:
    return 0.0


@dataclass
class Driven:
    """Speeds, slips and slopes as functions of time; `run` yields inputs, attitude and truth at 100 Hz."""

    speed_mps: Callable[[float], float] = still
    yaw_rate_radps: Callable[[float], float] = still
    slip: Callable[[float], Four] = lambda _: NO_SLIP
    climb_rad: float = 0.0  # of the ground, along the robot's heading
    body_level: bool = False  # the suspension takes the climb out
    scrub: float = 1.5
    seed: int = 0
    noisy: bool = True
    gyro_bias_degps: tuple[float, float, float] = (0.4, -0.7, 0.9)
    accel_bias_mps2: tuple[float, float] = (0.015, -0.012)
    iron_ut: tuple[float, float] = (1.5, -1.8)
    disturbance_ut: Callable[[float], float] = still
    stroke_mm: float = 35.0
    truth: Truth = field(default_factory=Truth)

    def run(self, duration_s: float) -> Iterator[tuple[Inputs, Estimate, Truth]]:
        random = np.random.default_rng(self.seed)
        noise = 1.0 if self.noisy else 0.0
        bias = np.radians(self.gyro_bias_degps)
        truth, dt = self.truth, PERIOD_S
        pitch = 0.0 if self.body_level else -self.climb_rad
        turned = [0.0] * 4
        mag = (0.0, 0.0, 0.0)
        for step in range(1, round(duration_s / dt) + 1):
            time_s = step * dt
            before = truth.speed_mps
            speed, yaw_rate, slip = self.speed_mps(time_s), self.yaw_rate_radps(time_s), self.slip(time_s)
            middle = truth.yaw_rad + 0.5 * yaw_rate * dt
            along = 0.5 * (before + speed) * dt
            truth.time_s, truth.speed_mps, truth.yaw_rate_radps, truth.slip = time_s, speed, yaw_rate, slip
            truth.x_m += along * cos(self.climb_rad) * cos(middle)
            truth.y_m += along * cos(self.climb_rad) * sin(middle)
            truth.yaw_rad += yaw_rate * dt
            truth.travelled_m += abs(along)
            tangent = (speed - before) / dt
            # Acceleration along the ground, and gravity, seen from the body.
            lean = self.climb_rad + pitch  # of the body against the ground
            force = (
                tangent * cos(lean) - G * sin(pitch),
                speed * yaw_rate,
                G * cos(pitch) + tangent * sin(lean),
            )
            accel = force + noise * (
                np.array([*self.accel_bias_mps2, 0.0]) + 0.012 * random.standard_normal(3)
            )
            rate = np.array([0.0, 0.0, yaw_rate]) + noise * (bias + radians(0.1) * random.standard_normal(3))
            if step % 5 == 0:
                away = self.disturbance_ut(time_s)
                field_x = 20.0 * cos(truth.yaw_rad) + noise * self.iron_ut[0] + away
                field_y = -20.0 * sin(truth.yaw_rad) + noise * self.iron_ut[1]
                level = np.array([field_x, field_y, -43.0]) + 0.6 * random.standard_normal(3) * max(
                    noise, 1e-6
                )
                x, y, z = level
                mag = (cos(pitch) * x - sin(pitch) * z, y, sin(pitch) * x + cos(pitch) * z)
            wheels = []
            for i, side in enumerate(_SIDE):
                # A wheel's own slip comes on top of the scrub of the turn.
                ground = speed - side * self.scrub * HALF_TRACK_M * yaw_rate
                push = tangent + G * sin(self.climb_rad)  # which takes a small slip of every tyre
                surface = (
                    ground * (1.0 + slip[i] + push / (21.5 * G)) + noise * 0.004 * random.standard_normal()
                )
                wheels.append(surface / RADIUS_M if abs(ground) > 1e-9 else 0.0)
                turned[i] += wheels[i] * dt
            edges = [int(angle * 240.0 / (2.0 * pi)) for angle in turned]
            inputs = Inputs(
                now_s=time_s + 0.004,
                armed=True,
                strokes=StrokeSample(time_s, (self.stroke_mm,) * 4, NO_SLIP, (0, 0, 0, 0), 0),
                imu_raw=ImuRawSample(time_s, _three(accel), _three(rate), mag),
                wheels_left=WheelSample(time_s, (edges[0], edges[2]), (wheels[0], wheels[2]), 0),
                wheels_right=WheelSample(time_s, (edges[1], edges[3]), (wheels[1], wheels[3]), 0),
            )
            yield inputs, Estimate(ready=True, pitch_rad=pitch, plate_pitch_rad=-self.climb_rad), truth


def _three(values: np.ndarray) -> tuple[float, float, float]:
    a, b, c = values.tolist()
    return a, b, c


def ramp(at_s: float, to: float, over_s: float = 2.0, begin: float = 0.0) -> Callable[[float], float]:
    """A smooth change of a speed."""

    def value(time_s: float) -> float:
        share = min(max((time_s - at_s) / over_s, 0.0), 1.0)
        return begin + (to - begin) * share * share * (3.0 - 2.0 * share)

    return value
