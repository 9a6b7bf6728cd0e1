"""The commands: quick to answer, one clear message for what is wrong, figures where they are asked for."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from tiger.cli import commands, doctor
from tiger.cli.commands import COMMANDS, app
from tiger.cli.study import STUDIES
from tiger.protocol.frame import encode_message
from tiger.protocol.messages import BoardState, Fault, Health, SuspensionSetpoint, SuspensionState


def tiger(*words: str, monkeypatch: pytest.MonkeyPatch) -> Result:
    monkeypatch.setattr(sys, "argv", ["tiger", *words])
    return CliRunner().invoke(app, list(words))


def test_help_lists_every_command_in_less_than_0_4_seconds() -> None:
    best_s = 9.9
    for _ in range(5):
        start_s = time.perf_counter()
        result = subprocess.run(
            [sys.executable, "-m", "tiger.cli.main", "--help"], capture_output=True, text=True, check=True
        )
        best_s = min(best_s, time.perf_counter() - start_s)
    assert all(name in result.stdout for name in COMMANDS)
    assert best_s < 0.4


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys; sys.argv = ['tiger', '--help']\n"
        "from tiger.cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'control', 'numba', 'matplotlib', 'pydantic', 'rich'}\n"
        "heavy &= sys.modules.keys()\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_explains_itself(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger(name, "--help", monkeypatch=monkeypatch)
    assert result.exit_code == 0
    assert "Usage" in result.output


def test_an_unknown_command_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger("fly", monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert "fly" in result.output


def completed(line: str) -> list[str]:
    """What the shell is offered for the last word of a line."""
    environment = os.environ | {
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split(" ")) - 1),
        "_TIGER_COMPLETE": "complete_bash",
    }
    command = [sys.executable, "-c", "from tiger.cli.main import main; main()"]
    result = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return result.stdout.split()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("tiger ca", ["calibrate"]),
        ("tiger run --em", ["--emulate"]),
        ("tiger run --emulate s", ["shaking-plate", "side-slope", "smooth-floor"]),
        ("tiger ctl mode ", ["hold", "level", "balance", "pose", "stow"]),
        ("tiger study tip", ["tip-over"]),
        ("tiger log export c", ["csv"]),
    ],
)
def test_a_shell_completes_commands_options_and_names(line: str, words: list[str]) -> None:
    assert completed(line) == words


def test_the_version_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tiger("--version", monkeypatch=monkeypatch).output.startswith("tiger 0.")


def test_a_mistake_of_the_program_is_two_lines_and_a_status_of_its_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*words: object, **more: object) -> None:
        raise ZeroDivisionError("of all things")

    monkeypatch.delenv("TIGER_TRACEBACK", raising=False)
    monkeypatch.setattr(commands, "app", broken)
    with pytest.raises(SystemExit) as ended:
        commands.obey()
    assert ended.value.code == commands.MISTAKE
    said = capsys.readouterr().err
    assert "ZeroDivisionError: of all things" in said
    assert said.count("\n") == 2
    monkeypatch.setenv("TIGER_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        commands.obey()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "words", [["--version"], ["protocol", "capture", "-"], ["study", "eam", "--points", "3"]]
)
def test_a_full_disk_behind_standard_output_is_no_mistake_of_the_program(words: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "tiger.cli.main", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            input=encode_message(STATE, 9),
        )
    assert result.returncode == 2
    said = result.stderr.decode()
    assert "the output cannot be written (No space left on device); make room there" in said
    assert "mistake" not in said


def test_a_reader_that_has_seen_enough_is_no_unreadable_file(tmp_path: Path) -> None:
    file = tmp_path / "line.bin"
    file.write_bytes(encode_message(STATE, 9) * 5000)
    command = [sys.executable, "-m", "tiger.cli.main", "protocol", "capture", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == ""


INTERRUPTED_WHILE_IMPORTING = """
import signal, sys
class CtrlC:
    def find_spec(self, name, *_):
        if name == module:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)
module = sys.argv.pop(1)
sys.meta_path.insert(0, CtrlC())
from tiger.cli.main import main
main()
"""


@pytest.mark.parametrize("module", ["tiger.cli.commands", "typer", "tiger.cli.log", "tiger.logs.summary"])
def test_ctrl_c_while_python_still_imports_ends_quietly(module: str) -> None:
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IMPORTING, module, "log", "info", "/no/such"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert (result.returncode, result.stdout, result.stderr.strip()) == (130, "", "")


# ------------------------------------------------------------------------------------------------------ study


@pytest.mark.parametrize("name", list(STUDIES))
def test_every_option_of_a_study_is_explained(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger("study", name, "--help", monkeypatch=monkeypatch)
    assert result.exit_code == 0, result.output
    assert "<" not in result.output  # an option whose unit or kind was not named


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--vehicle", "nope"], "vehicle 'nope' is not known"),
        (["--json", "/no/such/out.json"], "cannot be written (there is no folder /no/such)"),
        (["--plots", "/proc/no"], "/proc/no: cannot be written"),
        (["--points", "1"], "greater than or equal to 2"),
    ],
)
def test_a_study_refuses_before_it_works(
    words: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiger("study", "eam", *words, monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert message in result.output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["quarter-car", "--step-m", "nan"], "--step-m nan: cannot be calculated with; give a finite number"),
        (["handling", "--speed-kmh", "-30"], "greater than or equal to 1"),
        (["shaking-plate", "--step-deg", "90"], "study shaking-plate: to_deg = 90.0: input should be less"),
        (["speed-sweep", "--slowest-mps", "50", "--fastest-mps", "10"], "exchange them"),
        (["speed-sweep", "--step-mps", "0"], "greater than or equal to 0.1"),
        (["force-limits", "--rate-nps", "-1"], "greater than or equal to 1"),
        (["tip-over", "--keep", "/tmp"], "/tmp: cannot be written (it is a folder)"),
    ],
)
def test_a_study_refuses_what_cannot_be_calculated(
    words: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiger("study", *words, monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert message in result.output
    assert "pydantic" not in result.output


def test_figures_of_a_study_to_the_screen_are_all_there_is_on_standard_output() -> None:
    words = ["study", "eam", "--points", "3", "--json", "-"]
    result = subprocess.run(
        [sys.executable, "-m", "tiger.cli.main", *words], capture_output=True, text=True, timeout=120
    )
    assert json.loads(result.stdout)["rows"]
    assert "quantity" in result.stderr


# -------------------------------------------------------------------------------------------------------- run


def test_a_run_in_virtual_time_arms_and_writes_its_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "out.json"
    words = ["run", "--emulate", "shaking-plate", "--virtual-time", "--duration", "5", "--json", str(file)]
    result = tiger(*words, monkeypatch=monkeypatch)
    assert result.exit_code == 0, result.output
    assert "ARMED" in result.output
    assert result.output.strip().splitlines()[-1].startswith("Armed from 3.")
    report = json.loads(file.read_text())
    series = report["series"]
    lengths = {name: len(values) for name, values in series.items()}
    assert set(lengths.values()) == {250}, lengths
    assert list(series) == [
        *("time_s", "roll_true_deg", "pitch_true_deg", "roll_est_deg", "pitch_est_deg"),
        *("stroke_mm", "rate_cmd_mmps"),
        *("x_m", "y_m", "yaw_deg", "speed_mps", "slip_ratio"),
    ]
    assert series["time_s"][-1] == pytest.approx(5.0, abs=0.02)
    assert len(series["stroke_mm"][-1]) == len(series["rate_cmd_mmps"][-1]) == 4
    assert series["stroke_mm"][-1] == pytest.approx([35.0] * 4, abs=0.2)
    assert series["roll_true_deg"][-1] == pytest.approx(0.0, abs=0.1)
    assert report["summary"]["state"] == "ARMED"
    assert report["summary"]["stops"] == []
    assert len(report["summary"]["drive"]["energy_j"]) == 4
    assert report["summary"]["drive"]["lowest_battery_v"] == pytest.approx(24.0, abs=0.2)
    assert report["summary"]["log"] is None


def test_a_planned_drive_is_driven_with_a_log_as_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, figures = tmp_path / "ahead.toml", tmp_path / "out.json"
    scenario.write_text('title = "t"\nduration_s = 8.0\n[[drive]]\nat_s = 5.0\nspeed_mps = 0.3\n')
    words = ["run", "--emulate", str(scenario), "--virtual-time", "--json", str(figures)]
    reached_m = []
    for more in ([], ["--log", str(tmp_path / "logs")]):
        assert tiger(*words, *more, monkeypatch=monkeypatch).exit_code == 0
        reached_m.append(json.loads(figures.read_text())["series"]["x_m"][-1])
    assert reached_m[0] > 0.3
    assert reached_m[1] == reached_m[0]


def test_json_to_the_screen_is_all_there_is_on_standard_output() -> None:
    words = ["run", "--emulate", "shaking-plate", "--virtual-time", "--duration", "0.2", "--json", "-"]
    result = subprocess.run(
        [sys.executable, "-m", "tiger.cli.main", *words], capture_output=True, text=True, timeout=120
    )
    assert json.loads(result.stdout)["summary"]["scenario"] == "shaking-plate"
    assert "Never armed" in result.stderr


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[loop]\nrate_hz = 'fast'\n", ["loop.rate_hz", "'fast'"]),
        ("[ports]\nroboteq_lefft = '/dev/x'\n", ["ports.roboteq_lefft", "not a known key"]),
        ("[leveling]\nsettle_deg = 3.0\n", ["leveling", "settle_deg = 3.0"]),
        ("rate = = 3\n", ["not valid TOML"]),
    ],
)
def test_a_wrong_robot_toml_names_its_key_and_nothing_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: list[str]
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(text)
    result = tiger("run", "--config", str(file), "--emulate", "shaking-plate", monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert all(word in result.output for word in [*words, "robot.toml"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--virtual-time"], "--virtual-time needs --emulate SCENARIO"),
        (["--emulate", "no-such-place", "--virtual-time"], "no-such-place"),
        (["--config", "/no/such/robot.toml"], "/no/such/robot.toml: cannot be read"),
        (
            ["--emulate", "curb", "--speed", "99"],
            "--speed 99: is outside ±3 m/s (max_speed_mps under [drive])",
        ),
        (["--emulate", "curb", "--speed", "nan"], "--speed nan: is outside"),
        (["--emulate", "curb", "--speed", "0.2"], "curb drives by its own plan; leave out --speed"),
        (["--emulate", "curb", "--yaw-rate", "-91"], "--yaw-rate -91: is outside ±90 degrees/s"),
        (
            ["--emulate", "curb", "--json", "/no/such/out.json"],
            "cannot be written (there is no folder /no/such)",
        ),
        (["--emulate", "curb", "--json", "/"], "/: cannot be written (it is a folder)"),
        (["--emulate", "curb", "--seed", "-1"], "--seed"),
    ],
)
def test_a_wrong_wish_is_answered_in_one_message(
    words: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiger("run", *words, monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output


@pytest.mark.parametrize("pace", [[], ["--virtual-time"]])
def test_a_scenario_that_drives_faster_than_the_robot_may_is_refused(
    pace: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "fast.toml"
    file.write_text('title = "t"\nduration_s = 9.0\n[[drive]]\nat_s = 5.0\nspeed_mps = 30.0\n')
    result = tiger("run", "--emulate", str(file), *pace, monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert f"{file}: drive.0.speed_mps = 30: is beyond ±3, drive.max_speed_mps" in result.output


@pytest.mark.parametrize("pace", [[], ["--virtual-time"]])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("initial_stroke_mm = [99.0, 0.0, 0.0, 0.0]", "initial_stroke_mm of FL = 99 is outside 0..70"),
        ('[[fault]]\nat_s = 1.0\ntarget = "moon"\nkind = "full"', "no 'full' of 'moon'; targets are"),
    ],
)
def test_a_scenario_that_this_robot_cannot_have_is_refused_in_one_message(
    wrong: str,
    message: str,
    pace: list[str],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(f'title = "t"\nduration_s = 1.0\nmodel = "linear"\n{wrong}\n')
    result = tiger("run", "--emulate", str(file), *pace, monkeypatch=monkeypatch)
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output + capfd.readouterr().err


def test_a_robot_that_is_not_there_is_described_and_fails_only_if_it_should_have_armed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(
        f'[ports]\nboards = ["{tmp_path}/board-*"]\n'
        f'roboteq_left = "{tmp_path}/l"\nroboteq_right = "{tmp_path}/r"\n'
    )
    words = ["run", "--config", str(file), "--duration", "0.3"]
    watched = tiger(*words, monkeypatch=monkeypatch)
    assert watched.exit_code == 0
    assert watched.output.strip().splitlines()[-1].startswith("Never armed: disconnected")
    assert f"{tmp_path}/l: is not there" in watched.output
    assert tiger(*words, "--arm", monkeypatch=monkeypatch).exit_code == 1


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_a_run_over_pseudo_terminals_arms_in_real_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "out.json"
    words = ["run", "--emulate", "shaking-plate", "--duration", "20", "--json", str(file)]
    result = tiger(*words, monkeypatch=monkeypatch)
    assert result.exit_code == 0, result.output
    summary = json.loads(file.read_text())["summary"]
    assert summary["state"] == "ARMED"
    assert summary["lateness_us"]["ticks"] > 500
    assert "late by" in result.output


# --------------------------------------------------------------------------------------------------- protocol

STATE = SuspensionState(7, (35.0,) * 4, (0.0,) * 4, (0,) * 4, 1 << 13 | 1 << 9, BoardState.ARMED, 4)
HEALTH = Health(1, BoardState.FAULT, 1 << Fault.IMU_BUS, 255, 1, 2, 0, (0, 0, 0, 0, 3, 0), 0, 0, 9, 5000, 8)


def test_a_frame_is_decoded_to_text(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger("protocol", "frame", encode_message(STATE, 9).hex(" "), monkeypatch=monkeypatch)
    assert result.exit_code == 0
    assert "suspension_state (id 0x21), seq 9, node 0" in result.output
    assert "stroke_mm = 35 35 35 35" in result.output
    assert "DRIVE_ON+1, NEUTRAL_SEEN" in result.output
    assert "state = ARMED" in result.output


def test_a_capture_is_decoded_frame_by_frame_and_damage_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damaged = bytearray(encode_message(STATE, 3))
    damaged[8] ^= 4
    setpoint = SuspensionSetpoint(5, 1, (1.5, 0.0, 0.0, -1.5))
    file = tmp_path / "line.bin"
    file.write_bytes(b"boot\r\n" + encode_message(HEALTH, 1) + bytes(damaged) + encode_message(setpoint, 2))
    result = tiger("protocol", "capture", str(file), monkeypatch=monkeypatch)
    assert result.exit_code == 0
    assert "seq   1 node 1 health" in result.output
    assert "IMU_BUS" in result.output
    assert "CRC 3" in result.output
    assert "rate_mmps = 1.5 0 0 -1.5" in result.output
    assert "refused (DECODE 1, CRC 1)" in result.output


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["frame", "zz"], 2, "is not a row of hexadecimal bytes"),
        (["frame", "00010200"], 1, "no valid frame"),
        (["capture", "/no/such/file"], 2, "cannot be read"),
    ],
)
def test_what_is_no_frame_is_said(
    words: list[str], code: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiger("protocol", *words, monkeypatch=monkeypatch)
    assert result.exit_code == code
    assert message in result.output


# ----------------------------------------------------------------------------------------------------- doctor


def test_the_doctor_names_what_is_missing_with_the_next_step(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger("doctor", monkeypatch=monkeypatch)
    assert "crcmod" in result.output
    assert "SCHED_FIFO" in result.output
    if "BAD" in result.output:
        assert result.exit_code == 1


def test_a_slow_latency_timer_and_a_modem_manager_are_found(tmp_path: Path) -> None:
    device = tmp_path / "bus/usb-serial/devices/ttyUSB0"
    device.mkdir(parents=True)
    (device / "latency_timer").write_text("16\n")
    (slow,) = doctor._latency_timers(tmp_path)
    assert slow.grade is doctor.Grade.NOTE
    assert "ttyUSB0 hands bytes over after 16 ms" in slow.what
    (device / "latency_timer").write_text("1\n")
    (quick,) = doctor._latency_timers(tmp_path)
    assert quick.grade is doctor.Grade.GOOD
    (tmp_path / "123").mkdir()
    (tmp_path / "123" / "comm").write_text("ModemManager\n")
    (found,) = doctor._disturbers(tmp_path)
    assert found.grade is doctor.Grade.BAD


def test_pure_python_codecs_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_has_module", lambda name: False)
    findings = {finding.what: finding for finding in doctor._software()}
    slow = findings["crcmod runs in pure Python, 25 to 50 times slower"]
    assert slow.grade is doctor.Grade.BAD
    assert "--force-reinstall crcmod" in slow.next_step


def test_a_port_that_is_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "x").touch()
    assert "is no serial device" in doctor._port(str(tmp_path / "x"), "a board").what


def test_the_doctor_writes_what_it_found_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    findings = json.loads(tiger("doctor", "--json", "-", monkeypatch=monkeypatch).output)
    assert {finding["grade"] for finding in findings} <= {"ok", "note", "BAD"}
    assert all(finding["next_step"] for finding in findings if finding["grade"] == "BAD")


def test_a_capture_is_counted_as_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "line.bin"
    file.write_bytes(b"\0" + encode_message(HEALTH, 1) + b"garbage\0")
    report = json.loads(
        tiger("protocol", "capture", str(file), "--json", "-", monkeypatch=monkeypatch).output
    )
    assert report["messages"] == {"health": 1}
    assert sum(report["refused"].values()) == 1


def test_a_folder_is_not_taken_from_another_emulated_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["emulate", "shaking-plate", "--folder", str(tmp_path), "--duration", "0.2"]
    assert tiger(*words, monkeypatch=monkeypatch).exit_code == 0
    with (tmp_path / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        refused = tiger(*words, monkeypatch=monkeypatch)
    assert refused.exit_code == 2
    assert "another emulated robot is served there" in refused.output
