"""Serial ports over pseudo-terminals: nothing waits, an unplugged device is an error, and errors teach."""

from __future__ import annotations

import contextlib
import errno
import os
import pty
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from tiger.devices.ports import SerialPort, SerialPorts, port_problem
from tiger.devices.suspension import RATE_MAX_MMPS, setpoint
from tiger.protocol.messages import SuspensionSetpoint


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    for descriptor in (master, slave):
        with contextlib.suppress(OSError):
            os.close(descriptor)


def test_bytes_go_both_ways_without_waiting(line: tuple[int, str]) -> None:
    master, path = line
    port = SerialPort(path, 250_000)
    assert port.read() == b""
    os.write(master, b"hello\x00")
    time.sleep(0.02)
    assert port.read() == b"hello\x00"
    port.write(b"\x00answer")
    assert os.read(master, 100) == b"\x00answer"
    assert port.backlog == 0
    port.close()


def test_a_device_that_takes_nothing_keeps_the_bytes_then_fails(line: tuple[int, str]) -> None:
    _, path = line
    port = SerialPort(path, 250_000)

    def flood() -> None:
        for _ in range(100_000):
            port.write(b"x" * 100)

    with pytest.raises(OSError, match="takes no more"):
        flood()
    assert port.backlog > 0
    port.close()


def test_an_unplugged_device_is_an_error(line: tuple[int, str]) -> None:
    master, path = line
    port = SerialPort(path, 250_000)
    os.close(master)

    def use() -> None:
        for _ in range(3):
            port.write(b"x")
            port.read()

    with pytest.raises(OSError):  # noqa: PT011  which errno depends on the driver
        use()
    port.close()


def test_a_port_is_for_one_program(line: tuple[int, str]) -> None:
    _, path = line
    port = SerialPort(path, 250_000)
    with pytest.raises(OSError) as error:  # noqa: PT011
        SerialPort(path, 250_000)
    assert "in use by another program" in str(port_problem(path, error.value))
    port.close()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "usermod -aG dialout"),
        (errno.ENOENT, "is not there. Connect the device, or correct its path under [ports]."),
        (errno.EIO, "was unplugged. Plug it in again."),
        (errno.EBUSY, "fuser -v /dev/x"),
        (12345, "does not work"),
    ],
)
def test_every_failure_names_the_port_and_the_next_step(number: int, words: str) -> None:
    problem = str(port_problem("/dev/x", OSError(number, "reason")))
    assert problem.startswith("/dev/x")
    assert words in problem


def test_only_matching_devices_are_present(tmp_path: Path) -> None:
    for name in ("board-a", "board-b", "other"):
        (tmp_path / name).touch()
    ports = SerialPorts()
    assert ports.present([f"{tmp_path}/board-*"]) == [f"{tmp_path}/board-a", f"{tmp_path}/board-b"]
    assert ports.present([f"{tmp_path}/none*"]) == []


def test_a_link_is_the_device_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "device").touch()
    (tmp_path / "link").symlink_to(tmp_path / "device")
    assert SerialPorts().same(str(tmp_path / "link"), str(tmp_path / "device"))


def test_the_rate_limit_is_the_one_of_the_spec() -> None:
    fastest = setpoint((99.0, -99.0, 1.0, 0.0), True, 1.0)
    assert fastest.rate_mmps == (RATE_MAX_MMPS, -RATE_MAX_MMPS, 1.0, 0.0)
    low, high = next(limits[2:] for limits in SuspensionSetpoint._LIMITS if limits[0] == "rate_mmps[0]")
    assert (low / 1000, high / 1000) == (-RATE_MAX_MMPS, RATE_MAX_MMPS)
    assert SuspensionSetpoint.unpack(fastest.pack()) == fastest


def test_setpoints_carry_the_host_clock_in_milliseconds() -> None:
    assert setpoint((0.0,) * 4, False, 70.0).host_ms == 70_000 - 65_536
