"""The elastic actuated mechanism (EAM) of one corner: from actuator stroke to wheel, exactly and fast.

`Eam` solves the dissertation's eqs. 4.1-4.4: five bodies in the plane (1 robot body, 2 rocker, 3 damper taken
as rigid, 4 lower arm, 5 wheel carrier), fifteen coordinates `q = [y_i, z_i, phi_i]`, fourteen kinematic
constraints and the stroke as the driving one. `LiftCurve` is its fast interpolant for control loops.

Plane of one corner: y outboard, z up, origin on the ground below the lower-arm pivot P8; angles
counter-clockwise with y right and z up, so `phi_4` is minus the arm angle (positive = robot body raised).
Lengths in mm. Arrays are vectorised over strokes: (n,) of strokes gives (n, 15) of coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from tiger.config.vehicle import MechanismConfig, VehicleConfig

Array = NDArray[np.float64]

BODIES = 5
COORDINATES = 3 * BODIES
RESIDUAL_LIMIT = 1e-12
"""Newton stops below this scaled residual (lengths over the arm length, angles in rad)."""

_MAX_ITERATIONS = 12
_TABLE_STEP_MM = 2.0
_SLACK_MM = 1e-6
"""Rounding that still counts as inside the range."""


class MechanismError(ValueError):
    """A stroke or rise the mechanism cannot take, or points that make no mechanism."""


@dataclass(frozen=True, slots=True)
class EamPose:
    """What a corner looks like at each stroke; every field has the shape of the strokes."""

    stroke_mm: Array
    arm_angle_rad: Array
    """Lower arm below the horizontal; positive = robot body raised."""
    rise_mm: Array
    """Height of the robot body above its height at zero stroke, wheel on the ground."""
    ground_clearance_mm: Array
    """Height of the lower-arm pivot P8 above the ground."""
    track_mm: Array
    """Distance between the left and right wheels' mid-planes when both corners stand alike."""
    motion_ratio: Array
    """d(rise)/d(stroke)."""
    transmission_angle_rad: Array
    """Between damper and arm at P9; the mechanism locks at 0 and pi."""


@dataclass(frozen=True, slots=True)
class _Joint:
    """A revolute joint: a point of body `i` and a point of body `j` (indices from 0) stay together."""

    i: int
    point_i: Array
    j: int
    point_j: Array


class Eam:
    """Kinematics of one EAM corner.

    Raises MechanismError when the points make no mechanism over the whole stroke: no assembly, a change of
    assembly, or a rise that does not grow with the stroke.
    """

    def __init__(
        self,
        mechanism: MechanismConfig,
        *,
        stroke_max_mm: float,
        length_at_zero_stroke_mm: float,
        wheel_radius_mm: float,
    ) -> None:
        self.mechanism = mechanism
        self.stroke_max_mm = stroke_max_mm
        self.length_at_zero_stroke_mm = length_at_zero_stroke_mm
        self.wheel_radius_mm = wheel_radius_mm

        # Inside, lengths are counted in arm lengths: Jacobian entries are then of order one.
        self._unit_mm = mechanism.arm_length_mm
        origin = np.zeros(2)
        self._p1 = np.array(mechanism.actuator_anchor_mm) / self._unit_mm
        self._p4 = np.array(mechanism.rocker_pivot_mm) / self._unit_mm
        self._p2 = np.array([mechanism.rocker_actuator_arm_mm, 0.0]) / self._unit_mm
        rocker_angle = mechanism.rocker_angle_rad
        self._p3 = (
            np.array([np.cos(rocker_angle), np.sin(rocker_angle)])
            * mechanism.rocker_damper_arm_mm
            / self._unit_mm
        )
        damper_end = np.array([mechanism.damper_length_mm, 0.0]) / self._unit_mm
        self._p9 = np.array(mechanism.damper_mount_mm) / self._unit_mm
        arm_end = np.array([1.0, 0.0])
        carrier_joint = np.array([-mechanism.hub_offset_mm, 0.0]) / self._unit_mm
        # In the order of eq. 4.2: P4, P8, P3, P9, P7. Origins: P8 (body 1), P4, P3, P8 (arm), wheel centre.
        self._joints = (
            _Joint(0, self._p4, 1, origin),
            _Joint(0, origin, 3, origin),
            _Joint(1, self._p3, 2, origin),
            _Joint(2, damper_end, 3, self._p9),
            _Joint(3, arm_end, 4, carrier_joint),
        )
        self._assembly = np.zeros(2)
        self._table_mm, self._table_q = self._walk_the_stroke()
        self._rise_origin_mm = float(self._table_q[0, 1] * self._unit_mm)

    @classmethod
    def from_vehicle(cls, vehicle: VehicleConfig) -> Eam:
        """Build the mechanism of a vehicle whose config has one; raises MechanismError if it has none."""
        actuator = vehicle.actuator
        if vehicle.eam is None or actuator.kind != "rate":
            raise MechanismError(
                "this vehicle has no mechanism: give it an [eam] section and a rate actuator"
            )
        return cls(
            vehicle.eam,
            stroke_max_mm=actuator.stroke_max_mm,
            length_at_zero_stroke_mm=actuator.length_at_zero_stroke_mm,
            wheel_radius_mm=vehicle.tire.rolling_radius_m * 1000.0,
        )

    # ---- what users ask ---------------------------------------

    def pose(self, stroke_mm: ArrayLike) -> EamPose:
        """Solve the mechanism at each stroke. Raises MechanismError for a stroke outside 0..stroke_max_mm."""
        strokes = _within(stroke_mm, self.stroke_max_mm, "stroke")
        flat = np.atleast_1d(strokes).ravel()
        q = self.assemble(flat)
        ratio = self.velocity(q, flat, 1.0)[:, 1]
        half_track = self.mechanism.arm_pivot_from_midplane_mm + q[:, 12]
        _, transmission = self._transmission_angles(self._scaled(q))

        def shaped(values: Array) -> Array:
            return values.reshape(strokes.shape)

        return EamPose(
            stroke_mm=shaped(flat),
            arm_angle_rad=shaped(-q[:, 11]),
            rise_mm=shaped(q[:, 1] - self._rise_origin_mm),
            ground_clearance_mm=shaped(q[:, 1]),
            track_mm=shaped(2.0 * half_track),
            motion_ratio=shaped(ratio),
            transmission_angle_rad=shaped(np.abs(transmission)),
        )

    def stroke_for_rise(self, rise_mm: ArrayLike) -> Array:
        """Return the stroke that gives each rise (inverse of `pose().rise_mm`).

        Raises MechanismError for a rise that no stroke gives.
        """
        highest = float(self.pose(self.stroke_max_mm).rise_mm)
        rises = _within(rise_mm, highest, "rise")
        strokes = np.interp(rises, self._table_q[:, 1] * self._unit_mm - self._rise_origin_mm, self._table_mm)
        for _ in range(_MAX_ITERATIONS):
            pose = self.pose(strokes)
            error = pose.rise_mm - rises
            strokes = np.clip(strokes - error / pose.motion_ratio, 0.0, self.stroke_max_mm)
            if np.all(np.abs(error) < 1e-10 * self._unit_mm):
                break
        return np.asarray(strokes)

    def curve(self) -> LiftCurve:
        """Build the fast interpolant of rise against stroke."""
        pose = self.pose(self._table_mm)
        return LiftCurve(pose.stroke_mm, pose.rise_mm, pose.motion_ratio)

    # ---- eqs. 4.2 to 4.4 --------------------------------------

    def assemble(self, stroke_mm: ArrayLike, guess: Array | None = None) -> Array:
        """Return the coordinates q, (n, 15), that satisfy eq. 4.2 at strokes (n,), in the designed assembly.

        `guess` (n, 15) replaces the built-in starting point. Raises MechanismError for strokes outside the
        range, where Newton finds no assembly, and where it finds the wrong one.
        """
        strokes = np.atleast_1d(_within(stroke_mm, self.stroke_max_mm, "stroke"))
        start = self._guess(strokes) if guess is None else self._scaled(guess)
        q, _ = self._newton(strokes, start)
        self._require_assembly(strokes, q)
        return self._in_mm(q)

    def residual(self, q: Array, stroke_mm: ArrayLike) -> Array:
        """Return the scaled constraints of eq. 4.2, (n, 15), at coordinates (n, 15) and strokes (n,)."""
        strokes = np.atleast_1d(np.asarray(stroke_mm, dtype=float))
        return self._constraints(self._scaled(q), strokes)

    def velocity(self, q: Array, stroke_mm: ArrayLike, rate_mmps: ArrayLike) -> Array:
        """Return dq/dt, (n, 15), for actuator rates (n,) or one for all (eq. 4.3)."""
        strokes = np.atleast_1d(np.asarray(stroke_mm, dtype=float))
        scaled = self._scaled(q)
        right = np.zeros_like(scaled)
        right[:, -1] = -2.0 * self._length(strokes) * np.asarray(rate_mmps, dtype=float) / self._unit_mm
        return self._in_mm(_solve(self._jacobian(scaled), right))

    def acceleration(
        self,
        q: Array,
        q_dot: Array,
        stroke_mm: ArrayLike,
        rate_mmps: ArrayLike,
        accel_mmps2: ArrayLike = 0.0,
    ) -> Array:
        """Return d2q/dt2, (n, 15), for actuator rates and accelerations (n,) (eq. 4.4)."""
        strokes = np.atleast_1d(np.asarray(stroke_mm, dtype=float))
        scaled, speed = self._scaled(q), self._scaled(q_dot)
        rate = np.asarray(rate_mmps, dtype=float) / self._unit_mm
        accel = np.asarray(accel_mmps2, dtype=float) / self._unit_mm
        right = -self._quadratic_velocity_terms(scaled, speed)
        right[:, -1] -= 2.0 * (rate * rate + self._length(strokes) * accel)
        return self._in_mm(_solve(self._jacobian(scaled), right))

    def _length(self, strokes: Array) -> Array:
        """Actuator length S of eq. 4.2, in arm lengths."""
        return (self.length_at_zero_stroke_mm + strokes) / self._unit_mm

    def _constraints(self, q: Array, strokes: Array) -> Array:
        phi = np.empty_like(q)
        phi[:, 0] = q[:, 0]
        phi[:, 1] = q[:, 2]
        for row, joint in zip(range(2, 12, 2), self._joints, strict=True):
            phi[:, row : row + 2] = _point(q, joint.i, joint.point_i) - _point(q, joint.j, joint.point_j)
        phi[:, 12] = q[:, 14]
        phi[:, 13] = q[:, 13] - self.wheel_radius_mm / self._unit_mm
        span = self._actuator(q)
        phi[:, 14] = self._length(strokes) ** 2 - np.einsum("nk,nk->n", span, span)
        return phi

    def _jacobian(self, q: Array) -> Array:
        jacobian = np.zeros((len(q), COORDINATES, COORDINATES))
        jacobian[:, 0, 0] = 1.0
        jacobian[:, 1, 2] = 1.0
        for row, joint in zip(range(2, 12, 2), self._joints, strict=True):
            for body, point, sign in ((joint.i, joint.point_i, 1.0), (joint.j, joint.point_j, -1.0)):
                column = 3 * body
                jacobian[:, row, column] = jacobian[:, row + 1, column + 1] = sign
                jacobian[:, row : row + 2, column + 2] = sign * _turned(_arm(q, body, point))
        jacobian[:, 12, 14] = 1.0
        jacobian[:, 13, 13] = 1.0
        span = self._actuator(q)
        for body, point, sign in ((1, self._p2, -2.0), (0, self._p1, 2.0)):
            column = 3 * body
            jacobian[:, 14, column : column + 2] = sign * span
            jacobian[:, 14, column + 2] = sign * np.einsum("nk,nk->n", span, _turned(_arm(q, body, point)))
        return jacobian

    def _quadratic_velocity_terms(self, q: Array, speed: Array) -> Array:
        """(Phi_q q')_q q' of eq. 4.4; Phi_qt is zero because S enters alone."""

        def centripetal(body: int, point: Array) -> Array:
            return -_arm(q, body, point) * speed[:, 3 * body + 2, None] ** 2

        terms = np.zeros_like(q)
        for row, joint in zip(range(2, 12, 2), self._joints, strict=True):
            terms[:, row : row + 2] = centripetal(joint.i, joint.point_i) - centripetal(
                joint.j, joint.point_j
            )
        span = self._actuator(q)
        span_speed = _point_speed(q, speed, 1, self._p2) - _point_speed(q, speed, 0, self._p1)
        bend = centripetal(1, self._p2) - centripetal(0, self._p1)
        terms[:, 14] = -2.0 * np.einsum("nk,nk->n", span_speed, span_speed)
        terms[:, 14] -= 2.0 * np.einsum("nk,nk->n", span, bend)
        return terms

    def _actuator(self, q: Array) -> Array:
        """Vector from P1 to P2."""
        return _point(q, 1, self._p2) - _point(q, 0, self._p1)

    # ---- Newton and the assembly ------------------------------

    def _newton(self, strokes: Array, start: Array) -> tuple[Array, int]:
        """Solve eq. 4.2 from `start`; returns the scaled coordinates and the iterations used."""
        q = start.copy()
        for iteration in range(_MAX_ITERATIONS + 1):
            with np.errstate(over="ignore", invalid="ignore"):  # a diverging start may leave the numbers
                phi = self._constraints(q, strokes)
            if np.all(np.abs(phi) < RESIDUAL_LIMIT):
                return q, iteration
            q = q - _solve(self._jacobian(q), phi)
        error = np.abs(phi).max(axis=1)
        error[~np.isfinite(error)] = np.inf
        worst = strokes[np.argmax(error)]
        raise MechanismError(
            f"no assembly at stroke {worst:.3f} mm "
            f"(actuator length {self.length_at_zero_stroke_mm + worst:.1f} mm); "
            "shorten the stroke, check the [eam] points, or start nearer to the solution"
        )

    def _require_assembly(self, strokes: Array, q: Array) -> None:
        wrong = np.any(np.sign(np.stack(self._transmission_angles(q), axis=-1)) != self._assembly, axis=1)
        if np.any(wrong):
            raise MechanismError(
                f"wrong assembly at stroke {strokes[np.argmax(wrong)]:.3f} mm: a transmission angle changed "
                "its sign; start nearer to the solution, or check the [eam] points"
            )

    def _transmission_angles(self, q: Array) -> tuple[Array, Array]:
        """Signed angles actuator-rocker at P2 and damper-arm at P9; a sign is one of two ways to assemble."""
        p2, p9 = _point(q, 1, self._p2), _point(q, 3, self._p9)
        rocker = p2 - _point(q, 0, self._p4)
        damper, arm = p9 - _point(q, 1, self._p3), p9 - _point(q, 0, np.zeros(2))
        return _angle_between(self._actuator(q), rocker), _angle_between(damper, arm)

    def _walk_the_stroke(self) -> tuple[Array, Array]:
        """Assemble at zero stroke, then step to the full one: the starting points of every later solution."""
        strokes = np.linspace(0.0, self.stroke_max_mm, int(np.ceil(self.stroke_max_mm / _TABLE_STEP_MM)) + 1)
        q, _ = self._newton(strokes[:1], self._first_guess())
        self._assembly = np.sign(np.stack(self._transmission_angles(q), axis=-1))[0]
        if abs(-q[0, 11] - self.mechanism.arm_angle_at_zero_stroke_rad) > 0.2:
            raise MechanismError(
                f"the arm stands at {-q[0, 11]:.3f} rad at zero stroke, but "
                f"eam.arm_angle_at_zero_stroke_rad = {self.mechanism.arm_angle_at_zero_stroke_rad:.3f}; "
                "correct it or the points"
            )
        rows = [q]
        step = strokes[1] - strokes[0]
        for before, stroke in pairwise(strokes):
            speed = self._scaled(self.velocity(self._in_mm(rows[-1]), before, step))
            q, _ = self._newton(np.array([stroke]), rows[-1] + speed)
            self._require_assembly(np.array([stroke]), q)
            rows.append(q)
        table = np.concatenate(rows)
        if np.any(np.diff(table[:, 1]) <= 0.0):
            raise MechanismError(
                "the robot body does not rise with the stroke everywhere; check the [eam] points"
            )
        return strokes, table

    def _first_guess(self) -> Array:
        """Draw the linkage at zero stroke from the configured arm angle.

        Of the two ways to place the rocker, take the one whose actuator length is nearer to the given one.
        """
        phi_4 = -self.mechanism.arm_angle_at_zero_stroke_rad
        height = (self.wheel_radius_mm / self._unit_mm) - np.sin(phi_4)
        p9 = _rotation(phi_4) @ self._p9
        damper = self.mechanism.damper_length_mm / self._unit_mm
        guesses, errors = [], []
        for p3 in _circle_crossings(self._p4, float(np.hypot(*self._p3)), p9, damper):
            phi_2 = _direction(p3 - self._p4) - self.mechanism.rocker_angle_rad
            phi_2 = float(np.arctan2(np.sin(phi_2), np.cos(phi_2)))
            p2 = self._p4 + _rotation(phi_2) @ self._p2
            errors.append(abs(float(np.hypot(*(p2 - self._p1))) - float(self._length(np.zeros(1))[0])))
            wheel = np.array([np.cos(phi_4) + self.mechanism.hub_offset_mm / self._unit_mm, np.sin(phi_4)])
            points = (np.zeros(2), self._p4, p3, np.zeros(2), wheel)
            angles = (0.0, phi_2, _direction(p9 - p3), phi_4, 0.0)
            guesses.append(
                [value for p, a in zip(points, angles, strict=True) for value in (p[0], p[1] + height, a)]
            )
        if not guesses:
            raise MechanismError(
                f"no assembly: the damper ({self.mechanism.damper_length_mm} mm) does not reach from the "
                "rocker to the arm at zero stroke; check the [eam] points"
            )
        return np.asarray([guesses[int(np.argmin(errors))]], dtype=float)

    def _guess(self, strokes: Array) -> Array:
        """Nearest row of the table, moved along its tangent."""
        step = self._table_mm[1] - self._table_mm[0]
        nearest = np.rint(strokes / step).astype(int)
        q, at = self._table_q[nearest], self._table_mm[nearest]
        tangent = self._scaled(self.velocity(self._in_mm(q), at, strokes - at))
        return np.asarray(q + tangent)

    def _scaled(self, q: Array) -> Array:
        scaled = np.array(q, dtype=float).reshape(-1, BODIES, 3)
        scaled[:, :, :2] /= self._unit_mm
        return scaled.reshape(-1, COORDINATES)

    def _in_mm(self, q: Array) -> Array:
        result = q.reshape(-1, BODIES, 3).copy()
        result[:, :, :2] *= self._unit_mm
        return result.reshape(-1, COORDINATES)


class LiftCurve:
    """Rise of the robot body against stroke: cubic Hermite pieces on equal steps, well within 1 um of `Eam`.

    A stroke outside the range counts as the end it passed: a noisy potentiometer at an end stop is no error.
    """

    def __init__(self, stroke_mm: Array, rise_mm: Array, slope: Array) -> None:
        """Interpolate rises and slopes (n,) given at equally spaced strokes (n,) that start at 0."""
        from scipy.interpolate import CubicHermiteSpline

        spline = CubicHermiteSpline(stroke_mm, rise_mm, slope)
        self.stroke_max_mm = float(stroke_mm[-1])
        self.rise_max_mm = float(rise_mm[-1])
        self._spline = spline
        self._slope = spline.derivative()
        self._nodes = (stroke_mm, rise_mm)
        self.pieces = np.ascontiguousarray(spline.c.T)
        """Coefficients of each piece, (n - 1, 4): c3, c2, c1, c0 of the stroke beyond the piece's start."""
        self.pieces_per_mm = (len(stroke_mm) - 1) / self.stroke_max_mm
        self._last = len(stroke_mm) - 2
        # Plain floats: indexing a list of tuples costs a tenth of a call into scipy.
        self._pieces = [tuple(map(float, piece)) for piece in self.pieces]

    def rise_mm(self, stroke_mm: ArrayLike) -> Array:
        """Return the rise at each stroke."""
        return np.asarray(self._spline(np.clip(stroke_mm, 0.0, self.stroke_max_mm)))

    def motion_ratio(self, stroke_mm: ArrayLike) -> Array:
        """Return d(rise)/d(stroke) at each stroke."""
        return np.asarray(self._slope(np.clip(stroke_mm, 0.0, self.stroke_max_mm)))

    def stroke_mm(self, rise_mm: ArrayLike) -> Array:
        """Return the stroke that gives each rise; a rise outside the range gives the end it passed."""
        rises = np.clip(rise_mm, 0.0, self.rise_max_mm)
        strokes = np.interp(rises, self._nodes[1], self._nodes[0])
        for _ in range(3):
            strokes = np.clip(
                strokes - (self._spline(strokes) - rises) / self._slope(strokes), 0.0, self.stroke_max_mm
            )
        return np.asarray(strokes)

    def at(self, stroke_mm: float) -> tuple[float, float]:
        """Return (rise_mm, motion ratio) at one stroke, in under a microsecond."""
        stroke, per_mm = stroke_mm, self.pieces_per_mm
        if stroke < 0.0:
            stroke = 0.0
        elif stroke > self.stroke_max_mm:
            stroke = self.stroke_max_mm
        index = int(stroke * per_mm)
        if index > self._last:
            index = self._last
        c3, c2, c1, c0 = self._pieces[index]
        x = stroke - index / per_mm
        return ((c3 * x + c2) * x + c1) * x + c0, (3.0 * c3 * x + 2.0 * c2) * x + c1


# ---- plane geometry, vectorised over rows of q ------------


def _arm(q: Array, body: int, point: Array) -> Array:
    """Vector from a body's origin to one of its points, (n, 2)."""
    phi = q[:, 3 * body + 2]
    cos, sin = np.cos(phi), np.sin(phi)
    return np.stack([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]], axis=-1)


def _point(q: Array, body: int, point: Array) -> Array:
    return q[:, 3 * body : 3 * body + 2] + _arm(q, body, point)


def _point_speed(q: Array, speed: Array, body: int, point: Array) -> Array:
    turning = _turned(_arm(q, body, point)) * speed[:, 3 * body + 2, None]
    return speed[:, 3 * body : 3 * body + 2] + turning


def _turned(vector: Array) -> Array:
    """Turn vectors (n, 2) a quarter turn counter-clockwise."""
    return np.stack([-vector[:, 1], vector[:, 0]], axis=-1)


def _angle_between(first: Array, second: Array) -> Array:
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(np.arctan2(cross, np.einsum("nk,nk->n", first, second)))


def _rotation(angle: float) -> Array:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _direction(vector: Array) -> float:
    return float(np.arctan2(vector[1], vector[0]))


def _circle_crossings(centre_a: Array, radius_a: float, centre_b: Array, radius_b: float) -> list[Array]:
    """Return the two points where the circles cross; none when they do not."""
    line = centre_b - centre_a
    distance = float(np.hypot(*line))
    along = (distance**2 + radius_a**2 - radius_b**2) / (2.0 * distance)
    across_squared = radius_a**2 - along**2
    if across_squared < 0.0:
        return []
    across = np.sqrt(across_squared)
    unit = line / distance
    normal = np.array([-unit[1], unit[0]])
    return [centre_a + along * unit + side * across * normal for side in (1.0, -1.0)]


def _solve(matrix: Array, right: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0], dtype=float)
    except np.linalg.LinAlgError as error:
        raise MechanismError("the mechanism is at a dead point; check the [eam] points") from error


def _within(values: ArrayLike, highest: float, name: str) -> Array:
    """Return the values as an array within 0..highest, or raise MechanismError (NaN is outside too)."""
    array = np.asarray(values, dtype=float)
    inside = (array >= -_SLACK_MM) & (array <= highest + _SLACK_MM)
    if not np.all(inside):
        bad = float(np.ravel(array)[np.argmin(np.ravel(inside))])
        raise MechanismError(
            f"{name} {bad:g} mm is outside 0..{highest:g} mm; stay within the actuator's range"
        )
    return np.asarray(np.clip(array, 0.0, highest))
