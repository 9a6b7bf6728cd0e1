"""The performance index of section 6.5, and the simulation it is taken from.

The vehicle runs between the samples of its controller: outputs are evaluated every millisecond, forces are
held for a controller period and may act late, the road is straight between milliseconds. Many runs go side by
side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tiger.control import ride
from tiger.models.full_car import BODY_ACCELERATION, FORCE, IMU, ROAD, SUSPENSION, TIRE, full_car

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from tiger.control.ride import ImuNoise
    from tiger.models.full_car import FullCarParameters
    from tiger.models.linear import LinearModel

    Array = NDArray[np.float64]

FINE_S = 0.001
FINE_PER_PERIOD = round(ride.PERIOD_S / FINE_S)

INDEX_NAMES = (
    "peak heave acceleration",
    "rms heave acceleration",
    "peak pitch acceleration",
    "rms pitch acceleration",
    "peak roll acceleration",
    "rms roll acceleration",
    *(f"rms relative tire load eta{i}" for i in range(1, 5)),
    *(f"peak relative suspension deflection mu{i}" for i in range(1, 5)),
)
INDEX_UNITS = ("m/s^2",) * 2 + ("rad/s^2",) * 4 + ("-",) * 8
RMS_BODY, RMS_TIRE_LOAD, PEAK_SUSPENSION = slice(1, 6, 2), slice(6, 10), slice(10, 14)
"""Where the index has the accelerations of BODY, eta and mu."""
BODY = ("heave", "pitch", "roll")

SIMULATED = (IMU[0], *BODY_ACCELERATION[1:], *SUSPENSION, *TIRE)


class Controller(Protocol):
    """Anything that turns an IMU sample (3, runs) into forces (4, runs) with a state of its own."""

    def start(self, runs: int | None = None) -> Any:
        """Return the state to begin with."""
        ...

    def step(self, state: Any, imu: Array) -> tuple[Any, Array]:
        """Return the next state and the force."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RideRun:
    """What happened: outputs in the order of SIMULATED (runs, fine steps, 11) and forces (runs, steps, 4)."""

    outputs: Array
    force_n: Array
    imu: Array
    """Measurements as the controller saw them, (runs, steps, 3)."""

    @property
    def accelerations(self) -> Array:
        """Heave acceleration at the IMU, pitch and roll acceleration, (runs, fine steps, 3)."""
        return self.outputs[..., :3]

    @property
    def suspension_m(self) -> Array:
        """Suspension deflections, (runs, fine steps, 4)."""
        return self.outputs[..., 3:7]

    @property
    def tire_m(self) -> Array:
        """Tyre deflections, (runs, fine steps, 4)."""
        return self.outputs[..., 7:]


def performance_index(p: FullCarParameters, rattle_space_m: float, run: RideRun) -> Array:
    """Return the index of section 6.5 in the order of INDEX_NAMES, shape (runs, 14).

    eta = kt (z_wheel - z_road) / static tyre load, mu = |suspension deflection| / rattle space.
    """
    eta = p.tire_stiffness_npm * run.tire_m / p.static_tire_load_n()
    mu = np.abs(run.suspension_m).max(axis=1) / rattle_space_m
    peak = np.abs(run.accelerations).max(axis=1)
    body = np.stack([peak, _rms(run.accelerations)], axis=2).reshape(len(peak), 6)
    return np.asarray(np.hstack([body, _rms(eta), mu]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Milliseconds:
    """How the car goes on from millisecond to millisecond: x' = a x + push force + drive."""

    a: Array
    push: Array
    """What a force held for the millisecond adds, (14, 4)."""
    drive: Array
    """What the road adds, (runs, steps, FINE_PER_PERIOD, 14)."""

    @classmethod
    def over(cls, car: LinearModel, roads: Array) -> _Milliseconds:
        """Sample the car's inputs (ROAD, FORCE): the road is straight between milliseconds."""
        a, held, ramp = ride.hold(car.a, car.b, FINE_S)
        start, end, push = held[:, :4] - ramp[:, :4], ramp[:, :4], held[:, 4:]
        drive = roads[:, :-1] @ start.T + roads[:, 1:] @ end.T
        return cls(a, push, drive.reshape(len(roads), -1, FINE_PER_PERIOD, 14))


def fine_time_s(duration_s: float) -> Array:
    """Return the instants at which a road for `simulate` is to be evaluated, duration included."""
    steps = round(duration_s / ride.PERIOD_S)
    return np.arange(steps * FINE_PER_PERIOD + 1, dtype=np.float64) * FINE_S


def simulate(
    p: FullCarParameters,
    road_m: Array,
    controller: Controller | None = None,
    noise: ImuNoise | None = None,
    seeds: tuple[int, ...] = (0,),
    imu_offset_m: tuple[float, float] = (0.0, 0.0),
    delay_s: float = 0.0,
    x0: Array | None = None,
    measurement: Callable[[Array], Array] | None = None,
) -> RideRun:
    """Drive the car over `road_m`, (fine steps + 1, 4) or (runs, fine steps + 1, 4) at `fine_time_s`.

    One run per seed; with one road, every seed drives the same. controller None is the passive car. `delay_s`
    is the time from a measurement to the force computed from it, in whole milliseconds. x0 (14,) is the
    initial state. `measurement` may alter the noisy IMU sample (3, runs) before the controller sees it.
    """
    roads = np.broadcast_to(road_m, (len(seeds), *road_m.shape[-2:]))
    runs, steps = len(seeds), (roads.shape[1] - 1) // FINE_PER_PERIOD
    car = full_car(p, imu_offset_m).select(inputs=(*ROAD, *FORCE), outputs=(*SIMULATED, *IMU[1:]))
    fine = _Milliseconds.over(car, roads)

    # Over one period: x goes through a^5, and each millisecond's drive through what is left of the period.
    whole, *left = (np.linalg.matrix_power(fine.a, i) for i in range(FINE_PER_PERIOD, -1, -1))
    from_road = sum(fine.drive[:, :, j] @ rest.T for j, rest in enumerate(left))
    pushed = [rest @ fine.push for rest in left]
    late, late_fine = divmod(round(delay_s / FINE_S), FINE_PER_PERIOD)
    push_old = sum(pushed[:late_fine], np.zeros((14, 4)))
    push_new = sum(pushed[late_fine:], np.zeros((14, 4)))

    states = np.empty((steps, 14, runs))
    forces = np.zeros((steps + late + 1, 4, runs))  # row k + late + 1 is computed at step k
    measured = np.zeros((steps, 3, runs))
    x = np.zeros((14, runs)) if x0 is None else np.repeat(np.asarray(x0, float)[:, None], runs, axis=1)
    c_imu = car.select(outputs=IMU)
    through = c_imu.d[:, 4:]
    spread = np.zeros(3) if noise is None else np.sqrt(np.diag(noise.covariance()))
    random = np.stack([np.random.default_rng(seed).standard_normal((steps, 3)) for seed in seeds], axis=2)
    road_steps = np.moveaxis(np.asarray(from_road), 0, 2)
    state = None if controller is None else controller.start(runs)
    for k in range(steps):
        states[k] = x
        acting_before = forces[k]  # computed late + 1 steps ago: it acted until this instant
        sample = c_imu.c @ x + through @ acting_before + spread[:, None] * random[k]
        if measurement is not None:
            sample = measurement(sample)
        measured[k] = sample
        if controller is not None and state is not None:
            state, forces[k + late + 1] = controller.step(state, sample)
        x = whole @ x + push_old @ forces[k] + push_new @ forces[k + 1] + road_steps[k]

    outputs = _between(car, fine, roads, states, forces, late_fine)
    acting = np.moveaxis(forces[1 : steps + 1], 2, 0)
    return RideRun(outputs, acting, np.moveaxis(measured, 2, 0))


def _between(
    car: LinearModel, fine: _Milliseconds, roads: Array, states: Array, forces: Array, late_fine: int
) -> Array:
    """Fill in the outputs at every millisecond from the states at the samples, (runs, fine steps, 11).

    For its first `late_fine` milliseconds a period still has the force of the one before.
    """
    runs, steps = fine.drive.shape[:2]
    rows = len(SIMULATED)
    c, d_road, d_force = car.c[:rows], car.d[:rows, :4], car.d[:rows, 4:]
    x = np.moveaxis(states, 2, 0)
    force = np.moveaxis(forces, 2, 0)
    heights = roads[:, :-1].reshape(runs, steps, FINE_PER_PERIOD, 4)
    outputs = np.empty((runs, steps, FINE_PER_PERIOD, rows))
    for j in range(FINE_PER_PERIOD):
        acting = force[:, :steps] if j < late_fine else force[:, 1 : steps + 1]
        outputs[:, :, j] = x @ c.T + heights[:, :, j] @ d_road.T + acting @ d_force.T
        x = x @ fine.a.T + fine.drive[:, :, j] + acting @ fine.push.T
    return outputs.reshape(runs, steps * FINE_PER_PERIOD, rows)


def _rms(series: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(series**2, axis=1)))
