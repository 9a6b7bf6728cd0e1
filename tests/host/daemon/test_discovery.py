"""Who sits on which port: found by HELLO, each role once, other people's ports left alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import pytest

from tiger.config.robot import load_robot
from tiger.daemon.discovery import ANSWER_TIME_S, BAUDS, GRACE_S, Boards, Role
from tiger.protocol.frame import encode_message
from tiger.protocol.messages import PROTO, SCHEMA_HASH, BoardKind, BoardState, Health, HelloReply

LEFT: Role = (BoardKind.MEGA_SPEED, 0)
RIGHT: Role = (BoardKind.MEGA_SPEED, 1)
NEEDED = (RIGHT, LEFT)
STEP_S = 0.05


@dataclass
class FakeBoard:
    """A board that introduces itself and then reports its health; None: a device of someone else."""

    role: Role | None
    uid: int = 1
    schema_change: int = 0
    baud: int = BAUDS[0]


@dataclass
class FakePort:
    """The line to a board, heard at one baud rate only."""

    board: FakeBoard
    baud: int
    backlog: int = 0
    seq: int = 0
    unplugged: bool = False
    written: bytes = b""

    def read(self) -> bytes:
        if self.unplugged:
            raise OSError(5, "Input/output error")
        if self.board.role is None or self.baud != self.board.baud:
            return b""
        kind, instance = self.board.role
        who = HelloReply(
            *(PROTO, 0, kind, instance, self.board.uid, SCHEMA_HASH[kind] ^ self.board.schema_change),
            *((1, 0, 0), 0, 0, 1, 3, 0, 5000, 0, 1),
        )
        health = Health(0, BoardState.DISARMED, 0, 255, 100, 200, 0, (0,) * 6, 0, 0, 500, 5000, 20)
        self.seq += 1
        return encode_message(health if self.seq > 1 else who, self.seq)

    def write(self, data: bytes) -> None:
        self.written += data

    def close(self) -> None:
        pass


@dataclass
class Computer:
    """What is plugged in where, and which ports were opened at which baud rates."""

    boards: dict[str, FakeBoard]
    hidden: set[str] = field(default_factory=set)
    opened: list[tuple[str, int]] = field(default_factory=list)
    ports: dict[str, FakePort] = field(default_factory=dict)

    def present(self, patterns: Iterable[str]) -> list[str]:
        return [path for path in self.boards if path not in self.hidden]

    def same(self, path: str, other: str) -> bool:
        return path == "/dev/ttyUSB9" and other == "/dev/tiger-roboteq-right"

    def open(self, path: str, baud: int) -> FakePort:
        if path not in self.boards:
            raise FileNotFoundError(2, "No such file or directory", path)
        self.opened.append((path, baud))
        self.ports[path] = FakePort(self.boards[path], baud)
        return self.ports[path]


@dataclass
class Search:
    """The daemon's look for its boards, in emulated time."""

    computer: Computer
    now_s: float = 0.0

    def __post_init__(self) -> None:
        self.found = Boards(self.computer, load_robot().ports, NEEDED, 99, self.now_s)  # type: ignore[arg-type]

    def run(self, seconds: float) -> Boards:
        for _ in range(round(seconds / STEP_S)):
            self.found.step(self.now_s)
            list(self.found.receive(self.now_s))
            list(self.found.poll(self.now_s))
            self.found.send(self.now_s)
            self.now_s += STEP_S
        return self.found


def both(**more: FakeBoard) -> Computer:
    boards = {"/dev/a": FakeBoard(LEFT, 1), "/dev/b": FakeBoard(RIGHT, 2)}
    return Computer(boards | {f"/dev/{name}": board for name, board in more.items()})


def test_each_board_is_found_in_its_role_and_the_crew_is_in_the_order_needed() -> None:
    found = Search(both()).run(1.0)
    assert found.complete
    assert [session.port for session in found.crew] == ["/dev/b", "/dev/a"]
    assert found.session(LEFT) is found.crew[1]
    assert found.link(LEFT) is found.ports["/dev/a"].link
    assert found.problems(100.0) == []


def test_a_role_that_is_there_twice_is_nobodys_until_one_is_unplugged() -> None:
    search = Search(both(c=FakeBoard(LEFT, 3)))
    found = search.run(1.0)
    assert not found.complete
    assert found.session(LEFT) is None
    assert found.session(RIGHT) is not None
    (problem,) = found.problems(search.now_s)
    assert "is there twice: /dev/a and /dev/c" in str(problem)
    search.computer.hidden.add("/dev/c")
    search.computer.ports["/dev/c"].unplugged = True
    search.run(5.0)
    assert found.complete
    assert list(found.ports) == ["/dev/a", "/dev/b"]


def test_a_board_of_another_schema_has_no_role() -> None:
    search = Search(both())
    search.computer.boards["/dev/a"] = FakeBoard(LEFT, 1, schema_change=1)
    found = search.run(1.0)
    assert not found.complete
    assert found.session(LEFT) is None
    assert len(found.crew) == 1


def test_the_ports_of_the_roboteqs_are_never_opened() -> None:
    search = Search(both(ttyUSB9=FakeBoard(None)))
    search.run(6.0)
    assert search.found.complete
    assert "/dev/ttyUSB9" not in dict(search.computer.opened)


def test_a_silent_port_is_tried_at_each_baud_rate_and_then_named() -> None:
    search = Search(both(c=FakeBoard(None)))
    search.computer.boards["/dev/b"] = FakeBoard(RIGHT, 2, baud=BAUDS[1])
    assert len(BAUDS) == 2
    found = search.run(ANSWER_TIME_S - 2 * STEP_S)
    assert [baud for path, baud in search.computer.opened if path == "/dev/c"] == [BAUDS[0]]
    search.run(ANSWER_TIME_S)
    assert [baud for path, baud in search.computer.opened if path == "/dev/c"] == list(BAUDS)
    assert found.complete  # /dev/b has answered at the other rate
    assert found.ports["/dev/c"].problem() is None
    search.run(8 * STEP_S)
    assert "answers HELLO" in str(found.ports["/dev/c"].problem())


def test_a_missing_board_is_named_after_a_time_of_grace_and_found_when_plugged_in() -> None:
    search = Search(Computer({"/dev/a": FakeBoard(LEFT, 1)}))
    found = search.run(GRACE_S)
    assert found.problems(GRACE_S - 0.01) == []
    (problem,) = found.problems(GRACE_S)
    assert "mega_speed (right)" in str(problem)
    search.computer.boards["/dev/b"] = FakeBoard(RIGHT, 2)
    search.run(0.7)  # a look each half second while one is missing
    assert found.complete


def test_an_open_port_is_kept_though_the_list_forgets_it() -> None:
    search = Search(both())
    found = search.run(1.0)
    link = found.link(LEFT)
    search.computer.hidden.add("/dev/a")
    search.run(5.0)
    assert found.complete
    assert found.link(LEFT) is link


def test_nothing_new_is_said_on_a_line_that_still_holds_the_old() -> None:
    search = Search(both())
    search.run(1.0)
    port = search.computer.ports["/dev/a"]
    port.backlog, port.written = 10, b""
    search.run(3.0)
    assert port.written == b""
    port.backlog = 0
    search.run(3.0)
    assert port.written


@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_a_board_that_was_replugged_elsewhere_keeps_its_role(seconds: float) -> None:
    search = Search(both())
    found = search.run(seconds)
    search.computer.ports["/dev/a"].unplugged = True
    moved = replace(search.computer.boards.pop("/dev/a"))
    search.run(0.2)
    assert found.session(LEFT) is None
    search.computer.boards["/dev/z"] = moved
    search.run(2.5)
    assert found.complete
    assert found.crew[1].port == "/dev/z"
