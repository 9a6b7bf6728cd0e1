"""Wheels on loose soil: Bekker's sinkage, Janosi-Hanamoto's shear, and the vehicle that stands on both."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.errors import ConfigError
from tiger.config.tire import load_soil, load_tire_set
from tiger.config.vehicle import load_vehicle
from tiger.models.soil import SoilContact, sinkage_of_load, sinkage_of_tire
from tiger.models.terrain import Terrain
from tiger.models.vehicle import Inputs, Vehicle

TIGER = load_vehicle("tiger")
SAND, LOAM = load_soil("dry-sand"), load_soil("sandy-loam")
CONTACT = SoilContact.from_config(SAND, load_tire_set(), TIGER.tire)
RADIUS_M = TIGER.tire.rolling_radius_m
WIDTH_M = 0.205 * RADIUS_M / 0.313
LOAD_N = 196.0

loads = st.floats(1.0, 5000.0)


def test_sinkage_is_bekkers() -> None:
    z = CONTACT.sinkage_m(LOAD_N)
    stiffness = SAND.cohesive_modulus_npm / WIDTH_M + SAND.frictional_modulus_npm2
    n = SAND.sinkage_exponent
    carried = (3 - n) / 3 * WIDTH_M * stiffness * np.sqrt(2 * RADIUS_M) * z ** (n + 0.5)
    assert carried == pytest.approx(LOAD_N, rel=1e-9)


def test_compaction_resistance_is_the_work_of_pressing_one_metre_of_rut() -> None:
    z = CONTACT.sinkage_m(LOAD_N)
    depth = np.linspace(0.0, z, 20_001)
    stiffness = SAND.cohesive_modulus_npm / WIDTH_M + SAND.frictional_modulus_npm2
    work = WIDTH_M * np.trapezoid(stiffness * depth**SAND.sinkage_exponent, depth)
    assert CONTACT.compaction_resistance_n(LOAD_N) == pytest.approx(work, rel=1e-6)


def test_shear_force_is_the_integral_of_janosi_hanamoto_along_the_patch() -> None:
    slip, z = 0.3, CONTACT.sinkage_m(LOAD_N)
    length = np.sqrt(2 * RADIUS_M * z)
    x = np.linspace(0.0, length, 20_001)
    pressure = LOAD_N / (WIDTH_M * length)
    strength = SAND.cohesion_pa + pressure * np.tan(np.radians(SAND.friction_angle_deg))
    shear = strength * (1.0 - np.exp(-slip * x / SAND.shear_modulus_m))
    assert CONTACT.forces(LOAD_N, slip, 0.0)[0] == pytest.approx(WIDTH_M * np.trapezoid(shear, x), rel=1e-6)


@settings(deadline=None)
@given(loads, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_shear_never_exceeds_the_soils_strength_and_opposes_the_sliding(
    load: float, kappa: float, tan_alpha: float
) -> None:
    fx, fy = CONTACT.forces(load, kappa, tan_alpha)
    length = np.sqrt(2 * RADIUS_M * CONTACT.sinkage_m(load))
    strength = WIDTH_M * length * SAND.cohesion_pa + load * np.tan(np.radians(SAND.friction_angle_deg))
    assert np.hypot(fx, fy) <= strength * (1.0 + 1e-9)
    assert fx * kappa >= 0.0
    assert fy * tan_alpha <= 0.0
    assert fx * tan_alpha == pytest.approx(-fy * kappa, rel=1e-9, abs=1e-9)


@settings(deadline=None)
@given(loads)
def test_small_slip_series_joins_the_exact_form(load: float) -> None:
    below, above = (CONTACT.forces(load, k, 0.0)[0] / k for k in (1e-7, 1e-2))
    assert below >= above > 0.5 * below
    assert CONTACT.forces(load, 0.0, 0.0) == (0.0, 0.0)


@settings(deadline=None)
@given(st.floats(1e-6, 0.3), st.floats(1e3, 1e6))
def test_tyre_and_soil_in_series_carry_the_same_load(compression: float, stiffness: float) -> None:
    row = CONTACT.parameters[0]
    z = sinkage_of_tire(row, stiffness, compression)
    assert 0.0 < z < compression
    assert sinkage_of_load(row, stiffness * (compression - z)) == pytest.approx(z, rel=1e-6)


def test_wheel_clear_of_the_ground_does_not_sink() -> None:
    assert sinkage_of_tire(CONTACT.parameters[0], 30e3, -0.01) == 0.0


@settings(deadline=None)
@given(loads, st.floats(1.01, 3.0))
def test_heavier_wheels_sink_deeper(load: float, factor: float) -> None:
    assert CONTACT.sinkage_m(load * factor) > CONTACT.sinkage_m(load)


def test_drawbar_pull_grows_with_slip_and_starts_below_zero() -> None:
    pull = [CONTACT.drawbar_pull_n(LOAD_N, slip) for slip in (0.0, 0.1, 0.3, 1.0)]
    assert pull[0] < 0.0
    assert pull == sorted(pull)


def test_unknown_soil_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="dry-sand"):
        load_soil("moon")


# ---- on the vehicle ------------


def test_tiger_sinks_into_sand_as_far_as_its_wheel_load_says() -> None:
    vehicle = Vehicle(TIGER, soil=SAND)
    state = vehicle.settle(vehicle.at_rest())
    readings = vehicle.sense(state, Inputs())
    expected = [CONTACT.sinkage_m(load) for load in readings.wheel_load_n]
    np.testing.assert_allclose(readings.sinkage_m, expected, rtol=1e-6)
    assert readings.wheel_load_n.sum() == pytest.approx((41.22 + 4 * 9.67) * 9.80665, rel=1e-3)


def climb(soil: str | None, climb_deg: float, seconds: float = 4.0) -> float:
    vehicle = Vehicle(TIGER, Terrain.slope(climb_deg), soil=load_soil(soil) if soil else None)
    state = vehicle.settle(vehicle.at_rest(), 2.0)
    inputs = Inputs()
    inputs.wheel_speed_radps[:] = 0.5 / RADIUS_M
    start = state[0]
    vehicle.step(state, inputs, 1e-3, round(seconds / 1e-3))
    return float(state[0] - start)


def test_loose_slope_costs_ground_that_a_road_does_not() -> None:
    road, sand = climb(None, 12.0), climb("dry-sand", 12.0)
    assert road > 1.3
    assert sand < 0.8 * road


def test_slope_steeper_than_the_soil_holds_cannot_be_climbed() -> None:
    assert climb("dry-sand", 30.0) < 0.0
