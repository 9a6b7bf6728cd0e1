"""Many runs at once are the runs one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiger.config.vehicle import load_vehicle
from tiger.models.batch import BLOCK_STEPS, simulate_batch
from tiger.models.full_car import FORCE, ROAD, FullCarParameters, full_car

CAR = full_car(FullCarParameters.from_config(load_vehicle("table-6-1")))
SAMPLED = CAR.select(inputs=(*ROAD, *FORCE)).discretise(5e-3, "foh")


@settings(deadline=None)
@given(st.integers(1, 9), st.integers(1, 3 * BLOCK_STEPS + 1), st.integers(0, 99))
def test_batch_equals_each_run_alone(runs: int, steps: int, seed: int) -> None:
    inputs = np.random.default_rng(seed).normal(size=(runs, steps, 8)) * 1e-2
    outputs = simulate_batch(SAMPLED, inputs)
    for u, y in zip(inputs, outputs, strict=True):
        alone = SAMPLED.simulate(u)[0]
        np.testing.assert_allclose(y, alone, rtol=1e-9, atol=1e-9 * np.abs(alone).max())


def test_continuous_model_is_refused() -> None:
    with pytest.raises(ValueError, match="discretise"):
        simulate_batch(CAR, np.zeros((1, 10, CAR.b.shape[1])))


@pytest.mark.parametrize("shape", [(10, 8), (2, 10, 7)])
def test_inputs_of_the_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"runs, steps, 8"):
        simulate_batch(SAMPLED, np.zeros(shape))
