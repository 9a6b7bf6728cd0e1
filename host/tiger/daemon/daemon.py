"""The daemon: ports on one side, the supervisor and the controller on the other.

    daemon = Daemon(robot, ports, clock)
    daemon.arm()
    record = daemon.tick(now_s)          # every control period: read, decide, compute, write

It has no clock and no thread of its own: `loop.py` runs it in real time, the rig in virtual time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tiger.daemon import limits, supervisor, wheel_check
from tiger.daemon.controller import ControllerState, design_controller, initial_state, rearmed
from tiger.daemon.controller import step as control
from tiger.daemon.discovery import Boards, Role, role_name
from tiger.daemon.drives import Drive
from tiger.daemon.overview import DriveEnergy
from tiger.daemon.rest_calibration import RestCalibration, bias_messages
from tiger.daemon.supervisor import Facts
from tiger.daemon.wheel_check import WheelCheck
from tiger.devices.imu import imu_raw_sample, imu_sample
from tiger.devices.roboteq import FaultFlag
from tiger.devices.suspension import ENGAGED_STATES, setpoint, stroke_sample
from tiger.devices.wheel_speed import wheel_sample
from tiger.frozen import replace
from tiger.protocol.link import Identified, Lost, Outcome, Rebooted, Request, Telemetry
from tiger.protocol.messages import (
    ACK_TEXT,
    SCHEMA_HASH,
    AckStatus,
    Arm,
    BoardKind,
    BoardState,
    ClearFaults,
    Disarm,
    Estop,
    ImuAttitude,
    ImuFlag,
    ImuRaw,
    Log,
    SuspensionFlag,
    SuspensionState,
    WheelSpeed,
)
from tiger.record import (
    STILL,
    Command,
    DaemonState,
    ImuRawSample,
    ImuSample,
    Inputs,
    LinkStatus,
    Outputs,
    Problem,
    ProblemKind,
    Record,
    StrokeSample,
    WheelSample,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tiger.config.robot import RobotConfig
    from tiger.daemon.clock import Clock
    from tiger.devices.ports import PortProvider
    from tiger.protocol.link import Event, Session

SUSPENSION: Role = (BoardKind.MEGA_SUSPENSION, 0)
IMU: Role = (BoardKind.NANO_IMU, 0)
SPEED_LEFT: Role = (BoardKind.MEGA_SPEED, 0)
SPEED_RIGHT: Role = (BoardKind.MEGA_SPEED, 1)

LIMITS_HZ = 50.0  # measurements held against their limits
HOUSEKEEPING_HZ = 10.0  # ports opened, problems and link health gathered
ARM_PATIENCE_S = 3.0  # how long a wish to arm lives
SETTLING_S = 5.0  # after the start it is normal that something is not ready yet
ARM_TIME_S = 1.0  # from ARM to every device reporting itself armed
CLEAR_TIME_S = 1.0  # how long a wish to clear faults lives
LOG_LINES = 20
NEUTRAL_SEEN = 1 << SuspensionFlag.NEUTRAL_SEEN.value
IMU_CALIBRATED = 1 << ImuFlag.CALIBRATED.value
DRIVE_ESTOP = FaultFlag.EMERGENCY_STOP.value


class Daemon:
    """One robot; see the module's text."""

    def __init__(self, robot: RobotConfig, ports: PortProvider, clock: Clock, nonce: int = 1) -> None:
        """Design the controller and prepare the ports; nothing is opened before the first tick.

        `nonce` differs from run to run, so that answers to an earlier run are not taken for ours.
        """
        now_s = clock.now_s()
        self.robot = robot
        self.command = Command()
        self.state = DaemonState.DISCONNECTED
        self.reason = "starting"
        self.log_lines: list[str] = []
        self.latched: tuple[Problem, ...] = ()  # why it is in FAULT or ESTOP
        self._clock = clock
        self._design = design_controller(robot)
        self._control = initial_state(self._design)
        needed = (SUSPENSION, IMU) + ((SPEED_LEFT, SPEED_RIGHT) if robot.drive.enabled else ())
        self.boards = Boards(ports, robot.ports, needed, nonce, now_s)
        paths = {"left": robot.ports.roboteq_left, "right": robot.ports.roboteq_right}
        self.drives = [Drive(side, path, ports, robot) for side, path in paths.items() if robot.drive.enabled]
        self.energy = DriveEnergy()
        self._rest = limits.RestCheck(robot.safety)
        self._resets: list[Problem] = []  # of boards, while armed
        self._calibration = RestCalibration()
        self._calibrating: list[Request] = []
        self._tick = 0
        self._setpoint_every = round(robot.loop.rate_hz / robot.loop.setpoint_rate_hz)
        self._limits_every = max(round(robot.loop.rate_hz / LIMITS_HZ), 1)
        self._housekeeping_every = max(round(robot.loop.rate_hz / HOUSEKEEPING_HZ), 1)
        self._housekeeping_due = True
        self._strokes: StrokeSample | None = None
        self._board_state = BoardState.BOOTING
        self._imu: ImuSample | None = None
        self._imu_raw: ImuRawSample | None = None
        self._wheels: dict[int, WheelSample] = {}
        self._estimate = Outputs().estimate
        self._wheel_check = WheelCheck()
        self._arm_until_s = -math.inf
        self._arm_request: Request | None = None
        self._arm_deadline_s = math.inf
        self._disarm = False
        self._clear_until_s = -math.inf
        self._problems: tuple[Problem, ...] = ()
        self._refusal: Problem | None = None
        self._waiting_for: Problem | None = None  # what keeps a wish to arm from coming true
        self._start_s = now_s
        self._links: tuple[LinkStatus, ...] = ()

    @property
    def control_state(self) -> ControllerState:
        """State of the controller after the latest tick, for a log from which it can be replayed."""
        return self._control

    # ----------------------------------------------------------------------------------- what a user asks for

    def arm(self, patience_s: float = ARM_PATIENCE_S) -> None:
        """Arm as soon as everything is ready, or say after `patience_s` why not."""
        self._arm_until_s = self._clock.now_s() + patience_s
        self._refusal = None

    def disarm(self) -> None:
        """Stop and disarm."""
        self._arm_until_s = -math.inf
        self._disarm = True

    def estop(self) -> None:
        """Emergency stop: everything off, latched on every device."""
        self._arm_until_s = -math.inf
        self._to(DaemonState.ESTOP, "emergency stop by command")
        link = self.boards.link(SUSPENSION)
        if link is not None:
            link.request(Estop(0), urgent=True)
        for drive in self.drives:
            drive.driver.emergency_stop()

    def clear(self) -> None:
        """Clear latched faults and emergency stops whose cause is gone; nothing is armed by it.

        An armed robot has none: boards clear only when disarmed, which would stop it.
        """
        if self.state is DaemonState.ARMED:
            self._say("nothing to clear: the robot is armed")
            return
        self._clear_until_s = self._clock.now_s() + CLEAR_TIME_S
        self._refusal = None
        self._wheel_check = WheelCheck()
        for role in self.boards.needed:
            session, link = self.boards.session(role), self.boards.link(role)
            if session is not None and link is not None and session.health is not None:
                node = session.node
                link.request(Disarm(node))
                link.request(ClearFaults(node))
        for drive in self.drives:
            drive.driver.clear()

    # ----------------------------------------------------------------------------------------------- one tick

    def _receive(self, now_s: float) -> None:
        """Take what has arrived on every port."""
        for event in self.boards.receive(now_s):
            self._on(event)
        for drive in self.drives:
            drive.receive(now_s)

    def tick(self, now_s: float, lateness_s: float = 0.0) -> Record:
        """One control period: read, decide, compute, write. `lateness_s` is only recorded."""
        if self._housekeeping_due or self._tick % self._housekeeping_every == 0:
            self._housekeeping(now_s)
        self._receive(now_s)
        for event in self.boards.poll(now_s):
            self._on(event)
        inputs = self._inputs(now_s)
        self.energy.add(inputs)
        facts = self._facts(inputs, now_s)
        state, reason = supervisor.step(self.state, facts)
        if reason is not None:
            self._to(state, reason)
        self._pursue_arming(inputs, now_s)
        self._disarm = False
        outputs = self._compute(inputs)
        self._send(outputs, now_s)
        record = Record(
            self._tick,
            self.state,
            self.reason,
            inputs,
            outputs,
            self._problems,
            self._links,
            lateness_s,
        )
        self._tick += 1
        return record

    def close(self) -> None:
        """Disarm what is armed and give the ports back."""
        now_s = self._clock.now_s()
        if self.state is DaemonState.ARMED:
            self._to(DaemonState.DISARMED, "the daemon ends")
            self._send(Outputs(), now_s)
        for port in self.boards.ports.values():
            port.connection.close()
        for drive in self.drives:
            drive.connection.close()

    def descriptors(self) -> list[int]:
        """Descriptors of the open ports, to wait on."""
        connections = [port.connection for port in self.boards.ports.values()]
        connections += [drive.connection for drive in self.drives]
        numbers = [connection.port.fileno() for connection in connections if connection.port is not None]
        return [number for number in numbers if number is not None]

    # ------------------------------------------------------------------------------------------ what arrives

    def _on(self, event: Event) -> None:
        if isinstance(event, Telemetry):
            self._on_telemetry(event)
            return
        self._housekeeping_due = True
        if isinstance(event, Rebooted):
            self._say(f"{event.session.name} was reset (cause {event.reply.reset_cause:#04x})")
            if self.state is DaemonState.ARMED:
                step = "Check its supply and its cable, then clear and arm again."
                self._resets.append(
                    Problem(ProblemKind.FAULT, event.session.name, "was reset while armed", step)
                )
        elif isinstance(event, Identified):
            identity = event.session.identity
            version = ".".join(map(str, identity.fw_version)) if identity else "?"
            self._say(f"{event.session.name} on {event.session.port}: firmware {version}")
        elif isinstance(event, Lost):
            self._say(f"{event.session.name} fell silent")
        if event.session.kind in (None, BoardKind.MEGA_SUSPENSION):
            self._board_state = BoardState.BOOTING

    def _on_telemetry(self, event: Telemetry) -> None:
        message = event.message
        if isinstance(message, SuspensionState):
            self._strokes = stroke_sample(message, event.t_s)
            self._board_state = message.state
        elif isinstance(message, ImuAttitude):
            sample = imu_sample(message, event.t_s)
            if sample is not None:
                self._imu = sample
                self._rest.add(sample)
        elif isinstance(message, ImuRaw):
            self._imu_raw = imu_raw_sample(message, event.t_s)
            self._calibration.add(self._imu_raw)
        elif isinstance(message, WheelSpeed):
            identity = event.session.identity
            if identity is not None:
                self._wheels[identity.instance] = wheel_sample(message, event.t_s)
        elif isinstance(message, Log):
            self._say(f"{event.session.name}: {message.text}")

    def note(self, line: str) -> None:
        """Show a line to whoever watches."""
        self._say(line)

    def _say(self, line: str) -> None:
        self.log_lines = [*self.log_lines[1 - LOG_LINES :], line]

    def _inputs(self, now_s: float) -> Inputs:
        command = self.command
        if self._motion_wanted() and not self._wheel_check.passed:
            command = replace(command, speed_mps=0.0, yaw_rate_radps=0.0)
        samples = [drive.sample for drive in self.drives] or [None, None]
        return Inputs(
            now_s=now_s,
            armed=self.state is DaemonState.ARMED,
            command=command,
            strokes=self._strokes,
            imu=self._imu,
            imu_raw=self._imu_raw,
            wheels_left=self._wheels.get(0),
            wheels_right=self._wheels.get(1),
            drive_left=samples[0],
            drive_right=samples[1],
        )

    # ----------------------------------------------------------------------------------------- the supervisor

    def _facts(self, inputs: Inputs, now_s: float) -> Facts:
        is_armed = self.state is DaemonState.ARMED
        faults = self._device_faults()
        if is_armed:
            if self._tick % self._limits_every == 0:
                faults += limits.exceeded(self.robot.safety, inputs, self._estimate, is_armed=True)
            if self._wheel_check.problem is not None:
                faults.append(self._wheel_check.problem)
            faults += self._resets
            if faults:
                self.latched = tuple(faults)
        missing, complete = True, self.boards.complete
        for port in self.boards.ports.values():
            if port.link is not None:
                missing = is_armed and not complete
                break
        unknown, estop = not complete, self._board_state is BoardState.ESTOP
        for drive in self.drives:  # every tick: no generators
            missing = missing or not drive.connection.is_open
            unknown = unknown or not drive.known
            estop = estop or bool(drive.driver.flags["FF"] & DRIVE_ESTOP)
        return Facts(
            missing=missing,
            unknown=unknown,
            estop=estop,
            fault=bool(faults),
            armed=self._all_armed(),
            disarm=self._disarm,
            clear=now_s < self._clear_until_s,
        )

    def _device_faults(self) -> list[Problem]:
        faults: list[Problem] = []
        for session in self.boards.crew:
            if session.health is not None and session.health.faults:
                faults += limits.board_faults(session)
        for drive in self.drives:
            faults += limits.drive_faults(drive.driver)
        return faults

    def _all_armed(self) -> bool:
        """Whether every device that moves something is armed, and the suspension saw neutral commands."""
        if self._board_state not in ENGAGED_STATES or self._strokes is None:
            return False
        return bool(self._strokes.flags & NEUTRAL_SEEN) and all(drive.running for drive in self.drives)

    def _to(self, state: DaemonState, reason: str) -> None:
        """Enter a state and do what it means."""
        was_armed = self.state is DaemonState.ARMED
        if state in (DaemonState.FAULT, DaemonState.ESTOP):
            found = self._device_faults() + list(self._lost_devices())
            self.latched = tuple(dict.fromkeys((*self.latched, *found)))
        else:
            self.latched = ()
        self.state, self.reason = state, reason
        self._housekeeping_due = True
        self._arm_request = None
        self._waiting_for = None
        self._resets.clear()
        if state is DaemonState.ARMED:
            self._arm_until_s = -math.inf
            self._wheel_check = WheelCheck()
            self._control = rearmed(self._design, self._control)
        elif was_armed:
            self._stop_everything(state)

    def _stop_everything(self, state: DaemonState) -> None:
        self._arm_until_s = -math.inf
        link = self.boards.link(SUSPENSION)
        # A board that stopped by itself keeps its fault until it is cleared: DISARM would wipe it out.
        if link is not None and state is not DaemonState.ESTOP and self._board_state in ENGAGED_STATES:
            link.request(Disarm(0), urgent=True)
        for drive in self.drives:
            drive.driver.hold()
            if state is DaemonState.ESTOP:
                drive.driver.emergency_stop()

    def _lost_devices(self) -> Iterable[Problem]:
        """Devices that are not there now, for the record of a fault."""
        for role in self.boards.needed:
            if role not in self.boards.roles:
                text, step = "was lost", "Check its cable and power, then clear and arm again."
                yield Problem(ProblemKind.MISSING, role_name(role), text, step)
        for drive in self.drives:
            if not drive.known:
                yield drive.problem() or Problem(
                    ProblemKind.NO_ANSWER,
                    drive.driver.name,
                    "stopped confirming commands: drives were stopped",
                    "Check its cable and power, then clear and arm again.",
                )

    # ------------------------------------------------------------------------------------------------- arming

    def _pursue_arming(self, inputs: Inputs, now_s: float) -> None:
        """While someone wants it armed: look for what is in the way, then arm device by device."""
        if self._arm_until_s == -math.inf or self.state is DaemonState.ARMED:
            return
        obstacle = self._obstacle(inputs)
        if obstacle is None:
            obstacle = self._arm_devices(now_s)
        if obstacle is not None and now_s >= self._arm_until_s:
            self._refuse(obstacle)
        self._waiting_for = obstacle

    def _obstacle(self, inputs: Inputs) -> Problem | None:
        """The first thing that keeps the robot from being armed."""
        if self.state is not DaemonState.DISARMED:
            problems = (*self.latched, *self._problems)
            text = f"the robot is {self.state.name.lower()}"
            return problems[0] if problems else Problem(ProblemKind.REFUSED, "arm", text, "Wait, or clear.")
        if max(abs(self.command.speed_mps), abs(self.command.yaw_rate_radps)) > (
            self.robot.safety.max_neutral_speed_mps
        ):
            text, step = "the command is not neutral", "Bring speed and yaw rate to zero first."
            return Problem(ProblemKind.REFUSED, "arm", text, step)
        rest = self._rest.problem(inputs.imu)
        if rest is not None:
            return rest
        if not self._estimate.ready:
            text = "the attitude observer is not ready"
            return Problem(ProblemKind.REFUSED, "arm", text, "Keep the robot still for a few seconds.")
        exceeded = next(limits.exceeded(self.robot.safety, inputs, self._estimate), None)
        if exceeded is not None:
            return exceeded
        idle = [drive for drive in self.drives if not (drive.running or drive.driver.ready)]
        if idle:
            text = f"is {idle[0].driver.phase.value}"
            return Problem(ProblemKind.REFUSED, idle[0].driver.name, text, "Wait a moment.")
        return None

    def _arm_devices(self, now_s: float) -> Problem | None:
        link, session = self.boards.link(SUSPENSION), self.boards.session(SUSPENSION)
        if link is None or session is None or session.identity is None:
            return None
        if self._arm_request is None:
            arm = Arm(0, SCHEMA_HASH[BoardKind.MEGA_SUSPENSION], session.identity.session)
            self._arm_request = link.request(arm)
            self._arm_deadline_s = now_s + ARM_TIME_S
            return None
        request = self._arm_request
        if request.outcome is Outcome.WAITING:
            return None
        if not request.ok:
            self._arm_request = None
            return _refused_by_board(request)
        for drive in self.drives:
            if not drive.running:
                drive.driver.release()
        if now_s > self._arm_deadline_s:
            self._arm_request = None
            text = "accepted ARM but does not report itself armed"
            return Problem(
                ProblemKind.REFUSED, "mega_suspension", text, "Try again; check the link's health."
            )
        return None

    def _refuse(self, obstacle: Problem) -> None:
        self._arm_until_s = -math.inf
        self._arm_request = None
        self._refusal = Problem(
            ProblemKind.REFUSED, "not armed", f"{obstacle.where}: {obstacle.text}", obstacle.next_step
        )
        self._housekeeping_due = True
        for drive in self.drives:
            drive.driver.hold()

    # ------------------------------------------------------------------------------------ compute and send

    def _compute(self, inputs: Inputs) -> Outputs:
        self._control, outputs = control(self._design, self._control, inputs, self.robot.loop.period_s)
        self._estimate = outputs.estimate
        if self.state is not DaemonState.ARMED or not inputs.armed:
            return replace(outputs, stroke_rate_mmps=STILL, wheel_rpm=STILL)
        if limits.is_late(self.robot.safety, inputs):
            outputs = replace(outputs, stroke_rate_mmps=STILL, reason="holding: samples are late")
        if self._wheel_check.passed or not self.drives:
            return outputs
        self._wheel_check = wheel_check.step(
            self._wheel_check, self._motion_wanted(), inputs, self.robot.loop.period_s
        )
        wheel_rpm = self._wheel_check.wheel_rpm
        return outputs if outputs.wheel_rpm == wheel_rpm else replace(outputs, wheel_rpm=wheel_rpm)

    def _motion_wanted(self) -> bool:
        return self.command.speed_mps != 0.0 or self.command.yaw_rate_radps != 0.0

    def _send(self, outputs: Outputs, now_s: float) -> None:
        link = self.boards.link(SUSPENSION)
        if link is not None and self._tick % self._setpoint_every == 0:
            engaged = self.state is DaemonState.ARMED or self._arm_request is not None
            link.setpoint(setpoint(outputs.stroke_rate_mmps, engaged, now_s))
        fl, fr, rl, rr = outputs.wheel_rpm
        for drive, (front_rpm, rear_rpm) in zip(self.drives, ((fl, rl), (fr, rr)), strict=False):
            drive.driver.command(front_rpm, rear_rpm)
        self.boards.send(self._clock.now_s())
        for drive in self.drives:
            drive.send(self._clock.now_s())

    # ------------------------------------------------------------------------------------------- housekeeping

    def _housekeeping(self, now_s: float) -> None:
        """Open ports, and gather what people want to see: too slow for every tick."""
        self._housekeeping_due = False
        if self.state in (DaemonState.FAULT, DaemonState.ESTOP):
            self.latched = tuple(dict.fromkeys((*self.latched, *self._device_faults())))
        self.boards.step(now_s)
        for drive in self.drives:
            drive.step(now_s)
        found = [*self.latched, *self.boards.problems(now_s)]
        found += [problem for drive in self.drives if (problem := drive.problem())]
        if self.state is not DaemonState.ARMED:
            found += self._device_faults()
        if self._refusal is not None:
            found.append(self._refusal)
        elif self._waiting_for is not None and now_s - self._start_s > SETTLING_S:
            found.append(self._waiting_for)
        if self._low_battery() is not None:
            found.append(self._low_battery())  # type: ignore[arg-type]
        tipping = limits.tip_warning(self._estimate)
        if tipping is not None:
            found.append(tipping)
        if self.state is DaemonState.DISARMED:
            self._calibrate_imu()
        self._problems = tuple(dict.fromkeys(found))
        self._links = tuple(self._link_statuses(now_s))

    def _calibrate_imu(self) -> None:
        """Set the gyro's bias while everything is still, when the Nano has none or a wrong one."""
        if any(request.outcome is Outcome.WAITING for request in self._calibrating):
            return
        link, rest = self.boards.link(IMU), self._rest.problem(self._imu)
        if link is None or self._imu is None or self._arm_request is not None:
            return
        if rest is None or (self._imu.flags & IMU_CALIBRATED and rest.kind is not ProblemKind.LIMIT):
            return
        bias = self._calibration.bias()
        if bias is None:
            return
        self._calibrating = [link.request(message) for message in bias_messages(bias)]
        self._calibration.clear()
        self._rest.reset()
        degrees = " ".join(f"{math.degrees(value):+.2f}" for value in bias)
        self._say(f"nano_imu: gyro bias at rest {degrees} degrees/s")

    def _low_battery(self) -> Problem | None:
        volts = [drive.sample.battery_v for drive in self.drives if drive.sample is not None]
        if not volts or min(volts) >= self.robot.safety.battery_low_v:
            return None
        text = f"{min(volts):.1f} V, low is {self.robot.safety.battery_low_v:g} V"
        return Problem(ProblemKind.LIMIT, "battery", text, "Charge it soon.")

    def _link_statuses(self, now_s: float) -> Iterable[LinkStatus]:
        for role in self.boards.needed:
            place = self.boards.roles.get(role)
            if place is None or place[0].link is None:
                yield LinkStatus(role_name(role), "absent", False)
            else:
                yield _board_status(role_name(role), place[1], place[0].link.decoder.rejects, now_s)
        for drive in self.drives:
            driver = drive.driver
            yield LinkStatus(
                driver.name,
                driver.phase.value if drive.connection.is_open else "absent",
                drive.known,
                rx_frames=driver.exchanges,
                rejects=driver.garbled,
                board_rejects=driver.changed_commands,
                seq_gaps=driver.timeouts,
                supply_v=drive.sample.battery_v if drive.sample else 0.0,
            )


def _board_status(name: str, session: Session, rejects: list[int], now_s: float) -> LinkStatus:
    health = session.health
    clock = session.clock
    return LinkStatus(
        name,
        health.state.name.lower() if health else "silent",
        True,
        rx_frames=session.frames,
        rejects=sum(rejects),
        board_rejects=sum(health.rejects) if health else 0,
        seq_gaps=session.seq_gaps,
        round_trip_ms=clock.best_round_trip_s * 1e3 if clock.accepted else 0.0,
        clock_sigma_us=clock.sigma_at(now_s) * 1e6 if clock.accepted else 0.0,
        drift_ppm=clock.drift_ppm,
        overruns=health.overruns if health else 0,
        ram_free_bytes=health.ram_free_bytes if health else 0,
        supply_v=health.supply_mv / 1000.0 if health else 0.0,
    )


def _refused_by_board(request: Request) -> Problem:
    if request.status is None:
        text, step = "does not answer ARM", "Check the link's health."
    else:
        text, step = ACK_TEXT[request.status], _ARM_STEPS.get(request.status, "Try again.")
    return Problem(ProblemKind.REFUSED, "mega_suspension", text, step)


_ARM_STEPS = {
    AckStatus.BAD_SCHEMA: "Flash it: make flash BOARD=mega_suspension PORT=...",
    AckStatus.FAULTED: "Mend the fault, clear, then arm again.",
    AckStatus.ESTOPPED: "Release the emergency stop, clear, then arm again.",
    AckStatus.NOT_READY: "Check that all four potentiometers read plausible strokes.",
}
