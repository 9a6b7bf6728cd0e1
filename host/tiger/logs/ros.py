"""What one tick says in the words of ROS 2: standard messages that Foxglove, PlotJuggler and rviz know. Pure.

A sample is written once, when it is new, with the time it was taken. Frames are REP 103 / REP 105:
`base_link` is the body (x forward, y left, z up), `odom` the earth with z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tiger.logs.topics import (
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    Imu,
    JointState,
    KeyValue,
    MagneticField,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    QuaternionStamped,
    Time,
    Twist,
    TwistStamped,
    TwistWithCovariance,
    Vector3,
)
from tiger.record import DaemonState

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.logs.topics import Health, Tick
    from tiger.record import DriveSample, Estimate, ImuRawSample, ImuSample, StrokeSample, WheelSample

GRAVITY_MPS2 = 9.80665
NS_PER_S = 1_000_000_000
UNKNOWN = (0.0,) * 9  # a covariance of zeros means unknown (sensor_msgs/Imu)
UNKNOWN_VARIANCE = 1e6  # of a pose or twist: REP 105 users take it for "not measured"
CORNERS = ("fl", "fr", "rl", "rr")
SILENT, ERROR, WARN, WELL = 3, 2, 1, 0

Stamped = tuple[str, int, Any]  # topic, time of the sample in ns since 1970, message


@dataclass(slots=True)
class Newness:
    """The samples last written, so that each is written once."""

    last: dict[str, Any] = field(default_factory=dict)

    def take(self, name: str, sample: Any) -> bool:
        """Whether `sample` is there and was not seen yet."""
        if sample is None or self.last.get(name) == sample:
            return False
        self.last[name] = sample
        return True


def header(stamp_ns: int, frame_id: str = "base_link") -> Header:
    """A header with a time in nanoseconds since 1970."""
    return Header(Time(*divmod(stamp_ns, NS_PER_S)), frame_id)


def messages(tick: Tick, newness: Newness, epoch_ns: int) -> Iterator[Stamped]:
    """The standard messages of one tick; `epoch_ns` is when the host's monotonic clock was zero."""

    def stamp(t_s: float) -> int:
        return epoch_ns + round(t_s * NS_PER_S)

    inputs = tick.inputs
    if inputs.imu is not None and newness.take("imu", inputs.imu):
        at = stamp(inputs.imu.t_s)
        yield "/imu/data", at, imu(inputs.imu, header(at))
        now = stamp(inputs.now_s)
        yield "/estimate/attitude", now, attitude(tick.outputs.estimate, header(now, "odom"))
        yield "/estimate/twist", now, estimated_twist(tick.outputs.estimate, header(now))
        yield "/odom", now, odometry(tick.outputs.estimate, header(now, "odom"))
    if inputs.imu_raw is not None and newness.take("imu_raw", inputs.imu_raw):
        at = stamp(inputs.imu_raw.t_s)
        yield "/imu/mag", at, magnetic_field(inputs.imu_raw, header(at))
    if inputs.strokes is not None and newness.take("strokes", inputs.strokes):
        at = stamp(inputs.strokes.t_s)
        yield "/joint_states", at, stroke_joints(inputs.strokes, header(at))
    for side, wheels in (("l", inputs.wheels_left), ("r", inputs.wheels_right)):
        if wheels is not None and newness.take("wheels" + side, wheels):
            at = stamp(wheels.t_s)
            yield "/joint_states", at, wheel_joints(wheels, side, header(at))
    if newness.take("command", inputs.command):
        at = stamp(inputs.now_s)
        speed = Vector3(inputs.command.speed_mps, 0.0, 0.0)
        turn = Vector3(0.0, 0.0, inputs.command.yaw_rate_radps)
        yield "/command/twist", at, TwistStamped(header(at), Twist(speed, turn))


def imu(sample: ImuSample, head: Header) -> Imu:
    """Attitude, rates and specific force: REP 145 counts gravity in, our sample leaves it out."""
    w, x, y, z = sample.quaternion
    up = (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))  # earth's z in the body
    force = [a + GRAVITY_MPS2 * u for a, u in zip(sample.linear_accel_mps2, up, strict=True)]
    return Imu(
        head,
        Quaternion(x, y, z, w),
        UNKNOWN,
        Vector3(*sample.rate_radps),
        UNKNOWN,
        Vector3(*force),
        UNKNOWN,
    )


def magnetic_field(sample: ImuRawSample, head: Header) -> MagneticField:
    """The magnetometer's reading, in tesla."""
    x, y, z = (microtesla * 1e-6 for microtesla in sample.mag_ut)
    return MagneticField(head, Vector3(x, y, z), UNKNOWN)


def stroke_joints(sample: StrokeSample, head: Header) -> JointState:
    """The four actuators as prismatic joints; effort is the duty of the motor driver, -1 to 1."""
    return JointState(
        head,
        tuple(f"stroke_{corner}" for corner in CORNERS),
        tuple(stroke * 1e-3 for stroke in sample.stroke_mm),
        tuple(rate * 1e-3 for rate in sample.rate_mmps),
        tuple(duty * 1e-3 for duty in sample.duty_permille),
    )


def wheel_joints(sample: WheelSample, side: str, head: Header) -> JointState:
    """The two wheels of a side as continuous joints; their angle is not measured absolutely."""
    return JointState(head, (f"wheel_f{side}", f"wheel_r{side}"), (), sample.speed_radps, ())


def attitude(estimate: Estimate, head: Header) -> QuaternionStamped:
    """The observer's roll and pitch, without a heading."""
    cr, sr = math.cos(estimate.roll_rad / 2.0), math.sin(estimate.roll_rad / 2.0)
    cp, sp = math.cos(estimate.pitch_rad / 2.0), math.sin(estimate.pitch_rad / 2.0)
    return QuaternionStamped(head, Quaternion(sr * cp, cr * sp, -sr * sp, cr * cp))


def estimated_twist(estimate: Estimate, head: Header) -> TwistStamped:
    """Speed from odometry, rates from the observer and the gyro."""
    turning = Vector3(estimate.roll_rate_radps, estimate.pitch_rate_radps, estimate.yaw_rate_radps)
    return TwistStamped(head, Twist(Vector3(estimate.speed_mps, 0.0, 0.0), turning))


def odometry(estimate: Estimate, head: Header) -> Odometry:
    """Dead reckoning, odom to base_link; what it does not estimate (height, sideways speed) is unknown."""
    where = estimate.odometry
    half = where.yaw_rad / 2.0
    xx, xy, x_yaw, yy, y_yaw, yaw_yaw = where.covariance
    pose, twist = [0.0] * 36, [0.0] * 36
    for row, column, value in (
        *((0, 0, xx), (0, 1, xy), (0, 5, x_yaw), (1, 1, yy), (1, 5, y_yaw), (5, 5, yaw_yaw)),
        *((2, 2, UNKNOWN_VARIANCE), (3, 3, estimate.sigma_rad**2), (4, 4, estimate.sigma_rad**2)),
    ):
        pose[6 * row + column] = pose[6 * column + row] = value
    for axis, value in ((0, where.speed_sigma_mps**2), (1, UNKNOWN_VARIANCE), (2, UNKNOWN_VARIANCE)):
        twist[7 * axis] = value
    place = Pose(Point(where.x_m, where.y_m, 0.0), Quaternion(0.0, 0.0, math.sin(half), math.cos(half)))
    velocity = Twist(Vector3(where.speed_mps, 0.0, 0.0), Vector3(0.0, 0.0, where.yaw_rate_radps))
    return Odometry(
        head,
        "base_link",
        PoseWithCovariance(place, tuple(pose)),
        TwistWithCovariance(velocity, tuple(twist)),
    )


def diagnostics(tick: Tick, health: Health, drives: tuple[DriveSample | None, ...], at_ns: int) -> Stamped:
    """How every part does: the supervisor, each problem, each link."""
    stopped = tick.state in (DaemonState.FAULT, DaemonState.ESTOP)
    worst = ERROR if stopped else WARN if health.problems else WELL
    status = [
        DiagnosticStatus(
            worst,
            "tiger: supervisor",
            f"{tick.state.name.lower()}: {tick.reason}",
            "tiger",
            tuple(KeyValue(problem.where, str(problem)) for problem in health.problems),
        )
    ]
    for link in health.links:
        numbers = {
            "received frames": link.rx_frames,
            "refused frames": link.rejects,
            "frames refused by the board": link.board_rejects,
            "lost frames": link.seq_gaps,
            "round trip ms": link.round_trip_ms,
            "clock sigma us": link.clock_sigma_us,
            "clock drift ppm": link.drift_ppm,
            "overruns": link.overruns,
            "free RAM bytes": link.ram_free_bytes,
            "supply V": link.supply_v,
        }
        values = tuple(KeyValue(key, f"{value:g}") for key, value in numbers.items())
        level = WELL if link.connected else SILENT
        status.append(DiagnosticStatus(level, f"tiger: {link.name}", link.state, link.name, values))
    for side, drive in zip(("left", "right"), drives, strict=True):
        if drive is not None:
            figures = {
                "battery V": drive.battery_v,
                "front motor A": drive.motor_current_a[0],
                "rear motor A": drive.motor_current_a[1],
                "temperature celsius": drive.controller_temperature_celsius,
            }
            values = tuple(KeyValue(k, f"{v:g}") for k, v in figures.items() if v is not None)
            level = ERROR if drive.fault_flags else WELL
            text = f"fault flags {drive.fault_flags:#x}" if drive.fault_flags else "well"
            status.append(DiagnosticStatus(level, f"tiger: motors {side}", text, f"roboteq {side}", values))
    return "/diagnostics", at_ns, DiagnosticArray(header(at_ns, ""), tuple(status))
