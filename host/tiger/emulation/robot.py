"""The emulated robot: the boards' own firmware and two Roboteqs on the world, in lock-step virtual time.

    robot = EmulatedRobot(load_vehicle("tiger"), load_scenario("shaking-plate"), seed=1)
    robot.cables["suspension"].host_write(frame)      # what the daemon says
    robot.run()                                       # one millisecond passes
    robot.cables["suspension"].host_read()            # what it hears
    robot.truth()                                     # for tests and plots only

One `run` is: duties and speeds move the world, the world moves the pins, the boards run, bytes move along the
wires. It depends on nothing but its arguments and the bytes that came in: two robots fed alike are equal.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from tiger.config.errors import ConfigError
from tiger.emulation.body import Four
from tiger.emulation.cable import Cable, LineNoise, NoisyLine
from tiger.emulation.roboteq import Roboteq
from tiger.emulation.world import Truth, World
from tiger.models.sensors.potentiometer import ADC_COUNTS
from tiger.native.boards import BROWN_OUT, EXTERNAL, PEER_PORT, Board, ImuBoard, SpeedBoard, SuspensionBoard

if TYPE_CHECKING:
    from collections.abc import Callable

    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import FaultEvent, Scenario

STEP_US = 1000
STEP_S = STEP_US * 1e-6
IMU_EVERY_STEPS = 5  # the sensor's registers follow the world at 200 Hz, twice the rate they are read at
FEEDBACK_EVERY_STEPS = 10  # what the Roboteqs measure

BOARD_CABLES = ("suspension", "speed_left", "speed_right")
DRIVE_CABLES = ("roboteq_left", "roboteq_right")
SIDES = {"left": (0, 2), "right": (1, 3)}  # front and rear corner of each side

RESONATOR_PPM = {
    "mega_suspension": 800.0,
    "nano_imu": -1200.0,
    "mega_speed_left": 300.0,
    "mega_speed_right": -500.0,
}
"""How far each board's clock is off: ceramic resonators are, by up to 5000."""

GEAR_PLAY_TEETH = 0.01
"""Half the hysteresis of a gear-tooth sensor: without it a standing wheel's tremor is a storm of edges."""

CORNER_NAMES = ("fl", "fr", "rl", "rr")
_OPEN_POT_COUNTS = float(ADC_COUNTS - 1)


class Failure(NamedTuple):
    """How one kind of planned failure begins and ends; the argument is the event's value."""

    begin: Callable[[float], None]
    end: Callable[[float], None]


class EmulatedRobot:
    """See the top of this file.

    Args:
        vehicle: the robot; its actuators must be of kind "rate".
        scenario: what happens to it, planned failures included.
        seed: of everything random.
        noise: damage on every framed line (the Roboteqs' lines carry no checksum and stay clean).

    Raises:
        ConfigError: the scenario plans a failure that this robot cannot have.
    """

    def __init__(
        self,
        vehicle: VehicleConfig,
        scenario: Scenario,
        seed: int = 0,
        noise: LineNoise = LineNoise(),  # noqa: B008  frozen
    ) -> None:
        self.scenario = scenario
        self.world = World(vehicle, scenario, seed)
        self.suspension = SuspensionBoard(uid=0x51)
        self.imu = ImuBoard(uid=0x52)
        self.speed = {"left": SpeedBoard(0, uid=0x53), "right": SpeedBoard(1, uid=0x54)}
        self.drives = {side: Roboteq(seed=seed) for side in SIDES}
        self.boards: dict[str, Board] = {
            "mega_suspension": self.suspension,
            "nano_imu": self.imu,
            "mega_speed_left": self.speed["left"],
            "mega_speed_right": self.speed["right"],
        }
        for name, board in self.boards.items():
            board.set_clock_ppm(RESONATOR_PPM[name])
        self._exact_counts = self.world.potentiometer.exact_counts
        if scenario.sensor_noise:
            self.imu.set_dither(0.0)  # the world's noise is enough
            self.suspension.set_noise(self.world.potentiometer.noise_counts)
        else:
            self.suspension.set_noise(0.0)

        self.cables = {name: Cable(noise, seed=10 * seed + k) for k, name in enumerate(BOARD_CABLES)}
        self.cables |= {name: Cable() for name in DRIVE_CABLES}
        self._nano_up = NoisyLine(noise, seed=10 * seed + 8)
        self._nano_down = NoisyLine(noise, seed=10 * seed + 9)
        self.nano_wire_cut = False
        self.estop_pressed = False
        self._broken_pots: dict[int, float] = {}  # corner -> counts its input shows
        self._stuck_pots: set[int] = set()
        self._counts = [0.0] * 4
        self._shown_phase = [0.0] * 4  # teeth, as the wheel sensors see them
        self._steps = 0
        self._failures = self._table_of_failures()
        self._plan = self._planned_failures(scenario.fault)

    @property
    def time_s(self) -> float:
        """Virtual time since the start."""
        return self.world.time_s

    @property
    def damaged_bytes(self) -> int:
        """Bytes damaged on all lines so far."""
        wires = self._nano_up.damaged_bytes + self._nano_down.damaged_bytes
        return wires + sum(cable.damaged_bytes for cable in self.cables.values())

    def truth(self) -> Truth:
        """What the world really does."""
        return self.world.truth()

    def run(self) -> None:
        """Let one millisecond pass."""
        self._begin_and_end_failures()
        self._move_world()
        self._set_pins()
        for board in self.boards.values():
            board.run(STEP_US)
        self._run_drives()
        self._move_bytes()
        self._steps += 1

    # ---- one step

    def _move_world(self) -> None:
        left, right = self.drives["left"].motor_rpm, self.drives["right"].motor_rpm
        self.world.step(STEP_S, self.suspension.drive(), (left[0], right[0], left[1], right[1]))

    def _set_pins(self) -> None:
        world = self.world
        counts = [self._exact_counts(stroke) for stroke in world.stroke_mm]
        for corner in self._stuck_pots:
            counts[corner] = self._counts[corner]
        for corner, shown in self._broken_pots.items():
            counts[corner] = shown
        self._counts = counts
        self.suspension.set_inputs(
            counts, _bits(world.lower_switches), _bits(world.upper_switches), self.estop_pressed
        )
        if self._steps % IMU_EVERY_STEPS == 0:
            reading = world.imu()
            self.imu.set_inputs(
                reading.accel_mps2.tolist(), reading.gyro_radps.tolist(), reading.mag_ut.tolist()
            )
        if self._steps == 0 or not world.wheels_stand:
            self._turn_gears(world.tooth_phase)

    def _turn_gears(self, phase: Four) -> None:
        """Show the sensors what has passed beyond their hysteresis."""
        shown, play = self._shown_phase, GEAR_PLAY_TEETH
        for side, wheels in SIDES.items():
            for input_, wheel in enumerate(wheels):
                behind = phase[wheel] - shown[wheel]
                if behind > play or behind < -play:
                    shown[wheel] = phase[wheel] - (play if behind > 0.0 else -play)
                    self.speed[side].set_wheel(input_, shown[wheel])

    def _run_drives(self) -> None:
        if self._steps % FEEDBACK_EVERY_STEPS == 0:
            rpm, current = self.world.wheel_speed_rpm, self.world.motor_current_a().tolist()
            for side, (front, rear) in SIDES.items():
                self.drives[side].feedback((rpm[front], rpm[rear]), (current[front], current[rear]))
        for side, drive in self.drives.items():
            drive.estop_input = self.estop_pressed
            cable = self.cables[f"roboteq_{side}"]
            data = cable.board_read()
            if data:
                drive.receive(data)
            drive.run(STEP_US)
            cable.board_write(drive.transmit())

    def _move_bytes(self) -> None:
        for name, board in zip(BOARD_CABLES, (self.suspension, *self.speed.values()), strict=True):
            cable = self.cables[name]
            cable.board_write(board.uart_read())
            data = cable.board_read()
            if data:
                board.uart_write(data)
        up, down = self.imu.uart_read(), self.suspension.uart_read(PEER_PORT)
        if not self.nano_wire_cut:
            if up:
                self.suspension.uart_write(self._nano_up.carry(up), PEER_PORT)
            if down:
                self.imu.uart_write(self._nano_down.carry(down))

    # ---- planned failures

    def _table_of_failures(self) -> dict[tuple[str, str], Failure]:
        """Return every failure this robot can have, by target and kind."""
        table: dict[tuple[str, str], Failure] = {
            ("nano_wire", "cut"): _flag(self, "nano_wire_cut"),
            ("estop", "press"): _flag(self, "estop_pressed"),
            ("imu_sensor", "faults"): _value(self.imu.set_faults),
            ("imu_sensor", "power_cycle"): _once(self.imu.power_cycle_sensor),
        }
        for name, cable in self.cables.items():
            table |= {
                (name, "cut"): Failure(_ignoring(cable.cut), _ignoring(cable.mend)),
                (name, "silence"): _flag(cable, "is_silent"),
            }
        for name, board in self.boards.items():
            table |= {
                (name, "hang"): _once(board.hang),
                (name, "hang_hard"): _once(partial(board.hang, interrupts_off=True)),
                (name, "reset"): _once(partial(board.reset, EXTERNAL)),
                (name, "brown_out"): _once(partial(board.reset, BROWN_OUT)),
            }
        for side, drive in self.drives.items():
            name = f"roboteq_{side}"
            table |= {
                (name, "silent"): _flag(drive, "silent"),
                (name, "deaf"): _flag(drive, "deaf"),
                (name, "fault_flags"): _value(partial(setattr, drive, "fault_flags")),
                (name, "reboot"): _once(drive.reboot),
            }
        for corner, corner_name in enumerate(CORNER_NAMES):
            name = f"potentiometer_{corner_name}"
            heals = _ignoring(partial(self._broken_pots.pop, corner, None))
            opens = _ignoring(partial(self._broken_pots.update, {corner: _OPEN_POT_COUNTS}))
            shorts = _ignoring(partial(self._broken_pots.update, {corner: 0.0}))
            sticks = _ignoring(partial(self._stuck_pots.add, corner))
            frees = _ignoring(partial(self._stuck_pots.discard, corner))
            table |= {
                (name, "open"): Failure(opens, heals),
                (name, "short"): Failure(shorts, heals),
                (name, "stuck"): Failure(sticks, frees),
            }
        return table

    def _planned_failures(
        self, events: tuple[FaultEvent, ...]
    ) -> list[tuple[int, Callable[[float], None], float]]:
        """Return (microsecond, action, value), the latest first: the next one is popped off the end."""
        plan = []
        for event in events:
            failure = self._failures.get((event.target, event.kind))
            if failure is None:
                kinds = sorted(kind for target, kind in self._failures if target == event.target)
                known = (
                    f"{event.target} knows {', '.join(kinds)}"
                    if kinds
                    else f"targets are {', '.join(sorted({target for target, _ in self._failures}))}"
                )
                raise ConfigError(
                    f"fault at {event.at_s:g} s: no {event.kind!r} of {event.target!r}; {known}"
                )
            plan.append((round(event.at_s * 1e6), failure.begin, event.value))
            if event.for_s is not None:
                plan.append((round((event.at_s + event.for_s) * 1e6), failure.end, event.value))
        return sorted(plan, key=lambda entry: -entry[0])

    def _begin_and_end_failures(self) -> None:
        now_us = self.world.time_us
        while self._plan and self._plan[-1][0] <= now_us:
            _, action, value = self._plan.pop()
            action(value)


def _bits(switches: tuple[bool, bool, bool, bool]) -> int:
    a, b, c, d = switches
    return a | b << 1 | c << 2 | d << 3


def _ignoring(action: Callable[[], object]) -> Callable[[float], None]:
    def act(_: float) -> None:
        action()

    return act


def _once(action: Callable[[], object]) -> Failure:
    """A failure that ends by itself."""
    return Failure(_ignoring(action), _ignoring(lambda: None))


def _flag(owner: object, name: str) -> Failure:
    return Failure(
        _ignoring(partial(setattr, owner, name, True)), _ignoring(partial(setattr, owner, name, False))
    )


def _value(set_to: Callable[[int], object]) -> Failure:
    def begin(value: float) -> None:
        set_to(int(value))

    def end(_: float) -> None:
        set_to(0)

    return Failure(begin, end)
