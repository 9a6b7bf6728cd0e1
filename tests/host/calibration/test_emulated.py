"""Every calibration on the emulated robot: a known error goes in, the stored parameters take it out."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiger.calibration import parameters, procedure
from tiger.calibration.accel import accel_procedure
from tiger.calibration.imu import imu_procedure
from tiger.calibration.level import level_procedure
from tiger.calibration.procedure import CalibrationError
from tiger.calibration.strokes import plot, positions_mm, strokes_procedure
from tiger.emulation.scenarios import Scenario
from tiger.models.full_car import GRAVITY_MPS2
from tiger.models.sensors.potentiometer import Potentiometer
from tiger.protocol.messages import BoardKind, BoardState, Fault, ImuFlag

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.host.calibration.conftest import Bench

    from tiger.protocol.messages import ImuAttitude

NANO, MEGA = BoardKind.NANO_IMU, BoardKind.MEGA_SUSPENSION


def tilt_deg(attitude: ImuAttitude) -> float:
    """Angle between the body's z axis and the vertical."""
    up = Rotation.from_quat(attitude.quaternion, scalar_first=True).apply([0.0, 0.0, 1.0])
    return math.degrees(math.acos(min(up[2], 1.0)))


def test_the_gyro_bias_is_found_stored_and_survives_a_power_cycle(bench: Bench) -> None:
    result = bench.calibrate(imu_procedure())
    true_degps = np.degrees(bench.rig.robot.world._imu.gyroscope.bias)
    assert np.degrees(result.parameters["gyro_bias_radps"]) == pytest.approx(true_degps, abs=0.025)
    bench.power_cycle(NANO)
    kept = parameters.read(bench.station, NANO)
    assert kept["gyro_bias_radps"] == pytest.approx(result.parameters["gyro_bias_radps"], abs=1e-6)
    attitude = bench.attitude()
    assert attitude.flags >> ImuFlag.CALIBRATED & 1
    assert np.degrees(attitude.rate_radps) == pytest.approx((0.0, 0.0, 0.0), abs=0.4)  # noise only


def test_a_shaken_robot_is_not_calibrated(
    bench_on: Callable[[Scenario], Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(procedure, "PATIENCE_S", 2.0)
    plate = {"axis": "roll", "at_s": 0.0, "amplitude_deg": 2.0, "frequency_hz": 0.5}
    bench = bench_on(Scenario(title="rocks", duration_s=99.0, model="linear", plate=(plate,)))
    with pytest.raises(CalibrationError, match="the robot shakes"):
        bench.calibrate(imu_procedure(2.0))
    assert parameters.read(bench.station, NANO)["calibrated"] == (0.0,)


def test_six_positions_find_offset_and_scale(bench: Bench) -> None:
    imu = bench.person.imu
    imu.offset_mps2, imu.scale = np.array([0.3, -0.25, 0.4]), np.array([1.03, 0.97, 1.02])
    result = bench.calibrate(accel_procedure(1.0))
    chip = bench.rig.robot.world._imu.accelerometer.bias
    expected = imu.offset_mps2 + chip / imu.scale
    assert result.parameters["accel_offset_mps2"] == pytest.approx(expected, abs=0.01)
    assert np.array(result.parameters["accel_scale_permille"]) / 1000.0 == pytest.approx(imu.scale, abs=2e-3)
    imu.up = None
    bench.power_cycle(NANO)
    assert tilt_deg(bench.attitude(6.0)) < 0.3
    kept = parameters.read(bench.station, NANO)
    raw = np.mean([message.accel_mps2 for message in bench.raw(1.0)], axis=0)
    force = np.array(kept["accel_scale_permille"]) / 1000.0 * (raw - kept["accel_offset_mps2"])
    assert np.linalg.norm(force) == pytest.approx(GRAVITY_MPS2, abs=0.01)


def test_a_tilted_mounting_is_taken_out_on_level_ground(bench: Bench) -> None:
    bench.person.imu.mounting = Rotation.from_euler("xyz", (5.0, -7.0, 0.0), degrees=True)
    assert tilt_deg(bench.attitude()) > 8.0
    bench.calibrate(level_procedure(rest_s=2.0))
    bench.power_cycle(NANO)
    assert tilt_deg(bench.attitude(6.0)) < 0.3  # the filter's share included
    x, y, z = np.mean([message.accel_mps2 for message in bench.raw(2.0)], axis=0)
    assert math.degrees(math.atan2(math.hypot(x, y), z)) < 0.03


def test_turned_round_the_slope_of_the_ground_does_not_matter(
    bench_on: Callable[[Scenario], Bench],
) -> None:
    ramp = {"axis": "roll", "at_s": 0.0, "to_deg": 2.0, "over_s": 0.1}
    bench = bench_on(Scenario(title="slopes", duration_s=99.0, model="linear", plate=(ramp,)))
    bench.gather(3.0)
    mounting = Rotation.from_euler("xyz", (3.0, 4.0, 0.0), degrees=True)
    bench.person.imu.mounting = mounting
    slope_deg = bench.rig.robot.truth().roll_deg
    result = bench.calibrate(level_procedure(turned=True, rest_s=2.0))
    kept = Rotation.from_quat(result.parameters["mounting_quaternion"], scalar_first=True)
    up = kept.apply(mounting.inv().apply([0.0, 0.0, 1.0]))
    assert math.degrees(math.acos(up[2])) < 0.15
    slope = next(finding for finding in result.findings if finding.name == "slope of the ground")
    assert slope.value == pytest.approx(abs(slope_deg), abs=0.15)


def test_a_body_that_leans_is_evened_first_or_refused(bench_on: Callable[[Scenario], Bench]) -> None:
    strokes_mm = (32.0, 35.0, 35.0, 38.0)
    bench = bench_on(Scenario(title="leans", duration_s=99.0, initial_stroke_mm=strokes_mm))
    with pytest.raises(CalibrationError, match=r"strokes are .* mm apart"):
        bench.calibrate(level_procedure(rest_s=1.0))
    bench.calibrate(level_procedure(even_mm=35.0, rest_s=2.0))
    assert np.ptp(bench.rig.robot.truth().stroke_mm) < 0.3
    mounting = parameters.read(bench.station, NANO)["mounting_quaternion"]
    tilt = Rotation.from_quat(mounting, scalar_first=True).magnitude()
    assert math.degrees(tilt) < 0.2


def test_other_potentiometers_are_found_by_moving_and_measuring(bench: Bench, tmp_path: Path) -> None:
    pots = Potentiometer(70.0, volts_at_zero_stroke=0.4, volts_at_full_stroke=4.5)
    bench.rig.robot.set_potentiometers(pots)
    bench.gather(1.0)
    bench.station.connect(MEGA)
    before = bench.stroke_error_mm()
    result = bench.calibrate(strokes_procedure(positions_mm(70.0, 3, moves=True), moves=True))
    assert max(map(abs, before)) > 0.7
    assert max(map(abs, bench.stroke_error_mm())) < 0.1
    bench.power_cycle(MEGA)
    assert max(map(abs, bench.stroke_error_mm())) < 0.1
    file = plot(result, tmp_path / "plots")
    assert file.stat().st_size > 5000


def test_nothing_moves_without_leave(bench: Bench) -> None:
    bench.person.permit = lambda text: False
    start = bench.rig.robot.truth().stroke_mm
    with pytest.raises(CalibrationError, match="not permitted to move"):
        bench.calibrate(strokes_procedure([10.0, 60.0], moves=True))
    assert bench.rig.robot.truth().stroke_mm == start
    assert bench.station.state.state is BoardState.DISARMED


def test_an_interrupted_move_leaves_the_board_disarmed(bench: Bench) -> None:
    bench.station.connect(MEGA)

    def interrupt(text: str) -> None:
        if bench.station.stroke_mm[0] > 37.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench.station.move((60.0,) * 4, interrupt)
    bench.gather(0.2)
    assert bench.station.state.state is BoardState.DISARMED
    assert bench.rig.robot.suspension.drive() == (0.0,) * 4
    assert max(bench.rig.robot.truth().stroke_mm) < 39.0


def test_a_pressed_emergency_stop_refuses_the_move_and_says_so(bench: Bench) -> None:
    bench.station.connect(MEGA)
    bench.rig.robot.estop_pressed = True
    bench.gather(0.3)
    with pytest.raises(CalibrationError, match="arm is refused: the emergency stop"):
        bench.station.move((40.0,) * 4)


def test_damaged_storage_is_noticed_and_a_calibration_mends_it(bench: Bench) -> None:
    bench.station.connect(MEGA, NANO)
    parameters.store(bench.station, NANO, {"gyro_bias_radps": (0.01, 0.02, 0.03)})
    for address in range(16, 200):
        bench.rig.robot.imu.eeprom[address] ^= 0x55
    bench.power_cycle(NANO)
    bench.station.forget_health(NANO)
    assert bench.station.faults(NANO) >> Fault.PARAMETERS & 1
    assert parameters.read(bench.station, NANO)["gyro_bias_radps"] == (0.0, 0.0, 0.0)
    parameters.store(bench.station, NANO, {"gyro_bias_radps": (0.01, 0.02, 0.03)})
    assert not bench.station.faults(NANO)
    bench.power_cycle(NANO)
    bench.station.forget_health(NANO)
    assert not bench.station.faults(NANO)


def test_a_value_outside_its_limits_is_refused_before_anything_is_set(bench: Bench) -> None:
    bench.station.connect(MEGA, NANO)
    with pytest.raises(CalibrationError, match=r"gyro_bias_radps = 0.3 is outside -0.2 to 0.2"):
        parameters.store(bench.station, NANO, {"calibrated": (1.0,), "gyro_bias_radps": (0.3, 0.0, 0.0)})
    assert parameters.read(bench.station, NANO)["calibrated"] == (0.0,)


def test_an_absent_nano_is_named_with_the_next_step(bench: Bench) -> None:
    bench.rig.robot.nano_wire_cut = True
    with pytest.raises(CalibrationError, match=r"nano_imu: does not answer .* Check the Nano's power"):
        bench.calibrate(imu_procedure())
