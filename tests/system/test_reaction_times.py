"""Every row of the table of reaction times, on the real firmware and the real daemon in virtual time.

| event | reaction | within |
|---|---|---|
| setpoints late | motion stopped, hold | 100 ms |
| none accepted for 250 ms | outputs off, LINK_LOST latched | 300 ms |
| the AVR's program hangs | watchdog switches the outputs off, then resets | 100 ms |
| the host hangs or dies | Roboteqs command zero | 250 ms |
| fault detected on a board | its outputs off, latched, reported | 20 ms after detection |
| e-stop input | everything off | 20 ms |

And after each: what stopped stays stopped until someone arms again, from neutral.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from tiger.protocol.messages import BoardState, Fault
from tiger.record import Command, DaemonState

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Run

TILTED = Command(roll_rad=0.08)  # keeps all four actuators busy for seconds
RUNNING = Command(speed_mps=0.5)


def moving(run: Run, command: Command = TILTED) -> None:
    """Bring the robot into motion."""
    run.rig.daemon.command = command
    run.go(0.8)
    drive = run.rig.robot.suspension.drive()
    assert command.roll_rad == 0.0 or all(abs(duty) > 0.5 for duty in drive), drive


def milliseconds_until(run: Run, condition: Callable[[], bool], most_ms: int) -> int:
    """Let the emulated robot run, a millisecond at a time with the daemon's ticks between; count them."""
    rig = run.rig
    for ms in range(most_ms + 1):
        if condition():
            return ms
        rig.robot.run()
        rig.clock.set(rig.robot.time_s)
        if not rig.hung and (ms + 1) % 5 == 0:
            rig.daemon.tick(rig.robot.time_s)
    pytest.fail(f"not within {most_ms} ms")


def drives_off(run: Run) -> bool:
    return not any(run.rig.robot.suspension.drive())


def board_faults(run: Run) -> set[Fault]:
    """Faults the suspension board reports in its health."""
    health = run.rig.daemon.boards.session((1, 0)).health
    return {fault for fault in Fault if health.faults >> fault & 1}


def assert_stays_stopped(run: Run, seconds: float = 3.0) -> None:
    """Nothing may move although the command still asks for it."""
    rig = run.rig
    before = rig.robot.world.stroke_mm
    for _ in range(round(seconds / 0.005)):
        rig.tick()
        assert drives_off(run)
        assert rig.robot.drives["left"].motor_rpm == rig.robot.drives["right"].motor_rpm == (0.0, 0.0)
    # The actuators' own lag of 50 ms is all that may still move them.
    assert max(abs(a - b) for a, b in zip(before, rig.robot.world.stroke_mm, strict=True)) < 1.0


def assert_moves_again_only_after_arming(run: Run) -> None:
    """Clear what is latched, arm from neutral, and see the actuators work."""
    daemon = run.rig.daemon
    run.rig.hung = False
    daemon.command = Command()
    run.go(2.0)
    daemon.clear()
    run.go(2.5)
    assert daemon.state is not DaemonState.ARMED
    assert drives_off(run)
    run.arm(8.0)
    moving(run)


def test_setpoints_that_stop_coming_stop_the_motion_within_100_ms(armed: Run) -> None:
    moving(armed)
    armed.rig.hung = True
    assert milliseconds_until(armed, lambda: drives_off(armed), 100) >= 20


def test_no_setpoint_for_250_ms_latches_link_lost_within_300_ms(armed: Run) -> None:
    moving(armed)
    armed.rig.hung = True
    armed.rig.robot.cables["suspension"].host_read()
    for _ in range(300):
        armed.rig.robot.run()
    armed.rig.clock.set(armed.rig.robot.time_s)
    armed.rig.hung = False
    armed.go(0.3)
    assert armed.records[-1].state is DaemonState.FAULT
    assert "no setpoint accepted for 250 ms" in " ".join(str(p) for p in armed.rig.daemon.latched)
    assert_stays_stopped(armed)
    assert_moves_again_only_after_arming(armed)


def test_a_short_stall_only_holds_and_motion_goes_on_by_itself(armed: Run) -> None:
    moving(armed)
    armed.rig.hung = True
    for _ in range(24):  # 120 ms: longer than the hold, shorter than the loss
        armed.rig.tick()
    assert drives_off(armed)
    armed.rig.hung = False
    armed.go(0.5)
    assert armed.records[-1].state is DaemonState.ARMED
    assert not drives_off(armed)


def test_a_burst_of_old_setpoints_after_a_stall_moves_nothing(armed: Run) -> None:
    """A stalled host's buffer is released at once: every frame in it is newer than the last, and old."""
    moving(armed)
    rig = armed.rig
    cable = rig.robot.cables["suspension"]
    held = []
    for _ in range(40):  # for 200 ms the daemon goes on talking, and its bytes wait in some buffer
        for _ in range(5):
            rig.robot.run()
        rig.clock.set(rig.robot.time_s)
        rig.daemon.tick(rig.robot.time_s)
        held.append(cable.board_read())
    assert drives_off(armed)
    cable.host_write(b"".join(held[:28]))  # what is 60 ms old and older
    for _ in range(30):
        rig.robot.run()
        assert drives_off(armed)


@pytest.mark.parametrize("interrupts_off", [False, True])
def test_a_hung_suspension_board_is_off_within_100_ms(armed: Run, interrupts_off: bool) -> None:
    moving(armed)
    armed.rig.robot.suspension.hang(interrupts_off)
    milliseconds_until(armed, lambda: drives_off(armed), 100)
    armed.go(1.0)
    assert armed.records[-1].state is DaemonState.FAULT
    assert_stays_stopped(armed)
    assert_moves_again_only_after_arming(armed)


@pytest.mark.parametrize("board", ["nano_imu", "mega_speed_left", "mega_speed_right"])
def test_a_hung_sensor_board_stops_the_robot_and_it_stays_stopped(armed: Run, board: str) -> None:
    moving(armed)
    armed.rig.robot.boards[board].hang(interrupts_off=True)
    milliseconds_until(armed, lambda: drives_off(armed), 350)
    assert_stays_stopped(armed)
    assert_moves_again_only_after_arming(armed)


def test_a_host_that_dies_leaves_the_wheels_commanded_to_zero_within_250_ms(armed: Run) -> None:
    armed.rig.daemon.command = RUNNING
    armed.go(3.0)
    drives = armed.rig.robot.drives
    assert min(*drives["left"].motor_rpm, *drives["right"].motor_rpm) > 10.0
    armed.rig.hung = True
    milliseconds_until(armed, lambda: all(d.watchdog_expired for d in drives.values()), 250)
    for _ in range(2000):
        armed.rig.robot.run()
    assert drives["left"].motor_rpm == drives["right"].motor_rpm == (0.0, 0.0)


def test_wheels_do_not_resume_their_old_speed_when_the_host_comes_back(armed: Run) -> None:
    armed.rig.daemon.command = RUNNING
    armed.go(3.0)
    armed.rig.hung = True
    for _ in range(200):
        armed.rig.tick()
    armed.rig.hung = False
    assert_stays_stopped(armed)


@pytest.mark.parametrize("corner", ["fl", "fr", "rl", "rr"])
@pytest.mark.parametrize("kind", ["open", "short"])
def test_a_broken_potentiometer_switches_all_outputs_off_within_220_ms(
    armed: Run, corner: str, kind: str
) -> None:
    moving(armed)
    failures = armed.rig.robot._failures
    failures[f"potentiometer_{corner}", kind].begin(0.0)
    milliseconds_until(armed, lambda: drives_off(armed), 220)  # 200 ms to detect, 20 ms to act
    armed.go(0.5)
    assert Fault.POT_OPEN in board_faults(armed)
    assert corner_name(corner) in " ".join(str(p) for p in armed.records[-1].problems)
    assert_stays_stopped(armed)
    failures[f"potentiometer_{corner}", kind].end(0.0)
    assert_moves_again_only_after_arming(armed)


def corner_name(corner: str) -> str:
    return {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}[corner]


def test_emergency_stop_switches_everything_off_within_20_ms_until_a_person_releases_it(armed: Run) -> None:
    moving(armed, replace(TILTED, speed_mps=0.3))
    armed.rig.robot.estop_pressed = True
    milliseconds_until(armed, lambda: drives_off(armed), 20)
    armed.go(0.3)
    assert armed.records[-1].state is DaemonState.ESTOP
    assert_stays_stopped(armed)
    armed.rig.daemon.clear()  # still pressed: nothing to clear
    armed.go(1.0)
    assert armed.records[-1].state is DaemonState.ESTOP
    armed.rig.robot.estop_pressed = False
    assert_stays_stopped(armed)
    assert_moves_again_only_after_arming(armed)


@pytest.mark.parametrize("cable", ["suspension", "speed_left", "roboteq_right"])
def test_an_unplugged_cable_stops_the_robot_and_plugging_it_in_starts_nothing(armed: Run, cable: str) -> None:
    moving(armed)
    armed.rig.robot.cables[cable].cut()
    milliseconds_until(armed, lambda: drives_off(armed), 350)
    armed.go(0.5)
    assert armed.records[-1].state is DaemonState.FAULT
    armed.rig.robot.cables[cable].mend()
    assert_stays_stopped(armed, 6.0)
    assert_moves_again_only_after_arming(armed)


@pytest.mark.parametrize("board", ["mega_suspension", "nano_imu", "mega_speed_left"])
def test_a_board_that_resets_stops_the_robot_and_starts_nothing(armed: Run, board: str) -> None:
    moving(armed)
    armed.rig.robot.boards[board].reset()
    milliseconds_until(armed, lambda: drives_off(armed), 350)
    armed.go(1.0)
    assert armed.records[-1].state is DaemonState.FAULT
    assert_stays_stopped(armed)
    assert_moves_again_only_after_arming(armed)


def test_board_state_is_reported_as_holding_then_fault(armed: Run) -> None:
    moving(armed)
    assert armed.rig.daemon.boards.session((1, 0)).health.state is BoardState.ARMED
