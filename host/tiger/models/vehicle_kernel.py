"""The 14-DOF vehicle's equations of motion (eqs. 5.1-5.19, corrected), compiled.

Errata are numbered as in docs/vehicle-model.md.

Bodies: the sprung body (6 DOF, full rotations), four wheel carriers that slide along the body's z axis, four
wheels that spin about its y axis. The equations are Kane's for the generalised speeds body velocity, body
rates, strut speeds and absolute wheel spins. Carriers are points (their own inertia counts with the body's);
wheels add their spin inertia and gyroscopic torque. The accelerations of struts and spins decouple by hand,
which leaves an elimination of three unknowns instead of a 10 x 10 system.

State (33), SI: position of the body's COM in the world, attitude quaternion (w, x, y, z; body to world), COM
velocity and body rates in body axes, strut compression (wheel up relative to the body) and its rate, wheel
spin, and the two slips of each contact. Corners are FL, FR, RL, RR.

Inputs (34): wheel torque; wheel speed command (NaN: none, else it replaces the torque); actuator force
(+ lifts the body); lift of the spring seat by a series actuator, and its rate; then a force and a moment on
the body at its COM in body axes (disturbances, ideal holds); and the height and speed of a post that lifts
the ground under each wheel (a four-post rig, or a profile given per wheel; it has no slope).
"""

from __future__ import annotations

from math import isnan, sqrt

import numpy as np
from numpy.typing import NDArray

from tiger.models.jit import Record, Row, jit
from tiger.models.soil import compaction_resistance, rolling_direction, sinkage_of_tire, soil_forces
from tiger.models.terrain import ground_at
from tiger.models.tire import contact_forces, contact_slip_rates

Array = NDArray[np.float64]

# Where what is in a state, for people; compiled code counts from the first of four wheels.
POSITION, ATTITUDE, VELOCITY, RATE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
STRUT, STRUT_RATE, SPIN, SLIP = slice(13, 17), slice(17, 21), slice(21, 25), slice(25, 33)
STRUT_AT, STRUT_RATE_AT, SPIN_AT, KAPPA_AT, ALPHA_AT = 13, 17, 21, 25, 29
STATES = 33

TORQUE, SPEED, FORCE, LIFT, LIFT_RATE = (slice(k, k + 4) for k in range(0, 20, 4))
BODY_FORCE, BODY_MOMENT, POST, POST_RATE = slice(20, 23), slice(23, 26), slice(26, 30), slice(30, 34)
TORQUE_AT, SPEED_AT, FORCE_AT, LIFT_AT, LIFT_RATE_AT, POST_AT, POST_RATE_AT = 0, 4, 8, 12, 16, 26, 30
INPUTS = 34

LOAD_AT, FX_AT, FY_AT, STRUT_FORCE_AT, DRIVE_TORQUE_AT, GROUND_AT, SINKAGE_AT = range(7)
CONTACT_FIGURES = 7
"""Per wheel: normal load, F_x, F_y, strut force, drive torque, ground height under it, sinkage."""

VEHICLE = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("gravity", "mass", "roll_inertia", "pitch_inertia", "yaw_inertia"),
            *("tire_stiffness", "tire_damping", "rolling_radius", "spin_inertia"),
            *("torque_max", "speed_gain", "wheel_height"),
        )
    ]
    + [
        (name, np.float64, 4)
        for name in ("x", "y", "wheel_mass", "spring", "damper", "preload", "free_radius")
    ]
)
"""A vehicle as compiled code reads it: COM-relative corner places, strut preload and unloaded tyre radius."""

Plant = tuple[Record, Record, Record, Record, Record, Array]
"""A vehicle where it drives: VEHICLE, tire.TIRE, soil.SOIL, then ground, features, heights of a terrain."""

Rotation = tuple[float, float, float, float, float, float, float, float, float]
"""Body to world, row by row."""


@jit
def _rotation(state: Array) -> Rotation:
    """Rows of eq. 5.2 from the quaternion: its columns are the body's axes in the world."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    return (
        *(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        *(2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        *(2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


@jit
def _in_world(rotation: Rotation, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Turn a vector from body into world axes."""
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = rotation
    return r11 * x + r12 * y + r13 * z, r21 * x + r22 * y + r23 * z, r31 * x + r32 * y + r33 * z


@jit
def _in_body(rotation: Rotation, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Turn a vector from world into body axes."""
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = rotation
    return r11 * x + r21 * y + r31 * z, r12 * x + r22 * y + r32 * z, r13 * x + r23 * y + r33 * z


@jit
def _tangents(
    bx: float, by: float, bz: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float, float, float, float]:
    """Heading and left of a wheel in the ground's tangent plane: body x axis `b`, ground normal `n`."""
    climb = bx * nx + by * ny + bz * nz
    ax, ay, az = bx - climb * nx, by - climb * ny, bz - climb * nz
    length = sqrt(ax * ax + ay * ay + az * az) + 1e-12  # nose straight down: no heading, no slip
    ax, ay, az = ax / length, ay / length, az / length
    return ax, ay, az, ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax


@jit
def _drive_torque(v: Row, torque: float, speed: float, motor_speed: float) -> float:
    """Torque of a motor: as commanded, or towards a speed command where there is one, within its limit."""
    if not isnan(speed):
        torque = v.speed_gain * (speed - motor_speed)
    return min(max(torque, -v.torque_max), v.torque_max)


@jit
def _quaternion_rate(state: Array, p: float, q: float, r: float, out: Array) -> None:
    """Write half the quaternion times the body rates (eq. 5.6 without its singularity)."""
    w, x, y, z = state[3], state[4], state[5], state[6]
    out[3] = -0.5 * (x * p + y * q + z * r)
    out[4] = 0.5 * (w * p + y * r - z * q)
    out[5] = 0.5 * (w * q + z * p - x * r)
    out[6] = 0.5 * (w * r + x * q - y * p)


@jit
def derivative(
    plant: Plant,
    state: Array,
    inputs: Array,
    lead: float,
    out: Array,
    contact: Array,
) -> None:
    """Write the state's rate to `out` (33,) and the wheels' figures to `contact` (4, 7).

    `lead` is the time since the inputs were set: the lift has gone on at its rate since.
    """
    vehicle, tire, soil, ground, features, heights = plant
    v, t, s = vehicle[0], tire[0], soil[0]
    u, w_side, w_up = state[7], state[8], state[9]
    p, q, r = state[10], state[11], state[12]

    rotation = r11, r12, r13, r21, r22, r23, r31, r32, r33 = _rotation(state)
    gx, gy, gz = -v.gravity * r31, -v.gravity * r32, -v.gravity * r33

    # Accelerations of the COM that need no force: omega x v.
    bias_x, bias_y, bias_z = q * w_up - r * w_side, r * u - p * w_up, p * w_side - q * u

    # Force and moment on the body plus what it drags along sideways (carriers), about its COM.
    fx = inputs[20] + v.mass * (gx - bias_x)
    fy = inputs[21] + v.mass * (gy - bias_y)
    fz = inputs[22] + v.mass * (gz - bias_z)
    mx = inputs[23] - (v.yaw_inertia - v.pitch_inertia) * q * r
    my = inputs[24] - (v.roll_inertia - v.yaw_inertia) * p * r
    mz = inputs[25] - (v.pitch_inertia - v.roll_inertia) * p * q
    mass = v.mass
    sx = sy = sz = sxx = syy = szz = sxz = syz = 0.0

    for i in range(4):
        strut, strut_rate, spin = state[STRUT_AT + i], state[STRUT_RATE_AT + i], state[SPIN_AT + i]
        m = v.wheel_mass[i]
        x, y, z = v.x[i], v.y[i], v.wheel_height + strut

        # Wheel centre: place in the world, velocity in body and world axes.
        cx = state[0] + r11 * x + r12 * y + r13 * z
        cy = state[1] + r21 * x + r22 * y + r23 * z
        cz = state[2] + r31 * x + r32 * y + r33 * z
        bx, by, bz = u + q * z - r * y, w_side + r * x - p * z, w_up + p * y - q * x + strut_rate
        wx, wy, wz = _in_world(rotation, bx, by, bz)

        # Tyre spring between ground and wheel, unilateral; its force is minus the gradient of its energy, so
        # that a slope pushes back (erratum of eq. 5.4) and a bump gives no energy away.
        height, hx, hy, grip = ground_at(ground, features, heights, cx, cy)
        height += inputs[POST_AT + i] + lead * inputs[POST_RATE_AT + i]
        compression = height + v.free_radius[i] - cz
        sinkage = 0.0
        if s.soft:
            sinkage = sinkage_of_tire(s, v.tire_stiffness, compression)
            height -= sinkage
        vertical = 0.0
        if compression > 0.0:
            closing = hx * wx + hy * wy - wz + inputs[POST_RATE_AT + i]
            vertical = max(0.0, v.tire_stiffness * (compression - sinkage) + v.tire_damping * closing)
        steepness = sqrt(1.0 + hx * hx + hy * hy)
        load = vertical * steepness
        ax, ay, az, ex, ey, ez = _tangents(r11, r21, r31, -hx / steepness, -hy / steepness, 1.0 / steepness)

        # Sliding: roll moves the contact sideways (erratum 14), spin moves it back.
        arm = (cz - height) / steepness
        hbx, hby, hbz = _in_body(rotation, ax, ay, az)
        forward = ax * wx + ay * wy + az * wz
        sideways = ex * wx + ey * wy + ez * wz + arm * (p * hbx + q * hby + r * hbz)
        slip_speed = spin * v.rolling_radius - forward
        kappa, tan_alpha = state[KAPPA_AT + i], state[ALPHA_AT + i]
        out[KAPPA_AT + i], out[ALPHA_AT + i] = contact_slip_rates(
            t, slip_speed, forward, sideways, kappa, tan_alpha
        )

        rolling = (
            t.rolling_resistance * load * rolling_direction(spin * v.rolling_radius, t.rolling_threshold)
        )
        drag = 0.0
        if s.soft:
            tire_fx, tire_fy = soil_forces(s, load, sinkage, kappa, tan_alpha)
            drag = compaction_resistance(s, sinkage) * rolling_direction(forward, t.rolling_threshold)
        else:
            tire_fx, tire_fy = contact_forces(t, grip, load, slip_speed, forward, sideways, kappa, tan_alpha)

        # Eq. 5.19 with its corrected signs; the motor's stator turns the body back (erratum 17).
        torque = _drive_torque(v, inputs[TORQUE_AT + i], inputs[SPEED_AT + i], spin - q)
        out[SPIN_AT + i] = (torque - (tire_fx + rolling) * v.rolling_radius) / v.spin_inertia

        # Ground force on the wheel in world, then body axes.
        along = tire_fx - drag
        px = -vertical * hx + along * ax + tire_fy * ex
        py = -vertical * hy + along * ay + tire_fy * ey
        pz = vertical + along * az + tire_fy * ez
        qbx, qby, qbz = _in_body(rotation, px, py, pz)

        # Strut (eqs. 5.7-5.9, with preload): up on the body, down on the wheel (erratum of eq. 5.10).
        strut_force = (
            v.preload[i]
            + v.spring[i] * (strut + inputs[LIFT_AT + i] + lead * inputs[LIFT_RATE_AT + i])
            + v.damper[i] * (strut_rate + inputs[LIFT_RATE_AT + i])
            + inputs[FORCE_AT + i]
        )

        # Sideways the carrier hangs rigidly on the body and passes on what its own inertia does not take.
        spin_about = p * x + q * y + r * z
        rate2 = p * p + q * q + r * r
        side_x = qbx + m * (gx - bias_x - p * spin_about + rate2 * x - 2.0 * q * strut_rate)
        side_y = qby + m * (gy - bias_y - q * spin_about + rate2 * y + 2.0 * p * strut_rate)
        fx += side_x
        fy += side_y
        fz += strut_force
        tilt = arm * tire_fy
        gyro = v.spin_inertia * spin
        mx += y * strut_force - z * side_y + tilt * hbx + gyro * r
        my += z * side_x - x * strut_force + tilt * hby - torque
        mz += x * side_y - y * side_x + tilt * hbz - gyro * p

        mass += m
        sx, sy, sz = sx + m * x, sy + m * y, sz + m * z
        sxx, syy, szz = sxx + m * x * x, syy + m * y * y, szz + m * z * z
        sxz, syz = sxz + m * x * z, syz + m * y * z

        # Vertical acceleration of the carrier, less what the body's angular acceleration adds below.
        out[STRUT_AT + i] = strut_rate
        out[STRUT_RATE_AT + i] = (qbz - strut_force) / m + gz - bias_z - r * spin_about + rate2 * z

        contact[i, LOAD_AT], contact[i, FX_AT], contact[i, FY_AT] = load, tire_fx, tire_fy
        contact[i, STRUT_FORCE_AT], contact[i, DRIVE_TORQUE_AT] = strut_force, torque
        contact[i, GROUND_AT], contact[i, SINKAGE_AT] = height, sinkage

    # Carriers couple the sideways and angular accelerations: eliminate U', V', then p', q', then r'.
    pp = v.roll_inertia + szz - sz * sz / mass
    qq = v.pitch_inertia + szz - sz * sz / mass
    rr = v.yaw_inertia + sxx + syy - (sx * sx + sy * sy) / mass
    pr = sx * sz / mass - sxz
    qr = sy * sz / mass - syz
    mx += sz * fy / mass
    my -= sz * fx / mass
    mz += (sy * fx - sx * fy) / mass
    r_dot = (mz - pr / pp * mx - qr / qq * my) / (rr - pr * pr / pp - qr * qr / qq)
    p_dot = (mx - pr * r_dot) / pp
    q_dot = (my - qr * r_dot) / qq
    w_dot = fz / v.mass
    out[7] = (fx - sz * q_dot + sy * r_dot) / mass
    out[8] = (fy + sz * p_dot - sx * r_dot) / mass
    out[9] = w_dot
    out[10], out[11], out[12] = p_dot, q_dot, r_dot
    for i in range(4):
        out[STRUT_RATE_AT + i] -= w_dot + p_dot * v.y[i] - q_dot * v.x[i]

    out[0], out[1], out[2] = _in_world(rotation, u, w_side, w_up)
    _quaternion_rate(state, p, q, r, out)


@jit
def advance(
    plant: Plant,
    state: Array,
    inputs: Array,
    dt: float,
    steps: int,
    contact: Array,
) -> None:
    """Move `state` in place by `steps` fourth-order Runge-Kutta steps of `dt`; the inputs are held."""
    k = np.empty((4, STATES))
    trial = np.empty(STATES)
    lead = 0.0
    for _ in range(steps):
        derivative(plant, state, inputs, lead, k[0], contact)
        for j in range(STATES):
            trial[j] = state[j] + 0.5 * dt * k[0, j]
        half = lead + 0.5 * dt
        derivative(plant, trial, inputs, half, k[1], contact)
        for j in range(STATES):
            trial[j] = state[j] + 0.5 * dt * k[1, j]
        derivative(plant, trial, inputs, half, k[2], contact)
        for j in range(STATES):
            trial[j] = state[j] + dt * k[2, j]
        lead += dt
        derivative(plant, trial, inputs, lead, k[3], contact)
        for j in range(STATES):
            state[j] += dt / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])
        norm = sqrt(state[3] ** 2 + state[4] ** 2 + state[5] ** 2 + state[6] ** 2)
        for j in range(3, 7):
            state[j] /= norm


@jit
def run(
    plant: Plant,
    state: Array,
    inputs: Array,
    dt: float,
    steps: int,
    states: Array,
    rates: Array,
    contacts: Array,
) -> None:
    """Advance by `steps` per row of `inputs` (n, 34); record state, its rate and contacts (n + 1, ...)."""
    n = inputs.shape[0]
    for i in range(n):
        derivative(plant, state, inputs[i], 0.0, rates[i], contacts[i])
        states[i] = state
        advance(plant, state, inputs[i], dt, steps, contacts[n])
    derivative(plant, state, inputs[n - 1], steps * dt, rates[n], contacts[n])
    states[n] = state
