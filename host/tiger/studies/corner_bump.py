"""Figure 5.6: the road under the front left wheel steps up by 10 cm while the car rolls at 30 km/h.

The step comes in time and under one wheel only, as the text says ("applied to only the front left tire"): the
ground there is lifted like the post of a test rig, so no kerb pushes the wheel back and the rear left wheel
does not meet it. Small-angle theory says where a body on four equal springs comes to rest: 3/4, 1/4, 1/4 and
-1/4 of the step above the four wheels. Gravity, acting on a body that leans, adds some 5 % of roll.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiger.models.vehicle import Inputs, Vehicle
from tiger.studies.chapter5 import ASSUMPTIONS, CONTROL_PERIOD_S, KMH_TO_MPS, SpeedHold, drive, load_car
from tiger.studies.figures import save_panels
from tiger.studies.report import CORNERS, Report, Row, unwatched

if TYPE_CHECKING:
    from pathlib import Path

    from tiger.studies.report import Progress

Array = NDArray[np.float64]


def run(
    vehicle: str = "table-5-1",
    speed_kmh: float = 30.0,
    step_m: float = 0.1,
    step_at_s: float = 0.5,
    duration_s: float = 20.0,
    inertia_divisor: float = 1.0,
    dt_s: float = 1e-3,
    progress: Progress = unwatched,
) -> Report:
    """Lift the ground under the front left wheel by `step_m` at `step_at_s`, at constant speed.

    Raises ValueError if the run ends before the step, ConfigError for an unknown vehicle.
    """
    if not 0.0 <= step_at_s < duration_s:
        raise ValueError(f"step_at_s = {step_at_s} must lie within the run of {duration_s} s")
    config = load_car(vehicle, inertia_divisor)
    plant = Vehicle(config)
    speed = speed_kmh * KMH_TO_MPS
    hold = SpeedHold(config, speed)

    def act(time_s: float, state: Array, inputs: Inputs) -> None:
        hold.act(state, inputs)
        inputs.post_m[0] = step_m if time_s >= step_at_s - 0.5 * CONTROL_PERIOD_S else 0.0

    history, _ = drive(plant, plant.rolling(speed), duration_s, dt_s, act, progress)
    corners_cm = 100.0 * history.corner_height_m
    angles_deg = np.degrees(history.attitude_rad)
    settled = corners_cm[-1]
    rows = [Row(f"{c} corner, settled", float(settled[i]), "cm") for i, c in enumerate(CORNERS)]
    rows += [Row(f"{c} corner, largest", _extreme(corners_cm[:, i]), "cm") for i, c in enumerate(CORNERS)]
    for i, name in enumerate(("roll", "pitch", "yaw")):
        rows += [
            Row(f"{name}, settled", float(angles_deg[-1, i]), "deg"),
            Row(f"{name}, largest", _extreme(angles_deg[:, i]), "deg"),
        ]
    rows.append(Row("wheel load, least", float(history.wheel_load_n.min()), "N"))
    return Report(
        title=f"Corner bump: {100 * step_m:g} cm under the front left wheel at {speed_kmh:g} km/h",
        rows=tuple(rows),
        series={
            "time_s": history.time_s,
            **{f"corner_{c.lower()}_cm": corners_cm[:, i] for i, c in enumerate(CORNERS)},
            "roll_deg": angles_deg[:, 0],
            "pitch_deg": angles_deg[:, 1],
            "yaw_deg": angles_deg[:, 2],
            "wheel_load_n": history.wheel_load_n,
        },
        assumptions={
            **ASSUMPTIONS,
            "vehicle": vehicle,
            "step": "the ground under the front left wheel only, in time, without a kerb's push",
            "speed": "held by equal wheel torques (proportional-integral)",
            "inertia_divisor": inertia_divisor,
            "com_height_m": config.body.com_height_m,
        },
    )


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figure 5.6: the body's corner heights, then its angles."""
    return [
        save_panels(
            report,
            directory / "corner_bump.png",
            [
                ("corner rise (cm)", [(f"corner_{c.lower()}_cm", c) for c in CORNERS]),
                ("roll (deg)", [("roll_deg", "roll")]),
                ("pitch (deg)", [("pitch_deg", "pitch")]),
                ("yaw (deg)", [("yaw_deg", "yaw")]),
            ],
        )
    ]


def _extreme(values: Array) -> float:
    """Return the value of largest magnitude, with its sign."""
    return float(values[np.argmax(np.abs(values))])
