"""Parameters of a board: read, stored in its EEPROM, read back and compared."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiger.calibration.procedure import CalibrationError, Values
from tiger.protocol.messages import NODE, PARAMS, ClearFaults, Fault, Param, ParamGet, ParamSave, ParamSet

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tiger.calibration.station import Station
    from tiger.protocol.messages import BoardKind

_DAMAGED = 1 << Fault.PARAMETERS


def read(station: Station, kind: BoardKind) -> dict[str, tuple[float, ...]]:
    """All parameters in force on a board, in physical units."""
    node = NODE[kind]
    return {
        param.name: tuple(
            station.call(kind, ParamGet(node, param.index + k)) * param.scale for k in range(param.count)
        )
        for param in PARAMS[kind]
    }


def store(station: Station, kind: BoardKind, values: Values) -> None:
    """Set, save and verify; the board itself reads its EEPROM back and checks the CRC.

    Raises CalibrationError: a value outside its limits (nothing is set then), a refusal, a save that failed.
    """
    node = NODE[kind]
    wanted = list(counts(kind, values))
    had_fault = station.faults(kind) & _DAMAGED
    for index, value in wanted:
        station.call(kind, ParamSet(node, index, value))
    station.call(kind, ParamSave(node))
    index, value = wanted[0]
    station.call(kind, ParamSet(node, index, value))  # busy until the save has ended
    station.forget_health(kind)
    if had_fault and station.faults(kind) == _DAMAGED:
        station.call(kind, ClearFaults(node))  # its cause is gone, unless the save failed
        station.forget_health(kind)
    if station.faults(kind) & _DAMAGED:
        raise CalibrationError(
            f"{kind.name.lower()}: the EEPROM does not keep the parameters; try again, else replace the board"
        )
    for index, value in wanted:
        kept = station.call(kind, ParamGet(node, index))
        if kept != value:
            raise CalibrationError(
                f"{kind.name.lower()}: parameter {index} reads {kept} after {value} was stored; try again"
            )


def counts(kind: BoardKind, values: Values) -> Iterator[tuple[int, int]]:
    """Index and counts on the wire of each value. Raises CalibrationError on one outside its limits."""
    by_name = {param.name: param for param in PARAMS[kind]}
    for name, several in values.items():
        param = by_name[name]
        for k, value in enumerate(several):
            yield param.index + k, _counts(kind, param, value)


def _counts(kind: BoardKind, param: Param, value: float) -> int:
    if not param.min <= value <= param.max:
        raise CalibrationError(
            f"{kind.name.lower()}: {param.name} = {value:g} is outside {param.min:g} to {param.max:g}; "
            "calibrate again"
        )
    return round(value / param.scale)
