"""Section 4.2.3: one corner of the vehicle over a step in the road and under a push of its actuator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tiger.config.vehicle import load_vehicle
from tiger.models.linear import modes
from tiger.models.quarter_car import QuarterCarParameters, quarter_car
from tiger.studies.figures import new_figure, save
from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from pathlib import Path

STEP_S = 1e-4


def run(
    vehicle: str = "table-5-1",
    axle: str = "front",
    step_m: float = 0.1,
    push_n: float = 100.0,
    duration_s: float = 3.0,
) -> Report:
    """Drive one corner over a step of the road, and push it with its actuator on a flat one.

    Raises ConfigError for an unknown vehicle, ValueError for another axle than "front" or "rear".
    """
    model = quarter_car(QuarterCarParameters.from_config(load_vehicle(vehicle), axle))
    sampled = model.discretise(STEP_S)
    steps = round(duration_s / STEP_S)
    road, push = np.zeros((steps, 4)), np.zeros((steps, 4))
    road[:, model.inputs.index("road_m")] = step_m
    push[:, model.inputs.index("force_n")] = push_n
    over_step, _ = sampled.simulate(road)
    pushed, _ = sampled.simulate(push)
    accel, body, wheel, suspension, tire = over_step.T
    rows = [
        Row(f"mode {i + 1} {name}", float(value), unit)
        for i, mode in enumerate(modes(model.poles()))
        for name, value, unit in zip(("frequency", "damping ratio"), mode, ("Hz", "-"), strict=True)
    ]
    rows += [
        Row("step: highest body", float(body.max()), "m"),
        Row("step: time of highest body", float(body.argmax() * STEP_S), "s"),
        Row("step: highest wheel", float(wheel.max()), "m"),
        Row("step: peak body acceleration", float(np.abs(accel).max()), "m/s^2"),
        Row("step: peak suspension deflection", float(np.abs(suspension).max()), "m"),
        Row("step: peak tyre deflection", float(np.abs(tire).max()), "m"),
        Row("push: body rise at rest", float(push_n * model.static_gain()[1, 0]), "m"),
        Row("push: body rise at the end", float(pushed[-1, 1]), "m"),
    ]
    every = slice(None, None, 20)
    return Report(
        f"Quarter car, {axle} corner of {vehicle}",
        tuple(rows),
        {
            "time_s": np.arange(steps)[every] * STEP_S,
            "step_body_m": body[every],
            "step_wheel_m": wheel[every],
            "step_acceleration_mps2": accel[every],
            "push_body_m": pushed[every, 1],
        },
        {
            "signs": "those of the equations of motion (4.5); its printed matrices negate the force",
            "body mass": "the share of the body that rests on the corner",
        },
    )


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw the step and the push."""
    s = report.arrays()
    figure = new_figure(7, 6)
    axes = figure.subplots(3, 1, sharex=True)
    axes[0].plot(s["time_s"], s["step_body_m"], label="body")
    axes[0].plot(s["time_s"], s["step_wheel_m"], label="wheel")
    axes[0].legend()
    axes[1].plot(s["time_s"], s["step_acceleration_mps2"])
    axes[2].plot(s["time_s"], s["push_body_m"])
    for axis, label in zip(axes, ("step m", "step m/s$^2$", "push m"), strict=True):
        axis.set_ylabel(label)
    axes[2].set_xlabel("time s")
    return [save(figure, directory / "quarter_car.png", 120)]
