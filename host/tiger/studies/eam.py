"""The mechanism over its stroke: Figure 4.3 (suspension travel) and 4.5 (ground clearance, track)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tiger.config.vehicle import load_vehicle
from tiger.models.eam import Eam, MechanismError
from tiger.models.full_car import GRAVITY_MPS2
from tiger.studies.figures import new_figure, save
from tiger.studies.report import Report, Row

if TYPE_CHECKING:
    from pathlib import Path


def run(*, vehicle: str = "tiger", stroke_mm: float = 100.0, points: int = 201) -> Report:
    """Solve the mechanism of a vehicle from zero to `stroke_mm` with the actuator at full speed.

    The default is the 100 mm of section 3.3.2, over which the arm sweeps the printed angles; the fitted motor
    has 70 mm (section 3.4.2). Raises ConfigError for an unknown vehicle, MechanismError for one without a
    mechanism or a stroke it cannot take.
    """
    config = load_vehicle(vehicle)
    actuator = config.actuator
    if config.eam is None or actuator.kind != "rate":
        raise MechanismError(f"vehicle {vehicle!r} has no [eam]; choose tiger or tiger-b")
    if not (stroke_mm > 0.0 and points >= 2):
        raise MechanismError(
            f"stroke_mm = {stroke_mm:g} and points = {points} must be positive, points at least 2"
        )
    eam = Eam(
        config.eam,
        stroke_max_mm=stroke_mm,
        length_at_zero_stroke_mm=actuator.length_at_zero_stroke_mm,
        wheel_radius_mm=config.tire.rolling_radius_m * 1000.0,
    )
    strokes = np.linspace(0.0, stroke_mm, points)
    pose = eam.pose(strokes)
    q = eam.assemble(strokes)
    q_dot = eam.velocity(q, strokes, actuator.max_rate_mmps)
    q_ddot = eam.acceleration(q, q_dot, strokes, actuator.max_rate_mmps)

    widest = int(np.argmax(pose.track_mm))
    straight = np.polynomial.Polynomial.fit(strokes, pose.rise_mm, 1)(strokes)
    corner_load_n = config.body.mass_kg * GRAVITY_MPS2 / 4.0
    arm_deg = np.degrees(pose.arm_angle_rad)
    # What the dissertation prints, it prints for the whole 100 mm.
    printed = np.isclose(stroke_mm, 100.0)

    def row(name: str, value: float, unit: str, said: float | None = None) -> Row:
        return Row(name, float(value), unit, said if printed else None)

    return Report(
        title=f"Elastic actuated mechanism of {vehicle}, stroke 0 to {stroke_mm:g} mm",
        rows=(
            row("arm angle at zero stroke", arm_deg[0], "deg", -7.5),
            row("arm angle at full stroke", arm_deg[-1], "deg", 49.0),
            row("suspension travel", pose.rise_mm[-1], "mm", 180.0),
            row("deviation of the travel from a straight line", np.abs(pose.rise_mm - straight).max(), "mm"),
            row("pivot clearance at zero stroke", pose.ground_clearance_mm[0], "mm"),
            row("pivot clearance at full stroke", pose.ground_clearance_mm[-1], "mm"),
            row("track at zero stroke", pose.track_mm[0], "mm"),
            row("greatest track", pose.track_mm[widest], "mm", 1270.0),
            row("stroke at the greatest track (arm level)", strokes[widest], "mm"),
            row("track at full stroke", pose.track_mm[-1], "mm", 1120.0),
            row("motion ratio at zero stroke", pose.motion_ratio[0], "-"),
            row("motion ratio at half stroke", float(eam.pose(stroke_mm / 2.0).motion_ratio), "-"),
            row("motion ratio at full stroke", pose.motion_ratio[-1], "-"),
            row("actuator force to hold the body, greatest", corner_load_n * pose.motion_ratio.max(), "N"),
            row("time of the full stroke", stroke_mm / actuator.max_rate_mmps, "s"),
            row("greatest rise rate at full speed", q_dot[:, 1].max(), "mm/s"),
            row("least transmission angle", np.degrees(pose.transmission_angle_rad).min(), "deg"),
            row("scaled residual of eq. 4.2, greatest", np.abs(eam.residual(q, strokes)).max(), "-"),
        ),
        series={
            "stroke_mm": strokes,
            "time_s": strokes / actuator.max_rate_mmps,
            "arm_angle_deg": arm_deg,
            "suspension_travel_mm": pose.rise_mm,
            "ground_clearance_mm": pose.ground_clearance_mm,
            "track_mm": pose.track_mm,
            "motion_ratio": pose.motion_ratio,
            "rise_rate_mmps": q_dot[:, 1],
            "rise_accel_mmps2": q_ddot[:, 1],
        },
        assumptions={
            "geometry": "designed to the printed angles, track and height; the points are printed nowhere",
            "ground clearance": "height of the lower-arm pivot P8, wheel on the ground, tyre not deflected",
            "upper arm": "parallel to the lower arm and as long, so the wheel stays upright (phi_5 = 0)",
            "printed suspension travel": "Table 3.1, robot height 58 less 40 cm",
        },
    )


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figures 4.3 and 4.5 into `directory`."""
    series = report.arrays()
    stroke = series["stroke_mm"]

    travel = new_figure(6.0, 4.0)
    axes = travel.subplots()
    axes.plot(stroke, series["suspension_travel_mm"], color="tab:blue")
    axes.set(xlabel="actuator stroke (mm)", ylabel="suspension travel (mm)", title="Figure 4.3")
    axes.grid(alpha=0.3)

    clearance_and_track = new_figure(6.0, 4.0)
    left = clearance_and_track.subplots()
    right = left.twinx()
    left.plot(stroke, series["ground_clearance_mm"], color="tab:blue")
    right.plot(stroke, series["track_mm"], color="tab:red")
    left.set(xlabel="actuator stroke (mm)", title="Figure 4.5")
    left.set_ylabel("ground clearance (mm)", color="tab:blue")
    right.set_ylabel("wheel track (mm)", color="tab:red")
    left.grid(alpha=0.3)
    return [
        save(travel, directory / "figure-4-3.png", 120),
        save(clearance_and_track, directory / "figure-4-5.png", 120),
    ]
