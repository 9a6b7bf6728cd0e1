"""Figures 5.7 and 5.8: two 20 cm bumps under the left wheels at 60 km/h, without and with active suspension.

Three runs over the same ground: passive; ideal force actuators beside the springs, limited to the vehicle's
`actuator.max_force_n`; and the real TIGER actuator in series with the springs, whose spring seats rise at
9.4 mm/s times the mechanism's motion ratio at most. The first two are the dissertation's figures; the third
says what such slow actuators can do about a bump that lasts 0.6 s, which is next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from tiger.config.vehicle import load_vehicle
from tiger.models import vehicle_kernel as kernel
from tiger.models.full_car import FullCarParameters
from tiger.models.terrain import Terrain
from tiger.models.vehicle import History, Inputs, Vehicle, euler_from_quaternion
from tiger.studies.chapter5 import (
    ASSUMPTIONS,
    CONTROL_PERIOD_S,
    KMH_TO_MPS,
    SpeedHold,
    drive,
    load_car,
    peak,
    rms,
)
from tiger.studies.figures import save_panels
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from tiger.config.vehicle import VehicleConfig
    from tiger.studies.report import Progress

Array = NDArray[np.float64]

CASES = ("passive", "active", "eam")


def run(
    vehicle: str = "table-5-1",
    speed_kmh: float = 60.0,
    bump_m: float = 0.2,
    bump_length_m: float = 10.0,
    inertia_divisor: float = 10.0,
    attitude_bandwidth_hz: float = 2.0,
    damper_share_kept: float = 0.4,
    eam: str = "tiger",
    duration_s: float = 4.0,
    dt_s: float = 1e-3,
    progress: Progress = unwatched,
) -> Report:
    """Cross the bumps three times and compare; `eam` names the robot whose actuator and EAM are borrowed.

    Raises ConfigError for an unknown vehicle, ValueError if `vehicle` has no force actuator or `eam` no EAM.
    """
    config = load_car(vehicle, inertia_divisor)
    if config.actuator.kind != "force":
        raise ValueError(f"{vehicle} has no force actuator; this study needs actuator.kind = 'force'")
    terrain = double_bump(bump_m, bump_length_m)
    plant = Vehicle(config, terrain)
    law = AttitudeForces(config, attitude_bandwidth_hz, damper_share_kept, config.actuator.max_force_n)
    drivers: dict[str, _Suspension] = {
        "passive": _Passive(),
        "active": law,
        "eam": SlowEam(law, config, load_vehicle(eam)),
    }
    histories: dict[str, History] = {}
    inputs: dict[str, Array] = {}
    for n, case in enumerate(CASES):
        histories[case], inputs[case] = _cross(plant, drivers[case], speed_kmh, duration_s, dt_s)
        progress((n + 1) / len(CASES))
    series: dict[str, Array] = {"time_s": histories["passive"].time_s[:-1]}
    for case in CASES:
        series |= {f"{name}_{case}": v for name, v in _series(histories[case], inputs[case]).items()}
    return Report(
        title=f"Double bump: {speed_kmh:g} km/h, left bumps of {bump_length_m:g} m x {100 * bump_m:g} cm",
        rows=(
            *_compared({case: _figures(histories[case]) for case in CASES}),
            Row("actuator force, peak, active", peak(inputs["active"][:, kernel.FORCE]), "N"),
            Row("spring seat lift, peak, eam", 1e3 * peak(inputs["eam"][:, kernel.LIFT]), "mm"),
        ),
        series=series,
        assumptions={
            **ASSUMPTIONS,
            "vehicle": vehicle,
            "inertia_divisor": inertia_divisor,
            "bumps": "one period of (1 - cos)/2 each, one after the other, under the left half of the car",
            "speed": "held by equal wheel torques (proportional-integral); no steering, no path control",
            "active": (
                "ideal forces: roll, pitch and warp parts of the spring forces, and of all but "
                f"{damper_share_kept:g} of the damper forces, are cancelled and replaced by a critically "
                f"damped {attitude_bandwidth_hz:g} Hz return of roll and pitch"
            ),
            "max_force_n": config.actuator.max_force_n,
            "eam": f"the same law through the springs of {eam}'s series actuators and their rate limit",
        },
    )


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figure 5.7 (path, speed, torque, rollover index) and 5.8 (attitude, yaw rate, heave, forces)."""

    def both(name: str) -> list[tuple[str, str]]:
        return [(f"{name}_{case}", case) for case in CASES]

    return [
        save_panels(
            report,
            directory / "double_bump_path.png",
            [
                ("path y (m)", both("y_m")),
                ("speed (km/h)", both("speed_kmh")),
                ("traction (Nm)", both("traction_torque_nm")),
                ("load transfer (-)", both("load_transfer")),
            ],
        ),
        save_panels(
            report,
            directory / "double_bump_attitude.png",
            [
                ("roll (deg)", both("roll_deg")),
                ("pitch (deg)", both("pitch_deg")),
                ("yaw rate (deg/s)", both("yaw_rate_degps")),
                ("body rise (m)", both("heave_m")),
                ("force FL (N)", [("force_fl_n_active", "active")]),
            ],
        ),
    ]


def double_bump(height_m: float = 0.2, length_m: float = 10.0, start_m: float = 10.0) -> Terrain:
    """Two successive bumps under everything left of the centre line."""
    first = Terrain().with_bump(height_m, start_m, length_m, right_m=0.0)
    return first.with_bump(height_m, start_m + length_m, length_m, right_m=0.0)


class _Suspension(Protocol):
    def act(self, state: Array, inputs: Inputs) -> None:
        """Set the suspension's inputs for the next step."""


class _Passive:
    def act(self, state: Array, inputs: Inputs) -> None:
        """Leave the springs and dampers alone."""


class AttitudeForces:
    """Ideal forces that keep roll and pitch level and let the body heave.

    Springs and dampers are measured (strut compression and rate); what they do to roll, pitch and warp is
    taken back, which leaves the body hanging on the mean of the four: the soft heave mode it has anyway. A
    share of the dampers stays, for nothing else damps the wheels' hop. Roll and pitch are then near to double
    integrators, returned to level with a bandwidth and critical damping (attitude and rates from the IMU).
    """

    def __init__(
        self, config: VehicleConfig, bandwidth_hz: float, damper_share_kept: float, max_force_n: float
    ) -> None:
        """Take the law's four figures; the corners' springs, dampers and places are the vehicle's."""
        car = FullCarParameters.from_config(config)
        self._bandwidth_radps = 2.0 * np.pi * bandwidth_hz
        self._max_force_n = max_force_n
        self._spring_npm = car.spring_npm()
        self._damper_nspm = (1.0 - damper_share_kept) * car.damper_nspm()
        self._inertia_kgm2 = np.array([car.roll_inertia_kgm2, car.pitch_inertia_kgm2])
        # Force (+ up) at each corner for a unit moment about roll and pitch, without heave or warp.
        x, y = car.corner_positions_m().T
        modes = np.stack([np.ones(4), y, -x, x * y])
        self._lever_per_m = np.linalg.inv(modes)[:, 1:3]

    def wanted(self, state: Array) -> Array:
        """Forces (4,) before the limit."""
        passive = self._spring_npm * state[kernel.STRUT] + self._damper_nspm * state[kernel.STRUT_RATE]
        attitude = euler_from_quaternion(state[kernel.ATTITUDE])[:2]
        omega = self._bandwidth_radps
        moments = -self._inertia_kgm2 * (omega**2 * attitude + 2.0 * omega * state[kernel.RATE][:2])
        return np.asarray(passive.mean() - passive + self._lever_per_m @ moments)

    def act(self, state: Array, inputs: Inputs) -> None:
        """Set the actuator forces, limited."""
        inputs.actuator_force_n[:] = np.clip(self.wanted(state), -self._max_force_n, self._max_force_n)


class SlowEam:
    """The same law through series actuators: a lift of force/spring, as fast and as far as the EAM goes."""

    def __init__(self, law: AttitudeForces, car: VehicleConfig, robot: VehicleConfig) -> None:
        """Borrow `robot`'s actuator and mechanism for `car`; strokes start in the middle."""
        from tiger.models.eam import Eam

        if robot.actuator.kind != "rate":
            raise ValueError("the EAM's vehicle needs actuator.kind = 'rate'; use the preset tiger")
        self._law = law
        self._spring_npm = FullCarParameters.from_config(car).spring_npm()
        self._actuator = robot.actuator
        self._curve = Eam.from_vehicle(robot).curve()
        self._stroke_mm = np.full(4, 0.5 * robot.actuator.stroke_max_mm)
        self._datum_mm = float(self._curve.rise_mm(self._stroke_mm[0]))

    def act(self, state: Array, inputs: Inputs) -> None:
        """Move the strokes towards the wanted lift."""
        target_mm = self._curve.stroke_mm(self._datum_mm + 1e3 * self._law.wanted(state) / self._spring_npm)
        limit = self._actuator.max_rate_mmps
        lag_s = max(self._actuator.lag_s, CONTROL_PERIOD_S)
        rate = np.clip((target_mm - self._stroke_mm) / lag_s, -limit, limit)
        inputs.lift_m[:] = 1e-3 * (self._curve.rise_mm(self._stroke_mm) - self._datum_mm)
        inputs.lift_rate_mps[:] = 1e-3 * self._curve.motion_ratio(self._stroke_mm) * rate
        self._stroke_mm = np.clip(
            self._stroke_mm + rate * CONTROL_PERIOD_S, 0.0, self._actuator.stroke_max_mm
        )


def _cross(
    plant: Vehicle, suspension: _Suspension, speed_kmh: float, duration_s: float, dt_s: float
) -> tuple[History, Array]:
    """Drive over the terrain in closed loop; return the history and the inputs (n, 34)."""
    speed = speed_kmh * KMH_TO_MPS
    hold = SpeedHold(plant.config, speed)

    def act(_: float, state: Array, inputs: Inputs) -> None:
        hold.act(state, inputs)
        suspension.act(state, inputs)

    return drive(plant, plant.rolling(speed), duration_s, dt_s, act)


def _compared(figures: Mapping[str, Mapping[str, tuple[float, str]]]) -> list[Row]:
    """Every figure of every case, then the main ones over those of the passive car."""
    passive = figures["passive"]
    rows = [Row(f"{name}, {case}", *figures[case][name]) for name in passive for case in CASES]
    rows += [
        Row(f"{name}, {case}/passive", _ratio(figures[case][name][0], passive[name][0]), "-")
        for name in ("roll, RMS", "pitch, RMS", "load transfer, peak", "path deviation, peak")
        for case in CASES[1:]
    ]
    return rows


def _ratio(value: float, passive: float) -> float:
    """Quotient, or NaN where the passive car does not move either."""
    return value / passive if passive > 0.0 else float("nan")


def _figures(history: History) -> dict[str, tuple[float, str]]:
    """What one crossing comes to: value and unit."""
    angles = np.degrees(history.attitude_rad)
    return {
        "roll, RMS": (rms(angles[:, 0]), "deg"),
        "pitch, RMS": (rms(angles[:, 1]), "deg"),
        "load transfer, peak": (peak(history.load_transfer), "-"),
        "path deviation, peak": (peak(history.position_m[:, 1]), "m"),
        "yaw rate, peak": (peak(np.degrees(history.rate_radps[:, 2])), "deg/s"),
        "body rise, peak": (peak(history.position_m[:, 2] - history.position_m[0, 2]), "m"),
        "speed, least": (float(history.velocity_mps[:, 0].min()) / KMH_TO_MPS, "km/h"),
        "traction torque, peak": (peak(history.wheel_torque_nm.sum(axis=1)), "Nm"),
        "wheel load, least": (float(history.wheel_load_n.min()), "N"),
    }


def _series(history: History, inputs: Array) -> dict[str, Array]:
    angles = np.degrees(history.attitude_rad[:-1])
    return {
        "x_m": history.position_m[:-1, 0],
        "y_m": history.position_m[:-1, 1],
        "speed_kmh": history.velocity_mps[:-1, 0] / KMH_TO_MPS,
        "traction_torque_nm": history.wheel_torque_nm[:-1].sum(axis=1),
        "load_transfer": history.load_transfer[:-1],
        "roll_deg": angles[:, 0],
        "pitch_deg": angles[:, 1],
        "yaw_rate_degps": np.degrees(history.rate_radps[:-1, 2]),
        "heave_m": history.position_m[:-1, 2] - history.position_m[0, 2],
        "force_fl_n": inputs[:, kernel.FORCE_AT],
        "lift_fl_mm": 1e3 * inputs[:, kernel.LIFT_AT],
    }
