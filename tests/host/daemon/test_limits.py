"""Limits and faults: each names what, value, limit and next step, and only when it is exceeded."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tiger.config.robot import RobotConfig, load_robot
from tiger.daemon import limits
from tiger.daemon.limits import LIMITS, RestCheck
from tiger.daemon.rest_calibration import (
    BIAS_MOST_RADPS,
    STILL_ACCEL_MPS2,
    STILL_GYRO_RADPS,
    RestCalibration,
    bias_messages,
)
from tiger.devices.roboteq import REMEDY, FaultFlag, MotorFlag, Roboteq
from tiger.protocol.link import Session
from tiger.protocol.messages import (
    FAULT_INFO,
    BoardKind,
    BoardState,
    Fault,
    Health,
    HelloReply,
    ImuFlag,
)
from tiger.record import (
    DriveSample,
    Estimate,
    ImuRawSample,
    ImuSample,
    Inputs,
    ProblemKind,
    Stability,
    StrokeSample,
    WheelSample,
)

NOW_S = 100.0
GOOD_FLAGS = 1 << ImuFlag.CALIBRATED | 1 << ImuFlag.FILTER_READY | 1 << ImuFlag.REST
IMU = ImuSample(NOW_S, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, GOOD_FLAGS)
WHEELS = WheelSample(NOW_S, (0, 0), (0.0, 0.0), 0)
DRIVE = DriveSample(NOW_S, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 24.0, 30.0, 0, 0)
GOOD = Inputs(
    now_s=NOW_S,
    armed=True,
    strokes=StrokeSample(NOW_S, (35.0,) * 4, (0.0,) * 4, (0,) * 4, 0),
    imu=IMU,
    wheels_left=WHEELS,
    wheels_right=WHEELS,
    drive_left=DRIVE,
    drive_right=DRIVE,
)
LEVEL = Estimate(ready=True)


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot(None)


def found(robot: RobotConfig, inputs: Inputs, estimate: Estimate = LEVEL, armed: bool = False) -> list[str]:
    return [str(problem) for problem in limits.exceeded(robot.safety, inputs, estimate, armed)]


def test_a_good_robot_exceeds_nothing(robot: RobotConfig) -> None:
    assert found(robot, GOOD) == found(robot, GOOD, armed=True) == []


def test_what_was_never_measured_exceeds_nothing(robot: RobotConfig) -> None:
    assert found(robot, Inputs(now_s=NOW_S, armed=False), Estimate()) == []


LATE, SLOW = NOW_S - 0.061, NOW_S - 0.2


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (
            replace(GOOD, imu=replace(IMU, t_s=NOW_S - 0.061)),
            "nano_imu: newest sample is 61 ms old, the limit is 60",
        ),
        (
            replace(GOOD, wheels_left=replace(WHEELS, t_s=SLOW)),
            "mega_speed (left): newest wheel speeds",
        ),
        (replace(GOOD, drive_right=replace(DRIVE, t_s=SLOW)), "roboteq (right): newest speeds"),
        (replace(GOOD, wheels_right=replace(WHEELS, speed_radps=(0.0, -45.0))), "wheels: turn at 430 rpm"),
        (replace(GOOD, drive_left=replace(DRIVE, motor_current_a=(0.0, -56.0))), "motor current is 56.0 A"),
        (replace(GOOD, drive_left=replace(DRIVE, sustained_current_a=(31.0, 0.0))), "has been 31.0 A (RMS)"),
        (replace(GOOD, drive_left=replace(DRIVE, controller_temperature_celsius=80.0)), "80 degrees Celsius"),
        (
            replace(GOOD, drive_left=replace(DRIVE, battery_v=19.9)),
            "voltage is 19.9 V, the limit is 20",
        ),
    ],
)
def test_each_limit_names_value_limit_and_next_step(robot: RobotConfig, inputs: Inputs, words: str) -> None:
    (problem,) = found(robot, inputs)
    assert words in problem
    assert problem.endswith(".")


SIDES = ("left", "right")


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("motor", [0, 1])
@pytest.mark.parametrize("side", SIDES)
def test_every_wheel_and_motor_is_limited_either_way(
    robot: RobotConfig, side: str, motor: int, sign: float
) -> None:
    safety = robot.safety

    def with_wheel(rpm: float) -> Inputs:
        speeds = tuple(sign * rpm / limits.RPM_PER_RADPS * (k == motor) for k in range(2))
        return replace(GOOD, **{f"wheels_{side}": replace(WHEELS, speed_radps=speeds)})  # type: ignore[arg-type]

    def with_current(amps: float) -> Inputs:
        currents = tuple(sign * amps * (k == motor) for k in range(2))
        return replace(GOOD, **{f"drive_{side}": replace(DRIVE, motor_current_a=currents)})  # type: ignore[arg-type]

    def with_heat(amps: float) -> Inputs:
        currents = tuple(amps * (k == motor) for k in range(2))
        return replace(GOOD, **{f"drive_{side}": replace(DRIVE, sustained_current_a=currents)})  # type: ignore[arg-type]

    for inputs, most in (
        (with_wheel, safety.max_wheel_speed_rpm),
        (with_current, safety.max_motor_current_a),
        (with_heat, safety.max_sustained_current_a),
    ):
        for is_armed in (False, True):
            assert not found(robot, inputs(0.999 * most), armed=is_armed)
            assert len(found(robot, inputs(1.001 * most), armed=is_armed)) == 1


@pytest.mark.parametrize("side", SIDES)
def test_the_worse_of_two_controllers_counts(robot: RobotConfig, side: str) -> None:
    for changes in (
        {"battery_v": 0.999 * robot.safety.battery_min_v},
        {"controller_temperature_celsius": 1.001 * robot.safety.max_controller_temperature_celsius},
    ):
        drive = replace(DRIVE, **changes)
        assert len(found(robot, replace(GOOD, **{f"drive_{side}": drive}))) == 1  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", ["roll_rad", "pitch_rad"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_tilt_is_limited_about_either_axis(robot: RobotConfig, axis: str, sign: float) -> None:
    for tilt_deg, is_over in ((24.9, False), (25.1, True)):
        estimate = replace(LEVEL, **{axis: sign * math.radians(tilt_deg)})  # type: ignore[arg-type]
        assert bool(found(robot, GOOD, estimate)) == is_over


@pytest.mark.parametrize(("roll_deg", "is_over"), [(24.9, False), (25.1, True), (-25.1, True)])
def test_tilt_is_limited_either_way(robot: RobotConfig, roll_deg: float, is_over: bool) -> None:
    assert bool(found(robot, GOOD, replace(LEVEL, roll_rad=math.radians(roll_deg)))) == is_over
    assert not found(robot, GOOD, Estimate(ready=False, roll_rad=math.radians(roll_deg)))


@pytest.mark.parametrize("age_ms", [59, 61, 239, 241])
def test_late_samples_hold_first_and_stop_when_they_stay_late(robot: RobotConfig, age_ms: int) -> None:
    inputs = replace(GOOD, imu=replace(IMU, t_s=NOW_S - age_ms * 1e-3))
    assert limits.is_late(robot.safety, inputs) == (age_ms > 60)
    assert bool(found(robot, inputs, armed=False)) == (age_ms > 60)
    assert bool(found(robot, inputs, armed=True)) == (age_ms > 240)


def test_the_rows_that_hold_are_those_that_do(robot: RobotConfig) -> None:
    late = {
        "nano_imu": replace(GOOD, imu=replace(IMU, t_s=NOW_S - 0.1)),
        "mega_suspension": replace(
            GOOD, strokes=StrokeSample(NOW_S - 0.1, (35.0,) * 4, (0.0,) * 4, (0,) * 4, 0)
        ),
        "mega_speed (left)": replace(GOOD, wheels_left=replace(WHEELS, t_s=NOW_S - 0.2)),
        "roboteq (right)": replace(GOOD, drive_right=replace(DRIVE, t_s=NOW_S - 0.2)),
    }
    for limit in LIMITS:
        if limit.where in late:
            assert limits.is_late(robot.safety, late[limit.where]) == limit.holds
        else:
            assert not limit.holds


def test_late_strokes_hold_too(robot: RobotConfig) -> None:
    assert limits.is_late(robot.safety, replace(GOOD, strokes=None))
    assert GOOD.strokes is not None
    assert limits.is_late(robot.safety, replace(GOOD, strokes=replace(GOOD.strokes, t_s=NOW_S - 0.07)))


def test_every_limit_has_words_for_a_person() -> None:
    for limit in LIMITS:
        assert "{" in limit.what
        assert limit.next_step.endswith(".")


# ------------------------------------------------------------------------------------------ reported faults


def session(kind: BoardKind, faults: int, detail: int = 255) -> Session:
    identity = HelloReply(1, 0, kind, 0, 1, 0, (1, 0, 0), 0, 0, 1, 1, 0, 0, 0, 1)
    health = Health(0, BoardState.FAULT, faults, detail, 0, 0, 0, (0,) * 6, 0, 0, 0, 5000, 9)
    return Session("/dev/x", 0, identity=identity, health=health)


@pytest.mark.parametrize("fault", list(Fault))
def test_every_fault_of_the_spec_is_said_with_its_remedy(fault: Fault) -> None:
    kind = FAULT_INFO[fault].boards[0]
    (problem,) = limits.board_faults(session(kind, 1 << fault))
    assert (problem.text, problem.next_step) == (FAULT_INFO[fault].text, FAULT_INFO[fault].remedy)


def test_the_corner_or_wheel_of_a_fault_is_named() -> None:
    (jam,) = limits.board_faults(session(BoardKind.MEGA_SUSPENSION, 1 << Fault.JAM, detail=2))
    assert jam.where == "mega_suspension, rear left"
    (dead,) = limits.board_faults(session(BoardKind.MEGA_SPEED, 1 << Fault.ENCODER_DEAD, detail=1))
    assert dead.where == "mega_speed (left), rear wheel"


def test_a_fault_of_a_newer_board_is_said_by_number() -> None:
    (problem,) = limits.board_faults(session(BoardKind.NANO_IMU, 1 << 31))
    assert "fault 31, unknown to this program" in problem.text


def test_a_roboteqs_faults_are_named_and_its_emergency_stop_is_none() -> None:
    drive = Roboteq("roboteq (left)", "/dev/left", 150, 50.0, 20.0)
    drive.flags |= {"FF": FaultFlag.EMERGENCY_STOP.value, "FM1": MotorFlag.AMPS_LIMIT.value}
    assert list(limits.drive_faults(drive)) == []
    drive.flags |= {"FF": FaultFlag.SHORT_CIRCUIT | 1 << 9, "FM2": MotorFlag.STALLED.value}
    texts = [problem.text for problem in limits.drive_faults(drive)]
    assert texts == ["short circuit", "bit 9", "rear motor: stalled"]


@pytest.mark.parametrize("flag", [flag for flag in FaultFlag if flag is not FaultFlag.EMERGENCY_STOP])
def test_each_fault_of_a_roboteq_comes_with_its_remedy(flag: FaultFlag) -> None:
    drive = Roboteq("roboteq (left)", "/dev/left", 150, 50.0, 20.0)
    drive.flags |= {"FF": flag.value}
    (problem,) = limits.drive_faults(drive)
    assert problem.next_step == REMEDY.get(flag, "Look it up in the controller's manual.")


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        ({"FF": FaultFlag.SHORT_CIRCUIT.value}, "short circuit"),
        ({"FM1": MotorFlag.STALLED.value}, "front motor: stalled"),
        ({"FM2": MotorFlag.STALLED.value}, "rear motor: stalled"),
    ],
)
def test_one_fault_of_a_roboteq_alone_is_enough(flags: dict[str, int], text: str) -> None:
    drive = Roboteq("roboteq (left)", "/dev/left", 150, 50.0, 20.0)
    drive.flags |= flags
    assert [problem.text for problem in limits.drive_faults(drive)] == [text]


def test_a_board_that_reported_nothing_yet_has_no_faults() -> None:
    assert not list(limits.board_faults(Session("/dev/x", 0)))


# ------------------------------------------------------------------------------------------ the IMU at rest


def fed(robot: RobotConfig, sample: ImuSample, seconds: float = 4.0) -> RestCheck:
    check = RestCheck(robot.safety)
    for k in range(round(seconds * 100)):
        check.add(replace(sample, t_s=k * 0.01))
    return check


def test_an_imu_that_reads_nothing_at_rest_is_good(robot: RobotConfig) -> None:
    assert fed(robot, IMU).problem(IMU) is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"rate_radps": (0.0, math.radians(0.12), 0.0)},
            "0.12 degrees/s while nothing turns",
        ),
        ({"linear_accel_mps2": (0.0, 0.0, 0.06)}, "0.06 m/s2 while nothing moves, the limit is 0.05"),
        ({"flags": GOOD_FLAGS & ~(1 << ImuFlag.CALIBRATED)}, "is not calibrated"),
        ({"flags": GOOD_FLAGS & ~(1 << ImuFlag.FILTER_READY)}, "attitude has not settled"),
    ],
)
def test_what_is_wrong_with_an_imu_at_rest_is_said(
    robot: RobotConfig, changes: dict[str, object], words: str
) -> None:
    sample = replace(IMU, **changes)  # type: ignore[arg-type]
    assert words in str(fed(robot, sample).problem(sample))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_imu_at_rest_is_judged_in_each_axis_against_the_limit_of_its_kind(
    robot: RobotConfig, axis: int, sign: float
) -> None:
    def along(value: float) -> tuple[float, ...]:
        return tuple(sign * value * (k == axis) for k in range(3))

    turning = math.radians(robot.safety.max_rest_gyro_bias_degps)
    pushed = robot.safety.max_rest_accel_offset_mps2
    for changes, words in (
        ({"rate_radps": along(1.01 * turning)}, "while nothing turns"),
        ({"linear_accel_mps2": along(1.01 * pushed)}, "while nothing moves"),
        ({"rate_radps": along(0.99 * turning), "linear_accel_mps2": along(0.99 * pushed)}, "None"),
    ):
        sample = replace(IMU, **changes)  # type: ignore[arg-type]
        assert words in str(fed(robot, sample).problem(sample))


def test_after_a_new_calibration_the_rest_before_it_counts_no_more(robot: RobotConfig) -> None:
    wrong = replace(IMU, rate_radps=(0.1, 0.0, 0.0))
    check = fed(robot, wrong)
    assert check.problem(wrong) is not None
    check.reset()
    check.add(replace(wrong, t_s=7.0))
    assert check.problem(wrong) is None


def test_motion_ends_the_rest_that_an_imu_is_judged_by(robot: RobotConfig) -> None:
    wrong = replace(IMU, rate_radps=(0.1, 0.0, 0.0))
    check = fed(robot, wrong)
    check.add(replace(wrong, t_s=4.0, flags=GOOD_FLAGS & ~(1 << ImuFlag.REST)))
    assert check.problem(wrong) is None


def test_without_an_imu_nothing_is_armed(robot: RobotConfig) -> None:
    problem = RestCheck(robot.safety).problem(None)
    assert problem is not None
    assert problem.kind is ProblemKind.NO_ANSWER


# ------------------------------------------------------------------------------------------- rest calibration


def raw(t_s: float, gyro: tuple[float, float, float], wobble: float = 0.0) -> ImuRawSample:
    shake = wobble * math.sin(t_s * 40.0)
    return ImuRawSample(t_s, (0.0, shake, 9.81), (gyro[0] + shake, gyro[1], gyro[2]), (0.0,) * 3)


def collected(samples: list[ImuRawSample]) -> RestCalibration:
    calibration = RestCalibration()
    for sample in samples:
        calibration.add(sample)
    return calibration


BIAS = (0.01, -0.015, 0.002)


def test_the_mean_of_a_still_second_is_the_bias() -> None:
    calibration = collected([raw(k * 0.01, BIAS) for k in range(120)])
    assert calibration.bias() == pytest.approx(BIAS)


@pytest.mark.parametrize(
    "samples",
    [
        [raw(k * 0.01, BIAS) for k in range(60)],  # too short
        [raw(k * 0.01, BIAS, wobble=0.5) for k in range(120)],  # moving
        [raw(k * 0.01, (0.2, 0.0, 0.0)) for k in range(120)],  # turning steadily
        [raw(k * 0.01, BIAS) for k in range(80)] + [raw(k * 0.01 + 5.0, BIAS) for k in range(20)],  # a gap
    ],
    ids=["too short", "moving", "turning", "gap"],
)
def test_anything_else_gives_no_bias(samples: list[ImuRawSample]) -> None:
    assert collected(samples).bias() is None


def test_a_still_second_is_needed_without_a_gap() -> None:
    def still(*spans: tuple[int, int]) -> list[ImuRawSample]:
        return [raw(k * 0.01, BIAS) for begin, end in spans for k in range(begin, end)]

    assert collected(still((0, 95))).bias() is None
    assert collected(still((0, 98))).bias() is not None
    assert collected(still((0, 60), (85, 115))).bias() is None  # 0.26 s are missing
    assert collected(still((0, 98), (0, 50))).bias() is None  # the board was reset
    assert collected([raw(k * 0.021, BIAS) for k in range(100)]).bias() is None  # too few


@pytest.mark.parametrize("axis", range(3))
def test_motion_in_any_axis_of_either_sensor_gives_no_bias(axis: int) -> None:
    def bias(gyro_radps: float = 0.0, accel_mps2: float = 0.0, mean_radps: float = 0.0) -> object:
        """Of a second with these standard deviations, and this mean, in one axis."""
        samples = []
        for k in range(120):
            here = [(1.0 if k % 2 else -1.0) * (n == axis) for n in range(3)]
            gyro = tuple(gyro_radps * way + mean_radps * (n == axis) for n, way in enumerate(here))
            samples.append(ImuRawSample(k * 0.01, tuple(accel_mps2 * way for way in here), gyro, (0.0,) * 3))
        return collected(samples).bias()

    for least, most in ((0.99, False), (1.01, True)):
        assert (bias(gyro_radps=least * STILL_GYRO_RADPS) is None) == most
        assert (bias(accel_mps2=least * STILL_ACCEL_MPS2) is None) == most
        assert (bias(mean_radps=least * BIAS_MOST_RADPS) is None) == most
        assert (bias(mean_radps=-least * BIAS_MOST_RADPS) is None) == most


def test_the_bias_goes_to_the_nano_in_counts_and_marks_it_calibrated() -> None:
    messages = bias_messages(BIAS)
    assert [(m.node, m.value) for m in messages] == [(1, 10_000), (1, -15_000), (1, 2_000), (1, 1)]


def test_coming_near_tipping_is_shown_with_the_side_and_what_is_left() -> None:
    calm = Estimate(ready=True)
    assert limits.tip_warning(calm) is None
    near = replace(calm, stability=Stability(margin=0.07, edge=1, warning=True))
    assert "to the right, 7 %" in str(limits.tip_warning(near))
    for edge, side in enumerate(("left", "right", "front", "rear")):
        warned = replace(near, stability=replace(near.stability, edge=edge))
        assert f"to the {side}," in str(limits.tip_warning(warned))
    hit = replace(near, stability=replace(near.stability, tripped=True))
    assert "ran into something" in str(limits.tip_warning(hit))
    assert not list(limits.exceeded(load_robot().safety, Inputs(now_s=0.0, armed=True), near, is_armed=True))
