"""Runs a procedure: the state machine on one side, station and person on the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.calibration import parameters
from tiger.calibration.person import measured
from tiger.calibration.procedure import (
    Ask,
    CalibrationError,
    Confirm,
    Inputs,
    Measure,
    Procedure,
    Result,
    State,
    Turn,
    step,
)
from tiger.protocol.messages import BoardKind

if TYPE_CHECKING:
    from tiger.calibration.person import Person
    from tiger.calibration.station import Station

PERMISSION = (
    "The suspension will be armed and all four actuators will move, each time you are told so. "
    "Keep hands and feet clear, the emergency stop within reach. May it move?"
)


def run(procedure: Procedure, station: Station, person: Person) -> Result:
    """Go through a procedure; nothing is stored by it. Raises CalibrationError."""
    station.connect(BoardKind.MEGA_SUSPENSION, procedure.board)
    before = parameters.read(station, procedure.board)
    outside = _Outside(station, person)
    state, answer = State(), None
    while True:
        messages = station.advance()
        inputs = Inputs(station.clock.now_s(), messages, station.stroke_mm, answer, before)
        state, turn = step(procedure, state, inputs)
        person.show(turn)
        if turn.result is not None:
            return turn.result
        answer = outside.answer(turn) if turn.ask is not None else None


class _Outside:
    """Does what a state machine asks for."""

    def __init__(self, station: Station, person: Person) -> None:
        self._station = station
        self._person = person
        self._may_move = False

    def answer(self, turn: Turn) -> tuple[float, ...]:
        ask: Ask | None = turn.ask
        if isinstance(ask, Confirm):
            self._person.confirm(ask)
        elif isinstance(ask, Measure):
            return measured(self._person, ask)
        elif ask is not None:
            self._may_move = self._may_move or self._person.permit(PERMISSION)
            if not self._may_move:
                raise CalibrationError("not permitted to move; leave out --arm to do it by hand")
            self._station.move(
                ask.stroke_mm, lambda text: self._person.show(Turn(turn.progress, f"{turn.text}: {text}"))
            )
        return ()
