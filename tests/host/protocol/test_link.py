"""Sessions on a line: who answers is checked, commands are repeated, losses are counted, resets are seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import pytest

from tiger.protocol.frame import OVERHEAD_BYTES, FrameDecoder, encode_message
from tiger.protocol.link import (
    Event,
    Identified,
    Link,
    Lost,
    Outcome,
    Rebooted,
    Telemetry,
)
from tiger.protocol.messages import (
    BAUD,
    PROTO,
    SCHEMA_HASH,
    TO_BOARD,
    Ack,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    Disarm,
    Estop,
    Health,
    Hello,
    HelloReply,
    ImuRaw,
    Message,
    Ping,
    Pong,
    SuspensionSetpoint,
    WheelSpeed,
    node_of,
)
from tiger.record import ProblemKind

EVERYTHING = {i: m for kind in BoardKind for i, m in TO_BOARD[kind].items()}


def reply(kind: BoardKind = BoardKind.MEGA_SPEED, **changes: int) -> HelloReply:
    node = 1 if kind is BoardKind.NANO_IMU else 0
    return replace(
        HelloReply(PROTO, node, kind, 0, 7, SCHEMA_HASH[kind], (1, 0, 0), 0, 0, 1, 3, 0, 5000, 0, 1),
        **changes,
    )


def health(node: int = 0, state: BoardState = BoardState.DISARMED) -> Health:
    return Health(node, state, 0, 255, 100, 200, 0, (0,) * 6, 0, 0, 500, 5000, 20)


RAW = ImuRaw(1_000_000, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 0, 20)
WHEELS = WheelSpeed(1_000_000, (0, 0), (0.0, 0.0), (0, 0), (0, 0), 0)
SETPOINT = SuspensionSetpoint(0, 1, (0.0,) * 4)


@dataclass
class Wire:
    """The far end of a link: reads what the host sends, answers as told."""

    link: Link = field(default_factory=lambda: Link("/dev/ttyACM0", 500_000, 99))
    now_s: float = 100.0
    seqs: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ears = FrameDecoder(EVERYTHING)

    def sent(self) -> list[Message]:
        return [message for _, message in self.ears.feed(self.link.outgoing(self.now_s))]

    def sent_frames(self) -> list[tuple[int, Message]]:
        return list(self.ears.feed(self.link.outgoing(self.now_s)))

    def say(self, message: Message, skip: int = 0) -> list[Event]:
        node = node_of(message)
        self.seqs[node] = self.seqs.get(node, 250) + 1 + skip
        return self.link.feed(encode_message(message, self.seqs[node]), self.now_s)

    def wait(self, seconds: float) -> list[Event]:
        self.now_s += seconds
        return self.link.poll(self.now_s)

    def introduce(self, kind: BoardKind = BoardKind.MEGA_SPEED) -> list[Event]:
        nonces = [m.host_nonce for m in self.sent() if isinstance(m, Hello)]
        return self.say(reply(kind, host_nonce=nonces[0] if nonces else 0))


@pytest.fixture
def wire() -> Wire:
    return Wire()


# -------------------------------------------------------------------------------------------------- handshake


def test_hello_is_said_until_a_board_answers(wire: Wire) -> None:
    assert wire.sent() == [Hello(PROTO, 0, 0, 99)]
    assert wire.sent() == []
    wire.wait(0.25)
    assert wire.sent() == [Hello(PROTO, 0, 0, 99)]
    wire.introduce()
    wire.wait(0.3)
    assert not [m for m in wire.sent() if isinstance(m, Hello)]


def test_a_good_board_is_identified_once(wire: Wire) -> None:
    (event,) = wire.introduce()
    assert isinstance(event, Identified)
    assert event.session.usable
    assert (event.session.kind, event.session.name) == (BoardKind.MEGA_SPEED, "mega_speed (left)")
    assert wire.say(reply(uptime_ms=6000)) == []


def test_an_unasked_introduction_is_enough(wire: Wire) -> None:
    (event,) = wire.say(reply(host_nonce=0))
    assert isinstance(event, Identified)


def test_the_nano_is_introduced_behind_the_mega(wire: Wire) -> None:
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    hellos = [m for m in wire.sent() if isinstance(m, Hello)]
    assert hellos == [Hello(PROTO, 1, SCHEMA_HASH[BoardKind.NANO_IMU], 99)]
    (event,) = wire.say(reply(BoardKind.NANO_IMU))
    assert isinstance(event, Identified)
    assert wire.link.session(BoardKind.NANO_IMU) is event.session


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        (
            {"schema_hash": 0xDEADBEEF},
            ProblemKind.SCHEMA,
            [
                *("mega_speed on /dev/ttyACM0", "0xdeadbeef", f"{SCHEMA_HASH[BoardKind.MEGA_SPEED]:#010x}"),
                "make flash BOARD=mega_speed PORT=/dev/ttyACM0",
            ],
        ),
        ({"proto": 2}, ProblemKind.PROTOCOL, ["speaks version 2", "this program version 1", "make flash"]),
        ({"board_kind": 77}, ProblemKind.WRONG_BOARD, ["unknown kind 77", "make flash"]),
        ({"instance": 2}, ProblemKind.WRONG_BOARD, ["number 2 of its kind; there are 2", "strap pin"]),
    ],
)
def test_a_wrong_board_is_named_with_the_next_step(
    wire: Wire, changes: dict[str, int], kind: ProblemKind, words: list[str]
) -> None:
    wire.sent()
    (event,) = wire.say(reply(**changes))
    assert isinstance(event, Identified)
    assert not event.session.usable
    assert event.session.problem is not None
    assert event.session.problem.kind is kind
    for word in words:
        assert word in str(event.session.problem)


def test_a_speed_board_behind_the_mega_is_a_wrong_board(wire: Wire) -> None:
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    (event,) = wire.say(reply(BoardKind.MEGA_SPEED, node=1))
    assert isinstance(event, Identified)
    assert event.session.problem is not None
    assert "is not the nano_imu that belongs there" in str(event.session.problem)


def test_of_a_board_with_another_schema_only_frozen_messages_are_believed(wire: Wire) -> None:
    wire.sent()
    wire.say(reply(schema_hash=1))
    assert wire.say(health()) == []
    assert wire.say(WHEELS) == []
    assert [m for m in wire.sent() if isinstance(m, Ping)]


def test_nothing_is_believed_before_the_introduction(wire: Wire) -> None:
    assert wire.say(health()) == []
    assert wire.say(WHEELS) == []


# ------------------------------------------------------------------------------------------ resets and losses


@pytest.mark.parametrize(
    "changes",
    [{"boot_count": 4, "uptime_ms": 100}, {"uptime_ms": 100}, {"board_uid": 8}],
    ids=["counted boot", "short uptime", "another board"],
)
def test_a_reset_is_seen(wire: Wire, changes: dict[str, int]) -> None:
    wire.introduce()
    events = wire.say(reply(**{"uptime_ms": 6000, **changes}))
    assert [type(event) for event in events] == [Rebooted, Identified]


def test_a_wrapped_uptime_is_no_reset(wire: Wire) -> None:
    wire.say(reply(uptime_ms=0xFFFF_FF00))
    assert wire.say(reply(uptime_ms=50)) == []


def test_a_board_that_comes_back_with_another_schema_is_not_used(wire: Wire) -> None:
    wire.introduce()
    wire.say(reply(boot_count=4, schema_hash=1))
    assert not wire.link.sessions[0].usable


def test_a_silent_board_is_lost_and_asked_again(wire: Wire) -> None:
    wire.introduce()
    wire.sent()
    assert wire.wait(0.5) == []
    (event,) = wire.wait(0.01)
    assert isinstance(event, Lost)
    assert Hello(PROTO, 0, 0, 99) in wire.sent()
    (back,) = wire.say(reply())
    assert isinstance(back, Identified)


def test_gaps_are_counted_for_each_board_by_itself(wire: Wire) -> None:
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    wire.say(reply(BoardKind.NANO_IMU))
    for _ in range(300):
        wire.say(health())
    wire.say(RAW, skip=3)
    wire.say(RAW)
    mega, nano = wire.link.sessions[0], wire.link.sessions[1]
    assert (mega.seq_gaps, nano.seq_gaps) == (0, 3)


def test_what_a_board_said_before_its_introduction_is_not_missing(wire: Wire) -> None:
    wire.say(health())
    wire.say(health(), skip=7)  # cut as the port was opened
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    wire.say(RAW)
    wire.say(RAW, skip=2)
    wire.say(reply(BoardKind.NANO_IMU), skip=5)
    mega, nano = wire.link.sessions[0], wire.link.sessions[1]
    assert (mega.seq_gaps, nano.seq_gaps) == (0, 0)
    wire.say(RAW, skip=2)
    assert (mega.seq_gaps, nano.seq_gaps) == (0, 2)


def test_telemetry_in_one_piece_with_the_introduction_counts(wire: Wire) -> None:
    said = b"".join(encode_message(m, seq) for seq, m in enumerate((reply(), WHEELS, WHEELS)))
    events = wire.link.feed(said, wire.now_s)
    assert [type(event) for event in events] == [Identified, Telemetry, Telemetry]
    assert sum(wire.link.decoder.rejects) == 0
    assert wire.link.sessions[0].seq_gaps == 0


def test_a_reset_is_no_gap(wire: Wire) -> None:
    wire.introduce()
    wire.say(health())
    wire.say(reply(boot_count=4), skip=100)
    wire.say(health())
    assert wire.link.sessions[0].seq_gaps == 0


# ----------------------------------------------------------------------------------------------------- config


def test_a_config_message_is_repeated_unchanged_until_the_board_answers(wire: Wire) -> None:
    wire.introduce()
    wire.sent()
    request = wire.link.request(Arm(0, SCHEMA_HASH[BoardKind.MEGA_SPEED], 1))
    ((seq, arm),) = [f for f in wire.sent_frames() if isinstance(f[1], Arm)]
    wire.wait(0.020)
    assert not [m for m in wire.sent() if isinstance(m, Arm)]
    wire.wait(0.006)
    assert [f for f in wire.sent_frames() if isinstance(f[1], Arm)] == [(seq, arm)]
    assert request.outcome is Outcome.WAITING
    wire.say(Ack(0, Arm.ID, seq, AckStatus.OK, 17))
    assert (request.outcome, request.ok, request.value) == (Outcome.ANSWERED, True, 17)


def test_five_tries_with_doubling_pauses_then_it_is_given_up(wire: Wire) -> None:
    wire.introduce()
    request = wire.link.request(Disarm(0))
    times = []
    for _ in range(2000):
        if any(isinstance(m, Disarm) for m in wire.sent()):
            times.append(wire.now_s)
        wire.say(health())
        wire.wait(0.001)
    assert request.outcome is Outcome.GIVEN_UP
    pauses_ms = [round((b - a) * 1000) for a, b in pairwise(times)]
    assert len(times) == 5
    assert pauses_ms == pytest.approx([26, 52, 104, 208], abs=4)


def test_one_config_message_is_under_way_at_a_time(wire: Wire) -> None:
    wire.introduce()
    wire.link.request(Disarm(0))
    second = wire.link.request(Arm(0, 1, 1))
    ((seq, _),) = [f for f in wire.sent_frames() if isinstance(f[1], Disarm | Arm)]
    assert not [m for m in wire.sent() if isinstance(m, Arm)]
    wire.say(Ack(0, Disarm.ID, seq, AckStatus.OK, 0))
    assert [m for m in wire.sent() if isinstance(m, Arm)]
    assert second.outcome is Outcome.WAITING


@pytest.mark.parametrize("wrong", [{"seq": 200}, {"id": Disarm.ID}, {"node": 1}])
def test_an_answer_to_something_else_is_not_taken(wire: Wire, wrong: dict[str, int]) -> None:
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    wire.say(reply(BoardKind.NANO_IMU))
    request = wire.link.request(Arm(0, 1, 1))
    ((seq, _),) = [f for f in wire.sent_frames() if isinstance(f[1], Arm)]
    wire.say(replace(Ack(0, Arm.ID, seq, AckStatus.OK, 0), **wrong))
    assert request.outcome is Outcome.WAITING


def test_an_urgent_message_goes_before_all_others(wire: Wire) -> None:
    wire.introduce()
    waiting = [wire.link.request(Arm(0, 1, 1)), wire.link.request(Arm(0, 1, 1))]
    wire.sent()
    wire.link.request(Estop(0), urgent=True)
    assert [type(m) for m in wire.sent() if isinstance(m, Arm | Estop)] == [Estop]
    assert all(request.outcome is Outcome.GIVEN_UP for request in waiting)


def test_the_new_session_is_asked_for_after_a_disarm(wire: Wire) -> None:
    wire.introduce()
    wire.link.request(Disarm(0))
    ((seq, _),) = [f for f in wire.sent_frames() if isinstance(f[1], Disarm)]
    wire.say(Ack(0, Disarm.ID, seq, AckStatus.OK, 0))
    assert [m for m in wire.sent() if isinstance(m, Hello)]
    wire.say(reply(session=2, host_nonce=99))
    assert wire.link.sessions[0].identity is not None
    assert wire.link.sessions[0].identity.session == 2
    wire.wait(0.3)
    assert not [m for m in wire.sent() if isinstance(m, Hello)]


# ---------------------------------------------------------------------------------------------- streams, time


def test_of_two_setpoints_the_newer_is_sent_and_only_once(wire: Wire) -> None:
    wire.introduce(BoardKind.MEGA_SUSPENSION)
    wire.link.setpoint(SETPOINT)
    wire.link.setpoint(replace(SETPOINT, host_ms=5))
    assert [m for m in wire.sent() if isinstance(m, SuspensionSetpoint)] == [replace(SETPOINT, host_ms=5)]
    assert not [m for m in wire.sent() if isinstance(m, SuspensionSetpoint)]


def test_telemetry_carries_the_time_of_its_sample(wire: Wire) -> None:
    wire.introduce()
    board_us = 5_000_000
    for _ in range(8):
        for ping in [m for m in wire.sent() if isinstance(m, Ping)]:
            wire.now_s += 0.003
            board_us += 3000
            up_us, down_us = (12 * 20, 20 * 20)
            wire.say(Pong(0, ping.host_us, board_us - 1000 - down_us, board_us - 500 - down_us))
            assert up_us < 2000
        wire.wait(0.03)
        board_us += 30000
    wire.say(health())
    (event,) = wire.say(replace(WHEELS, t_us=board_us - 8000))
    assert isinstance(event, Telemetry)
    assert event.t_s == pytest.approx(wire.now_s - 0.008, abs=2e-3)


def test_a_sample_is_never_from_the_future(wire: Wire) -> None:
    test_telemetry_carries_the_time_of_its_sample(wire)
    (sampled,) = wire.say(WHEELS)
    assert isinstance(sampled, Telemetry)
    for ahead_us in range(0, 60_000_000, 5_000_000):
        (event,) = wire.say(replace(WHEELS, t_us=5_000_000 + ahead_us))
        assert isinstance(event, Telemetry)
        assert event.t_s <= wire.now_s


def test_pings_come_as_a_burst_and_then_once_a_second(wire: Wire) -> None:
    wire.introduce()
    times = []
    for _ in range(3000):
        times += [wire.now_s] * sum(isinstance(m, Ping) for m in wire.sent())
        wire.say(health())
        wire.wait(0.001)
    pauses = [b - a for a, b in pairwise(times)]
    assert pauses[:7] == pytest.approx([0.03] * 7, abs=2e-3)
    assert pauses[7:] == pytest.approx([0.98] * len(pauses[7:]), abs=2e-3)


def test_an_answer_to_a_ping_of_long_ago_tells_nothing_of_the_clock(wire: Wire) -> None:
    (event,) = wire.introduce()
    assert isinstance(event, Identified)
    first, *_ = [m for m in wire.sent() if isinstance(m, Ping)]
    for _ in range(20):
        wire.wait(0.5)
        wire.say(health())
        wire.sent()
    wire.say(Pong(0, first.host_us, 1_000_000, 1_000_100))
    assert (event.session.clock.accepted, event.session.clock.gated) == (0, 0)


def test_the_way_to_the_nano_counts_both_lines(wire: Wire) -> None:
    (mega,) = wire.introduce(BoardKind.MEGA_SUSPENSION)
    (nano,) = wire.say(reply(BoardKind.NANO_IMU))
    assert isinstance(mega, Identified)
    assert isinstance(nano, Identified)
    for message, way in ((Ping, "wire_up_s"), (Pong, "wire_down_s")):
        line_s = 10 * (message.SIZE + OVERHEAD_BYTES) / 500_000
        assert getattr(mega.session, way) == pytest.approx(line_s)
        second_s = 10 * (message.SIZE + OVERHEAD_BYTES) / BAUD["nano_serial"]
        assert getattr(nano.session, way) == pytest.approx(line_s + second_s)
