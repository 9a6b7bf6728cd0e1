"""Frozen dataclasses of the tick: as those of the standard library, but for the guard and its price."""

from __future__ import annotations

import dataclasses
import pickle
from dataclasses import dataclass

import pytest

from tiger.frozen import replace
from tiger.record import Command, Estimate, Inputs, Loads, Odometry, Outputs


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


def test_equal_fields_make_equal_records_with_equal_hashes() -> None:
    assert Command(speed_mps=1.0) == replace(Command(), speed_mps=1.0) != Command()
    assert len({Command(speed_mps=1.0), replace(Command(), speed_mps=1.0), Command()}) == 2


def test_a_field_that_does_not_exist_cannot_be_set() -> None:
    with pytest.raises(AttributeError):
        Command().sped_mps = 1.0  # type: ignore[attr-defined]


def test_a_record_survives_pickling() -> None:
    record = Estimate(ready=True, odometry=Odometry(x_m=1.0))
    assert pickle.loads(pickle.dumps(record)) == record


def test_a_guarded_class_is_refused_by_the_quick_copy() -> None:
    @dataclass(frozen=True, slots=True)
    class Guarded:
        value: int

    with pytest.raises(TypeError, match=r"Guarded guards its fields: .* tiger.frozen"):
        replace(Guarded(1), value=2)


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
