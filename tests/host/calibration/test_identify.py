"""What a log says of how the body answers its strokes, and what it cannot say."""

from __future__ import annotations

import json
import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from typer.testing import CliRunner

from tiger.calibration.identify import (
    FROM_STROKES,
    MODES,
    SAMPLE_S,
    Identification,
    IdentifyError,
    Recording,
    _longest_stretch,
    identify,
    read,
)
from tiger.cli.commands import app
from tiger.config.robot import RobotConfig, load_robot
from tiger.daemon.daemon import Daemon
from tiger.emulation.scenarios import Scenario
from tiger.logs.reader import open_log
from tiger.logs.session import LogSession
from tiger.models.eam import Eam
from tiger.record import Command, Mode
from tiger.rig.virtual import Rig

if TYPE_CHECKING:
    from pathlib import Path


def tiger(monkeypatch: pytest.MonkeyPatch, *words: str) -> Any:
    """Run a command line: the list of commands looks at the real one."""
    monkeypatch.setattr(sys, "argv", ["tiger", *words])
    return CliRunner().invoke(app, list(words))


LEVEL_GROUND = Scenario(title="stands on level ground", duration_s=60.0, model="linear")
READY_S, POSE_S = 3.0, 2.0
ROLLS_DEG = (2, 2, -2, 2, -2, -2, 2, -2, -2, 2, 2, -2, 2, -2, 2, -2)
PITCHES_DEG = (1.5, -1.5, -1.5, 1.5, 1.5, -1.5, 1.5, 1.5, -1.5, -1.5, 1.5, -1.5, -1.5, 1.5, -1.5, 1.5)


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot()


def log_poses(folder: Path, poses: list[tuple[float, float]]) -> Path:
    """The emulated robot stands on level ground and takes poses (roll, pitch in degrees)."""
    rig = Rig(load_robot(), LEVEL_GROUND, seed=3)
    with LogSession(folder, rig.config, rig.clock, epoch_ns=1_700_000_000_000_000_000) as log:
        rig.daemon = Daemon(rig.config, log.tap(rig.ports), rig.clock)
        for record in rig.run(READY_S):
            log.record(record)
        rig.daemon.arm()
        for roll, pitch in poses:
            rig.daemon.command = Command(
                mode=Mode.POSE, roll_rad=math.radians(roll), pitch_rad=math.radians(pitch)
            )
            for record in rig.run(POSE_S):
                log.record(record)
    return folder


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of poses that change roll and pitch."""
    poses = list(zip(ROLLS_DEG, PITCHES_DEG, strict=True))
    return log_poses(tmp_path_factory.mktemp("moved"), poses)


def geometry_deg_per_mm(robot: RobotConfig) -> tuple[float, float]:
    """Roll and pitch of the body for a millimetre of difference, from the mechanism alone."""
    ratio = Eam.from_vehicle(robot.vehicle).curve().at(robot.leveling.ride_stroke_mm)[1]
    body = robot.vehicle.body
    return tuple(math.degrees(ratio / (1000.0 * d)) for d in (2 * body.half_track_m, body.wheelbase_m))  # type: ignore[return-value]


def gain(found: Identification, name: str) -> tuple[float, float, float]:
    """Measured gain, half-width and expected gain of "roll per roll"."""
    output, mode = name.split(" per ")
    (one,) = (g for g in found.gains if (g.output, g.mode) == (f"{output}_deg", mode))
    return one.measured, one.half_width, one.expected


def test_the_gains_of_the_emulated_robot_are_found_within_their_intervals(
    moved: Path, robot: RobotConfig
) -> None:
    found = identify(read(open_log(moved)), robot)
    for name, true in zip(("roll per roll", "pitch per pitch"), geometry_deg_per_mm(robot), strict=True):
        measured, half_width, expected = gain(found, name)
        assert measured == pytest.approx(true, abs=half_width)
        assert expected == pytest.approx(true, rel=0.02)
        assert half_width < 0.05 * true
    for name in ("roll per pitch", "pitch per roll"):
        measured, half_width, _ = gain(found, name)
        assert measured == pytest.approx(0.0, abs=half_width)


def test_what_the_poses_did_not_excite_is_named(moved: Path, robot: RobotConfig) -> None:
    text = "\n".join(identify(read(open_log(moved)), robot).remarks)
    assert "heave: not excited" in text
    assert "warp: not excited" in text
    assert "roll: the record does not carry its first mode" in text
    assert "above 1 Hz: not identified" in text
    assert "no shaker" in text
    assert "levelled itself" not in text


def test_the_command_prints_a_table_and_writes_json_and_a_picture(
    moved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "found.json"
    result = tiger(
        monkeypatch, "identify", str(moved), "--json", str(file), "--plots", str(tmp_path / "plots")
    )
    assert result.exit_code == 0, result.output
    assert "roll per roll" in result.output
    assert "warp: not excited" in result.output
    data = json.loads(file.read_text())
    assert {row["name"] for row in data["gains"]} >= {"roll per roll", "pitch per pitch"}
    assert data["series"]["half_width_95"][0][0][MODES.index("warp")] is None
    assert (tmp_path / "plots" / "identify.png").read_bytes().startswith(b"\x89PNG")


def test_a_log_without_motion_gives_one_clear_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tiger(monkeypatch, "identify", str(log_poses(tmp_path, [])))
    assert result.exit_code == 2
    assert "no stroke moved" in result.output
    assert "docs/identify.md" in result.output
    assert len(result.output.splitlines()) == 1


def test_a_missing_log_gives_one_clear_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = tiger(monkeypatch, "identify", str(tmp_path / "none.mcap"))
    assert result.exit_code == 2
    assert "is not there" in result.output


# ------------------------------------------------------------------------------------- records made up


def wander(modes: tuple[str, ...], seed: int = 0, seconds: float = 60.0) -> np.ndarray:
    """Strokes (n, 4) that wander in the named modes, within the actuator's rate."""
    rng = np.random.default_rng(seed)
    steps, hold = round(seconds / SAMPLE_S), 50
    moved = np.zeros((steps, len(MODES)))
    for name in modes:
        rate = np.repeat(rng.choice([-6.0, 0.0, 6.0], steps // hold + 1), hold)[:steps]
        path = np.cumsum(rate) * SAMPLE_S
        moved[:, MODES.index(name)] = 6.0 * np.sin(path / 6.0)  # folds it back into the stroke's range
    return 35.0 + moved @ np.linalg.inv(FROM_STROKES).T


def record(
    stroke_mm: np.ndarray, robot: RobotConfig, *, scale: float = 1.0, noise_deg: float = 0.05, seed: int = 0
) -> Recording:
    """The body follows the plane of the lifts, `scale` times; noise of the IMU is that of the config."""
    lift_mm = Eam.from_vehicle(robot.vehicle).curve().rise_mm(stroke_mm) @ FROM_STROKES.T
    body = robot.vehicle.body
    arms_mm = 1000.0 * np.array([2 * body.half_track_m, body.wheelbase_m])
    angles = scale * np.degrees(lift_mm[:, 1:3] / arms_mm)
    rng = np.random.default_rng(seed)
    angles = angles + noise_deg * rng.standard_normal(angles.shape)
    rates = np.gradient(angles, SAMPLE_S, axis=0)
    accel = 0.02 * rng.standard_normal((len(angles), 1))
    return Recording(stroke_mm, np.hstack([angles, rates, accel]), 0.0, 0.0)


def test_heave_and_warp_that_moved_unseen_are_named(robot: RobotConfig) -> None:
    found = identify(record(wander(MODES), robot), robot)
    text = "\n".join(found.remarks)
    assert "heave: an IMU sees no ride height" in text
    assert "warp: moves nothing the IMU can see" in text
    assert {g.mode for g in found.gains} == set(MODES)


def test_modes_that_only_moved_together_are_not_told_apart(robot: RobotConfig) -> None:
    stroke = wander(("roll",))
    stroke[:, 1:] = 35.0  # FL alone
    found = identify(record(stroke, robot), robot)
    assert len({g.mode for g in found.gains}) == 1
    assert sum("cannot be told from" in remark for remark in found.remarks) == len(MODES) - 1


def test_a_body_that_differs_from_its_configuration_is_found_out(robot: RobotConfig) -> None:
    found = identify(record(wander(("roll", "pitch")), robot, scale=1.1), robot)
    own = [g for g in found.gains if g.output.startswith(g.mode)]
    assert len(own) == 2
    for one in own:
        assert not one.agrees
        assert one.measured / one.expected == pytest.approx(1.1, rel=0.03)


def test_intervals_cover_the_truth_as_often_as_they_say(robot: RobotConfig) -> None:
    covered = []
    for seed in range(25):
        stroke = wander(("roll", "pitch"), seed)
        found = identify(record(stroke, robot, noise_deg=0.5, seed=seed), robot)
        covered += [g.agrees for g in found.gains]
    assert 0.88 <= np.mean(covered) <= 0.99


def test_a_mode_within_the_band_is_found(robot: RobotConfig) -> None:
    recording = record(wander(("roll",), seconds=240.0), robot, noise_deg=0.01)
    hz, damping = 1.1, 0.3
    w = 2 * math.pi * hz
    (b,), a, _ = cont2discrete(
        ([2 * damping * w, w * w], [1.0, 2 * damping * w, w * w]), SAMPLE_S, "bilinear"
    )
    recording.imu[:, 0] = lfilter(b, a, recording.imu[:, 0])
    (mode,) = identify(recording, robot).body_modes
    assert mode.axis == "roll"
    assert mode.frequency_hz == pytest.approx(hz, abs=max(mode.frequency_half_width_hz, 0.03))
    assert mode.damping == pytest.approx(damping, abs=max(mode.damping_half_width, 0.03))


def test_levelling_and_driving_are_held_against_the_figures(robot: RobotConfig) -> None:
    still = record(wander(("roll", "pitch")), robot)
    found = identify(Recording(still.stroke_mm, still.imu, levelling_s=20.0, driving_s=9.0), robot)
    text = "\n".join(found.remarks)
    assert "levelled itself for 20 s" in text
    assert "drove for 9 s" in text


def test_short_records_are_refused(robot: RobotConfig) -> None:
    with pytest.raises(IdentifyError, match=r"holds 20\.0 s .* at least 30 s"):
        identify(record(wander(("roll",), seconds=20.0), robot), robot)


@pytest.mark.parametrize(
    ("stroke", "imu", "expected"),
    [
        ([0.0, 0.4, 0.8], [0.2, 0.6, 1.0], (0.2, 0.8)),
        ([0.0, 0.4, 2.0, 2.4, 2.8], [0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8], (2.0, 2.8)),
        ([0.0, 0.4, 0.8, 1.2, 3.0, 3.4], [0.0, 0.4, 0.8, 1.2, 3.0, 3.4], (0.0, 1.2)),
        ([], [0.0, 0.4], (0.0, 0.0)),
        ([0.0, 0.4], [5.0, 5.4], (0.0, 0.0)),
    ],
)
def test_the_longest_time_without_gaps_is_taken(
    stroke: list[float], imu: list[float], expected: tuple[float, float]
) -> None:
    start, end = _longest_stretch(stroke, imu)
    assert end - start == pytest.approx(expected[1] - expected[0])
    if end > start:
        assert (start, end) == expected
