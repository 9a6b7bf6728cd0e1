"""The emulated robot: the boards' own firmware and two Roboteqs on the world, in lock-step virtual time.

    robot = EmulatedRobot(load_vehicle("tiger"), load_scenario("shaking-plate"), seed=1)
    robot.cables["suspension"].host_write(frame)      # what the daemon says
    robot.run(5)                                      # five milliseconds pass
    robot.cables["suspension"].host_read()            # what it hears
    robot.truth()                                     # for tests and plots only

A millisecond is: duties and speeds move the world, the world moves the pins, the boards run, bytes move along
the wires. That loop is compiled (firmware/native/native_robot.cpp); it stops for what Python does, at the
latest every five milliseconds for the IMU's noise. All depends on nothing but the arguments and the bytes
that came in: two robots fed alike are equal, in however many calls their time has passed.
"""

from __future__ import annotations

from functools import partial
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

from tiger.config.errors import ConfigError
from tiger.emulation.cable import Cable, LineNoise, NoisyLine
from tiger.emulation.roboteq import Roboteq
from tiger.emulation.world import STANDING_RADPS, SWITCH_MARGIN_MM, Truth, World
from tiger.models.sensors.potentiometer import ADC_COUNTS, Potentiometer
from tiger.native._core import ffi, lib
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
        if scenario.sensor_noise:
            self.imu.set_dither(0.0)  # the world's noise is enough
            self.suspension.set_noise(self.world.potentiometer.noise_counts)
        else:
            self.suspension.set_noise(0.0)

        self.cables = {name: Cable(noise, seed=10 * seed + k) for k, name in enumerate(BOARD_CABLES)}
        self.cables |= {name: Cable() for name in DRIVE_CABLES}
        self._nano_up = NoisyLine(noise, seed=10 * seed + 8)
        self._nano_down = NoisyLine(noise, seed=10 * seed + 9)
        self._most_steps = IMU_EVERY_STEPS if noise.clean else 1  # a noisy wire between boards is Python's
        self.nano_wire_cut = False
        self.estop_pressed = False
        self.motor_signs = (1.0, 1.0, 1.0, 1.0)
        """-1 for a motor whose wires are crossed: it turns backwards, and no one notices but the wheel."""
        self._broken_pots: dict[int, float] = {}  # corner -> counts its input shows
        self._stuck_pots: dict[int, float] = {}
        self._native = self._wired()
        self.set_potentiometers(self.world.potentiometer)
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

    def set_potentiometers(self, potentiometer: Potentiometer) -> None:
        """Exchange the four stroke potentiometers; raises ValueError unless they are straight."""
        if potentiometer.nonlinearity:
            raise ValueError("the emulated converter knows straight potentiometers only")
        zero, full = map(potentiometer.exact_counts, (0.0, potentiometer.stroke_max_mm))
        self._native.zero_counts = zero
        self._native.counts_per_mm = (full - zero) / potentiometer.stroke_max_mm

    def run(self, steps: int = 1) -> None:
        """Let so many milliseconds pass."""
        while steps > 0:
            self._begin_and_end_failures()
            n = min(steps, self._undisturbed_steps())
            self._run(n)
            steps -= n

    # ---- steps in which only the world, the boards and the wires between them act

    def _undisturbed_steps(self) -> int:
        """How many steps may pass before Python is needed again."""
        steps = min(self._most_steps, IMU_EVERY_STEPS - self._native.steps % IMU_EVERY_STEPS)
        if self._plan:
            steps = min(steps, -((self.world.time_us - self._plan[-1][0]) // STEP_US))
        return int(steps)

    def _run(self, steps: int) -> None:
        world, native = self.world, self._native
        self._put_bytes()
        world.step(STEP_S, self.suspension.drive(), self._wheel_rpm())
        if native.steps % IMU_EVERY_STEPS == 0:
            self.imu.set_inputs(*world.imu())
        if native.steps % FEEDBACK_EVERY_STEPS == 0:
            self._feed_back()
        wheel_rpm = self._run_drives(steps)
        plate_rad = world.plate_path_rad(steps, STEP_US)
        self._set_pins()
        lib.tiger_robot_run(native, steps, plate_rad, wheel_rpm)
        world.turn_field()
        self._take_bytes()

    def _set_pins(self) -> None:
        """Everything of the pins that is not the world's."""
        native, boards = self._native, self.boards
        native.suspension, native.imu = boards["mega_suspension"].handle, boards["nano_imu"].handle
        native.speed = [boards["mega_speed_left"].handle, boards["mega_speed_right"].handle]
        native.estop_pressed = self.estop_pressed
        native.carries_nano = self._nano_up.is_clean and not self.nano_wire_cut
        for corner in range(4):
            stuck = self._stuck_pots.get(corner, nan)
            native.forced_counts[corner] = self._broken_pots.get(corner, stuck)

    def _wheel_rpm(self) -> tuple[float, float, float, float]:
        """What the drives drive the motors to."""
        left, right = self.drives["left"].motor_rpm, self.drives["right"].motor_rpm
        fl, fr, rl, rr = self.motor_signs
        return fl * left[0], fr * right[0], rl * left[1], rr * right[1]

    def _feed_back(self) -> None:
        rpm, current = self.world.wheel_speed_rpm, self.world.motor_current_a().tolist()
        for side, (front, rear) in SIDES.items():
            self.drives[side].feedback((rpm[front], rpm[rear]), (current[front], current[rear]))

    def _run_drives(self, steps: int) -> list[float]:
        """Let the drives run ahead, as nothing reaches them meanwhile; return the rpm before each step."""
        for side, drive in self.drives.items():
            drive.estop_input = self.estop_pressed
            data = self.cables[f"roboteq_{side}"].board_read()
            if data:
                drive.receive(data)
        wheel_rpm: list[float] = []
        for _ in range(steps):
            wheel_rpm += self._wheel_rpm()
            for drive in self.drives.values():
                drive.run(STEP_US)
        for side, drive in self.drives.items():
            self.cables[f"roboteq_{side}"].board_write(drive.transmit())
        return wheel_rpm

    def _put_bytes(self) -> None:
        """Hand over what the host has sent: through USB, which takes until the end of the step."""
        for name, board in zip(BOARD_CABLES, (self.suspension, *self.speed.values()), strict=True):
            data = self.cables[name].board_read()
            if data:
                board.uart_write(data, delay_us=STEP_US)

    def _take_bytes(self) -> None:
        for name, board in zip(BOARD_CABLES, (self.suspension, *self.speed.values()), strict=True):
            self.cables[name].board_write(board.uart_read())
        if self._native.carries_nano:
            return
        up, down = self.imu.uart_read(), self.suspension.uart_read(PEER_PORT)
        if not self.nano_wire_cut:
            self.suspension.uart_write(self._nano_up.carry(up), PEER_PORT)
            self.imu.uart_write(self._nano_down.carry(down))

    def _wired(self) -> Any:
        """Return the `tiger_robot` of native_robot_api.h."""
        native: Any = ffi.new("tiger_robot *")
        native.world = self.world.native
        native.switch_margin_mm, native.standing_radps = SWITCH_MARGIN_MM, STANDING_RADPS
        native.gear_play = GEAR_PLAY_TEETH
        native.teeth, native.teeth_rad = self.world.teeth, ffi.from_buffer("double[]", self.world.teeth_rad)
        return native

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
            sticks = _ignoring(partial(self._stick_pot, corner))
            frees = _ignoring(partial(self._stuck_pots.pop, corner, None))
            table |= {
                (name, "open"): Failure(opens, heals),
                (name, "short"): Failure(shorts, heals),
                (name, "stuck"): Failure(sticks, frees),
            }
        return table

    def _stick_pot(self, corner: int) -> None:
        self._stuck_pots[corner] = self._native.shown_counts[corner]

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
