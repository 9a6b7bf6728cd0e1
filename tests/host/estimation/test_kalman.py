"""The discrete Kalman filter against the `control` package, against itself over time, and against truth."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.config.vehicle import load_vehicle
from tiger.estimation.kalman import log_likelihood, predict, predictor_gain, steady_state_gain, update
from tiger.models.full_car import FORCE, IMU, FullCarParameters, full_car

CAR = (
    full_car(FullCarParameters.from_config(load_vehicle("table-6-1")))
    .select(inputs=FORCE, outputs=IMU)
    .discretise(0.005)
)
PROCESS = np.diag(np.linspace(1e-4, 1e-2, 14))
MEASUREMENT = np.diag([4e-4, 1e-6, 1e-6])


def test_gain_is_in_filter_form_and_its_predictor_form_is_that_of_control() -> None:
    import control

    ours = steady_state_gain(CAR.a, CAR.c, PROCESS, MEASUREMENT)
    theirs, covariance, _ = control.dlqe(CAR.a, np.eye(14), CAR.c, PROCESS, MEASUREMENT)
    assert predictor_gain(CAR.a, ours) == pytest.approx(theirs, rel=1e-6, abs=1e-8)
    assert ours.prior == pytest.approx(covariance, rel=1e-6, abs=1e-9)
    assert ours.gain != pytest.approx(theirs, rel=1e-2)


def test_doubling_agrees_with_scipy_on_singular_process_noise() -> None:
    from scipy.linalg import solve_discrete_are

    process = np.zeros((14, 14))
    process[7, 7] = 1e-3
    ours = steady_state_gain(CAR.a, CAR.c, process, MEASUREMENT).prior
    theirs = solve_discrete_are(CAR.a.T, CAR.c.T, process, MEASUREMENT)
    assert ours == pytest.approx(theirs, rel=1e-7, abs=1e-7 * abs(theirs).max())


def test_time_varying_steps_converge_to_the_steady_state() -> None:
    steady = steady_state_gain(CAR.a, CAR.c, PROCESS, MEASUREMENT)
    x, covariance = np.zeros(14), np.eye(14)
    for _ in range(3000):
        x, covariance = update(x, covariance, np.zeros(3), CAR.c, MEASUREMENT)
        posterior = covariance
        x, covariance = predict(CAR.a, CAR.b, x, np.zeros(4), covariance, PROCESS)
    assert covariance == pytest.approx(steady.prior, rel=1e-6, abs=1e-10)
    assert posterior == pytest.approx(steady.posterior, rel=1e-6, abs=1e-10)


def test_cross_correlated_noise_gives_white_innovations_of_the_stated_covariance() -> None:
    """The same noise drives the state and the measurement, as a road does an accelerometer."""
    rng = np.random.default_rng(3)
    a, c = np.array([[0.9, 0.2], [-0.2, 0.8]]), np.array([[1.0, 0.5]])
    drive, through = np.array([[0.3], [1.0]]), np.array([[0.7]])
    process, cross = drive @ drive.T, drive @ through.T
    measurement = through @ through.T + 0.01
    steady = steady_state_gain(a, c, process, measurement, cross)
    gain = predictor_gain(a, steady, cross)
    x, estimate, innovations = np.zeros(2), np.zeros(2), []
    for w, v in rng.standard_normal((40000, 2)):
        y = c @ x + through[:, 0] * w + 0.1 * v
        innovations.append(y - c @ estimate)
        estimate = a @ estimate + gain @ innovations[-1]
        x = a @ x + drive[:, 0] * w
    e = np.array(innovations)[100:, 0]
    assert e.var() == pytest.approx(steady.innovation[0, 0], rel=0.03)
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.02


def test_update_never_raises_the_variance_and_stays_symmetric() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((14, 14))
    prior = root @ root.T
    _, posterior = update(np.zeros(14), prior, np.zeros(3), CAR.c, MEASUREMENT)
    assert np.allclose(posterior, posterior.T)
    assert np.linalg.eigvalsh(prior - posterior).min() > -1e-6 * np.linalg.eigvalsh(prior).max()


def test_unobservable_mode_on_the_stability_limit_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="not observable"):
        steady_state_gain(np.eye(2), np.array([[1.0, 0.0]]), np.eye(2), np.eye(1))


def test_log_likelihood_is_that_of_a_normal_density() -> None:
    from scipy.stats import multivariate_normal

    covariance = np.array([[2.0, 0.3], [0.3, 1.0]])
    e = np.array([0.4, -1.0])
    assert log_likelihood(e, covariance) == pytest.approx(multivariate_normal(cov=covariance).logpdf(e))
