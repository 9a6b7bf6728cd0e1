"""The augmented closed loop (6.28)-(6.29), and how far it is from instability: disk, gain and delay
margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tiger.control.ride import PERIOD_S, hold
from tiger.models.full_car import BODY_ACCELERATION, CORNERS, FORCE, IMU, ROAD, SUSPENSION, TIRE, full_car
from tiger.models.linear import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tiger.control.ride import RideController
    from tiger.models.full_car import FullCarParameters

    Array = NDArray[np.float64]

NOISE = ("noise_heave_accel_mps2", "noise_pitch_rate_radps", "noise_roll_rate_radps")
PUSH = tuple(f"push_{corner}_n" for corner in CORNERS)
"""A force added at the actuators that the controller does not know of."""
OUTPUTS = (*BODY_ACCELERATION, *SUSPENSION, *TIRE, *FORCE)


@dataclass(frozen=True, slots=True)
class Margins:
    """How much the loop tolerates at the plant's inputs.

    disk_margin: the smallest symmetric disk margin of one actuator with the others closed (Seiler, Packard
    and Gahinet 2020); gain_margin_db and phase_margin_deg are what it guarantees. multiloop_disk_margin: all
    four at once, unstructured. delay_margin_s: delay of all forces, beyond the designed one, at which the
    loop turns unstable.
    """

    disk_margin: float
    multiloop_disk_margin: float
    gain_margin_db: float
    phase_margin_deg: float
    delay_margin_s: float


def closed_loop(
    p: FullCarParameters,
    controller: RideController,
    delay_s: float = 0.0,
    imu_offset_m: tuple[float, float] = (0.0, 0.0),
) -> LinearModel:
    """Close the loop of a vehicle and a controller that may have been designed for another one.

    States: car (14), filter, the forces computed before, and the push that acted until now. Inputs: ROAD held
    over a period, NOISE on the IMU, PUSH. Outputs: accelerations, deflections and FORCE as computed.
    `delay_s` is any time from measurement to force.
    """
    n = len(controller.model.a)
    late, fraction = divmod(delay_s / PERIOD_S + 1e-12, 1.0)
    first, rest = fraction * PERIOD_S, (1 - fraction) * PERIOD_S
    depth = max(int(late), controller.delay_samples) + 1
    car = full_car(p, imu_offset_m).select(inputs=(*ROAD, *FORCE))
    whole, over_period, _ = hold(car.a, car.b, PERIOD_S)
    after, in_rest, _ = hold(car.a, car.b, rest)
    _, in_first, _ = hold(car.a, car.b, first)

    size = 14 + n + 4 * depth + 4
    columns = size + 4 + 3 + 4  # states, road, noise, push: every row below is a map from these

    def take(start: int, count: int) -> Array:
        return np.eye(columns)[start : start + count]

    x, estimate_before = take(0, 14), take(14, n)
    past = [take(14 + n + 4 * i, 4) for i in range(depth)]  # past[i] was computed i + 1 samples ago
    pushed = take(size - 4, 4)
    road, noise, push = take(size, 4), take(size + 4, 3), take(size + 7, 4)

    imu = car.select(inputs=FORCE, outputs=IMU)
    measured = imu.c @ x + imu.d @ (past[int(late)] + pushed) + noise
    predicted, force = _controlled(controller, measured, estimate_before, past)
    acting = force if late < 1 else past[int(late) - 1]
    moved = (
        whole @ x
        + over_period[:, :4] @ road
        + after @ in_first[:, 4:] @ past[int(late)]
        + in_rest[:, 4:] @ acting
        + over_period[:, 4:] @ push
    )
    outputs = car.select(outputs=OUTPUTS[:-4])
    seen = outputs.c @ x + outputs.d[:, :4] @ road + outputs.d[:, 4:] @ (acting + push)
    step = np.vstack([moved, predicted, force, *past[:-1], push])
    out = np.vstack([seen, force])
    states = (
        *car.states,
        *(f"estimate_{i}" for i in range(n)),
        *(f"force_{corner}_{i + 1}_ago_n" for i in range(depth) for corner in CORNERS),
        *(f"pushed_{corner}_n" for corner in CORNERS),
    )
    (a, b), (c, d) = np.hsplit(step, [size]), np.hsplit(out, [size])
    return LinearModel(a, b, c, d, states, (*ROAD, *NOISE, *PUSH), OUTPUTS, PERIOD_S)


def _controlled(
    controller: RideController, measured: Array, before: Array, past: list[Array]
) -> tuple[Array, Array]:
    """Return the filter's next state and the force, as `ride.step` has them when no limit acts.

    `measured`, the filter's state `before` and `past` forces, newest first, are maps from the same columns.
    """
    model = controller.model
    innovation = measured - model.c @ before - model.d @ past[controller.delay_samples]
    estimate = before + controller.filter_gain @ innovation
    if controller.delay_samples:
        predicted = model.a @ estimate + model.b @ past[0]
        return predicted, -controller.feedback @ predicted
    force = -controller.feedback @ estimate
    return model.a @ estimate + model.b @ force, force


def is_stable(p: FullCarParameters, controller: RideController, delay_s: float = 0.0) -> bool:
    """Say whether every pole of the closed loop lies inside the unit circle."""
    return bool(np.abs(closed_loop(p, controller, delay_s).poles()).max() < 1.0)


def margins(p: FullCarParameters, controller: RideController, lines: int = 300) -> Margins:
    """Compute the margins of a controller on a vehicle. Raises ValueError where the loop is not stable to
    begin with."""
    designed = controller.delay_samples * PERIOD_S
    if not is_stable(p, controller, designed):
        raise ValueError("the closed loop is unstable as designed: it has no margins")
    loop = closed_loop(p, controller, designed).select(inputs=PUSH, outputs=FORCE)
    frequency = np.geomspace(0.05, 0.499 / PERIOD_S, lines)
    # What acts is the push and the force computed `delay_samples` ago.
    late = np.exp(-2j * np.pi * frequency * designed)[:, None, None]
    sensitivity = late * loop.frequency_response(frequency) + np.eye(4)
    centred = sensitivity - 0.5 * np.eye(4)
    single = 1 / float(np.abs(np.diagonal(centred, axis1=1, axis2=2)).max())
    together = 1 / float(np.linalg.norm(centred, ord=2, axis=(1, 2)).max())
    reach = min(single, 1.999)
    gain = 20 * np.log10((2 + reach) / (2 - reach))
    phase = np.rad2deg(2 * np.arctan(reach / 2))
    return Margins(single, together, float(gain), float(phase), _delay_margin(p, controller, designed))


def _delay_margin(
    p: FullCarParameters, controller: RideController, designed: float, most: float = 0.1
) -> float:
    """Find the first unstable extra delay up to `most`, by steps of half a period and then by bisection."""
    low, step = 0.0, 0.5 * PERIOD_S
    while low < most and is_stable(p, controller, designed + low + step):
        low += step
    if low >= most:
        return most
    high = low + step
    for _ in range(8):
        middle = 0.5 * (low + high)
        if is_stable(p, controller, designed + middle):
            low = middle
        else:
            high = middle
    return low
