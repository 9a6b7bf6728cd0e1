"""The numbers of one vehicle: checked, frozen, loaded from a preset or a TOML file.

Presets: `tiger` (the robot, Tables 3.1-3.3), `tiger-b` (the same on longer arms), `table-5-1` and `table-6-1`
(the cars of the dissertation's simulations). Each value in a preset file is marked printed or chosen. SI
units, except millimetres for the actuator's stroke and the mechanism's points; the unit ends each key's name.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tiger.config import toml
from tiger.config.errors import ConfigError

# Strict: neither "1.0" nor true is a number; a TOML integer is.
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Point = tuple[Finite, Finite]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class BodyConfig(_Section):
    """The sprung mass; its COM lies on the mid-plane. `half_track_m` is `w` of eq. 4.6, at half stroke."""

    mass_kg: Positive
    roll_inertia_kgm2: Positive
    pitch_inertia_kgm2: Positive
    yaw_inertia_kgm2: Positive
    com_height_m: Positive
    com_to_front_axle_m: Positive
    com_to_rear_axle_m: Positive
    half_track_m: Positive

    @property
    def wheelbase_m(self) -> float:
        """Distance between the axles, a + b."""
        return self.com_to_front_axle_m + self.com_to_rear_axle_m


class AxleConfig(_Section):
    """One corner of an axle. Spring and damper act at the wheel (eq. 4.7)."""

    unsprung_mass_kg: Positive
    spring_npm: Positive
    damper_nspm: NonNegative


class TireConfig(_Section):
    """Tyre and wheel; `friction` scales the tyre set's grip, `nominal_load_n` its load."""

    vertical_stiffness_npm: Positive
    vertical_damping_nspm: NonNegative = 0.0
    rolling_radius_m: Positive
    spin_inertia_kgm2: Positive
    rolling_resistance: NonNegative
    longitudinal_relaxation_m: Positive
    lateral_relaxation_m: Positive
    nominal_load_n: Positive
    friction: Positive


class RateActuatorConfig(_Section):
    """A slow self-locking linear actuator in series with the spring: its command is stroke rate."""

    kind: Literal["rate"]
    max_rate_mmps: Positive
    lag_s: NonNegative
    max_force_n: Positive
    stroke_max_mm: Positive
    length_at_zero_stroke_mm: Positive


class ForceActuatorConfig(_Section):
    """An ideal actuator beside the spring: its command is force.

    The spring may travel `rattle_space_m` either way.
    """

    kind: Literal["force"]
    max_force_n: Positive
    rattle_space_m: Positive


ActuatorConfig = Annotated[RateActuatorConfig | ForceActuatorConfig, Field(discriminator="kind")]


class DriveConfig(_Section):
    """One in-wheel motor."""

    max_torque_nm: Positive
    max_wheel_speed_rpm: Positive


class MechanismConfig(_Section):
    """One EAM corner (eq. 4.2), seen along the robot: mm, y outboard, z up, origin at the lower-arm pivot P8.

    The linear actuator spans P1 (on the body) to P2 (on the rocker); the rocker turns about P4 (on the body);
    the damper, taken as rigid, spans P3 (on the rocker) to P9 (on the lower arm); the arm ends at P7, where
    the wheel carrier hangs upright (parallel upper arm).
    """

    actuator_anchor_mm: Point
    rocker_pivot_mm: Point
    rocker_actuator_arm_mm: Positive
    rocker_damper_arm_mm: Positive
    rocker_angle_rad: Finite
    """Angle P2-P4-P3 in the rocker, from P4P2 to P4P3, counter-clockwise seen with y right and z up."""
    damper_length_mm: Positive
    damper_mount_mm: Point
    """P9 in the lower arm's axes: along P8-P7, and perpendicular to it (up when the arm is level)."""
    arm_length_mm: Positive
    arm_pivot_from_midplane_mm: Positive
    hub_offset_mm: NonNegative
    """From P7 to the wheel's mid-plane."""
    arm_angle_at_zero_stroke_rad: Finite
    """Approximate arm angle (positive = body raised) at zero stroke; it only selects the assembly."""


class PayloadConfig(_Section):
    """A compact load fixed to the body; `place_m` is its COM relative to that of the empty body (x, y, z)."""

    mass_kg: Positive
    place_m: tuple[Finite, Finite, Finite]


class VehicleConfig(_Section):
    """All numbers of one vehicle.

    A `payload` weighs on the 14-DOF model of it; controllers do not know of it.
    `drive` is None where wheel torque is not limited, `eam` where there is no mechanism (the two cars).
    `imu_offset_m` is the IMU's place relative to the COM, in body axes (x forward, y left, z up).
    """

    body: BodyConfig
    front: AxleConfig
    rear: AxleConfig
    tire: TireConfig
    actuator: ActuatorConfig
    drive: DriveConfig | None = None
    eam: MechanismConfig | None = None
    payload: PayloadConfig | None = None
    imu_offset_m: tuple[Finite, Finite, Finite]

    @model_validator(mode="after")
    def _mechanism_needs_a_stroke(self) -> VehicleConfig:
        if self.eam is not None and self.actuator.kind != "rate":
            raise ValueError('an [eam] needs an actuator with a stroke: set actuator.kind = "rate"')
        return self


def preset_names() -> tuple[str, ...]:
    """Names that `load_vehicle` knows."""
    return toml.preset_names()


def load_vehicle(name_or_path: str | Path) -> VehicleConfig:
    """Load a preset by name, or a TOML file by path (a name that ends in .toml or has a slash is a path).

    A file may say `extends = "tiger"` (a preset's name) and then give only the keys that differ.
    Raises ConfigError: one line per wrong key, with the key's path, the value, the limit and the next step.
    """
    values = _read(name_or_path)
    base = values.pop("extends", None)
    if base is not None:
        if base not in preset_names():
            raise ConfigError(f"{name_or_path}: extends = {base!r} is not a preset; {_known_presets()}")
        values = _merged(_read(base), values)
    try:
        return VehicleConfig.model_validate(values)
    except ValidationError as error:
        raise ConfigError.from_validation(error, str(name_or_path)) from error


def _read(name_or_path: str | Path) -> dict[str, Any]:
    source = str(name_or_path)
    if toml.is_path(name_or_path):
        return toml.read(name_or_path)
    if source in preset_names():
        return toml.read_preset(source)
    raise ConfigError(f"vehicle {source!r} is not known; {_known_presets()}, or give a path to a .toml file")


def _known_presets() -> str:
    return f"use one of {', '.join(preset_names())}"


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        section = merged.get(key)
        # Another kind of actuator has other keys: nothing of the base applies.
        same_kind = isinstance(section, dict) and isinstance(value, dict) and "kind" not in value
        merged[key] = {**section, **value} if same_kind else value  # type: ignore[dict-item]
    return merged
