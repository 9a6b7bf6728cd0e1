"""Class of the ground's roughness (ISO 8608) from the vertical acceleration of the body and its speed.

A road of index G = Gd(n0), n0 = 0.1 cycles/m, has the spectrum G (n/n0)^-2 along each track. At speed v the
acceleration of the IMU, band-passed by B, then has the power G I(v), with the sum over both tracks in

    I(v) = integral sum |B(f) (H_front(f) + H_rear(f) exp(-i 2 pi f L/v))|^2 n0^2 v/f^2 df.

H is that of the 7-DOF car (4.9) from the height under a wheel to the vertical acceleration at the IMU, with a
payload's mass; L is the wheelbase, for the rear wheels run in the tracks of the front ones. The two tracks
are taken as independent. I is tabulated at start-up. The estimate of G is the power measured over the power
that G = 1 would give, both summed over the way with a memory in metres. A class is a factor of four.

The band holds the body's own swing and leaves the hopping of the wheels out. On rough ground at speed the
wheels take off, and the body swings more than a linear car: by 1 + gain (u - from), u the RMS variation of
the wheel loads over the load at rest that a linear car would have on this G at this speed. What is measured
is divided by that.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tiger.frozen import dataclass
from tiger.models.full_car import ROAD, TIRE, FullCarParameters, full_car
from tiger.models.road import ISO_ROUGHNESS_M3, REFERENCE_CYCLES_PER_M
from tiger.record import Roughness

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig, RoughnessConfig
    from tiger.record import Estimate, Inputs

    Array = NDArray[np.float64]

CLASSES = "".join(ISO_ROUGHNESS_M3)
_UNKNOWN = Roughness()
_SMOOTHEST_M3 = ISO_ROUGHNESS_M3["A"]
_SPEED_STEP_MPS = 0.25
_FASTEST_MPS = 12.0
_PAYLOAD_STEP_KG = 10.0
_HEAVIEST_KG = 60.0
_FREQUENCIES_HZ = np.linspace(0.2, 20.0, 400)
_MOST_CYCLES_PER_M = 1.7
"""Shorter waves go under the tyre's print (the band of `models.road`)."""
_ROUNDS = 6

Section = tuple[float, float, float, float, float]
"""b0, b1, b2, a1, a2 of a second-order filter."""


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessDesign:
    """What `design_roughness` computes once."""

    config: RoughnessConfig
    sections: tuple[Section, Section]
    """The band-pass, at the rate of the IMU."""
    power_per_m3: tuple[tuple[float, ...], ...]
    """I(v) in (m/s2)^2 per m3: a row for each payload, a column for each speed."""
    flight_per_m3: tuple[tuple[float, ...], ...]
    """u^2 per m3, alike."""


@dataclass(frozen=True, slots=True)
class RoughnessState:
    """What a tick leaves to the next."""

    imu_t_s: float = -math.inf
    memory: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Of the two filter sections."""
    measured: float = 0.0
    expected: float = 0.0
    """Energy in the band, and what G = 1 m3 would have given, over the last metres."""
    distance_m: float = 0.0
    found: Roughness = _UNKNOWN


def design_roughness(robot: RobotConfig) -> RoughnessDesign:
    """Design the filter and tabulate the expected power, in some ten milliseconds."""
    from scipy.signal import butter, sosfreqz

    config, rate_hz = robot.roughness, robot.observer.imu_rate_hz
    sos = butter(2, config.band_hz, "bandpass", fs=rate_hz, output="sos")
    response = sosfreqz(sos, _FREQUENCIES_HZ, fs=rate_hz)[1]
    parameters = FullCarParameters.from_config(robot.vehicle)
    speeds = np.arange(_SPEED_STEP_MPS, _FASTEST_MPS + _SPEED_STEP_MPS, _SPEED_STEP_MPS).tolist()
    power, flight = [], []
    for payload_kg in np.arange(0.0, _HEAVIEST_KG + _PAYLOAD_STEP_KG, _PAYLOAD_STEP_KG).tolist():
        loaded = replace(parameters, body_mass_kg=parameters.body_mass_kg + payload_kg)
        body, tyre = _responses(loaded, robot.vehicle.imu_offset_m[:2])
        power.append(tuple(_power(loaded, body * response[:, None], v) for v in speeds))
        flight.append(tuple(_power(loaded, tyre, v) for v in speeds))
    first, second = ((float(b0), float(b1), float(b2), float(a1), float(a2)) for b0, b1, b2, _, a1, a2 in sos)
    return RoughnessDesign(config, (first, second), tuple(power), tuple(flight))


def step(
    design: RoughnessDesign, state: RoughnessState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[RoughnessState, Roughness]:
    """Advance with each new sample of the IMU; `estimate` has odometry and loads of this tick."""
    imu = inputs.imu
    if imu is None or imu.t_s <= state.imu_t_s:
        return state, state.found
    passed, memory = _filtered(design.sections, state.memory, imu.linear_accel_mps2[2])
    config, speed = design.config, abs(estimate.odometry.speed_mps)
    if speed < config.min_speed_mps or state.imu_t_s == -math.inf:
        kept = RoughnessState(imu.t_s, memory, state.measured, state.expected, state.distance_m, state.found)
        return kept, state.found
    time_s = min(_LONGEST_S, imu.t_s - state.imu_t_s)
    way = speed * time_s
    keep = max(0.0, 1.0 - way / config.memory_m)
    measured = keep * state.measured + time_s * (passed * passed - config.noise_mps2**2)
    payload_kg = estimate.loads.payload_kg
    expected = keep * state.expected + time_s * _looked_up(design.power_per_m3, speed, payload_kg)
    distance = state.distance_m + way
    found = _UNKNOWN
    if distance >= config.distance_m:
        flight = _looked_up(design.flight_per_m3, speed, payload_kg)
        found = _roughness(_on_the_ground(config, measured / expected, flight))
    return RoughnessState(imu.t_s, memory, measured, expected, distance, found), found


_LONGEST_S = 0.1
"""Between two samples of the IMU; a longer gap counts as this."""


def _roughness(index_m3: float) -> Roughness:
    """Index and class; the limits of a class are a factor of two from its geometric mean."""
    if index_m3 <= 0.0:
        return Roughness(0.0, 0)
    number = round(0.5 * math.log2(index_m3 / _SMOOTHEST_M3))
    return Roughness(index_m3, min(len(CLASSES) - 1, max(0, number)))


def _on_the_ground(config: RoughnessConfig, index_m3: float, flight_per_m3: float) -> float:
    """Divide an index by what wheels that take off have added to it."""
    true = index_m3
    for _ in range(_ROUNDS):
        flight = math.sqrt(max(0.0, true) * flight_per_m3) - config.flight_from
        true = index_m3 / (1.0 + config.flight_gain * max(0.0, flight))
    return true


def _filtered(
    sections: tuple[Section, Section], memory: tuple[float, float, float, float], value: float
) -> tuple[float, tuple[float, float, float, float]]:
    """Pass one sample through both sections (transposed direct form II)."""
    (b0, b1, b2, a1, a2), (d0, d1, d2, c1, c2) = sections
    p, q, r, s = memory
    between = b0 * value + p
    passed = d0 * between + r
    return passed, (
        b1 * value - a1 * between + q,
        b2 * value - a2 * between,
        d1 * between - c1 * passed + s,
        d2 * between - c2 * passed,
    )


def _looked_up(table: tuple[tuple[float, ...], ...], speed_mps: float, payload_kg: float) -> float:
    """Interpolate in a table over payload and speed."""
    row, down = _place(payload_kg / _PAYLOAD_STEP_KG, len(table))
    column, right = _place(speed_mps / _SPEED_STEP_MPS - 1.0, len(table[0]))
    light, heavy = table[row], table[row + 1]
    a = light[column] + right * (light[column + 1] - light[column])
    b = heavy[column] + right * (heavy[column + 1] - heavy[column])
    return a + down * (b - a)


def _place(position: float, count: int) -> tuple[int, float]:
    index = min(count - 2, max(0, int(position)))
    return index, min(1.0, max(0.0, position - index))


# ---- design -------------------------------------------------


def _responses(car: FullCarParameters, imu_xy_m: tuple[float, float]) -> tuple[Array, Array]:
    """Responses to the heights under the four wheels: the IMU's vertical acceleration (n, 4) in m/s2 per m,
    and the load of the front left tyre (n, 4) over its load at rest."""
    model = full_car(car, imu_xy_m).select(inputs=ROAD, outputs=("imu_heave_accel_mps2", TIRE[0]))
    resolvents = 2j * np.pi * _FREQUENCIES_HZ[:, None, None] * np.eye(len(model.a)) - model.a
    response = model.c @ np.linalg.solve(resolvents, model.b[None]) + model.d
    return response[:, 0], response[:, 1] * (car.tire_stiffness_npm / float(car.static_tire_load_n()[0]))


def _power(car: FullCarParameters, response: Array, speed_mps: float) -> float:
    """Power of what answers to the four wheels by `response` (n, 4), on two tracks of 1 m3."""
    f = _FREQUENCIES_HZ
    late = np.exp(-2j * np.pi * f * car.wheelbase_m / speed_mps)
    left, right = response[:, 0] + late * response[:, 2], response[:, 1] + late * response[:, 3]
    road = np.where(f < _MOST_CYCLES_PER_M * speed_mps, REFERENCE_CYCLES_PER_M**2 * speed_mps / f**2, 0.0)
    return float(np.trapezoid((np.abs(left) ** 2 + np.abs(right) ** 2) * road, f))
