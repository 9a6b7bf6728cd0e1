"""Each erratum of the printed equations 5.3-5.19 has a demand that the printed form breaks.

`test_corrected_equations_meet_the_demand` holds the model to the demands. The proof puts the printed form
back into the kernel's source, one erratum at a time, and sees the demand fail.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tiger.config.vehicle import VehicleConfig, load_vehicle
from tiger.models import tire as tire_module
from tiger.models import vehicle as vehicle_module
from tiger.models import vehicle_kernel
from tiger.models.terrain import Terrain
from tiger.models.vehicle import Inputs, Vehicle

CAR = load_vehicle("table-5-1")
SPEED = 30.0 / 3.6


def likely_car() -> VehicleConfig:
    """The car with the pitch and yaw inertia that the table most likely means."""
    update = {"pitch_inertia_kgm2": 2607.0, "yaw_inertia_kgm2": 2674.4}
    return CAR.model_copy(update={"body": CAR.body.model_copy(update=update)})


def rest_drift(seconds: float) -> float:
    vehicle = Vehicle(CAR)
    start = vehicle.at_rest()
    return float(np.abs(vehicle.step(start.copy(), Inputs(), 1e-3, round(seconds / 1e-3)) - start).max())


def pitched(degrees: float, state: np.ndarray) -> np.ndarray:
    """Tilt the body, with the wheels."""
    half = np.radians(degrees) / 2.0
    state[3:7] = [np.cos(half), 0.0, np.sin(half), 0.0]
    return state


# ---- the demands ------------


def rests_where_it_stands() -> None:
    assert rest_drift(0.5) < 1e-6


def pitch_springs_back_to_level() -> None:
    vehicle = Vehicle(CAR)
    for angle in (-1.0, 1.0):
        state = pitched(angle, vehicle.at_rest())
        state[13:17] = np.array([1.32, 1.32, -1.32, -1.32]) * np.sin(np.radians(angle))
        moment = vehicle.rate(state, Inputs())[11] * CAR.body.pitch_inertia_kgm2
        assert moment == pytest.approx(-4 * 20e3 * 1.32**2 * np.radians(angle), rel=0.05)


def braking_dives() -> None:
    vehicle = Vehicle(CAR)
    inputs = Inputs()
    inputs.wheel_torque_nm[:] = -300.0
    state = vehicle.step(vehicle.rolling(SPEED), inputs, 1e-3, 400)
    assert vehicle.sense(state, inputs).attitude_rad[1] > 1e-3


def inner_wheels_travel_slower() -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.rolling(SPEED)
    state[12] = 0.2
    kappa_rate = vehicle.rate(state, Inputs())[25:29]
    expected = 0.2 * 0.793 / CAR.tire.longitudinal_relaxation_m
    np.testing.assert_allclose(kappa_rate, np.array([1, -1, 1, -1]) * expected, rtol=1e-6)


def coasting_slows_by_rolling_resistance() -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.step(vehicle.rolling(3.0), Inputs(), 1e-3, 1000)
    later = vehicle.step(state.copy(), Inputs(), 1e-3, 1000)
    assert state[7] - later[7] == pytest.approx(0.1432, rel=1e-3)


def dampers_do_not_feel_forward_speed() -> None:
    vehicle = Vehicle(CAR)
    readings = vehicle.sense(pitched(1.0, vehicle.rolling(SPEED)), Inputs())
    preload = CAR.body.mass_kg * 9.80665 / 4.0
    np.testing.assert_allclose(readings.strut_force_n, preload, rtol=1e-9)


def leaning_body_is_not_driven_by_gravity() -> None:
    vehicle, inputs = Vehicle(likely_car()), Inputs()
    inputs.lift_m[:] = [-0.03, -0.03, 0.03, 0.03]
    state = vehicle.step(vehicle.rolling(SPEED), inputs, 1e-3, 3000)
    assert vehicle.sense(state, inputs).attitude_rad[1] > np.radians(1.0)
    later = vehicle.step(state.copy(), inputs, 1e-3, 1000)
    drive = (np.hypot(*later[7:9]) - np.hypot(*state[7:9])) / 1.0
    assert drive == pytest.approx(-0.1432, abs=2e-3)


def side_force_acts_at_the_height_of_the_com() -> None:
    axle = CAR.front.model_copy(update={"unsprung_mass_kg": 1e-3})
    vehicle = Vehicle(CAR.model_copy(update={"front": axle, "rear": axle}))
    for rise in (-0.05, 0.0, 0.05):
        state = vehicle.rolling(SPEED)
        state[2] += rise
        state[13:17] -= rise
        straight = vehicle.rate(state, Inputs())[10]
        state[29:33] = 0.05
        sliding = vehicle.rate(state, Inputs())[10]
        side_force = vehicle.sense(state, Inputs()).wheel_force_n[1].sum()
        moment = (sliding - straight) * CAR.body.roll_inertia_kgm2
        assert moment == pytest.approx(side_force * (CAR.body.com_height_m + rise), rel=1e-3)


def rolling_body_moves_its_contacts_sideways() -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.rolling(SPEED)
    state[10] = 0.1
    slip_rate = vehicle.rate(state, Inputs())[29:33]
    expected = 0.1 * CAR.body.com_height_m / CAR.tire.lateral_relaxation_m
    np.testing.assert_allclose(slip_rate, expected, rtol=1e-6)


def climbing_costs_speed() -> None:
    vehicle = Vehicle(CAR, Terrain.slope(5.0))
    state = vehicle.settle(vehicle.at_rest())
    state[25:33] = 0.0
    slope_pull = vehicle.step(state, Inputs(), 1e-3, 1000)[7]
    gravity = 9.80665 * np.sin(np.radians(5.0)) - 9.80665 * CAR.tire.rolling_resistance
    assert slope_pull == pytest.approx(-gravity * 1410.0 / (1410.0 + 4 * 1.2 / 0.3509**2), rel=0.03)


def tyres_do_not_pull() -> None:
    vehicle = Vehicle(CAR)
    state = vehicle.at_rest()
    state[2] += 0.3
    readings = vehicle.sense(state, Inputs())
    assert not readings.wheel_load_n.any()
    np.testing.assert_allclose(
        vehicle.rate(state, Inputs())[17:21][0], -9.80665 * (1 + 605.0 / 100.0), rtol=0.2
    )


def motors_turn_the_body_back() -> None:
    vehicle, inputs = Vehicle(CAR), Inputs()
    inputs.wheel_torque_nm[:] = 100.0
    state = vehicle.at_rest()
    state[2] += 1.0
    spin_up, pitch = vehicle.rate(state, inputs)[[21, 11]]
    assert spin_up == pytest.approx(100.0 / CAR.tire.spin_inertia_kgm2)
    assert pitch < 0.0


def drive_and_brake_slip_share_one_denominator() -> None:
    vehicle = Vehicle(CAR)
    for slip in (0.1, -0.1):
        state = vehicle.rolling(10.0)
        state[21:25] *= 1.0 + slip
        state[25:29] = slip
        np.testing.assert_allclose(vehicle.rate(state, Inputs())[25:29], 0.0, atol=1e-9)


@dataclass(frozen=True)
class Erratum:
    number: str
    demand: Callable[[], None]
    correct: str
    printed: str
    in_tire: bool = False


ERRATA = [
    Erratum(
        "1: strut force on the wheel (5.10)",
        rests_where_it_stands,
        "(qbz - strut_force) / m",
        "(qbz + strut_force) / m",
    ),
    Erratum(
        "2: pitch moment of the struts (5.16)",
        pitch_springs_back_to_level,
        "my += z * side_x - x * strut_force",
        "my += z * side_x + x * strut_force",
    ),
    Erratum(
        "2: pitch moment of F_x (5.16)",
        braking_dives,
        "my += z * side_x - x * strut_force",
        "my += -(z - v.rolling_radius) * side_x - x * strut_force",
    ),
    Erratum(
        "3: wheel speed in a turn (5.11)",
        inner_wheels_travel_slower,
        "u + q * z - r * y",
        "u + q * z + r * y",
    ),
    Erratum(
        "4: rolling resistance on the spin (5.19)",
        coasting_slows_by_rolling_resistance,
        "(tire_fx + rolling) * v.rolling_radius",
        "(tire_fx - rolling) * v.rolling_radius",
    ),
    Erratum(
        "5: damper speed (5.8)",
        dampers_do_not_feel_forward_speed,
        "v.damper[i] * (strut_rate",
        "v.damper[i] * (u * r31 + strut_rate",
    ),
    Erratum(
        "6: mass of the vertical equation (5.3c)",
        rests_where_it_stands,
        "w_dot = fz / v.mass",
        "w_dot = (fz + (mass - v.mass) * gz) / mass",
    ),
    Erratum(
        "7: gravity without the loads' share (5.4)",
        leaning_body_is_not_driven_by_gravity,
        "qbx, qby, qbz = _in_body(rotation, px, py, pz)",
        "qbx, qby, qbz = _in_body(rotation, px, py, pz)\n        qbx -= r31 * vertical",
    ),
    Erratum(
        "8: arm of the side force (5.15)",
        side_force_acts_at_the_height_of_the_com,
        "strut_force - z * side_y",
        "strut_force - (2.0 * v.wheel_height - z) * side_y",
    ),
    Erratum(
        "9: springs without preload (5.7)",
        rests_where_it_stands,
        "v.preload[i]\n",
        "0.0\n",
    ),
    Erratum(
        "12: two slip definitions (5.13)",
        drive_and_brake_slip_share_one_denominator,
        "transport = max(abs(forward_speed), ",
        "transport = max(abs(forward_speed), forward_speed + slip_speed, ",
        in_tire=True,
    ),
    Erratum(
        "14: contact velocity without roll (5.12)",
        rolling_body_moves_its_contacts_sideways,
        "+ arm * (p * hbx + q * hby + r * hbz)",
        "",
    ),
    Erratum(
        "15: no road slope force (5.4)",
        climbing_costs_speed,
        "px = -vertical * hx + ",
        "px = ",
    ),
    Erratum(
        "16: tyre that pulls (5.10)",
        tyres_do_not_pull,
        "if compression > 0.0:",
        "vertical = v.tire_stiffness * compression\n        if compression > 9.0:",
    ),
    Erratum(
        "17: no motor reaction (5.5)",
        motors_turn_the_body_back,
        "tilt * hby - torque",
        "tilt * hby",
    ),
]


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda e: e.number)
def test_corrected_equations_meet_the_demand(erratum: Erratum) -> None:
    erratum.demand()


@pytest.mark.proof
@pytest.mark.parametrize("erratum", ERRATA, ids=lambda e: e.number)
def test_printed_form_breaks_the_demand(
    erratum: Erratum, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    sources = {
        module: Path(str(module.__file__)).read_text("utf-8") for module in (tire_module, vehicle_kernel)
    }
    wrong = tire_module if erratum.in_tire else vehicle_kernel
    assert sources[wrong].count(erratum.correct) == 1, "the corrected form has moved; follow it"
    sources[wrong] = sources[wrong].replace(erratum.correct, erratum.printed)
    if erratum.in_tire:
        load("printed_tire", sources[tire_module], tmp_path, monkeypatch)
        sources[vehicle_kernel] = sources[vehicle_kernel].replace("tiger.models.tire", "printed_tire")
    kernel = load("printed_kernel", sources[vehicle_kernel], tmp_path, monkeypatch)
    monkeypatch.setattr(vehicle_module, "kernel", kernel)
    with pytest.raises(AssertionError):
        erratum.demand()


def load(name: str, source: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import `source` as a module of its own."""
    path = folder / f"{name}.py"
    path.write_text(source, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module
