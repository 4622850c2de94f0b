"""Messages and samples as a chassis, its gateway, its arbiter and a recorder publish them.

The constants are whole messages, to be changed by ``msgspec.structs.replace``; the functions make one of a series.
"""

from enum import Enum
from functools import lru_cache
from hashlib import sha256
from types import NoneType
from typing import Annotated, Any, Final, TypeVar, get_args, get_origin

import msgspec

from recorder.encoding.samples import ReceivedSample
from schemas import codec, keys
from schemas.can_word import EXTENDED
from schemas.decisions import (
    ArbiterState,
    Decision,
    EventKind,
    SafetyEvent,
    SafetyState,
    Severity,
    Verdict,
)
from schemas.messages import (
    BrakingStatus,
    CanFrame,
    CanFrames,
    ControllerState,
    FrameHealth,
    GatewayHealth,
    GatewayInfo,
    Gear,
    GearPosition,
    Message,
    Mode,
    ParkingStatus,
    RobotState,
    Variant,
)
from schemas.reasons import Reason
from schemas.recording import RecorderHealth, RecorderState
from schemas.requests import Role
from schemas.subjects import BY_NAME, BY_TYPE

ROOT: Final = "fleet"
ROBOT: Final = "cruiser-1"
WALL_NS: Final = 1_800_000_000_000_000_000
SECOND: Final = 1_000_000_000
MS: Final = 1_000_000
PERIOD_NS: Final = 50 * MS  # between the messages of a numbered series
GEAR_FEEDBACK: Final = 0x18C4D1EF

Struct = TypeVar("Struct", bound=msgspec.Struct)


def plain(kind: type[Struct], /, **fields: Any) -> Struct:  # noqa: ANN401 - any field of the message
    """A message whose other required fields are zero, empty, none or the first of their enumeration."""
    required = {one.name: _empty(one.type) for one in msgspec.structs.fields(kind) if one.required}
    return kind(**required | fields)


def _empty(kind: Any) -> object:  # noqa: ANN401 - any annotation
    if NoneType in get_args(kind):
        return None
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else get_origin(kind) or kind
    return next(iter(kind)) if issubclass(kind, Enum) else kind()


# A robot that drives.
STATE: Final = RobotState(
    time_ns=1,
    sequence=0,
    bus_up=True,
    variant=Variant.COARSE,
    silent=[],
    mode=Mode.AUTO,
    gear_position=GearPosition.DRIVE,
    speed_mps=1.25,
    angle_deg=-3.5,
    yaw_rate_radps=-0.1,
    rear_left_speed_mps=1.25,
    rear_right_speed_mps=1.25,
    rear_left_pulses=7,
    rear_right_pulses=8,
    braking_status=BrakingStatus.RELEASED,
    parking_status=ParkingStatus.RELEASED,
    total_mileage_km=12.345,
    front_bumper=False,
    rear_bumper=False,
    headlamp=True,
    right_indicator=False,
    left_indicator=False,
    horn=False,
)
# An arbiter in standby, with a lease.
STANDBY: Final = plain(
    SafetyState,
    time_ns=1,
    tick=100,
    challenge=bytes(8),
    deadman_s=0.3,
    state=ArbiterState.STANDBY,
    lease_holder="first",
    lease_role=Role.OPERATOR,
    lease_expires_s=2.0,
    guarded=True,
    speed_limit_mps=2.0,
    acceleration_limit_mps2=0.8,
    deceleration_limit_mps2=1.2,
    emergency_deceleration_mps2=2.0,
    steering_limit_deg=24.0,
    steering_rate_limit_degps=60.0,
    lateral_acceleration_limit_mps2=1.5,
    output_angle_deg=7.0,
    output_gear=GearPosition.NEUTRAL,
)
# A gateway that is well.
HEALTH: Final = plain(
    GatewayHealth,
    time_ns=1,
    gateway_version="0.1.0",
    uptime_s=12.0,
    bus="can0",
    bus_up=True,
    controller=ControllerState.UNKNOWN,
    zenoh_peers=1,
    variant=Variant.COARSE,
    frames=630,
    frames_per_s=630.0,
    faults={"checksum": 0},
    feedback=[plain(FrameHealth, name="Auto_GearFeedBack", rate_hz=100, valid=99)],
    tick_lateness_p50_ms=0.1,
    tick_lateness_p99_ms=0.2,
    tick_lateness_max_ms=0.3,
    tick_lateness_worst_ms=0.4,
    cpu_percent=5.0,
)


class FakeSample(msgspec.Struct, frozen=True):
    key: str
    encoding: str
    payload: bytes
    attachment: bytes = b""
    zenoh_time_ns: int = 0
    deleted: bool = False
    source: tuple[str, int] | None = None
    received_ns: int = WALL_NS
    is_reply: bool = False


@lru_cache(32)
def key_of(kind: type[Message], robot: str = ROBOT, root: str = ROOT) -> str:
    subject = BY_TYPE[kind]
    return keys.build(root, robot, subject, "can0" if "{bus}" in subject.name else "")


def logged_topics(key: str = "fleet/cruiser-1") -> dict[str, type]:
    """The class of each topic's messages."""
    return {
        f"{key}/{name.format(bus='can0')}": CanFrame if subject.type is CanFrames else subject.type
        for name, subject in BY_NAME.items()
    }


def sample_of(message: Message, robot: str = ROBOT, root: str = ROOT) -> ReceivedSample:
    kind = type(message)
    return FakeSample(key_of(kind, robot, root), BY_TYPE[kind].encoding, codec.encode(message))


def gear(sequence: int, time_ns: int = WALL_NS) -> Gear:
    return Gear(
        time_ns=time_ns,
        sequence=sequence,
        alive_counter=sequence % 16,
        active=True,
        gear_position=GearPosition.DRIVE,
    )


def feedback(counter: int) -> bytes:
    """A gear feedback frame's data with its checksum."""
    data = bytes([1, 4, 0, 0, 0, 0, counter % 16 << 4])
    checksum = 0
    for byte in data:
        checksum ^= byte
    return data + bytes([checksum])


def batch(sequence: int, frames: list[tuple[int, bytes]], dropped: int = 0) -> CanFrames:
    """A batch of gear feedback frames, from receive time and data of each."""
    return CanFrames(
        time_ns=WALL_NS,
        sequence=sequence,
        bus="can0",
        dropped=dropped,
        frame_time_ns=[time_ns for time_ns, _ in frames],
        can_id=[EXTENDED | GEAR_FEEDBACK] * len(frames),
        fd_flags=[0] * len(frames),
        length=[len(data) for _, data in frames],
        data=[data for _, data in frames],
    )


def safety_event(kind: EventKind, severity: Severity = Severity.WARNING, sequence: int = 0) -> SafetyEvent:
    return SafetyEvent(WALL_NS, sequence, 0, severity, kind, Reason.NONE, "", "as it were")


def info(variant: Variant = Variant.COARSE, sequence: int = 0, dbc: str = 'VERSION "1"\n') -> GatewayInfo:
    return GatewayInfo(
        time_ns=WALL_NS,
        sequence=sequence,
        robot=ROBOT,
        bus="can0",
        listen_only=True,
        started_ns=WALL_NS - SECOND,
        variant=variant,
        versions={"cruiser-gateway": "0.1.0"},
        configuration="[can]\n",
        configuration_sha256="ab" * 32,
        dbc_name="cruiser-coarse.dbc",
        dbc=dbc,
        schemas={"cruiser.Gear": "{}"},
    )


def gateway_info(number: int, configuration: str = "[can]\n", **fields: Any) -> GatewayInfo:  # noqa: ANN401 - any field
    """The info of a gateway that started so many periods after the beginning."""
    made = {
        "time_ns": WALL_NS + number * PERIOD_NS,
        "started_ns": WALL_NS + number * PERIOD_NS,
        "configuration": configuration,
        "configuration_sha256": sha256(configuration.encode()).hexdigest(),
    }
    return msgspec.structs.replace(info(sequence=number), **{**made, **fields})


def state(number: int, **fields: Any) -> RobotState:  # noqa: ANN401 - any field of the message
    """The robot's state so many periods after the beginning: ahead at 1 m/s, all else unknown."""
    made = plain(
        RobotState,
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        bus_up=True,
        variant=Variant.COARSE,
        mode=Mode.AUTO,
        gear_position=GearPosition.DRIVE,
        speed_mps=1.0,
        angle_deg=0.0,
        braking_status=BrakingStatus.RELEASED,
        parking_status=ParkingStatus.RELEASED,
    )
    return msgspec.structs.replace(made, **fields)


def arbiter(number: int, **fields: Any) -> SafetyState:  # noqa: ANN401 - any field of the message
    """The arbiter's state at that time: engaged by operator-1, at 1 m/s."""
    made: dict[str, Any] = {
        "time_ns": WALL_NS + number * PERIOD_NS,
        "sequence": number,
        "tick": 10_000 + 5 * number,
        "challenge": number.to_bytes(8),
        "state": ArbiterState.ENGAGED,
        "engaged": True,
        "lease_holder": "operator-1",
        "target_speed_mps": 1.0,
        "output_speed_mps": 1.0,
        "output_angle_deg": 0.0,
        "output_gear": GearPosition.DRIVE,
    }
    return msgspec.structs.replace(STANDBY, **{**made, **fields})


def event(number: int, kind: EventKind = EventKind.STOP, **fields: Any) -> SafetyEvent:  # noqa: ANN401 - any field of the message
    """An event at that time: a stop, because the front bumper was hit."""
    known = SafetyEvent(
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        tick=10_000 + 5 * number,
        severity=Severity.WARNING,
        kind=kind,
        reason=Reason.FRONT_BUMPER,
        operator="",
        text="stopping: the front bumper was hit",
    )
    return msgspec.structs.replace(known, **fields)


def refusal(number: int, **fields: Any) -> Decision:  # noqa: ANN401 - any field of the message
    """A refused drive command at that time: operator-2 holds no lease."""
    known = plain(
        Decision,
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        tick=10_000 + 5 * number,
        request="drive",
        operator="operator-2",
        lease=1,
        request_sequence=number,
        verdict=Verdict.REFUSED,
        reason=Reason.NO_LEASE,
        requested_speed_mps=1.0,
        requested_angle_deg=0.0,
        output_speed_mps=0.0,
        output_angle_deg=0.0,
    )
    return msgspec.structs.replace(known, **fields)


def health(number: int, lost: int, faults: dict[str, int] | None = None) -> GatewayHealth:
    """The gateway's health at that time: frames and buses lost and other faults since its start."""
    frame = msgspec.structs.replace(HEALTH.feedback[0], valid=1000, lost=lost)
    return msgspec.structs.replace(
        HEALTH,
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        uptime_s=1.0,
        frames=1000,
        faults=faults or {},
        feedback=[frame],
    )


def can_frame(
    identifier: int = 0x18C4D1EF,
    time_ns: int = WALL_NS,
    data: bytes = b"\1\2\3\4\5\6\7\x08",
    *,
    is_extended: bool = True,
    is_remote: bool = False,
    is_error: bool = False,
    is_fd: bool = False,
) -> CanFrame:
    return CanFrame(
        time_ns=time_ns,
        bus="can0",
        identifier=identifier,
        is_extended=is_extended,
        is_remote=is_remote,
        is_error=is_error,
        is_fd=is_fd,
        bitrate_switch=False,
        error_state_indicator=False,
        dlc=len(data),
        data=data,
    )


def recorder_health(state: RecorderState = RecorderState.RECORDING) -> RecorderHealth:
    """The health of a recorder that has received nothing."""
    return plain(
        RecorderHealth,
        time_ns=WALL_NS,
        recorder="bench",
        recorder_version="1",
        uptime_s=2.0,
        state=state,
        state_since_s=1.0,
    )
