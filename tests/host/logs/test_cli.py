"""`tiger log` as a person uses it."""

from __future__ import annotations

import csv
import itertools
import json
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from typer.testing import CliRunner

from tiger.cli.log import app
from tiger.logs.export import csv_files
from tiger.logs.reader import open_log

if TYPE_CHECKING:
    from pathlib import Path

    import pytest
    from tests.host.logs.conftest import Run


def _call(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


def test_info_tells_what_happened(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "info.json"
    text = _call("info", run.folder, "--check", "--json", file)
    assert "emergency stop by command" in text
    assert "Every message, checksum and index is right." in text
    data = json.loads(file.read_text())
    assert data["ticks"] == len(run.records)
    assert [change["state"] for change in data["changes"]][-2:] == ["ARMED", "ESTOP"]
    assert data["findings"] == []
    assert json.loads(_call("info", run.folder, "--json", "-"))["ticks"] == len(run.records)


def test_plot_draws_every_sheet(run: Run, tmp_path: Path) -> None:
    _call("plot", run.folder, "--out", tmp_path)
    for name in ("attitude", "strokes", "wheels", "links"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_plot_explains_its_shades_and_keeps_the_colour_of_a_name(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    _call("plot", run.folder, "--out", tmp_path)
    for figure in drawn:
        (shades,) = figure.legends
        assert [text.get_text() for text in shades.get_texts()] == ["armed", "emergency stop"]
        colours = {(line.get_label(), line.get_color()) for axes in figure.axes for line in axes.lines}
        assert len(colours) == len({name for name, _ in colours})


def test_csv_keeps_every_digit(run: Run, tmp_path: Path) -> None:
    _call("export", "csv", run.folder, "--out", tmp_path, "--topic", "/tiger/tick")
    with (tmp_path / "tiger-tick.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["tick"]) for row in rows] == [record.tick for record in run.records]
    for row, record in zip(rows, run.records, strict=True):
        assert float(row["outputs.estimate.roll_rad"]) == record.outputs.estimate.roll_rad
        if record.inputs.strokes is not None:
            assert float(row["inputs.strokes.stroke_mm.2"]) == record.inputs.strokes.stroke_mm[2]


def test_a_topic_that_is_not_in_the_log_is_named_and_the_others_are_written(run: Run, tmp_path: Path) -> None:
    wanted = ["--topic", "/nope", "--topic", "/odom"]
    said = _call("export", "csv", run.folder, "--out", tmp_path, *wanted, code=2)
    assert "has no messages on /nope;" in said
    assert [path.name for path in tmp_path.iterdir()] == ["odom.csv"]


def test_a_log_that_grows_meanwhile_is_written_as_far_as_it_was(run: Run, tmp_path: Path) -> None:
    log, reads = open_log(run.folder), []

    class Growing:
        def messages(self, topics=None):
            reads.append(topics)
            every = log.messages(topics)
            return every if len(reads) > 1 else itertools.islice(every, 500)

    rows = csv_files(Growing(), tmp_path)
    assert sum(rows.values()) == 500


def test_the_bytes_of_a_line_are_read_by_the_capture_command(run: Run, tmp_path: Path) -> None:
    from tiger.cli.protocol import app as protocol

    _call("export", "wire", run.folder, "--out", tmp_path)
    capture = tmp_path / "wire-emulated-board_suspension-rx.bin"
    result = CliRunner().invoke(protocol, ["capture", str(capture), "--summary"])
    assert result.exit_code == 0
    assert "imu_attitude" in result.output


def test_frames_before_the_stop_are_shown_as_messages(run: Run) -> None:
    text = _call("frames", run.folder)
    assert "ESTOP" in text
    assert "imu_attitude: " in text
    assert "!G 1" in text or "?" in text


def test_replay_says_that_every_output_is_the_same(run: Run) -> None:
    assert "the same to the last bit" in _call("replay", run.folder)


def test_replay_with_another_configuration_fails_and_says_where(run: Run, tmp_path: Path) -> None:
    config = tmp_path / "robot.toml"
    config.write_text("[leveling]\nacceleration_mmps2 = 60.0\n")
    text = _call("replay", run.folder, "--config", config, code=1)
    assert "stroke_rate_mmps" in text


def test_a_wrong_path_is_one_clear_line(tmp_path: Path) -> None:
    for command in (["info"], ["plot"], ["frames"], ["replay"], ["export", "csv"], ["export", "wire"]):
        text = _call(*command, tmp_path / "none.mcap", code=2)
        assert "is not there" in text
        assert text.count("\n") == 1
