"""How far a vehicle on four wheels is from tipping over, measured against each edge of its support polygon.

*Force-angle measure* (E. G. Papadopoulos, D. A. Rey, "A new measure of tipover stability margin for mobile
manipulators", ICRA 1996): gravity, inertial and centripetal forces and moments at the centre of mass (COM)
make one net force; its angle to each edge, seen along that edge, is what is left. An accelerometer measures
the negative of that net force, whatever made it, so nothing here needs a model of the motion.

*Energy measure* (D. Messuri, C. Klein, "Automatic body regulation for maintaining stability of a legged
vehicle during rough-terrain locomotion", IEEE J. Robotics and Automation, 1985): the work that lifts the COM
over the edge; here against the net force, which for a robot at rest is gravity: E = |f| l (1 - cos theta),
with the sign of theta. Over its least value for the robot at rest on level ground it is the margin: 1 at
rest, 0 when the net force goes through an edge.

The edges of a rectangle run along the body's axes, so that each is a plane problem: outward and down. Edges
are left, right, front, rear. Forces are per unit mass (m/s2), energies per unit mass (m2/s2).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, copysign, hypot, inf, sqrt
from math import log as ln
from typing import TYPE_CHECKING

from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from tiger.record import Three

Edges = tuple[float, float, float, float]
LEFT, RIGHT, FRONT, REAR = range(4)
EDGES = ("left", "right", "front", "rear")


@dataclass(frozen=True, slots=True)
class Stance:
    """The robot as far as tipping goes; places are those of the COM of everything, wheels included."""

    height_m: float = 1.0
    """COM above the ground, along the body's z axis."""
    reach_m: Edges = (1.0, 1.0, 1.0, 1.0)
    """From the COM's foot to each edge; positive while it is inside."""
    roll_gyration_m2: float = 0.0
    """Moment of inertia over mass of what turns when the body leans on its springs."""
    pitch_gyration_m2: float = 0.0
    roll_tip_gyration_m2: float = 0.0
    """The same for the whole robot turning about an edge: the wheels come along."""
    pitch_tip_gyration_m2: float = 0.0
    roll_sway_s2pm: float = 0.0
    """How far the springs let the body lean for each m/s2 along its y axis (rad)."""
    pitch_sway_s2pm: float = 0.0
    imu_m: Three = (0.0, 0.0, 0.0)
    """The IMU's place from the COM."""
    strokes_rad: tuple[float, float] = (0.0, 0.0)
    """Roll and pitch that the strokes give the body against the ground."""

    @property
    def least_energy(self) -> float:
        """Energy to tip at rest on level ground, of the easiest edge."""
        return GRAVITY_MPS2 * (hypot(min(self.reach_m), self.height_m) - self.height_m)


def at_com(stance: Stance, force: Three, rate: Three, turn: Three) -> Three:
    """Bring a specific force from the IMU to the COM of a rigid body (m/s2).

    f_c = f - alpha x r - omega x (omega x r), with body rates `rate` (rad/s), their derivatives `turn`
    (rad/s2) and the IMU at r from the COM.
    """
    x, y, z = stance.imu_m
    p, q, r = rate
    along, square = p * x + q * y + r * z, p * p + q * q + r * r
    return (
        force[0] - (turn[1] * z - turn[2] * y) - (along * p - square * x),
        force[1] - (turn[2] * x - turn[0] * z) - (along * q - square * y),
        force[2] - (turn[0] * y - turn[1] * x) - (along * r - square * z),
    )


def load_transfer(stance: Stance, force: Three, turn: Three) -> tuple[float, float]:
    """Return (left - right)/all and (front - rear)/all of the wheel loads, from the moments about the COM.

    sum (r_i x F_i) = I alpha with all r_i on the ground gives the centre of pressure; at +-1 wheels are in
    the air, so it ends there. `force` (m/s2, at the COM) and `turn` (rad/s2) are in body axes.
    """
    left, right, front, rear = stance.reach_m
    push = max(force[2], 1e-3)
    leftward = (-stance.height_m * force[1] + stance.roll_gyration_m2 * turn[0]) / push
    forward = (-stance.height_m * force[0] - stance.pitch_gyration_m2 * turn[1]) / push
    lateral = (2.0 * leftward + right - left) / (left + right)
    longitudinal = (2.0 * forward + rear - front) / (front + rear)
    return min(1.0, max(-1.0, lateral)), min(1.0, max(-1.0, longitudinal))


def outward(stance: Stance, force: Three, turn: Three) -> tuple[Edges, Edges]:
    """Push over each edge: net force outward (m/s2), and net moment over the mass (m2/s2)."""
    roll, pitch = stance.roll_gyration_m2 * turn[0], stance.pitch_gyration_m2 * turn[1]
    return (-force[1], force[1], -force[0], force[0]), (roll, -roll, -pitch, pitch)


def edge_depths(stance: Stance, force: Three) -> Edges:
    """How far below the COM each edge lies, along the body's z axis: a body that leans has them uneven."""
    left, right, front, rear = stance.reach_m
    limit_roll, limit_pitch = 0.5 * (left + right), 0.5 * (front + rear)
    most_y, most_x = GRAVITY_MPS2 * limit_roll, GRAVITY_MPS2 * limit_pitch
    height = stance.height_m  # at which all weight is on one side: the springs give no more
    side = min(most_y, max(-most_y, height * force[1])) * stance.roll_sway_s2pm / height
    ahead = min(most_x, max(-most_x, height * force[0])) * stance.pitch_sway_s2pm / height
    # roll + = left side up: the left wheels hang lower; pitch + = nose down, from braking (force[0] < 0)
    return (
        height + side * limit_roll,
        height - side * limit_roll,
        height + ahead * limit_pitch,
        height - ahead * limit_pitch,
    )


def force_angle(reach: float, depth: float, push: float, moment: float, weight: float) -> tuple[float, float]:
    """Angle (rad) and signed energy (m2/s2) that are left to one edge.

    The edge lies `reach` outward of the COM and `depth` below; `push` and `weight` are the net force outward
    and down, and the net moment adds a force at right angles to the lever (Papadopoulos & Rey, eq. 11).
    """
    lever2 = reach * reach + depth * depth
    push += moment * depth / lever2
    weight -= moment * reach / lever2
    angle = atan2(reach, depth) - atan2(push, weight)
    lever, net = sqrt(lever2), hypot(push, weight)
    lifted = lever * net - (push * reach + weight * depth)  # |f| l (1 - cos theta)
    return angle, copysign(lifted, angle)


def lean_angle(reach: float, depth: float, push: float, weight: float) -> float:
    """Angle of a force without moment to an edge (rad)."""
    return atan2(reach, depth) - atan2(push, weight)


def time_to_balance(
    lever_m: float, gyration_m2: float, upright_rad: float, net_rad: float, rate_radps: float
) -> float:
    """Return when the COM will stand over an edge, if all goes on as it does; inf if it will not.

    Turning about the edge the robot is an inverted pendulum, psi'' = w2 (psi - psi_a), w2 = g l/(l2 + k2):
    `upright_rad` is the angle psi that gravity leaves, `net_rad` the one that the net force leaves,
    psi - psi_a, and `rate_radps` how fast psi shrinks:
    psi(t) = psi_a + (psi - psi_a) cosh(w t) - rate/w sinh(w t).
    """
    if upright_rad <= 0.0:
        return 0.0
    speed = sqrt(GRAVITY_MPS2 * lever_m / (lever_m * lever_m + gyration_m2))
    push = upright_rad - net_rad
    drift = rate_radps / speed
    # With e = exp(w t): (net - drift)/2 e + push + (net + drift)/2 / e = 0
    grows, fades = 0.5 * (net_rad - drift), 0.5 * (net_rad + drift)
    if abs(grows) < 1e-12:
        return ln(-fades / push) / speed if push < 0.0 and fades > -push else inf
    root2 = push * push - 4.0 * grows * fades
    if root2 < 0.0:
        return inf
    root = sqrt(root2)
    later = [e for e in ((-push - root) / (2.0 * grows), (-push + root) / (2.0 * grows)) if e > 1.0]
    return ln(min(later)) / speed if later else inf
