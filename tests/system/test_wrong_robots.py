"""A robot that is not as it should be: one clear message with the next step, no traceback, no motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tiger.config.robot import load_robot
from tiger.emulation.cable import Cable
from tiger.native.boards import SpeedBoard
from tiger.protocol import frame
from tiger.protocol.messages import SCHEMA_HASH, BoardKind, HelloReply
from tiger.record import Command, DaemonState
from tiger.rig.ports import PATHS

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Run

    from tiger.config.robot import RobotConfig


def messages_after(run: Run, seconds: float = 6.0) -> str:
    """Try to arm; return everything the daemon has to say. Nothing may move meanwhile."""
    run.rig.daemon.arm(seconds - 1.0)
    run.go(seconds)
    assert not run.duty.any()
    assert all(record.state is not DaemonState.ARMED for record in run.records)
    return "\n".join(str(problem) for problem in run.records[-1].problems)


def test_a_missing_board_is_named_with_where_it_was_looked_for(standing: Run) -> None:
    standing.rig.robot.cables["speed_right"].cut()
    text = messages_after(standing, 8.0)
    assert "mega_speed (right)" in text
    assert "/emulated/board-*" in text or "allowed" in text or "ports" in text


def test_a_missing_nano_is_named_with_its_wire(standing: Run) -> None:
    standing.rig.robot.nano_wire_cut = True
    text = messages_after(standing, 8.0)
    assert "nano_imu" in text
    assert "mega_suspension" in text or "wire" in text.lower()


def test_a_missing_roboteq_is_named_with_its_port(standing: Run) -> None:
    standing.rig.robot.cables["roboteq_left"].cut()
    text = messages_after(standing)
    assert "roboteq" in text
    assert PATHS["roboteq_left"] in text


def test_two_boards_of_one_kind_and_instance_are_both_named(standing: Run) -> None:
    """Both speed boards strapped left."""
    robot = standing.rig.robot
    impostor = SpeedBoard(0, uid=0x99)
    robot.speed["right"] = impostor
    robot.boards["mega_speed_right"] = impostor
    text = messages_after(standing)
    assert "mega_speed (left)" in text
    assert PATHS["speed_left"] in text
    assert PATHS["speed_right"] in text
    assert "strap" in text.lower()


def test_swapped_roboteq_ports_stop_the_drive_at_the_first_motion(standing: Run) -> None:
    paths = standing.rig.ports.paths
    left, right = PATHS["roboteq_left"], PATHS["roboteq_right"]
    paths[left], paths[right] = paths[right], paths[left]
    standing.arm()
    standing.rig.daemon.command = Command(speed_mps=0.5)
    standing.go(3.0)
    rig = standing.rig
    assert rig.daemon.state is DaemonState.FAULT
    text = "\n".join(str(problem) for problem in standing.records[-1].problems)
    assert "roboteq" in text.lower()
    assert "swap" in text.lower() or "left" in text.lower()
    assert rig.robot.drives["left"].motor_rpm == rig.robot.drives["right"].motor_rpm == (0.0, 0.0)


def test_a_roboteq_on_a_board_s_port_and_a_board_on_a_roboteq_s_port_are_told_apart(standing: Run) -> None:
    paths = standing.rig.ports.paths
    board, drive = PATHS["speed_left"], PATHS["roboteq_left"]
    paths[board], paths[drive] = paths[drive], paths[board]
    text = messages_after(standing, 8.0)
    assert drive in text


def reply_with(kind: BoardKind, instance: int, schema_hash: int) -> bytes:
    """What a board built from another spec says of itself."""
    reply = HelloReply(
        proto=1,
        node=0,
        board_kind=kind,
        instance=instance,
        board_uid=7,
        schema_hash=schema_hash,
        fw_version=(0, 0, 9),
        git=0x1234ABCD,
        dirty=0,
        reset_cause=1,
        boot_count=3,
        last_fault=0,
        uptime_ms=5000,
        host_nonce=0,
        session=1,
    )
    return frame.encode(HelloReply.ID, 0, reply.pack())


def test_another_schema_hash_names_board_both_hashes_and_the_command_that_mends_it(standing: Run) -> None:
    """An old mega_speed: it introduces itself, and its hash is another."""
    rig = standing.rig
    old = Cable()
    rig.ports.paths[PATHS["speed_left"]] = old
    old_hash = 0x0BADCAFE

    def keep_saying(run: Run, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            old.board_write(reply_with(BoardKind.MEGA_SPEED, 0, old_hash))
            run.go(0.5)

    rig.daemon.arm(5.0)
    keep_saying(standing, 6.0)
    text = "\n".join(str(problem) for problem in standing.records[-1].problems)
    assert "mega_speed" in text
    assert f"{old_hash:08x}" in text.lower()
    assert f"{SCHEMA_HASH[BoardKind.MEGA_SPEED]:08x}" in text.lower()
    assert "make flash BOARD=mega_speed" in text
    assert not standing.duty.any()


def test_a_text_banner_in_the_stream_does_not_disturb_the_boards(standing: Run) -> None:
    for name in ("suspension", "speed_left", "speed_right"):
        standing.rig.robot.cables[name].board_write(b"Arduino bootloader v2.0\r\nready.\r\n" * 5)
    standing.arm()


def test_a_port_that_talks_nonsense_is_named_as_something_else(standing: Run) -> None:
    """A GPS on a port that may hold a board."""
    rig = standing.rig
    gps = Cable()
    rig.ports.paths["/emulated/board-gps"] = gps
    for _ in range(8):
        gps.board_write(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n")
        standing.go(0.5)
    standing.arm()


def test_arming_is_refused_while_the_robot_is_commanded_to_drive(standing: Run) -> None:
    standing.rig.daemon.command = Command(speed_mps=0.5)
    text = messages_after(standing)
    assert "neutral" in text
    assert "zero" in text


def test_arming_is_refused_while_the_emergency_stop_is_pressed(standing: Run) -> None:
    standing.rig.robot.estop_pressed = True
    text = messages_after(standing)
    assert "emergency stop" in text.lower()
    assert "release" in text.lower()


def test_arming_is_refused_with_a_remedy_while_a_potentiometer_is_broken(standing: Run) -> None:
    standing.rig.robot._failures["potentiometer_rl", "open"].begin(0.0)
    text = messages_after(standing)
    assert "rear left" in text
    assert "wires" in text


def test_a_robot_without_drives_levels_without_roboteqs_and_speed_boards(
    run_of: Callable[[RobotConfig], Run],
) -> None:
    config = load_robot(None)
    run = run_of(config.model_copy(update={"drive": config.drive.model_copy(update={"enabled": False})}))
    for name in ("speed_left", "speed_right", "roboteq_left", "roboteq_right"):
        run.rig.robot.cables[name].cut()
    run.arm()


@pytest.mark.parametrize("seconds", [0.0, 1.0])
def test_nothing_moves_before_arming(standing: Run, seconds: float) -> None:
    standing.go(2.0 + seconds)
    assert not standing.duty.any()
