"""The IMU's offset from the centre of mass, found in the innovations of one passage."""

from __future__ import annotations

import numpy as np
import pytest

from tiger.control.ride import ImuNoise
from tiger.estimation.imu_offset import LONG_WAVES, ROUGH_ROAD, estimate
from tiger.studies import ride_cases
from tiger.studies.performance import simulate

CAR = ride_cases.load_case("table-6-1").car
NOISE = ImuNoise()


@pytest.mark.parametrize("offset", [(0.305, 0.145), (-0.2, 0.1)])
def test_offset_is_found_within_5_cm_on_the_bumpy_road(offset: tuple[float, float]) -> None:
    imu = simulate(CAR, ride_cases.bumpy_road(), None, NOISE, (1,), offset).imu[0]
    found = estimate(CAR, NOISE, imu, preview_s=(ride_cases.BUMPY_PREVIEW_S,), priors=(LONG_WAVES,))
    assert (found.x_m, found.y_m) == pytest.approx(offset, abs=0.05)


def test_offset_is_found_within_5_cm_on_an_iso_road() -> None:
    road = ride_cases.iso_roads(CAR, [5], duration_s=3.0)[0]
    imu = simulate(CAR, road, None, NOISE, (2,), (0.305, 0.145)).imu[0]
    tau = CAR.wheelbase_m / ride_cases.ISO_SPEED_MPS
    found = estimate(CAR, NOISE, imu, preview_s=(tau,), priors=(ROUGH_ROAD,))
    assert (found.x_m, found.y_m) == pytest.approx((0.305, 0.145), abs=0.05)
    assert 0 < found.x_std_m < 0.05


def test_wheel_delay_is_found_with_the_offset() -> None:
    imu = simulate(CAR, ride_cases.bumpy_road(), None, NOISE, (3,), (0.2, 0.1)).imu[0]
    found = estimate(CAR, NOISE, imu, preview_s=(0.134, 0.102), priors=(LONG_WAVES,))
    assert found.preview_s == pytest.approx(0.102)


def test_record_at_rest_determines_nothing() -> None:
    imu = np.random.default_rng(0).standard_normal((300, 3)) * np.sqrt(np.diag(NOISE.covariance()))
    with pytest.raises(ValueError, match="do not determine"):
        estimate(CAR, NOISE, imu, preview_s=(0.1,), priors=(LONG_WAVES,))
