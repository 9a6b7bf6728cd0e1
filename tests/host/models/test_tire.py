"""The Magic Formula tyre: published figures, scaling, combined slip, and a contact that knows standstill."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tiger.config.errors import ConfigError
from tiger.config.tire import TireSetConfig, load_tire_set
from tiger.config.vehicle import TireConfig, load_vehicle
from tiger.models.tire import Tire, contact_forces, contact_slip_rates

STATIC_LOAD_N = 3458.0
CAR = load_vehicle("table-5-1").tire
TIGER = load_vehicle("tiger").tire
SET = load_tire_set()

loads = st.floats(20.0, 25_000.0)
slips = st.floats(-3.0, 3.0)


def tire(config: TireConfig = CAR, **changes: float) -> Tire:
    return Tire.from_config(SET, config.model_copy(update=changes))


# ---- Table A3.1 at the car's static load ------------


def test_slip_stiffnesses_are_those_of_the_published_set() -> None:
    c_kappa, c_alpha = tire().stiffness(STATIC_LOAD_N)
    assert c_kappa == pytest.approx(72.0e3, rel=1e-3)
    assert c_alpha == pytest.approx(41.7e3, rel=1e-3)


def test_stiffness_over_the_nominal_load_is_known_without_the_model() -> None:
    over_load = load_tire_set().stiffness_per_load
    load_n = tire().parameters[0]["nominal_load"]
    assert [c / load_n for c in tire().stiffness(load_n)] == pytest.approx(over_load, rel=1e-12)


def test_stiffness_is_the_slope_of_the_force_at_zero_slip() -> None:
    c_kappa, c_alpha = tire().stiffness(STATIC_LOAD_N)
    assert tire().forces(STATIC_LOAD_N, 1e-6, 0.0)[0] == pytest.approx(c_kappa * 1e-6, rel=1e-6)
    assert tire().forces(STATIC_LOAD_N, 0.0, 1e-6)[1] == pytest.approx(-c_alpha * 1e-6, rel=1e-6)


def test_longitudinal_peak_is_1_215_at_15_percent_slip() -> None:
    slip = np.linspace(0.0, 1.0, 10_001)
    force = tire().forces(STATIC_LOAD_N, slip, 0.0)[0] / STATIC_LOAD_N
    assert force.max() == pytest.approx(1.215, abs=5e-4)
    assert slip[force.argmax()] == pytest.approx(0.150, abs=5e-4)


def test_lateral_peak_is_1_010_at_slip_of_14_7_degrees() -> None:
    slip = np.linspace(0.0, 1.0, 10_001)
    force = -tire().forces(STATIC_LOAD_N, 0.0, slip)[1] / STATIC_LOAD_N
    assert force.max() == pytest.approx(1.010, abs=5e-4)
    assert np.degrees(slip[force.argmax()]) == pytest.approx(14.7, abs=0.05)


# ---- laws ------------


@settings(deadline=None)
@given(loads, slips, slips)
def test_force_stays_within_the_friction_circle(load: float, kappa: float, tan_alpha: float) -> None:
    sweep = np.linspace(-3.0, 3.0, 601)
    grip = max(
        np.abs(tire().forces(load, sweep, 0.0)[0]).max(), np.abs(tire().forces(load, 0.0, sweep)[1]).max()
    )
    fx, fy = tire().forces(load, kappa, tan_alpha)
    assert np.hypot(fx, fy) <= 1.01 * grip


@settings(deadline=None)
@given(loads, slips, slips)
def test_mirrored_slip_gives_mirrored_force(load: float, kappa: float, tan_alpha: float) -> None:
    fx, fy = tire().forces(load, kappa, tan_alpha)
    fx_mirrored, fy_mirrored = tire().forces(load, kappa, -tan_alpha)
    assert (fx_mirrored, fy_mirrored) == (fx, -fy)
    fx_reversed, fy_reversed = tire().forces(load, -kappa, tan_alpha)
    assert (fx_reversed, fy_reversed) == (-fx, fy)


@settings(deadline=None)
@given(loads, slips, slips)
def test_force_never_drives_the_sliding_on(load: float, kappa: float, tan_alpha: float) -> None:
    fx, fy = tire().forces(load, kappa, tan_alpha)
    assert fx * kappa >= 0.0
    assert fy * tan_alpha <= 0.0


@settings(deadline=None)
@given(st.floats(0.1, 4.0), slips, slips)
def test_similar_tyres_have_the_same_force_coefficients(
    load_ratio: float, kappa: float, tan_alpha: float
) -> None:
    big = np.array(tire(CAR).forces(load_ratio * CAR.nominal_load_n, kappa, tan_alpha)) / CAR.nominal_load_n
    small = (
        np.array(tire(TIGER).forces(load_ratio * TIGER.nominal_load_n, kappa, tan_alpha))
        / TIGER.nominal_load_n
    )
    np.testing.assert_allclose(small, big, rtol=1e-9, atol=1e-12)


@settings(deadline=None)
@given(st.floats(0.05, 1.5), loads)
def test_friction_scales_the_peak_and_not_the_stiffness(friction: float, load: float) -> None:
    slip = np.linspace(0.0, 3.0, 3001)
    slippery, normal = tire(friction=friction), tire()
    peak = slippery.forces(load, slip, 0.0)[0].max()
    assert peak == pytest.approx(friction * normal.forces(load, slip, 0.0)[0].max(), rel=2e-2)
    assert slippery.stiffness(load) == normal.stiffness(load)


def test_braking_takes_grip_from_cornering() -> None:
    _, alone = tire().forces(STATIC_LOAD_N, 0.0, 0.1)
    _, shared = tire().forces(STATIC_LOAD_N, -0.2, 0.1)
    assert abs(shared) < 0.7 * abs(alone)


@pytest.mark.parametrize("load", [0.0, -5.0])
def test_wheel_in_the_air_has_no_force(load: float) -> None:
    assert tire().forces(load, 1.0, 1.0) == (0.0, 0.0)


def test_forces_broadcast() -> None:
    fx, fy = tire().forces(np.array([1000.0, 2000.0])[:, None], np.linspace(-1, 1, 5), 0.1)
    assert fx.shape == fy.shape == (2, 5)


def test_grip_stays_above_zero_far_beyond_the_measured_loads() -> None:
    slip = np.linspace(-1.0, 1.0, 201)
    assert -tire().forces(60e3, 0.0, slip)[1][-1] > 0.3 * 60e3 * abs(slip[-1]) * 0.5


# ---- the contact's lag: no division by speed ------------


def settled_slip(slip_speed: float, forward: float, side: float, duration_s: float = 50.0) -> np.ndarray:
    row = tire().parameters[0]

    def rate(_: float, slip: np.ndarray) -> tuple[float, float]:
        return contact_slip_rates(row, slip_speed, forward, side, slip[0], slip[1])

    return solve_ivp(rate, (0.0, duration_s), [0.0, 0.0], rtol=1e-9, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("forward", [10.0, -10.0])
@pytest.mark.parametrize("slip_speed", [1.0, -1.0])
def test_slip_settles_at_slip_speed_over_ground_speed_driving_and_braking(
    forward: float, slip_speed: float
) -> None:
    """Erratum of eq. 5.13: one denominator for drive and brake, the ground speed's magnitude."""
    np.testing.assert_allclose(settled_slip(slip_speed, forward, 0.5), [slip_speed / 10.0, 0.05], rtol=1e-6)


def test_relaxation_length_is_travelled_to_63_percent_of_the_slip() -> None:
    row, speed = tire().parameters[0], 10.0
    kappa, dt = 0.0, 1e-5
    for _ in range(round(CAR.longitudinal_relaxation_m / speed / dt)):
        kappa += dt * contact_slip_rates(row, 0.5, speed, 0.0, kappa, 0.0)[0]
    assert kappa == pytest.approx(0.05 * (1.0 - np.exp(-1.0)), rel=1e-3)


def test_slip_holds_at_standstill() -> None:
    assert contact_slip_rates(tire().parameters[0], 0.0, 0.0, 0.0, 0.02, -0.01) == (0.0, 0.0)


def test_wheel_spinning_in_place_reaches_the_slip_limit_and_no_more() -> None:
    kappa, tan_alpha = settled_slip(5.0, 0.0, 0.0)
    assert kappa == pytest.approx(SET.standstill.slip_limit, rel=1e-6)
    assert tan_alpha == 0.0


def test_sideways_slide_without_rolling_is_opposed_along_its_direction() -> None:
    kappa, tan_alpha = settled_slip(3.0, 0.0, 4.0)
    assert np.hypot(kappa, tan_alpha) == pytest.approx(SET.standstill.slip_limit, rel=1e-6)
    assert kappa / tan_alpha == pytest.approx(3.0 / 4.0, rel=1e-6)


def test_tread_damping_acts_at_rest_and_has_faded_at_speed() -> None:
    row, fade = tire().parameters[0], SET.standstill.damping_fades_at_mps
    at_rest = contact_forces(row, 1.0, STATIC_LOAD_N, 0.01, 0.0, 0.0, 0.0, 0.0)[0]
    assert at_rest == pytest.approx(SET.standstill.damping_nspm * 0.01, rel=1e-2)
    assert contact_forces(row, 1.0, STATIC_LOAD_N, 0.01, fade, 0.0, 0.0, 0.0) == (0.0, 0.0)


@settings(deadline=None)
@given(
    st.floats(0.0, 30e3),
    *(st.floats(-200.0, 200.0) for _ in range(3)),
    *(st.floats(-5.0, 5.0) for _ in range(2)),
)
def test_contact_is_finite_everywhere(
    load: float, slip_speed: float, forward: float, side: float, kappa: float, tan_alpha: float
) -> None:
    row = tire().parameters[0]
    assert np.isfinite(contact_forces(row, 1.0, load, slip_speed, forward, side, kappa, tan_alpha)).all()
    assert np.isfinite(contact_slip_rates(row, slip_speed, forward, side, kappa, tan_alpha)).all()


# ---- configuration ------------


def test_unknown_tyre_set_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="205_60r15"):
        load_tire_set("slick")


def test_wrong_sign_of_a_coefficient_is_refused() -> None:
    data = SET.model_dump()
    data["lateral"]["pky1"] = 14.95
    with pytest.raises(ValueError, match="pky1"):
        TireSetConfig.model_validate(data)


def test_file_that_is_not_there_is_named(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError, match=r"none\.toml"):
        load_tire_set(tmp_path / "none.toml")
