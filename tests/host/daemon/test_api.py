"""The local socket: what programs may ask for, who may, and what nobody can do to the loop."""

from __future__ import annotations

import json
import math
import os
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.robot import RobotConfig, load_robot
from tiger.control.reachable import Suspension
from tiger.daemon import api as api_module
from tiger.daemon.api import (
    DRIVE_LIFE_S,
    MAX_CLIENTS,
    MAX_LINE_BYTES,
    REQUESTS_AT_ONCE,
    REQUESTS_PER_S,
    Api,
    ApiError,
    Desk,
    Moment,
    Session,
)
from tiger.daemon.api_messages import REQUEST, DriveRequest, Refusal, StatusReply, Telemetry
from tiger.daemon.client import Refused, Robot, socket_path
from tiger.daemon.overview import DriveEnergy
from tiger.emulation.scenarios import load_scenario
from tiger.record import STILL, Command, DaemonState, Inputs, Mode, Outputs, Record
from tiger.rig.virtual import Rig

ROBOT = load_robot(None)


def line(do: str, request_id: int | str = 1, **fields: Any) -> bytes:
    return json.dumps({"id": request_id, "do": do, **fields}).encode() + b"\n"


# ------------------------------------------------------------------------------------- bytes of one client


def fed(data: bytes) -> list[Any]:
    return Session(0.0).feed(data, 0.0)


@pytest.mark.parametrize(
    "cut", [1, 5, 17, 38], ids=["after 1 byte", "after 5", "in the middle", "before the end of line"]
)
def test_a_request_in_pieces_is_one_request(cut: int) -> None:
    text = line("drive", speed_mps=0.5)[:39] + line("drive", speed_mps=0.5)[39:]
    session = Session(0.0)
    found = session.feed(text[:cut], 0.0) + session.feed(text[cut:], 0.0)
    assert found == [DriveRequest(id=1, do="drive", speed_mps=0.5)]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"", "Invalid JSON"),
        (b"forward!", "Invalid JSON"),
        (b"[1, 2]", "should be an object"),
        (b'{"id": 1, "do": "drive", "speed_mps": 0.1', "Invalid JSON"),
        (b"\xff\xfe\x00", "Invalid JSON"),
        (b"[" * 1000, "recursion limit"),
        (b'{"id": 1}', "Unable to extract tag"),
        (b'{"do": "estop"}', "id: Field required"),
        (b'{"id": 1.5, "do": "estop"}', "id: Input should be a valid"),
        (b'{"id": true, "do": "estop"}', "id: Input should be a valid"),
        (b'{"id": 1, "do": "fly"}', "Input tag 'fly'"),
        (b'{"id": 1, "do": "drive"}', "speed_mps: Field required"),
        (b'{"id": 1, "do": "drive", "speed_mps": "1"}', "speed_mps: Input should be a valid number"),
        (b'{"id": 1, "do": "drive", "speed_mps": true}', "speed_mps: Input should be a valid number"),
        (b'{"id": 1, "do": "drive", "speed_mps": NaN}', "speed_mps: Input should be a finite number"),
        (b'{"id": 1, "do": "drive", "speed_mps": Infinity}', "speed_mps: Input should be a finite number"),
        (b'{"id": 1, "do": "drive", "speed_mps": 1e999}', "speed_mps: Input should be a finite number"),
        (b'{"id": 1, "do": "drive", "speed_mps": 0, "sped": 1}', "sped: Extra inputs are not permitted"),
        (b'{"id": 1, "do": "mode", "mode": "jump"}', "mode: Input should be 'hold', 'level', "),
        (b'{"id": 1, "do": "subscribe", "rate_hz": 21}', "rate_hz: Input should be less than or equal to 20"),
    ],
)
def test_what_is_no_request_is_refused_with_a_reason_and_a_next_step(text: bytes, reason: str) -> None:
    (refusal,) = fed(text + b"\n")
    assert isinstance(refusal, Refusal)
    assert reason in refusal.reason
    assert refusal.next_step.endswith("docs/api.md lists every request.")
    assert not refusal.closing


def test_a_refusal_carries_the_id_wherever_it_can_be_read() -> None:
    assert fed(b'{"id": "abc", "do": "fly"}\n')[0].id == "abc"
    assert fed(b'{"id": 7, "do": "drive"}\n')[0].id == 7
    assert fed(b'{"id": [7], "do": "drive"}\n')[0].id is None
    assert fed(b"{\n")[0].id is None


def test_one_bad_line_spoils_no_other() -> None:
    found = fed(b"nonsense\n" + line("status", 2))
    assert [type(item) is Refusal for item in found] == [True, False]


@pytest.mark.parametrize("extra", [0, 1])
@pytest.mark.parametrize("ending", [b"", b"\n"])
def test_a_line_over_the_limit_ends_the_connection(extra: int, ending: bytes) -> None:
    session = Session(0.0)
    session.feed(b" " * (MAX_LINE_BYTES + extra) + ending, 0.0)
    assert (session.closing is not None) == bool(extra)
    if session.closing:
        assert "1024 bytes" in session.closing.reason
        assert session.feed(line("estop"), 1.0) == []


def test_a_flood_ends_the_connection_and_the_allowed_rate_does_not() -> None:
    period_s = 1.0 / REQUESTS_PER_S
    steady, flood = Session(0.0), Session(0.0)
    answered = 0
    for n in range(1000):
        assert len(steady.feed(line("status"), (n + 1) * period_s)) == 1
        answered += len(flood.feed(line("status"), (n + 1) * period_s / 2))
    assert steady.closing is None
    assert flood.closing is not None
    assert "more than 250 requests a second" in flood.closing.reason
    assert answered <= 2 * REQUESTS_AT_ONCE + 1


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_no_bytes_break_a_session_and_what_they_mean_does_not_depend_on_their_cutting(
    chunks: list[bytes],
) -> None:
    session, whole = Session(0.0), Session(0.0)
    found = [item for chunk in chunks for item in session.feed(chunk, 0.0)]
    for refusal in found:
        assert isinstance(refusal, Refusal)
        assert json.loads(refusal.model_dump_json())["reason"]
    at_once = whole.feed(b"".join(chunks), 0.0)
    if session.closing is None and whole.closing is None:
        assert found == at_once


NAMES = st.sampled_from(["id", "do", "mode", "speed_mps", "yaw_rate_radps", "roll_rad", "ride_stroke_mm"])
WORDS = ["drive", "arm", "pose", "mode", "level", 1, 10**400, -(10**400), 1e308, [], {}, [[{}]]]
VALUES = st.none() | st.booleans() | st.floats() | st.integers() | st.sampled_from(WORDS)


@given(st.dictionaries(NAMES, VALUES))
def test_any_object_is_a_valid_request_of_finite_numbers_or_is_refused(fields: dict[str, Any]) -> None:
    text = json.dumps(fields).encode()
    for item in fed(text + b"\n"):
        if isinstance(item, Refusal):
            json.loads(item.model_dump_json())
            continue
        assert item.do == fields["do"]
        numbers = [value for value in item.model_dump().values() if isinstance(value, float)]
        assert all(map(math.isfinite, numbers))


# ------------------------------------------------------------------------------- what is done, and for whom


def record(state: DaemonState = DaemonState.ARMED, tick: int = 0) -> Record:
    return Record(tick, state, "because", Inputs(0.0, state is DaemonState.ARMED), Outputs())


@pytest.fixture(autouse=True, scope="module")
def mechanism_solved_once() -> Iterator[None]:
    """Solving the mechanism takes a tenth of a second, and all robots here have the same."""
    suspension = Suspension.from_config(ROBOT)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Suspension, "from_config", lambda robot: suspension)
        yield


class Asked:
    """A desk and a daemon that only notes what it is told."""

    def __init__(self, robot: RobotConfig = ROBOT) -> None:
        self.desk = Desk(robot)
        self.told: list[str] = []
        tell = self.told.append
        self.daemon: Any = SimpleNamespace(
            state=DaemonState.ARMED,
            reason="armed",
            latched=(),
            log_lines=[],
            energy=DriveEnergy(),
            command=Command(),
            **{word: lambda word=word: tell(word) for word in ("arm", "disarm", "estop", "clear")},
        )

    def ask(self, do: str, client: str = "one", now_s: float = 0.0, **fields: Any) -> Any:
        request = REQUEST.validate_json(line(do, **fields))
        return self.desk.carry_out(request, Moment(client, self.daemon, record(self.daemon.state), now_s))

    @property
    def speeds(self) -> tuple[float, float]:
        return self.daemon.command.speed_mps, self.daemon.command.yaw_rate_radps


@pytest.mark.parametrize("do", ["arm", "disarm", "estop", "clear"])
def test_each_of_the_four_words_reaches_the_daemon(do: str) -> None:
    asked = Asked()
    asked.daemon.state = DaemonState.DISARMED
    assert asked.ask(do).ok
    assert asked.told == [do]


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_can_be_asked_for_and_keeps_speed_and_height(mode: Mode) -> None:
    asked = Asked()
    asked.daemon.command = Command(speed_mps=0.2, roll_rad=0.1, ride_stroke_mm=40.0)
    assert asked.ask("mode", mode=mode.value).ok
    assert asked.daemon.command == Command(mode, speed_mps=0.2, ride_stroke_mm=40.0)


def test_a_pose_sets_what_it_names() -> None:
    asked = Asked()
    assert asked.ask("pose", roll_rad=0.05, pitch_rad=-0.02, ride_stroke_mm=30.0).text == "mode pose"
    assert asked.daemon.command == Command(Mode.POSE, 0.05, -0.02, 30.0)
    asked.ask("pose", roll_rad=0.01)
    assert asked.daemon.command == Command(Mode.POSE, 0.01, 0.0, 30.0)
    asked.ask("ride_height", ride_stroke_mm=None)
    assert asked.daemon.command == Command(Mode.POSE, 0.01, 0.0, None)


def with_reach(choice: str) -> RobotConfig:
    leveling = ROBOT.leveling.model_copy(update={"out_of_reach": choice})
    return ROBOT.model_copy(update={"leveling": leveling})


def test_a_pose_beyond_the_strokes_is_clipped_or_refused_as_the_config_says() -> None:
    corner = {"roll_rad": math.radians(14.0), "pitch_rad": math.radians(14.0)}
    clip, refuse = Asked(with_reach("clip")), Asked(with_reach("refuse"))
    accepted, refused = clip.ask("pose", **corner), refuse.ask("pose", **corner)
    assert "clipped to what the strokes reach: roll" in accepted.text
    assert 0.0 < clip.daemon.command.roll_rad < corner["roll_rad"]
    assert "the strokes do not reach this attitude" in refused.reason
    assert "|roll|/6.3 + |pitch|/7.6 up to 1" in accepted.text
    assert "|roll|/6.3 + |pitch|/7.6 up to 1" in refused.next_step
    assert refuse.daemon.command == Command()


def test_a_ride_height_that_the_attitude_does_not_leave_is_said() -> None:
    high = ROBOT.stroke_range_mm[1]
    assert "gives way" in Asked().ask("pose", roll_rad=0.1, ride_stroke_mm=high).text
    assert "gives way" not in Asked().ask("pose", ride_stroke_mm=high).text


LIMITED = {
    "speed_mps": ("drive", ROBOT.drive.max_speed_mps),
    "yaw_rate_radps": ("drive", math.radians(ROBOT.drive.max_yaw_rate_degps)),
    "roll_rad": ("pose", math.radians(ROBOT.leveling.max_angle_deg)),
    "pitch_rad": ("pose", math.radians(ROBOT.leveling.max_angle_deg)),
    "ride_stroke_mm": ("ride_height", ROBOT.stroke_range_mm[1]),
}


@pytest.mark.parametrize("name", LIMITED)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_values_up_to_the_limit_of_the_config_are_taken_and_none_beyond(name: str, sign: float) -> None:
    do, most = LIMITED[name]
    if name == "ride_stroke_mm" and sign < 0.0:
        most = -ROBOT.stroke_range_mm[0]
    fields = {"speed_mps": 0.0} if do == "drive" else {}
    asked = Asked()
    refusal = asked.ask(do, **{**fields, name: sign * most + sign * 1e-6})
    assert not refusal.ok
    assert f"{name} = " in refusal.reason
    assert asked.daemon.command == Command()
    assert asked.desk.helm is None
    assert asked.ask(do, **{**fields, name: sign * most}).ok


@pytest.mark.parametrize("state", [state for state in DaemonState if state is not DaemonState.ARMED])
def test_only_an_armed_robot_drives(state: DaemonState) -> None:
    asked = Asked()
    asked.daemon.state = state
    refusal = asked.ask("drive", speed_mps=0.1)
    assert (state.name in refusal.reason, refusal.next_step) == (True, "Arm it first.")
    assert asked.speeds == (0.0, 0.0)


def test_a_robot_without_a_drive_says_so() -> None:
    drive = ROBOT.drive.model_copy(update={"enabled": False})
    assert "no drive" in Asked(ROBOT.model_copy(update={"drive": drive})).ask("drive", speed_mps=0.1).reason


@pytest.mark.parametrize("state", [DaemonState.FAULT, DaemonState.ESTOP])
def test_a_stopped_robot_is_not_armed_before_it_is_cleared(state: DaemonState) -> None:
    asked = Asked()
    asked.daemon.state = state
    assert state.name in asked.ask("arm").reason
    assert asked.told == []


def test_a_drive_command_lives_half_a_second() -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5, yaw_rate_radps=0.1, now_s=1.0)
    asked.desk.tick(asked.daemon, 1.0 + DRIVE_LIFE_S)
    assert asked.speeds == (0.5, 0.1)
    asked.desk.tick(asked.daemon, 1.0 + DRIVE_LIFE_S + 1e-6)
    assert asked.speeds == (0.0, 0.0)
    assert asked.desk.helm is None


def test_other_requests_keep_the_helm_but_not_the_speed() -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5, now_s=0.0)
    asked.ask("mode", mode="hold", now_s=0.4)
    asked.desk.tick(asked.daemon, 0.6)
    assert asked.speeds == (0.0, 0.0)
    assert asked.desk.helm == "one"


HELM = [
    ("arm", {}),
    ("clear", {}),
    ("mode", {"mode": "stow"}),
    ("pose", {"roll_rad": 0.1}),
    ("ride_height", {"ride_stroke_mm": 20.0}),
    ("drive", {"speed_mps": -1.0}),
]


@pytest.mark.parametrize(("do", "fields"), HELM, ids=[do for do, _ in HELM])
def test_a_second_master_is_refused_until_the_first_releases_or_is_silent(
    do: str, fields: dict[str, Any]
) -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5)
    before = asked.daemon.command
    refusal = asked.ask(do, "two", now_s=0.1, **fields)
    assert refusal.reason == "one has the helm"
    assert "0.5 s" in refusal.next_step
    assert (asked.daemon.command, asked.told) == (before, [])
    asked.ask("release", "two", now_s=0.1)  # not yours to release
    assert asked.desk.helm == "one"
    asked.ask("release", "one", now_s=0.2)
    assert asked.speeds == (0.0, 0.0)
    assert asked.ask(do, "two", now_s=0.2, **fields).ok


def test_refused_requests_do_not_keep_the_helm() -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5, now_s=0.0)
    asked.ask("drive", speed_mps=99.0, now_s=0.4)
    asked.desk.tick(asked.daemon, 0.51)
    assert asked.desk.helm is None


@pytest.mark.parametrize("do", ["estop", "disarm", "status", "subscribe"])
def test_anyone_may_stop_it_and_look(do: str) -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5)
    assert asked.ask(do, "two").ok
    if do in ("estop", "disarm"):
        assert asked.told == [do]
        assert asked.speeds == (0.0, 0.0)


def test_what_stopped_does_not_drive_again_after_arming() -> None:
    asked = Asked()
    asked.ask("drive", speed_mps=0.5, now_s=0.0)
    asked.daemon.state = DaemonState.FAULT
    asked.desk.tick(asked.daemon, 0.01)
    asked.daemon.state = DaemonState.ARMED
    asked.desk.tick(asked.daemon, 0.02)
    assert asked.speeds == (0.0, 0.0)


def test_a_reserved_helm_stays_and_its_speed_is_left_alone() -> None:
    asked = Asked()
    asked.desk.reserve("tiger run --speed")
    asked.daemon.command = Command(speed_mps=1.0)
    asked.desk.tick(asked.daemon, 1e6)
    assert asked.ask("drive", speed_mps=0.1, now_s=1e6).reason == "tiger run --speed has the helm"
    assert asked.ask("estop", now_s=1e6).ok
    assert asked.speeds == (1.0, 0.0)


# ----------------------------------------------------------------------------------------------- real sockets


class Served:
    """An API on a daemon that only ticks; real sockets, a clock that the test moves."""

    def __init__(self, folder: Path) -> None:
        self.api = Api(ROBOT, folder / "private" / "robot.sock")
        self.asked = Asked()
        self.daemon = self.asked.daemon
        self.now_s, self.tick = 0.0, 0

    def ticks(self, count: int = 1) -> None:
        for _ in range(count):
            self.now_s += 0.005
            self.tick += 1
            self.api.poll(self.daemon, record(self.daemon.state, self.tick), self.now_s)

    def connect(self) -> socket.socket:
        client = socket.socket(socket.AF_UNIX)
        client.settimeout(2.0)
        client.connect(str(self.api.path))
        self.ticks()
        return client

    def ask(self, client: socket.socket, data: bytes) -> list[dict[str, Any]]:
        client.sendall(data)
        self.ticks()
        return lines_of(client.recv(1 << 20))


def lines_of(data: bytes) -> list[dict[str, Any]]:
    return [json.loads(text) for text in data.splitlines()]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    found = Served(tmp_path)
    yield found
    found.api.close(found.daemon)


def test_only_the_owner_may_reach_the_socket(served: Served) -> None:
    path = served.api.path
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_a_folder_that_others_may_enter_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "open"
    folder.mkdir(mode=0o755)
    with pytest.raises(ApiError, match=r"mode 0755\); chmod 700 it"):
        Api(ROBOT, folder / "robot.sock")
    (tmp_path / "private").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "private")
    with pytest.raises(ApiError, match="no folder of this user alone"):
        Api(ROBOT, tmp_path / "link" / "robot.sock")


def test_a_path_that_cannot_be_listened_on_is_named(tmp_path: Path) -> None:
    with pytest.raises(ApiError, match=r"cannot listen there \(AF_UNIX path too long\)"):
        Api(ROBOT, tmp_path / "private" / ("x" * 120))
    in_the_way = tmp_path / "private" / "robot.sock"
    in_the_way.write_text("mine")
    with pytest.raises(ApiError, match="Address already in use"):
        Api(ROBOT, in_the_way)
    assert in_the_way.read_text() == "mine"


def test_a_second_daemon_is_refused_and_the_first_goes_on(served: Served) -> None:
    with pytest.raises(ApiError, match="another daemon listens there; stop it"):
        Api(ROBOT, served.api.path)
    with served.connect() as client:
        assert served.ask(client, line("status"))[0]["ok"]


def test_a_socket_left_behind_by_a_killed_daemon_is_taken_over(tmp_path: Path) -> None:
    path = tmp_path / "private" / "robot.sock"
    script = (
        "import os, sys; from pathlib import Path\n"
        "from tiger.config.robot import load_robot\n"
        "from tiger.daemon.api import Api\n"
        "api = Api(load_robot(None), Path(sys.argv[1])); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    assert path.is_socket()
    found = Served(tmp_path)
    with found.connect() as client:
        assert found.ask(client, line("status"))[0]["ok"]
    found.api.close(found.daemon)
    assert not path.exists()


def test_status_tells_everything_and_fits_its_model(served: Served) -> None:
    with served.connect() as client:
        (answer,) = served.ask(client, line("status", "x"))
    reply = StatusReply.model_validate(answer)
    assert (reply.id, reply.status.state, reply.status.helm) == ("x", "ARMED", None)
    assert reply.limits["speed_mps"] == (-3.0, 3.0)
    assert reply.status.record == record(DaemonState.ARMED, reply.status.record.tick)


def test_answers_come_in_the_order_of_the_requests(served: Served) -> None:
    with served.connect() as client:
        answers = served.ask(client, line("estop", 1) + b"{}\n" + line("disarm", 3))
    assert [answer["id"] for answer in answers] == [1, None, 3]


def test_a_master_that_hangs_up_stops_the_robot_at_once(served: Served) -> None:
    client = served.connect()
    assert served.ask(client, line("drive", speed_mps=0.5))[0]["ok"]
    client.close()
    served.ticks()
    assert served.asked.speeds == (0.0, 0.0)
    assert served.api.desk.helm is None


def test_a_silent_master_stops_the_robot_after_half_a_second(served: Served) -> None:
    with served.connect() as client:
        served.ask(client, line("drive", speed_mps=0.5))
        served.ticks(99)
        assert served.asked.speeds == (0.5, 0.0)
        served.ticks(2)
        assert served.asked.speeds == (0.0, 0.0)


def test_two_masters_on_two_connections(served: Served) -> None:
    with served.connect() as one, served.connect() as two:
        assert served.ask(one, line("drive", speed_mps=0.5))[0]["ok"]
        (refusal,) = served.ask(two, line("drive", speed_mps=-0.5))
        assert f"client 1 (process {os.getpid()}) has the helm" == refusal["reason"]
        assert served.asked.speeds == (0.5, 0.0)


HOSTILE: dict[str, Callable[[], bytes]] = {
    "flood": lambda: line("drive", speed_mps=1.0) * 500,
    "oversized": lambda: b"x" * 5000,
    "flood of nonsense": lambda: b"\n" * 1000,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_client_is_told_why_and_hung_up_on(served: Served, name: str) -> None:
    served.daemon.state = DaemonState.DISARMED
    with served.connect() as hostile, served.connect() as other:
        hostile.sendall(HOSTILE[name]())
        served.ticks(20)
        received = b""
        try:
            while data := hostile.recv(65536):
                received += data
        except ConnectionResetError:  # it had more to say
            pass
        last = lines_of(received)[-1]
        assert last["closing"]
        assert last["reason"] in served.api.desk.notes[-1]
        assert served.asked.daemon.command == Command()
        assert served.ask(other, line("status"))[0]["ok"]


def test_one_client_too_many_is_told_so(served: Served) -> None:
    clients = [served.connect() for _ in range(MAX_CLIENTS)]
    with served.connect() as late:
        (goodbye,) = lines_of(late.recv(65536))
        assert goodbye["reason"] == f"there are {MAX_CLIENTS} clients already"
    assert served.ask(clients[0], line("status"))[0]["ok"]
    clients.pop().close()
    served.ticks()
    with served.connect() as again:
        assert served.ask(again, line("status"))[0]["ok"]
    for client in clients:
        client.close()


def test_telemetry_comes_at_the_rate_asked_for(served: Served) -> None:
    with served.connect() as client:
        served.ask(client, line("subscribe", rate_hz=20.0))
        rows = []
        for _ in range(20):
            served.ticks(10)
            rows += [Telemetry.model_validate(row) for row in lines_of(client.recv(65536))]
        ticks = [row.telemetry.record.tick for row in rows]
        assert [later - earlier for earlier, later in pairwise(ticks)] == [10] * 19
        served.ask(client, line("subscribe", rate_hz=0.0))
        served.ticks(100)
        client.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            client.recv(1)


def test_a_subscriber_that_does_not_read_loses_telemetry_and_nobody_waits(served: Served) -> None:
    with served.connect() as slow, served.connect() as quick:
        for client in (slow, quick):
            served.ask(client, line("subscribe", rate_hz=20.0))
        received = 0
        for _ in range(400):
            served.ticks(10)
            received += quick.recv(65536).count(b"\n")
        assert received == 400
        rows = lines_of_slow(served, slow)
    dropped = rows[-1]["dropped"]
    assert dropped > 200
    assert rows[0]["dropped"] == 0


def lines_of_slow(served: Served, client: socket.socket) -> list[dict[str, Any]]:
    """Read all that waits, then the next telemetry."""
    data = b""
    client.settimeout(0.0)
    for _ in range(40):
        try:
            data += client.recv(1 << 20)
        except BlockingIOError:
            served.ticks(1)
    return lines_of(data[: data.rindex(b"\n")])


def test_a_client_that_fetches_no_answers_is_hung_up_on(served: Served) -> None:
    with served.connect() as client:
        for _ in range(400):
            try:
                client.sendall(line("status"))
            except BrokenPipeError:
                break
            served.ticks()
        assert "bytes of answers were not read" in served.api.desk.notes[-1]


def test_closing_stops_what_clients_drove(tmp_path: Path) -> None:
    served = Served(tmp_path)
    with served.connect() as client:
        served.ask(client, line("drive", speed_mps=0.5))
        served.api.close(served.daemon)
        assert served.asked.speeds == (0.0, 0.0)
        assert client.recv(10) == b""
    assert not served.api.path.exists()


def test_without_a_client_a_tick_costs_5_us_at_most(served: Served) -> None:
    nothing = record()
    best_s = math.inf
    for _ in range(20):
        start_s = time.perf_counter()
        for _ in range(200):
            served.api.poll(served.daemon, nothing, 0.0)
        best_s = min(best_s, (time.perf_counter() - start_s) / 200)
    assert best_s <= 5e-6


# ------------------------------------------------------------------- the real daemon on the emulated robot


class Live:
    """A rig whose socket is served by a thread that lets virtual time pass while a client waits."""

    def __init__(self, folder: Path) -> None:
        self.rig = Rig(ROBOT, load_scenario("shaking-plate"))
        self.api = Api(self.rig.config, folder / "private" / "robot.sock")
        self.records: list[Record] = []
        self._stop = False
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._stop:
            self.run(0.005)
            time.sleep(0.0002)

    def run(self, seconds: float) -> None:
        for found in self.rig.run(seconds):
            self.records.append(found)
            self.api.poll(self.rig.daemon, found, self.rig.time_s)

    def __enter__(self) -> Live:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop = True
        self._thread.join()
        self.api.close(self.rig.daemon)
        self.rig.daemon.close()


def wait_for(robot: Robot, state: str) -> dict[str, Any]:
    for _ in range(20_000):
        status = robot.ask("status")["status"]
        if status["state"] == state:
            return status
    raise AssertionError(f"never {state}: {status['state']}, {status['record']['problems']}")


def test_a_program_arms_poses_drives_and_stops_the_robot(tmp_path: Path) -> None:
    with Live(tmp_path) as live, Robot(live.api.path) as robot, Robot(live.api.path) as bystander:
        wait_for(robot, "DISARMED")
        with pytest.raises(Refused, match=r"DISARMED.*Arm it first\."):
            robot.ask("drive", speed_mps=0.3)
        while wait_for(robot, "DISARMED")["record"]["inputs"]["now_s"] < 3.5:
            pass
        robot.ask("arm")
        wait_for(robot, "ARMED")
        robot.ask("mode", mode="hold")
        slowest_radps = 0.0
        for _ in range(600):
            robot.ask("drive", speed_mps=0.3)
            inputs = robot.ask("status")["status"]["record"]["inputs"]
            wheels = inputs["wheels_left"]["speed_radps"] + inputs["wheels_right"]["speed_radps"]
            slowest_radps = min(wheels)
            if slowest_radps > 1.0:
                break
        assert slowest_radps > 1.0
        bystander.ask("estop")
        status = wait_for(robot, "ESTOP")
        assert status["record"]["outputs"]["wheel_rpm"] == list(STILL)
        assert status["record"]["inputs"]["command"]["speed_mps"] == 0.0
        with pytest.raises(Refused, match="Make it safe, then clear"):
            robot.ask("arm")
        robot.ask("clear")
        wait_for(robot, "DISARMED")
    assert not any(any(r.outputs.wheel_rpm) for r in live.records if r.state is not DaemonState.ARMED)


def test_nothing_that_is_refused_moves_the_robot(tmp_path: Path) -> None:
    with Live(tmp_path) as live:
        with Robot(live.api.path) as robot:
            for do, fields in (("drive", {"speed_mps": 9.0}), ("fly", {}), ("pose", {"roll_rad": "much"})):
                with pytest.raises(Refused):
                    robot.ask(do, **fields)
        client = socket.socket(socket.AF_UNIX)
        client.connect(str(live.api.path))
        client.sendall(b'{"id":1,"do":"drive","speed_mps":1}\n' * 200)
        time.sleep(0.1)
        client.close()
    assert all(r.outputs.wheel_rpm == STILL == r.outputs.stroke_rate_mmps for r in live.records)
    assert live.rig.daemon.command == Command()


# ----------------------------------------------------------------------------------------------- the client


def test_the_client_finds_the_socket_where_the_daemon_puts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TIGER_SOCKET", "/run/tiger/robot.sock")
    assert socket_path() == Path("/run/tiger/robot.sock")
    monkeypatch.delenv("TIGER_SOCKET")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert socket_path() == Path("/run/user/7/tiger/robot.sock")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert socket_path().parent.name.startswith("tiger-")


def test_the_client_needs_nothing_but_the_standard_library() -> None:
    source = Path(api_module.__file__).with_name("client.py").read_text()
    script = (
        "import sys, pathlib; before = set(sys.modules)\n"
        f"exec(compile({source!r}, 'client.py', 'exec'))\n"
        "names = {name.partition('.')[0] for name in set(sys.modules) - before}\n"
        "sys.exit(str(names - sys.stdlib_module_names) if names - sys.stdlib_module_names else 0)"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_the_page_and_the_schema_are_those_of_the_models() -> None:
    script = Path(__file__).parents[3] / "scripts" / "render_api.py"
    subprocess.run([sys.executable, str(script), "--check"], check=True)
