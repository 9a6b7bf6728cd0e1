"""The configuration of the robot: `robot.toml`, checked as a whole before anything moves.

The packaged `robot.toml` is the only place with default values; a user's file is laid over it table by table.
Every wrong key is reported at once, each with its value, its limit and the next step.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from tiger.config import toml
from tiger.config.errors import ConfigError
from tiger.config.vehicle import NonNegative, Positive, RateActuatorConfig, VehicleConfig, load_vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping

Factor = Annotated[float, Field(ge=0.5, le=3.0, allow_inf_nan=False, strict=True)]
DevicePath = Annotated[str, Field(pattern=r"^/", strict=True)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PortsConfig(_Section):
    """Where serial devices may be. Boards are told apart by HELLO; the Roboteqs by their path."""

    boards: Annotated[tuple[DevicePath, ...], Field(min_length=1)]
    roboteq_left: DevicePath
    roboteq_right: DevicePath

    @model_validator(mode="after")
    def _two_different_roboteqs(self) -> PortsConfig:
        if self.roboteq_left == self.roboteq_right:
            raise ValueError(f"roboteq_left and roboteq_right are both {self.roboteq_left}: name two ports")
        return self


class LoopConfig(_Section):
    """The control loop and what it asks of the operating system."""

    rate_hz: Annotated[float, Field(ge=50.0, le=500.0, strict=True)]
    setpoint_rate_hz: Annotated[float, Field(ge=50.0, le=200.0, strict=True)]
    drive_rate_hz: Annotated[float, Field(ge=20.0, le=100.0, strict=True)]
    realtime_priority: Annotated[int, Field(ge=0, le=99, strict=True)]
    lock_memory: Annotated[bool, Field(strict=True)]
    cpu: Annotated[int, Field(ge=-1, le=255, strict=True)]

    @property
    def period_s(self) -> float:
        """Time between two ticks."""
        return 1.0 / self.rate_hz

    @model_validator(mode="after")
    def _ticks_carry_the_setpoints(self) -> LoopConfig:
        for name in ("setpoint_rate_hz", "drive_rate_hz"):
            if self.rate_hz % getattr(self, name):
                rate = getattr(self, name)
                raise ValueError(
                    f"rate_hz = {self.rate_hz} is no multiple of {name} = {rate}: choose a divisor"
                )
        return self


class LogConfig(_Section):
    """How much room the logs of `tiger run --log` take; above it the oldest files are deleted."""

    part_mb: Annotated[float, Field(ge=0.1, le=4000.0, strict=True)]
    total_mb: Positive
    free_mb: NonNegative

    @model_validator(mode="after")
    def _holds_more_than_one_part(self) -> LogConfig:
        if self.total_mb < 2.0 * self.part_mb:
            raise ValueError(
                f"total_mb = {self.total_mb:g} does not hold two files of part_mb = {self.part_mb:g}: "
                "raise it, or make the files smaller"
            )
        return self


class ObserverConfig(_Section):
    """Noise of the IMU and restlessness of the ground, as the attitude observer assumes them."""

    imu_rate_hz: Annotated[float, Field(ge=20.0, le=500.0, strict=True)]
    attitude_noise_deg: Positive
    rate_noise_degps: Positive
    acceleration_noise_mps2: Positive
    plate_acceleration_degps2: Positive
    ground_noise_mm: Positive
    gyro_bias_drift_degps: Positive
    history_ms: Annotated[float, Field(ge=10.0, le=500.0, strict=True)]
    tilt_sigma_deg: Positive
    tilt_follow_s: Positive
    tilt_forget_s: Positive
    tilt_rate_degps: Positive


class LevelingConfig(_Section):
    """Suspension modes: dead zone, gains and limits."""

    dead_zone_deg: Positive
    wake_deg: Positive
    patience_degs: Positive
    settle_deg: Positive
    still_degps: Positive
    still_time_s: Positive
    ride_wake_mm: Positive
    ride_settle_mm: Positive
    angle_weight_deg: Positive
    rate_weight_degps: Positive
    setpoint_delay_s: Annotated[float, Field(ge=0.0, le=0.1, strict=True)]
    acceleration_mmps2: Annotated[float, Field(ge=20.0, le=2000.0, strict=True)]
    stroke_margin_mm: Positive
    stroke_brake_per_s: Annotated[float, Field(gt=0.0, le=20.0, strict=True)]
    warp_rate_per_s: Annotated[float, Field(gt=0.0, le=10.0, strict=True)]
    heat_slow: Annotated[float, Field(gt=0.0, lt=1.0, strict=True)]
    heat_stop: Annotated[float, Field(gt=0.0, le=1.0, strict=True)]
    ride_stroke_mm: Positive
    max_angle_deg: Annotated[float, Field(gt=0.0, le=45.0, strict=True)]
    out_of_reach: Literal["clip", "refuse"]
    rolling_mps: Positive
    ahead_step_m: Positive
    ahead_memory_m: Positive
    ahead_smooth_m: Positive
    ahead_noise: Annotated[tuple[Positive, ...], Field(min_length=1)]
    ahead_waves_m: Annotated[tuple[NonNegative, ...], Field(min_length=1)]
    ahead_trial_m: Positive
    ahead_learn_m: Positive
    ahead_fade_deg: Positive

    @model_validator(mode="after")
    def _remembers_what_it_tries(self) -> LevelingConfig:
        if self.ahead_trial_m >= self.ahead_memory_m:
            raise ValueError(
                f"ahead_trial_m = {self.ahead_trial_m} must be below ahead_memory_m = {self.ahead_memory_m}: "
                "lower it"
            )
        return self

    @model_validator(mode="after")
    def _hysteresis(self) -> LevelingConfig:
        if not self.settle_deg < self.dead_zone_deg <= self.wake_deg:
            raise ValueError(
                f"settle_deg = {self.settle_deg}, dead_zone_deg = {self.dead_zone_deg} and wake_deg = "
                f"{self.wake_deg} must rise in this order, or the robot hunts: correct them"
            )
        if self.heat_slow >= self.heat_stop:
            raise ValueError(
                f"heat_slow = {self.heat_slow} must be below heat_stop = {self.heat_stop}: lower it"
            )
        if self.ride_settle_mm >= self.ride_wake_mm:
            raise ValueError(
                f"ride_settle_mm = {self.ride_settle_mm} must be below "
                f"ride_wake_mm = {self.ride_wake_mm}: lower it"
            )
        return self


class DriveControlConfig(_Section):
    """From forward speed and yaw rate to wheel speeds."""

    enabled: Annotated[bool, Field(strict=True)]
    max_speed_mps: Positive
    max_yaw_rate_degps: Positive
    acceleration_mps2: Positive
    jerk_mps3: Positive
    yaw_acceleration_degps2: Positive
    effective_track_factor: Factor
    wheel_radius_factor: Factor
    yaw_rate_gain_per_s: NonNegative
    yaw_rate_trim_max_degps: NonNegative
    speed_source: Literal["roboteq", "mega_speed"]
    roboteq_speed_query: Literal["S", "BS"]
    wheel_speed_gain_per_s: NonNegative
    wheel_trim_max_rpm: NonNegative


class TractionConfig(_Section):
    """Forces over the four tyres, carried out as trims of the wheel speeds."""

    mode: Literal["off", "on", "log"]
    share: Literal["load", "equal"]
    friction: Positive
    friction_gain_per_s: NonNegative
    trust_per_s: NonNegative
    min_load_n: Positive
    torque_share_max: Annotated[float, Field(gt=0.0, le=1.0, strict=True)]
    battery_power_w: Positive
    slip_max: Positive
    slip_margin_mps: Positive
    torque_gain_rpm_per_nms: NonNegative
    slip_gain_per_s: NonNegative
    forget_per_s: NonNegative
    speed_keeping_per_s: NonNegative
    release_per_s: Positive
    trim_max_rpm: NonNegative


class StabilityConfig(_Section):
    """Warning of and protection from tipping over."""

    limiter: Literal["off", "on", "log"]
    load_transfer_max: Annotated[float, Field(gt=0.0, lt=1.0, strict=True)]
    friction_max: Positive
    brake_min_mps2: Positive
    crawl_mps: Positive
    foresight_s: Positive
    trend_m: Positive
    trend_along_m: Positive
    load_sigma_kg: Positive
    load_sigma_m: Positive
    smooth_s: Positive
    late_s: NonNegative
    upright_s: Positive
    slope_s: Positive
    slope_along_s: Positive
    warning_margin: Annotated[float, Field(gt=0.0, lt=1.0, strict=True)]
    warning_time_s: Positive
    warning_hold_s: Positive
    trip_mean_s: Positive
    trip_blow_s: Positive
    trip_blow_mps: Positive
    trip_hold_s: Positive


class ContactConfig(_Section):
    """What `estimation.contact` and `ground_track` expect of ground and measurements."""

    period_s: Annotated[float, Field(ge=0.05, le=0.5, strict=True)]
    idle_period_s: Annotated[float, Field(ge=0.05, le=1.0, strict=True)]
    expected_twist_mm: Positive
    false_alarm_s: Positive
    attitude_noise_deg: Positive
    slope_drift_deg: Positive
    slope_per_metre_deg: Positive
    grip_max: Positive
    push_noise_mm: Positive
    fade_m: Positive
    track_length_m: Positive
    track_bend_m: Positive
    track_noise_mm: Positive
    track_attitude_noise_deg: Positive
    track_sigma_mm: Positive
    track_fade_deg: Positive


class BalanceConfig(_Section):
    """Mode `balance`."""

    probe_mm: Positive
    probe_mmps: Positive
    settle_mm: Positive
    wake_mm: Positive
    sure: Annotated[float, Field(gt=0.5, lt=1.0, strict=True)]

    @model_validator(mode="after")
    def _hysteresis(self) -> BalanceConfig:
        if self.settle_mm >= self.wake_mm:
            raise ValueError(
                f"settle_mm = {self.settle_mm} must be below wake_mm = {self.wake_mm}, or the robot hunts: "
                "lower it"
            )
        return self


class OdometryConfig(_Section):
    """Noise of IMU, wheels and magnetometer as dead reckoning assumes it, and when a wheel slips."""

    gyro_scale_factor: Annotated[float, Field(ge=0.9, le=1.1, strict=True)]
    place_walk_m: Positive
    angle_walk_deg: Positive
    speed_walk_mps: Positive
    gyro_bias_walk_degps: Positive
    accel_bias_walk_mps2: Positive
    field_walk_ut: Positive
    start_speed_mps: Positive
    start_tilt_deg: Positive
    start_gyro_bias_degps: Positive
    start_accel_bias_mps2: Positive
    start_field_ut: Positive
    start_iron_ut: Positive
    wheel_scale_sigma: Positive
    wheel_sigma_mps: Positive
    missing_wheel_factor: Factor
    wheel_noise_mps: Positive
    wheel_noise_ratio: Positive
    gate_sigmas: Positive
    regain_sigmas: Positive
    coasting_sigmas: Positive
    agree_sigmas: Positive
    agree_s: Positive
    longest_slip_s: Positive
    longest_tooth_s: Positive
    memory: Positive
    push_time_s: Annotated[float, Field(ge=0.02, strict=True)]
    scrub_start: Factor
    scrub_most: Factor
    scrub_noise: Positive
    scrub_speed_m: Positive
    scrub_least_radps: Positive
    scrub_learning_per_rad: Annotated[float, Field(ge=0.0, le=2.0, strict=True)]
    slide_sigma_mps: Positive
    slide_m: Positive
    stand_s: Positive
    stand_wheel_radps: Positive
    stand_speed_mps: Positive
    stand_yaw_rate_degps: Positive
    stand_noise_mps: Positive
    stand_gyro_degps: Positive
    stand_gate_sigmas: Positive
    stand_turning_s: Positive
    mag_noise_ut: Positive
    mag_lag_s: NonNegative
    mag_gate_sigmas: Positive
    mag_lasting_ut: Positive
    mag_lasting_s: Positive
    mag_longest_doubt_s: Positive
    mag_up_noise_ut: Positive
    mag_up_learning: Annotated[float, Field(ge=0.0, le=1.0, strict=True)]
    least_speed_mps: Positive
    event_ratio: Positive
    event_over_ratio: Positive
    event_speed_mps: Positive
    event_sigmas: Positive
    event_s: NonNegative
    event_over_s: NonNegative

    @model_validator(mode="after")
    def _events_have_a_hysteresis(self) -> OdometryConfig:
        if self.event_over_ratio >= self.event_ratio:
            raise ValueError(
                f"event_over_ratio = {self.event_over_ratio} must be below "
                f"event_ratio = {self.event_ratio}: lower it"
            )
        return self


class LoadsConfig(_Section):
    """What `estimation.payload` and `wheel_loads` expect of load, ground and measurements."""

    payload_kg: Positive
    payload_place_m: Positive
    payload_height_m: NonNegative
    payload_height_spread_m: Positive
    slope_deg: Positive
    slope_drift_deg: Positive
    slope_length_m: Positive
    attitude_noise_deg: Positive
    force_noise_mps2: Positive
    rolling_spread: Positive
    soft_resistance: Positive
    moving_mps: Positive
    turning_degps: Positive
    changed_sigmas: Annotated[float, Field(ge=3.0, le=20.0, strict=True)]
    load_noise_n: Positive


class RoughnessConfig(_Section):
    """The road's class from the vertical acceleration (`estimation.roughness`)."""

    band_hz: tuple[Positive, Positive]
    memory_m: Positive
    distance_m: Positive
    min_speed_mps: Positive
    noise_mps2: NonNegative
    flight_from: Positive
    flight_gain: NonNegative

    @model_validator(mode="after")
    def _band(self) -> RoughnessConfig:
        if self.band_hz[0] >= self.band_hz[1]:
            raise ValueError(f"band_hz = {self.band_hz} is empty: give a lower and a higher frequency")
        return self


class SafetyConfig(_Section):
    """Limits that the supervisor watches; what each does is a row of its table."""

    max_tilt_deg: Annotated[float, Field(gt=0.0, le=60.0, strict=True)]
    max_wheel_speed_rpm: Positive
    max_motor_current_a: Positive
    max_sustained_current_a: Positive
    sustained_current_s: Positive
    max_controller_temperature_celsius: Positive
    battery_low_v: Positive
    battery_min_v: Positive
    imu_age_ms: Annotated[float, Field(ge=20.0, le=500.0, strict=True)]
    stroke_age_ms: Annotated[float, Field(ge=20.0, le=500.0, strict=True)]
    wheel_age_ms: Annotated[float, Field(ge=20.0, le=500.0, strict=True)]
    roboteq_age_ms: Annotated[float, Field(ge=40.0, le=500.0, strict=True)]
    roboteq_watchdog_ms: Annotated[int, Field(ge=50, le=250, strict=True)]
    roboteq_read_back: Annotated[bool, Field(strict=True)]
    max_rest_gyro_bias_degps: Positive
    max_rest_accel_offset_mps2: Positive
    max_neutral_speed_mps: NonNegative

    @model_validator(mode="after")
    def _warn_before_stopping(self) -> SafetyConfig:
        if self.battery_low_v <= self.battery_min_v:
            raise ValueError(
                f"battery_low_v = {self.battery_low_v} must be above "
                f"battery_min_v = {self.battery_min_v}: raise it"
            )
        return self


class RobotConfig(_Section):
    """Everything that the daemon needs to know about one robot."""

    vehicle: VehicleConfig
    ports: PortsConfig
    loop: LoopConfig
    log: LogConfig
    observer: ObserverConfig
    leveling: LevelingConfig
    contact: ContactConfig
    balance: BalanceConfig
    loads: LoadsConfig
    roughness: RoughnessConfig
    drive: DriveControlConfig
    odometry: OdometryConfig
    traction: TractionConfig
    stability: StabilityConfig
    safety: SafetyConfig

    @property
    def actuator(self) -> RateActuatorConfig:
        """The vehicle's actuator; a `RobotConfig` always has one that follows stroke rates."""
        actuator = self.vehicle.actuator
        assert isinstance(actuator, RateActuatorConfig)
        return actuator

    def with_motor_current(self, limit_a: float) -> RobotConfig:
        """The same robot, stopped when a wheel's motor takes more than this, for a moment or for long."""
        limits = {"max_motor_current_a": limit_a, "max_sustained_current_a": limit_a}
        return self.model_copy(update={"safety": self.safety.model_copy(update=limits)})

    @property
    def stroke_range_mm(self) -> tuple[float, float]:
        """Lowest and highest stroke that the controller uses."""
        margin = self.leveling.stroke_margin_mm
        return margin, self.actuator.stroke_max_mm - margin

    @model_validator(mode="after")
    def _fits_the_vehicle(self) -> RobotConfig:
        wrong = []
        if not isinstance(self.vehicle.actuator, RateActuatorConfig) or self.vehicle.eam is None:
            raise ValueError(
                'the vehicle has no stroke-rate actuators with an [eam]; use vehicle = "tiger" or add them'
            )
        low, high = self.stroke_range_mm
        ride = self.leveling.ride_stroke_mm
        if low >= high:
            wrong.append(f"leveling.stroke_margin_mm = {low} leaves no stroke of {low + high} mm: lower it")
        elif not low <= ride <= high:
            wrong.append(f"leveling.ride_stroke_mm = {ride} is outside {low} to {high} mm: move it inside")
        if self.drive.enabled and self.vehicle.drive is None:
            wrong.append("drive.enabled = true, but the vehicle has no [drive]: set it to false")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


def default_robot_toml() -> str:
    """Text of the packaged `robot.toml`, with its comments: what a user copies from."""
    return (resources.files("tiger.config") / "robot.toml").read_text(encoding="utf-8")


def load_robot(path: str | Path | None = None) -> RobotConfig:
    """Load the default configuration, with the user's file laid over it.

    A vehicle file named in it is relative to it. Raises ConfigError with one line for each wrong key.
    """
    tables = toml.parsed(default_robot_toml(), "robot.toml")
    source, folder = "robot.toml", Path()
    if path is not None:
        source, folder = str(path), Path(path).parent
        tables = _laid_over(tables, toml.read(path))
    wrong: list[str] = []
    try:
        tables["vehicle"] = _vehicle(tables["vehicle"], source, folder)
    except ConfigError as error:
        wrong += error.messages
        tables["vehicle"] = load_vehicle("tiger")  # so that the other keys are checked as well
    try:
        robot = RobotConfig.model_validate(tables)
    except ValidationError as error:
        wrong += ConfigError.from_validation(error, source).messages
    if wrong:
        raise ConfigError(wrong)
    return robot


def _laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two trees of tables; a value above hides the one below. A vehicle is replaced as a whole."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = (
            _laid_over(under, value) if isinstance(value, dict) and isinstance(under, dict) else value
        )
    return merged


def _vehicle(value: Any, source: str, folder: Path) -> VehicleConfig:
    if isinstance(value, dict):
        try:
            return VehicleConfig.model_validate(value)
        except ValidationError as error:
            raise ConfigError.from_validation(error, f"{source} [vehicle]") from error
    if not isinstance(value, str):
        raise ConfigError(
            f"{source}: vehicle = {value!r} is neither a name nor a table; name a preset or a file"
        )
    if value.endswith(".toml") or "/" in value:
        return load_vehicle(folder / value)
    return load_vehicle(value)
