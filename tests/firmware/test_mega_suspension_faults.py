"""Every fault of an actuator: found within 200 ms, outputs off, latched, named with its corner."""

from __future__ import annotations

import random

import pytest

from tiger.control import motor_heat
from tiger.protocol.messages import SCHEMA_HASH, AckStatus, Arm, BoardKind, BoardState, Fault, ParamSet

CORNER = 1
LIMIT_MS = 200


def at_speed(rig, rate_mmps):
    """All four at a steady rate."""
    rates = [rate_mmps] * 4
    rig.rates_mmps = tuple(rates)
    rig.run_ms(400)
    assert rig.state.state == BoardState.ARMED


def demand_fault(rig, fault, limit_ms=LIMIT_MS):
    """The fault comes in time, switches off, names the corner and stays."""
    took_ms = rig.run_until(lambda: rig.state.state == BoardState.FAULT, limit_ms)
    assert rig.is_off
    health = rig.health()
    assert health.faults == 1 << fault, [f.name for f in Fault if f and health.faults >> f & 1]
    assert health.fault_detail == CORNER
    assert rig.request(Arm(0, SCHEMA_HASH[BoardKind.MEGA_SUSPENSION], rig.hello().session)).status == (
        AckStatus.FAULTED
    )
    rig.rates_mmps = (0.0,) * 4
    rig.run_ms(300)
    assert rig.is_off
    return took_ms


def replace_pot(rig, read):
    rig.read_pot = lambda corner, counts: read(counts) if corner == CORNER else counts


# ------------------------------------------------------------------------------------------ potentiometers


@pytest.mark.parametrize("rail", [0.0, 1023.0, 20.0, 1005.0])
@pytest.mark.parametrize("rate", [0.0, 9.4, -4.0])
def test_an_open_or_shorted_potentiometer(armed, rail, rate):
    at_speed(armed, rate)
    replace_pot(armed, lambda counts: rail)
    demand_fault(armed, Fault.POT_OPEN)
    assert armed.clear_faults().status == AckStatus.STILL_PRESENT
    replace_pot(armed, lambda counts: counts)
    armed.run_ms(300)
    assert armed.clear_faults().status == AckStatus.OK
    assert armed.disarm().status == AckStatus.OK
    armed.rates_mmps = None
    armed.arm()


def test_an_open_potentiometer_is_found_while_disarmed_too(rig):
    replace_pot(rig, lambda counts: 1023.0)
    demand_fault(rig, Fault.POT_OPEN)


def test_a_potentiometer_is_called_open_after_30_ms_and_not_before(armed):
    for phase_ms in range(10):
        armed.run_until(lambda at=phase_ms: armed.time_ms % 10 == at, 10)
        replace_pot(armed, lambda counts: 1023.0)
        armed.run_ms(10)
        replace_pot(armed, lambda counts: counts)
        armed.run_ms(100)
        assert armed.state.state == BoardState.ARMED
    armed.run_until(lambda: armed.time_ms % 10 == 9, 10)  # a tick begins: three of them, and the line
    replace_pot(armed, lambda counts: 1023.0)
    assert 30 <= armed.run_until(lambda: armed.state.state == BoardState.FAULT, LIMIT_MS) <= 35


def test_a_noisy_potentiometer_is_cleared_only_after_it_was_quiet_for_a_while(armed):
    at_speed(armed, 2.0)
    replace_pot(armed, lambda counts: counts + (50.0 if armed.time_ms // 20 % 2 else -50.0))
    demand_fault(armed, Fault.POT_NOISY)
    assert armed.clear_faults().status == AckStatus.STILL_PRESENT
    replace_pot(armed, lambda counts: counts)
    armed.run_ms(60)
    assert armed.clear_faults().status == AckStatus.STILL_PRESENT
    armed.run_ms(200)
    assert armed.clear_faults().status == AckStatus.OK


@pytest.mark.parametrize("jump_counts", [25.0, 100.0])
def test_a_potentiometer_that_jumps(armed, jump_counts):
    at_speed(armed, 2.0)
    chance = random.Random(5)
    replace_pot(armed, lambda counts: counts + (jump_counts if armed.time_ms // 20 % 2 else -jump_counts))
    demand_fault(armed, Fault.POT_NOISY)
    del chance


def test_a_potentiometer_that_rattles_at_random(armed):
    at_speed(armed, 2.0)
    chance = random.Random(5)
    replace_pot(armed, lambda counts: counts + chance.gauss(0.0, 80.0))
    demand_fault(armed, Fault.POT_NOISY)


def test_ordinary_noise_of_three_counts_is_no_fault(armed):
    chance = random.Random(6)
    armed.board.set_noise(3.0)
    armed.read_pot = lambda corner, counts: counts + chance.gauss(0.0, 1.0)
    at_speed(armed, 3.0)
    armed.run_ms(3000)
    at_speed(armed, -9.4)
    armed.run_ms(2000)
    assert armed.faults() == set()


def test_a_single_glitch_is_passed_over(armed):
    at_speed(armed, 2.0)
    replace_pot(armed, lambda counts: counts + 300.0)
    armed.run_ms(8)
    replace_pot(armed, lambda counts: counts)
    before = armed.actuators[CORNER].stroke_mm
    armed.run_ms(300)
    assert armed.faults() == set()
    assert armed.state.stroke_mm[CORNER] == pytest.approx(armed.actuators[CORNER].stroke_mm, abs=0.15)
    assert armed.actuators[CORNER].stroke_mm > before


# ------------------------------------------------------------------------------------------ motion


@pytest.mark.parametrize("rate", [9.4, -9.4, 6.0, -4.0])
def test_a_jam_in_full_motion(armed, rate):
    at_speed(armed, rate)
    armed.actuators[CORNER].gain = 0.0
    armed.actuators[CORNER].rate_mmps = 0.0
    demand_fault(armed, Fault.JAM)


@pytest.mark.parametrize("rate", [9.4, -9.4, 6.0])
def test_a_jam_from_rest(armed, rate):
    armed.actuators[CORNER].gain = 0.0
    armed.rates_mmps = (rate,) * 4
    demand_fault(armed, Fault.JAM)


@pytest.mark.parametrize("rate", [9.4, -9.4, 4.0])
def test_a_reversed_motor(armed, rate):
    armed.actuators[CORNER].gain = -1.0
    start = armed.actuators[CORNER].stroke_mm
    armed.rates_mmps = (rate,) * 4
    demand_fault(armed, Fault.REVERSED)
    assert abs(armed.actuators[CORNER].stroke_mm - start) < 1.5


@pytest.mark.parametrize("rate", [9.4, -9.4, 4.0])
def test_a_potentiometer_wired_the_wrong_way_round(armed, rate):
    middle = armed.counts(35.0)
    replace_pot(armed, lambda counts: 2 * middle - counts)
    armed.rates_mmps = (rate,) * 4
    demand_fault(armed, Fault.REVERSED)


def test_two_potentiometers_swapped(armed):
    pots = {}

    def read(corner, counts):
        pots[corner] = counts
        return pots.get({0: 1, 1: 0}.get(corner, corner), counts)

    armed.read_pot = read
    armed.rates_mmps = (0.0, 9.4, 0.0, 0.0)
    armed.run_until(lambda: armed.state.state == BoardState.FAULT, LIMIT_MS)
    assert armed.is_off
    assert armed.faults() & {Fault.JAM, Fault.REVERSED, Fault.DRIVER}


@pytest.mark.parametrize("duty", [1.0, -1.0, 0.5])
def test_a_driver_that_stays_on_at_rest(armed, duty):
    armed.run_ms(2000)
    armed.actuators[CORNER].stuck_drive = duty
    demand_fault(armed, Fault.DRIVER)


@pytest.mark.parametrize("rate", [9.4, -9.4, 5.0])
def test_a_driver_that_stays_on_when_the_motion_ends(armed, rate):
    at_speed(armed, rate)
    armed.actuators[CORNER].stuck_drive = rate / 9.4
    armed.rates_mmps = (0.0,) * 4
    armed.run_until(lambda: armed.state.state == BoardState.FAULT, LIMIT_MS)
    assert armed.is_off
    assert armed.faults() & {Fault.DRIVER, Fault.REVERSED}


def test_a_driver_that_moves_a_disarmed_board(rig):
    rig.actuators[CORNER].stuck_drive = 1.0
    demand_fault(rig, Fault.DRIVER)


# ------------------------------------------------------------------------------------------ limit switches


def test_a_limit_switch_pressed_at_mid_stroke(armed):
    at_speed(armed, 1.0)
    armed.upper = 1 << CORNER
    demand_fault(armed, Fault.LIMIT_SWITCH)
    assert armed.clear_faults().status == AckStatus.STILL_PRESENT
    armed.upper = 0
    armed.run_ms(50)
    assert armed.clear_faults().status == AckStatus.OK


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize(("from_end_mm", "is_wrong"), [(2.8, False), (3.2, True)])
def test_a_limit_switch_may_be_pressed_within_3_mm_of_its_end_and_for_50_ms_elsewhere(
    make_rig, side, from_end_mm, is_wrong
):
    rig = make_rig()
    for actuator in rig.actuators:
        actuator.stroke_mm = actuator.motor_mm = from_end_mm if side == "lower" else 70.0 - from_end_mm
    rig.boot()
    rig.arm()
    for _ in range(3):
        setattr(rig, side, 1 << CORNER)
        rig.run_ms(38)
        setattr(rig, side, 0)
        rig.run_ms(50)
    assert rig.state.state == BoardState.ARMED
    setattr(rig, side, 1 << CORNER)
    if is_wrong:
        assert 45 <= rig.run_until(lambda: rig.state.state == BoardState.FAULT, LIMIT_MS) <= 65
    else:
        rig.run_ms(300)
        assert rig.state.state == BoardState.ARMED


def test_a_limit_switch_lost_beyond_the_end(rig):
    for actuator in rig.actuators:
        actuator.stroke_mm = actuator.motor_mm = 3.0
    # The world was set down anew: boot on it.
    rig.board.reset()
    rig.boot()
    # A calibration that is 2 mm off lets the actuator run past its end; the switch does not answer.
    for corner in range(4):
        rig.request(ParamSet(0, corner, 818 + 420))
    rig.request(ParamSet(0, 8, 0))
    rig.run_ms(300)
    rig.arm()
    rig.rates_mmps = (0.0, -9.4, 0.0, 0.0)
    rig.lower = 0
    rig.run_ms(300)
    rig.rates_mmps = (0.0,) * 4
    rig.run_ms(300)
    before = rig.faults()
    assert before == set()
    rig.actuators[CORNER].stuck_drive = -1.0
    armed_faults = rig.run_until(lambda: rig.state.state == BoardState.FAULT, LIMIT_MS)
    assert armed_faults <= LIMIT_MS


@pytest.mark.parametrize(("side", "rate", "stroke"), [("lower", -5.0, 1.5), ("upper", 5.0, 68.5)])
def test_a_pressed_switch_at_its_end_bars_its_direction_only(make_rig, side, rate, stroke):
    rig = make_rig()
    for actuator in rig.actuators:
        actuator.stroke_mm = actuator.motor_mm = stroke
    setattr(rig, side, 1 << CORNER)
    rig.boot()
    rig.arm()
    rig.rates_mmps = (rate,) * 4
    rig.run_ms(45)
    duties = rig.board.drive()
    assert duties[CORNER] == 0.0
    assert duties[0] * rate > 0
    rig.rates_mmps = (-rate / 10,) * 4  # nothing was piled up behind the switch
    rig.run_ms(50)
    assert rig.board.drive()[CORNER] * rate < 0


# ------------------------------------------------------------------------------------------ heat


def test_a_motor_that_works_beyond_its_duty_cycle_is_switched_off_and_cools(armed):
    for actuator in armed.actuators:
        actuator.full_speed_mmps = 9.4

    heat = motor_heat.COLD  # as the host reckons it from the duties that it is told of

    def run_to_and_fro(limit_s):
        nonlocal heat
        for n in range(limit_s // 3):
            armed.rates_mmps = (0.0, 9.4 if n % 2 else -9.4, 0.0, 0.0)
            for _ in range(30):
                armed.run_ms(100)
                if armed.state.state == BoardState.FAULT:
                    return n * 3
                heat = motor_heat.step(heat, armed.state.duty_permille, 0.1)
        raise AssertionError("never too hot")

    seconds = run_to_and_fro(180)
    assert 60 <= seconds <= 150  # a quarter of full heat: 94 s from cold
    assert armed.is_off
    assert armed.faults() == {Fault.OVERHEAT}
    assert max(heat) == heat[CORNER] == pytest.approx(1.0, abs=0.03)
    assert armed.health().fault_detail == CORNER
    assert armed.clear_faults().status == AckStatus.STILL_PRESENT
    armed.rates_mmps = None
    armed.run_ms(120_000)
    assert armed.clear_faults().status == AckStatus.OK


def test_levelling_on_the_shaking_plate_never_overheats(armed):
    # 11 mm at 0.05 Hz, the ride of the longest scenario, for five minutes.
    import math

    for n in range(3000):
        rate = 11.0 * 0.314 * math.cos(0.314 * n / 10)
        armed.rates_mmps = (rate, -rate, rate, -rate)
        armed.run_ms(100)
    assert armed.faults() == set()


# ------------------------------------------------------------------------------------------ no false alarms


def test_backlash_stiction_and_reversals_raise_no_fault(armed):
    chance = random.Random(11)
    for actuator in armed.actuators:
        actuator.stiction = 0.2
        actuator.backlash_mm = 0.3
    armed.board.set_noise(1.0)
    for _ in range(300):
        middle = sum(armed.strokes_mm) / 4 - 35.0
        armed.rates_mmps = tuple(
            chance.uniform(-9.4, 9.4) - middle / 3 if chance.random() < 0.8 else 0.0 for _ in range(4)
        )
        armed.run_ms(chance.randrange(10, 500))
    assert armed.faults() == set()
    assert armed.state.state == BoardState.ARMED
