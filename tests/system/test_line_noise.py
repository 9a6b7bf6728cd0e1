"""Lines that flip, drop, insert and double one byte in a thousand each, on every framed link."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from tiger.config.robot import load_robot
from tiger.emulation.cable import LineNoise
from tiger.emulation.scenarios import load_scenario
from tiger.native.boards import HOST_PORT, Board
from tiger.protocol import frame
from tiger.protocol.messages import RejectCause, node_of
from tiger.record import DaemonState
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NOISE = 1e-3


class Witness:
    """Keeps every frame a board sent before the line touched it, and checks what the host took for good."""

    def __init__(self, rig: Rig) -> None:
        self.accepted = 0
        self.wrong: list[bytes] = []
        boards = rig.robot.boards
        self._sent = {name: self._watch(board) for name, board in boards.items()}

    def _watch(self, board: Board) -> set[bytes]:
        sent: set[bytes] = set()
        read = board.uart_read
        partial = bytearray()

        def uart_read(port: int = HOST_PORT) -> bytes:
            data = read(port)
            if port == HOST_PORT:
                partial.extend(data)
                *whole, rest = bytes(partial).split(frame.DELIMITER)
                sent.update(chunk for chunk in whole if chunk)
                partial[:] = rest
            return data

        board.uart_read = uart_read  # type: ignore[method-assign]
        return sent

    def check(self, received: frame.Received) -> None:
        """Note a frame that the host accepted and no board sent."""
        self.accepted += 1
        message = received.message
        raw = frame.encode_message(message, received.seq).strip(frame.DELIMITER)
        origins = ("nano_imu",) if node_of(message) == 1 else tuple(n for n in self._sent if n != "nano_imu")
        if not any(raw in self._sent[name] for name in origins):
            self.wrong.append(raw)


@pytest.fixture
def noisy_minutes(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], tuple[Rig, Witness, float]]:
    """Return `run(minutes)`: the shaking plate's first 20 s, then level ground, all over bad lines."""

    def run(minutes: float) -> tuple[Rig, Witness, float]:
        rig = Rig(
            load_robot(None), load_scenario("shaking-plate"), seed=11, noise=LineNoise.everything(NOISE)
        )
        witness = Witness(rig)
        each = frame.FrameDecoder.each

        def watched(self: frame.FrameDecoder, data: bytes) -> Iterator[frame.Received]:
            for one in each(self, data):
                witness.check(one)
                yield one

        monkeypatch.setattr(frame.FrameDecoder, "each", watched)
        rig.daemon.arm(10.0)
        worst_deg = 0.0
        for record in rig.run(60.0 * minutes):
            if rig.time_s > 10.0 and record.tick % 20 == 0:
                truth = rig.robot.truth()
                settled = rig.time_s < 20.0 or rig.time_s > 25.0
                worst_deg = (
                    max(worst_deg, abs(truth.roll_deg), abs(truth.pitch_deg)) if settled else worst_deg
                )
        return rig, witness, worst_deg

    return run


def demand(
    rig: Rig, witness: Witness, worst_deg: float, record_figure: Callable[[str, object, str], None]
) -> None:
    """No wrong value, no crash, level all the time, every rejection counted."""
    links = [port.link for port in rig.daemon.boards.ports.values()]
    host: Counter[RejectCause] = Counter()
    board: Counter[RejectCause] = Counter()
    for link in links:
        assert link is not None
        for cause, count in zip(RejectCause, link.decoder.rejects, strict=True):
            host[cause] += count
        for session in link.sessions.values():
            if session.health is not None:
                for cause, count in zip(RejectCause, session.health.rejects, strict=True):
                    board[cause] += count
    minutes = rig.time_s / 60.0
    record_figure(f"{minutes:.0f} min at {NOISE:g}: bytes damaged", rig.robot.damaged_bytes, "")
    record_figure(
        "frames accepted by the host / wrong", f"{witness.accepted} / {len(witness.wrong)}", "0 wrong"
    )
    record_figure("refused by the host", {cause.name: n for cause, n in host.items()}, "all counted")
    record_figure("refused by the boards", {cause.name: n for cause, n in board.items()}, "all counted")
    record_figure("worst tilt once settled, deg", worst_deg, "0.5")
    assert witness.accepted > 1000 * minutes
    assert not witness.wrong
    assert rig.daemon.state is DaemonState.ARMED, rig.daemon.reason
    assert worst_deg < 0.5
    assert host[RejectCause.CRC] > 0
    assert sum(board.values()) > 0


def test_a_minute_of_bad_lines_lets_no_wrong_value_through(
    noisy_minutes: Callable[[float], tuple[Rig, Witness, float]],
    record_figure: Callable[[str, object, str], None],
) -> None:
    demand(*noisy_minutes(0.75), record_figure)


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_ten_minutes_of_bad_lines_let_no_wrong_value_through(
    noisy_minutes: Callable[[float], tuple[Rig, Witness, float]],
    record_figure: Callable[[str, object, str], None],
) -> None:
    demand(*noisy_minutes(10.0), record_figure)
