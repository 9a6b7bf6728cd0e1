"""The emulated serial line and its noise."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.emulation.cable import Cable, LineNoise, NoisyLine


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_a_clean_cable_carries_every_byte_in_order_both_ways(chunks: list[bytes]) -> None:
    cable = Cable()
    for chunk in chunks:
        cable.host_write(chunk)
        cable.board_write(chunk)
    assert cable.board_read() == b"".join(chunks)
    assert cable.host_read() == b"".join(chunks)
    assert cable.host_read() == b""
    assert cable.damaged_bytes == 0


@pytest.mark.parametrize("kind", ["flip", "drop", "insert", "duplicate"])
def test_noise_damages_at_the_rate_asked_for(kind: str) -> None:
    line = NoisyLine(LineNoise(**{kind: 0.01}), seed=1)
    count = 200_000
    out = line.carry(bytes(count))
    assert line.damaged_bytes == pytest.approx(0.01 * count, rel=0.1)
    length = {"flip": 0, "drop": -1, "insert": 1, "duplicate": 1}[kind] * line.damaged_bytes
    assert len(out) == count + length


def test_noise_is_the_same_for_the_same_seed_and_not_for_another() -> None:
    def noisy(seed: int) -> bytes:
        return NoisyLine(LineNoise.everything(0.05), seed).carry(bytes(range(256)) * 4)

    assert noisy(3) == noisy(3)
    assert noisy(3) != noisy(4)


def test_a_cut_cable_loses_what_was_under_way_and_carries_again_once_mended() -> None:
    cable = Cable()
    cable.host_write(b"lost")
    cable.cut()
    cable.host_write(b"lost too")
    cable.board_write(b"and this")
    assert (cable.board_read(), cable.host_read()) == (b"", b"")
    cable.mend()
    cable.host_write(b"kept")
    assert cable.board_read() == b"kept"


def test_a_silent_cable_stays_open_but_carries_nothing() -> None:
    cable = Cable()
    cable.is_silent = True
    cable.host_write(b"lost")
    assert not cable.is_cut
    assert cable.board_read() == b""
