"""How the body's attitude answers the strokes, from a log of the robot: `tiger identify`.

The four strokes make four modes: heave, roll, pitch, and warp. For each that moved by itself there is a
quasi-static gain on roll and pitch, with an interval from the spread of the record (delete-one jackknife over
its blocks, Efron and Stein 1981), beside the gain that the configuration gives: the same estimate, on the
attitude which the mechanism and the seven-degree-of-freedom car of the log's own robot.json take under the
recorded strokes. Frequency responses come from `identification.strokes`. What could not be excited is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal, stats
from scipy.optimize import curve_fit

from tiger.estimation.attitude_observer import attitude_rad
from tiger.estimation.identification import strokes
from tiger.models.eam import Eam
from tiger.models.full_car import LIFT, LIFT_RATE, FullCarParameters, full_car
from tiger.record import Mode

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from tiger.config.robot import RobotConfig
    from tiger.config.vehicle import VehicleConfig
    from tiger.logs.reader import Log
    from tiger.record import ImuSample

    Array = NDArray[np.float64]

SAMPLE_S = 0.02
BLOCKS = 10  # of a record, for the jackknife
LEAST_RECORD_S = 30.0
LONGEST_GAP_S = 0.5  # between samples; a longer one ends a stretch
GAIN_BAND_HZ = 0.3  # below it the body follows the strokes to within some percent
STROKE_BAND_HZ = 3.0  # above it a potentiometer shows only its noise
MODE_INTERVAL_MOST = 0.3  # of frequency and damping: a wider interval says nothing
MODE_LINES_LEAST = 6

# Rows: the modes in mm, from the strokes FL, FR, RL, RR. Roll and pitch are the differences left less right
# and rear less front, so that their gain is one over track and wheelbase, times the motion ratio.
MODES = ("heave", "roll", "pitch", "warp")
FROM_STROKES = np.array(
    [[0.25, 0.25, 0.25, 0.25], [0.5, -0.5, 0.5, -0.5], [-0.5, -0.5, 0.5, 0.5], [0.5, -0.5, -0.5, 0.5]]
)
OUTPUTS = ("roll_deg", "pitch_deg", "roll_rate_degps", "pitch_rate_degps", "vertical_accel_mps2")
ANGLES = OUTPUTS[:2]


class IdentifyError(ValueError):
    """A log that says nothing of the robot's dynamics; the message says what to record."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The longest stretch of a log without gaps, on even samples: stroke_mm (n, 4), imu (n, OUTPUTS)."""

    stroke_mm: Array
    imu: Array
    levelling_s: float  # how long the controller moved the strokes by the attitude
    driving_s: float

    @property
    def duration_s(self) -> float:
        """Length of the stretch."""
        return len(self.stroke_mm) * SAMPLE_S


@dataclass(frozen=True, slots=True)
class Gain:
    """Degrees of an angle per millimetre of a mode."""

    mode: str
    output: str
    measured: float
    half_width: float  # of the 95 % interval
    expected: float

    @property
    def agrees(self) -> bool:
        """Whether the expected gain lies in the interval."""
        return abs(self.measured - self.expected) <= self.half_width


@dataclass(frozen=True, slots=True)
class BodyMode:
    """First mode of an axis as found, with half-widths of its 95 % intervals, and as the model has it."""

    axis: str
    frequency_hz: float
    frequency_half_width_hz: float
    damping: float
    damping_half_width: float
    expected_hz: float
    expected_damping: float


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """What a log says.

    Over frequency_hz (k,): response (k, OUTPUTS, MODES) with half-widths of the 95 % intervals of its
    magnitude (infinite where a mode was not excited), coherence (k, OUTPUTS), and the response expected of
    ANGLES (k, ANGLES, MODES).
    """

    duration_s: float
    stroke_rms_mm: dict[str, float]
    gains: tuple[Gain, ...]
    body_modes: tuple[BodyMode, ...]
    remarks: tuple[str, ...]
    frequency_hz: Array
    response: NDArray[np.complexfloating[Any, Any]]
    half_width: Array
    coherence: Array
    expected: NDArray[np.complexfloating[Any, Any]]

    def as_json(self) -> dict[str, Any]:
        """Everything as plain values; a half-width is None where a mode was not excited."""
        return {
            "duration_s": self.duration_s,
            "stroke_rms_mm": self.stroke_rms_mm,
            "gains": [
                {
                    "name": f"{gain.output.removesuffix('_deg')} per {gain.mode}",
                    "unit": "deg/mm",
                    "measured": gain.measured,
                    "half_width_95": gain.half_width,
                    "expected": gain.expected,
                    "agrees": gain.agrees,
                }
                for gain in self.gains
            ],
            "body_modes": [
                {name: getattr(mode, name) for name in BodyMode.__dataclass_fields__}
                for mode in self.body_modes
            ],
            "remarks": list(self.remarks),
            "series": {
                "modes": list(MODES),
                "outputs": list(OUTPUTS),
                "frequency_hz": self.frequency_hz.tolist(),
                "magnitude": np.abs(self.response).tolist(),
                "phase_deg": np.degrees(np.angle(self.response)).tolist(),
                "half_width_95": _without_infinity(self.half_width),
                "coherence": self.coherence.tolist(),
                "expected_magnitude": np.abs(self.expected).tolist(),
            },
        }


def _without_infinity(values: Array) -> Any:
    """Nested lists with None for what is infinite, which JSON does not know."""
    plain = values.astype(object)
    plain[np.isinf(values)] = None
    return plain.tolist()


# ------------------------------------------------------------------------------------------------ the record


def read(log: Log) -> Recording:
    """Gather the samples of a log. Raises LogError, and IdentifyError where there are none."""
    stroke: dict[float, tuple[float, ...]] = {}
    imu: dict[float, tuple[float, ...]] = {}
    levelling: list[float] = []
    driving: list[float] = []
    last_s = math.nan
    for _, record in log.records():
        inputs = record.inputs
        if inputs.strokes is not None:
            stroke[inputs.strokes.t_s] = inputs.strokes.stroke_mm
        if inputs.imu is not None and inputs.imu.t_s not in imu:
            imu[inputs.imu.t_s] = _measured(inputs.imu)
        passed_s = inputs.now_s - last_s if inputs.now_s - last_s < LONGEST_GAP_S else 0.0
        last_s = inputs.now_s
        if inputs.armed and inputs.command.mode is Mode.LEVEL:
            levelling.append(passed_s)
        if inputs.armed and (inputs.command.speed_mps or inputs.command.yaw_rate_radps):
            driving.append(passed_s)
    start_s, end_s = _longest_stretch(sorted(stroke), sorted(imu))
    if end_s - start_s < SAMPLE_S:
        raise IdentifyError(
            "the log holds no strokes and attitude of the same time: record a run with all boards connected"
        )
    grid = np.arange(start_s, end_s, SAMPLE_S)
    return Recording(_resampled(stroke, grid), _resampled(imu, grid), sum(levelling), sum(driving))


def _measured(sample: ImuSample) -> tuple[float, ...]:
    """One sample as OUTPUTS; rates and acceleration are those of body axes, the angles being small."""
    roll, pitch = attitude_rad(sample.quaternion)
    p, q, _ = sample.rate_radps
    return (*(math.degrees(v) for v in (roll, pitch, p, q)), sample.linear_accel_mps2[2])


def _longest_stretch(*times: list[float]) -> tuple[float, float]:
    """Start and end of the longest time in which no stream has a gap; (0, 0) when there is none."""
    if not all(times):
        return 0.0, 0.0
    low, high = max(t[0] for t in times), min(t[-1] for t in times)
    cuts = [(a, b) for t in times for a, b in pairwise(t) if b - a > LONGEST_GAP_S]
    edges = sorted({(low, low), (high, high), *cuts})
    end, best = low, (low, low)
    for before, after in edges:
        if before - end > best[1] - best[0]:
            best = end, before
        end = max(end, after)
    return best


def _resampled(samples: dict[float, tuple[float, ...]], grid: Array) -> Array:
    times = np.array(sorted(samples))
    values = np.array([samples[t] for t in times])
    return np.column_stack([np.interp(grid, times, column) for column in values.T])


# -------------------------------------------------------------------------------------------- the estimation


def identify(recording: Recording, robot: RobotConfig) -> Identification:
    """Estimate gains, responses and modes. Raises IdentifyError for a record without motion or too short."""
    moved_mm = recording.stroke_mm @ FROM_STROKES.T
    rms = moved_mm.std(axis=0)
    if rms.max() < strokes.LEAST_STROKE_MM:
        raise IdentifyError(
            f"no stroke moved: {rms.max():.2f} mm RMS at most, at least {strokes.LEAST_STROKE_MM} mm are "
            "needed; change the pose while logging, docs/identify.md has a recipe"
        )
    if recording.duration_s < LEAST_RECORD_S:
        raise IdentifyError(
            f"the log holds {recording.duration_s:.1f} s of strokes and attitude without a gap, "
            f"at least {LEAST_RECORD_S:g} s are needed: record longer, docs/identify.md has a recipe"
        )
    told, remarks = _told_apart(moved_mm)
    use = [MODES.index(name) for name in told]
    angles = _expected_deg(recording.stroke_mm, robot.vehicle)
    only_told = np.zeros_like(moved_mm)
    only_told[:, use] = moved_mm[:, use]
    found = strokes.identify(only_told, recording.imu, OUTPUTS, SAMPLE_S)
    model = strokes.identify(only_told, angles, ANGLES, SAMPLE_S)
    gains = _gains(moved_mm, recording.imu[:, :2], angles, use)
    body_modes, more = _body_modes(found, told, robot.vehicle)
    # Of a complex number with variance std^2; the inputs take their degrees of freedom from the averages.
    quantile = float(stats.t.ppf(0.975, 2 * max(strokes.SEGMENTS - len(use), 1)))
    remarks += [
        *_blind(gains, found, told),
        *_band(found, told),
        *more,
        *_circumstances(recording),
        f"above {strokes.MOST_HZ:g} Hz: not identified, the actuators are too slow to excite it",
        "road and wheel forces: not excited, the robot has no shaker",
    ]
    return Identification(
        duration_s=recording.duration_s,
        stroke_rms_mm=dict(zip(MODES, rms.tolist(), strict=True)),
        gains=gains,
        body_modes=body_modes,
        remarks=tuple(remarks),
        frequency_hz=np.asarray(found.frequency_hz, dtype=np.float64),
        response=found.response,
        half_width=np.asarray(quantile * found.std / math.sqrt(2.0), dtype=np.float64),
        coherence=np.asarray(found.coherence, dtype=np.float64),
        expected=model.response,
    )


def _told_apart(moved_mm: Array) -> tuple[list[str], list[str]]:
    """Modes that moved, and moved by themselves, with a remark on each of the others.

    The one with the least motion of its own goes first, until all that are left can be told apart.
    """
    least = strokes.LEAST_STROKE_MM
    rms = dict(zip(MODES, moved_mm.std(axis=0), strict=True))
    told = [name for name in MODES if rms[name] > least]
    remarks = [
        f"{name}: not excited, it moved by {rms[name]:.2f} mm RMS, at least {least} mm are needed"
        for name in MODES
        if name not in told
    ]
    while len(told) > 1:
        centred = moved_mm[:, [MODES.index(name) for name in told]]
        centred = centred - centred.mean(axis=0)
        own = {}
        for i, name in enumerate(told):
            others = np.delete(centred, i, axis=1)
            rest = centred[:, i] - others @ np.linalg.lstsq(others, centred[:, i], rcond=None)[0]
            own[name] = float(rest.std())
        worst = min(own, key=lambda name: own[name])
        if own[worst] > least:
            break
        told.remove(worst)
        remarks.append(
            f"{worst}: cannot be told from {', '.join(told)}, it moved only together with them "
            f"({own[worst]:.2f} mm RMS of its own)"
        )
    return told, remarks


def _expected_deg(stroke_mm: Array, vehicle: VehicleConfig) -> Array:
    """Roll and pitch that the configured mechanism and car take under these strokes, (n, 2), from rest."""
    smooth = signal.sosfiltfilt(signal.butter(2, STROKE_BAND_HZ, fs=1 / SAMPLE_S, output="sos"), stroke_mm, 0)
    lift_m = Eam.from_vehicle(vehicle).curve().rise_mm(smooth) / 1000.0
    lift_m = lift_m - lift_m[0]
    car = full_car(FullCarParameters.from_config(vehicle)).select(
        inputs=(*LIFT, *LIFT_RATE), outputs=("roll_rad", "pitch_rad")
    )
    inputs = np.hstack([lift_m, np.gradient(lift_m, SAMPLE_S, axis=0)])
    angles, _ = car.discretise(SAMPLE_S, "foh").simulate(inputs)
    return np.degrees(angles)


def _gains(moved_mm: Array, measured: Array, expected: Array, use: list[int]) -> tuple[Gain, ...]:
    """Quasi-static gains of each mode on each angle, by least squares below GAIN_BAND_HZ."""
    slow = signal.butter(2, GAIN_BAND_HZ, fs=1 / SAMPLE_S, output="sos")
    columns = np.hstack([moved_mm[:, use], measured, expected])
    blocks = np.array_split(signal.sosfiltfilt(slow, columns, 0), BLOCKS)
    # Each block keeps its own mean, so that a ground or gyroscope that drifts adds little.
    centred = [block - block.mean(axis=0) for block in blocks]
    m = len(use)
    products = np.array([block[:, :m].T @ block for block in centred])
    total = products.sum(axis=0)
    best = np.linalg.lstsq(total[:, :m], total[:, m:], rcond=None)[0]
    without = np.array(
        [np.linalg.lstsq((total - p)[:, :m], (total - p)[:, m:], rcond=None)[0] for p in products]
    )
    spread = (BLOCKS - 1) / BLOCKS * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    half = float(stats.t.ppf(0.975, BLOCKS - 1)) * np.sqrt(spread)
    return tuple(
        Gain(
            MODES[mode],
            output,
            float(best[i, j]),
            float(half[i, j]),
            float(best[i, j + len(ANGLES)]),
        )
        for i, mode in enumerate(use)
        for j, output in enumerate(ANGLES)
    )


def _coherent(found: strokes.StrokeResponse, axis: str) -> NDArray[np.bool_]:
    """Lines whose angle of this axis is explained by the strokes."""
    return np.asarray(found.coherence[:, OUTPUTS.index(f"{axis}_deg")] >= strokes.LEAST_COHERENCE)


def _band(found: strokes.StrokeResponse, told: list[str]) -> list[str]:
    """Up to where each axis was excited."""
    remarks = []
    for axis in ("roll", "pitch"):
        if axis not in told:
            continue
        good = _coherent(found, axis)
        if not good.any():
            remarks.append(f"{axis}: nowhere coherent with the strokes: the ground or the load moved it")
        elif not good[-1]:
            top = found.frequency_hz[np.flatnonzero(good)[-1]]
            remarks.append(f"{axis}: no coherent excitation above {top:.2f} Hz")
    return remarks


def _blind(gains: tuple[Gain, ...], found: strokes.StrokeResponse, told: list[str]) -> list[str]:
    """Modes that moved without a trace in what the IMU measures."""
    remarks = []
    if "heave" in told:
        best = float(found.coherence[:, OUTPUTS.index("vertical_accel_mps2")].max())
        seen = f"its vertical acceleration has a coherence of at most {best:.2f}"
        remarks.append(f"heave: an IMU sees no ride height at rest; {seen}")
    largest = max(abs(gain.measured) for gain in gains)
    if "warp" in told and all(
        abs(gain.measured) - gain.half_width < 0.02 * largest for gain in gains if gain.mode == "warp"
    ):
        remarks.append("warp: moves nothing the IMU can see, it only shifts load between the wheels")
    return remarks


def _body_modes(
    found: strokes.StrokeResponse, told: list[str], vehicle: VehicleConfig
) -> tuple[tuple[BodyMode, ...], list[str]]:
    """Fit each axis's response to its own mode where the record carries it."""
    car = full_car(FullCarParameters.from_config(vehicle))
    results, remarks = [], []
    for axis in ("roll", "pitch"):
        rows = [car.states.index(f"{axis}_rad"), car.states.index(f"{axis}_rate_radps")]
        stiffness, damping = -car.a[rows[1], rows]  # of the axis alone, its wheels held: also above critical
        expected_hz = math.sqrt(stiffness) / (2 * math.pi)
        expected_damping = float(damping / (2 * math.sqrt(stiffness)))
        fitted = _fitted(found, axis, expected_hz) if axis in told else None
        if fitted is None:
            remarks.append(
                f"{axis}: the record does not carry its first mode, expected near {expected_hz:.1f} Hz "
                f"with a damping of {expected_damping:.2f}"
            )
        else:
            results.append(BodyMode(axis, *fitted, expected_hz, expected_damping))
    return tuple(results), remarks


def _fitted(
    found: strokes.StrokeResponse, axis: str, start_hz: float
) -> tuple[float, float, float, float] | None:
    """Frequency and damping with half-widths from H = g (2 d w s + w^2) / (s^2 + 2 d w s + w^2), or None."""
    good = _coherent(found, axis)
    if good.sum() < MODE_LINES_LEAST:
        return None
    output, mode = OUTPUTS.index(f"{axis}_deg"), MODES.index(axis)
    h, std = found.response[good, output, mode], found.std[good, output, mode] / math.sqrt(2.0)
    s = 1j * found.frequency_hz[good]

    def model(_: Array, gain: float, hz: float, damping: float) -> Array:
        spring = 2 * damping * hz * s + hz**2
        value = gain * spring / (s**2 + spring)
        return np.concatenate([value.real, value.imag])

    try:
        best, covariance = curve_fit(
            model,
            np.tile(found.frequency_hz[good], 2),
            np.concatenate([h.real, h.imag]),
            (h[0].real, start_hz, 0.2),
            np.tile(std, 2),
        )
    except RuntimeError:  # did not converge
        return None
    half = float(stats.t.ppf(0.975, 2 * len(h) - 3)) * np.sqrt(np.diag(covariance))
    _, hz, damping = (float(v) for v in best)
    if not (half[1] < MODE_INTERVAL_MOST * hz and half[2] < MODE_INTERVAL_MOST * damping):
        return None
    return hz, float(half[1]), damping, float(half[2])


def _circumstances(recording: Recording) -> list[str]:
    """What makes the figures doubtful."""
    remarks = []
    if recording.levelling_s > 1.0:
        remarks.append(
            f"the robot levelled itself for {recording.levelling_s:.0f} s: where the ground moved, strokes "
            "answered the attitude and gains are biased; use mode pose"
        )
    if recording.driving_s > 1.0:
        remarks.append(f"the robot drove for {recording.driving_s:.0f} s: the ground moved its attitude too")
    return remarks


# ------------------------------------------------------------------------------------------------ the picture


def plot(result: Identification, folder: Path) -> Path:
    """Draw roll and pitch per millimetre, with 95 % intervals, and coherence; returns the file."""
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for column, axis in enumerate(("roll", "pitch")):
        output, mode = OUTPUTS.index(f"{axis}_deg"), MODES.index(axis)
        above, below = axes[:, column]
        f = result.frequency_hz
        half = result.half_width[:, output, mode]
        if np.isfinite(half).all():
            above.errorbar(f, np.abs(result.response[:, output, mode]), half, fmt="o", ms=3, label="measured")
            above.plot(f, np.abs(result.expected[:, output, mode]), label="configuration")
            above.legend()
        above.set(title=f"{axis} per {axis} stroke", ylabel="deg/mm", ylim=(0.0, None))
        below.plot(f, result.coherence[:, output], ".-")
        below.axhline(strokes.LEAST_COHERENCE, linewidth=0.8, linestyle="--", color="0.5")
        below.set(xlabel="frequency, Hz", ylabel="coherence", ylim=(0.0, 1.05))
        for part in (above, below):
            part.grid(alpha=0.3)
    file = folder / "identify.png"
    figure.savefig(file, dpi=150)
    return file
