"""The state machine that all calibrations of a board share: pure, so it is stepped by hand here."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.calibration.procedure import (
    PATIENCE_S,
    SETTLE_S,
    CalibrationError,
    Confirm,
    Inputs,
    Measure,
    Procedure,
    Result,
    Stage,
    State,
    Turn,
    What,
    step,
)
from tiger.protocol.messages import BoardKind, Log, LogLevel

POSE = Confirm("do something")
RULER = Measure("measure it", What.DISTANCE)


def reading(value: str) -> Log:
    return Log(0, LogLevel.INFO, value)


def procedure(check=lambda readings: None, stages: int = 1, pose=POSE, measure=None) -> Procedure:
    """Readings are the texts of LOG messages; the result holds all windows."""
    return Procedure(
        "test",
        BoardKind.NANO_IMU,
        tuple(Stage(f"stage {k}", 1.0, check, pose, measure) for k in range(stages)),
        lambda message: (float(message.text),),
        lambda windows, before: Result((), {"means": tuple(float(w.mean[0]) for w in windows)}),
    )


class Play:
    """Steps a procedure at 100 Hz and answers what is asked."""

    def __init__(self, subject: Procedure) -> None:
        self.subject, self.state, self.now_s = subject, State(), 0.0
        self.asked: list[object] = []

    def step(self, value: str | None = "1", answer: tuple[float, ...] | None = None) -> Turn:
        self.now_s += 0.01
        messages = () if value is None else ((self.now_s, reading(value)),)
        self.state, turn = step(self.subject, self.state, Inputs(self.now_s, messages, None, answer))
        return turn

    def run(self, seconds: float, value: str | None = "1", answers: tuple[float, ...] = ()) -> Turn:
        turn = Turn(0.0)
        for _ in range(round(seconds * 100)):
            answer = None
            if turn.ask is not None:
                self.asked.append(turn.ask)
                answer = answers if isinstance(turn.ask, Measure) else ()
            turn = self.step(value, answer)
            if turn.result is not None:
                break
        return turn


def test_nothing_is_gathered_before_the_pose_is_confirmed() -> None:
    play = Play(procedure())
    for _ in range(500):
        assert play.step().ask is POSE
    assert play.state.readings == ()


def test_readings_while_things_settle_are_not_used() -> None:
    play = Play(procedure())
    play.step()
    play.step("1000", answer=())
    play.run(SETTLE_S - 0.02, "1000")
    turn = play.run(3.0, "1")
    assert turn.result is not None
    assert turn.result.parameters["means"] == (1.0,)


def test_each_stage_asks_gathers_and_measures_in_its_turn() -> None:
    play = Play(procedure(stages=3, measure=RULER))
    turn = play.run(20.0, answers=(12.5,))
    assert turn.result is not None
    assert play.asked == [POSE, RULER] * 3
    assert [window.measured for window in play.state.windows] == [(12.5,)] * 3


def test_progress_never_falls_and_ends_at_one() -> None:
    play, seen, turn = Play(procedure(stages=2)), [0.0], Turn(0.0)
    while turn.result is None:
        turn = play.step(answer=() if turn.ask else None)
        seen.append(turn.progress)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_a_window_that_fails_its_check_is_gathered_again() -> None:
    def check(readings):
        return "it shakes; keep still" if np.ptp(readings) else None

    play = Play(procedure(check))
    play.step()
    play.step(answer=())
    play.run(1.0)
    play.run(1.0, "2")
    assert "it shakes" in play.step("2").text
    turn = play.run(5.0, "2")
    assert turn.result is not None
    assert turn.result.parameters["means"] == (2.0,)


def test_a_check_that_never_passes_ends_it_with_the_reason() -> None:
    play = Play(procedure(lambda readings: "it shakes; keep still"))
    with pytest.raises(CalibrationError, match="stage 0: it shakes; keep still"):
        play.run(PATIENCE_S + 5.0)


def test_a_silent_board_ends_it_with_the_next_step() -> None:
    play = Play(procedure())
    with pytest.raises(CalibrationError, match=r"no steady stream .*tiger doctor"):
        play.run(PATIENCE_S + 5.0, value=None)


def test_a_finished_calibration_stays_finished() -> None:
    play = Play(procedure(pose=None))
    first = play.run(5.0).result
    assert first is not None
    assert play.step().result == first
