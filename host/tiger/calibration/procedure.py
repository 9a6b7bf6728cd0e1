"""The state machine of a calibration: ask, gather while everything is still, measure, and at last solve.

    procedure = accel_procedure()
    state, turn = step(procedure, State(), Inputs(now_s))
    # turn.ask: what only the outside can do; its answer goes into the next Inputs
    # turn.result: what was found

A calibration is a list of stages. In each the robot is brought into a pose (`Confirm` by a person, `Move` by
itself), readings are gathered until a window of them passes the stage's check, and a person may be asked to
measure something. The windows of all stages are then solved. No clock, no I/O: time comes with the inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tiger.protocol.messages import BoardKind, Message
    from tiger.record import Four

Array = NDArray[np.float64]
Values = Mapping[str, tuple[float, ...]]
"""Parameters of a board by name, in physical units."""

SETTLE_S = 0.5  # readings taken sooner after a pose was reached are not used
PATIENCE_S = 30.0  # beyond the window itself


class CalibrationError(Exception):
    """A calibration that cannot be done; the message says what is wrong and the next step."""


@dataclass(frozen=True, slots=True)
class Confirm:
    """A person must do something and say when it is done; the rest says it to the emulated person."""

    text: str
    up: tuple[float, float, float] | None = None  # axis of the sensor that must point up
    turn_deg: float | None = None  # heading of the robot, against where it stood


@dataclass(frozen=True, slots=True)
class Move:
    """All four actuators must go to these strokes; only with the leave of a person."""

    stroke_mm: Four


class What(Enum):
    """Kind of a measurement."""

    STROKES = "strokes"  # mm, FL FR RL RR
    DISTANCE = "distance"  # m, from the mark
    BEYOND = "beyond"  # degrees beyond full turns

    @property
    def count(self) -> int:
        """How many numbers it gives."""
        return 4 if self is What.STROKES else 1


def never(values: tuple[float, ...]) -> str | None:
    """No number is wrong."""
    return None


@dataclass(frozen=True, slots=True)
class Measure:
    """A person must measure something and type the numbers."""

    text: str
    what: What
    wrong: Callable[[tuple[float, ...]], str | None] = never
    """Why these numbers cannot be, and the next step; None when they can."""


Ask = Confirm | Move | Measure


@dataclass(frozen=True, slots=True)
class Stage:
    """One pose of a calibration; what is None is left out."""

    name: str
    gather_s: float
    check: Callable[[Array], str | None]
    """What is wrong with a window of readings (N, channels), and the next step; None when it is good."""
    pose: Confirm | Move | None = None
    measure: Measure | None = None


@dataclass(frozen=True, slots=True)
class Window:
    """What one stage gathered: readings (N, channels), the strokes meanwhile, and what was measured."""

    readings: Array
    stroke_mm: Four | None = None
    measured: tuple[float, ...] = ()

    @property
    def mean(self) -> Array:
        """Mean of each channel."""
        return np.asarray(self.readings.mean(axis=0))


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of a result: a figure, and what it is held against."""

    name: str
    value: float
    unit: str
    limit: float | None = None
    good: bool = True


@dataclass(frozen=True, slots=True)
class Result:
    """What a calibration found."""

    findings: tuple[Finding, ...]
    parameters: Values = field(default_factory=dict)
    """What is to be stored on the board."""
    notes: tuple[str, ...] = ()
    """What the user should know before storing it."""
    series: Mapping[str, list[list[float]]] = field(default_factory=dict)
    """Points for plots and --json."""


@dataclass(frozen=True, slots=True)
class Procedure:
    """A calibration of one board."""

    name: str
    board: BoardKind
    stages: tuple[Stage, ...]
    channels: Callable[[Message], tuple[float, ...] | None]
    """The readings in a message of the board; None in one that does not matter."""
    solve: Callable[[tuple[Window, ...], Values], Result]
    """From one window per stage and the parameters in force; raises CalibrationError."""


class Phase(Enum):
    """Where a stage stands."""

    POSE = "pose"
    GATHER = "gather"
    MEASURE = "measure"
    END = "end"


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Between two steps."""

    stage: int = 0
    phase: Phase = Phase.POSE
    since_s: float = 0.0
    readings: tuple[tuple[float, ...], ...] = ()  # time and channels
    window: Window | None = None
    windows: tuple[Window, ...] = ()
    complaint: str = ""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What has happened since the last step."""

    now_s: float
    messages: tuple[tuple[float, Message], ...] = ()  # time of the sample, message
    stroke_mm: Four | None = None
    answer: tuple[float, ...] | None = None  # to what was asked; empty for a confirmation or a move
    parameters: Values = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Turn:
    """What a step wants or tells."""

    progress: float  # of the whole, 0 to 1
    text: str = ""
    ask: Ask | None = None
    result: Result | None = None


def step(procedure: Procedure, state: State, inputs: Inputs) -> tuple[State, Turn]:
    """Advance the calibration. Raises CalibrationError when it cannot go on."""
    if state.phase is Phase.END:
        return state, Turn(1.0, result=procedure.solve(state.windows, inputs.parameters))
    stage = procedure.stages[state.stage]
    return _PHASES[state.phase](procedure, stage, state, inputs)


def _pose(procedure: Procedure, stage: Stage, state: State, inputs: Inputs) -> tuple[State, Turn]:
    if stage.pose is not None and inputs.answer is None:
        return state, Turn(_progress(procedure, state), stage.name, ask=stage.pose)
    state = replace(state, phase=Phase.GATHER, since_s=inputs.now_s, readings=(), complaint="")
    return state, Turn(_progress(procedure, state), stage.name)


def _gather(procedure: Procedure, stage: Stage, state: State, inputs: Inputs) -> tuple[State, Turn]:
    new = [
        (t_s, *channels)
        for t_s, message in inputs.messages
        if t_s >= state.since_s + SETTLE_S and (channels := procedure.channels(message)) is not None
    ]
    readings = (*state.readings, *new)
    span_s = readings[-1][0] - readings[0][0] if readings else 0.0
    text = f"{stage.name}: {state.complaint}" if state.complaint else stage.name
    turn = Turn(_progress(procedure, state, span_s / stage.gather_s), text)
    if span_s >= stage.gather_s:
        window = Window(np.array(readings)[:, 1:], inputs.stroke_mm)
        complaint = stage.check(window.readings)
        if complaint is None:
            return replace(state, phase=Phase.MEASURE, window=window, readings=()), turn
        half = tuple(row for row in readings if row[0] > readings[-1][0] - stage.gather_s / 2.0)
        return _patient(stage, replace(state, readings=half, complaint=complaint), inputs), turn
    return _patient(stage, replace(state, readings=readings), inputs), turn


def _patient(stage: Stage, state: State, inputs: Inputs) -> State:
    if inputs.now_s - state.since_s <= SETTLE_S + stage.gather_s + PATIENCE_S:
        return state
    if state.complaint:
        raise CalibrationError(f"{stage.name}: {state.complaint}")
    raise CalibrationError(
        f"{stage.name}: the board sent no steady stream of readings in {inputs.now_s - state.since_s:.0f} s; "
        "run `tiger doctor`"
    )


def _measure(procedure: Procedure, stage: Stage, state: State, inputs: Inputs) -> tuple[State, Turn]:
    assert state.window is not None
    if stage.measure is not None and inputs.answer is None:
        return state, Turn(_progress(procedure, state, 1.0), stage.name, ask=stage.measure)
    window = replace(state.window, measured=inputs.answer or ())
    is_last = state.stage + 1 == len(procedure.stages)
    state = State(
        stage=state.stage if is_last else state.stage + 1,
        phase=Phase.END if is_last else Phase.POSE,
        windows=(*state.windows, window),
    )
    return state, Turn(1.0 if is_last else _progress(procedure, state), stage.name)


def _progress(procedure: Procedure, state: State, share: float = 0.0) -> float:
    return (state.stage + min(max(share, 0.0), 1.0)) / len(procedure.stages)


_PHASES = {Phase.POSE: _pose, Phase.GATHER: _gather, Phase.MEASURE: _measure}
