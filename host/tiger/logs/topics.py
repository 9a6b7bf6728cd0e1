"""What is in a log: the messages and their topics. `docs/logs.md` shows the list to people.

Messages of our own come from `tiger.record`; those of ROS 2 are declared here as its packages define them.
A tick is logged as two messages, because health changes ten times less often than measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from tiger.record import DaemonState, Inputs, LinkStatus, Outputs, Problem

INT32, UINT32, UINT8, FLOAT32 = "int32", "uint32", "uint8", "float32"

# ------------------------------------------------------------------------------------------------- our own


@dataclass(frozen=True, slots=True)
class Tick:
    """One control tick, exactly as it was: what replay steps the controller with."""

    tick: int
    state: DaemonState
    reason: str
    inputs: Inputs
    outputs: Outputs
    lateness_s: float


@dataclass(frozen=True, slots=True)
class Health:
    """What is wrong, and how every link does; written when it changes."""

    problems: tuple[Problem, ...]
    links: tuple[LinkStatus, ...]


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The controller's state before a tick, so that replay may begin there."""

    tick: int
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class WireBytes:
    """Bytes as they were read from a port or written to it; a frame may begin in one and end in the next."""

    data: bytes


@dataclass(frozen=True, slots=True)
class WireFrame:
    """One frame of a board, or one line of a Roboteq."""

    port: str
    sent: bool  # by the host
    t_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class FaultReport:
    """Why the robot stopped, and the last frames of every link before it did."""

    tick: int
    state: DaemonState
    reason: str
    problems: tuple[Problem, ...]
    frames: tuple[WireFrame, ...]


@dataclass(frozen=True, slots=True)
class LogStatus:
    """How the log itself does. Counts are totals since the session began."""

    dropped_packets: int  # of some ticks each, not taken from the control loop, because the log lagged
    dropped_bytes: int


# --------------------------------------------------------------------------------------------------- ROS 2


@dataclass(frozen=True, slots=True)
class Time:
    """Time of day."""

    ROS_PACKAGE: ClassVar[str] = "builtin_interfaces"
    sec: Annotated[int, INT32]
    nanosec: Annotated[int, UINT32]


@dataclass(frozen=True, slots=True)
class Header:
    """When and in which frame."""

    ROS_PACKAGE: ClassVar[str] = "std_msgs"
    stamp: Time
    frame_id: str


@dataclass(frozen=True, slots=True)
class Quaternion:
    """Orientation."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    x: float
    y: float
    z: float
    w: float


@dataclass(frozen=True, slots=True)
class Vector3:
    """Three components."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Twist:
    """Linear and angular velocity."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    linear: Vector3
    angular: Vector3


@dataclass(frozen=True, slots=True)
class TwistStamped:
    """Linear and angular velocity at a time."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    header: Header
    twist: Twist


@dataclass(frozen=True, slots=True)
class QuaternionStamped:
    """Orientation at a time."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    header: Header
    quaternion: Quaternion


Covariance = Annotated[tuple[float, ...], 9]
PoseCovariance = Annotated[tuple[float, ...], 36]


@dataclass(frozen=True, slots=True)
class Point:
    """A place."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and orientation."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    position: Point
    orientation: Quaternion


@dataclass(frozen=True, slots=True)
class PoseWithCovariance:
    """A pose and the covariance of x, y, z and the turns about them, by rows."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    pose: Pose
    covariance: PoseCovariance


@dataclass(frozen=True, slots=True)
class TwistWithCovariance:
    """Velocities and their covariance, in the same order."""

    ROS_PACKAGE: ClassVar[str] = "geometry_msgs"
    twist: Twist
    covariance: PoseCovariance


@dataclass(frozen=True, slots=True)
class Odometry:
    """Pose of `child_frame_id` in the frame of the header, and its velocities in its own axes."""

    ROS_PACKAGE: ClassVar[str] = "nav_msgs"
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass(frozen=True, slots=True)
class Imu:
    """Attitude, rates and specific force."""

    ROS_PACKAGE: ClassVar[str] = "sensor_msgs"
    header: Header
    orientation: Quaternion
    orientation_covariance: Covariance
    angular_velocity: Vector3
    angular_velocity_covariance: Covariance
    linear_acceleration: Vector3
    linear_acceleration_covariance: Covariance


@dataclass(frozen=True, slots=True)
class MagneticField:
    """Magnetic field in tesla."""

    ROS_PACKAGE: ClassVar[str] = "sensor_msgs"
    header: Header
    magnetic_field: Vector3
    magnetic_field_covariance: Covariance


@dataclass(frozen=True, slots=True)
class JointState:
    """Positions in metres or radians, velocities, and efforts."""

    ROS_PACKAGE: ClassVar[str] = "sensor_msgs"
    header: Header
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class KeyValue:
    """One figure of a diagnosis."""

    ROS_PACKAGE: ClassVar[str] = "diagnostic_msgs"
    key: str
    value: str


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """How one part does: level 0 well, 1 warning, 2 error, 3 silent."""

    ROS_PACKAGE: ClassVar[str] = "diagnostic_msgs"
    level: Annotated[int, UINT8]
    name: str
    message: str
    hardware_id: str
    values: tuple[KeyValue, ...]


@dataclass(frozen=True, slots=True)
class DiagnosticArray:
    """How every part does."""

    ROS_PACKAGE: ClassVar[str] = "diagnostic_msgs"
    header: Header
    status: tuple[DiagnosticStatus, ...]


# -------------------------------------------------------------------------------------------------- topics

TICK = "/tiger/tick"
HEALTH = "/tiger/health"
CHECKPOINT = "/tiger/checkpoint"
FAULT = "/tiger/fault"
LOG_STATUS = "/tiger/log_status"
WIRE = "/wire"  # followed by the port, then /rx or /tx

TOPICS: dict[str, type] = {
    TICK: Tick,
    HEALTH: Health,
    CHECKPOINT: Checkpoint,
    FAULT: FaultReport,
    LOG_STATUS: LogStatus,
    "/imu/data": Imu,
    "/imu/mag": MagneticField,
    "/joint_states": JointState,
    "/estimate/attitude": QuaternionStamped,
    "/estimate/twist": TwistStamped,
    "/odom": Odometry,
    "/command/twist": TwistStamped,
    "/diagnostics": DiagnosticArray,
}


def wire_topic(port: str, *, sent: bool) -> str:
    """Topic of the bytes of a port: its path, as far as a ROS 2 name may carry it."""
    safe = "".join(c if c.isascii() and (c.isalnum() or c == "/") else "_" for c in port.strip("/"))
    return f"{WIRE}/{safe}/{'tx' if sent else 'rx'}"


def message_type(topic: str) -> type | None:
    """What is on a topic of ours; None for one that this program does not write."""
    return WireBytes if topic.startswith(WIRE + "/") else TOPICS.get(topic)
