"""How the actuators move: time and accuracy of a move, rest without hunting, recovery, synchronisation."""

from __future__ import annotations

from itertools import pairwise

import pytest

from tiger.native.boards import SuspensionBoard
from tiger.protocol.messages import (
    PARAMS,
    AckStatus,
    BoardKind,
    BoardState,
    ParamSet,
    SuspensionMove,
    SuspensionState,
)

FULL_SPEED = 9.4
MOVE_MM = 35.0
BEST_S = MOVE_MM / FULL_SPEED  # at full speed all the way, 3.72 s


def rough(rig, stiction=0.2, backlash_mm=0.3, noise_counts=1.0):
    """A worn robot: the motors of corners 1 and 3 stand at the far side of their play."""
    for corner, actuator in enumerate(rig.actuators):
        actuator.stiction = stiction
        actuator.backlash_mm = backlash_mm
        actuator.motor_mm = actuator.stroke_mm + (backlash_mm / 2 if corner % 2 else -backlash_mm / 2)
    rig.board.set_noise(noise_counts)
    return rig


def at(make_rig, stroke_mm, **settings):
    rig = make_rig(**settings)
    for actuator in rig.actuators:
        actuator.stroke_mm = actuator.motor_mm = stroke_mm
    rig.boot()
    rig.arm()
    return rig


class Watch:
    """What the strokes did since now, seen every millisecond."""

    def __init__(self, rig, targets):
        self.rig = rig
        self.targets = targets
        self.start_ms = rig.time_ms
        self.outside_ms = [0] * 4  # last time farther than 0.2 mm from the target
        self.overshoot_mm = 0.0
        self.apart_mm = 0.0  # spread of the ways
        self.reversals = 0
        self.drive_ms = 0
        self.from_mm = list(rig.strokes_mm)
        self.sign = [0] * 4
        rig.watch = self.look

    def look(self):
        ways = []
        for corner, stroke in enumerate(self.rig.strokes_mm):
            target = self.targets[corner]
            direction = 1.0 if target >= self.from_mm[corner] else -1.0
            if abs(stroke - target) > 0.2:
                self.outside_ms[corner] = self.rig.time_ms - self.start_ms
            self.overshoot_mm = max(self.overshoot_mm, (stroke - target) * direction)
            way = target - self.from_mm[corner]
            ways.append((stroke - self.from_mm[corner]) / way if way else 0.0)
        longest = max(abs(t - f) for t, f in zip(self.targets, self.from_mm, strict=True))
        moving = [w for w, t, f in zip(ways, self.targets, self.from_mm, strict=True) if t != f]
        self.apart_mm = max(self.apart_mm, (max(moving) - min(moving)) * longest)
        for corner, duty in enumerate(self.rig.board.drive()):
            sign = (duty > 0) - (duty < 0)
            self.reversals += sign != 0 and self.sign[corner] == -sign
            self.sign[corner] = sign or self.sign[corner]
            self.drive_ms += sign != 0

    @property
    def arrival_s(self):
        return max(self.outside_ms) / 1000.0

    @property
    def errors_mm(self):
        return [abs(s - t) for s, t in zip(self.rig.strokes_mm, self.targets, strict=True)]


# ------------------------------------------------------------------------------------------ one long move


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("start", "target"), [(17.5, 52.5), (52.5, 17.5)])
def test_a_35_mm_move_takes_1_03_of_the_shortest_time_and_overshoots_0_3_mm_at_most(
    make_rig, start, target, seed, record_figure
):
    rig = rough(at(make_rig, start, board=SuspensionBoard(uid=seed)))
    assert rig.request(SuspensionMove((target,) * 4)).status == AckStatus.OK
    watch = Watch(rig, (target,) * 4)
    rig.run_ms(6000)
    record_figure("35 mm move over its shortest time", f"{watch.arrival_s / BEST_S:.3f}", "1.03")
    assert watch.arrival_s <= 1.03 * BEST_S
    assert watch.overshoot_mm <= 0.3
    assert max(watch.errors_mm) <= 0.2
    assert rig.faults() == set()


def test_a_rested_actuator_neither_reverses_nor_drives_for_60_s(make_rig):
    rig = rough(at(make_rig, 20.0))
    rig.request(SuspensionMove((40.0,) * 4))
    rig.run_ms(4000)
    watch = Watch(rig, (40.0,) * 4)
    rig.run_ms(60_000)
    assert watch.reversals == 0
    assert watch.drive_ms == 0
    assert max(watch.errors_mm) <= 0.2


def test_small_moves_arrive_too(make_rig):
    rig = rough(at(make_rig, 35.0))
    for step in (0.5, -0.4, 1.0, -0.3, 0.25, -2.0):
        target = 35.0 + step
        rig.request(SuspensionMove((target,) * 4))
        rig.run_ms(1500)
        assert [abs(s - target) <= 0.2 for s in rig.strokes_mm] == [True] * 4
        assert rig.is_off


# ------------------------------------------------------------------------------------------ all four together


def test_four_actuators_keep_within_0_3_mm_of_each_other(make_rig, record_figure):
    rig = rough(at(make_rig, 17.5))
    rig.request(SuspensionMove((52.5,) * 4))
    watch = Watch(rig, (52.5,) * 4)
    rig.run_ms(5000)
    record_figure("four actuators apart in a common move, mm", f"{watch.apart_mm:.3f}", "0.3")
    assert watch.apart_mm <= 0.3 + 1e-9  # the play that two of them take up first


@pytest.mark.parametrize("slow", [0.95, 0.85])
def test_the_others_wait_for_a_slow_actuator(make_rig, slow):
    rig = at(make_rig, 17.5)
    rig.actuators[2].full_speed_mmps *= slow
    rig.request(SuspensionMove((52.5,) * 4))
    watch = Watch(rig, (52.5,) * 4)
    rig.run_ms(6000)
    assert watch.apart_mm <= 0.3
    assert max(watch.errors_mm) <= 0.2
    assert watch.arrival_s <= 1.05 * BEST_S / slow


def test_unequal_ways_arrive_together(make_rig):
    targets = (50.0, 20.0, 38.0, 34.5)
    rig = at(make_rig, 35.0)
    rig.request(SuspensionMove(targets))
    watch = Watch(rig, targets)
    rig.run_ms(800)
    ways = [(s - 35.0) / (t - 35.0) for s, t in zip(rig.strokes_mm, targets, strict=True)]
    assert max(ways) - min(ways) <= 0.15  # of the shortest way, 0.5 mm
    rig.run_ms(2000)
    assert max(watch.errors_mm) <= 0.2


# ------------------------------------------------------------------------------------------ following rates


def test_strokes_follow_the_commanded_rate_with_the_actuators_lag(armed):
    armed.rates_mmps = (3.0, -2.0, 9.0, -0.5)
    start, start_ms = armed.strokes_mm, armed.time_ms
    armed.run_ms(2000)
    for moved, rate in zip(
        [b - a for a, b in zip(start, armed.strokes_mm, strict=True)], armed.rates_mmps, strict=True
    ):
        lag_s = 0.05 + 0.02
        assert moved == pytest.approx(rate * ((armed.time_ms - start_ms) / 1000 - lag_s), abs=0.15)


@pytest.mark.parametrize("rate", [0.1, 0.3, 1.0])
def test_slow_rates_are_followed_through_stiction(make_rig, rate):
    rig = rough(at(make_rig, 35.0), backlash_mm=0.0)
    rig.rates_mmps = (rate,) * 4
    worst = 0.0
    for n in range(1, 60):
        rig.run_ms(100)
        if n > 10:
            worst = max(worst, *(abs(s - 35.0 - rate * (n / 10 - 0.06)) for s in rig.strokes_mm))
    assert worst <= 0.2


def test_no_drive_at_zero_rate(armed):
    armed.rates_mmps = (6.0, -6.0, 3.0, -9.4)
    armed.run_ms(700)
    armed.rates_mmps = (0.0,) * 4
    armed.run_ms(40)  # the setpoint has arrived, the slew is over
    seen = []
    armed.watch = lambda: seen.append(armed.is_off)
    armed.run_ms(5000)
    assert all(seen)


@pytest.mark.parametrize("full_speed_mmps", [5.0, 9.4, 18.8])
def test_half_the_full_speed_of_the_parameter_takes_half_the_drive(rig, full_speed_mmps):
    index = next(p.index for p in PARAMS[BoardKind.MEGA_SUSPENSION] if p.name == "full_speed_mmps")
    assert rig.request(ParamSet(0, index, round(1000 * full_speed_mmps))).status == AckStatus.OK
    for actuator in rig.actuators:
        actuator.full_speed_mmps = full_speed_mmps
    rig.boot()
    rig.arm()
    rig.rates_mmps = (full_speed_mmps / 2, -full_speed_mmps / 2) * 2
    rig.run_ms(400)
    assert rig.board.drive() == pytest.approx((0.5, -0.5, 0.5, -0.5), abs=0.03)
    assert [a.rate_mmps for a in rig.actuators] == pytest.approx(rig.rates_mmps, rel=0.05)


def test_a_rate_beyond_full_speed_is_followed_at_full_speed(armed):
    armed.rates_mmps = (12.0,) * 4
    armed.run_ms(1000)
    assert armed.state.duty_permille == pytest.approx((1000,) * 4, abs=30)
    assert armed.health().faults == 0


def test_an_actuator_that_cannot_follow_says_so(make_rig):
    rig = at(make_rig, 20.0)
    rig.actuators[1].full_speed_mmps = 6.0
    rig.rates_mmps = (9.0,) * 4
    rig.run_ms(1500)
    assert rig.state.flags & 0b1111 == 0b0010


# ------------------------------------------------------------------------------------------ soft limits


@pytest.mark.parametrize(("rate", "limit"), [(9.4, 69.0), (-9.4, 1.0)])
def test_soft_limits_hold_without_overshoot(armed, rate, limit):
    armed.rates_mmps = (rate,) * 4
    farthest = []
    armed.watch = lambda: farthest.extend(armed.strokes_mm)
    armed.run_ms(5500)
    assert (max(farthest) if rate > 0 else min(farthest)) == pytest.approx(limit, abs=0.1)
    assert armed.strokes_mm == pytest.approx([limit] * 4, abs=0.12)
    assert armed.is_off
    assert armed.state.flags >> 4 & 0b1111 == 0b1111
    assert armed.faults() == set()


def test_outside_a_soft_limit_only_the_way_back_is_open(make_rig):
    rig = at(make_rig, 69.6)
    rig.rates_mmps = (5.0,) * 4
    rig.run_ms(500)
    assert rig.strokes_mm == pytest.approx([69.6] * 4, abs=0.05)
    rig.rates_mmps = (-5.0,) * 4
    rig.run_ms(500)
    assert all(s < 67.8 for s in rig.strokes_mm)


# ------------------------------------------------------------------------------------------ recovery


def first_motion_ms(rig, rate):
    """Time from a command to a drive of its sign."""
    rig.rates_mmps = (rate,) * 4
    return rig.run_until(lambda: all(d * rate > 0 for d in rig.board.drive()), 200)


@pytest.mark.parametrize("back", [-9.4, -2.0, -0.5])
def test_after_10_s_at_a_soft_limit_the_way_back_begins_within_50_ms(armed, back):
    armed.rates_mmps = (9.4,) * 4
    armed.run_ms(14_000)
    assert first_motion_ms(armed, back) <= 50


@pytest.mark.parametrize("back", [-9.4, -2.0, -0.5])
def test_after_8_s_of_commands_it_cannot_follow_the_way_back_begins_within_50_ms(make_rig, back):
    rig = at(make_rig, 2.0)
    for actuator in rig.actuators:
        actuator.full_speed_mmps *= 0.85  # a low supply
    rig.rates_mmps = (9.4,) * 4
    rig.run_ms(8_000)
    assert rig.state.state == BoardState.ARMED
    assert rig.state.duty_permille == (1000,) * 4
    assert first_motion_ms(rig, back) <= 50


def test_after_8_s_of_saturation_a_stop_is_a_stop(make_rig):
    rig = at(make_rig, 2.0)
    for actuator in rig.actuators:
        actuator.full_speed_mmps *= 0.85
    rig.rates_mmps = (9.4,) * 4
    rig.run_ms(8_000)
    rig.rates_mmps = (0.0,) * 4
    before = rig.strokes_mm
    rig.run_ms(1000)
    assert [b - a for a, b in zip(before, rig.strokes_mm, strict=True)] == pytest.approx([0.35] * 4, abs=0.35)
    assert rig.is_off


# ------------------------------------------------------------------------------------------ changes of mode


def test_a_rate_takes_over_from_a_move_and_a_move_from_a_rate_without_a_bump(make_rig):
    rig = at(make_rig, 20.0)
    rig.board.set_noise(0.0)
    rig.request(SuspensionMove((60.0,) * 4))
    rig.run_ms(1000)
    duties = []
    rig.watch = lambda: duties.extend(rig.board.drive())
    rig.run_ms(100)
    rig.rates_mmps = (FULL_SPEED,) * 4
    rig.run_ms(200)
    rig.rates_mmps = (FULL_SPEED,) * 3 + (FULL_SPEED - 0.001,)
    rig.run_ms(200)
    assert min(duties) >= 0.999
    assert max(duties) <= 1.0


def test_a_hold_gives_way_to_the_same_rate_without_a_jump_of_the_stroke(armed):
    armed.rates_mmps = (4.0,) * 4
    armed.run_ms(500)
    armed.rates_mmps = None
    armed.run_ms(150)
    armed.rates_mmps = (4.0,) * 4
    strokes = []
    armed.watch = lambda: strokes.append(armed.strokes_mm[0])
    armed.run_ms(500)
    steps = [(b - a) * 1000 for a, b in pairwise(strokes)]
    assert max(steps) <= 4.0 * 1.08  # mm/s: no catching up of what the hold let go
    assert min(steps) >= -0.05


def test_arming_moves_nothing(rig):
    seen = []
    rig.watch = lambda: seen.append(rig.is_off)
    rig.arm()
    rig.run_ms(1000)
    assert all(seen)
    assert rig.wire.last(SuspensionState).state == BoardState.ARMED


@pytest.mark.parametrize("creep_mm", [0.18, -0.18])
def test_a_stroke_that_creeps_off_its_target_is_put_back(armed, creep_mm):
    before = armed.strokes_mm[1]
    armed.actuators[1].motor_mm += creep_mm
    armed.actuators[1].stroke_mm += creep_mm
    armed.run_ms(1000)
    assert armed.strokes_mm[1] == pytest.approx(before, abs=0.1)
    assert armed.is_off
    assert armed.faults() == set()
