"""Roads: their printed shape, their spectrum, their coherence, and who meets them when."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.models.road import (
    ISO_ROUGHNESS_M3,
    LEFT,
    RIGHT,
    Bump,
    Step,
    iso_road,
    rear_delay_s,
    wheel_heights_m,
)


def test_bump_is_two_full_height_cosines_and_flat_elsewhere() -> None:
    bump = Bump(height=0.1, wavelength=20.0)
    assert bump.height_m([-1, 0, 10, 20, 30, 40, 41], LEFT) == pytest.approx([0, 0, 0.1, 0, 0.1, 0, 0])


def test_step_acts_on_its_lanes_only() -> None:
    kerb = Step(height=0.05, start=3.0, lanes=(RIGHT,))
    assert kerb.height_m([2.9, 3.0], RIGHT) == pytest.approx([0, 0.05])
    assert kerb.height_m([2.9, 3.0], LEFT) == pytest.approx([0, 0])


def test_class_c_is_256e_6_and_each_class_is_four_times_the_one_before() -> None:
    assert ISO_ROUGHNESS_M3["C"] == pytest.approx(256e-6)
    assert ISO_ROUGHNESS_M3["D"] == pytest.approx(4 * ISO_ROUGHNESS_M3["C"])


@pytest.mark.parametrize("road_class", ["B", "C", "E"])
def test_spectrum_follows_6_31_inside_the_band_and_vanishes_outside(road_class: str) -> None:
    """Over one period each cosine fills one bin: mean square = density x bin width."""
    period, samples = 200.0, 1000
    x = np.arange(samples) * period / samples
    road = iso_road(road_class, 1, period_m=period, band_cycles_per_m=(0.01, 1.0))
    mean_square = 2 * abs(np.fft.rfft(road.height_m(x, LEFT)) / samples) ** 2
    n = np.arange(len(mean_square)) / period
    inside = (n > 0.0099) & (n < 1.0001)
    expected = ISO_ROUGHNESS_M3[road_class] * (n[inside] / 0.1) ** -2 / period
    assert mean_square[inside] == pytest.approx(expected, rel=1e-6)
    assert mean_square[n > 1.001].max() < 1e-20


def test_a_road_is_the_same_for_the_same_seed_and_starts_without_a_step() -> None:
    x = np.linspace(-5, 20, 50)
    one, again, other = (iso_road("C", seed).height_m(x, LEFT) for seed in (5, 5, 6))
    assert one == pytest.approx(again, abs=0)
    assert abs(one - other).max() > 1e-3
    assert one[x <= 0] == pytest.approx(np.zeros((x <= 0).sum()))
    assert abs(iso_road("C", 5).height_m([0.0], LEFT)[0]) < 1e-15


@pytest.mark.parametrize("length", [0.0, 0.3, 1e9])
def test_lanes_are_as_coherent_as_asked(length: float) -> None:
    period, samples, seeds = 50.0, 100, 200
    x = np.arange(samples) * period / samples
    spectra = np.array(
        [
            [np.fft.rfft(iso_road("C", s, period_m=period, coherence_length_m=length).height_m(x, lane))]
            for s in range(seeds)
            for lane in (LEFT, RIGHT)
        ]
    ).reshape(seeds, 2, -1)
    n = np.arange(spectra.shape[2]) / period
    left, right = spectra[:, 0], spectra[:, 1]
    cross = abs((left * right.conj()).mean(0)) ** 2
    coherence = cross / (abs(left) ** 2).mean(0) / (abs(right) ** 2).mean(0)
    band = (n > 0.05) & (n < 0.8)
    assert coherence[band] == pytest.approx(np.exp(-4 * np.pi * n[band] * length), abs=0.2)


def test_rear_wheels_meet_the_road_of_their_lane_a_wheelbase_later() -> None:
    time = np.arange(0, 2, 0.005)
    tau = rear_delay_s(2.68, 10.0)
    heights = wheel_heights_m(iso_road("C", 2, coherence_length_m=1e9), time, 10.0, (0, 0, tau, tau))
    late = time >= tau
    for front, rear in ((0, 2), (1, 3)):
        assert heights[late, rear] == pytest.approx(
            np.interp(time[late] - tau, time, heights[:, front]), abs=2e-4
        )
        assert abs(heights[time < tau, rear]).max() < 1e-15
    assert abs(heights[:, 0] - heights[:, 1]).max() > 1e-3


def test_errors_say_what_to_give() -> None:
    with pytest.raises(ValueError, match="use one of A, B, C"):
        iso_road("Z")
    with pytest.raises(ValueError, match="0 < low < high"):
        iso_road("C", band_cycles_per_m=(1.0, 0.5))
    with pytest.raises(ValueError, match="speed must be positive"):
        rear_delay_s(2.0, 0.0)
