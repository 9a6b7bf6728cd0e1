"""Replay commands exactly what was commanded, and says so exactly when it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tiger.daemon import controller
from tiger.logs import session
from tiger.logs.checkpoint import freeze, thaw
from tiger.logs.reader import Log, open_log
from tiger.logs.replay import Replay, differences, replay
from tiger.logs.topics import Tick
from tiger.record import STILL, Outputs

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.host.logs.conftest import Run


def _tick(record) -> Tick:
    return Tick(record.tick, record.state, record.reason, record.inputs, record.outputs, record.lateness_s)


def test_a_run_that_levels_drives_and_stops_is_replayed_to_the_last_bit(run: Run) -> None:
    assert any(record.outputs.stroke_rate_mmps != STILL for record in run.records)
    assert len({record.outputs.wheel_rpm for record in run.records}) > 20
    found = replay(open_log(run.folder))
    assert found.exact
    assert (found.ticks, found.skipped, found.missing) == (len(run.records), 0, 0)


def test_one_bit_in_one_input_is_found_in_that_tick(run: Run) -> None:
    again = Replay(run.rig.config)
    changed = 1500
    for record in run.records[: changed + 1]:
        tick = _tick(record)
        if record.tick == changed:
            stroke = tuple(float(np.nextafter(s, 99.0)) for s in tick.inputs.strokes.stroke_mm)
            strokes = replace(tick.inputs.strokes, stroke_mm=stroke)
            tick = replace(tick, inputs=replace(tick.inputs, strokes=strokes))
        outputs = again.step(tick)
        found = list(differences("", tick.outputs, outputs))
        assert bool(found) == (record.tick == changed)


def test_another_configuration_is_seen_to_command_otherwise(run: Run) -> None:
    config = run.rig.config
    other = config.model_copy(
        update={"leveling": config.leveling.model_copy(update={"acceleration_mmps2": 60.0})}
    )
    found = replay(open_log(run.folder), other)
    assert not found.exact
    assert found.worst["stroke_rate_mmps[0]"] > 0.1
    assert found.first[0].tick > 500
    assert "stroke_rate_mmps" in str(found.first[0])


def test_replay_begins_in_the_middle_at_a_checkpoint(
    log_a_run: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first part is gone, as when the oldest logs gave way."""
    monkeypatch.setattr(session, "CHECKPOINT_PERIOD_NS", 100_000_000)
    again = log_a_run(tmp_path, part_mb=0.8)
    log = open_log(tmp_path)
    whole = replay(log)
    assert whole.exact
    assert whole.ticks == len(again.records)
    assert len(log.files) > 2
    for begin in range(1, len(log.files)):
        found = replay(Log([file.path for file in log.files[begin:]]))
        assert found.exact
        assert found.skipped == 0


def test_after_missing_ticks_replay_waits_for_a_state(run: Run) -> None:
    again = Replay(run.rig.config)
    assert again.step(_tick(run.records[0])) is not None
    assert again.step(_tick(run.records[5])) is None
    assert again.missing == 4


def test_a_state_survives_being_made_numbers(run: Run) -> None:
    design = controller.design_controller(run.rig.config)
    state = controller.initial_state(design)
    for record in run.records[:1200]:
        state, _ = controller.step(design, state, record.inputs, 0.005)
    numbers = freeze(state)
    again = thaw(controller.initial_state(design), numbers)
    assert freeze(again) == numbers
    inputs = run.records[1200].inputs
    assert (
        controller.step(design, again, inputs, 0.005)[1] == controller.step(design, state, inputs, 0.005)[1]
    )
    with pytest.raises(ValueError, match="too few"):
        thaw(state, numbers[:-1])
    with pytest.raises(ValueError, match="too many"):
        thaw(state, (*numbers, 0.0))


def test_what_is_not_a_number_is_equal_to_itself() -> None:
    nan = float("nan")
    assert not list(differences("", Outputs(error_rad=(nan, 0.0)), Outputs(error_rad=(nan, 0.0))))
    assert list(differences("", Outputs(error_rad=(nan, 0.0)), Outputs(error_rad=(1.0, 0.0))))
