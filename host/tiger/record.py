"""What one control tick knew, did and why: the type that every log, page and bridge reads.

`Inputs` goes into `controller.step`, `Outputs` comes out, `Record` keeps both with the state of the
supervisor. Times are seconds of the host's monotonic clock; the time of a sample is when the board took it,
not when it arrived. Axes are ISO 8855 (roll + = left side up, pitch + = nose down); corners and wheels are
FL, FR, RL, RR.
"""

from __future__ import annotations

from dataclasses import field
from enum import IntEnum, StrEnum

from tiger.frozen import dataclass

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

STILL: Four = (0.0, 0.0, 0.0, 0.0)


class DaemonState(IntEnum):
    """State of the supervisor."""

    DISCONNECTED = 0  # a device is missing
    HANDSHAKE = 1  # devices are there and introduce themselves
    DISARMED = 2  # everything answers, nothing may move
    ARMED = 3  # following commands
    FAULT = 4  # stopped and latched until cleared
    ESTOP = 5  # emergency stop, latched until released and cleared


class Mode(StrEnum):
    """What the suspension does (Figure 3.3)."""

    HOLD = "hold"  # no stroke moves
    LEVEL = "level"  # roll and pitch are those of the command, against gravity
    BALANCE = "balance"  # as level, and all four wheels carry their share
    POSE = "pose"  # roll, pitch and ride height are those of the command, against the wheels
    STOW = "stow"  # as low as it goes


@dataclass(frozen=True, slots=True)
class Command:
    """What the user asks for. The default asks for a level body that stands still."""

    mode: Mode = Mode.LEVEL
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    ride_stroke_mm: float | None = None  # mean stroke; None: the one of the config
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0  # + turns left


@dataclass(frozen=True, slots=True)
class StrokeSample:
    """One suspension_state: the four actuators."""

    t_s: float
    stroke_mm: Four
    rate_mmps: Four
    duty_permille: tuple[int, int, int, int]
    flags: int  # bits of SuspensionFlag


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One imu_attitude: attitude and motion of the body in the robot's axes."""

    t_s: float
    quaternion: Four  # w x y z, body to earth (z up)
    rate_radps: Three
    angular_accel_radps2: Three
    linear_accel_mps2: Three
    flags: int  # bits of ImuFlag


@dataclass(frozen=True, slots=True)
class ImuRawSample:
    """One imu_raw: readings in the robot's axes before calibration."""

    t_s: float
    accel_mps2: Three
    gyro_radps: Three
    mag_ut: Three


@dataclass(frozen=True, slots=True)
class WheelSample:
    """One wheel_speed: the wheels of one side, front then rear; forward is positive."""

    t_s: float
    edge_counts: tuple[int, int]
    speed_radps: tuple[float, float]
    flags: int  # bits of WheelFlag


@dataclass(frozen=True, slots=True)
class DriveSample:
    """What one Roboteq last said of its two channels, front then rear; forward is positive."""

    t_s: float  # when the newest wheel speeds arrived
    wheel_rpm: tuple[float, float]
    motor_current_a: tuple[float, float]
    battery_current_a: tuple[float, float]
    battery_v: float
    controller_temperature_celsius: float | None
    fault_flags: int  # ?FF
    status_flags: int  # ?FS
    sustained_current_a: tuple[float, float] = (0.0, 0.0)  # RMS of the motors' of late: what heats them


@dataclass(frozen=True, slots=True)
class Inputs:
    """Everything `controller.step` may look at. A sample is the newest one, None before the first."""

    now_s: float
    armed: bool  # the supervisor permits motion
    command: Command = field(default_factory=Command)
    strokes: StrokeSample | None = None
    imu: ImuSample | None = None
    imu_raw: ImuRawSample | None = None
    wheels_left: WheelSample | None = None
    wheels_right: WheelSample | None = None
    drive_left: DriveSample | None = None
    drive_right: DriveSample | None = None


@dataclass(frozen=True, slots=True)
class Odometry:
    """Dead reckoning of the body's reference point, from where and how it stood at the start."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    covariance: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Of x, y and yaw: xx, xy, x yaw, yy, y yaw, yaw yaw; m2, m rad, rad2."""
    speed_mps: float = 0.0
    speed_sigma_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    distance_m: float = 0.0  # travelled, forwards or backwards
    slip_ratio: Four = STILL  # (w r - v)/|v| of each wheel, 0 where it means nothing
    slipping: tuple[bool, bool, bool, bool] = (False, False, False, False)  # too much for odometry
    standing: bool = True


@dataclass(frozen=True, slots=True)
class Loads:
    """Who carries what. Forces along the body's z axis."""

    wheel_load_n: Four = STILL
    wheel_load_sigma_n: Four = STILL
    hanging: tuple[bool, bool, bool, bool] = (False, False, False, False)
    ground_warp_m: float = 0.0  # FL - FR - RL + RR of the ground's heights under the wheels
    ground_warp_sigma_m: float = 0.0
    mass_kg: float = 0.0  # of the whole robot
    mass_sigma_kg: float = 0.0
    com_m: Three = (0.0, 0.0, 0.0)  # of the whole robot's body, from the empty body's
    com_sigma_m: Three = (0.0, 0.0, 0.0)
    payload_kg: float = 0.0  # as uncertain as the mass
    payload_m: Three = (0.0, 0.0, 0.0)  # from the empty body's centre of mass
    payload_sigma_m: Three = (0.0, 0.0, 0.0)  # 10 where it means nothing


@dataclass(frozen=True, slots=True)
class Roughness:
    """What kind of ground this is (ISO 8608)."""

    index_m3: float = 0.0  # Gd(n0) at n0 = 0.1 cycles/m
    class_number: int = -1  # 0 is A, 7 is H, -1 not known yet


class LimitCause(IntEnum):
    """Why motion is limited: what would come of the command otherwise."""

    NOTHING = 0  # it is not
    TURN = 1  # tipping in the turn
    SLOPE = 2  # tipping on the slope
    BRAKING = 3  # tipping when braking or speeding up
    TRIP = 4  # it has run into something


@dataclass(frozen=True, slots=True)
class Stability:
    """How far the robot is from tipping over, and what that allows."""

    margin: float = 1.0  # energy to tip, least of the four edges, over that at rest on level ground
    edge: int = 0  # the nearest: 0 left, 1 right, 2 front, 3 rear
    lateral_load_transfer: float = 0.0  # (left - right)/all, -1 to 1
    longitudinal_load_transfer: float = 0.0  # (front - rear)/all
    time_to_balance_s: float = 1e3  # until the COM is over the edge, as it moves now; 1e3: never
    warning: bool = False
    tripped: bool = False  # an impact that turns the body
    limited: int = 0  # bits: 1 speed, 2 curvature, 4 acceleration
    cause: LimitCause = LimitCause.NOTHING


@dataclass(frozen=True, slots=True)
class Traction:
    """Forces asked of the four tyres and what they use."""

    force_n: Four = STILL  # allocated, forward
    torque_nm: Four = STILL  # measured
    power_w: Four = STILL  # mechanical, measured
    electric_w: Four = STILL  # battery voltage times battery current
    friction_use: Four = STILL  # force over load
    friction: float = 0.0  # the most of it there is, as far as known
    grip: Four = STILL  # share of load times friction that each wheel is trusted with
    trim_rpm: Four = STILL  # added to the wheel speeds


@dataclass(frozen=True, slots=True)
class Estimate:
    """The observer's view of the body; `ready` before anything else in it means something."""

    ready: bool = False
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    roll_rate_radps: float = 0.0
    pitch_rate_radps: float = 0.0
    plate_roll_rad: float = 0.0  # slope of the ground
    plate_pitch_rad: float = 0.0
    plate_roll_rate_radps: float = 0.0
    plate_pitch_rate_radps: float = 0.0
    gyro_bias_radps: tuple[float, float] = (0.0, 0.0)  # x and y, what the board left in
    innovation: tuple[
        float, ...
    ] = ()  # roll, pitch, their rates, vertical acceleration; empty without a new sample
    sigma_rad: float = 0.0  # standard deviation of the worse of roll and pitch
    speed_mps: float = 0.0  # odometry
    yaw_rate_radps: float = 0.0
    odometry: Odometry = Odometry()
    loads: Loads = Loads()
    roughness: Roughness = Roughness()
    stability: Stability = Stability()


@dataclass(frozen=True, slots=True)
class Outputs:
    """What `controller.step` commands, and why."""

    stroke_rate_mmps: Four = STILL  # positive raises the body
    wheel_rpm: Four = STILL
    estimate: Estimate = Estimate()
    reason: str = ""  # mode of the controller in a few words
    error_rad: tuple[float, float] = (0.0, 0.0)  # roll and pitch still to go
    settled: bool = False  # at the setpoint, quiet
    unreachable: bool = False  # the strokes do not reach the setpoint: the nearest attitude is held
    at_limit: tuple[bool, bool, bool, bool] = (
        False,
        False,
        False,
        False,
    )  # corners at the end of their stroke
    traction: Traction = Traction()


class ProblemKind(StrEnum):
    """What sort of thing keeps the robot from working."""

    PORT = "port"  # cannot be opened, or vanished
    NO_ANSWER = "no answer"  # a device does not talk
    PROTOCOL = "protocol"  # a board speaks another version of the framing
    SCHEMA = "schema"  # a board was built from another description of the wire
    WRONG_BOARD = "wrong board"  # a board where another one belongs
    DUPLICATE = "duplicate"  # two boards of one kind and instance
    MISSING = "missing"  # a board that the robot needs is on none of the ports
    WIRING = "wiring"  # directions or sides disagree
    FAULT = "fault"  # a board or drive controller latched a fault
    LIMIT = "limit"  # a measurement outside the limits of the config
    REFUSED = "refused"  # a command was not obeyed


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that keeps the robot from working: what, and the next step."""

    kind: ProblemKind
    where: str  # the board, port or key
    text: str
    next_step: str

    def __str__(self) -> str:
        return f"{self.where}: {self.text}. {self.next_step}"


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """Health of one board or drive controller as the host sees it."""

    name: str
    state: str
    connected: bool
    rx_frames: int = 0
    rejects: int = 0  # received frames refused by the host, all causes
    board_rejects: int = 0  # frames refused by the board
    seq_gaps: int = 0
    round_trip_ms: float = 0.0
    clock_sigma_us: float = 0.0
    drift_ppm: float = 0.0
    overruns: int = 0
    ram_free_bytes: int = 0
    supply_v: float = 0.0


@dataclass(frozen=True, slots=True)
class Record:
    """One tick."""

    tick: int
    state: DaemonState
    reason: str  # why the supervisor is in this state
    inputs: Inputs
    outputs: Outputs  # as sent: all zeros unless armed
    problems: tuple[Problem, ...] = ()
    links: tuple[LinkStatus, ...] = ()
    lateness_s: float = 0.0
