"""nano_imu on its model of the BNO055: what it sends, and what it does about a sensor that fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tiger.native._core import lib

from tiger.native.boards import ImuBoard
from tiger.protocol.messages import (
    PARAMS,
    SCHEMA_HASH,
    Ack,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    ClearFaults,
    Fault,
    Health,
    HelloReply,
    ImuAttitude,
    ImuFlag,
    ImuRaw,
    ParamSave,
    ParamSet,
)

NANO = BoardKind.NANO_IMU
NODE = 1
GRAVITY = 9.80665
FIELD_UT = np.array([0.0, 20.0, -45.0])

# Bits of Bno055Model::FaultBit.
ABSENT, HUNG, SHORTED, ZERO, STUCK, SATURATED, SELF_TEST, BIT_FLIPS, FREE_FALL, STUCK_ACCEL, STUCK_GYRO = (
    1 << bit for bit in range(11)
)

Turn = Callable[[float], Rotation]


def attitude_of(message: ImuAttitude) -> Rotation:
    w, x, y, z = message.quaternion
    return Rotation.from_quat([x, y, z, w])


def tilt_deg(a: Rotation, b: Rotation) -> float:
    """Angle between the verticals of two attitudes."""
    up_a, up_b = a.inv().apply([0, 0, 1]), b.inv().apply([0, 0, 1])
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(up_a, up_b))), float(up_a @ up_b)))


def turned_deg(a: Rotation, b: Rotation) -> float:
    return math.degrees(float((a.inv() * b).magnitude()))


class Nano:
    """The board, its end of the wire, and a body whose attitude is a function of time."""

    def __init__(
        self, wire_of: Callable[..., Any], turn: Turn | None = None, clock_start_us: int = 0
    ) -> None:
        self.board = ImuBoard(uid=0x17)
        if clock_start_us:
            self.board.set_clock_start(clock_start_us)
            self.board.reset()
        self.wire = wire_of(self.board, NODE)
        self.turn: Turn = turn or tilted(0, 0)
        self.accel_mps2 = np.zeros(3)  # of the body over ground, earth axes
        self.gyro_bias = np.zeros(3)
        self.accel_offset = np.zeros(3)
        self._felt: tuple[Any, ...] = (None, None)
        self.time_ms = 0
        self.log: list[tuple[int, Any]] = []

    def run_ms(self, ms: int) -> list[Any]:
        """Let time pass; returns the messages that came. Short runs see the time of a message to 1 ms."""
        first = len(self.log)
        step_ms = 1 if ms <= 60 else 5
        while ms > 0:
            step_ms = min(step_ms, ms)
            self._feel(self.time_ms * 1e-3)
            self.board.run(1000 * step_ms)
            self.time_ms += step_ms
            ms -= step_ms
            self.log += [(self.time_ms, message) for message in self.wire.poll()]
        return [message for _, message in self.log[first:]]

    def _feel(self, t: float) -> None:
        """Give the sensor what it feels now, unless it is what it felt before."""
        dt = 1e-3
        body = self.turn(t)
        world = (*self.accel_mps2, *self.gyro_bias, *self.accel_offset)
        if body is self._felt[0] and world == self._felt[1]:
            return
        self._felt = (body, world)
        rate = (self.turn(t - dt).inv() * self.turn(t + dt)).as_rotvec() / (2 * dt)
        force = body.inv().apply(self.accel_mps2 + np.array([0, 0, GRAVITY])) + self.accel_offset
        field = body.inv().apply(FIELD_UT)
        self.board.set_inputs(force.tolist(), (rate + self.gyro_bias).tolist(), field.tolist())

    def all(self, kind: type, since_ms: int = 0) -> list[Any]:
        return [message for at, message in self.log if isinstance(message, kind) and at > since_ms]

    def last(self, kind: type) -> Any:
        return self.all(kind)[-1]

    def flag(self, flag: ImuFlag) -> bool:
        return bool(self.last(ImuAttitude).flags >> flag & 1)

    def request(self, message: Any) -> Ack:
        seq = self.wire.send(message)
        for _ in range(60):
            for answer in self.run_ms(1):
                if isinstance(answer, Ack) and answer.id == message.ID and answer.seq == seq:
                    return answer
        raise AssertionError(f"no answer to {message}")

    def set_parameter(self, name: str, *values: float) -> None:
        first = next(p for p in PARAMS[NANO] if p.name == name)
        for i, value in enumerate(values):
            answer = self.request(ParamSet(NODE, first.index + i, round(value / first.scale)))
            assert answer.status == AckStatus.OK

    def faults(self) -> set[Fault]:
        before = len(self.all(Health))
        while len(self.all(Health)) == before:
            self.run_ms(10)
        bits = self.last(Health).faults
        return {fault for fault in Fault if fault != 0 and bits >> fault & 1}

    def largest_step_deg(self, since_ms: int) -> float:
        """Largest change of attitude from one message to the next."""
        attitudes = [attitude_of(message) for message in self.all(ImuAttitude, since_ms)]
        return max(turned_deg(a, b) for a, b in pairwise(attitudes))


@pytest.fixture
def make_nano(make_wire: Callable[..., Any]) -> Iterator[Callable[..., Nano]]:
    made: list[Nano] = []

    def make(*args: Any, **kwargs: Any) -> Nano:
        made.append(Nano(make_wire, *args, **kwargs))
        return made[-1]

    yield make
    for nano in made:
        nano.board.close()


@pytest.fixture
def nano(make_nano: Callable[..., Nano]) -> Nano:
    """At rest and level, settled."""
    fresh = make_nano()
    fresh.run_ms(4500)
    return fresh


def tilted(roll_deg: float, pitch_deg: float) -> Turn:
    still = Rotation.from_euler("YX", [pitch_deg, roll_deg], degrees=True)
    return lambda _: still


def swaying(roll_deg: float, hz: float, from_s: float = 0.0) -> Turn:
    def turn(t: float) -> Rotation:
        angle = roll_deg * math.sin(2 * math.pi * hz * (t - from_s)) if t > from_s else 0.0
        return Rotation.from_euler("x", angle, degrees=True)

    return turn


# ---- what is sent


def test_it_introduces_itself_and_is_disarmed_once_its_sensor_measures(nano: Nano) -> None:
    reply = nano.last(HelloReply)
    assert (reply.board_kind, reply.node, reply.schema_hash) == (NANO, NODE, SCHEMA_HASH[NANO])
    assert nano.last(Health).state == BoardState.DISARMED
    assert nano.faults() == set()


@pytest.mark.parametrize("kind", [ImuAttitude, ImuRaw])
def test_both_messages_come_at_100_hz_within_one_percent(nano: Nano, kind: type) -> None:
    start = nano.time_ms
    nano.run_ms(10_000)
    assert len(nano.all(kind, start)) == pytest.approx(1000, abs=10)
    times = np.array([message.t_us for message in nano.all(kind, start)])
    assert np.diff(times).max() < 18_000  # one burst late by a 6 ms stretch at most


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg"), [(0, 0), (5, 0), (0, 5), (-20, 10), (45, -45), (170, 0), (0, 89)]
)
def test_attitude_at_rest_is_true_to_a_third_of_a_degree(
    make_nano: Callable[..., Nano], roll_deg: float, pitch_deg: float
) -> None:
    nano = make_nano(tilted(roll_deg, pitch_deg))
    nano.run_ms(6000)
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), nano.turn(0)) < 0.3
    assert math.isclose(sum(x * x for x in nano.last(ImuAttitude).quaternion), 1.0, abs_tol=2e-4)


def test_roll_is_positive_with_the_left_side_up_and_pitch_with_the_nose_down(
    make_nano: Callable[..., Nano],
) -> None:
    nano = make_nano(tilted(10, 20))
    nano.run_ms(3000)
    left_up = attitude_of(nano.last(ImuAttitude)).apply([0, 1, 0])[2]
    nose_up = attitude_of(nano.last(ImuAttitude)).apply([1, 0, 0])[2]
    assert left_up == pytest.approx(math.sin(math.radians(10)) * math.cos(math.radians(20)), abs=0.02)
    assert nose_up == pytest.approx(-math.sin(math.radians(20)), abs=0.01)


def test_heading_is_that_of_the_earths_field(make_nano: Callable[..., Nano]) -> None:
    facing_north = Rotation.from_euler("z", 90, degrees=True)  # east north up
    nano = make_nano(lambda _: facing_north)
    nano.run_ms(4000)
    assert turned_deg(attitude_of(nano.last(ImuAttitude)), facing_north) < 1.5


def test_attitude_follows_a_swaying_body(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano(swaying(8.0, 0.7, from_s=3.0))
    nano.run_ms(3500)
    worst = 0.0
    for _ in range(700):
        before = len(nano.all(ImuAttitude))
        nano.run_ms(10)
        if len(nano.all(ImuAttitude)) > before:
            message = nano.last(ImuAttitude)
            worst = max(worst, tilt_deg(attitude_of(message), nano.turn(message.t_us * 1e-6)))
    assert worst < 0.5


def test_rates_have_their_bias_removed_while_raw_ones_keep_it(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano()
    nano.gyro_bias = np.radians([0.8, -0.5, 0.3])
    nano.run_ms(20_000)
    tail = nano.all(ImuAttitude)[-300:]
    assert np.abs(np.mean([m.rate_radps for m in tail], axis=0)).max() < np.radians(0.03)
    raw = nano.all(ImuRaw)[-300:]
    assert np.mean([m.gyro_radps for m in raw], axis=0) == pytest.approx(nano.gyro_bias, abs=2e-4)


def test_angular_acceleration_follows_a_sway_of_one_hertz(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano(swaying(5.0, 1.0))
    nano.run_ms(6000)
    tail = nano.all(ImuAttitude)[-300:]
    seen = np.array([m.angular_accel_radps2[0] for m in tail])
    phase = 2 * math.pi * np.array([m.t_us for m in tail]) * 1e-6
    (in_phase, quadrature), *_ = np.linalg.lstsq(
        np.column_stack([-np.sin(phase), np.cos(phase)]), seen, rcond=None
    )
    peak = math.radians(5.0) * (2 * math.pi) ** 2
    assert math.hypot(in_phase, quadrature) == pytest.approx(peak, rel=0.03)
    delay_s = math.atan2(quadrature, in_phase) / (2 * math.pi)
    assert 0.015 < delay_s < 0.035  # the 15 Hz low-pass, and the age of a sample


def test_linear_acceleration_is_free_of_gravity_at_any_tilt(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano(tilted(15, -10))
    nano.run_ms(5000)
    tail = nano.all(ImuAttitude)[-100:]
    assert np.abs(np.mean([m.linear_accel_mps2 for m in tail], axis=0)).max() < 0.05
    nano.accel_mps2 = np.array([0.0, 0.0, 2.0])  # the ground lifts it
    nano.run_ms(200)
    lift = attitude_of(nano.last(ImuAttitude)).apply(nano.last(ImuAttitude).linear_accel_mps2)
    assert lift == pytest.approx([0, 0, 2.0], abs=0.15)


def test_magnetometer_samples_are_told_from_repeated_ones(nano: Nano) -> None:
    start = nano.time_ms
    nano.run_ms(5000)
    fresh = sum(m.flags >> ImuFlag.MAG_FRESH & 1 for m in nano.all(ImuAttitude, start))
    assert fresh == pytest.approx(100, abs=4)  # 20 Hz
    assert max(m.mag_age_ms for m in nano.all(ImuRaw, start)) < 110  # by chance two look alike


def test_the_filter_says_when_it_is_ready_and_when_the_robot_rests(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano(swaying(5.0, 1.0, from_s=8.0))
    nano.run_ms(1500)
    assert not nano.flag(ImuFlag.FILTER_READY)
    nano.run_ms(3000)
    assert nano.flag(ImuFlag.FILTER_READY)
    assert nano.flag(ImuFlag.REST)
    nano.run_ms(5000)
    assert not nano.flag(ImuFlag.REST)


def test_arm_is_refused_until_the_attitude_has_settled(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano()
    nano.run_ms(1000)
    session = nano.last(HelloReply).session
    assert nano.request(Arm(NODE, SCHEMA_HASH[NANO], session)).status == AckStatus.NOT_READY
    nano.run_ms(3500)
    assert nano.request(Arm(NODE, SCHEMA_HASH[NANO], session)).status == AckStatus.OK


def test_the_clock_may_wrap_at_any_time(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano(tilted(7, 0), clock_start_us=2**32 - 3_000_000)
    nano.run_ms(6000)
    times = [m.t_us for m in nano.all(ImuAttitude)]
    assert min(times) < 4_000_000 < max(times)
    assert len(nano.all(ImuAttitude, 4000)) == pytest.approx(200, abs=4)
    assert nano.faults() == set()
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), nano.turn(0)) < 0.3
    assert nano.largest_step_deg(2500) < 0.2


# ---- calibration


def test_offset_scale_and_bias_are_taken_out_of_the_attitude_but_not_of_raw(
    make_nano: Callable[..., Nano],
) -> None:
    nano = make_nano(tilted(3, 0))
    nano.accel_offset = np.array([0.4, -0.5, 0.2])
    nano.set_parameter("accel_offset_mps2", 0.4, -0.5, 0.2)
    nano.set_parameter("gyro_bias_radps", 0.01, 0.0, 0.0)
    nano.gyro_bias = np.array([0.01, 0.0, 0.0])
    nano.run_ms(5000)
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), nano.turn(0)) < 0.2
    assert np.mean([m.accel_mps2[0] for m in nano.all(ImuRaw)[-100:]]) == pytest.approx(0.4, abs=0.02)


def test_scale_is_applied_after_the_offset(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano()
    nano.accel_offset = np.array([0.0, 0.0, 0.5])
    nano.set_parameter("accel_offset_mps2", 0.0, 0.0, 0.5)
    nano.set_parameter("accel_scale_permille", 1000.0, 1000.0, 1100.0)
    nano.run_ms(4000)
    tail = [m.linear_accel_mps2[2] for m in nano.all(ImuAttitude)[-100:]]
    assert np.mean(tail) == pytest.approx(0.1 * GRAVITY, abs=0.02)


def test_mounting_turns_the_sensor_into_the_robots_axes(make_nano: Callable[..., Nano]) -> None:
    on_its_side = Rotation.from_euler("ZX", [90, 30], degrees=True)  # sensor to body
    nano = make_nano()
    robot = Rotation.from_euler("YX", [4, -6], degrees=True)
    nano.turn = lambda _: robot * on_its_side  # what the sensor feels
    x, y, z, w = on_its_side.as_quat()
    nano.set_parameter("mounting_quaternion", w, x, y, z)
    nano.run_ms(5000)
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), robot) < 0.3
    force = np.mean([m.accel_mps2 for m in nano.all(ImuRaw)[-100:]], axis=0)
    assert force == pytest.approx(robot.inv().apply([0, 0, GRAVITY]), abs=0.02)


def test_a_saved_calibration_outlives_a_reset_and_an_unsaved_one_does_not(
    make_nano: Callable[..., Nano],
) -> None:
    nano = make_nano(tilted(0, 0))
    nano.set_parameter("calibrated", 1)
    nano.set_parameter("accel_offset_mps2", 0.5)
    assert nano.request(ParamSave(NODE)).status == AckStatus.OK
    nano.run_ms(600)
    nano.set_parameter("accel_offset_mps2", 0.0)
    nano.board.reset()
    nano.run_ms(3500)
    assert nano.flag(ImuFlag.CALIBRATED)
    assert nano.last(ImuAttitude).linear_accel_mps2[0] == pytest.approx(0.0, abs=0.1)
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), Rotation.identity()) == pytest.approx(
        math.degrees(math.atan2(0.5, GRAVITY)), abs=0.3
    )


# ---- the BNO055


def test_the_chip_is_configured_as_designed(nano: Nano) -> None:
    def register(page: int, address: int) -> int:
        return int(lib.tiger_imu_register(nano.board._board, page, address))

    assert register(0, 0x3D) == 0x07  # accelerometer, magnetometer, gyroscope, no fusion
    assert register(0, 0x3B) & 0x17 == 0x02  # m/s2, rad/s, degrees Celsius
    assert register(1, 0x08) == 0b000_011_01  # normal, 62.5 Hz, 4 g
    assert register(1, 0x09) == 0b00_01_101  # normal, regular, 20 Hz
    assert register(1, 0x0A) == 0b011_010  # 47 Hz, 500 degrees/s
    assert register(1, 0x0B) == 0


def test_a_clock_stretched_in_every_transaction_costs_no_sample(nano: Nano) -> None:
    nano.board.set_stretch(1.0, 6000)
    start = nano.time_ms
    nano.run_ms(3000)
    assert len(nano.all(ImuAttitude, start)) == pytest.approx(300, abs=6)
    repeats = sum(m.flags >> ImuFlag.STALE & 1 for m in nano.all(ImuAttitude, start))
    assert repeats <= 3  # where the chip's clock and the board's drift past each other
    assert nano.faults() == set()


def unusable(message: ImuAttitude) -> bool:
    """The message says that its readings are not to be used."""
    both_ok = message.flags >> ImuFlag.ACCEL_OK & message.flags >> ImuFlag.GYRO_OK & 1
    return not both_ok or bool(message.flags >> ImuFlag.STALE & 1)


def measures(nano: Nano) -> bool:
    """Its latest messages are good, but for one repeated where the clocks of chip and board drift past."""
    return sum(unusable(message) for message in nano.all(ImuAttitude)[-20:]) <= 2


FAULTS = {
    "absent": (ABSENT, Fault.IMU_ABSENT),
    "shorted bus": (SHORTED, Fault.IMU_BUS),
    "zeros": (ZERO, Fault.IMU_DATA),
    "stuck": (STUCK, Fault.IMU_DATA),
    "saturated": (SATURATED, Fault.IMU_DATA),
    "free fall": (FREE_FALL, Fault.IMU_DATA),
}


@pytest.mark.parametrize("phase_ms", range(0, 10, 3))
@pytest.mark.parametrize("name", FAULTS)
def test_a_failing_sensor_is_told_within_30_ms_latched_and_recovered_without_a_jump(
    nano: Nano, name: str, phase_ms: int
) -> None:
    bits, fault = FAULTS[name]
    nano.run_ms(phase_ms)
    begun = nano.time_ms
    nano.board.set_faults(bits)
    nano.run_ms(31)  # and one for the bytes on the wire
    assert any(unusable(message) for message in nano.all(ImuAttitude, begun))
    nano.run_ms(15)
    assert nano.faults() == {fault}
    nano.run_ms(1500)
    assert nano.request(ClearFaults(NODE)).status == AckStatus.STILL_PRESENT

    nano.board.set_faults(0)
    nano.run_ms(7000)
    assert measures(nano)
    assert nano.flag(ImuFlag.FILTER_READY)
    assert nano.largest_step_deg(begun - 100) < 0.5
    assert nano.request(ClearFaults(NODE)).status == AckStatus.OK
    assert nano.faults() == set()


def test_a_hung_bus_is_freed_by_nine_clocks_at_the_price_of_two_samples(nano: Nano) -> None:
    for phase_ms in range(10):
        nano.run_ms(50 + phase_ms)
        begun = nano.time_ms
        nano.board.set_faults(HUNG)
        nano.run_ms(100)
        assert nano.board.faults == 0
        times = [m.t_us for m in nano.all(ImuAttitude, begun)]
        assert np.diff(times).max() <= 30_000
        assert len(nano.all(ImuAttitude, begun)) >= 8
    assert nano.faults() == set()


def test_a_fault_is_latched_within_31_ms_by_the_health_report(nano: Nano) -> None:
    for bits in (ABSENT, SHORTED, ZERO, STUCK, SATURATED, FREE_FALL):
        begun = nano.time_ms
        nano.board.set_faults(bits)
        nano.run_ms(31)
        frozen = nano.time_ms
        nano.board.set_faults(0)
        while not nano.all(Health, frozen):
            nano.run_ms(10)
        assert nano.last(Health).faults != 0, (bits, begun)
        nano.run_ms(2500)
        assert nano.request(ClearFaults(NODE)).status == AckStatus.OK


def test_a_chip_that_resets_itself_is_told_within_30_ms_and_measures_again_within_a_second(
    nano: Nano,
) -> None:
    begun = nano.time_ms
    nano.board.power_cycle_sensor()
    nano.run_ms(31)
    assert any(unusable(message) for message in nano.all(ImuAttitude, begun))
    nano.run_ms(900)
    assert measures(nano)
    assert nano.largest_step_deg(begun - 100) < 0.5
    assert nano.faults() == {Fault.IMU_ABSENT}


def test_the_body_may_turn_while_the_sensor_is_away_and_the_attitude_walks_there(
    make_nano: Callable[..., Nano],
) -> None:
    before, after = Rotation.identity(), Rotation.from_euler("x", 6.0, degrees=True)
    nano = make_nano(lambda t: after if t > 5.0 else before)
    nano.run_ms(4900)
    nano.board.set_faults(ABSENT)
    nano.run_ms(400)
    nano.board.set_faults(0)
    nano.run_ms(4000)
    assert nano.largest_step_deg(4800) < 0.5
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), after) < 0.5


def test_a_missing_sensor_is_named_after_its_boot_time_and_taken_into_service_when_it_comes(
    make_nano: Callable[..., Nano],
) -> None:
    nano = make_nano()
    nano.board.set_faults(ABSENT)
    nano.run_ms(900)
    assert nano.faults() == set()
    nano.run_ms(300)
    assert nano.faults() == {Fault.IMU_ABSENT}
    assert nano.last(Health).state == BoardState.FAULT
    assert len(nano.all(ImuAttitude, 1000)) > 10  # it says so in its messages too
    assert all(unusable(message) for message in nano.all(ImuAttitude))
    nano.board.set_faults(0)
    nano.run_ms(5000)
    assert nano.request(ClearFaults(NODE)).status == AckStatus.OK
    assert nano.flag(ImuFlag.FILTER_READY)


def test_a_failed_self_test_is_reported(make_nano: Callable[..., Nano]) -> None:
    nano = make_nano()
    nano.board.set_faults(SELF_TEST)
    nano.run_ms(1500)
    assert nano.faults() == {Fault.IMU_SELF_TEST}


@pytest.mark.parametrize("bits", [STUCK_ACCEL, STUCK_GYRO])
def test_one_stuck_sensor_of_the_two_is_not_used_after_32_ms_and_a_fault_after_120(
    nano: Nano, bits: int
) -> None:
    begun = nano.time_ms
    nano.board.set_faults(bits)
    nano.run_ms(33)
    assert any(unusable(message) for message in nano.all(ImuAttitude, begun))
    nano.run_ms(88)
    assert nano.faults() == {Fault.IMU_DATA}


def test_flipped_bits_are_not_taken_for_motion(nano: Nano) -> None:
    nano.board.set_faults(BIT_FLIPS)
    begun = nano.time_ms
    nano.run_ms(3000)
    assert any(unusable(message) for message in nano.all(ImuAttitude, begun))
    sent = len(nano.all(ImuAttitude, begun))
    assert len(nano.all(ImuRaw, begun)) >= sent - 1  # none was beyond the limits of the wire
    assert nano.largest_step_deg(begun) < 0.5
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), Rotation.identity()) < 0.5


def test_a_knock_of_two_samples_is_flagged_but_no_fault(nano: Nano) -> None:
    nano.accel_mps2 = np.array([80.0, 0.0, 0.0])
    begun = nano.time_ms
    nano.run_ms(18)
    nano.accel_mps2 = np.zeros(3)
    nano.run_ms(200)
    assert any(m.flags >> ImuFlag.SATURATED & 1 for m in nano.all(ImuAttitude, begun))
    assert nano.faults() == set()
    assert nano.largest_step_deg(begun) < 0.2


@settings(
    max_examples=8,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # each example takes 20 s of the board's time
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    events=st.lists(
        st.tuples(
            st.sampled_from([ABSENT, HUNG, SHORTED, ZERO, STUCK, SATURATED, FREE_FALL, BIT_FLIPS]),
            st.integers(1, 400),
            st.integers(1, 700),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_no_sequence_of_faults_makes_the_attitude_jump_or_keeps_the_board_from_recovering(
    make_nano: Callable[..., Nano], events: list[tuple[int, int, int]]
) -> None:
    nano = make_nano(tilted(5, -3))
    nano.run_ms(4000)
    for bits, lasting_ms, pause_ms in events:
        nano.board.set_faults(bits)
        nano.run_ms(lasting_ms)
        nano.board.set_faults(0)
        nano.run_ms(pause_ms)
    nano.run_ms(8000)
    assert nano.largest_step_deg(3500) < 0.5
    assert measures(nano)
    assert tilt_deg(attitude_of(nano.last(ImuAttitude)), nano.turn(0)) < 0.4
    nano.request(ClearFaults(NODE))
    assert nano.faults() == set()
