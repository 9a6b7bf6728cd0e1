"""Parameters of a board: limits, storage, and what is left after every loss of power."""

from __future__ import annotations

import pytest

from tiger.native.boards import BROWN_OUT, EXTERNAL, POWER_ON
from tiger.protocol.messages import (
    PARAMS,
    SCHEMA_HASH,
    AckStatus,
    Arm,
    BoardKind,
    Fault,
    Log,
    ParamGet,
    ParamSave,
    ParamSet,
    SuspensionState,
)

TABLE = [
    (param.index + k, param, default)
    for param in PARAMS[BoardKind.MEGA_SUSPENSION]
    for k, default in enumerate(
        param.default if isinstance(param.default, tuple) else (param.default,) * param.count
    )
]
COUNT = len(TABLE)
POT_LOW = 0
SAVE_MS = 500  # a copy takes 0.2 s


def get(rig, index):
    answer = rig.request(ParamGet(0, index))
    assert answer.status == AckStatus.OK
    return answer.value


def set_(rig, index, value):
    return AckStatus(rig.request(ParamSet(0, index, value)).status)


def save(rig):
    assert rig.request(ParamSave(0)).status == AckStatus.OK
    rig.run_ms(SAVE_MS)


def restart(rig, cause=POWER_ON):
    rig.board.reset(cause)
    rig.boot()


def test_a_new_board_has_the_defaults_of_the_spec(rig):
    for index, param, default in TABLE:
        assert get(rig, index) == round(default / param.scale), param.name
    assert rig.faults() == set()
    assert not rig.state.flags >> 15 & 1


def test_limits_are_kept_at_their_edges(rig):
    for index, param, _ in TABLE:
        low, high = round(param.min / param.scale), round(param.max / param.scale)
        before = get(rig, index)
        for value in (low - 1, high + 1):
            assert set_(rig, index, value) == AckStatus.OUT_OF_RANGE, param.name
            assert get(rig, index) == before
        for value in (low, high, before):
            assert set_(rig, index, value) == AckStatus.OK, param.name
            assert get(rig, index) == value


@pytest.mark.parametrize("index", [COUNT, 200, 255])
def test_an_index_that_does_not_exist_is_named(rig, index):
    assert rig.request(ParamGet(0, index)).status == AckStatus.BAD_INDEX
    assert set_(rig, index, 0) == AckStatus.BAD_INDEX


def test_what_was_not_saved_is_gone_after_a_reset(rig):
    set_(rig, POT_LOW, 900)
    restart(rig, EXTERNAL)
    assert get(rig, POT_LOW) == 818


def test_what_was_saved_is_there_after_a_reset(rig):
    for n in range(3):  # both copies get their turn
        set_(rig, POT_LOW, 900 + n)
        set_(rig, COUNT - 1, 9000 + n)
        save(rig)
        restart(rig)
        assert get(rig, POT_LOW) == 900 + n
        assert get(rig, COUNT - 1) == 9000 + n
        assert rig.state.flags >> 15 & 1  # calibrated
        assert rig.faults() == set()


def test_parameters_wait_while_they_are_stored(rig):
    set_(rig, POT_LOW, 900)
    rig.request(ParamSave(0))
    assert set_(rig, POT_LOW, 901) == AckStatus.BUSY
    assert rig.request(ParamSave(0)).status == AckStatus.BUSY
    rig.run_ms(SAVE_MS)
    assert set_(rig, POT_LOW, 901) == AckStatus.OK


@pytest.mark.parametrize("cause", [POWER_ON, BROWN_OUT])
def test_power_lost_at_any_moment_of_a_save_leaves_the_old_or_the_new_values(rig, cause):
    set_(rig, POT_LOW, 900)
    set_(rig, 5, 15000)
    save(rig)
    seen = set()
    for cut_ms in range(0, 260, 7):
        set_(rig, POT_LOW, 1000)
        set_(rig, 5, 15100)
        rig.request(ParamSave(0))
        rig.run_ms(cut_ms)
        restart(rig, cause)
        assert rig.faults() == set()
        pair = get(rig, POT_LOW), get(rig, 5)
        seen.add(pair)
        if pair == (1000, 15100):
            break
    assert seen == {(900, 15000), (1000, 15100)}


def test_one_damaged_copy_falls_back_to_the_other(rig):
    set_(rig, POT_LOW, 900)
    save(rig)
    set_(rig, POT_LOW, 901)
    save(rig)
    for at in range(16, 16 + 2 * (8 + 4 * COUNT), 9):
        rig.board.eeprom[at] ^= 0x10
        restart(rig)
        assert get(rig, POT_LOW) in (900, 901)
        assert rig.faults() == set()
        rig.board.eeprom[at] ^= 0x10


def test_when_both_copies_are_damaged_defaults_are_in_use_and_it_is_said(rig):
    set_(rig, POT_LOW, 900)
    save(rig)
    save(rig)
    slot = 8 + 4 * COUNT
    rig.board.eeprom[16 + 6] ^= 1
    rig.board.eeprom[16 + slot + 6] ^= 1
    restart(rig)
    assert get(rig, POT_LOW) == 818
    assert rig.faults() == {Fault.PARAMETERS}
    assert not rig.state.flags >> 15 & 1
    assert rig.clear_faults().status == AckStatus.STILL_PRESENT
    save(rig)
    assert rig.clear_faults().status == AckStatus.OK
    restart(rig)
    assert rig.faults() == set()


def test_a_cell_that_does_not_keep_its_value_is_found_after_the_save(rig):
    set_(rig, POT_LOW, 900)
    rig.request(ParamSave(0))
    worn = 16 + 8 + 4 * COUNT + 4  # a value of the copy being written

    def wear():
        rig.board.eeprom[worn] = 0

    rig.watch = wear
    rig.run_ms(SAVE_MS)
    assert rig.faults() == {Fault.PARAMETERS}


def test_calibration_changes_the_stroke_at_once(rig):
    before = rig.state.stroke_mm[0]
    assert before == pytest.approx(35.0, abs=0.05)
    set_(rig, POT_LOW, 818 - 400)
    rig.run_ms(300)
    assert rig.state.stroke_mm[0] == pytest.approx(35.0 + 400 / 15132 * 35, abs=0.1)
    assert rig.wire.last(SuspensionState).stroke_mm[1] == pytest.approx(35.0, abs=0.05)


@pytest.mark.parametrize(
    ("index", "value"),
    [(POT_LOW, 15500), (POT_LOW + 4, 900), (8, 35000), (9, 36000)],
    ids=["no span above", "no span below", "soft limits crossed", "soft limit beyond the stroke"],
)
def test_an_implausible_calibration_is_named_and_not_armed(rig, index, value):
    assert set_(rig, index, value) == AckStatus.OK
    rig.run_ms(300)
    assert rig.wire.last(Log).text == "stroke calibration is not plausible"
    session = rig.hello().session
    arm = Arm(0, SCHEMA_HASH[BoardKind.MEGA_SUSPENSION], session)
    assert rig.request(arm).status == AckStatus.NOT_READY
    restart(rig)
    assert rig.request(Arm(0, arm.schema_hash, rig.hello().session)).status == AckStatus.OK


def test_a_potentiometer_wired_the_other_way_round_is_calibrated(rig):
    set_(rig, POT_LOW, 15550)
    set_(rig, POT_LOW + 4, 818)
    rig.read_pot = lambda corner, counts: 1023.0 - counts if corner == 0 else counts
    rig.run_ms(100)
    rig.clear_faults()
    rig.run_ms(300)
    assert rig.state.stroke_mm[0] == pytest.approx(35.0, abs=0.1)
    rig.arm()
    rig.rates_mmps = (5.0, 0.0, 0.0, 0.0)
    rig.run_ms(1000)
    assert rig.state.stroke_mm[0] == pytest.approx(rig.strokes_mm[0], abs=0.15)
    assert rig.strokes_mm[0] > 39.0
