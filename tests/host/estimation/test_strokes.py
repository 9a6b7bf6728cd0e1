"""The robot identified from its strokes: what they excite is found, what they do not is said."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.estimation.identification.strokes import identify
from tiger.models.full_car import LIFT, LIFT_RATE, FullCarParameters, full_car

SAMPLE_S = 0.01
OUTPUTS = ("pitch_rad", "roll_rad")
CAR = full_car(FullCarParameters.from_config(load_vehicle("tiger"))).select(
    inputs=(*LIFT, *LIFT_RATE), outputs=OUTPUTS
)


def record(moving: list[int], seconds: float = 120.0) -> tuple[np.ndarray, np.ndarray]:
    """Strokes wander at up to the actuator's rate; a millimetre of stroke lifts the seat by two."""
    rng = np.random.default_rng(0)
    steps = round(seconds / SAMPLE_S)
    rate = np.zeros((steps, 4))
    rate[:, moving] = np.repeat(rng.choice([-9.4, 0.0, 9.4], (steps // 40 + 1, len(moving))), 40, axis=0)[
        :steps
    ]
    stroke = np.cumsum(rate, axis=0) * SAMPLE_S
    u = np.hstack([stroke, rate]) * 2e-3
    angles, _ = CAR.discretise(SAMPLE_S).simulate(u)
    return stroke, angles + rng.standard_normal(angles.shape) * 1e-4


def test_slow_responses_are_those_of_the_vehicle() -> None:
    stroke, angles = record([0, 1, 2, 3])
    found = identify(stroke, angles, OUTPUTS, SAMPLE_S)
    low = found.frequency_hz < 0.5
    static = CAR.static_gain()[:, :4] * 2e-3
    assert found.response[low].mean(axis=0).real == pytest.approx(
        static, rel=0.15, abs=0.05 * np.abs(static).max()
    )
    assert found.coherence[low].min() > 0.9
    assert (found.std[low] < 0.2 * np.abs(static).max()).all()


def test_what_was_not_excited_is_said() -> None:
    found = identify(*record([0, 3]), OUTPUTS, SAMPLE_S)
    text = " / ".join(found.remarks)
    assert "stroke fr moved by less" in text
    assert "stroke rl moved by less" in text
    assert "no shaker" in text
    assert "too slow" in text
    assert np.isinf(found.std[:, :, 1]).all()


def test_records_that_say_nothing_are_refused() -> None:
    stroke, angles = record([0])
    with pytest.raises(ValueError, match="excite the actuators"):
        identify(stroke * 0, angles, OUTPUTS, SAMPLE_S)
    with pytest.raises(ValueError, match="too short"):
        identify(stroke[:400], angles[:400], OUTPUTS, SAMPLE_S)
    with pytest.raises(ValueError, match="do not fit"):
        identify(stroke[:, :3], angles, OUTPUTS, SAMPLE_S)
