"""The decoder's table, transition by transition, and counts against a second implementation."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.native.boards import SpeedBoard
from tiger.protocol.frame import FrameDecoder
from tiger.protocol.messages import FROM_BOARD, BoardKind, WheelSpeed

CYCLE = (0b00, 0b01, 0b11, 0b10)  # A (bit 0) leads B (bit 1)
FRONT, REAR = 0, 1


class Decoder:
    """The board's decoder, fed with pins."""

    def __init__(self) -> None:
        self.board = SpeedBoard(uid=3)
        self.frames = FrameDecoder(FROM_BOARD[BoardKind.MEGA_SPEED])

    def feed(self, *pins: int, channel: int = FRONT) -> None:
        for state in pins:
            self.board.interrupt(channel, state)

    def report(self) -> WheelSpeed:
        self.board.run(20_000)
        messages = [r.message for r in self.frames.feed(self.board.uart_read())]
        return [m for m in messages if isinstance(m, WheelSpeed)][-1]


@pytest.mark.parametrize("start", range(4))
@pytest.mark.parametrize(("steps", "count", "illegal"), [(1, 1, 0), (3, -1, 0), (2, 0, 1), (0, 0, 0)])
def test_every_transition_of_the_table(start: int, steps: int, count: int, illegal: int) -> None:
    decoder = Decoder()
    decoder.feed(*CYCLE[: start + 1])
    before = decoder.report()
    decoder.feed(CYCLE[(start + steps) % 4])
    after = decoder.report()
    assert after.edge_counts[FRONT] - before.edge_counts[FRONT] == count
    assert after.illegal_counts[FRONT] - before.illegal_counts[FRONT] == illegal


@given(st.lists(st.integers(0, 3), max_size=200), st.lists(st.integers(0, 3), max_size=200))
def test_any_sequence_of_pins_counts_as_the_gray_code_says(front: list[int], rear: list[int]) -> None:
    decoder = Decoder()
    expected = []
    for channel, pins in ((FRONT, front), (REAR, rear)):
        decoder.feed(*pins, channel=channel)
        at, count, illegal = 0, 0, 0
        for state in pins:
            moved = (CYCLE.index(state) - at) % 4
            at = CYCLE.index(state)
            count += (0, 1, 0, -1)[moved]
            illegal += moved == 2
        expected.append((count, illegal))
    report = decoder.report()
    assert list(zip(report.edge_counts, report.illegal_counts, strict=True)) == expected


def test_count_and_illegal_count_wrap_without_a_jump() -> None:
    decoder = Decoder()
    for _ in range(40):  # 65536 edges in portions below 32768, one report after each
        decoder.feed(*CYCLE[1:], CYCLE[0], *(CYCLE[1:] + CYCLE[:1]) * 499)
        decoder.report()
    assert decoder.report().edge_counts[FRONT] == 40 * 2000
