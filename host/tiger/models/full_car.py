"""Seven degrees of freedom: heave, pitch and roll of the body, and the vertical motion of the four wheels.

Equations (4.6)-(4.8), equally (6.1)-(6.3). Axes are ISO 8855 (pitch + = nose down, roll + = left side up),
corners are FL, FR, RL, RR, and every displacement is measured from the static equilibrium on a flat road.

An actuator stands beside the spring as a force (chapter 6), or in series with it as a stroke that lifts the
spring's upper seat (the EAM): both are inputs of the same model, so take the ones the vehicle has with
`LinearModel.select`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.models.linear import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.config.vehicle import VehicleConfig

    Array = NDArray[np.float64]

GRAVITY_MPS2 = 9.80665

CORNERS = ("fl", "fr", "rl", "rr")


def _each(template: str) -> tuple[str, ...]:
    return tuple(template.format(corner) for corner in CORNERS)


ROAD = _each("road_{}_m")
ROAD_RATE = _each("road_rate_{}_mps")
FORCE = _each("force_{}_n")
LIFT = _each("lift_{}_m")
LIFT_RATE = _each("lift_rate_{}_mps")

STATES = (
    "heave_m",
    "heave_rate_mps",
    "pitch_rad",
    "pitch_rate_radps",
    "roll_rad",
    "roll_rate_radps",
    *(name for corner in CORNERS for name in (f"wheel_{corner}_m", f"wheel_rate_{corner}_mps")),
)

BODY_ACCELERATION = ("heave_accel_mps2", "pitch_accel_radps2", "roll_accel_radps2")
BODY_RATE = ("heave_rate_mps", "pitch_rate_radps", "roll_rate_radps")
BODY_POSITION = ("heave_m", "pitch_rad", "roll_rad")
IMU = ("imu_heave_accel_mps2", "pitch_rate_radps", "roll_rate_radps")
SUSPENSION = _each("suspension_{}_m")
SUSPENSION_RATE = _each("suspension_rate_{}_mps")
TIRE = _each("tire_{}_m")


@dataclass(frozen=True, slots=True)
class FullCarParameters:
    """What (4.6)-(4.8) need. Springs and dampers are those of one corner, reduced to the wheel."""

    body_mass_kg: float
    roll_inertia_kgm2: float
    pitch_inertia_kgm2: float
    com_to_front_axle_m: float
    com_to_rear_axle_m: float
    half_track_m: float
    front_wheel_mass_kg: float
    rear_wheel_mass_kg: float
    front_spring_npm: float
    rear_spring_npm: float
    front_damper_nspm: float
    rear_damper_nspm: float
    tire_stiffness_npm: float
    com_left_m: float = 0.0
    """How far the centre of mass lies to the left of the mid-plane."""

    @classmethod
    def from_config(cls, vehicle: VehicleConfig) -> FullCarParameters:
        """Read the parameters of a vehicle. The tyre's vertical damping is neglected, as (4.6) does."""
        return cls(
            body_mass_kg=vehicle.body.mass_kg,
            roll_inertia_kgm2=vehicle.body.roll_inertia_kgm2,
            pitch_inertia_kgm2=vehicle.body.pitch_inertia_kgm2,
            com_to_front_axle_m=vehicle.body.com_to_front_axle_m,
            com_to_rear_axle_m=vehicle.body.com_to_rear_axle_m,
            half_track_m=vehicle.body.half_track_m,
            front_wheel_mass_kg=vehicle.front.unsprung_mass_kg,
            rear_wheel_mass_kg=vehicle.rear.unsprung_mass_kg,
            front_spring_npm=vehicle.front.spring_npm,
            rear_spring_npm=vehicle.rear.spring_npm,
            front_damper_nspm=vehicle.front.damper_nspm,
            rear_damper_nspm=vehicle.rear.damper_nspm,
            tire_stiffness_npm=vehicle.tire.vertical_stiffness_npm,
        )

    @property
    def wheelbase_m(self) -> float:
        """Distance from the front to the rear axle."""
        return self.com_to_front_axle_m + self.com_to_rear_axle_m

    def corner_positions_m(self) -> Array:
        """Return (x, y) of each corner from the centre of mass, shape (4, 2)."""
        a, b = self.com_to_front_axle_m, self.com_to_rear_axle_m
        left, right = self.half_track_m - self.com_left_m, -self.half_track_m - self.com_left_m
        return np.array([[a, left], [a, right], [-b, left], [-b, right]])

    def corner_kinematics(self) -> Array:
        """Return T of (4.8): corner heights (4,) = T @ [heave, pitch, roll], shape (4, 3)."""
        x, y = self.corner_positions_m().T
        return np.column_stack([np.ones(4), -x, y])

    def spring_npm(self) -> Array:
        """Return the spring of each corner, shape (4,)."""
        return np.repeat([self.front_spring_npm, self.rear_spring_npm], 2)

    def damper_nspm(self) -> Array:
        """Return the damper of each corner, shape (4,)."""
        return np.repeat([self.front_damper_nspm, self.rear_damper_nspm], 2)

    def wheel_mass_kg(self) -> Array:
        """Return the unsprung mass of each corner, shape (4,)."""
        return np.repeat([self.front_wheel_mass_kg, self.rear_wheel_mass_kg], 2)

    def static_tire_load_n(self) -> Array:
        """Return the tyre load of each corner at rest, the denominators of eta in section 6.2, shape (4,)."""
        x, y = self.corner_positions_m().T
        share = (1 - np.abs(x) / self.wheelbase_m) * (1 - np.abs(y) / (2 * self.half_track_m))
        return np.asarray(GRAVITY_MPS2 * (share * self.body_mass_kg + self.wheel_mass_kg()))


def full_car(p: FullCarParameters, imu_offset_m: tuple[float, float] = (0.0, 0.0)) -> LinearModel:
    """Build the 14-state model (4.9) with road displacement as input.

    Inputs: ROAD, FORCE (+ pushes the body up), LIFT and LIFT_RATE (a stroke that lifts the spring's upper
    seat; the spring deflects by corner - wheel - lift, so lift and its rate act as the force K lift + C
    lift_rate). Outputs: body position, rate and acceleration; `imu_heave_accel_mps2`, the vertical
    acceleration at `imu_offset_m` = (x, y) from the centre of mass; SUSPENSION = corner - wheel and its rate;
    TIRE = wheel - road.
    """
    kinematics = p.corner_kinematics()
    body_inertia = np.array([p.body_mass_kg, p.pitch_inertia_kgm2, p.roll_inertia_kgm2])
    # On q = [heave, pitch, roll, four wheels] a corner force +F lifts the body and presses the wheel down.
    deflection = np.hstack([kinematics, -np.eye(4)])
    mass = np.concatenate([body_inertia, p.wheel_mass_kg()])
    tire = np.diag(np.r_[np.zeros(3), np.full(4, p.tire_stiffness_npm)])
    stiffness = deflection.T @ np.diag(p.spring_npm()) @ deflection + tire
    damping = deflection.T @ np.diag(p.damper_nspm()) @ deflection
    road_force = np.vstack([np.zeros((3, 4)), p.tire_stiffness_npm * np.eye(4)])
    corner_force = deflection.T
    from_inputs = np.hstack(
        [
            road_force,
            corner_force,
            corner_force * p.spring_npm(),
            corner_force * p.damper_nspm(),
        ]
    )

    position, rate = np.arange(0, 14, 2), np.arange(1, 14, 2)
    acceleration = np.zeros((7, 14))
    acceleration[:, position] = -stiffness / mass[:, None]
    acceleration[:, rate] = -damping / mass[:, None]
    acceleration_inputs = from_inputs / mass[:, None]
    a, b = np.zeros((14, 14)), np.zeros((14, 16))
    a[position, rate] = 1.0
    a[rate], b[rate] = acceleration, acceleration_inputs

    x, y = imu_offset_m
    at_imu = np.array([1.0, -x, y])
    of_position, of_rate = np.eye(14)[position], np.eye(14)[rate]
    none, road = np.zeros((4, 16)), np.eye(4, 16)
    blocks: list[tuple[tuple[str, ...], Array, Array]] = [
        (BODY_POSITION, of_position[:3], np.zeros((3, 16))),
        (BODY_RATE, of_rate[:3], np.zeros((3, 16))),
        (BODY_ACCELERATION, acceleration[:3], acceleration_inputs[:3]),
        (IMU[:1], (at_imu @ acceleration[:3])[None], (at_imu @ acceleration_inputs[:3])[None]),
        (SUSPENSION, deflection @ of_position, none),
        (SUSPENSION_RATE, deflection @ of_rate, none),
        (TIRE, of_position[3:], -road),
    ]
    return LinearModel(
        a,
        b,
        np.vstack([c for _, c, _ in blocks]),
        np.vstack([d for _, _, d in blocks]),
        STATES,
        (*ROAD, *FORCE, *LIFT, *LIFT_RATE),
        tuple(name for names, _, _ in blocks for name in names),
    )


def road_rate_form(model: LinearModel) -> tuple[LinearModel, Array]:
    """Rewrite `full_car` with road RATE as input, in the minimal 14 states, and return it with a gain (p, 4).

    The new state is the deviation from the equilibrium on the present road, x + A^-1 B_road road, so that A,
    C and the other inputs are unchanged and B_road_rate = A^-1 B_road. An output is y = C x + D u + gain @
    road: the gain is that of a road at rest, zero for accelerations and rates; on suspension and tyre
    deflections it acts only on the warp of the road, the one integrator for which (6.4) carries a fifteenth,
    uncontrollable state.
    """
    columns = [model.inputs.index(name) for name in ROAD]
    others = [i for i in range(len(model.inputs)) if i not in columns]
    b_rate = np.linalg.solve(model.a, model.b[:, columns])
    gain = np.asarray(model.d[:, columns] - model.c @ b_rate)
    rewritten = LinearModel(
        model.a,
        np.hstack([b_rate, model.b[:, others]]),
        model.c,
        np.hstack([np.zeros((len(model.outputs), 4)), model.d[:, others]]),
        model.states,
        (*ROAD_RATE, *(model.inputs[i] for i in others)),
        model.outputs,
    )
    return rewritten, gain
