"""What the robot knows of its motion, load and ground: the estimators behind the attitude, in order."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING

from tiger.estimation import contact, ground_ahead, odometry, roughness, tilt_error, wheel_loads
from tiger.estimation.contact import Contact, ContactDesign, ContactState
from tiger.estimation.ground_ahead import AheadDesign, AheadState
from tiger.estimation.odometry import OdometryDesign, OdometryState
from tiger.estimation.roughness import RoughnessDesign, RoughnessState
from tiger.estimation.tilt_error import TiltError
from tiger.estimation.wheel_loads import LoadsDesign, LoadsState
from tiger.frozen import dataclass, replace
from tiger.record import Loads

if TYPE_CHECKING:
    from tiger.config.robot import ObserverConfig, RobotConfig
    from tiger.record import Estimate, Inputs


@dataclass(frozen=True, slots=True, eq=False)
class SituationDesign:
    """Designs of the estimators."""

    odometry: OdometryDesign
    contact: ContactDesign
    loads: LoadsDesign
    roughness: RoughnessDesign
    ahead: AheadDesign
    tilt: ObserverConfig


@dataclass(frozen=True, slots=True, eq=False)
class SituationState:
    """States of the estimators."""

    contact: ContactState
    loads: LoadsState
    ahead: AheadState
    odometry: OdometryState = field(default_factory=OdometryState)
    roughness: RoughnessState = field(default_factory=RoughnessState)
    carried: Loads = field(default_factory=Loads)
    """Loads as last estimated."""
    tilt_error: TiltError = TiltError()
    """What the next attitude from the Nano is off by."""


def design_situation(robot: RobotConfig) -> SituationDesign:
    """Design everything for a checked configuration."""
    return SituationDesign(
        odometry=odometry.design_odometry(robot),
        contact=contact.design_contact(robot),
        loads=wheel_loads.design_loads(robot),
        roughness=roughness.design_roughness(robot),
        ahead=ground_ahead.design_ahead(robot),
        tilt=robot.observer,
    )


def initial_state(design: SituationDesign) -> SituationState:
    """Return the state before the first tick."""
    return SituationState(
        contact.initial_state(design.contact),
        wheel_loads.initial_state(design.loads),
        ground_ahead.initial_state(design.ahead),
    )


def step(
    design: SituationDesign, state: SituationState, inputs: Inputs, estimate: Estimate, dt: float
) -> tuple[SituationState, Estimate]:
    """Advance by `dt` seconds from this tick's attitude; each estimator sees what those before it found."""
    moving, where = odometry.step(design.odometry, state.odometry, inputs, estimate, dt)
    estimate = replace(
        estimate, speed_mps=where.speed_mps, yaw_rate_radps=where.yaw_rate_radps, odometry=where
    )
    tilt = state.tilt_error
    if inputs.imu is not None:
        tilt = tilt_error.step(design.tilt, tilt, inputs.imu, moving)
    ahead = ground_ahead.step(design.ahead, state.ahead, estimate)
    touching, touch = contact.step(design.contact, state.contact, inputs, estimate, state.carried, dt)
    carried = state.carried if touching is state.contact else _with_contact(state.carried, touch)
    estimate = replace(estimate, loads=carried)
    loading, loads = wheel_loads.step(design.loads, state.loads, inputs, estimate, tilt, dt)
    rolling, rough = roughness.step(design.roughness, state.roughness, inputs, estimate, dt)
    if loads is not carried:
        loads = _with_contact(loads, touch)
    after = SituationState(touching, loading, ahead, moving, rolling, loads, tilt)
    return after, replace(estimate, loads=loads, roughness=rough)


def _with_contact(loads: Loads, touch: Contact) -> Loads:
    """Loads with what is known of contact; the record's warp is FL - FR - RL + RR of the ground's heights."""
    fl, fr, rl, rr = (share > 0.5 for share in touch.hanging)
    return replace(
        loads,
        hanging=(fl, fr, rl, rr),
        ground_warp_m=0.004 * touch.ground_warp_mm,
        ground_warp_sigma_m=0.004 * touch.sigma_mm,
    )
