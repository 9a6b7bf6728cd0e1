"""`tiger run`: the daemon on the real robot, or on the emulated one in real or virtual time."""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.cli.answers import fail, refuse_unwritable, scenario_names, starting, write_json
from tiger.record import Command, DaemonState, Record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tiger.config.robot import RobotConfig
    from tiger.daemon.clock import Clock, Lateness
    from tiger.daemon.daemon import Daemon
    from tiger.daemon.overview import Overview
    from tiger.devices.ports import PortProvider
    from tiger.emulation.scenarios import Scenario
    from tiger.logs.session import LogSession
    from tiger.rig.separate import SeparateRobot

JOURNAL_HZ = 50.0
ARM_PATIENCE_S = 30.0
LEVEL_BAND_DEG = 0.5


@dataclass
class Wishes:
    """What the command line asked for."""

    arm: bool
    speed_mps: float
    yaw_rate_radps: float
    duration_s: float | None
    log_folder: Path | None = None
    keep_series: bool = False  # only for --json: a service runs for weeks


@dataclass
class Journal:
    """What a run was like: the series for --json, and what its last line says."""

    series: dict[str, list[Any]] = field(
        default_factory=lambda: {
            name: []
            for name in (
                "time_s",
                "roll_true_deg",
                "pitch_true_deg",
                "roll_est_deg",
                "pitch_est_deg",
                "stroke_mm",
                "rate_cmd_mmps",
                *("x_m", "y_m", "yaw_deg", "speed_mps", "slip_ratio"),
            )
        }
    )
    ticks: int = 0
    looks: int = 0
    armed_looks: int = 0
    level_looks: int = 0
    first_armed_s: float | None = None
    stops: list[str] = field(default_factory=list)
    last: Record | None = None
    last_time_s: float = 0.0
    log: dict[str, Any] | None = None
    drive: dict[str, Any] | None = None

    def add(self, record: Record, time_s: float, truth_deg: tuple[float, float] | None, keep: bool) -> None:
        """Look at a tick; `truth_deg` is the true roll and pitch where someone knows them."""
        estimate = record.outputs.estimate
        attitude = (math.degrees(estimate.roll_rad), math.degrees(estimate.pitch_rad))
        self.ticks = record.tick + 1
        self.looks += 1
        if record.state is DaemonState.ARMED:
            self.armed_looks += 1
            if self.first_armed_s is None:
                self.first_armed_s = time_s
            self.level_looks += max(map(abs, truth_deg or attitude)) < LEVEL_BAND_DEG
        stopped = record.state in (DaemonState.FAULT, DaemonState.ESTOP)
        if stopped and (self.last is None or self.last.state is not record.state):
            self.stops.append(f"{time_s:.2f} s: {record.reason}")
        self.last, self.last_time_s = record, time_s
        if keep:
            self._keep(record, time_s, truth_deg, attitude)

    def _keep(
        self,
        record: Record,
        time_s: float,
        truth_deg: tuple[float, float] | None,
        attitude: tuple[float, float],
    ) -> None:
        roll_true, pitch_true = truth_deg or (None, None)
        known = record.outputs.estimate.ready
        strokes, where = record.inputs.strokes, record.outputs.estimate.odometry
        row = {
            "time_s": round(time_s, 6),
            "roll_true_deg": roll_true,
            "pitch_true_deg": pitch_true,
            "roll_est_deg": attitude[0] if known else None,
            "pitch_est_deg": attitude[1] if known else None,
            "stroke_mm": list(strokes.stroke_mm) if strokes else [None] * 4,
            "rate_cmd_mmps": list(record.outputs.stroke_rate_mmps),
            "x_m": where.x_m,
            "y_m": where.y_m,
            "yaw_deg": math.degrees(where.yaw_rad),
            "speed_mps": where.speed_mps,
            "slip_ratio": list(where.slip_ratio),
        }
        for name, value in row.items():
            self.series[name].append(value)

    def summary(self, lateness: Lateness | None) -> dict[str, Any]:
        """Figures of the whole run."""
        last = self.last
        return {
            "state": last.state.name if last else "NONE",
            "reason": last.reason if last else "",
            "duration_s": round(self.last_time_s, 3),
            "ticks": self.ticks,
            "first_armed_s": self.first_armed_s,
            "armed_share": self.armed_looks / self.looks if self.looks else 0.0,
            "level_share_of_armed": self.level_looks / self.armed_looks if self.armed_looks else 0.0,
            "stops": self.stops,
            "problems": [str(problem) for problem in last.problems] if last else [],
            "links": {
                link.name: {
                    "state": link.state,
                    "frames": link.rx_frames,
                    "refused": link.rejects,
                    "refused_by_board": link.board_rejects,
                    "lost": link.seq_gaps,
                }
                for link in (last.links if last else ())
            },
            "lateness_us": lateness.summary() if lateness else None,
            "drive": self.drive,
            "log": self.log,
        }

    def last_line(self, wished_armed: bool, lateness: Lateness | None) -> tuple[str, bool]:
        """How it went in one line, and whether it went well."""
        last = self.last
        if last is None:
            return "Nothing happened.", False
        late = f" Ticks were late by {_late(lateness)}." if lateness and lateness.ticks else ""
        if self.stops:
            return f"Stopped at {self.stops[0]}; ended {last.state.name}.{late}", not wished_armed
        if self.armed_looks:
            share = 100.0 * self.level_looks / self.armed_looks
            return (
                f"Armed from {self.first_armed_s:.1f} s; within {LEVEL_BAND_DEG:g} degrees of level for "
                f"{share:.1f} % of that time; no faults.{late}",
                True,
            )
        why = f" {last.problems[0]}" if last.problems else ""
        return f"Never armed: {last.state.name.lower()}, {last.reason}.{why}{late}", not wished_armed


def _late(lateness: Lateness) -> str:
    figures = lateness.summary()
    return f"{figures['p50_us'] / 1e3:.2f} ms (median), {figures['p99_us'] / 1e3:.2f} ms (99 %)"


def run(
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="robot.toml; what it leaves out keeps its default."),
    ] = None,
    emulate: Annotated[
        str | None,
        typer.Option(
            "--emulate",
            metavar="SCENARIO",
            autocompletion=scenario_names,
            help=f"Arm the emulated robot in a scenario: a .toml file, or {', '.join(scenario_names())}.",
        ),
    ] = None,
    arm: Annotated[
        bool, typer.Option("--arm", help="Arm the robot as soon as it is ready. It moves.")
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="SECONDS",
            min=0.1,
            help="How long; default: until interrupted, a scenario's own.",
        ),
    ] = None,
    virtual_time: Annotated[
        bool, typer.Option("--virtual-time", help="As fast as this computer can; needs --emulate.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write summary and series to this file, - to the screen."
        ),
    ] = None,
    speed: Annotated[float, typer.Option("--speed", metavar="M/S", help="Forward speed once armed.")] = 0.0,
    yaw_rate: Annotated[
        float, typer.Option("--yaw-rate", metavar="DEG/S", help="Yaw rate once armed, + turns left.")
    ] = 0.0,
    seed: Annotated[
        int, typer.Option("--seed", metavar="NUMBER", min=0, help="Of everything random in the emulation.")
    ] = 0,
    log: Annotated[
        Path | None,
        typer.Option("--log", metavar="FOLDER", help="Keep an MCAP log of everything in this folder."),
    ] = None,
) -> None:
    """Run the robot: find its devices, arm, level the body, drive the wheels."""
    from tiger.config.errors import ConfigError
    from tiger.config.robot import load_robot
    from tiger.logs.errors import LogError
    from tiger.models.eam import MechanismError

    if virtual_time and emulate is None:
        fail("--virtual-time needs --emulate SCENARIO: a real robot lives in real time")
    wishes = Wishes(
        arm or emulate is not None, speed, math.radians(yaw_rate), duration, log, json_file is not None
    )
    outcome: tuple[Journal, Lateness | None]
    try:
        robot = load_robot(config)
        _check(wishes, robot, json_file)
        to_screen = str(json_file) == "-"
        with contextlib.redirect_stdout(sys.stderr) if to_screen else contextlib.nullcontext():
            if emulate is None:
                outcome = _run_hardware(robot, wishes)
            elif virtual_time:
                outcome = _run_virtual(robot, emulate, seed, wishes)
            else:
                outcome = _run_emulated(robot, emulate, seed, wishes)
    except (ConfigError, LogError, MechanismError) as error:
        fail(str(error))
    journal, lateness = outcome
    if json_file is not None:
        report = {"summary": journal.summary(lateness), "series": journal.series}
        report["summary"] |= {"scenario": emulate, "seed": seed if emulate else None}
        write_json(json_file, report, indent=None)
    line, good = journal.last_line(wishes.arm, lateness)
    typer.echo(line, err=to_screen)
    if not good:
        raise typer.Exit(1)


def _check(wishes: Wishes, robot: RobotConfig, json_file: Path | None) -> None:
    """Refuse now what would only show at the end of the run, or not at all."""
    yaw_rate_degps = math.degrees(wishes.yaw_rate_radps)
    asked = (
        ("--speed", wishes.speed_mps, robot.drive.max_speed_mps, "m/s", "max_speed_mps"),
        ("--yaw-rate", yaw_rate_degps, robot.drive.max_yaw_rate_degps, "degrees/s", "max_yaw_rate_degps"),
    )
    for option, value, most, unit, key in asked:
        if not abs(value) <= most:  # nan is refused too
            fail(f"{option} {value:g}: is outside ±{most:g} {unit} ({key} under [drive]); ask for less")
    refuse_unwritable(json_file)


class _Driver:
    """Carries the user's wishes to the daemon, tick by tick."""

    def __init__(self, daemon: Daemon, wishes: Wishes) -> None:
        self.daemon = daemon
        self.wishes = wishes
        if wishes.arm:
            daemon.arm(ARM_PATIENCE_S)

    def after(self, record: Record) -> None:
        """Set the speed once the robot is armed, and take it back when it is not: arming needs neutral."""
        wishes = self.wishes
        if not (wishes.speed_mps or wishes.yaw_rate_radps):
            return
        armed = record.state is DaemonState.ARMED
        if armed != bool(self.daemon.command.speed_mps or self.daemon.command.yaw_rate_radps):
            command = Command(speed_mps=wishes.speed_mps, yaw_rate_radps=wishes.yaw_rate_radps)
            self.daemon.command = command if armed else Command()

    def press(self, keys: str) -> bool:
        """Obey keys; returns False when the user wants to quit."""
        actions = {
            "a": self.daemon.arm,
            "d": self.daemon.disarm,
            "c": self.daemon.clear,
            " ": self.daemon.estop,
        }
        for key in keys:
            if key in actions:
                actions[key]()
        return "q" not in keys


class _Log:
    """The log of a run, or nothing when none was asked for."""

    def __init__(self, folder: Path | None, robot: RobotConfig, clock: Clock) -> None:
        self._session: LogSession | None = None
        if folder is not None:
            from tiger.logs.session import LogSession

            self._session = LogSession(folder, robot, clock, about={"command": " ".join(sys.argv)})
        self._told: str | None = None

    def __enter__(self) -> _Log:
        if self._session is not None:
            self._session.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._session is None:
            return
        self._session.__exit__(*error)
        typer.echo(f"log: {self._session.path}")
        if self._session.trouble:
            typer.echo(self._session.trouble, err=True)

    def tap(self, ports: PortProvider) -> PortProvider:
        """The same ports, with all bytes logged."""
        return ports if self._session is None else self._session.tap(ports)

    def record(self, record: Record, daemon: Daemon) -> None:
        """Hand a tick over, never waiting, and tell whoever watches when the log is in trouble."""
        if self._session is None:
            return
        self._session.record(record, daemon.control_state)
        if self._session.trouble != self._told:
            self._told = self._session.trouble
            daemon.note(self._told or "log: goes on")
            if not sys.stdout.isatty():
                typer.echo(self._told)

    def summary(self) -> dict[str, Any] | None:
        """Figures for the run's summary; None when no log was asked for."""
        if self._session is None:
            return None
        return {
            "file": str(self._session.path),
            "dropped_packets": self._session.dropped_packets,
            "dropped_bytes": self._session.dropped_bytes,
            "problem": self._session.problem,
        }


def _overseer(robot: RobotConfig, daemon: Daemon) -> Callable[[Record], Overview]:
    """What makes the overview of a record for the screen."""
    from tiger.control.reachable import Suspension
    from tiger.daemon.overview import overview

    suspension = Suspension.from_config(robot)
    return lambda record: overview(record, daemon.energy, suspension)


def _drive_figures(daemon: Daemon) -> dict[str, Any] | None:
    """What the wheels' motors took, FL FR RL RR; None for a robot that only levels."""
    if not daemon.drives:
        return None
    energy = daemon.energy
    return {
        "energy_j": list(energy.energy_j),
        "largest_power_w": list(energy.largest_w),
        "largest_current_a": list(energy.largest_a),
        "lowest_battery_v": energy.lowest_v,
    }


class _Socket:
    """The socket for other programs, or nothing where it cannot be had: the robot runs without it."""

    def __init__(self, robot: RobotConfig, wishes: Wishes) -> None:
        from tiger.daemon.api import Api, ApiError

        self._api: Api | None = None
        self.trouble: list[str] = []
        try:
            self._api = Api(robot)
        except ApiError as error:
            self.trouble.append(f"no commands from other programs: {error}")
            return
        if wishes.speed_mps or wishes.yaw_rate_radps:
            self._api.desk.reserve("tiger run --speed")

    def poll(self, daemon: Daemon, record: Record, now_s: float) -> None:
        """Serve it after a tick; never waits."""
        if self._api is not None:
            self._api.poll(daemon, record, now_s)

    def close(self, daemon: Daemon) -> None:
        """Hang up on everyone."""
        if self._api is not None:
            self._api.close(daemon)


def _note(daemon: Daemon, *texts: str) -> None:
    """Say it where it can be read: on the screen's last lines, and on standard error."""
    for text in texts:
        daemon.note(f"note: {text}")
        typer.echo(f"note: {text}", err=True)


@contextlib.contextmanager
def _signals() -> Iterator[Callable[[], bool]]:
    """Ctrl-C, SIGTERM and a closed terminal end the run in order; yields what says whether one came."""
    asked: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda came, _: asked.append(came)) for number in numbers}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Printer:
    """For output that is no terminal: a line whenever something changes."""

    def __init__(self) -> None:
        self._before: tuple[Any, ...] = ()

    def show(self, record: Record, time_s: float) -> None:
        """Say what has changed."""
        now = (record.state, record.reason, record.problems)
        if now != self._before:
            self._before = now
            problems = "".join(f"\n  ! {problem}" for problem in record.problems)
            typer.echo(f"{time_s:8.2f} s  {record.state.name}: {record.reason}{problems}")


def _scenario(robot: RobotConfig, name: str, wishes: Wishes) -> Scenario:
    """Load a scenario; one that drives leaves nothing to drive for the command line."""
    from tiger.emulation.scenarios import load_scenario

    scenario = load_scenario(name, robot.drive)
    if (scenario.drive or scenario.waypoint) and (wishes.speed_mps or wishes.yaw_rate_radps):
        fail(f"{name} drives by its own plan; leave out --speed and --yaw-rate, or take another scenario")
    return scenario


def _run_virtual(robot: RobotConfig, scenario_name: str, seed: int, wishes: Wishes) -> tuple[Journal, None]:
    from contextlib import nullcontext

    from tiger.cli.live import FRAMES_PER_S, Screen, is_terminal
    from tiger.rig.virtual import Rig

    scenario = _scenario(robot, scenario_name, wishes)
    with starting("the emulated robot starts"):
        rig = Rig(robot, scenario, seed)
    log = _Log(wishes.log_folder, rig.config, rig.clock)
    if wishes.log_folder is not None:
        rig.connect(log.tap(rig.ports))
    journal, driver, printer = Journal(), _Driver(rig.daemon, wishes), _Printer()
    look = _overseer(robot, rig.daemon)
    every = max(round(robot.loop.rate_hz / JOURNAL_HZ), 1)
    duration_s = wishes.duration_s if wishes.duration_s is not None else scenario.duration_s
    drawn_s = -math.inf
    display = Screen(f"TIGER, emulated: {scenario.title}") if is_terminal() else nullcontext()
    with _signals() as stop_asked, log, display as screen:
        for tick, record in enumerate(rig.run(duration_s)):
            driver.after(record)
            log.record(record, rig.daemon)
            if tick % every == 0:
                truth = rig.robot.truth()
                truth_deg = truth.roll_deg, truth.pitch_deg
                journal.add(record, rig.time_s, truth_deg, wishes.keep_series)
            if screen is None:
                printer.show(record, rig.time_s)
            elif time.monotonic() - drawn_s > 1.0 / FRAMES_PER_S:
                drawn_s = time.monotonic()
                screen.show(record, look(record), rig.daemon.log_lines)
            if stop_asked():
                break
    rig.daemon.close()
    journal.log, journal.drive = log.summary(), _drive_figures(rig.daemon)
    return journal, None


def _run_emulated(
    robot: RobotConfig, scenario_name: str, seed: int, wishes: Wishes
) -> tuple[Journal, Lateness]:
    from tiger.rig.separate import SeparateRobot

    scenario = _scenario(robot, scenario_name, wishes)
    if wishes.duration_s is None:
        wishes.duration_s = scenario.duration_s
    with contextlib.ExitStack() as stack:
        with starting("the emulated robot starts"):
            emulated = stack.enter_context(SeparateRobot(robot.vehicle, scenario_name, seed))
        config = robot.model_copy(update={"ports": emulated.ports})
        title = f"TIGER, emulated: {scenario.title}"
        return _run_real_time(config, wishes, title, emulated.clock, emulated, scenario)


def _run_hardware(robot: RobotConfig, wishes: Wishes) -> tuple[Journal, Lateness]:
    from tiger.daemon.clock import MonotonicClock

    return _run_real_time(robot, wishes, "TIGER", MonotonicClock())


def _run_real_time(
    robot: RobotConfig,
    wishes: Wishes,
    title: str,
    clock: Clock,
    emulated: SeparateRobot | None = None,
    scenario: Scenario | None = None,
) -> tuple[Journal, Lateness]:
    """Run the loop in this thread.

    The time of an `emulated` robot begins with the loop, and `scenario` says how it drives.
    """
    from contextlib import nullcontext

    from tiger.cli.live import ScreenProcess, is_terminal
    from tiger.daemon import loop
    from tiger.daemon.daemon import Daemon
    from tiger.devices.ports import SerialPorts
    from tiger.rig.planned_drive import PlannedDrive

    loop.make_room(robot.loop)
    log = _Log(wishes.log_folder, robot, clock)
    daemon = Daemon(robot, log.tap(SerialPorts()), clock, nonce=int(clock.now_s() * 1e3) & 0xFFFF)
    driver, journal, printer = _Driver(daemon, wishes), Journal(), _Printer()
    planned = None
    if emulated is not None and scenario is not None:
        planned = PlannedDrive(scenario, daemon, emulated.pose)
    programs = _Socket(robot, wishes)
    _note(daemon, *programs.trouble)
    look = _overseer(robot, daemon)
    every = max(round(robot.loop.rate_hz / JOURNAL_HZ), 1)
    draw_every = max(round(robot.loop.rate_hz / 50.0), 1)
    display = ScreenProcess(title) if is_terminal() else nullcontext()
    with _signals() as stop_asked, log, display as screen:
        _note(daemon, *loop.prepare(robot.loop))
        start_s = clock.now_s()

        def on_record(record: Record) -> bool:
            driver.after(record)
            log.record(record, daemon)
            programs.poll(daemon, record, clock.now_s())
            if record.tick % every != 0:
                return not stop_asked()
            keep = wishes.keep_series
            if emulated is None:
                journal.add(record, clock.now_s() - start_s, None, keep)
            else:
                now = emulated.truth()
                if planned is not None:
                    planned.follow(now.time_s, record.outputs.estimate.odometry)
                journal.add(record, now.time_s, (now.roll_deg, now.pitch_deg), keep)
            if screen is None:
                printer.show(record, journal.last_time_s)
            elif record.tick % draw_every == 0:
                return driver.press(screen.exchange(record, look, daemon.log_lines)) and not stop_asked()
            return not stop_asked()

        if emulated is not None:
            emulated.begin()
        try:
            lateness = loop.run(daemon, clock, on_record, wishes.duration_s)
        finally:
            programs.close(daemon)
            daemon.close()
    sys.stdout.flush()
    journal.log, journal.drive = log.summary(), _drive_figures(daemon)
    return journal, lateness
