"""A board's end of its wire: who it is, config messages, forwarding, health."""

from __future__ import annotations

import random
import re
from itertools import pairwise
from pathlib import Path

import pytest

from tiger.native.boards import EXTERNAL, PEER_PORT, POWER_ON, ImuBoard, SpeedBoard, SuspensionBoard
from tiger.protocol.frame import FrameDecoder, encode, encode_message
from tiger.protocol.messages import (
    FROM_BOARD,
    NODE,
    PROTO,
    SCHEMA_HASH,
    Ack,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    ClearFaults,
    Disarm,
    Fault,
    Health,
    Hello,
    HelloReply,
    ParamGet,
    ParamSave,
    ParamSet,
    Ping,
    Pong,
    RejectCause,
    SuspensionSetpoint,
    SuspensionState,
)

HASH = SCHEMA_HASH[BoardKind.MEGA_SUSPENSION]
VERSION_H = Path(__file__).parents[2] / "firmware/libraries/TigerCore/src/tiger/version.h"
FW_VERSION = tuple(int(part) for part in re.findall(r"kVersion\w+ = (\d+);", VERSION_H.read_text()))


# --------------------------------------------------------------------------------------------- introduction


@pytest.mark.parametrize("kind", [SuspensionBoard, ImuBoard, SpeedBoard])
def test_every_board_answers_hello_with_who_it_is(kind, make_wire):
    with kind(uid=0xCAFE) as board:
        wire = make_wire(board)
        board.run(50_000)
        wire.send(Hello(PROTO, NODE[kind.KIND], 0, 4711))
        board.run(20_000)
        reply = wire.last(HelloReply)
    assert reply.board_kind == kind.KIND
    assert reply.node == NODE[kind.KIND]
    assert reply.schema_hash == SCHEMA_HASH[kind.KIND]
    assert reply.host_nonce == 4711
    assert reply.board_uid == 0xCAFE
    assert reply.reset_cause == POWER_ON
    assert reply.fw_version == FW_VERSION


def test_a_board_introduces_itself_at_boot_and_once_a_second_while_disarmed(make_rig):
    rig = make_rig()
    rig.run_ms(20)
    assert [reply.host_nonce for reply in rig.wire.all(HelloReply)] == [0]
    rig.run_ms(3000)
    assert len(rig.wire.all(HelloReply)) == 4
    rig.arm()
    before = len(rig.wire.all(HelloReply))
    rig.run_ms(3000)
    assert len(rig.wire.all(HelloReply)) == before


def test_a_hello_for_an_unknown_node_stays_unanswered(rig):
    before = len(rig.wire.all(HelloReply))
    rig.wire.send(Hello(PROTO, 7, HASH, 1))
    rig.run_ms(100)
    assert all(reply.host_nonce == 0 for reply in rig.wire.all(HelloReply)[before:])


def test_boots_are_counted_over_resets(rig):
    count = rig.hello().boot_count
    for cause in (EXTERNAL, POWER_ON):
        rig.run_ms(100)  # the count is written
        rig.board.reset(cause)
        rig.run_ms(100)
        count += 1
        reply = rig.hello()
        assert reply.boot_count == count
        assert reply.reset_cause == cause


def test_a_board_without_identity_draws_one_and_keeps_it(make_rig):
    uids = []
    for pause_ms in (13, 57):
        rig = make_rig(board=SuspensionBoard(uid=0xFFFFFFFF))
        rig.run_ms(pause_ms)
        uid = rig.hello().board_uid
        assert uid != 0xFFFFFFFF
        rig.run_ms(100)
        rig.board.reset(POWER_ON)
        rig.run_ms(50)
        assert rig.hello().board_uid == uid
        uids.append(uid)
    assert uids[0] != uids[1]


def test_ping_returns_the_boards_clock_at_reception(rig):
    rig.wire.send(Ping(0, 123_456_789))
    rig.run_ms(5)
    pong = rig.wire.last(Pong)
    assert pong.host_us == 123_456_789
    assert 0 <= pong.tx_us - pong.rx_us < 1000
    assert 0 < rig.board.clock_us - pong.rx_us < 5000


# --------------------------------------------------------------------------------------------- arming


def test_arm_names_what_it_refuses(rig):
    session = rig.hello().session
    assert rig.request(Arm(0, HASH ^ 1, session)).status == AckStatus.BAD_SCHEMA
    assert rig.request(Arm(0, HASH, session ^ 1)).status == AckStatus.BAD_SESSION
    assert rig.request(Arm(0, HASH, session)).status == AckStatus.OK


def test_arm_is_refused_while_the_board_boots(make_rig):
    rig = make_rig()
    rig.run_ms(20)
    assert rig.request(Arm(0, HASH, rig.hello().session)).status == AckStatus.NOT_READY


def test_each_disarm_begins_a_new_session(rig):
    session = rig.hello().session
    for step in range(1, 4):
        assert rig.disarm().value == (session + step) % 256
    assert rig.request(Arm(0, HASH, session)).status == AckStatus.BAD_SESSION


def test_a_repeated_config_message_is_carried_out_once_and_gets_the_same_answer(rig):
    session = rig.hello().session
    first = rig.request(Disarm(0), seq=200)
    again = rig.request(Disarm(0), seq=200)
    assert again == first
    assert rig.hello().session == (session + 1) % 256


def test_the_same_number_seconds_later_is_a_new_message(rig):
    session = rig.hello().session
    rig.request(Disarm(0), seq=200)
    rig.run_ms(1500)
    rig.request(Disarm(0), seq=200)
    assert rig.hello().session == (session + 2) % 256


def test_the_same_number_of_a_restarted_host_is_a_new_message(rig):
    session = rig.hello().session
    rig.request(Disarm(0), seq=3)
    rig.hello()
    rig.request(Disarm(0), seq=3)
    assert rig.hello().session == (session + 2) % 256


# --------------------------------------------------------------------------------------------- health


def test_health_comes_ten_times_a_second(rig):
    before = len(rig.wire.all(Health))
    rig.run_ms(2000)
    assert len(rig.wire.all(Health)) - before == 20


def test_health_reports_loop_times_and_the_watchdogs_margin(rig):
    rig.run_ms(500)
    health = rig.health()
    assert health.state == BoardState.DISARMED
    assert health.fault_detail == 255
    assert health.faults == 0
    assert health.overruns == 0
    assert health.loop_min_us == health.loop_max_us == 250
    assert health.supply_mv == 5000
    assert health.watchdog_margin_ms == 23  # fed every 10 ms


def corrupted(frame: bytes) -> bytes:
    return frame[:-3] + bytes([frame[-3] ^ 0x40 or 1]) + frame[-2:]


def test_each_refusal_is_counted_under_its_cause(rig):
    before = rig.health().rejects
    setpoint = SuspensionSetpoint(0, 1, (0.0,) * 4)
    bad = {
        RejectCause.LENGTH: [b"\0" + b"\x01" * 60 + b"\0", b"\0ab\0"],
        RejectCause.DECODE: [b"\0\xc8abcdefgh\0"],
        RejectCause.UNKNOWN_ID: [encode(0x21, 0, setpoint.pack()), encode(0x77, 0, b"abc")],
        RejectCause.SIZE: [encode(0x20, 0, setpoint.pack() + b"\x01")],
        RejectCause.CRC: [corrupted(encode_message(setpoint, 5))],
        RejectCause.RANGE: [encode(0x20, 0, b"\1\1" + b"\2" + b"\1" * 8)],
    }
    for frames in bad.values():
        for frame in frames:
            rig.board.uart_write(frame)
    rig.run_ms(20)
    after = rig.health().rejects
    assert [b - a for a, b in zip(before, after, strict=True)] == [len(bad[cause]) for cause in RejectCause]


def test_noise_between_frames_costs_no_frame(rig):
    chance = random.Random(3)
    for _ in range(50):
        rig.board.uart_write(bytes(chance.randrange(1, 256) for _ in range(chance.randrange(80))))
        assert rig.request(ParamGet(0, 0)).status == AckStatus.OK


def test_missing_sequence_numbers_are_counted(armed):
    before = armed.health().seq_gaps
    armed.wire.seq = (armed.wire.seq + 7) % 256
    armed.run_ms(20)
    assert armed.health().seq_gaps - before == 7


def test_a_repeated_frame_makes_no_gap(armed):
    before = armed.health().seq_gaps
    old = (armed.wire.seq - 20) % 256
    for _ in range(3):
        armed.request(ParamGet(0, 0), seq=old)
    assert armed.health().seq_gaps == before


def test_frames_of_a_board_carry_consecutive_numbers(armed):
    armed.wire.poll()
    decoder = FrameDecoder(FROM_BOARD[BoardKind.MEGA_SUSPENSION])
    seqs = []
    for _ in range(500):
        armed.run_ms(1)
        seqs += [received.seq for received in decoder.feed(armed.board.uart_read())]
    assert len(seqs) > 50
    assert {(b - a) % 256 for a, b in pairwise(seqs)} == {1}


# ------------------------------------------------------------------------------------------the Nano behind it


class Pair:
    """The Mega and the Nano with the line between them."""

    def __init__(self, rig):
        self.rig = rig
        self.nano = ImuBoard(uid=0x1111)
        self.nano.set_inputs((0.0, 0.0, 9.81), (0.0, 0.0, 0.0), (20.0, 0.0, -40.0))
        self.decoder = FrameDecoder(
            {**FROM_BOARD[BoardKind.MEGA_SUSPENSION], **FROM_BOARD[BoardKind.NANO_IMU]}
        )
        self.received = []
        self.from_nano = b""
        self.noise = lambda data: data
        rig.watch = self.link

    def link(self):
        self.nano.run(1000)
        upwards = self.nano.uart_read()
        self.from_nano += upwards
        self.rig.board.uart_write(self.noise(upwards), PEER_PORT)
        self.nano.uart_write(self.rig.board.uart_read(PEER_PORT))
        self.received += self.decoder.feed(self.rig.board.uart_read())

    def last(self, kind, node=1):
        found = [r.message for r in self.received if isinstance(r.message, kind) and r.message.node == node]
        assert found, f"no {kind.__name__} of node {node}"
        return found[-1]


@pytest.fixture
def pair(rig):
    joined = Pair(rig)
    rig.run_ms(1500)
    yield joined
    joined.nano.close()


def test_the_host_says_hello_to_the_nano_through_the_mega(pair):
    pair.rig.wire.send(Hello(PROTO, 1, 0, 99))
    pair.rig.run_ms(20)
    reply = pair.last(HelloReply)
    assert (reply.board_kind, reply.board_uid, reply.host_nonce) == (BoardKind.NANO_IMU, 0x1111, 99)


def test_the_nano_is_pinged_and_configured_through_the_mega(pair):
    pair.rig.wire.send(Ping(1, 42))
    seq = pair.rig.wire.send(ParamGet(1, 6))
    pair.rig.run_ms(20)
    assert pair.last(Pong).host_us == 42
    ack = pair.last(Ack)
    assert (ack.id, ack.seq, ack.status, ack.value) == (ParamGet.ID, seq, AckStatus.OK, 1_000_000)


def test_frames_of_the_nano_pass_byte_for_byte_and_at_full_rate(pair):
    pair.received.clear()
    pair.from_nano = b""
    raw = []
    feed = pair.decoder.feed
    pair.decoder.feed = lambda data: raw.append(data) or feed(data)
    pair.rig.run_ms(1000)
    stream = b"".join(raw)
    sent = [chunk for chunk in pair.from_nano.split(b"\0") if chunk][1:-2]
    assert len(sent) > 190
    for chunk in sent:
        assert b"\0" + chunk + b"\0" in stream
    assert sum(isinstance(r.message, SuspensionState) for r in pair.received) == 100


def test_config_messages_of_the_nano_do_not_touch_the_mega(pair):
    pair.rig.wire.send(Hello(PROTO, 0, 0, 1))
    pair.rig.run_ms(20)
    before = pair.last(HelloReply, node=0).session
    pair.rig.wire.send(Disarm(1))
    pair.rig.wire.send(ParamSet(1, 0, 5))
    pair.rig.wire.send(Hello(PROTO, 0, 0, 2))
    pair.rig.run_ms(30)
    assert pair.last(HelloReply, node=0).session == before


def test_damaged_frames_of_the_nano_are_dropped_and_counted(pair):
    chance = random.Random(1)

    def flip(data):
        return bytes(b ^ (1 << chance.randrange(8)) if chance.random() < 0.005 else b for b in data)

    pair.noise = flip
    pair.received.clear()
    pair.rig.run_ms(2000)
    health = pair.last(Health, node=0)
    assert sum(health.rejects) > 20
    assert sum(pair.decoder.rejects) == 0  # none was passed on


def test_a_babbling_nano_does_not_disturb_the_mega(armed):
    chance = random.Random(2)
    armed.watch = lambda: armed.board.uart_write(chance.randbytes(25), PEER_PORT)  # its line is full
    armed.rates_mmps = (2.0, -2.0, 1.0, -1.0)
    before = len(armed.wire.all(SuspensionState))
    armed.run_ms(3000)
    assert len(armed.wire.all(SuspensionState)) - before == 300
    assert armed.state.state == BoardState.ARMED
    assert armed.health().overruns == 0


def test_a_flood_from_the_host_does_not_disturb_the_control(armed):
    chance = random.Random(4)
    armed.watch = lambda: armed.board.uart_write(chance.randbytes(20))
    armed.run_ms(20)
    armed.watch = None
    armed.run_ms(50)
    armed.rates_mmps = (2.0, -2.0, 1.0, -1.0)
    flood = encode_message(Ping(0, 1), 1) + chance.randbytes(20)  # two thirds of the line
    armed.watch = lambda: armed.board.uart_write(flood)
    armed.run_ms(1000)
    assert armed.health().overruns == 0
    assert armed.state.state == BoardState.ARMED


# ------------------------------------------------------------------------------------------ faults in general


def test_a_fault_latched_before_a_reset_is_named_by_the_next_boot(armed):
    armed.rates_mmps = None
    armed.run_ms(400)
    assert armed.faults() == {Fault.LINK_LOST}
    armed.board.reset(EXTERNAL)
    armed.run_ms(50)
    assert armed.hello().last_fault == Fault.LINK_LOST
    assert armed.faults() == set()


def test_power_on_forgets_the_last_run(armed):
    armed.rates_mmps = None
    armed.run_ms(400)
    armed.board.reset(POWER_ON)
    armed.run_ms(50)
    assert armed.hello().last_fault == 0


def test_parameters_are_not_set_while_armed(armed):
    assert armed.request(ParamSet(0, 0, 900)).status == AckStatus.NOT_DISARMED
    assert armed.request(ParamSave(0)).status == AckStatus.NOT_DISARMED
    assert armed.request(ClearFaults(0)).status == AckStatus.OK


# -------------------------------------------------------------------------------------------- deadlines


def test_a_main_loop_that_is_late_now_and_then_is_counted(armed):
    for _ in range(5):
        armed.board.set_turn(21_000)
        armed.run_us(21_000)
        armed.board.set_turn(250)
        armed.run_ms(50)
    health = armed.health()
    assert health.overruns >= 5
    assert health.faults == 0
    assert health.watchdog_margin_ms < 12


@pytest.mark.parametrize(("missed", "is_fault"), [(9, False), (10, True)])
def test_nine_deadlines_missed_in_a_row_are_no_fault_and_ten_are(armed, missed, is_fault):
    armed.board.set_turn(21_000)
    for _ in range(missed):
        armed.run_us(21_000)
    armed.board.set_turn(250)
    assert (Fault.OVERRUN in armed.faults()) == is_fault


def test_a_board_that_misses_its_deadlines_switches_off(armed):
    armed.board.set_turn(21_000)
    for _ in range(14):
        armed.run_us(21_000)
    armed.board.set_turn(250)
    armed.rates_mmps = None
    armed.run_ms(5)
    assert armed.is_off
    assert Fault.OVERRUN in armed.faults()
