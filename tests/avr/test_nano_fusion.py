"""The attitude filter on the real Nano image: it computes what the host computes, in time and in memory."""

from __future__ import annotations

import math
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tiger.native.attitude import AttitudeFilter
from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

GRAVITY = 9.80665
FIELD_UT = np.array([0.0, 20.0, -45.0])
BRIDGE_US = 50_000
CPU_BUDGET = 0.60
LEAST_RAM_BYTES = 600


@pytest.fixture
def nano(simulated: ModuleType, make_board: Callable[[str], Any]) -> Any:
    """The Mega's end of a Nano that has just been switched on, its body swaying and turning."""
    host = simulated.Host([make_board("nano_imu")], (simulated.KIND["nano_imu"],))
    time_ms = 0

    def move(ms: float) -> None:
        nonlocal time_ms
        time_ms += round(ms)
        if time_ms % 5:
            return
        before, after = (turn(1e-3 * (time_ms + shift)) for shift in (-1, 1))
        body = turn(1e-3 * time_ms)
        host.board.set_motion(
            body.inv().apply([0, 0, GRAVITY]).tolist(),
            ((before.inv() * after).as_rotvec() / 2e-3 + np.radians([0.5, -0.3, 0.4])).tolist(),
            body.inv().apply(FIELD_UT).tolist(),
        )

    host.world = move
    return host


def turn(t: float) -> Rotation:
    """Attitude of the body: at rest for two seconds, then lively."""
    lively = min(max(t - 2.0, 0.0), 1.0)
    roll = lively * (15 * math.sin(2.1 * t) + 4 * math.sin(9.0 * t))
    pitch = lively * 10 * math.sin(1.3 * t)
    return Rotation.from_euler("ZYX", [lively * 12 * (t - 2.0), pitch, roll], degrees=True)


def replay(log: list[wire.Message]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Quaternions the Nano sent, and those of the host's filter fed with the raw samples it sent."""
    raws = {m.t_us: m for m in log if isinstance(m, wire.ImuRaw)}
    own, sent = [], []
    host_filter = AttitudeFilter()
    last_us = None
    for attitude in (m for m in log if isinstance(m, wire.ImuAttitude)):
        raw = raws.get(attitude.t_us)
        if raw is None or not attitude.flags >> wire.ImuFlag.GYRO_OK & 1 or attitude.t_us == last_us:
            continue
        since_us = 0 if last_us is None else attitude.t_us - last_us
        last_us = attitude.t_us
        fresh = attitude.flags >> wire.ImuFlag.MAG_FRESH & attitude.flags >> wire.ImuFlag.MAG_OK & 1
        state = host_filter.step(
            raw.gyro_radps,
            raw.accel_mps2 if attitude.flags >> wire.ImuFlag.ACCEL_OK & 1 else None,
            raw.mag_ut if fresh else None,
            dt_s=since_us * 1e-6,
            follows_gap=since_us > BRIDGE_US,
        )
        own.append(state.quaternion)
        sent.append(attitude.quaternion)
    return np.array(sent), np.array(own)


def apart_deg(sent: NDArray[np.float64], own: NDArray[np.float64]) -> float:
    a, b = (Rotation.from_quat(np.roll(q, -1, axis=1)) for q in (sent, own))
    return float(np.degrees((a.inv() * b).magnitude()).max())


def listen(nano: Any, seconds: int) -> None:
    for _ in range(seconds):
        nano.listen(1000)  # what it sends in longer would not fit into the simulator's buffer


def test_the_image_computes_the_attitude_that_the_host_computes_from_its_raw_samples(nano: Any) -> None:
    listen(nano, 12)
    sent, own = replay(nano.log)
    assert len(sent) > 1000
    assert apart_deg(sent, own) < 0.02


@pytest.mark.proof
@pytest.mark.timeout(1800)
def test_the_image_agrees_with_the_host_over_ten_minutes(nano: Any) -> None:
    listen(nano, 600)
    sent, own = replay(nano.log)
    print(f"image and host differ by {apart_deg(sent, own):.4f} degrees at most in {len(sent)} samples")
    assert len(sent) > 59_000
    assert apart_deg(sent, own) < 0.02


def test_the_whole_nano_keeps_its_budget_of_time_and_memory(nano: Any) -> None:
    listen(nano, 4)
    nano.board.clear_statistics()
    listen(nano, 4)
    turns = nano.board.turns()
    health = [m for m in nano.log if isinstance(m, wire.Health)][-1]
    print(f"load {turns.load:.3f}, longest turn {turns.max_cycles} cycles, RAM free {health.ram_free_bytes}")
    assert turns.load <= CPU_BUDGET
    assert turns.max_cycles < 160_000  # a tick
    assert health.ram_free_bytes >= LEAST_RAM_BYTES
    assert health.overruns == 0


def test_the_filter_takes_at_most_60_k_cycles_a_tick_and_never_more_than_100_k(
    simulated: ModuleType, tmp_path: Path
) -> None:
    image = tmp_path / "nano_fusion_cost.elf"
    command = "avr-g++ -std=gnu++11 -Os -flto -mmcu=atmega328p -DF_CPU=16000000L -fno-threadsafe-statics"
    source = Path(__file__).with_name("nano_fusion_cost.cpp")
    core = Path(__file__).parents[2] / "firmware/libraries/TigerCore/src"
    subprocess.run(
        [*command.split(), "-Wall", "-Wextra", f"-I{core}", source, "-o", image, "-lm"], check=True
    )
    board = simulated.Board("nano_imu", image)
    try:
        said = b""
        for _ in range(100):
            board.run_ms(100)
            said += board.receive()
            if len(said) == 8:
                break
    finally:
        board.close()
    mean, worst = struct.unpack("<II", said)
    print(f"attitude filter: {mean} cycles a tick in the mean, {worst} at worst")
    assert mean <= 60_000
    assert worst <= 100_000
