"""What programs and the daemon say to each other over the local socket: one JSON object a line, each a model.

docs/api.md is made from these models. Names and units are those of `record.py`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from tiger.daemon.overview import Overview
from tiger.record import Mode, Record

MAX_TELEMETRY_HZ = 20.0

Id = Annotated[int, Field(ge=0, le=2**53)] | Annotated[str, Field(max_length=64)]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    id: Id


class ArmRequest(_Request):
    """Arm as soon as everything is ready; `status` tells when, or why not. The robot may move."""

    do: Literal["arm"]


class DisarmRequest(_Request):
    """Stop and disarm. Anyone may."""

    do: Literal["disarm"]


class EstopRequest(_Request):
    """Emergency stop: everything off, latched. Anyone may."""

    do: Literal["estop"]


class ClearRequest(_Request):
    """Clear latched faults and emergency stops whose cause is gone; arms nothing."""

    do: Literal["clear"]


class ModeRequest(_Request):
    """Change what the suspension does, with roll and pitch zero."""

    do: Literal["mode"]
    mode: Mode


class PoseRequest(_Request):
    """Mode `pose`: roll (+ = left side up) and pitch (+ = nose down) against the wheels."""

    do: Literal["pose"]
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    ride_stroke_mm: Annotated[float | None, Field(description="mean stroke; null: as it is")] = None


class RideHeightRequest(_Request):
    """Change the ride height, whatever the mode."""

    do: Literal["ride_height"]
    ride_stroke_mm: float | None = Field(description="mean stroke; null: the one of the config")


class DriveRequest(_Request):
    """Drive for half a second: repeat it to go on. Needs an armed robot."""

    do: Literal["drive"]
    speed_mps: float = Field(description="+ forward")
    yaw_rate_radps: Annotated[float, Field(description="+ turns left")] = 0.0


class StatusRequest(_Request):
    """Ask for everything that is known now, and for the limits. Anyone may."""

    do: Literal["status"]


class SubscribeRequest(_Request):
    """Receive telemetry from now on; rate 0 ends it. Anyone may."""

    do: Literal["subscribe"]
    rate_hz: Annotated[float, Field(ge=0.0, le=MAX_TELEMETRY_HZ)] = 10.0


class ReleaseRequest(_Request):
    """Stop driving and give the helm to whoever asks next."""

    do: Literal["release"]


Request = (
    ArmRequest
    | DisarmRequest
    | EstopRequest
    | ClearRequest
    | ModeRequest
    | PoseRequest
    | RideHeightRequest
    | DriveRequest
    | StatusRequest
    | SubscribeRequest
    | ReleaseRequest
)
REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])
REQUEST_ID: TypeAdapter[int | str] = TypeAdapter(Id, config=ConfigDict(strict=True))


class Status(BaseModel):
    """The robot now."""

    state: str = Field(description="DISCONNECTED, HANDSHAKE, DISARMED, ARMED, FAULT or ESTOP")
    reason: str = Field(description="why it is in this state")
    helm: str | None = Field(description="who may move the robot; null: whoever asks first")
    log_lines: list[str] = Field(description="what boards and clients did lately")
    record: Record = Field(description="the latest tick: what was measured, estimated and commanded")
    overview: Overview = Field(
        description="power and energy of the drive, and how far the strokes still reach"
    )


class Accepted(BaseModel):
    """The request is carried out."""

    id: int | str
    ok: Literal[True] = True
    text: str = Field(description="what happens now")


class StatusReply(Accepted):
    """Answer to `status`."""

    status: Status
    limits: dict[str, tuple[float, float]] = Field(description="lowest and highest value of each field")


class Refusal(BaseModel):
    """Nothing was done."""

    id: Annotated[int | str | None, Field(description="null when the request's own could not be read")] = None
    ok: Literal[False] = False
    reason: str
    next_step: str
    closing: Annotated[bool, Field(description="the daemon hangs up after this line")] = False


class Telemetry(BaseModel):
    """What a subscriber receives."""

    dropped: int = Field(description="telemetry so far left out because you did not read fast enough")
    telemetry: Status


Reply = Accepted | StatusReply | Refusal
