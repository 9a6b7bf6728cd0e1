"""The quick `replace`: as the one of dataclasses."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import pytest

from tiger.record import Command, Estimate, Inputs, Loads, Outputs
from tiger.replace import replace


@pytest.mark.parametrize(
    ("record", "changes"),
    [
        (Estimate(), {"ready": True, "roll_rad": 0.1}),
        (Outputs(), {"reason": "because"}),
        (Command(), {"speed_mps": 1.0}),
        (Loads(), {}),
    ],
)
def test_a_changed_copy_is_that_of_dataclasses(record: object, changes: dict[str, object]) -> None:
    before = repr(record)
    changed = replace(record, **changes)
    assert changed == dataclasses.replace(record, **changes)  # type: ignore[type-var]
    assert type(changed) is type(record)
    assert changed is not record
    assert repr(record) == before


def test_a_copy_stays_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        replace(Command(), speed_mps=1.0).speed_mps = 2.0  # type: ignore[misc]


def test_a_field_that_is_not_there_is_named() -> None:
    with pytest.raises(TypeError, match="Inputs has no field 'sped'"):
        replace(Inputs(now_s=0.0, armed=False, command=Command()), sped=1.0)


def test_what_checks_itself_is_not_copied_past_its_check() -> None:
    @dataclass(frozen=True, slots=True)
    class Checked:
        value: int

        def __post_init__(self) -> None:
            assert self.value > 0

    with pytest.raises(TypeError, match="__post_init__"):
        replace(Checked(1), value=-1)
