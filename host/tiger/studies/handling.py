"""Figure 5.5: 30 km/h straight on while the yaw rate is made to follow 0.18 sin(3t).

The dissertation prescribes the motion and not what causes it, so the study does the same: at every step it
applies the yaw moment and the longitudinal force at the COM that hold yaw rate and speed, and reports their
size. The lateral response (acceleration, lag, roll, load transfer) then depends on tyres and suspension only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.vehicle import Inputs, Vehicle
from tiger.models.vehicle_kernel import BODY_MOMENT, RATE, VELOCITY
from tiger.studies.chapter5 import ASSUMPTIONS, KMH_TO_MPS, drive, load_car, peak
from tiger.studies.figures import save_panels
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from tiger.studies.report import Progress

Array = NDArray[np.float64]

_FORWARD_SPEED, _YAW_RATE = VELOCITY.start, RATE.stop - 1
_HOLD_PER_S = 20.0


def run(
    vehicle: str = "table-5-1",
    speed_kmh: float = 30.0,
    yaw_rate_amplitude_radps: float = 0.18,
    yaw_rate_frequency_radps: float = 3.0,
    periods: int = 5,
    inertia_divisor: float = 1.0,
    dt_s: float = 1e-3,
    progress: Progress = unwatched,
) -> Report:
    """Drive the sinusoid; amplitude and lag are those of the fundamental over the last two periods.

    Raises ValueError for fewer than 3 periods, ConfigError for an unknown vehicle.
    """
    if periods < 3:
        raise ValueError(f"periods = {periods}; at least 3 are needed, one to settle and two to measure")
    config = load_car(vehicle, inertia_divisor)
    plant = Vehicle(config)
    speed = speed_kmh * KMH_TO_MPS
    amplitude, frequency = yaw_rate_amplitude_radps, yaw_rate_frequency_radps
    period_s = 2.0 * np.pi / frequency

    def act(time_s: float, state: Array, inputs: Inputs) -> None:
        phase = frequency * time_s
        yaw_rate, yaw_acceleration = amplitude * np.sin(phase), amplitude * frequency * np.cos(phase)
        _hold(plant, state, inputs, speed, yaw_rate, yaw_acceleration)

    history, table = drive(plant, plant.rolling(speed), periods * period_s, dt_s, act, progress)
    series = {
        "time_s": history.time_s[:-1],
        "yaw_rate_radps": history.rate_radps[:-1, 2],
        "lateral_acceleration_mps2": history.acceleration_mps2[:-1, 1],
        "roll_deg": np.degrees(history.attitude_rad[:-1, 0]),
        "load_transfer": history.load_transfer[:-1],
        "yaw_moment_nm": table[:, BODY_MOMENT][:, 2],
        "x_m": history.position_m[:-1, 0],
        "y_m": history.position_m[:-1, 1],
    }
    mass_kg = config.body.mass_kg + 2.0 * (config.front.unsprung_mass_kg + config.rear.unsprung_mass_kg)
    grip_moment_nm = config.tire.friction * mass_kg * GRAVITY_MPS2 * config.body.half_track_m
    return Report(
        title=f"Handling: {speed_kmh:g} km/h, r = {amplitude:g} sin({frequency:g} t) rad/s",
        rows=(
            *_steady_rows(series, amplitude, frequency),
            Row("yaw moment if all grip went into it (mu m g w)", grip_moment_nm, "Nm"),
            Row("lateral path, peak to peak", float(np.ptp(history.position_m[:, 1])), "m"),
        ),
        series=series,
        assumptions={
            **ASSUMPTIONS,
            "vehicle": vehicle,
            "yaw_and_speed": "held by an ideal yaw moment and longitudinal force at the COM",
            "inertia_divisor": inertia_divisor,
            "com_height_m": config.body.com_height_m,
        },
    )


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figure 5.5: yaw rate and lateral acceleration, then roll and load transfer."""
    return [
        save_panels(
            report,
            directory / "handling.png",
            [
                ("yaw rate (rad/s)", [("yaw_rate_radps", "yaw rate")]),
                ("lateral acc. (m/s²)", [("lateral_acceleration_mps2", "lateral acceleration")]),
                ("roll (deg)", [("roll_deg", "roll")]),
                ("load transfer (-)", [("load_transfer", "load transfer")]),
            ],
        )
    ]


def _steady_rows(series: Mapping[str, Array], amplitude_radps: float, frequency_radps: float) -> list[Row]:
    """What the last two periods show."""
    time_s = series["time_s"]
    steady = time_s >= time_s[-1] - 2.0 * (2.0 * np.pi / frequency_radps)
    yaw_rate, lateral, roll, transfer, moment = (
        series[name][steady]
        for name in (
            *("yaw_rate_radps", "lateral_acceleration_mps2", "roll_deg"),
            *("load_transfer", "yaw_moment_nm"),
        )
    )
    fit = _Sinusoid(time_s[steady], frequency_radps)
    lateral_amplitude, lateral_phase = fit(lateral)
    roll_amplitude, _ = fit(roll)
    _, yaw_phase = fit(yaw_rate)
    return [
        Row("yaw rate, peak", peak(yaw_rate), "rad/s", amplitude_radps),
        Row("lateral acceleration, amplitude", lateral_amplitude, "m/s2"),
        Row("lateral acceleration, lag on yaw rate", yaw_phase - lateral_phase, "deg"),
        Row("roll, amplitude", roll_amplitude, "deg"),
        Row("load transfer, peak", peak(transfer), "-"),
        Row("yaw moment needed, peak", peak(moment), "Nm"),
    ]


def _hold(
    plant: Vehicle, state: Array, inputs: Inputs, speed: float, yaw_rate: float, yaw_acceleration: float
) -> None:
    """Set the yaw moment and longitudinal force that give the wanted accelerations (both act linearly)."""
    inputs.body_moment_nm[2] = inputs.body_force_n[0] = 0.0
    free = plant.rate(state, inputs)[[_YAW_RATE, _FORWARD_SPEED]]
    inputs.body_moment_nm[2] = 1.0
    by_moment = plant.rate(state, inputs)[[_YAW_RATE, _FORWARD_SPEED]] - free
    inputs.body_moment_nm[2], inputs.body_force_n[0] = 0.0, 1.0
    by_force = plant.rate(state, inputs)[[_YAW_RATE, _FORWARD_SPEED]] - free
    wanted = np.array(
        [
            yaw_acceleration + _HOLD_PER_S * (yaw_rate - state[_YAW_RATE]),
            _HOLD_PER_S * (speed - state[_FORWARD_SPEED]),
        ]
    )
    moment, force = np.linalg.solve(np.stack([by_moment, by_force], axis=1), wanted - free)
    inputs.body_moment_nm[2], inputs.body_force_n[0] = moment, force


class _Sinusoid:
    """Least-squares amplitude and phase (deg, of the sine) at a known frequency."""

    def __init__(self, time_s: Array, frequency_radps: float) -> None:
        phase = frequency_radps * time_s
        self._basis = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)

    def __call__(self, values: Array) -> tuple[float, float]:
        sine, cosine, _ = np.linalg.lstsq(self._basis, values, rcond=None)[0]
        return float(np.hypot(sine, cosine)), float(np.degrees(np.arctan2(cosine, sine)))
