"""What a board takes for a frame: every damaged one is refused, no neighbour is lost."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.native.boards import SuspensionBoard
from tiger.protocol.frame import encode, encode_message
from tiger.protocol.messages import Ack, ParamGet, Ping, Pong, RejectCause

FRAME = encode_message(ParamGet(0, 3), 17)
BODY = range(1, len(FRAME) - 1)  # between the delimiters


@pytest.fixture(scope="module")
def line(request):
    """A booted board and a way to hand it bytes: returns answers to ParamGet and Ping."""
    board = SuspensionBoard(uid=9)
    board.set_inputs((500.0,) * 4)
    board.run(300_000)
    wire = request.getfixturevalue("make_wire_once")(board)

    def give(data):
        wire.poll()
        seen = len(wire.received)
        board.uart_write(data)
        board.run(8_000)
        wire.poll()
        return [m for m in wire.received[seen:] if isinstance(m, Ack | Pong)]

    yield give
    board.close()


@pytest.fixture(scope="module")
def make_wire_once():
    from tiger.protocol.frame import FrameDecoder
    from tiger.protocol.messages import FROM_BOARD

    class Reader:
        def __init__(self, board):
            self.board, self.received = board, []
            self.decoder = FrameDecoder(FROM_BOARD[board.KIND])

        def poll(self):
            self.received += [r.message for r in self.decoder.feed(self.board.uart_read())]

    return Reader


def neighbours_survive(line, damaged):
    """A damaged frame between two good ones: only the good ones are answered."""
    before, after = encode_message(Ping(0, 111), 1), encode_message(Ping(0, 222), 2)
    first = line(before)
    second = line(damaged)
    third = line(after)
    assert [m.host_us for m in first] == [111]
    assert second == []
    assert [m.host_us for m in third] == [222]


def test_a_good_frame_is_answered(line):
    assert [(m.id, m.seq) for m in line(FRAME)] == [(ParamGet.ID, 17)]


def test_every_single_flipped_bit_is_found(line):
    for at in BODY:
        for bit in range(8):
            damaged = bytearray(FRAME)
            damaged[at] ^= 1 << bit
            assert line(bytes(damaged)) == [], (at, bit)


def test_every_lost_doubled_or_inserted_byte_is_found(line):
    for at in BODY:
        assert line(FRAME[:at] + FRAME[at + 1 :]) == []
        assert line(FRAME[:at] + FRAME[at : at + 1] + FRAME[at:]) == []
        assert line(FRAME[:at] + b"\x37" + FRAME[at:]) == []


def test_a_lost_delimiter_costs_no_frame(line):
    ping = encode_message(Ping(0, 5), 3)
    assert len(line(FRAME[1:])) == 1  # the first of the two
    assert len(line(FRAME[:-1] + ping)) == 1 + 1


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=90))
def test_any_bytes_leave_the_line_usable(line, data):
    line(b"\0" + data + b"\0")
    assert len(line(encode_message(ParamGet(0, 3), data[0] if data else 1))) == 1


@settings(max_examples=60, deadline=None)
@given(at=st.integers(1, len(FRAME) - 2), burst=st.binary(min_size=2, max_size=6))
def test_a_burst_costs_at_most_the_frame_it_hits(line, at, burst):
    damaged = FRAME[:at] + burst + FRAME[at + len(burst) :]
    if damaged.rstrip(b"\0") != FRAME.rstrip(b"\0") and b"\0" not in damaged.strip(b"\0"):
        neighbours_survive(line, damaged + b"\0")


@pytest.mark.parametrize("size", [0, 1, 3, 47, 48, 49, 100])
def test_a_known_id_of_another_size_is_refused(rig, size):
    before = rig.health().rejects
    rig.board.uart_write(encode(ParamGet.ID, 0, b"\x01" * size))
    rig.run_ms(20)
    after = rig.health().rejects
    gained = [b - a for a, b in zip(before, after, strict=True)]
    cause = RejectCause.LENGTH if size > 48 else RejectCause.SIZE
    assert gained[cause] == 1
    assert sum(gained) == 1
