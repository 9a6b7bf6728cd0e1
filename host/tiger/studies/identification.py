"""Section 6.3, Figures 6.4-6.8 and 6.11: excite the vehicle, identify it from one noisy IMU, reduce, compare.

Eight records, one input at a time: a multisine under each wheel (peak 0.1 m) and in each actuator (peak 100
N). Three builders work on the same responses: the dissertation's channel-by-channel least squares,
common-pole vector fitting and maximum likelihood. The thirteen physical parameters are fitted as well, and
the ride controllers designed from them are driven in closed loop on the true vehicle.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tiger.control import ride_designs
from tiger.control.ride import ImuNoise
from tiger.estimation.identification import channel_wls, maximum_likelihood, physical, vector_fitting
from tiger.estimation.identification.excitation import multisine
from tiger.estimation.identification.frf import FrfData, from_multisine, noise_at_rest
from tiger.estimation.identification.model import fit_percent
from tiger.models.full_car import BODY_ACCELERATION, CORNERS, FORCE, ROAD, FullCarParameters, full_car
from tiger.models.linear import modes
from tiger.studies import ride_cases
from tiger.studies.figures import new_figure, save
from tiger.studies.performance import BODY, FINE_PER_PERIOD, RMS_BODY, RMS_TIRE_LOAD, simulate
from tiger.studies.report import Report, Row, unwatched

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from tiger.estimation.identification.excitation import Multisine
    from tiger.estimation.identification.model import IdentifiedModel
    from tiger.models.linear import LinearModel
    from tiger.studies.report import Progress

    Array = NDArray[np.float64]
    ComplexArray = NDArray[np.complexfloating[Any, Any]]
    Series = dict[str, Array]
    Record = tuple[Array, list[int]]
    """Outputs (samples, 3), and the numbers of the inputs that were on."""

SAMPLE_S = 0.005
PERIODS = 4
ROAD_PEAK_M, FORCE_PEAK_N = 0.1, 100.0
SIMULTANEOUS_ROAD_PEAK_M = 0.0005
"""With all inputs on at once the roads must not drown the forces."""
FIT_BAND_HZ = (0.2, 60.0)
START_ERROR = 0.25
STD_95 = 1.959964
"""Half of the 95 % interval of a normal distribution, in standard deviations."""


def plant(car: FullCarParameters) -> LinearModel:
    """Return the vehicle as the record sees it: (6.10), Tustin's rule at 200 Hz, roads and forces to
    accelerations."""
    model = full_car(car).select(inputs=(*ROAD, *FORCE), outputs=BODY_ACCELERATION)
    return model.discretise(SAMPLE_S, "tustin")


def record(
    model: LinearModel, seed: int, snr_db: float, simultaneous: bool = False
) -> tuple[Multisine, list[Record]]:
    """Simulate the records: white noise `snr_db` below the RMS of each output of each record."""
    road = SIMULTANEOUS_ROAD_PEAK_M if simultaneous else ROAD_PEAK_M
    signal = multisine(np.r_[np.full(4, road), np.full(4, FORCE_PEAK_N)], seed, simultaneous=simultaneous)
    rng = np.random.default_rng([seed, 1])
    everything = signal.record(PERIODS)
    groups = [list(range(8))] if simultaneous else [[i] for i in range(8)]
    records: list[Record] = []
    for on in groups:
        u = np.zeros_like(everything)
        u[:, on] = everything[:, on]
        y, _ = model.simulate(u)
        spread = y.std(axis=0) * 10 ** (-snr_db / 20)
        records.append((y + rng.standard_normal(y.shape) * spread, on))
    return signal, records


def start_from(car: FullCarParameters, seed: int) -> FullCarParameters:
    """Return the car with each of the thirteen parameters off by up to 25 %: what a data sheet would say."""
    off = np.random.default_rng([seed, 2]).uniform(1 - START_ERROR, 1 + START_ERROR, len(physical.PARAMETERS))
    changes = {
        name: float(getattr(car, name) * factor)
        for name, factor in zip(physical.PARAMETERS, off, strict=True)
    }
    return replace(car, **changes)


def run(
    vehicle: str = "table-6-1",
    snr_db: float = 20.0,
    seed: int = 0,
    simultaneous: bool = False,
    closed_loop: bool = True,
    loop_roads: int = 40,
    progress: Progress = unwatched,
) -> Report:
    """Identify the vehicle from records of the given output signal-to-noise ratio.

    simultaneous: one record with orthogonal multisines at all inputs instead of eight records. closed_loop:
    compare the ISO ride controllers designed from the fitted parameters with those designed from the true
    ones.
    """
    case = ride_cases.load_case(vehicle)
    model = plant(case.car)
    signal, records = record(model, seed, snr_db, simultaneous)
    data = from_multisine(signal, records)
    frequency = np.arange(FIT_BAND_HZ[0], FIT_BAND_HZ[1], 0.1)
    truth = model.frequency_response(frequency)
    built, rows = _built(data, frequency, truth, progress)
    best = built["maximum likelihood"]
    rows += _interval_rows(best, model, frequency, truth)
    fitted = physical.fit(data, start_from(case.car, seed)).car
    worst = max(abs(getattr(fitted, n) / getattr(case.car, n) - 1) for n in physical.PARAMETERS)
    rows.append(Row("physical fit, worst of 13 parameters", 100 * worst, "%"))
    open_loop_rows, open_loop = _open_loop(best, model)
    rows += open_loop_rows
    if closed_loop:
        rows += _closed_loop(case, fitted, loop_roads)
    return Report(
        "Identification from one IMU (Figures 6.4-6.8, 6.11)",
        tuple(rows),
        {
            "frequency_hz": frequency,
            "true_gain_si": _gains(truth),
            **_record_series(signal, records, data, seed),
            **_built_series(built, frequency),
            "channel_poles_z": _unit_disc(channel_wls.path_poles(data)),
            "pole_z": _unit_disc(np.linalg.eigvals(best.a)),
            **open_loop,
        },
        {
            "output snr (dB)": snr_db,
            "noise": "white on the three accelerations, per record and output",
            "records": "1 x 82 s, all inputs at once" if simultaneous else "8 x 82 s, one input at a time",
            "excitation": "multisine, 4 periods of 20.48 s, the first dropped",
            "fit": "100 (1 - |H - H0| / |H0|) over 0.2-60 Hz, every 0.1 Hz",
            "seed": seed,
            "physical start error (%)": 100 * START_ERROR,
        },
    )


def _maximum_likelihood(data: FrfData) -> IdentifiedModel:
    return maximum_likelihood.build(data)


_BUILDERS: dict[str, Callable[[FrfData], IdentifiedModel]] = {
    "channel wls": channel_wls.build,
    "vector fitting": vector_fitting.build,
    "maximum likelihood": _maximum_likelihood,
}


def _built(
    data: FrfData, frequency: Array, truth: ComplexArray, progress: Progress
) -> tuple[dict[str, IdentifiedModel], list[Row]]:
    """Let every builder work on the responses, and compare what it built with the truth."""
    built: dict[str, IdentifiedModel] = {}
    error_percent: dict[str, float] = {}
    rows: list[Row] = []
    for name, builder in _BUILDERS.items():
        begin = time.process_time()
        model = built[name] = builder(data)
        seconds = time.process_time() - begin
        fit = fit_percent(model.response(frequency), truth)
        error_percent[name] = 100 - float(fit.mean())
        slowest = float(np.linalg.eigvals(model.a).real.max())
        rows += [
            Row(f"{name} fit, mean of 24 paths", float(fit.mean()), "%"),
            Row(f"{name} fit, worst path", float(fit.min()), "%"),
            Row(f"{name} order", model.order, "states", 14),
            Row(f"{name} largest real part of a pole", slowest, "1/s"),
            Row(f"{name} time", seconds, "s"),
        ]
        progress(0.15 * len(built))
    worse = error_percent["channel wls"] / error_percent["maximum likelihood"]
    rows.append(Row("channel wls error over maximum likelihood error", worse, "-"))
    return built, rows


def _record_series(signal: Multisine, records: list[Record], data: FrfData, seed: int) -> Series:
    """What was measured: at rest, in the first record, and at the lines of the multisine."""
    rest = np.random.default_rng([seed, 3]).standard_normal((4000, 3)) * ImuNoise().accel_mps2
    bias, spread = noise_at_rest(rest)
    return {
        "line_hz": data.frequency_hz,
        "measured_gain_si": _gains(data.response),
        "coherence": data.coherence.reshape(len(data.frequency_hz), -1),
        "excitation_si": signal.signal[:1024, [0, 4]],
        "response_si": records[0][0][:1024],
        "noise_at_rest_bias_si": bias,
        "noise_at_rest_std_si": spread,
    }


def _built_series(built: Mapping[str, IdentifiedModel], frequency: Array) -> Series:
    """Hankel singular values and gains of every model."""
    series = {}
    for name, model in built.items():
        key = name.replace(" ", "_")
        series[f"{key}_hankel"] = model.hankel[:40]
        series[f"{key}_gain_si"] = _gains(model.response(frequency))
    return series


def _gains(response: ComplexArray) -> Array:
    """Gains of the 24 paths, (frequencies, 24), of responses (frequencies, 3, 8)."""
    return np.abs(response).reshape(len(response), -1)


def coverage(model: IdentifiedModel, frequency_hz: Array, truth: ComplexArray) -> float:
    """Return the share of real and imaginary parts inside the model's own 95 % intervals."""
    real, imag = maximum_likelihood.response_std(model, frequency_hz)
    error = model.response(frequency_hz) - truth
    inside = (np.abs(error.real) < STD_95 * real).mean() + (np.abs(error.imag) < STD_95 * imag).mean()
    return 0.5 * float(inside)


def matched(identified: Array, exact: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair modes, rows of (frequency, damping), so that the poles lie nearest to each other.

    The wheels' modes lie 0.2 % apart in frequency: noise may change their order, but not their damping.
    """
    from scipy.optimize import linear_sum_assignment

    one, other = (f * (-z + 1j * np.sqrt(1 - z**2)) for f, z in (identified.T, exact.T))
    mine, theirs = linear_sum_assignment(np.abs(one[:, None] - other))
    return mine, theirs


def mode_coverage(model: IdentifiedModel, exact: Array) -> float:
    """Return the share of frequencies and dampings inside the model's own 95 % intervals."""
    assert model.mode_std is not None
    mine, theirs = matched(model.modes, exact)
    error = np.abs(model.modes[mine] - exact[theirs])
    return float((error < STD_95 * model.mode_std[mine]).mean())


def _interval_rows(
    identified: IdentifiedModel, model: LinearModel, frequency: Array, truth: ComplexArray
) -> list[Row]:
    """How far to trust the intervals that a model gives for its responses and modes."""
    covered = 100 * coverage(identified, frequency, truth)
    rows = [Row("95 % intervals of the responses cover", covered, "%")]
    z = model.poles()
    exact = modes(2 / SAMPLE_S * (z - 1) / (z + 1))
    if len(identified.modes) == len(exact):
        mine, theirs = matched(identified.modes, exact)
        off = np.abs(identified.modes[mine] / exact[theirs] - 1).max(axis=0)
        rows += [
            Row("95 % intervals of the modes cover", 100 * mode_coverage(identified, exact), "%"),
            Row("worst error of a mode's frequency", 100 * float(off[0]), "%"),
            Row("worst error of a mode's damping", 100 * float(off[1]), "%"),
        ]
    return rows


def _open_loop(identified: IdentifiedModel, model: LinearModel) -> tuple[list[Row], Series]:
    """Figure 6.11: actual and estimated model over the bumpy road, actuators off."""
    road = ride_cases.bumpy_road()[::FINE_PER_PERIOD]
    u = np.hstack([road, np.zeros((len(road), 4))])
    actual, _ = model.simulate(u)
    estimated, _ = identified.discrete(model.inputs, model.outputs).simulate(u)
    rows = []
    for name, mine, true in zip(BODY, estimated.T, actual.T, strict=True):
        fit = 100 * (1 - np.linalg.norm(mine - true) / np.linalg.norm(true))
        rows.append(Row(f"open loop {name} fit on the bumpy road", float(fit), "%"))
    return rows, {
        "open_loop_time_s": np.arange(len(road), dtype=np.float64) * SAMPLE_S,
        "open_loop_actual_si": actual,
        "open_loop_estimated_si": estimated,
    }


def _closed_loop(case: ride_cases.Case, fitted: FullCarParameters, roads: int) -> list[Row]:
    """Drive ISO roads with controllers designed from the true parameters and from the fitted ones."""
    seeds = tuple(range(roads))
    road = ride_cases.iso_roads(case.car, seeds)
    noise = ImuNoise()
    passive = case.index(simulate(case.car, road, seeds=seeds))

    def left(tuning: ride_designs.RideTuning, sees: bool, believed: FullCarParameters) -> Array:
        """Active over passive, mean over the roads, (14,)."""
        preview_s = replace(case, car=believed).iso_preview_s if sees else None
        controller = tuning.controller(believed, noise, preview_s)
        active = case.index(simulate(case.car, road, controller, noise, seeds))
        return np.asarray((active / passive).mean(axis=0))

    rows = []
    for name, tuning, sees in (
        ("holding", ride_designs.HOLDING_PLAIN, False),
        ("holding preview", ride_designs.HOLDING_PREVIEW, True),
    ):
        known, identified = (100 * (1 - left(tuning, sees, car)) for car in (case.car, fitted))
        for body, cut, lost in zip(BODY, identified[RMS_BODY], (known - identified)[RMS_BODY], strict=True):
            rows += [
                Row(f"{name} rms {body} cut, identified model", float(cut), "%"),
                Row(f"{name} rms {body} cut, points lost to the known model", float(lost), "%"),
            ]
        worst = 1 - float(identified[RMS_TIRE_LOAD].min()) / 100
        rows.append(Row(f"{name} worst eta, active over passive, identified model", worst, "-"))
    return rows


def _unit_disc(poles: NDArray[np.inexact[Any]]) -> Array:
    """Map poles of Tustin's plane to the z-plane, as (real, imaginary) columns."""
    half = 0.5 * SAMPLE_S * poles
    z = (1 + half) / (1 - half)
    return np.column_stack([z.real, z.imag])


def plot(report: Report, directory: Path) -> list[Path]:
    """Draw Figures 6.4-6.8 and 6.11."""
    series = report.arrays()
    figures = {
        "6_4_6_5_excitation_and_response": _draw_record,
        "6_6_responses": _draw_responses,
        "6_7_poles": _draw_poles,
        "6_8_hankel": _draw_hankel,
        "6_11_open_loop": _draw_open_loop,
    }
    return [save(draw(series), directory / f"figure_{name}.png") for name, draw in figures.items()]


def _draw_record(s: Series) -> Figure:
    figure = new_figure(7, 5)
    axes = figure.subplots(3, 1, sharex=True)
    time_s = np.arange(len(s["excitation_si"])) * SAMPLE_S
    axes[0].plot(time_s, s["excitation_si"][:, 0])
    axes[1].plot(time_s, s["excitation_si"][:, 1])
    axes[2].plot(time_s, s["response_si"])
    for axis, label in zip(axes, ("road m", "force N", "IMU SI"), strict=True):
        axis.set_ylabel(label)
    axes[2].set_xlabel("time s")
    return figure


def _draw_responses(s: Series) -> Figure:
    figure = new_figure(20, 8)
    axes = figure.subplots(3, 8, sharex=True)
    for path, axis in enumerate(axes.ravel()):
        axis.loglog(s["line_hz"], s["measured_gain_si"][:, path], ".", ms=2, color="0.6", label="measured")
        axis.loglog(s["frequency_hz"], s["true_gain_si"][:, path], label="true")
        axis.loglog(s["frequency_hz"], s["maximum_likelihood_gain_si"][:, path], "--", label="identified")
    inputs = [f"{kind} {corner}" for kind in ("road", "force") for corner in CORNERS]
    for axis, name in zip(axes[0], inputs, strict=True):
        axis.set_title(name)
    for axis, name in zip(axes[:, 0], BODY, strict=True):
        axis.set_ylabel(f"{name} acceleration")
    for axis in axes[2]:
        axis.set_xlabel("Hz")
    axes[0, 0].legend()
    return figure


def _draw_poles(s: Series) -> Figure:
    figure = new_figure(5, 5)
    axis = figure.subplots()
    angle = np.linspace(0, 2 * np.pi, 200)
    axis.plot(np.cos(angle), np.sin(angle), color="0.7")
    axis.plot(*s["channel_poles_z"].T, ".", ms=3, label="24 separate fits")
    axis.plot(*s["pole_z"].T, "x", label="maximum likelihood")
    axis.set(aspect="equal", xlabel="real", ylabel="imaginary")
    axis.legend()
    return figure


def _draw_hankel(s: Series) -> Figure:
    figure = new_figure(6, 3.5)
    axis = figure.subplots()
    for name in ("channel_wls", "maximum_likelihood"):
        hankel = s[f"{name}_hankel"]
        states = np.arange(1, len(hankel) + 1)
        axis.semilogy(states, hankel / hankel[0], "o-", ms=3, label=name.replace("_", " "))
    axis.axvline(14.5, ls=":", color="0.5")
    axis.set(xlabel="state", ylabel="Hankel singular value, relative")
    axis.legend()
    return figure


def _draw_open_loop(s: Series) -> Figure:
    figure = new_figure(7, 5)
    axes = figure.subplots(3, 1, sharex=True)
    for i, (axis, label) in enumerate(zip(axes, BODY, strict=True)):
        axis.plot(s["open_loop_time_s"], s["open_loop_actual_si"][:, i], label="actual")
        axis.plot(s["open_loop_time_s"], s["open_loop_estimated_si"][:, i], "--", label="estimated")
        axis.set_ylabel(label)
    axes[0].legend()
    return figure
