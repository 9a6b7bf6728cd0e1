"""The observer's accuracy, by a definition that is stated."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.control.ride import ImuNoise
from tiger.studies import observer, ride_cases

CAR = ride_cases.load_case("table-6-1").car
ROAD = ride_cases.bumpy_road()


def test_accuracy_readings() -> None:
    truth = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    fit, vaf, of_peak = observer.accuracy(truth * 0.9, truth)
    assert fit == pytest.approx([0.9])
    assert vaf == pytest.approx([0.99])
    assert of_peak == pytest.approx([0.9])


def test_bumpy_road_without_offset_and_with_20_percent_uncorrected_and_corrected() -> None:
    noise = ImuNoise()
    offset = (0.2 * CAR.com_to_front_axle_m, 0.2 * CAR.half_track_m)
    passage = observer.Passage("bumpy", CAR, ROAD, observer.SWELL, ride_cases.BUMPY_PREVIEW_S, noise, 3)
    fits = {}
    for name, at, believed in (
        ("centred", (0.0, 0.0), (0.0, 0.0)),
        ("ignored", offset, (0.0, 0.0)),
        ("known", offset, offset),
    ):
        imu, truth = passage.drive(at)
        fits[name] = observer.accuracy(passage.observe(imu, believed), truth)[0]
    assert (fits["centred"] >= [0.985, 0.96, 0.9]).all()
    assert fits["ignored"][0] == pytest.approx(0.778, abs=0.02)
    assert (fits["known"] >= [0.95, 0.94, 0.86]).all()


def test_wrong_initial_state_is_forgotten_within_0_3_s() -> None:
    rows, _ = observer._initial_state(CAR, ImuNoise(), 0)
    assert len(rows) == 3
    assert all(row.value <= 0.3 for row in rows)


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_study_prints_every_offset_and_finds_it() -> None:
    value = {row.name: row.value for row in observer.run().rows}
    for road in ("bumpy", "iso"):
        assert abs(value[f"{road} offset estimated, x error"]) <= 5
        assert abs(value[f"{road} offset estimated, y error"]) <= 5
    assert value["bumpy r_m 20 % with estimated offset heave fit"] >= 0.95
