"""Broken logs are read as far as they go, and every flaw is named."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from tiger.logs.doctor import examine
from tiger.logs.errors import LogError
from tiger.logs.reader import open_log

if TYPE_CHECKING:
    from pathlib import Path

    from tests.host.logs.conftest import Run

CHUNK_OPCODE = 6
MAGIC_BYTES = 8


@pytest.fixture
def whole(run: Run) -> bytes:
    (file,) = open_log(run.folder).files
    return file.path.read_bytes()


def _chunks(data: bytes) -> list[tuple[int, int]]:
    """Start and end of every chunk."""
    at, found = MAGIC_BYTES, []
    while at < len(data) - MAGIC_BYTES:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == CHUNK_OPCODE:
            found.append((at, at + 9 + length))
        at += 9 + length
    return found


@pytest.mark.parametrize("share", [0.1, 0.37, 0.5, 0.9, 0.999])
def test_a_log_cut_anywhere_gives_all_ticks_of_its_whole_chunks(
    run: Run, whole: bytes, tmp_path: Path, share: float
) -> None:
    cut = int(len(whole) * share)
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[:cut])
    log = open_log(path)
    read = [record for _, record in log.records()]
    assert read == run.records[: len(read)]
    if sum(end <= cut for _, end in _chunks(whole)):
        assert read
    assert log.robot() == run.rig.config
    assert any("no footer" in finding for finding in examine(path))


def test_a_log_cut_at_every_byte_near_a_chunks_end_can_be_read(
    run: Run, whole: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "cut.mcap"
    _, end = _chunks(whole)[0]
    for cut in range(end - 20, end + 20):
        path.write_bytes(whole[:cut])
        log = open_log(path)
        assert bool([1 for _ in log.records()]) == (cut >= end)


def test_a_damaged_chunk_is_left_out_and_named(run: Run, whole: bytes, tmp_path: Path) -> None:
    start, end = _chunks(whole)[1]
    damaged = bytearray(whole)
    damaged[(start + end) // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    log = open_log(path)
    read = [record.tick for _, record in log.records()]
    assert 0 < len(read) < len(run.records)
    assert read[-1] == run.records[-1].tick
    assert any("chunk" in text for text in log.damage)
    assert examine(path)


def test_a_wrong_byte_in_the_summary_is_found(whole: bytes, tmp_path: Path) -> None:
    footer_at = len(whole) - MAGIC_BYTES - 29
    summary_start = struct.unpack_from("<Q", whole, footer_at + 9)[0]
    damaged = bytearray(whole)
    damaged[(summary_start + footer_at) // 2] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    assert any("summary" in finding for finding in examine(path))


def test_a_file_that_is_no_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("These are not the bytes you are looking for.")
    with pytest.raises(LogError, match="no MCAP file"):
        list(open_log(path).messages())
    path.write_bytes(b"")
    with pytest.raises(LogError, match="no MCAP file"):
        list(open_log(path).messages())


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is not there"):
        open_log(tmp_path / "nothing.mcap")
    with pytest.raises(LogError, match="holds no logs"):
        open_log(tmp_path)


def test_a_folder_means_its_newest_log(run: Run, whole: bytes, tmp_path: Path) -> None:
    for name in ("tiger-20260101-000000-000", "tiger-20260102-000000-000", "tiger-20260102-000000-001"):
        (tmp_path / f"{name}.mcap").write_bytes(whole)
    names = [file.path.stem for file in open_log(tmp_path).files]
    assert names == ["tiger-20260102-000000-000", "tiger-20260102-000000-001"]


def test_an_independent_reader_decodes_every_message(run: Run) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    (file,) = open_log(run.folder).files
    with file.path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        topics = {"/tiger/tick", "/imu/data", "/joint_states", "/diagnostics", "/tiger/fault"}
        decoded = list(reader.iter_decoded_messages(topics=topics, log_time_order=False))
    ticks = [message.decoded_message for message in decoded if message.channel.topic == "/tiger/tick"]
    assert [tick.tick for tick in ticks] == [record.tick for record in run.records]
    last = run.records[-1].inputs.imu
    assert last is not None
    assert tuple(ticks[-1].inputs.imu[0].quaternion) == last.quaternion
    assert {message.channel.topic for message in decoded} == topics


def test_whoever_watches_is_told_which_part_was_read(run: Run) -> None:
    log = open_log(run.folder)
    parts: list[float] = []
    log.watch(parts.append)
    assert sum(1 for _ in log.records()) == len(run.records)
    assert parts == sorted(parts)
    assert parts == sorted(parts)
    assert 0.0 < parts[0] < 0.5
    assert parts[-1] == pytest.approx(1.0, abs=1e-3)  # what ends a file is not a record
