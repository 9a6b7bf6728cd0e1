"""Dead reckoning on paper: exact motion in, samples of noisy sensors out, and what is made of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import cos, degrees, hypot, pi, radians, sin, sqrt

import numpy as np
import pytest

from tiger.config.errors import ConfigError
from tiger.config.robot import load_robot
from tiger.estimation import inertial
from tiger.estimation import odometry as dead_reckoning
from tiger.estimation.inertial import FX, FY, HX, HY, HZ, YAW, Learned, Measurement, Motion
from tiger.estimation.odometry import Magnetic, OdometryState
from tiger.logs.checkpoint import freeze, thaw
from tiger.record import Estimate, Four, ImuRawSample, Inputs, Odometry, StrokeSample, WheelSample

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
    """A robot driven by functions of time; `run` yields inputs, attitude and truth at 100 Hz."""

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
    iron_ut: tuple[float, float, float] = (1.5, -1.8, 0.0)
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
                x, y, z = 20.0 * cos(truth.yaw_rad) + away, -20.0 * sin(truth.yaw_rad), -43.0
                in_body = np.array([cos(pitch) * x - sin(pitch) * z, y, sin(pitch) * x + cos(pitch) * z])
                own = noise * np.array(self.iron_ut) + 0.6 * random.standard_normal(3) * max(noise, 1e-6)
                mag = _three(in_body + own)
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


ROBOT = load_robot(None)
DESIGN = dead_reckoning.design_odometry(ROBOT)
STAND_S = 6.0


@dataclass
class Ride:
    """What was believed and what was true, one row a sample."""

    state: OdometryState = field(default_factory=OdometryState)
    last: Odometry = field(default_factory=Odometry)
    truth: Truth = field(default_factory=Truth)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """time, error of x, y, yaw, speed, their sigmas."""

    def column(self, index: int) -> np.ndarray:
        return np.array(self.rows)[:, index]


def ride(driven: Driven, duration_s: float, after: Callable[[Odometry, Truth], None] | None = None) -> Ride:
    result = Ride(truth=driven.truth)
    age_s = 0.004
    for inputs, estimate, truth in driven.run(duration_s):
        result.state, believed = dead_reckoning.step(DESIGN, result.state, inputs, estimate, 0.01)
        ahead_m = truth.speed_mps * cos(driven.climb_rad) * age_s
        c = believed.covariance
        result.rows.append(
            (
                truth.time_s,
                believed.x_m - truth.x_m - ahead_m * cos(truth.yaw_rad),
                believed.y_m - truth.y_m - ahead_m * sin(truth.yaw_rad),
                believed.yaw_rad - truth.yaw_rad - truth.yaw_rate_radps * age_s,
                believed.speed_mps - truth.speed_mps,
                *(sqrt(max(v, 0.0)) for v in (c[0], c[3], c[5])),
                believed.speed_sigma_mps,
            )
        )
        if after is not None:
            after(believed, truth)
        result.last = believed
    return result


def wander(time_s: float) -> float:
    """Turn now to the left, now to the right."""
    return 0.3 * sin(0.4 * (time_s - STAND_S)) if time_s > STAND_S + 3.0 else 0.0


def between(first_s: float, last_s: float, slip: Four) -> Callable[[float], Four]:
    def value(time_s: float) -> Four:
        return slip if first_s <= time_s < last_s else (0.0, 0.0, 0.0, 0.0)

    return value


def test_before_any_sample_nothing_is_claimed() -> None:
    state, believed = dead_reckoning.step(
        DESIGN, OdometryState(), Inputs(now_s=0.0, armed=False), next(Driven().run(0.01))[1], 0.005
    )
    assert believed == Odometry()
    assert not state.begun


def test_a_robot_that_stands_stays_where_it_is_and_learns_its_gyro() -> None:
    result = ride(Driven(), 60.0)
    assert result.last.standing
    assert hypot(result.last.x_m, result.last.y_m) < 0.02
    assert abs(degrees(result.last.yaw_rad)) < 0.3
    biases = [degrees(bias) for bias in result.state.motion.learned.gyro_bias_radps]
    assert biases[2] == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("speed", [0.5, 2.0, -1.0])
def test_a_straight_drive_ends_where_the_wheels_say(speed: float) -> None:
    result = ride(Driven(ramp(STAND_S, speed)), 50.0)
    assert abs(result.rows[-1][1]) < 0.005 * result.truth.travelled_m
    assert abs(result.rows[-1][2]) < 0.01 * result.truth.travelled_m
    assert result.last.distance_m == pytest.approx(result.truth.travelled_m, rel=0.005)
    assert result.last.speed_mps == pytest.approx(speed, abs=0.02)
    assert not result.last.standing


def test_a_wrong_wheel_radius_is_a_wrong_distance() -> None:
    """What calibration must give: the estimate hangs on it."""
    drive = ROBOT.drive.model_copy(update={"wheel_radius_factor": 1.05})
    design = dead_reckoning.design_odometry(ROBOT.model_copy(update={"drive": drive}))
    state, driven = OdometryState(), Driven(ramp(STAND_S, 1.0))
    for inputs, estimate, _ in driven.run(40.0):
        state, believed = dead_reckoning.step(design, state, inputs, estimate, 0.01)
    assert believed.x_m == pytest.approx(1.05 * driven.truth.x_m, rel=0.01)


@pytest.mark.parametrize("level", [False, True])
def test_a_climb_counts_along_the_ground_and_maps_onto_the_plane(level: bool) -> None:
    climb = radians(8.0)
    result = ride(Driven(ramp(STAND_S, 1.0), climb_rad=climb, body_level=level), 50.0)
    along = result.truth.travelled_m
    assert result.last.x_m == pytest.approx(along * cos(climb), rel=0.006)
    assert along - result.truth.x_m > 0.009 * along


@pytest.mark.parametrize("minutes", [2, pytest.param(10, marks=pytest.mark.proof)])
def test_heading_keeps_within_a_degree_over_minutes_of_turns(minutes: int) -> None:
    result = ride(Driven(ramp(STAND_S, 0.7), wander, seed=3), 60.0 * minutes)
    assert np.degrees(np.abs(result.column(3))).max() < 1.0
    assert hypot(result.rows[-1][1], result.rows[-1][2]) < 0.01 * result.truth.travelled_m


def test_hard_iron_is_learned_while_the_robot_turns() -> None:
    driven = Driven(ramp(STAND_S, 0.7), ramp(STAND_S + 2.0, 0.3), seed=5)
    result = ride(driven, 120.0)
    assert result.state.motion.learned.iron_ut[:2] == pytest.approx(driven.iron_ut[:2], abs=0.4)


@pytest.mark.parametrize("error", [YAW, FX, FY, HX, HY, HZ])
def test_the_field_is_expected_to_change_with_each_error_as_it_does(error: int) -> None:
    """On a slope the vertical part of the hard iron leans over, too."""
    learned = Learned(field_ut=(20.0, 3.0), iron_ut=(1.5, -1.8, 2.0))
    motion = Motion(yaw_rad=0.7, pitch_rad=-0.1, roll_rad=0.08, learned=learned)
    found = Magnetic((0.0, 0.0, 0.0), -43.0, found=True)

    def look(motion: Motion) -> list[Measurement]:
        return dead_reckoning._with_field(ROBOT.odometry, motion, found, (18.0, -12.0, -40.0), 0.05)[2]

    step = np.zeros(inertial.N)
    step[error] = 1e-4
    before, after = look(motion), look(inertial.put_right(motion, step))
    for old, new in zip(before, after, strict=True):
        assert (old.innovation - new.innovation) / 1e-4 == pytest.approx(old.row.get(error, 0.0), abs=0.01)


def test_a_magnet_beside_the_way_turns_no_heading() -> None:
    def passing(time_s: float) -> float:
        return 15.0 if 40.0 < time_s < 55.0 else 0.0

    result = ride(Driven(ramp(STAND_S, 0.7), wander, disturbance_ut=passing, seed=2), 70.0)
    assert np.degrees(np.abs(result.column(3))).max() < 1.0


@pytest.mark.parametrize("most_ut", [2.0, 5.0, 15.0])
def test_a_magnet_that_is_slowly_passed_turns_no_heading(most_ut: float) -> None:
    """No sample of it is off by much, but all of them are off together."""

    def passing(time_s: float) -> float:
        return most_ut * sin(pi * (time_s - 40.0) / 15.0) if 40.0 < time_s < 55.0 else 0.0

    result = ride(Driven(ramp(STAND_S, 0.7), wander, disturbance_ut=passing, seed=2), 70.0)
    assert np.degrees(np.abs(result.column(3))).max() < 1.5


def test_a_sensor_that_has_not_woken_up_is_not_believed() -> None:
    """It reads zero of everything, which is neither level nor without a bias."""
    state = OdometryState()
    asleep = ImuRawSample(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for inputs, estimate, truth in Driven().run(5.0):
        if truth.time_s < 1.0:
            inputs = replace(inputs, imu_raw=replace(asleep, t_s=truth.time_s))
        state, believed = dead_reckoning.step(DESIGN, state, inputs, estimate, 0.01)
        assert state.begun == (truth.time_s >= 1.0)
    assert degrees(state.motion.learned.gyro_bias_radps[2]) == pytest.approx(0.9, abs=0.05)
    assert abs(degrees(believed.yaw_rad)) < 0.5


def bias_at_standstill_degps(felt_degps: float, from_s: float, until_s: float) -> float:
    """The yaw gyro's bias as learned while the wheels stand and the gyro feels more from some time on."""
    state = OdometryState()
    for inputs, estimate, truth in Driven().run(until_s):
        raw = inputs.imu_raw
        if raw is not None and truth.time_s > from_s:
            p, q, r = raw.gyro_radps
            inputs = replace(inputs, imu_raw=replace(raw, gyro_radps=(p, q, r + radians(felt_degps))))
        state, _ = dead_reckoning.step(DESIGN, state, inputs, estimate, 0.01)
    return degrees(state.motion.learned.gyro_bias_radps[2])


def test_a_turn_before_the_first_tooth_is_no_bias_of_the_gyro() -> None:
    """Driving off turns the body a little while the wheel sensors still say that it stands."""
    before = bias_at_standstill_degps(0.0, 20.0, 20.5)
    assert bias_at_standstill_degps(-0.8, 20.0, 20.5) == pytest.approx(before, abs=0.003)


def test_a_bias_that_has_jumped_is_learned_anew() -> None:
    assert bias_at_standstill_degps(0.5, 20.0, 60.0) == pytest.approx(1.4, abs=0.05)


@pytest.mark.parametrize("ratio", [0.15, -0.15])
@pytest.mark.parametrize("wheels", range(1, 16))
def test_five_seconds_of_slip_of_any_wheels_cost_little(wheels: int, ratio: float) -> None:
    slip = tuple(ratio if wheels >> i & 1 else 0.0 for i in range(4))
    assert len(slip) == 4
    began, errors = [], []

    def after(believed: Odometry, truth: Truth) -> None:
        if 20.0 <= truth.time_s < 25.0:
            flagged = all(b == (s != 0.0) for b, s in zip(believed.slipping, truth.slip, strict=True))
            if flagged and not began:
                began.append(truth.time_s - 20.0)
            if truth.time_s > 20.05:
                errors.append([b - s for b, s in zip(believed.slip_ratio, truth.slip, strict=True)])

    result = ride(Driven(ramp(STAND_S, 1.0), slip=between(20.0, 25.0, slip), seed=wheels), 30.0, after)
    assert began
    assert began[0] <= 0.15
    assert np.abs(errors).max() < 0.03 + 0.01
    assert sqrt(np.mean(np.square(errors))) < 0.03
    assert abs(result.rows[-1][1]) < 0.01 * result.truth.travelled_m  # 0.75 m had the wheels been believed
    assert not any(result.last.slipping)


def test_wheels_that_hold_are_not_flagged() -> None:
    flags = []
    turn = Driven(ramp(STAND_S, 1.0), wander, scrub=1.0, seed=4)
    ride(turn, 60.0, lambda believed, _: flags.append(any(believed.slipping)))
    assert sum(flags) == 0


def test_wheels_locked_on_ice_are_not_standing() -> None:
    def sliding(time_s: float) -> Four:
        return (-1.0, -1.0, -1.0, -1.0) if time_s > 20.0 else (0.0, 0.0, 0.0, 0.0)

    result = ride(Driven(ramp(STAND_S, 1.5), slip=sliding), 23.0)
    assert not result.last.standing
    assert result.last.speed_mps == pytest.approx(1.5, abs=0.1)
    assert all(result.last.slipping)


def test_errors_stay_within_three_sigma() -> None:
    """Every sample of drives with their own slips, biases and noise."""
    inside, count = np.zeros(4), 0
    for seed in range(6):
        random = np.random.default_rng(seed)
        at = 15.0 + 20.0 * random.random()
        slip = tuple(0.15 * (random.random() < 0.6) for _ in range(4))
        assert len(slip) == 4
        driven = Driven(
            ramp(STAND_S, 0.5 + 1.5 * random.random()),
            wander if seed % 2 else still,
            slip=between(at, at + 5.0, slip),
            seed=seed,
            gyro_bias_degps=tuple(random.uniform(-1.0, 1.0, 3)),
            accel_bias_mps2=tuple(random.uniform(-0.02, 0.02, 2)),
            iron_ut=_three(random.uniform(-2.0, 2.0, 3)),
        )
        rows = np.array(ride(driven, 50.0).rows)[1000:]
        inside += (np.abs(rows[:, 1:5]) < 3.0 * rows[:, 5:9]).sum(axis=0)
        count += len(rows)
    assert (inside / count > 0.99).all(), inside / count


def test_a_gap_of_the_imu_is_waited_out() -> None:
    state = OdometryState()
    for inputs, estimate, truth in Driven(ramp(STAND_S, 1.0)).run(20.0):
        if not 15.0 < truth.time_s < 15.3:
            state, believed = dead_reckoning.step(DESIGN, state, inputs, estimate, 0.01)
    assert believed.speed_mps == pytest.approx(1.0, abs=0.03)
    assert np.isfinite(state.held.covariance).all()


def test_the_covariance_stays_one() -> None:
    result = ride(Driven(ramp(STAND_S, 1.0), wander), 120.0)
    covariance = result.state.held.covariance
    assert covariance == pytest.approx(covariance.T, rel=1e-6, abs=1e-12)
    scale = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-9


def test_the_equations_of_the_covariance_are_those_of_the_motion() -> None:
    """Each column of the transition against the motion with that one thing off."""
    motion = inertial.Motion(
        yaw_rad=0.7, u_mps=1.2, v_mps=0.1, pitch_rad=0.03, roll_rad=-0.02, rate_radps=(0.0, 0.0, 0.3)
    )
    dt, off = 0.01, 1e-5
    force, gyro = (0.4, 0.35, 9.8), (0.02, -0.01, 0.3)
    names = ("x_m", "y_m", "yaw_rad", "u_mps", "v_mps", "pitch_rad", "roll_rad")

    def after(start: inertial.Motion) -> np.ndarray:
        moved = inertial.integrate(start, force, gyro, 0.03, dt)
        return np.array([getattr(moved, name) for name in names])

    silent = inertial.Noise(*np.zeros((2, inertial.N, inertial.N)))
    for index, name in enumerate(names):
        column = (after(replace(motion, **{name: getattr(motion, name) + off})) - after(motion)) / off
        single = np.zeros((inertial.N, inertial.N))
        single[index, index] = 1.0
        variances = np.diag(inertial.spread(single, motion, silent, dt))[:7]
        assert np.sqrt(np.maximum(variances, 0.0)) == pytest.approx(np.abs(column), abs=4e-3), name


def test_a_state_is_kept_and_taken_up_again_bit_by_bit() -> None:
    samples = list(Driven(ramp(2.0, 1.0), wander).run(12.0))
    state = OdometryState()
    for inputs, estimate, _ in samples[:900]:
        state, _ = dead_reckoning.step(DESIGN, state, inputs, estimate, 0.01)
    again = thaw(OdometryState(), freeze(state))
    for inputs, estimate, _ in samples[900:]:
        state, first = dead_reckoning.step(DESIGN, state, inputs, estimate, 0.01)
        again, second = dead_reckoning.step(DESIGN, again, inputs, estimate, 0.01)
        assert first == second
    assert freeze(state) == freeze(again)


def test_a_threshold_without_hysteresis_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "robot.toml"
    file.write_text("[odometry]\nevent_over_ratio = 0.2\n")
    with pytest.raises(ConfigError, match=r"event_over_ratio = 0.2 must be below event_ratio = 0.08"):
        load_robot(file)


def test_yaw_wraps_nowhere() -> None:
    """Full turns add up, so that a heading has no jump to trip over."""
    result = ride(Driven(ramp(STAND_S, 0.7), ramp(STAND_S + 2.0, 0.4)), 60.0)
    assert result.last.yaw_rad > 3.0 * 2.0 * pi
    assert result.last.yaw_rad == pytest.approx(result.truth.yaw_rad, abs=radians(1.5))
