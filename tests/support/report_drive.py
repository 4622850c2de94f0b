"""Messages of a drive, and logs of them, made up."""

from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.rows import END_OF_TIME_NS
from recorder.review.report.findings import Report
from recorder.review.report.survey import read_report
from schemas.decisions import (
    ArbiterState,
    Decision,
    EventKind,
    SafetyEvent,
    SafetyState,
    Severity,
    StopPhase,
    Verdict,
)
from schemas.messages import (
    BrakingStatus,
    FrameHealth,
    GatewayHealth,
    GatewayInfo,
    GearPosition,
    Message,
    Mode,
    ParkingStatus,
    RobotState,
    Variant,
)
from schemas.messages import ControllerState as Controller
from schemas.reasons import Reason
from schemas.requests import Role
from tests.support.recorder_fakes import MS, ROOT, WALL_NS, FakeSample, Log, info, sample_of

HOSTILE: Final = (
    "</script><script>document.body.dataset.owned=1</script><img src=http://evil.test/x> <b>&amp; $x^2$ \u202e"
)
"""What must be shown as it is, and do nothing."""

PERIOD_NS: Final = 50 * MS


def state(number: int, **fields: Any) -> RobotState:  # noqa: ANN401 - any field of the message
    """The robot's state so many periods after the beginning: driving ahead at 1 m/s unless told otherwise."""
    known: dict[str, Any] = {
        "time_ns": WALL_NS + number * PERIOD_NS,
        "sequence": number,
        "bus_up": True,
        "variant": Variant.COARSE,
        "silent": [],
        "mode": Mode.AUTO,
        "gear_position": GearPosition.DRIVE,
        "speed_mps": 1.0,
        "angle_deg": 0.0,
        "braking_status": BrakingStatus.RELEASED,
        "parking_status": ParkingStatus.RELEASED,
    }
    nothing = dict.fromkeys(msgspec.structs.asdict(_BARE))
    return RobotState(**{**nothing, **known, **fields})


_BARE: Final = RobotState(
    0,
    0,
    bus_up=True,
    variant=Variant.COARSE,
    silent=[],
    mode=Mode.AUTO,
    gear_position=GearPosition.DRIVE,
    speed_mps=None,
    angle_deg=None,
    yaw_rate_radps=None,
    rear_left_speed_mps=None,
    rear_right_speed_mps=None,
    rear_left_pulses=None,
    rear_right_pulses=None,
    braking_status=BrakingStatus.RELEASED,
    parking_status=ParkingStatus.RELEASED,
    total_mileage_km=None,
    front_bumper=None,
    rear_bumper=None,
    headlamp=None,
    right_indicator=None,
    left_indicator=None,
    horn=None,
)


def arbiter(number: int, **fields: Any) -> SafetyState:  # noqa: ANN401 - any field of the message
    """The arbiter's state at that time: engaged by operator-1."""
    known = SafetyState(
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        tick=10_000 + 5 * number,
        challenge=number.to_bytes(8),
        link_age_s=None,
        link_age_last_s=None,
        link_age_p50_s=None,
        link_age_p99_s=None,
        travel_delay_m=0.0,
        travel_speed_limit_mps=None,
        deadman_s=0.3,
        accepted_seq=None,
        stop_detail="",
        state=ArbiterState.ENGAGED,
        engaged=True,
        stop_reason=Reason.NONE,
        stop_phase=StopPhase.IDLE,
        lease_holder="operator-1",
        lease_role=Role.OPERATOR,
        lease_expires_s=2.0,
        latched=[],
        blocked_by=[],
        guarded=True,
        speed_limit_mps=2.0,
        acceleration_limit_mps2=0.8,
        deceleration_limit_mps2=1.2,
        emergency_deceleration_mps2=2.0,
        steering_limit_deg=24.0,
        steering_rate_limit_degps=60.0,
        lateral_acceleration_limit_mps2=1.5,
        target_speed_mps=1.0,
        target_angle_deg=0.0,
        output_speed_mps=1.0,
        output_angle_deg=0.0,
        output_gear=GearPosition.DRIVE,
        brake_pedal_percent=0.0,
        parking=False,
    )
    return msgspec.structs.replace(known, **fields)


def event(number: int, kind: EventKind = EventKind.STOP, **fields: Any) -> SafetyEvent:  # noqa: ANN401 - any field of the message
    """Something that happened at that time: a stop, because the front bumper was hit."""
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
    """A drive command that was refused at that time: operator-2 holds no lease."""
    known = Decision(
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        tick=10_000 + 5 * number,
        request="drive",
        operator="operator-2",
        lease=1,
        request_sequence=number,
        age_ms=None,
        verdict=Verdict.REFUSED,
        reason=Reason.NO_LEASE,
        detail="",
        bound_by=[],
        requested_speed_mps=1.0,
        requested_angle_deg=0.0,
        output_speed_mps=0.0,
        output_angle_deg=0.0,
        frames_sent=0,
    )
    return msgspec.structs.replace(known, **fields)


def health(number: int, lost: int, losses: int = 0) -> GatewayHealth:
    """The gateway's health at that time: so many frames and buses lost since it started."""
    return GatewayHealth(
        time_ns=WALL_NS + number * PERIOD_NS,
        sequence=number,
        gateway_version="0.1.0",
        uptime_s=1.0,
        bus="can0",
        bus_up=True,
        bus_detail="",
        bus_losses=losses,
        bus_drops=0,
        controller=Controller.UNKNOWN,
        zenoh_peers=1,
        publish_failures=0,
        inbox_drops=0,
        variant=Variant.COARSE,
        frames=1000,
        frames_per_s=630.0,
        faults={},
        unknown_identifiers={},
        feedback=[
            FrameHealth(
                name="Auto_GearFeedBack",
                rate_hz=100.0,
                valid=1000,
                lost=lost,
                withheld=0,
                checksum_faults=0,
                implausible=0,
                silent=False,
                alive_faults=0,
                failures=[],
            )
        ],
        tick_lateness_p50_ms=0.1,
        tick_lateness_p99_ms=0.1,
        tick_lateness_max_ms=0.1,
        tick_lateness_worst_ms=0.1,
        cpu_percent=10.0,
    )


def drive(periods: int = 200) -> list[Message]:
    """A drive of so many periods, which a bumper ends."""
    found: list[Message] = []
    for number in range(periods):
        found += [state(number, angle_deg=10.0), arbiter(number)]
    return [*found, refusal(periods - 1), event(periods - 1)]


def restart(periods: int = 200, silent: int = 60) -> list[Message]:
    """A drive of so many periods; its gateway dies, and another one stands by from so many periods later on."""
    found: list[Message] = [one for number in range(periods) for one in (state(number), arbiter(number))]
    for number in range(periods + silent, periods + silent + 40):
        other = arbiter(number, sequence=number - periods - silent, state=ArbiterState.STANDBY, lease_holder="")
        found += [state(number, speed_mps=0.0), msgspec.structs.replace(other, tick=10**12 + 5 * number)]
    return found


def gateway(number: int, configuration: str = "[can]\n", **fields: Any) -> GatewayInfo:  # noqa: ANN401 - any field
    """What a gateway is that was started at that time; its configuration's hash is made of the text."""
    known = info(sequence=number)
    said = {
        "time_ns": WALL_NS + number * PERIOD_NS,
        "started_ns": WALL_NS + number * PERIOD_NS,
        "configuration": configuration,
        "configuration_sha256": sha256(configuration.encode()).hexdigest(),
    }
    return msgspec.structs.replace(known, **{**said, **fields})


def write_log(
    path: Path, messages: Iterable[Message], robots: Iterable[str] = ("cruiser-1",), root: str = ROOT
) -> Path:
    """A log in which each of these robots says all of these messages, received when they were sent."""
    log = Log()
    for robot in robots:
        log.receive(sample_of(info(), robot, root))
    for message in messages:
        for robot in robots:
            log.receive(sample_of(message, robot, root), wall_ns=message.time_ns)
    path.write_bytes(log.close())
    return path


def report_of(*paths: Path, faults: Faults | None = None) -> Report:
    """The report of these logs."""
    told = Faults() if faults is None else faults
    return read_report(find_logs(paths, told), 0, END_OF_TIME_NS, told, version="0.1.0")


def undecodable(robot: str = "cruiser-1") -> FakeSample:
    """A sample of a key of ours that is no message."""
    return FakeSample(f"fleet/{robot}/state", "text/plain", b"?")
