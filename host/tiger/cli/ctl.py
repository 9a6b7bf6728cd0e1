"""`tiger ctl`: one request to the running daemon, and what came of it."""

from __future__ import annotations

import json
import math
import re
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tiger.cli.answers import fail
from tiger.daemon.client import Refused, Robot
from tiger.record import Mode

if TYPE_CHECKING:
    from collections.abc import Iterator

REPEAT_S = 0.1  # a drive command lives for half a second
ARMING_TIME_S = 5.0
CHANGE_TIME_S = 1.5
LIMIT = re.compile(r"(\w+)_rad(ps)? = (\S+) is outside (\S+) to (\S+)")  # of an angle, in a refusal

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="Ask the running daemon for something: arm, mode, pose, drive.",
)

Json = Annotated[bool, typer.Option("--json", help="Print the daemon's answer as JSON.")]


@contextmanager
def connected() -> Iterator[Robot]:
    """A connection to the daemon; what goes wrong ends the program with one line, status 1 when refused."""
    try:
        with Robot() as robot:
            yield robot
    except Refused as refusal:
        typer.echo(f"refused: {in_degrees(str(refusal))}", err=True)
        raise typer.Exit(1) from None
    except (FileNotFoundError, ConnectionRefusedError):
        from tiger.daemon.client import socket_path

        fail(f"no daemon listens on {socket_path()}; start it: tiger run")
    except PermissionError:
        from tiger.daemon.client import socket_path

        fail(f"{socket_path()} belongs to another user; run this as the user of the daemon")
    except TimeoutError:
        fail("the daemon does not answer; look at its terminal, or: systemctl status tiger")
    except OSError as error:
        fail(f"the connection to the daemon broke ({error}); is it still running?")


def in_degrees(refusal: str) -> str:
    """The daemon's words about a limit with angles as a person gave them, and without the API's suffixes."""

    def told(found: re.Match[str]) -> str:
        name, rate, value, low, high = found.groups()
        asked, least, most = (f"{math.degrees(float(number)):.4g}" for number in (value, low, high))
        return f"{name} = {asked} is outside {least} to {most} degrees{'/s' if rate else ''}"

    return LIMIT.sub(told, refusal)


def _say(answer: dict[str, Any], as_json: bool) -> None:
    typer.echo(json.dumps(answer) if as_json else answer["text"])


def _ask(do: str, as_json: bool, **fields: Any) -> None:
    with connected() as robot:
        _say(robot.ask(do, **fields), as_json)


def _arrive(do: str, states: tuple[str, ...], seconds: float, as_json: bool) -> None:
    """Ask for a change of state and wait for it, or for the reason why it does not come."""
    with connected() as robot:
        robot.ask(do)
        robot.ask("release")  # from here on it only looks
        end_s = time.monotonic() + seconds
        while True:
            time.sleep(REPEAT_S)  # the daemon gathers its problems twenty times a second
            status = robot.ask("status")["status"]
            arrived = status["state"] in states
            refused = do == "arm" and any(p["where"] == "not armed" for p in status["record"]["problems"])
            if arrived or refused or time.monotonic() > end_s:
                break
        typer.echo(json.dumps(status) if as_json else "\n".join(_lines(status)))
        if not arrived:
            raise typer.Exit(1)


@app.command()
def arm(as_json: Json = False) -> None:
    """Arm the robot and wait until it is armed; it may move."""
    _arrive("arm", ("ARMED",), ARMING_TIME_S, as_json)


@app.command()
def disarm(as_json: Json = False) -> None:
    """Stop and disarm."""
    _arrive("disarm", ("DISARMED", "HANDSHAKE", "DISCONNECTED", "FAULT", "ESTOP"), CHANGE_TIME_S, as_json)


@app.command()
def estop(as_json: Json = False) -> None:
    """Emergency stop: everything off, until it is cleared."""
    _ask("estop", as_json)


@app.command()
def clear(as_json: Json = False) -> None:
    """Clear what stopped it and is gone; arms nothing."""
    _arrive("clear", ("DISARMED", "ARMED"), CHANGE_TIME_S, as_json)


@app.command()
def mode(
    name: Annotated[
        str, typer.Argument(metavar="MODE", autocompletion=lambda: [*Mode], help=f"{', '.join(Mode)}.")
    ],
    as_json: Json = False,
) -> None:
    """Change what the suspension does."""
    if name not in [*Mode]:
        fail(f"{name}: is no mode; choose one of {', '.join(Mode)}")
    _ask("mode", as_json, mode=name)


@app.command()
def pose(
    roll: Annotated[float, typer.Option(metavar="DEGREES", help="+ = left side up.")] = 0.0,
    pitch: Annotated[float, typer.Option(metavar="DEGREES", help="+ = nose down.")] = 0.0,
    height: Annotated[
        float | None, typer.Option(metavar="MM", help="Mean stroke of the actuators; default: as it is.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Take a pose relative to the wheels."""
    angles = {"roll_rad": math.radians(roll), "pitch_rad": math.radians(pitch)}
    _ask("pose", as_json, **angles, ride_stroke_mm=height)


@app.command()
def height(
    stroke: Annotated[
        float | None, typer.Argument(metavar="[MM]", help="Mean stroke; without: the one of the config.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Change the ride height, whatever the mode."""
    _ask("ride_height", as_json, ride_stroke_mm=stroke)


@app.command()
def drive(
    speed: Annotated[float, typer.Option(metavar="M/S", help="+ = forward.")] = 0.0,
    yaw_rate: Annotated[float, typer.Option(metavar="DEG/S", help="+ = turns left.")] = 0.0,
    seconds: Annotated[
        float, typer.Option("--for", metavar="SECONDS", min=0.0, max=3600.0, help="How long.")
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Drive for a while, then stop.

    Ctrl-C stops at once, and so does the end of this program.
    """
    with connected() as robot:
        end_s = time.monotonic() + seconds
        try:
            while True:
                answer = robot.ask("drive", speed_mps=speed, yaw_rate_radps=math.radians(yaw_rate))
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    break
                time.sleep(min(REPEAT_S, left_s))
        finally:
            answer = robot.ask("release")
        answer["text"] = f"drove for {seconds:g} s; it slows down and stands still"
        _say(answer, as_json)


@app.command()
def status(as_json: Json = False) -> None:
    """Say how the robot is, and what can be asked of it."""
    with connected() as robot:
        answer = robot.ask("status")
        if as_json:
            typer.echo(json.dumps(answer))
            return
        lines = [*_lines(answer["status"]), _possible(answer["limits"])]
        typer.echo("\n".join(lines))


def _possible(limits: dict[str, list[float]]) -> str:
    """What can be asked for."""
    most = {name: high for name, (_, high) in limits.items()}
    degrees = {name: math.degrees(high) for name, high in most.items()}
    low_mm, high_mm = limits["ride_stroke_mm"]
    return (
        f"at most {most['speed_mps']:g} m/s, {degrees['yaw_rate_radps']:.0f} degrees/s; within the strokes: "
        f"roll ±{degrees['reachable_roll_rad']:.1f}°, pitch ±{degrees['reachable_pitch_rad']:.1f}°, "
        f"ride height {low_mm:g} to {high_mm:g} mm"
    )


def _lines(status: dict[str, Any]) -> list[str]:
    """How the robot is, for people."""
    record = status["record"]
    inputs, estimate = record["inputs"], record["outputs"]["estimate"]
    strokes = inputs["strokes"]
    lines = [f"{status['state']}: {status['reason']}; mode {inputs['command']['mode']}"]
    if estimate["ready"]:
        roll, pitch = math.degrees(estimate["roll_rad"]), math.degrees(estimate["pitch_rad"])
        lines.append(f"roll {roll:+.2f}°, pitch {pitch:+.2f}°")
    if strokes is not None:
        lines.append("strokes " + " ".join(f"{mm:.1f}" for mm in strokes["stroke_mm"]) + " mm (FL FR RL RR)")
    sides = inputs["wheels_left"], inputs["wheels_right"]
    if None not in sides:
        left, right = (side["speed_radps"] for side in sides)
        radps = (left[0], right[0], left[1], right[1])
        lines.append("wheels " + " ".join(f"{w * 30.0 / math.pi:+.1f}" for w in radps) + " rpm (FL FR RL RR)")
    seen = status["overview"]
    if None not in (inputs["drive_left"], inputs["drive_right"]):
        volts = min(inputs[side]["battery_v"] for side in ("drive_left", "drive_right"))
        watts, taken_wh = sum(seen["electric_w"]), sum(seen["energy_j"]) / 3600.0
        lines.append(f"battery {volts:.1f} V, {watts:.0f} W, {taken_wh:.2f} Wh taken")
    if seen["reach_used"] is not None:
        lines.append(f"{100.0 * seen['reach_used']:.0f} % of what the strokes reach is used")
    if status["helm"] is not None:
        lines.append(f"{status['helm']} has the helm")
    lines += [f"! {p['where']}: {p['text']}. {p['next_step']}" for p in record["problems"]]
    return lines
