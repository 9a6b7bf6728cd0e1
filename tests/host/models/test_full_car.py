"""The seven-degree-of-freedom car against closed forms and against itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiger.config.vehicle import load_vehicle
from tiger.models.full_car import (
    BODY_ACCELERATION,
    BODY_POSITION,
    FORCE,
    IMU,
    LIFT,
    LIFT_RATE,
    ROAD,
    ROAD_RATE,
    SUSPENSION,
    TIRE,
    FullCarParameters,
    full_car,
    road_rate_form,
)
from tiger.models.linear import modes

TABLE_5_1 = FullCarParameters.from_config(load_vehicle("table-5-1"))
TABLE_6_1 = FullCarParameters.from_config(load_vehicle("table-6-1"))
CARS = pytest.mark.parametrize("car", [TABLE_5_1, TABLE_6_1], ids=["table-5-1", "table-6-1"])
positive = st.floats(0.3, 3.0)


def test_modes_of_table_6_1() -> None:
    expected = [
        (1.294, 0.138),
        (1.745, 0.127),
        (1.843, 0.095),
        (9.399, 0.269),
        (9.416, 0.258),
        (10.231, 0.306),
        (10.240, 0.302),
    ]
    assert modes(full_car(TABLE_6_1).poles()) == pytest.approx(np.array(expected), rel=1e-3, abs=6e-4)


@pytest.mark.parametrize(
    ("pitch_inertia", "expected"),
    [
        (2607.0, [1.170, 1.320, 1.373, 10.297, 10.354, 10.501, 11.027]),
        (26070.0, [0.354, 1.320, 1.373, 10.297, 10.354, 10.980, 11.027]),
    ],
)
def test_mode_frequencies_of_table_5_1(pitch_inertia: float, expected: list[float]) -> None:
    car = replace(TABLE_5_1, pitch_inertia_kgm2=pitch_inertia)
    assert modes(full_car(car).poles())[:, 0] == pytest.approx(expected, rel=1.5e-3)


def test_step_under_one_wheel_settles_where_the_plane_through_the_springs_lies() -> None:
    """FL 10 cm: corners 3h/4, h/4, h/4, -h/4; roll h/4w, pitch -h/4a (Table 5.1, a = b)."""
    h, p = 0.1, TABLE_5_1
    settled = full_car(p).select(inputs=ROAD, outputs=BODY_POSITION).static_gain() @ [h, 0, 0, 0]
    corners = p.corner_kinematics() @ settled
    assert corners == pytest.approx([0.075, 0.025, 0.025, -0.025], rel=1e-9)
    assert np.rad2deg(settled[1:]) == pytest.approx([-1.085, 1.806], rel=1e-3)


def test_step_under_one_wheel_peaks() -> None:
    car = full_car(replace(TABLE_5_1, pitch_inertia_kgm2=2607.0)).select(inputs=ROAD, outputs=BODY_POSITION)
    step = np.tile([0.1, 0, 0, 0], (4000, 1))
    body, _ = car.discretise(1e-3).simulate(step)
    corners = body @ TABLE_5_1.corner_kinematics().T
    assert corners.max(axis=0)[:3] == pytest.approx([0.0980, 0.0339, 0.0331], abs=6e-5)
    assert corners[:, 3].min() == pytest.approx(-0.0328, abs=6e-5)
    assert np.rad2deg([body[:, 2].max(), body[:, 1].min()]) == pytest.approx([2.345, -1.447], abs=1e-3)


@CARS
@pytest.mark.parametrize("shape", [(1, 0, 0), (0, 1, 0), (0, 0, 1)], ids=["heave", "pitch", "roll"])
def test_road_that_moves_as_a_plane_is_followed_without_deflection(
    car: FullCarParameters, shape: tuple[int, int, int]
) -> None:
    model = full_car(car).select(inputs=ROAD, outputs=(*BODY_POSITION, *SUSPENSION, *TIRE))
    plane = car.corner_kinematics() @ np.array(shape, float)
    assert model.static_gain() @ plane == pytest.approx([*shape, *[0.0] * 8], abs=1e-9)


@CARS
def test_force_lifts_the_body_and_lets_the_tires_share_nothing(car: FullCarParameters) -> None:
    """A force between body and wheel is internal: the tyre loads of the vehicle sum to zero."""
    model = full_car(car).select(inputs=FORCE, outputs=("heave_m", *TIRE))
    settled = model.static_gain() @ np.full(4, 100.0)
    assert settled[0] > 0
    assert settled[1:] == pytest.approx(np.zeros(4), abs=1e-9)


def test_equal_lift_of_all_strokes_raises_the_body_by_the_lift() -> None:
    model = full_car(TABLE_6_1).select(inputs=LIFT, outputs=(*BODY_POSITION, *TIRE))
    assert model.static_gain() @ np.full(4, 0.02) == pytest.approx([0.02, *[0.0] * 6], abs=1e-12)


@CARS
def test_series_stroke_acts_as_the_force_of_spring_and_damper(car: FullCarParameters) -> None:
    model = full_car(car)
    force, lift, rate = (model.select(inputs=names) for names in (FORCE, LIFT, LIFT_RATE))
    assert lift.b == pytest.approx(force.b * car.spring_npm())
    assert rate.d == pytest.approx(force.d * car.damper_nspm())


def test_imu_offset_adds_the_lever_arms_of_pitch_and_roll() -> None:
    offset = (0.3, -0.2)
    model = full_car(TABLE_6_1, offset).select(outputs=(IMU[0], *BODY_ACCELERATION))
    lever = np.array([1.0, -offset[0], offset[1]])
    assert model.c[0] == pytest.approx(lever @ model.c[1:])
    assert model.d[0] == pytest.approx(lever @ model.d[1:])


def test_road_rate_form_gives_the_same_outputs_from_the_minimal_states() -> None:
    outputs = (*IMU, *SUSPENSION, *TIRE)
    shape = full_car(TABLE_6_1).select(outputs=outputs)
    rate, gain = road_rate_form(shape)
    frequency = np.array([0.05, 1.0, 12.0])
    from_shape = shape.select(inputs=ROAD).frequency_response(frequency)
    from_rate = rate.select(inputs=ROAD_RATE).frequency_response(frequency)
    s = (2j * np.pi * frequency)[:, None, None]
    assert from_rate * s + gain == pytest.approx(from_shape, rel=1e-9, abs=1e-9)
    assert gain[:3] == pytest.approx(np.zeros((3, 4)), abs=1e-9)
    assert np.linalg.matrix_rank(gain, tol=1e-9) == 1


def test_static_tire_loads_carry_the_whole_weight() -> None:
    total = TABLE_6_1.body_mass_kg + 2 * (TABLE_6_1.front_wheel_mass_kg + TABLE_6_1.rear_wheel_mass_kg)
    assert TABLE_6_1.static_tire_load_n().sum() == pytest.approx(9.80665 * total)


@given(positive, positive, positive, positive, positive)
def test_any_damped_car_is_stable_and_its_left_mirrors_its_right(
    mass: float, pitch: float, front: float, rear: float, width: float
) -> None:
    p = TABLE_6_1
    car = replace(
        p,
        body_mass_kg=p.body_mass_kg * mass,
        pitch_inertia_kgm2=p.pitch_inertia_kgm2 * pitch,
        front_spring_npm=p.front_spring_npm * front,
        rear_damper_nspm=p.rear_damper_nspm * rear,
        half_track_m=p.half_track_m * width,
    )
    model = full_car(car).select(inputs=ROAD, outputs=BODY_ACCELERATION)
    assert model.poles().real.max() < 0
    left, right = (model.frequency_response(np.array([1.5]))[0][:, i] for i in (0, 1))
    assert left * [1, 1, -1] == pytest.approx(right, rel=1e-9)
