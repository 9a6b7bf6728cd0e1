"""Class of the ground's roughness (ISO 8608) from the vertical acceleration of the body and its speed.

A road of index G = Gd(n0), n0 = 0.1 cycles/m, has the spectrum G (n/n0)^-2 along each track. At speed v the
acceleration of the IMU, band-passed by B, then has the power G I(v), with the sum over both tracks in

    I(v) = integral sum |B(f) (H_front(f) + H_rear(f) exp(-i 2 pi f L/v))|^2 n0^2 v/f^2 df.

H is that of the 7-DOF car (4.9) from the height under a wheel to the vertical acceleration at the IMU, with a
payload's mass; L is the wheelbase, for the rear wheels run in the tracks of the front ones. The two tracks
are taken as independent. I is tabulated at start-up. The estimate of G is the power measured over the power
that G = 1 would give, both summed over the way with a memory in metres. A class is a factor of four.

The band holds the body's own swing and leaves the hopping of the wheels out, which on rough ground take off
and are no linear car.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.models.full_car import ROAD, FullCarParameters, full_car
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
_FREQUENCIES_HZ = np.linspace(0.2, 20.0, 1500)

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
    speeds = np.arange(_SPEED_STEP_MPS, _FASTEST_MPS + _SPEED_STEP_MPS, _SPEED_STEP_MPS)
    rows = []
    for payload_kg in np.arange(0.0, _HEAVIEST_KG + _PAYLOAD_STEP_KG, _PAYLOAD_STEP_KG):
        front, rear = _from_wheels(robot, parameters, float(payload_kg))
        rows.append(tuple(_power(parameters, front * response, rear * response, float(v)) for v in speeds))
    first, second = ((float(b0), float(b1), float(b2), float(a1), float(a2)) for b0, b1, b2, _, a1, a2 in sos)
    return RoughnessDesign(config, (first, second), tuple(rows))


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
    expected = keep * state.expected + time_s * _expected(design, speed, estimate.loads.payload_kg)
    distance = state.distance_m + way
    found = _roughness(measured / expected) if distance >= config.distance_m else _UNKNOWN
    return RoughnessState(imu.t_s, memory, measured, expected, distance, found), found


_LONGEST_S = 0.1
"""Between two samples of the IMU; a longer gap counts as this."""


def _roughness(index_m3: float) -> Roughness:
    """Index and class; the limits of a class are a factor of two from its geometric mean."""
    if index_m3 <= 0.0:
        return Roughness(0.0, 0)
    number = round(0.5 * math.log2(index_m3 / _SMOOTHEST_M3))
    return Roughness(index_m3, min(len(CLASSES) - 1, max(0, number)))


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


def _expected(design: RoughnessDesign, speed_mps: float, payload_kg: float) -> float:
    """I(v) by interpolation."""
    table = design.power_per_m3
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


def _from_wheels(robot: RobotConfig, parameters: FullCarParameters, payload_kg: float) -> tuple[Array, Array]:
    """Response (n,) of the IMU's vertical acceleration to the height under a front and a rear wheel."""
    from dataclasses import replace

    loaded = replace(parameters, body_mass_kg=parameters.body_mass_kg + payload_kg)
    car = full_car(loaded, robot.vehicle.imu_offset_m[:2]).select(
        inputs=ROAD, outputs=("imu_heave_accel_mps2",)
    )
    resolvents = 2j * np.pi * _FREQUENCIES_HZ[:, None, None] * np.eye(len(car.a)) - car.a
    response = (car.c @ np.linalg.solve(resolvents, np.broadcast_to(car.b, (len(resolvents), *car.b.shape))))[
        :, 0
    ]
    response = response + car.d[0]
    return response[:, 0], response[:, 2]


def _power(parameters: FullCarParameters, front: Array, rear: Array, speed_mps: float) -> float:
    """I(v): both tracks alike, so twice the left one."""
    f = _FREQUENCIES_HZ
    late = np.exp(-2j * np.pi * f * parameters.wheelbase_m / speed_mps)
    density = 2.0 * np.abs(front + rear * late) ** 2 * REFERENCE_CYCLES_PER_M**2 * speed_mps / f**2
    return float(np.trapezoid(density, f))
