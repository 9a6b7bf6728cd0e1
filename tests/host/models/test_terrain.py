"""Terrain: heights where they were put, gradients that are their slopes, random ground of its class."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.models.terrain import FLAT, Terrain

x_places, y_places = st.floats(-30.0, 60.0), st.floats(-20.0, 20.0)


def composite() -> Terrain:
    from dataclasses import replace

    rough = Terrain.random("D", 3, (40.0, 16.0), spacing_m=0.2)
    ground = Terrain.slope(8.0, -4.0)
    ground = replace(ground, heights_m=rough.heights_m, corner_m=rough.corner_m, spacing_m=rough.spacing_m)
    return ground.with_bump(0.2, 2.0, 10.0, right_m=0.0, edge_m=0.3).with_plate(
        0.1, 5.0, length_m=3.0, ramp_m=0.4, left_m=2.0, edge_m=0.5
    )


COMPOSITE = composite()


@settings(deadline=None)
@given(x_places, y_places)
def test_gradient_is_the_slope_of_the_height(x: float, y: float) -> None:
    step = 1e-6
    _, slope_x, slope_y = COMPOSITE.at(x, y)
    height = COMPOSITE.at([x + step, x - step, x, x], [y, y, y + step, y - step])[0]
    # A kink (grid border, flank) within the step may lie between the two samples.
    near = COMPOSITE.at([x + step, x - step], [y + step, y - step])
    spread = np.ptp(near[1]) + np.ptp(near[2]) + 1e-6
    assert (height[0] - height[1]) / (2 * step) == pytest.approx(float(slope_x), abs=spread)
    assert (height[2] - height[3]) / (2 * step) == pytest.approx(float(slope_y), abs=spread)


@settings(deadline=None)
@given(x_places, y_places)
def test_flat_ground_is_flat(x: float, y: float) -> None:
    assert FLAT.at(x, y) == (0.0, 0.0, 0.0)


def test_slope_climbs_forward_and_to_the_left() -> None:
    height, slope_x, slope_y = Terrain.slope(climb_deg=10.0, left_up_deg=5.0).at(2.0, 3.0)
    assert height == pytest.approx(2.0 * np.tan(np.radians(10)) + 3.0 * np.tan(np.radians(5)))
    assert (slope_x, slope_y) == pytest.approx((np.tan(np.radians(10)), np.tan(np.radians(5))))


def test_twisted_ground_lifts_diagonal_corners_alike() -> None:
    height = Terrain.twisted(0.1).at([1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0])[0]
    np.testing.assert_allclose(height, [0.1, -0.1, -0.1, 0.1])


def test_bump_is_one_cosine_period_on_its_side_only() -> None:
    ground = Terrain().with_bump(0.2, 10.0, 10.0, right_m=0.0)
    x = np.array([9.9, 10.0, 12.5, 15.0, 17.5, 20.0, 20.1])
    np.testing.assert_allclose(ground.at(x, 0.8)[0], [0, 0, 0.1, 0.2, 0.1, 0, 0], atol=1e-15)
    assert not ground.at(x, -0.8)[0].any()


def test_plate_without_end_is_a_step() -> None:
    ground = Terrain().with_plate(0.1, 1.0, ramp_m=0.2)
    np.testing.assert_allclose(ground.at([0.9, 1.1, 1.2, 1e4], 0.0)[0], [0.0, 0.05, 0.1, 0.1])


def test_plate_without_ramp_is_sheer() -> None:
    ground = Terrain().with_plate(0.1, 1.0, length_m=1.0, ramp_m=0.0)
    np.testing.assert_allclose(
        ground.at([1.0 - 1e-9, 1.0 + 1e-9, 2.0 - 1e-9, 2.0 + 1e-9], 0.0)[0], [0, 0.1, 0.1, 0]
    )


def test_height_field_passes_through_its_samples() -> None:
    heights = np.random.default_rng(1).normal(size=(7, 5))
    ground = Terrain.from_heights(heights, (0.5, 0.25), (-1.0, 2.0))
    x, y = np.meshgrid(-1.0 + 0.5 * np.arange(7), 2.0 + 0.25 * np.arange(5), indexing="ij")
    np.testing.assert_allclose(ground.at(x, y)[0], heights, atol=1e-12)


def test_height_field_reproduces_a_plane_exactly_inside() -> None:
    x, y = np.meshgrid(np.arange(8.0), np.arange(6.0), indexing="ij")
    ground = Terrain.from_heights(0.3 * x - 0.2 * y, (1.0, 1.0))
    height, slope_x, slope_y = ground.at([1.3, 5.7], [1.1, 3.9])
    np.testing.assert_allclose(height, [0.3 * 1.3 - 0.2 * 1.1, 0.3 * 5.7 - 0.2 * 3.9], atol=1e-12)
    np.testing.assert_allclose(slope_x, 0.3, atol=1e-12)
    np.testing.assert_allclose(slope_y, -0.2, atol=1e-12)


def test_border_height_goes_on_outside_the_field() -> None:
    ground = Terrain.from_heights([[1.0, 2.0], [3.0, 4.0]], (1.0, 1.0))
    height, slope_x, slope_y = ground.at([-5.0, 9.0], [-5.0, 9.0])
    np.testing.assert_allclose(height, [1.0, 4.0])
    assert not slope_x.any()
    assert not slope_y.any()


def test_tracks_lie_under_their_wheels() -> None:
    left, right = np.sin(np.arange(20.0)), np.cos(np.arange(20.0))
    ground = Terrain.from_tracks(left, right, 0.5, half_track_m=0.6, start_m=2.0)
    x = 2.0 + 0.5 * np.arange(20)
    np.testing.assert_allclose(ground.at(x, 0.6)[0], left, atol=1e-12)
    np.testing.assert_allclose(ground.at(x, -0.6)[0], right, atol=1e-12)


@pytest.mark.parametrize("roughness", ["A", "E"])
def test_any_straight_cut_of_random_ground_has_the_spectrum_of_its_class(roughness: str) -> None:
    ratios = []
    for seed in range(4):
        ground = Terrain.random(roughness, seed, (200.0, 200.0), spacing_m=0.2, shortest_wave_m=0.5)
        for heights in (ground.heights_m, ground.heights_m.T):
            wave = np.fft.rfftfreq(heights.shape[0], 0.2)
            density = 2 * 0.2 / heights.shape[0] * (np.abs(np.fft.rfft(heights, axis=0)) ** 2).mean(axis=1)
            line = 16e-6 * 4.0 ** "ABCDEFGH".index(roughness) * (wave[1:] / 0.1) ** -2
            band = (wave[1:] > 0.03) & (wave[1:] < 0.4)
            ratios.append((density[1:] / line)[band].mean())
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_random_ground_repeats_with_its_seed_only() -> None:
    first, same, other = (Terrain.random("C", seed, (20.0, 10.0)).heights_m for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1e-3


@pytest.mark.parametrize("name", ["I", "a", "", "AB"])
def test_unknown_roughness_class_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="ABCDEFGH"):
        Terrain.random(name, 1)


@pytest.mark.parametrize(
    ("heights", "spacing", "reason"),
    [
        ([1.0, 2.0], (1.0, 1.0), "2 x 2"),
        ([[1.0, np.nan], [0.0, 0.0]], (1.0, 1.0), "finite"),
        ([[1.0, 2.0], [0.0, 0.0]], (0.0, 1.0), "positive"),
    ],
)
def test_unusable_height_field_is_refused(
    heights: list[object], spacing: tuple[float, float], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        Terrain.from_heights(heights, spacing)


def test_bump_without_length_is_refused() -> None:
    with pytest.raises(ValueError, match="length"):
        Terrain().with_bump(0.1, 0.0, 0.0)


def test_a_slippery_patch_takes_friction_where_it_lies_and_nothing_else() -> None:
    ground = Terrain.slope(climb_deg=5.0).with_slippery(0.2, 2.0, 3.0, right_m=-1.0, left_m=1.0)
    assert ground.grip_at([1.99, 2.01, 4.99, 5.01, 3.0], [0.0, 0.0, 0.0, 0.0, 1.01]).tolist() == [
        *(1.0, 0.2, 0.2, 1.0, 1.0)
    ]
    assert np.array_equal(ground.at(3.0, 0.0), Terrain.slope(climb_deg=5.0).at(3.0, 0.0))


def test_patches_that_overlap_multiply() -> None:
    ground = FLAT.with_slippery(0.5, 0.0, 4.0).with_slippery(0.4, 2.0, 4.0)
    assert ground.grip_at([1.0, 3.0, 5.0], 0.0) == pytest.approx([0.5, 0.2, 0.4])


def test_a_patch_without_any_friction_is_refused() -> None:
    with pytest.raises(ValueError, match=r"friction_factor = 0.0 must be above 0: 0.05 is wet ice"):
        FLAT.with_slippery(0.0, 0.0)
