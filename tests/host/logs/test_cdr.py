"""Messages from dataclasses: the bytes are those that ROS 2 reads, and come back exactly."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum, IntEnum, StrEnum
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic

from tiger.logs import ros
from tiger.logs.cdr import CdrError, message
from tiger.logs.topics import TOPICS, Imu, JointState, LogStatus, WireBytes
from tiger.record import Estimate, ImuSample, Inputs, Odometry, Outputs, Problem, ProblemKind, Record


class Colour(IntEnum):
    RED = 1
    BLUE = 7


class Word(StrEnum):
    YES = "yes"
    NO = "no"


@dataclass(frozen=True)
class Inner:
    flag: bool
    value: float


@dataclass(frozen=True)
class Everything:
    small: Annotated[int, "uint8"]
    text: str
    three: tuple[float, float, float]
    colour: Colour
    word: Word
    many: tuple[Inner, ...]
    perhaps: Inner | None
    number: float | None
    data: bytes
    counts: tuple[int, ...]
    single: Annotated[float, "float32"]
    nine: Annotated[tuple[float, ...], 3]
    flags: tuple[bool, bool]
    last: int


finite = st.floats(allow_nan=False)
inner = st.builds(Inner, st.booleans(), finite)
i64 = st.integers(-(2**63), 2**63 - 1)
everything = st.builds(
    Everything,
    small=st.integers(0, 255),
    text=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])),
    three=st.tuples(finite, finite, finite),
    colour=st.sampled_from(Colour),
    word=st.sampled_from(Word),
    many=st.lists(inner, max_size=3).map(tuple),
    perhaps=st.none() | inner,
    number=st.none() | finite,
    data=st.binary(max_size=20),
    counts=st.lists(i64, max_size=3).map(tuple),
    single=st.floats(width=32, allow_nan=False),
    nine=st.tuples(finite, finite, finite),
    flags=st.tuples(st.booleans(), st.booleans()),
    last=i64,
)


@given(everything)
def test_every_value_comes_back_exactly(value: Everything) -> None:
    kind = message(Everything)
    assert kind.unpack(kind.pack(value)) == value


@given(everything)
def test_an_independent_reader_reads_the_same_values_and_writes_the_same_bytes(value: Everything) -> None:
    kind = message(Everything)
    definition = kind.definition()
    data = kind.pack(value)
    theirs = generate_dynamic(kind.name, definition)[kind.name](data)
    assert theirs.text == value.text
    assert theirs.colour == value.colour
    assert tuple(theirs.three) == value.three
    assert [v.value for v in theirs.perhaps] == ([] if value.perhaps is None else [value.perhaps.value])
    assert bytes(theirs.data) == value.data
    assert theirs.last == value.last
    assert serialize_dynamic(kind.name, definition)[kind.name](theirs) == data


def test_numbers_are_aligned_to_their_own_size() -> None:
    @dataclass(frozen=True)
    class Padded:
        a: Annotated[int, "uint8"]
        b: float
        c: Annotated[int, "uint16"]

    data = message(Padded).pack(Padded(1, 2.5, 3))
    assert data == b"\x00\x01\x00\x00" + b"\x01" + bytes(7) + struct.pack("<dH", 2.5, 3)


def test_floats_keep_their_last_bit_and_nan() -> None:
    value = Inner(True, math.nextafter(0.1, 1.0))
    assert message(Inner).unpack(message(Inner).pack(value)).value.hex() == value.value.hex()
    assert math.isnan(message(Inner).unpack(message(Inner).pack(Inner(False, math.nan))).value)


@pytest.mark.parametrize("cls", [Record, *TOPICS.values(), WireBytes], ids=lambda cls: cls.__name__)
def test_every_message_of_a_log_has_a_definition_that_an_independent_parser_accepts(cls: type) -> None:
    kind = message(cls)
    assert generate_dynamic(kind.name, kind.definition())[kind.name]


def test_standard_messages_are_defined_as_ros_2_defines_them() -> None:
    assert message(Imu).name == "sensor_msgs/msg/Imu"
    top = message(Imu).definition().split("\n\n")[0].splitlines()
    assert top == [
        "std_msgs/Header header",
        "geometry_msgs/Quaternion orientation",
        "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity",
        "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration",
        "float64[9] linear_acceleration_covariance",
    ]
    joints = message(JointState).definition()
    assert "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" in joints
    assert "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec" in joints


@given(st.integers(0, 40))
def test_a_message_cut_short_is_refused(cut: int) -> None:
    kind = message(Problem)
    data = kind.pack(Problem(ProblemKind.PORT, "here", "is gone", "Plug it in."))
    with pytest.raises(CdrError):
        kind.unpack(data[: max(len(data) - 1 - cut, 0)])


def test_a_text_that_does_not_end_where_it_says_is_refused() -> None:
    kind = message(Problem)
    data = kind.pack(Problem(ProblemKind.PORT, "here", "is gone", "Plug it in."))
    (size,) = struct.unpack_from("<I", data, 4)
    unended = data[: 8 + size - 1] + b"x" + data[8 + size :]
    for damaged in (unended, data[:4] + bytes(4) + data[8:], data[:4] + b"\xff\0\0\0" + data[8:]):
        with pytest.raises(CdrError, match="does not end"):
            kind.unpack(damaged)


def test_bytes_too_many_and_other_encodings_are_refused() -> None:
    kind = message(LogStatus)
    data = kind.pack(LogStatus(1, 2))
    with pytest.raises(CdrError, match="too many"):
        kind.unpack(data + b"\0")
    with pytest.raises(CdrError, match="little-endian"):
        kind.unpack(b"\x00\x00" + data[2:])


def test_a_type_without_a_place_in_ros_2_is_refused() -> None:
    @dataclass
    class Odd:
        field: complex

    with pytest.raises(CdrError, match="no place"):
        message(Odd)


def test_the_record_of_a_tick_holds_only_types_that_have_a_place() -> None:
    """Whoever adds a field to the record finds out here."""

    def leaves(value: Any) -> None:
        if is_dataclass(value):
            for field in fields(value):
                leaves(getattr(value, field.name))
        elif isinstance(value, tuple):
            for element in value:
                leaves(element)
        else:
            assert value is None or isinstance(value, bool | int | float | str | Enum)

    leaves(Inputs(0.0, False))
    leaves(Outputs())
    kind = message(Inputs)
    assert kind.unpack(kind.pack(Inputs(1.5, True))) == Inputs(1.5, True)


def test_a_body_at_rest_and_level_feels_gravity_upwards() -> None:
    still = (0.0, 0.0, 0.0)
    level = ImuSample(0.0, (1.0, 0.0, 0.0, 0.0), still, still, still, 0)
    assert ros.imu(level, ros.header(0)).linear_acceleration.z == ros.GRAVITY_MPS2


def test_a_body_with_its_left_side_up_feels_gravity_to_the_left() -> None:
    still = (0.0, 0.0, 0.0)
    roll = math.radians(30.0)
    tilted = ImuSample(0.0, (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0), still, still, still, 0)
    force = ros.imu(tilted, ros.header(0)).linear_acceleration
    assert force.y == pytest.approx(ros.GRAVITY_MPS2 * 0.5)
    assert force.x == pytest.approx(0.0)


def test_dead_reckoning_is_a_pose_of_the_body_in_odom_with_its_covariance() -> None:
    where = Odometry(
        x_m=1.0,
        y_m=-2.0,
        yaw_rad=math.radians(90.0),
        covariance=(0.01, 0.002, 0.003, 0.04, 0.005, 0.006),
        speed_mps=0.7,
        speed_sigma_mps=0.1,
        yaw_rate_radps=0.2,
    )
    odom = ros.odometry(Estimate(odometry=where), ros.header(0, "odom"))
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    pose, twist = odom.pose.pose, odom.twist.twist
    assert (pose.position.x, pose.position.y) == (1.0, -2.0)
    assert (pose.orientation.z, pose.orientation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert (twist.linear.x, twist.angular.z) == (0.7, 0.2)
    rows = [odom.pose.covariance[6 * row : 6 * row + 6] for row in range(6)]
    assert [rows[a][b] for a in (0, 1, 5) for b in (0, 1, 5)] == [
        *(0.01, 0.002, 0.003, 0.002, 0.04, 0.005, 0.003, 0.005, 0.006)
    ]
    assert rows[2][2] == ros.UNKNOWN_VARIANCE  # height is not estimated
    assert odom.twist.covariance[0] == pytest.approx(0.01)
    kind = message(type(odom))
    assert kind.unpack(kind.pack(odom)) == odom


def test_times_are_split_into_seconds_and_nanoseconds() -> None:
    stamp = ros.header(1_700_000_000_123_456_789).stamp
    assert (stamp.sec, stamp.nanosec) == (1_700_000_000, 123_456_789)
