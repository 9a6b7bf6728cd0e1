"""The emulated HBL2360 speaks as the manual says, traps included, and fails as it is told to."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.emulation.cable import LineNoise
from tiger.emulation.roboteq import BAUD, Roboteq

FAST_RAMP = ("^MAC 1 500000", "^MAC 2 500000", "^MDEC 1 500000", "^MDEC 2 500000")


def ask(drive: Roboteq, line: str, ms: int = 10) -> str:
    """Send one line, wait, and return all that came back."""
    drive.receive(line.encode() + b"\r")
    drive.run(ms * 1000)
    return drive.transmit().decode()


def quiet_drive(**options: object) -> Roboteq:
    drive = Roboteq(**options)  # type: ignore[arg-type]
    ask(drive, "^ECHOF 1")
    return drive


def tuned_drive() -> Roboteq:
    """A drive that reaches a speed within a few milliseconds."""
    drive = quiet_drive()
    for line in FAST_RAMP:
        assert ask(drive, line) == "+\r"
    return drive


# ---- echo, acknowledgements, grammar


def test_every_character_is_echoed_before_the_answer_by_default() -> None:
    assert ask(Roboteq(), "?FF") == "?FF\rFF=0\r"


def test_echo_goes_off_after_the_line_that_asks_for_it_and_comes_back() -> None:
    drive = Roboteq()
    assert ask(drive, "^ECHOF 1") == "^ECHOF 1\r+\r"
    assert ask(drive, "?FF") == "FF=0\r"
    assert ask(drive, "^ECHOF 0") == "+\r"
    assert ask(drive, "?FF") == "?FF\rFF=0\r"


@pytest.mark.parametrize(
    "line", ["!G 1 1000", "!G 2 -1000", "!S 1 800", "!S 2 -800", "!EX", "!MG", "!MS 1", "!s 1 5", " !S 1 5 "]
)
def test_a_good_command_is_acknowledged_with_plus(line: str) -> None:
    assert ask(quiet_drive(), line) == "+\r"


@pytest.mark.parametrize(
    "line",
    [
        "!G 1 1001",
        "!G 1 -1001",
        "!G 500",
        "!G 0 5",
        "!G 3 5",
        "!G 1 5 6",
        "!G 1 5x",
        "!G 1 1_0",
        "!G 1 1.5",
        "!S 1",
        "!S 1 65001",
        "!EX 1",
        "!MG 1",
        "!MS",
        "!MS 3",
        "!QQ 1 1",
        "?QQ",
        "?A 3",
        "?A 0",
        "?A 1 2",
        "?",
        "!",
        "hello",
        "^RWD",
        "^RWD -1",
        "^RWD 65001",
        "^RWD 1 100",
        "^MAC 5",
        "^MAC 3 5",
        "^XYZ 1",
        "~XYZ",
        "~RWD 2",
        "%EESAV 1",
        "!G 1 " + "0" * 70,
    ],
)
def test_a_bad_line_is_answered_with_minus_and_changes_nothing(line: str) -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    assert ask(drive, line) == "-\r"
    assert drive.motor_rpm == (100.0, 0.0)


def test_empty_lines_and_line_feeds_are_ignored() -> None:
    drive = quiet_drive()
    drive.receive(b"\r\r\n?FF\r\n")
    drive.run(10_000)
    assert drive.transmit() == b"FF=0\r"


def test_a_byte_that_is_not_ascii_spoils_its_line_only() -> None:
    drive = quiet_drive()
    drive.receive(b"!G 1 1\xb00\r?FF\r")
    drive.run(10_000)
    assert drive.transmit() == b"-\rFF=0\r"
    assert drive.motor_rpm == (0.0, 0.0)


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_no_bytes_crash_it_or_leave_it_deaf(data: bytes) -> None:
    drive = quiet_drive()
    drive.receive(data.replace(b"^", b"?") + b"\r")
    drive.run(60_000)
    drive.transmit()
    assert ask(drive, "?FID").startswith("FID=Roboteq")


# ---- queries


def test_queries_answer_by_name_in_the_units_of_the_manual() -> None:
    drive = quiet_drive(battery_v=24.6)
    drive.feedback([120.4, -80.0], [3.26, -1.5])
    assert ask(drive, "?A") == "A=33:-15\r"
    assert ask(drive, "?A 2") == "A=-15\r"
    assert ask(drive, "?S") == "S=120:-80\r"
    assert ask(drive, "?V") == "V=120:246:5000\r"
    assert ask(drive, "?V 2") == "V=246\r"
    assert ask(drive, "?BA") == "BA=4:1\r"
    assert ask(drive, "?FF") == "FF=0\r"
    assert ask(drive, "?FS") == "FS=1\r"
    assert ask(drive, "?FM") == "FM=0:0\r"
    assert ask(drive, "?FM 1") == "FM=0\r"
    assert ask(drive, "?T") == "T=32:30:30\r"
    assert "HBL2360" in ask(drive, "?FID")


def test_settings_read_back() -> None:
    drive = quiet_drive()
    assert ask(drive, "~RWD") == "RWD=1000\r"
    assert ask(drive, "^RWD 150") == "+\r"
    assert ask(drive, "~RWD") == "RWD=150\r"
    assert ask(drive, "~MDEC") == "MDEC=20000:20000\r"
    ask(drive, "^MDEC 2 5000")
    assert ask(drive, "~MDEC 2") == "MDEC=5000\r"


def test_a_power_cycle_keeps_only_what_was_saved() -> None:
    drive = quiet_drive()
    ask(drive, "^RWD 150")
    ask(drive, "%EESAV")
    ask(drive, "^RWD 300")
    ask(drive, "!S 1 100", ms=100)
    drive.reboot()
    assert ask(drive, "~RWD") == "RWD=150\r"
    assert drive.motor_rpm == (0.0, 0.0)


# ---- motion


def test_g_is_a_share_of_the_greatest_speed_and_s_is_rpm() -> None:
    drive = tuned_drive()
    ask(drive, "^MXRPM 1 800")
    ask(drive, "!G 1 500")
    ask(drive, "!S 2 -300")
    assert drive.motor_rpm == (400.0, -300.0)
    ask(drive, "!S 1 5000")
    assert drive.motor_rpm[0] == 800.0


def test_speed_ramps_at_the_configured_acceleration_and_deceleration() -> None:
    drive = quiet_drive()
    ask(drive, "^MAC 1 10000")  # 1000 rpm/s
    ask(drive, "^MDEC 1 5000")  # 500 rpm/s
    ask(drive, "^RWD 0")
    ask(drive, "!S 1 400", ms=101)
    assert drive.motor_rpm[0] == pytest.approx(100.0, abs=2.0)
    drive.run(1_000_000)
    assert drive.motor_rpm[0] == 400.0
    ask(drive, "!S 1 0", ms=401)
    assert drive.motor_rpm[0] == pytest.approx(200.0, abs=2.0)


@pytest.mark.parametrize("slice_us", [250, 1000, 7000])
def test_motion_does_not_depend_on_how_time_is_sliced(slice_us: int) -> None:
    drive = quiet_drive()
    drive.receive(b"!S 1 100\r")
    for _ in range(35_000 // slice_us):
        drive.run(slice_us)
    assert drive.motor_rpm[0] == pytest.approx(2000.0 * (0.035 - 9 * 10 / BAUD), abs=1e-3)


def test_ms_stops_one_channel_only() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    ask(drive, "!S 2 100")
    ask(drive, "!MS 1")
    assert drive.motor_rpm == (0.0, 100.0)


# ---- the watchdog and its trap


@pytest.mark.parametrize("watchdog_ms", [150, 1000])
def test_watchdog_zeroes_the_command_after_its_time_and_not_before(watchdog_ms: int) -> None:
    drive = tuned_drive()
    ask(drive, f"^RWD {watchdog_ms}")
    drive.receive(b"!S 1 100\r")
    drive.run(9 * 10 * 1_000_000 // BAUD + 1)
    drive.run(watchdog_ms * 1000 - 10)
    assert drive.motor_rpm == (100.0, 0.0)
    assert not drive.watchdog_expired
    drive.run(20)
    assert drive.watchdog_expired
    drive.run(10_000)
    assert drive.motor_rpm == (0.0, 0.0)


def test_watchdog_stop_takes_the_deceleration_ramp_on_top() -> None:
    drive = quiet_drive()
    ask(drive, "^MAC 1 500000")
    ask(drive, "^MDEC 1 10000")  # 1000 rpm/s
    ask(drive, "^RWD 150")
    ask(drive, "!S 1 100", ms=100)
    drive.run(101_000)
    assert 40.0 < drive.motor_rpm[0] < 60.0
    drive.run(60_000)
    assert drive.motor_rpm[0] == 0.0


def test_queries_settings_and_rubbish_do_not_feed_the_watchdog() -> None:
    drive = tuned_drive()
    ask(drive, "^RWD 150")
    ask(drive, "!S 1 100")
    for line in ("?S", "^ECHOF 1", "~RWD", "rubbish", "!XX", "!G 1 9999") * 5:
        ask(drive, line)
    assert drive.watchdog_expired
    assert drive.motor_rpm == (0.0, 0.0)


def test_commands_feed_the_watchdog() -> None:
    drive = tuned_drive()
    ask(drive, "^RWD 150")
    for _ in range(10):
        ask(drive, "!S 1 100", ms=140)
    assert drive.motor_rpm[0] == 100.0


def test_zero_disables_the_watchdog() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    ask(drive, "^RWD 0")
    drive.run(10_000_000)
    assert drive.motor_rpm[0] == 100.0


def test_after_a_watchdog_stop_a_command_to_one_channel_resumes_the_old_speed_of_the_other() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    ask(drive, "!S 2 200")
    drive.run(2_000_000)
    assert drive.motor_rpm == (0.0, 0.0)
    ask(drive, "!S 1 0")
    assert drive.motor_rpm == (0.0, 200.0)


def test_a_bad_command_or_a_query_does_not_resume_the_old_speed() -> None:
    drive = tuned_drive()
    ask(drive, "!S 2 200")
    drive.run(2_000_000)
    for line in ("!S 3 0", "?S", "^RWD 100"):
        ask(drive, line)
    assert drive.motor_rpm == (0.0, 0.0)


# ---- e-stop and faults


def test_ex_switches_the_power_stage_off_until_mg() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    ask(drive, "!EX")
    assert drive.motor_rpm == (0.0, 0.0)
    assert ask(drive, "?FF") == "FF=16\r"
    assert ask(drive, "?FS") == "FS=9\r"
    assert ask(drive, "!S 1 100") == "+\r"
    assert drive.motor_rpm == (0.0, 0.0)
    ask(drive, "!MG")
    assert ask(drive, "?FF") == "FF=0\r"
    assert drive.motor_rpm == (100.0, 0.0)


def test_estop_input_stops_at_once_and_stays_after_release_until_mg() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    drive.estop_input = True
    drive.run(1)
    assert drive.motor_rpm == (0.0, 0.0)
    ask(drive, "!MG")
    assert ask(drive, "?FF") == "FF=16\r"
    drive.estop_input = False
    assert ask(drive, "?FF") == "FF=16\r"
    ask(drive, "!MG")
    assert ask(drive, "?FF") == "FF=0\r"


@pytest.mark.parametrize("bit", [1, 2, 4, 8, 32, 64])
def test_an_injected_fault_is_reported_and_stops_the_motors(bit: int) -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    drive.fault_flags = bit
    assert ask(drive, "?FF") == f"FF={bit}\r"
    assert drive.motor_rpm == (0.0, 0.0)
    drive.fault_flags = 0
    drive.run(10_000)
    assert drive.motor_rpm == (100.0, 0.0)


def test_default_configuration_loaded_is_reported_and_stops_nothing() -> None:
    drive = tuned_drive()
    drive.fault_flags = 128
    ask(drive, "!S 1 100")
    assert ask(drive, "?FF") == "FF=128\r"
    assert drive.motor_rpm == (100.0, 0.0)


def test_stall_and_loop_error_clear_when_the_command_is_back_at_zero() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    drive.motor_flags[0] = 1 | 2 | 4 | 8 | 16
    assert ask(drive, "?FM") == "FM=31:0\r"
    ask(drive, "!S 1 0")
    assert ask(drive, "?FM") == "FM=17:0\r"


# ---- the line


def test_bytes_take_their_time_at_115200_baud() -> None:
    drive = quiet_drive()
    drive.receive(b"?FF\r")
    out = []
    for _ in range(12):
        drive.run(100)
        out.append(len(drive.transmit()))
    # Four bytes in (347 us), five bytes out (434 us), never more than two bytes within 100 us.
    assert out[:4] == [0, 0, 0, 0]
    assert sum(out) == 5
    assert max(out) <= 2
    assert sum(out[:8]) == 5


def test_a_burst_is_answered_in_order() -> None:
    drive = quiet_drive()
    drive.receive(b"?FF\r!S 1 10\r?FM\r?QQ\r?S\r")
    drive.run(20_000)
    assert drive.transmit() == b"FF=0\r+\rFM=0:0\r-\rS=0:0\r"


def test_two_commands_and_four_queries_fit_into_20_ms() -> None:
    drive = quiet_drive()
    drive.receive(b"!S 1 100\r!S 2 100\r?A\r?S\r?FF\r?FM\r")
    drive.run(20_000)
    assert drive.transmit().count(b"\r") == 6


def test_silent_drive_hears_and_obeys_but_says_nothing() -> None:
    drive = tuned_drive()
    drive.silent = True
    assert ask(drive, "!S 1 100") == ""
    assert drive.motor_rpm[0] == 100.0
    drive.silent = False
    assert ask(drive, "?FF") == "FF=0\r"


def test_deaf_drive_runs_into_its_watchdog() -> None:
    drive = tuned_drive()
    ask(drive, "!S 1 100")
    drive.deaf = True
    assert ask(drive, "!S 1 100", ms=1100) == ""
    assert drive.motor_rpm[0] == 0.0


def test_unasked_lines_come_between_the_answers() -> None:
    drive = quiet_drive()
    drive.say("W")
    assert ask(drive, "?FF") == "W\rFF=0\r"


def test_noise_damages_what_it_says_and_is_reproducible() -> None:
    def heard(seed: int) -> list[str]:
        drive = Roboteq(noise=LineNoise.everything(0.02), seed=seed)
        return [ask_lossy(drive) for _ in range(200)]

    def ask_lossy(drive: Roboteq) -> str:
        drive.receive(b"?FF\r")
        drive.run(5000)
        return drive.transmit().decode("latin-1")

    assert heard(1) == heard(1)
    assert heard(1) != heard(2)
    damaged = sum(answer != "?FF\rFF=0\r" for answer in heard(1))
    assert 40 < damaged < 160
