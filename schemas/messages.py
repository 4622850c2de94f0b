"""The typed messages, one class per subject.

Every message is a MessagePack map whose keys are the field names below. Physical fields have their unit in the
name (``speed_mps``); others are counts, flags or names. Axes are those of ISO 8855: x forward, y left, yaw
positive from x to y, so left is positive.

The fields of chassis messages are the signals of the DBC: CamelCase becomes snake_case, the unit a suffix, one bit
a bool, a value table an enumeration. A test compares the two.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

_INT64_MAX = 2**63 - 1

SEQUENCE_MAX = 2**32 - 1  # the last sequence number; 0 follows
BUS_MAX_LENGTH = 64  # characters of a CAN bus's name, which a log repeats with every frame
UNIT_KEYWORD = "unit"  # the JSON Schema keyword of a field's unit


def unit_keyword(unit: str) -> dict[str, str]:
    """The annotation of a unit, for ``Meta(extra_json_schema=...)``."""
    return {UNIT_KEYWORD: unit}


TimeNs = Annotated[
    int,
    Meta(
        ge=0,
        le=_INT64_MAX,
        description="Nanoseconds since 1970-01-01 UTC.",
        extra_json_schema=unit_keyword("ns"),
    ),
]
Count = Annotated[int, Meta(ge=0, le=_INT64_MAX)]
Sequence = Annotated[
    int, Meta(ge=0, le=SEQUENCE_MAX, description="+1 for each message of this key; a gap means lost messages.")
]
AliveCounter = Annotated[int, Meta(ge=0, le=15, description="The frame's 4-bit alive counter; 15 wraps to 0.")]
Pulses = Annotated[int, Meta(ge=-32768, le=32767, description="Signed 16-bit encoder count that wraps.")]
SpeedMps = Annotated[float, Meta(extra_json_schema=unit_keyword("m/s"))]
AngleDeg = Annotated[float, Meta(description="Left is positive.", extra_json_schema=unit_keyword("deg"))]
YawRateRadps = Annotated[float, Meta(description="Left is positive.", extra_json_schema=unit_keyword("rad/s"))]
HeadingRad = Annotated[
    float, Meta(description="From -pi to pi, left is positive.", extra_json_schema=unit_keyword("rad"))
]
PlaceM = Annotated[float, Meta(extra_json_schema=unit_keyword("m"))]
VarianceM2 = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("m2"))]
VarianceRad2 = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("rad2"))]
VarianceM2ps2 = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("m2/s2"))]
VarianceRad2ps2 = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("rad2/s2"))]
MileageKm = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("km"))]
DistanceM = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("m"))]
DurationS = Annotated[float, Meta(extra_json_schema=unit_keyword("s"))]
DurationMs = Annotated[float, Meta(extra_json_schema=unit_keyword("ms"))]
RateHz = Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("Hz"))]
CanIdentifier = Annotated[int, Meta(ge=0, le=2**29 - 1, description="11-bit or 29-bit CAN identifier.")]
CanWord = Annotated[
    int,
    Meta(
        ge=0,
        le=2**32 - 1,
        description="Identifier and flags as in linux/can.h: bit 31 extended, bit 30 remote, bit 29 error.",
    ),
]


class GearPosition(Enum):
    """Gear. ``undefined``: no value yet, or one that is not in the manual."""

    UNDEFINED = "undefined"
    PARK = "park"
    REVERSE = "reverse"
    NEUTRAL = "neutral"
    DRIVE = "drive"


class BrakingStatus(Enum):
    """Service brake. ``undefined``: no value yet, or one that is not in the manual."""

    UNDEFINED = "undefined"
    RELEASED = "released"
    BRAKING = "braking"
    FULLY_BRAKED = "fully_braked"


class ParkingStatus(Enum):
    """Parking brake. ``undefined``: no value yet, or one that is not in the manual."""

    UNDEFINED = "undefined"
    APPLIED = "applied"
    RELEASED = "released"


class Mode(Enum):
    """The source of the chassis's commands. ``undefined``: no value yet, or one that is not in the manual."""

    UNDEFINED = "undefined"
    AUTO = "auto"
    REMOTE = "remote"
    STOP = "stop"


class Variant(Enum):
    """The chassis's firmware variant, which decides the scale of speeds. ``unknown``: no evidence yet."""

    UNKNOWN = "unknown"
    COARSE = "coarse"
    FINE = "fine"


class ControllerState(Enum):
    """A CAN controller's error state (ISO 11898-1), by its error frames; ``unknown``: none were received."""

    UNKNOWN = "unknown"
    ACTIVE = "active"
    WARNING = "warning"
    PASSIVE = "passive"
    BUS_OFF = "bus_off"


class Message(msgspec.Struct, frozen=True, gc=False):
    """The fields that every message begins with.

    Attributes:
        time_ns: when the sender learned the content: for a CAN frame, when the bus delivered it.
    """

    version: ClassVar[int] = 1

    time_ns: TimeNs
    sequence: Sequence


class Feedback(Message, frozen=True, gc=False):
    """A decoded feedback frame of the chassis."""

    alive_counter: AliveCounter


class Gear(Feedback, frozen=True, gc=False):
    """Auto_GearFeedBack."""

    active: bool
    gear_position: GearPosition


class Steering(Feedback, frozen=True, gc=False):
    """Auto_SteeringFeedBack."""

    active: bool
    angle_deg: AngleDeg


class Drive(Feedback, frozen=True, gc=False):
    """Auto_DriveFeedBack. The speed is a magnitude: the gear gives the direction."""

    active: bool
    speed_mps: SpeedMps


class Braking(Feedback, frozen=True, gc=False):
    """Auto_BrakingFeedBack."""

    active: bool
    braking_status: BrakingStatus


class Parking(Feedback, frozen=True, gc=False):
    """Auto_ParkingFeedBack."""

    active: bool
    parking_status: ParkingStatus


class WheelSpeed(Feedback, frozen=True, gc=False):
    """Auto_WheelSpdFeedback. Negative in reverse."""

    valid: bool
    rear_left_speed_mps: SpeedMps
    rear_right_speed_mps: SpeedMps


class WheelPulse(Feedback, frozen=True, gc=False):
    """Auto_WheelPulseFeedback. Forward counts up, reverse down."""

    valid: bool
    rear_left_pulses: Pulses
    rear_right_pulses: Pulses


class Body(Feedback, frozen=True, gc=False):
    """Auto_MileageAndBodyFeedback. The chassis reports a bumper hit, but does not react to it."""

    valid: bool
    total_mileage_km: MileageKm
    front_bumper: bool
    rear_bumper: bool
    mode: Mode


class Light(Feedback, frozen=True, gc=False):
    """Auto_LightFeedback."""

    headlamp: bool
    right_indicator: bool
    left_indicator: bool


class Speaker(Feedback, frozen=True, gc=False):
    """Auto_SpeakerFeedback."""

    horn: bool


class Odometry(Message, frozen=True, gc=False):
    """Pose and speeds of the middle of the rear axle, from drive and steering feedback by the bicycle model.

    The pose is zero where the gateway started, or at the last ``reset_odometry``: x forward, y left, heading from
    x to y. It drifts: the variances grow with distance and turning, in gaps of the feedback, and where the wheel
    pulses disagree. Speeds are those of the robot, along its x and about z.

    Attributes:
        time_ns: of the newest drive feedback that was used.
        x_m: position of the axle, with ``y_m``.
        heading_rad: direction of the robot's x.
        distance_m: distance driven, forward plus reverse.
    """

    x_m: PlaceM
    y_m: PlaceM
    heading_rad: HeadingRad
    speed_mps: SpeedMps
    yaw_rate_radps: YawRateRadps
    distance_m: DistanceM
    x_variance_m2: VarianceM2
    y_variance_m2: VarianceM2
    heading_variance_rad2: VarianceRad2
    speed_variance_m2ps2: VarianceM2ps2
    yaw_rate_variance_rad2ps2: VarianceRad2ps2


class CanFrames(Message, frozen=True):
    """Raw CAN frames in bus order, as columns of equal length.

    Attributes:
        bus: the bus's name, as in the key.
        dropped: frames dropped before this batch because a buffer was full, since the start.
        frame_time_ns: when each frame was received (or sent).
        fd_flags: 0 for classic CAN; else bit 2 set, bit 0 bit rate switch, bit 1 error state indicator.
        length: data length in bytes; for a remote frame the requested length.
        data: the data bytes of each frame.
    """

    bus: Annotated[str, Meta(max_length=BUS_MAX_LENGTH)]
    dropped: Count
    frame_time_ns: list[TimeNs]
    can_id: list[CanWord]
    fd_flags: list[Annotated[int, Meta(ge=0, le=7)]]
    length: list[Annotated[int, Meta(ge=0, le=64)]]
    data: list[bytes]


class RobotState(Message, frozen=True):
    """The whole robot in one message. A field is null, or ``undefined``, without fresh, valid feedback.

    Attributes:
        bus_up: the gateway has the CAN bus open.
        variant: the chassis's firmware variant; until it is known, speeds are null.
        silent: names of the feedback frames that are missing or overdue.
        speed_mps: signed, forward positive: the drive feedback with the direction of the wheels, or else of the
            gear; null if neither has one.
        yaw_rate_radps: from speed and steering angle by the bicycle model, wheelbase 0.660 m.
    """

    bus_up: bool
    variant: Variant
    silent: list[str]
    mode: Mode
    gear_position: GearPosition
    speed_mps: SpeedMps | None
    angle_deg: AngleDeg | None
    yaw_rate_radps: YawRateRadps | None
    rear_left_speed_mps: SpeedMps | None
    rear_right_speed_mps: SpeedMps | None
    rear_left_pulses: Pulses | None
    rear_right_pulses: Pulses | None
    braking_status: BrakingStatus
    parking_status: ParkingStatus
    total_mileage_km: MileageKm | None
    front_bumper: bool | None
    rear_bumper: bool | None
    headlamp: bool | None
    right_indicator: bool | None
    left_indicator: bool | None
    horn: bool | None


class FrameHealth(msgspec.Struct, frozen=True):
    """Supervision of one feedback frame.

    Attributes:
        name: the frame's name in the DBC.
        rate_hz: valid frames per second over the last second.
        valid: valid frames since the start.
        lost: valid frames missing since the start, by the alive counter; in a gap the period shows how often it
            wrapped, once late frames have come. Frames with a wrong checksum or an implausible value count too.
        withheld: valid frames that were not published because the scale of speeds was not known.
        checksum_faults: frames with a wrong checksum since the start.
        implausible: frames with a correct checksum and a value that this chassis cannot have, since the start.
            They are not published.
        silent: true while the frame is missing or overdue.
        alive_faults: the fault count of the alive counter: +1 for each fault, -1 for each good frame.
        failures: checks beyond their threshold now: checksum, implausible, alive_counter, period, silence.
    """

    name: str
    rate_hz: RateHz
    valid: Count
    lost: Count
    withheld: Count
    checksum_faults: Count
    implausible: Count
    silent: bool
    alive_faults: Count
    failures: list[str]


class GatewayHealth(Message, frozen=True):
    """The health of the gateway, published each second.

    Attributes:
        uptime_s: since the gateway started.
        bus: the CAN bus's name, as in the keys.
        bus_up: the gateway has the CAN bus open.
        bus_detail: why the bus is not open; else empty.
        variant: the firmware variant in force.
        frames: CAN frames of any kind received since the start.
        frames_per_s: the same over the last second.
        faults: number of faults since the start, by kind.
        unknown_identifiers: frames whose identifier is not in the DBC, by hexadecimal identifier.
        bus_losses: number of losses of the bus since the start.
        bus_drops: frames dropped since the start: by SocketCAN, because they were not read in time; from an
            adapter, because their line could not be parsed.
        controller: the CAN controller's state, by the last error frame.
        zenoh_peers: Zenoh nodes connected directly to this one.
        publish_failures: samples that Zenoh did not accept.
        inbox_drops: requests dropped unread since the start, because too many came.
        feedback: the supervision of each feedback frame.
        tick_lateness_p50_ms: delay of the beginnings of the last second's ticks, median.
        tick_lateness_p99_ms: the same, 99th percentile.
        tick_lateness_max_ms: the same, maximum.
        tick_lateness_worst_ms: the maximum since the start.
        cpu_percent: processor time of this process over the last second; 100 is one core.
        realtime: the loop runs with real-time priority. Without it a lower speed limit is in force.
        certificate_ends_ns: end of the certificate that the gateway connects with; null without one.
        grant_ends_ns: end of the robot's own grant; null in open mode.
        notes: problems to fix: reasons why the robot cannot be engaged, and certificates that end soon, each with
            the file and the cure.
    """

    gateway_version: str
    uptime_s: DurationS
    bus: str
    bus_up: bool
    bus_detail: str
    bus_losses: Count
    bus_drops: Count
    controller: ControllerState
    zenoh_peers: Count
    publish_failures: Count
    inbox_drops: Count
    variant: Variant
    frames: Count
    frames_per_s: RateHz
    faults: dict[str, Count]
    unknown_identifiers: dict[str, Count]
    feedback: list[FrameHealth]
    tick_lateness_p50_ms: DurationMs
    tick_lateness_p99_ms: DurationMs
    tick_lateness_max_ms: DurationMs
    tick_lateness_worst_ms: DurationMs
    cpu_percent: Annotated[float, Meta(ge=0, extra_json_schema=unit_keyword("%"))]
    realtime: bool = True
    certificate_ends_ns: TimeNs | None = None
    grant_ends_ns: TimeNs | None = None
    notes: list[str] = []


class GatewayInfo(Message, frozen=True):
    """The gateway's identity and configuration: the reply to a query on ``gateway/info``.

    Attributes:
        robot: the robot's chunk of the key.
        bus: the CAN bus's name, as in the keys.
        listen_only: the gateway sends nothing on the bus.
        started_ns: when the gateway started.
        variant: the firmware variant in force.
        versions: versions of the gateway and of the packages it uses.
        configuration: the settings in force, as TOML.
        configuration_sha256: hash of that text, in hexadecimal.
        dbc_name: the file name of the DBC in force; empty while the variant is unknown.
        dbc: the text of the DBC in force; empty while the variant is unknown.
        schemas: JSON Schema text of every message, request and reply, by schema name.
        listen: Zenoh endpoints that the gateway listens on for everything except commands; empty for a client.
        command_listen: Zenoh endpoints that the gateway listens on for commands.
    """

    robot: str
    bus: str
    listen_only: bool
    started_ns: TimeNs
    variant: Variant
    versions: dict[str, str]
    configuration: str
    configuration_sha256: str
    dbc_name: str
    dbc: str
    schemas: dict[str, str]
    listen: list[str] = []
    command_listen: list[str] = []


class CanFrame(msgspec.Struct, frozen=True):
    """One raw CAN frame in a log: a row of CanFrames.

    Attributes:
        identifier: 11 bits, or 29 with is_extended.
        dlc: data length in bytes; for a remote frame the requested length.
    """

    time_ns: TimeNs
    bus: str
    identifier: CanIdentifier
    is_extended: bool
    is_remote: bool
    is_error: bool
    is_fd: bool
    bitrate_switch: bool
    error_state_indicator: bool
    dlc: Annotated[int, Meta(ge=0, le=64)]
    data: bytes


class RawSample(msgspec.Struct, frozen=True):
    """A Zenoh sample in a log that fits no known subject, stored whole.

    Attributes:
        time_ns: the sample's own Zenoh timestamp; 0 if it has none.
        reason: why it was not decoded.
    """

    time_ns: TimeNs
    key: str
    encoding: str
    payload: bytes
    attachment: bytes
    reason: str
