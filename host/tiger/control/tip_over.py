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

from math import atan2, cos, hypot, inf, sin, sqrt, tan
from math import log as ln
from typing import TYPE_CHECKING

from tiger.frozen import dataclass
from tiger.models.full_car import GRAVITY_MPS2

if TYPE_CHECKING:
    from tiger.record import Three

Edges = tuple[float, float, float, float]
Contacts = tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]
"""How far outward and how far below the COM each edge lies, in the body's axes (m)."""

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
    """Mass times height over the springs' stiffness against roll: the lean for each m/s2 along y."""
    pitch_sway_s2pm: float = 0.0
    wheel_radius_m: float = 0.0
    spin_m: float = 0.0
    """Spin inertia of the wheels over mass and radius: their share in the pitch moment for each m/s2."""
    rolling_m: float = 0.0
    """How far the ground carries a rolling wheel ahead of its centre."""
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


def contacts(stance: Stance, lean: tuple[float, float]) -> Contacts:
    """Return where the ground carries a body that leans on it by `lean` (roll, pitch).

    Wheels slide along the body's z axis, and stand on the ground straight below their centres.
    """
    left, right, front, rear = stance.reach_m
    (roll, pitch), radius = lean, stance.wheel_radius_m
    hub = stance.height_m - radius
    side, ahead = radius * sin(roll), radius * sin(pitch)
    across, along = hub + radius * cos(roll), hub + radius * cos(pitch)
    rising, diving = tan(roll), tan(pitch)
    return (
        (left - side, across + left * rising),
        (right + side, across - right * rising),
        (front + ahead, along - front * diving),
        (rear - ahead, along + rear * diving),
    )


def spring_lean(stance: Stance, force: Three, turn: tuple[float, float]) -> tuple[float, float]:
    """Roll and pitch that the springs give the body, up to where wheels lift.

    They carry the moment of the specific force `force` but for what turns the body (`turn`, rad/s2).
    """
    left, right, front, rear = stance.reach_m
    height, radius = stance.height_m, stance.wheel_radius_m
    side = force[1] - stance.roll_gyration_m2 * turn[0] / height
    ahead = force[0] + stance.pitch_gyration_m2 * turn[1] / height
    # K lean = m (h f - r g lean), and no moment is larger than all weight on one side makes it.
    roll_sway, pitch_sway = stance.roll_sway_s2pm, stance.pitch_sway_s2pm
    own = radius / height * GRAVITY_MPS2
    per_m = 0.5 * GRAVITY_MPS2 / height
    most_y, most_x = per_m * (left + right), per_m * (front + rear)
    push_y = min(most_y, max(-most_y, side / (1.0 + own * roll_sway)))
    push_x = min(most_x, max(-most_x, ahead / (1.0 + own * pitch_sway)))
    return push_y * roll_sway, -push_x * pitch_sway


def load_transfer(
    stance: Stance, places: Contacts, force: Three, moment: tuple[float, float]
) -> tuple[float, float]:
    """Return (left - right)/all and (front - rear)/all of the wheel loads, from the moments about the COM.

    The ground's force acts somewhere on the line between the contacts of two sides: sum (r_i x F_i) = I alpha
    says where. At +-1 wheels are in the air, so it ends there. `force` (m/s2, at the COM) and `moment` (I
    alpha over mass, m2/s2, roll and pitch) are in body axes.
    """
    (left, below_left), (right, below_right), (front, below_front), (rear, below_rear) = places
    ahead, side, up = force
    at_left, at_right = left * up + below_left * side, below_right * side - right * up
    lateral = 1.0 - 2.0 * (moment[0] - at_left) / (at_right - at_left)
    at_front, at_rear = -front * up - below_front * ahead, rear * up - below_rear * ahead
    longitudinal = 1.0 - 2.0 * (moment[1] - at_front) / (at_rear - at_front)
    return min(1.0, max(-1.0, lateral)), min(1.0, max(-1.0, longitudinal))


def angle(reach: float, depth: float, push: float, weight: float) -> float:
    """Angle (rad) that a force leaves to an edge `reach` outward of the COM and `depth` below.

    atan2(reach, depth) - atan2(push, weight), `push` and `weight` the force outward and down.
    """
    return atan2(reach * weight - depth * push, reach * push + depth * weight)


def force_angle(reach: float, depth: float, push: float, moment: float, weight: float) -> tuple[float, float]:
    """Angle (rad) and signed energy (m2/s2) that are left to one edge.

    The edge lies `reach` outward of the COM and `depth` below; `push` and `weight` are the net force outward
    and down, and the net `moment` over the mass (m2/s2) adds a force at right angles to the lever
    (Papadopoulos & Rey, eq. 11).
    """
    lever2 = reach * reach + depth * depth
    push += moment * depth / lever2
    weight -= moment * reach / lever2
    across, along = reach * weight - depth * push, reach * push + depth * weight
    lifted = sqrt(lever2 * (push * push + weight * weight)) - along  # |f| l (1 - cos theta)
    return atan2(across, along), lifted if across > 0.0 else -lifted


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
    if 0.0 < net_rad > drift and push >= 0.0:
        return inf  # it falls back before it gets to psi_a, and that is still inside
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
