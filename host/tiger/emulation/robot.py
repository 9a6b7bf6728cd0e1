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

from math import nan
from typing import TYPE_CHECKING, Any

from tiger.emulation.cable import Cable, LineNoise, NoisyLine
from tiger.emulation.faults import SIDES, Plan, table_of_failures
from tiger.emulation.roboteq import Roboteq
from tiger.emulation.world import STANDING_RADPS, SWITCH_MARGIN_MM, Truth, World
from tiger.models.sensors.potentiometer import Potentiometer
from tiger.native._core import ffi, lib
from tiger.native.boards import PEER_PORT, Board, ImuBoard, SpeedBoard, SuspensionBoard

if TYPE_CHECKING:
    from tiger.config.vehicle import VehicleConfig
    from tiger.emulation.scenarios import Scenario

STEP_US = 1000
STEP_S = STEP_US * 1e-6
IMU_EVERY_STEPS = 5  # the sensor's registers follow the world at 200 Hz, twice the rate they are read at
FEEDBACK_EVERY_STEPS = 10  # what the Roboteqs measure

BOARD_CABLES = ("suspension", "speed_left", "speed_right")
DRIVE_CABLES = ("roboteq_left", "roboteq_right")

RESONATOR_PPM = {
    "mega_suspension": 800.0,
    "nano_imu": -1200.0,
    "mega_speed_left": 300.0,
    "mega_speed_right": -500.0,
}
"""How far each board's clock is off: ceramic resonators are, by up to 5000."""

GEAR_PLAY_TEETH = 0.01
"""Half the hysteresis of a gear-tooth sensor: without it a standing wheel's tremor is a storm of edges."""


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
        self._forced_counts = [nan] * 4  # what a broken potentiometer shows
        self._native = self._wired()
        self.set_potentiometers(self.world.potentiometer)
        self._failures = table_of_failures(self)
        self._plan = Plan(scenario.fault, self._failures)

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
            self._plan.act(self.world.time_us)
            n = min(steps, self._undisturbed_steps())
            self._run(n)
            steps -= n

    # ---- steps in which only the world, the boards and the wires between them act

    def _undisturbed_steps(self) -> int:
        """How many steps may pass before Python is needed again."""
        steps = min(self._most_steps, IMU_EVERY_STEPS - self._native.steps % IMU_EVERY_STEPS)
        due_us = self._plan.next_us
        if due_us is not None:
            steps = min(steps, -((self.world.time_us - due_us) // STEP_US))
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
            native.forced_counts[corner] = self._forced_counts[corner]

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
        fl, fr, rl, rr = self.motor_signs
        left, right = (drive.path_rpm(steps, STEP_US) for drive in self.drives.values())
        for (left_front, left_rear), (right_front, right_rear) in zip(left, right, strict=True):
            wheel_rpm += (fl * left_front, fr * right_front, rl * left_rear, rr * right_rear)
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

    # ---- what planned failures do here

    def force_stroke(self, corner: int, counts: float | None) -> None:
        """Let a potentiometer show `counts` from now on; None: those of now."""
        self._forced_counts[corner] = self._native.shown_counts[corner] if counts is None else counts

    def show_stroke(self, corner: int) -> None:
        """Let a potentiometer show its stroke again."""
        self._forced_counts[corner] = nan

    def cross_motor(self, corner: int) -> None:
        """Cross a motor's wires, or put them right again."""
        fl, fr, rl, rr = (-s if i == corner else s for i, s in enumerate(self.motor_signs))
        self.motor_signs = (fl, fr, rl, rr)
