"""Tyre sets and soils: the coefficients of what a wheel stands on, loaded from a preset or a TOML file."""

from __future__ import annotations

from math import atan, sin
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tiger.config import toml
from tiger.config.errors import ConfigError

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, strict=True)]
Negative = Annotated[float, Field(lt=0.0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
FrictionAngle = Annotated[float, Field(gt=0.0, lt=60.0, strict=True)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class LongitudinalCoefficients(_Section):
    """Magic Formula for F_x, pure (p) and combined (r) slip; names as in Pacejka 2006, eqs. 4.E9-4.E57."""

    pcx1: Positive
    pdx1: Positive
    pdx2: Finite
    pex1: Finite
    pex2: Finite
    pex3: Finite
    pkx1: Positive
    pkx2: Finite
    pkx3: Finite
    rbx1: Positive
    rbx2: Finite
    rcx1: Positive


class LateralCoefficients(_Section):
    """Magic Formula for F_y, pure (p) and combined (r) slip; names as in Pacejka 2006, eqs. 4.E19-4.E67."""

    pcy1: Positive
    pdy1: Negative
    pdy2: Finite
    pey1: Finite
    pey2: Finite
    pky1: Negative
    pky2: Positive
    rby1: Positive
    rby2: Finite
    rcy1: Positive


class StandstillConfig(_Section):
    """What keeps the contact well behaved at rest, where slip has no meaning."""

    damping_nspm: NonNegative
    damping_fades_at_mps: Positive
    slip_limit: Positive
    rolling_threshold_mps: Positive


class TireSetConfig(_Section):
    """One tyre's Magic Formula set, without camber and offsets; a vehicle scales it by load and grip."""

    nominal_load_n: Positive
    unloaded_radius_m: Positive
    width_m: Positive
    load_ratio_max: Positive
    longitudinal: LongitudinalCoefficients
    lateral: LateralCoefficients
    standstill: StandstillConfig

    @property
    def stiffness_per_load(self) -> tuple[float, float]:
        """Slip stiffnesses C_kappa (1) and C_alpha (1/rad) over the load, at the nominal load.

        Pacejka 2006, eqs. 4.E15 and 4.E25 with df_z = 0 and without camber; similarity makes them those of
        every vehicle's tyre at its own nominal load.
        """
        across = abs(self.lateral.pky1) * sin(2.0 * atan(1.0 / self.lateral.pky2))
        return self.longitudinal.pkx1, across


class SoilConfig(_Section):
    """Bekker's pressure-sinkage and Janosi-Hanamoto's shear parameters of one soil."""

    cohesive_modulus_npm: NonNegative
    """k_c in N/m^(n+1)."""
    frictional_modulus_npm2: Positive
    """k_phi in N/m^(n+2)."""
    sinkage_exponent: Positive
    cohesion_pa: NonNegative
    friction_angle_deg: FrictionAngle
    shear_modulus_m: Positive
    """Shear displacement K at which 63 % of the strength acts."""


_Model = TypeVar("_Model", TireSetConfig, SoilConfig)


def load_tire_set(name_or_path: str | Path = "205_60r15") -> TireSetConfig:
    """Load a tyre set by preset name or TOML path; raises ConfigError with one line per wrong key."""
    return _load(TireSetConfig, "tires", name_or_path)


def load_soil(name_or_path: str | Path) -> SoilConfig:
    """Load a soil by preset name or TOML path; raises ConfigError with one line per wrong key."""
    return _load(SoilConfig, "soils", name_or_path)


def _load(model: type[_Model], folder: str, name_or_path: str | Path) -> _Model:
    known = toml.preset_names(folder)
    source = str(name_or_path)
    if toml.is_path(name_or_path):
        tables = toml.read(name_or_path)
    elif source in known:
        tables = toml.read_preset(folder, source)
    else:
        raise ConfigError(
            f"{source!r} is not among the {folder}; use one of {', '.join(known)}, or a .toml path"
        )
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        raise ConfigError.from_validation(error, source) from error
