"""The shipped images boot, introduce themselves, arm and follow a setpoint."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from tiger.protocol import messages as wire

pytestmark = pytest.mark.avr

PWM_PINS = ("B5", "B6", "E3", "E4")  # D11 D12 D5 D2: FL FR RL RR
DIRECTION_PINS = ("A0", "A1", "A2", "A3")
PERIOD_CYCLES = 800  # 20 kHz


def listen_until_ready(pair: Any) -> None:
    """Let the Nano's filter settle, three seconds after power-on."""
    for _ in range(40):
        attitudes = [m for m in pair.listen(100) if isinstance(m, wire.ImuAttitude)]
        if attitudes and attitudes[-1].flags >> wire.ImuFlag.FILTER_READY & 1:
            return
    raise AssertionError("the filter did not settle in four seconds")


@pytest.mark.parametrize("name", ["mega_suspension", "mega_speed"])
def test_board_introduces_itself_unasked_at_boot(
    simulated: ModuleType, make_board: Callable[[str], Any], name: str
) -> None:
    host = simulated.Host([make_board(name)], (simulated.KIND[name],))
    first = next(m for m in host.listen(60) if isinstance(m, wire.HelloReply))
    assert first.board_kind == simulated.KIND[name]
    assert first.schema_hash == wire.SCHEMA_HASH[simulated.KIND[name]]
    assert first.reset_cause == 1
    assert first.git != 0
    assert sum(host.decoder.rejects) == 0


@pytest.mark.parametrize("name", ["mega_suspension", "mega_speed"])
def test_board_arms_with_its_own_hash_and_session_only(
    simulated: ModuleType, make_board: Callable[[str], Any], name: str
) -> None:
    host = simulated.Host([make_board(name)], (simulated.KIND[name],))
    host.listen(400)
    who = host.hello()
    assert who.host_nonce == 0xBEEF
    wrong_hash = host.ask(wire.Arm(0, who.schema_hash ^ 1, who.session), wire.Ack)
    assert wrong_hash.status == wire.AckStatus.BAD_SCHEMA
    wrong_session = host.ask(wire.Arm(0, who.schema_hash, who.session ^ 1), wire.Ack)
    assert wrong_session.status == wire.AckStatus.BAD_SESSION
    assert host.arm().status == wire.AckStatus.OK
    assert host.health().state == wire.BoardState.ARMED or name == "mega_suspension"


def test_strap_tells_the_right_board_from_the_left_one(
    simulated: ModuleType, make_board: Callable[[str], Any]
) -> None:
    left, right = make_board("mega_speed"), make_board("mega_speed")
    right.pin("C7", 0)
    for board, instance in ((left, 0), (right, 1)):
        assert simulated.Host([board], (wire.BoardKind.MEGA_SPEED,)).hello().instance == instance


@pytest.mark.parametrize("sign", [1, -1])
def test_setpoint_drives_each_motor_its_own_way_at_20_khz(armed: Any, sign: int) -> None:
    board = armed.board
    pwm = [board.watch(pin) for pin in PWM_PINS]
    direction = [board.watch(pin) for pin in DIRECTION_PINS]
    rates = (4.0 * sign, -3.0 * sign, 0.0, 2.0 * sign)
    heard = armed.command(rates, 60)
    duties = [m.duty_permille for m in heard if isinstance(m, wire.SuspensionState)]
    for i, rate in enumerate(rates):
        pulses = board.watched(pwm[i])
        if rate == 0:
            assert pulses.rises == 0
            continue
        driven = [abs(duty[i]) for duty in duties if duty[i] != 0]
        mean_permille = 1000 * pulses.high_cycles / (pulses.rises * PERIOD_CYCLES)
        assert pulses.rises == pytest.approx(20 * 10 * len(driven), abs=20 * 12)
        assert min(driven) * 0.95 <= mean_permille <= max(driven) * 1.05
        assert all((duty[i] > 0) == (rate > 0) for duty in duties if duty[i] != 0)
        assert board.watched(direction[i]).level == (1 if rate > 0 else 0)


def test_potentiometer_sums_are_exact_and_in_corner_order(suspension: Any) -> None:
    codes = (100, 300, 700, 1000)
    for channel, code in enumerate(codes):
        suspension.board.adc(channel, code)
    raw = [m for m in suspension.listen(250) if isinstance(m, wire.SuspensionRaw)][-1]
    assert raw.pot_counts == tuple(16 * code for code in codes)
    assert raw.switches == 0


def test_open_switches_read_as_pressed_each_at_its_own_bit(suspension: Any) -> None:
    for bit, pin in enumerate(("A4", "A5", "A6", "A7", "C7", "C6", "C5", "C4", "E5")):
        suspension.board.pin(pin, 1)
        raw = [m for m in suspension.listen(110) if isinstance(m, wire.SuspensionRaw)][-1]
        assert raw.switches == 1 << bit, pin
        suspension.board.pin(pin, 0)


def test_nano_arms_through_the_mega_and_its_attitude_arrives(pair: Any) -> None:
    listen_until_ready(pair)
    assert pair.hello(node=1).board_kind == wire.BoardKind.NANO_IMU
    assert pair.arm(node=1).status == wire.AckStatus.OK
    heard = pair.listen(500)
    attitudes = [m for m in heard if isinstance(m, wire.ImuAttitude)]
    raws = [m for m in heard if isinstance(m, wire.ImuRaw)]
    assert len(attitudes) >= 48
    assert len(raws) >= 48
    assert attitudes[-1].quaternion == pytest.approx((1, 0, 0, 0), abs=5e-3)
    assert raws[-1].accel_mps2 == pytest.approx((0, 0, 9.81), abs=0.1)
    assert pair.arm(node=0).status == wire.AckStatus.OK
    mega, nano = pair.boards
    assert sum(pair.decoder.rejects) == 0
    assert mega.overruns(0) == mega.overruns(1) == nano.overruns(0) == 0


def test_every_board_follows_at_once(pair: Any) -> None:
    """Both boards armed, setpoints and both nodes' telemetry on one wire: nothing is lost."""
    listen_until_ready(pair)
    for node in (1, 0):
        assert pair.arm(node).status == wire.AckStatus.OK
    pair.command((0, 0, 0, 0), 50)
    heard = pair.command((2.0, -2.0, 2.0, -2.0), 100)
    states = [m for m in heard if isinstance(m, wire.SuspensionState)]
    assert all(m.state == wire.BoardState.ARMED for m in states)
    assert all(abs(duty) > 50 for duty in states[-1].duty_permille)
    assert sum(isinstance(m, wire.ImuAttitude) for m in heard) >= 9
    assert sum(pair.decoder.rejects) == 0
