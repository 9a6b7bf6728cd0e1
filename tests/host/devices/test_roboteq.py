"""The Roboteq driver against the emulated controller: no wrong value, no resumed speed, no wait."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.devices.roboteq import (
    PATIENCE_S,
    SPEED_JUMP_RPM,
    FaultFlag,
    MotorFlag,
    Phase,
    StatusFlag,
    decode_flags,
)
from tiger.devices.roboteq import Roboteq as Driver
from tiger.emulation.cable import LineNoise
from tiger.emulation.roboteq import Refused
from tiger.emulation.roboteq import Roboteq as Controller
from tiger.record import Problem, ProblemKind

WATCHDOG_MS = 150


@dataclass
class Bench:
    """Driver and controller on one line, a millisecond at a time."""

    controller: Controller = field(default_factory=Controller)
    piece: int = 1000  # most bytes that reach the driver in a millisecond
    current_a: tuple[float, float] = (1.5, 2.5)
    fastest_rpm: float = 0.0

    def __post_init__(self) -> None:
        self.driver = Driver("roboteq (left)", "/dev/left", WATCHDOG_MS, 50.0, 20.0)
        self.driver.connected(0.0)
        self.now_ms = 0
        self.cut = False
        self.sent: list[bytes] = []
        self._waiting = b""

    def run(self, ms: int, command: tuple[float, float] | None = None) -> None:
        for _ in range(ms):
            self.now_ms += 1
            now_s = self.now_ms * 1e-3
            self.controller.run(1000)
            self.controller.feedback(self.controller.motor_rpm, self.current_a)
            self.fastest_rpm = max(self.fastest_rpm, *map(abs, self.controller.motor_rpm))
            self._waiting += self.controller.transmit()
            if self.cut:
                self._waiting = b""
                continue
            data, self._waiting = self._waiting[: self.piece], self._waiting[self.piece :]
            self.driver.feed(data, now_s)
            if command is not None and self.now_ms % 5 == 0:
                self.driver.command(*command)
            out = self.driver.outgoing(now_s)
            if out:
                self.sent.append(out)
                self.controller.receive(out)

    def phase(self) -> Phase:
        return self.driver.phase

    def problem(self) -> Problem | None:
        return self.driver.problem

    def started(self) -> Bench:
        self.run(400)
        assert self.driver.release()
        return self


def test_it_configures_zeroes_and_holds_before_anything_else() -> None:
    bench = Bench()
    bench.run(400)
    assert bench.phase() is Phase.HOLDING
    assert bench.sent[:6] == [
        b"?\r!M 0 0\r?CIS\r",
        b"^ECHOF 0\r",
        b"^RWD 150\r",
        b"~RWD\r" * 3,
        b"~MXRPM\r" * 3,
        b"!S 1 0\r!S 2 0\r?CIS\r",
    ]
    assert bench.driver.ready


def test_nothing_but_zero_is_sent_before_release() -> None:
    bench = Bench()
    bench.run(1000, command=(100.0, 100.0))
    speeds = {line for out in bench.sent for line in out.split(b"\r") if line.startswith(b"!S")}
    assert speeds == {b"!S 1 0", b"!S 2 0"}
    assert bench.fastest_rpm == 0.0


def test_a_released_drive_follows_its_two_commands() -> None:
    bench = Bench().started()
    bench.run(500, command=(120.4, -80.6))
    assert bench.controller.motor_rpm == (120.0, -81.0)
    sample = bench.driver.sample
    assert sample is not None
    assert sample.wheel_rpm == (120.0, -81.0)
    assert sample.motor_current_a == (1.5, 2.5)
    assert sample.battery_v == 24.0
    assert sample.controller_temperature_celsius == 32.0


def test_a_blow_of_current_is_no_sustained_one_and_a_lasting_one_is() -> None:
    """The squares are smoothed over 20 s: after so long a step has got to 1 - 1/e of its square."""
    bench = Bench().started()

    def sustained() -> tuple[float, float]:
        assert bench.driver.sample is not None
        return bench.driver.sample.sustained_current_a

    assert max(sustained()) < 0.5
    bench.current_a = (50.0, -50.0)
    bench.run(2000)
    assert sustained() == pytest.approx((50.0 * math.sqrt(1.0 - math.exp(-0.1)),) * 2, rel=0.1)
    bench.run(18_000)
    heated = sustained()
    assert heated == pytest.approx((50.0 * math.sqrt(1.0 - math.exp(-1.0)),) * 2, rel=0.02)
    bench.current_a = (0.0, 0.0)
    bench.driver.connected(bench.now_ms * 1e-3)  # a lost line cools no motor
    bench.run(1000)
    assert sustained() == pytest.approx(heated, rel=0.06)
    bench.run(40_000)
    assert max(sustained()) < 0.4 * heated[0]


def test_commands_are_refreshed_at_50_hz_and_speeds_read_as_often() -> None:
    bench = Bench().started()
    before = len([out for out in bench.sent if out.startswith(b"!S")])
    queries = len([out for out in bench.sent if out == b"?S\r" * 3])
    bench.run(1000, command=(10.0, 10.0))
    assert len([out for out in bench.sent if out.startswith(b"!S")]) - before == pytest.approx(50, abs=1)
    assert len([out for out in bench.sent if out == b"?S\r" * 3]) - queries == pytest.approx(50, abs=1)


def test_motor_currents_are_read_twelve_times_a_second_and_nothing_less_than_once() -> None:
    bench = Bench().started()
    before = len(bench.sent)
    bench.run(2000, command=(10.0, 10.0))
    asked = Counter(out.split(b"\r")[0] for out in bench.sent[before:] if out[:1] in b"?~")
    assert asked[b"?A"] == pytest.approx(25, abs=1)
    assert asked[b"?FF"] == pytest.approx(50, abs=2)
    assert asked[b"~RWD"] >= 6
    assert min(asked[query] for query in (b"?V", b"?BA", b"?FS", b"?FM", b"?T")) >= 3


def test_hold_stops_the_motors() -> None:
    bench = Bench().started()
    bench.run(500, command=(100.0, 100.0))
    bench.driver.hold()
    bench.run(200, command=(100.0, 100.0))
    assert bench.controller.motor_rpm == (0.0, 0.0)
    assert bench.phase() is Phase.HOLDING


def test_a_speed_confirmed_after_hold_does_not_count_as_zero() -> None:
    bench = Bench().started()
    bench.run(200, command=(100.0, 100.0))
    _until_it_sends(bench, b"!S", command=(100.0, 100.0))
    bench.driver.hold()
    bench.driver.feed(b"!S 1 100\r+\r!S 2 100\r+\r?CIS\rCIS=100:100\r", bench.now_ms * 1e-3)
    assert bench.phase() is Phase.ZEROING
    bench.run(100)
    assert bench.phase() is Phase.HOLDING


def test_a_drive_that_is_not_ready_is_not_released() -> None:
    bench = Bench()
    bench.run(10)
    assert not bench.driver.release()
    assert bench.phase() is not Phase.RUNNING


def test_after_a_gap_the_old_speed_does_not_come_back() -> None:
    bench = Bench().started()
    bench.run(1000, command=(200.0, -200.0))
    bench.cut = True
    bench.run(600)
    assert bench.controller.watchdog_expired
    assert bench.controller.motor_rpm == (0.0, 0.0)
    bench.cut, bench.fastest_rpm = False, 0.0
    bench.run(600, command=(200.0, -200.0))
    assert bench.fastest_rpm == 0.0
    assert bench.controller.motor_rpm == (0.0, 0.0)
    assert bench.phase() is Phase.HOLDING
    assert bench.driver.gaps == 1


def test_a_new_daemon_on_a_controller_with_a_standing_speed_begins_with_zeros() -> None:
    controller = Controller()
    controller.receive(b"^RWD 150\r!S 1 300\r!S 2 300\r")
    controller.run(1_000_000)
    bench = Bench(controller)
    bench.run(600)
    assert bench.fastest_rpm == 0.0
    assert bench.driver.ready


@pytest.mark.parametrize("echo", [b"", b"^ECHOF 1\r"])
def test_a_zero_for_both_that_arrives_as_one_for_one_is_repeated_at_once(echo: bytes) -> None:
    """One bit makes of `!M 0 0` an `!M 0`, which lets the other motor run on at its old speed."""
    controller = Controller()
    controller.receive(echo + b"^RWD 150\r!S 1 300\r!S 2 300\r")
    controller.run(1_000_000)
    controller.transmit()
    bench = Bench(controller)
    hear = controller.receive

    def damaged(data: bytes) -> None:
        if b"!M 0 0" in data:
            data = data.replace(b"!M 0 0", b"!M 0  ")
            controller.receive = hear  # type: ignore[method-assign]
        hear(data)

    controller.receive = damaged  # type: ignore[method-assign]
    while controller.watchdog_expired:
        bench.run(1)
    assert bench.fastest_rpm <= 2.0  # of the ramp's first millisecond
    bench.run(12)
    assert not controller.watchdog_expired
    assert controller.motor_rpm == (0.0, 0.0)
    bench.run(600)
    assert bench.driver.ready


def test_a_controller_that_lost_power_is_configured_again() -> None:
    bench = Bench().started()
    bench.run(100, command=(50.0, 50.0))
    bench.controller.silent = bench.controller.deaf = True
    bench.run(300)
    bench.controller.silent = bench.controller.deaf = False
    bench.controller.reboot()
    bench.sent.clear()
    bench.run(600)
    assert b"^RWD 150\r" in bench.sent
    assert bench.driver.ready


def test_a_controller_that_lost_power_for_a_moment_gets_its_watchdog_back() -> None:
    bench = Bench().started()
    bench.run(100, command=(50.0, 50.0))
    bench.controller.reboot()  # so quickly that no exchange fails for it
    assert bench.phase() is Phase.RUNNING
    bench.run(400, command=(50.0, 50.0))
    assert bench.driver.gaps == 1
    bench.run(400, command=(50.0, 50.0))
    assert bench.phase() is Phase.HOLDING
    assert bench.controller._settings["RWD"] == [WATCHDOG_MS]


def test_a_watchdog_that_cannot_be_set_is_a_problem() -> None:
    bench = Bench()
    bench.controller._set = lambda name, numbers: "+"  # type: ignore[method-assign]
    bench.run(2000)
    assert bench.driver.problem is not None
    assert "keeps its watchdog at 1000 ms instead of 150 ms" in str(bench.driver.problem)
    assert not bench.driver.ready


def test_a_silent_controller_is_named_after_a_second() -> None:
    bench = Bench()
    bench.controller.silent = True
    bench.run(900)
    assert bench.problem() is None
    bench.run(400)
    assert bench.driver.problem is not None
    assert bench.driver.problem.kind is ProblemKind.NO_ANSWER
    assert "roboteq (left) on /dev/left: does not answer" in str(bench.driver.problem)


def _until_it_sends(bench: Bench, start: bytes, command: tuple[float, float] = (0.0, 0.0)) -> None:
    """Run until the driver has just sent what begins so."""
    before = len(bench.sent)
    while len(bench.sent) == before or not bench.sent[-1].startswith(start):
        before = len(bench.sent)
        bench.run(1, command=command)


def _echo_another_speed(bench: Bench) -> bytes:
    """Make the driver hear that its next command arrived as 90 rpm; returns what it says to that."""
    _until_it_sends(bench, b"!S", command=(10.0, 10.0))
    bench.driver.feed(b"!S 1 90\r", bench.now_ms * 1e-3)
    out = bench.driver.outgoing(bench.now_ms * 1e-3)
    bench.controller.receive(out)
    return out


def test_a_command_changed_on_the_way_is_answered_by_a_stop_at_once() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    assert _echo_another_speed(bench) == b"!M 0 0\r?CIS\r"
    assert bench.driver.changed_commands == 1


def test_after_one_changed_command_the_drive_goes_on() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    _echo_another_speed(bench)
    bench.run(100, command=(10.0, 10.0))
    assert bench.phase() is Phase.RUNNING
    assert bench.controller.motor_rpm == (10.0, 10.0)


def test_a_second_changed_command_within_a_second_holds_the_motors_until_released() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    _echo_another_speed(bench)
    bench.run(500, command=(10.0, 10.0))
    assert _echo_another_speed(bench) == b"!M 0 0\r?CIS\r"
    bench.run(500, command=(10.0, 10.0))
    assert bench.phase() is Phase.HOLDING
    assert bench.controller.motor_rpm == (0.0, 0.0)
    assert not bench.driver.release()
    assert str(bench.driver.fault).startswith(
        "roboteq (left) on /dev/left: commands arrived as other ones. Check"
    )
    bench.driver.clear()
    assert bench.driver.release()


def test_a_speed_that_is_read_back_otherwise_counts_as_changed_though_its_echo_is_right() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    _until_it_sends(bench, b"!S", command=(10.0, 10.0))
    bench.driver.feed(b"!S 1 10\r+\r!S 2 10\r+\r?CIS\rCIS=90:10\r", bench.now_ms * 1e-3)
    assert bench.driver.changed_commands == 1
    assert bench.driver.outgoing(bench.now_ms * 1e-3) == b"!M 0 0\r?CIS\r"


def test_speeds_are_read_back_in_thousandths_of_the_controllers_full_scale() -> None:
    controller = Controller()
    controller.receive(b"^MXRPM 1 3000\r^MXRPM 2 700\r")
    controller.run(10_000)
    bench = Bench(controller).started()
    for rpm in range(-400, 400, 7):
        bench.run(20, command=(float(rpm), float(rpm + 3)))
    assert bench.driver.changed_commands == 0
    bench.run(40, command=(10_000.0, -10_000.0))
    assert b"!S 1 3000\r!S 2 -700\r?CIS\r" in bench.sent
    assert bench.driver.changed_commands == 0


def test_a_full_scale_that_is_answered_in_two_ways_is_asked_again() -> None:
    class MisreadOnce(Controller):
        misread = False

        def _get(self, name: str, numbers: tuple[int, ...]) -> str:
            answer = super()._get(name, numbers)
            if name != "MXRPM" or self.misread:
                return answer
            self.misread = True
            return answer.replace("1000", "9000")

    bench = Bench(MisreadOnce())
    bench.run(1000)
    assert bench.driver.release()
    bench.run(300, command=(20.0, -15.0))
    assert bench.driver.changed_commands == 0
    assert bench.controller.motor_rpm == (20.0, -15.0)


def test_a_controller_that_cannot_read_back_is_named_with_the_key_that_helps() -> None:
    class OldFirmware(Controller):
        def _measured(self, name: str) -> list[int]:
            if name == "CIS":
                raise Refused
            return super()._measured(name)

    bench = Bench(OldFirmware())
    bench.run(2000)
    assert "does not answer ?CIS. Set roboteq_read_back = false" in str(bench.driver.problem)
    assert not bench.driver.ready


def test_without_read_back_the_echo_alone_confirms() -> None:
    bench = Bench()
    bench.driver = Driver("roboteq (left)", "/dev/left", WATCHDOG_MS, 50.0, 20.0, read_back=False)
    bench.driver.connected(0.0)
    bench.started()
    bench.run(500, command=(20.0, 20.0))
    assert bench.controller.motor_rpm == (20.0, 20.0)
    assert not any(b"CIS" in out for out in bench.sent)


def test_speeds_are_asked_of_the_sensors_that_the_motors_have() -> None:
    bench = Bench()
    bench.driver = Driver("roboteq (left)", "/dev/left", WATCHDOG_MS, 50.0, 20.0, speed_query="BS")
    bench.driver.connected(0.0)
    bench.started()
    bench.run(500, command=(20.0, 25.0))
    assert bench.driver.sample is not None
    assert bench.driver.sample.wheel_rpm == (20.0, 25.0)
    asked = {line for out in bench.sent for line in out.split(b"\r")}
    assert b"?BS" in asked
    assert b"?S" not in asked


def _commands(bench: Bench) -> list[bytes]:
    """What was sent of the lines that feed the watchdog."""
    return [line for out in bench.sent for line in out.split(b"\r") if line.startswith(b"!")]


def test_a_stop_that_nobody_confirms_is_repeated_for_a_moment_then_silence_lets_the_watchdog_do_it() -> None:
    """One that is damaged itself might feed the watchdog again and again."""
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    _echo_another_speed(bench)
    bench.controller.silent = True
    bench.sent.clear()
    bench.run(round(1e3 * PATIENCE_S))
    assert set(_commands(bench)) == {b"!M 0 0"}
    bench.sent.clear()
    bench.run(WATCHDOG_MS, command=(10.0, 10.0))
    assert not _commands(bench)
    assert b"?CIS\r" * 3 + b"~RWD\r" * 3 in bench.sent
    assert bench.controller.watchdog_expired
    bench.controller.silent = False
    bench.run(600)
    assert "commands arrived as other ones" in str(bench.driver.fault)
    assert not bench.driver.release()
    bench.driver.clear()
    assert bench.driver.release()


def test_a_wrong_speed_that_nothing_mends_lasts_no_longer_than_the_bound() -> None:
    """Every command for the front motor arrives as another one, every stop as one for the rear motor."""
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    hear = bench.controller.receive
    bench.controller.receive = lambda data: hear(  # type: ignore[method-assign]
        data.replace(b"!S 1 1", b"!S 1 9").replace(b"!M 0 0", b"!M   0")
    )
    bench.controller.silent = True  # and nobody tells
    began_ms = bench.now_ms
    while not bench.controller.watchdog_expired:
        bench.run(1, command=(10.0, 10.0))
    assert bench.fastest_rpm == 90.0
    assert bench.now_ms - began_ms <= 1e3 * (bench.driver.period_s + bench.driver.wrong_speed_s)


def test_a_stall_shorter_than_the_watchdog_passes() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    for _ in range(5):
        bench.controller.silent = True
        bench.run(100, command=(10.0, 10.0))
        bench.controller.silent = False
        bench.run(100, command=(10.0, 10.0))
    bench.run(100, command=(20.0, 20.0))
    assert bench.phase() is Phase.RUNNING
    assert bench.driver.gaps == bench.driver.changed_commands == 0
    assert bench.controller.motor_rpm == (20.0, 20.0)


def test_in_the_silence_no_command_follows_until_what_stands_was_meant() -> None:
    bench = Bench().started()
    bench.run(200, command=(10.0, 10.0))
    _until_it_sends(bench, b"!S", command=(10.0, 10.0))
    bench.cut = True
    bench.run(60)
    bench.cut = False
    bench.driver._exchange = None
    bench.controller.transmit()
    bench.controller._command_rpm = [90.0, 10.0]
    bench.sent.clear()
    bench.run(30, command=(10.0, 10.0))
    assert not _commands(bench)
    bench.controller._command_rpm = [10.0, 10.0]
    bench.run(20, command=(10.0, 10.0))
    assert _commands(bench)[:2] == [b"!S 1 10", b"!S 2 10"]


def test_power_lost_in_a_short_stall_is_noticed_before_the_next_command() -> None:
    bench = Bench().started()
    bench.run(200, command=(50.0, 50.0))
    bench.cut = True
    bench.run(60, command=(50.0, 50.0))
    bench.controller.reboot()
    bench.cut = False
    bench.sent.clear()
    while not _commands(bench):
        bench.run(1, command=(50.0, 50.0))
    assert _commands(bench) == [b"!M 0 0"]
    bench.sent.clear()
    while not _commands(bench):
        bench.run(1, command=(50.0, 50.0))
    assert bench.controller._settings["RWD"] == [WATCHDOG_MS]


def test_after_the_first_zeros_no_command_is_sent_before_the_watchdog_was_read_back() -> None:
    bench = Bench()
    hear = bench.controller.receive
    bench.controller.receive = lambda data: hear(  # type: ignore[method-assign]
        data.replace(b"^RWD 150", b"^RWD 350")
    )
    bench.run(1000)
    assert bench.controller._settings["RWD"] == [350]
    assert _commands(bench) == [b"!M 0 0"]
    bench.controller.receive = hear  # type: ignore[method-assign]
    bench.run(600)
    assert bench.driver.ready


def test_after_a_failed_stop_and_a_silence_a_stop_is_repeated_at_once_again() -> None:
    bench = Bench()
    bench.controller.silent = True
    times = []
    while bench.now_ms < 800:
        count = len(_commands(bench))
        bench.run(1)
        if len(_commands(bench)) > count:
            times.append(bench.now_ms)
    pauses = [b - a for a, b in itertools.pairwise(times)]
    silence_ms = round(1e3 * bench.driver.silence_s)
    assert pauses[:4] == pytest.approx([20, silence_ms, 20, silence_ms], abs=1)


def test_an_emergency_stop_leaves_a_standing_speed_behind_that_disturbs_nothing() -> None:
    bench = Bench().started()
    bench.run(200, command=(50.0, 50.0))
    bench.cut = True
    bench.run(100)
    bench.driver.emergency_stop()
    bench.run(300)
    bench.cut = False
    bench.run(100)
    assert bench.phase() is Phase.STOPPED
    for _ in range(50):
        bench.run(10)
        assert bench.phase() is Phase.STOPPED


def test_an_emergency_stop_waits_for_no_silence() -> None:
    bench = Bench().started()
    bench.run(200, command=(50.0, 50.0))
    bench.controller.silent = True
    while bench.phase() is not Phase.CONFIGURING:
        bench.run(1)
    bench.controller.silent = False
    bench.driver.emergency_stop()
    bench.run(5)
    assert bench.controller.stage_off


def test_changed_commands_that_are_far_apart_do_not_hold_the_motors() -> None:
    bench = Bench().started()
    for _ in range(3):
        bench.run(1100, command=(10.0, 10.0))
        _echo_another_speed(bench)
    bench.run(100, command=(10.0, 10.0))
    assert bench.phase() is Phase.RUNNING


def test_half_a_command_in_the_controllers_buffer_is_never_completed() -> None:
    bench = Bench().started()
    bench.run(500, command=(200.0, -200.0))
    bench.cut = True
    bench.controller.run(5000)
    bench.controller.receive(b"!S 1 2")
    bench.run(600)
    bench.cut, bench.fastest_rpm = False, 0.0
    bench.run(600, command=(200.0, -200.0))
    assert bench.fastest_rpm == 0.0
    assert bench.driver.ready


def test_an_emergency_stop_outlives_a_lost_line() -> None:
    bench = Bench().started()
    bench.run(200, command=(50.0, 50.0))
    bench.cut = True
    bench.run(20)
    bench.driver.emergency_stop()
    bench.run(500)
    bench.controller.reboot()
    bench.cut = False
    bench.sent.clear()
    bench.run(500)
    assert b"?\r!EX\r" in bench.sent
    assert bench.phase() is Phase.STOPPED
    assert bench.controller.stage_off


def test_emergency_stop_and_its_release_leave_the_motors_at_zero() -> None:
    bench = Bench().started()
    bench.run(500, command=(100.0, 100.0))
    bench.driver.emergency_stop()
    bench.run(300, command=(100.0, 100.0))
    assert bench.controller.motor_rpm == (0.0, 0.0)
    assert bench.driver.flags["FF"] & FaultFlag.EMERGENCY_STOP
    assert bench.phase() is Phase.STOPPED
    bench.driver.clear()
    bench.fastest_rpm = 0.0
    bench.run(500, command=(100.0, 100.0))
    assert bench.fastest_rpm == 0.0
    assert not bench.driver.flags["FF"]
    assert bench.driver.release()


def test_a_flag_is_believed_when_all_answers_agree() -> None:
    bench = Bench().started()
    bench.controller.fault_flags = int(FaultFlag.UNDERVOLTAGE | FaultFlag.SHORT_CIRCUIT)
    bench.run(300, command=(0.0, 0.0))
    assert bench.driver.flags["FF"] == 12


@pytest.mark.parametrize(("flags", "contradictions"), [((8, 0, 0), 1), ((0, 8, 8), 1), ((0, 0, 0), 0)])
def test_a_flag_that_not_all_answers_have_is_noise(flags: tuple[int, ...], contradictions: int) -> None:
    bench = Bench().started()
    _until_it_sends(bench, b"?FF\r" * 3)
    answers = "".join(f"?FF\rFF={value}\r" for value in flags)
    bench.driver.feed(answers.encode("ascii"), bench.now_ms * 1e-3)
    assert bench.driver.flags["FF"] == 0
    assert bench.driver.contradictions == contradictions


@pytest.mark.parametrize(
    "answers",
    [
        b"?S\rS=10:10\r?S\rS=10:30\r?S\rS=10:90\r",  # damaged digits
        b"?S\rS=010:10\r" * 3,  # not as the controller writes numbers
        b"?S\rS=10:-0\r" * 3,
        b"?S\rS=10\r" * 3,
        b"?S\rA=10:10\r" * 3,  # the answer to another query
        b"S=10:10\r" * 3,  # without an echo
    ],
)
def test_speeds_that_contradict_or_break_the_grammar_are_not_used(answers: bytes) -> None:
    bench = Bench().started()
    _until_it_sends(bench, b"?S\r" * 3)
    bench.driver.feed(answers, bench.now_ms * 1e-3)
    assert bench.driver.readings["S"] == (0, 0)


@pytest.mark.parametrize(
    ("answers", "used"),
    [
        ((20, 20, 20), 20),
        ((20, 90, 20), 20),  # a damaged digit is outvoted
        ((60, 20, 20), 20),
        ((18, 20, 22), 20),  # on the move: the middle one
        ((18, 26, 20), None),  # further apart than a motor gets in a millisecond
    ],
)
def test_of_three_answers_two_decide(answers: tuple[int, ...], used: int | None) -> None:
    bench = Bench().started()
    _until_it_sends(bench, b"?S\r" * 3)
    said = "".join(f"?S\rS={rpm}:0\r" for rpm in answers)
    bench.driver.feed(said.encode("ascii"), bench.now_ms * 1e-3)
    assert bench.driver.readings["S"] == (0 if used is None else used, 0)


def test_a_speed_that_jumps_is_used_when_the_next_reading_confirms_it() -> None:
    bench = Bench().started()
    bench.run(100, command=(0.0, 0.0))
    for confirmed in (False, True):
        _until_it_sends(bench, b"?S\r" * 3)
        bench.driver.feed(b"?S\rS=0:500\r" * 3, bench.now_ms * 1e-3)
        sample = bench.driver.sample
        assert sample is not None
        assert (sample.wheel_rpm == (0.0, 500.0)) is confirmed
        bench.sent.append(bench.driver.outgoing(bench.now_ms * 1e-3))
        bench.controller.run(15_000)
        bench.controller.transmit()


@settings(max_examples=15, deadline=None)
@given(piece=st.integers(3, 12), seed=st.integers(0, 1000))
def test_every_value_is_right_in_whatever_pieces_it_comes(piece: int, seed: int) -> None:
    bench = Bench(Controller(seed=seed), piece=piece)
    bench.run(800)
    if bench.driver.release():
        bench.run(400, command=(37.0, -41.0))
        assert bench.controller.motor_rpm in {(37.0, -41.0), (0.0, 0.0)}
        sample = bench.driver.sample
        assert sample is None or sample.wheel_rpm[0] in {float(rpm) for rpm in range(38)}
    assert bench.driver.wrong_echoes == 0


@pytest.mark.parametrize("rate", [1e-3, 5e-3])
def test_a_noisy_line_moves_nothing_wrongly(rate: float) -> None:
    bench = Bench(Controller(noise=LineNoise.everything(rate), seed=4))
    for _ in range(40):
        bench.run(100)
        if bench.driver.release():
            break
    worst = 0.0
    for _ in range(300):
        bench.run(20, command=(60.0, 60.0))
        sample = bench.driver.sample
        if sample is not None:
            worst = max(worst, *map(abs, sample.wheel_rpm))
    assert bench.fastest_rpm <= 60.0
    assert worst <= 60.0 + SPEED_JUMP_RPM  # a digit damaged twice alike may pass, within the plausible step


def test_unasked_lines_and_garbage_are_counted_and_ignored() -> None:
    bench = Bench().started()
    bench.run(100, command=(5.0, 5.0))
    exchanges = bench.driver.exchanges
    bench.driver.feed(b"W\rOK\r\xff\xfe\rS=1\rS=1:2:3\rS=99999999:1\r" + b"x" * 300 + b"\r", 0.5)
    assert bench.driver.garbled >= 6
    bench.run(200, command=(5.0, 5.0))
    assert bench.driver.exchanges > exchanges
    assert bench.phase() is Phase.RUNNING


@pytest.mark.parametrize(
    ("flags", "kind", "names"),
    [
        (0, FaultFlag, []),
        (1 | 64, FaultFlag, ["overheat", "mosfet"]),
        (1 << 9, FaultFlag, ["bit 9"]),
        (1 | 8, StatusFlag, ["serial mode", "power stage off"]),
        (64 | 256 | 1 << 15, StatusFlag, ["bit 6", "tuning", "bit 15"]),
        (1 << 7, MotorFlag, ["bit 7"]),
        (2 | 4, MotorFlag, ["stalled", "loop error"]),
    ],
)
def test_flags_are_named_and_unknown_bits_numbered(flags: int, kind: type, names: list[str]) -> None:
    assert decode_flags(flags, kind) == names


@pytest.mark.parametrize(("rpm", "sent"), [(float("nan"), b"0"), (1e9, b"1000"), (-1e9, b"-1000")])
def test_no_command_leaves_the_grammar(rpm: float, sent: bytes) -> None:
    bench = Bench().started()
    bench.sent.clear()
    bench.run(60, command=(rpm, rpm))
    assert b"!S 1 " + sent + b"\r!S 2 " + sent + b"\r?CIS\r" in bench.sent
