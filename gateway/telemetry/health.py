"""The gateway's health, each second, and the whole robot in one message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final, TypeVar

import msgspec

from gateway.chassis.frame import FaultKind, hex_identifier
from gateway.chassis.odometry import signed_speed_mps, yaw_rate_radps
from gateway.telemetry.feedback import FeedbackStream
from schemas.messages import (
    SEQUENCE_MAX,
    Body,
    Braking,
    BrakingStatus,
    ControllerState,
    Drive,
    Feedback,
    GatewayHealth,
    Gear,
    GearPosition,
    Light,
    Mode,
    Parking,
    ParkingStatus,
    RobotState,
    Speaker,
    Steering,
    Variant,
    WheelPulse,
    WheelSpeed,
)

UNKNOWN_IDENTIFIERS_MAX: Final = 64  # unknown identifiers that are counted one by one, to bound the memory

OTHER_IDENTIFIERS: Final = "other"


class Links(msgspec.Struct, frozen=True):
    """The bus, Zenoh and the guard, as the loop reports them to the core; most fields as in GatewayHealth.

    Attributes:
        certificate_ends_s, grant_ends_s: expiry, seconds since 1970; None where there is none.
    """

    bus_up: bool = False
    bus_detail: str = ""
    bus_losses: int = 0
    bus_drops: int = 0
    zenoh_peers: int = 0
    publish_failures: int = 0
    cpu_ns: int = 0  # processor time of the process since its start
    guarded: bool = False
    guard_sends: bool = False
    guard_stops: int = 0
    guard_says: str = ""
    is_behind: bool = False
    realtime: bool = False
    inbox_drops: int = 0
    outside: tuple[str, ...] = ()  # remote ends of Zenoh connections that leave this computer
    certificate_ends_s: int | None = None
    grant_ends_s: int | None = None
    notes: tuple[str, ...] = ()  # texts on what needs attention


class HealthMeter:
    """Counters of the gateway's health, published each second."""

    def __init__(self, gateway_version: str, bus: str, started_ns: int) -> None:
        self.faults: Counter[FaultKind] = Counter()
        self.controller = ControllerState.UNKNOWN
        self._gateway_version = gateway_version
        self._bus = bus
        self._started_ns = started_ns
        self._unknown: Counter[str] = Counter()
        self._lateness_ns: list[int] = []
        self._worst_ns = 0
        self._reported_ns = started_ns
        self._reported_frames = 0
        self._reported_cpu_ns = 0
        self._sequence = 0

    def unknown_identifier(self, can_id: int) -> None:
        """Count a frame whose identifier is not in the DBC."""
        name = hex_identifier(can_id)
        if name not in self._unknown and len(self._unknown) >= UNKNOWN_IDENTIFIERS_MAX:
            name = OTHER_IDENTIFIERS
        self._unknown[name] += 1

    def tick_lateness(self, late_ns: int) -> None:
        self._lateness_ns.append(late_ns)
        self._worst_ns = max(self._worst_ns, late_ns)

    def report(
        self,
        now_ns: int,
        wall_ns: int,
        links: Links,
        variant: Variant,
        frames: int,
        streams: list[FeedbackStream],
        barred: Iterable[str] = (),
    ) -> GatewayHealth:
        """Return the health since the last report; ``barred`` has the reasons that bar the robot from engaging."""
        elapsed_s = max(now_ns - self._reported_ns, 1) / 1e9
        late_ns = sorted(self._lateness_ns) or [0]
        health = GatewayHealth(
            time_ns=wall_ns,
            sequence=self._sequence,
            gateway_version=self._gateway_version,
            uptime_s=round((now_ns - self._started_ns) / 1e9, 3),
            bus=self._bus,
            bus_up=links.bus_up,
            bus_detail=links.bus_detail,
            bus_losses=links.bus_losses,
            bus_drops=links.bus_drops,
            controller=self.controller,
            zenoh_peers=links.zenoh_peers,
            publish_failures=links.publish_failures,
            inbox_drops=links.inbox_drops,
            variant=variant,
            frames=frames,
            frames_per_s=round((frames - self._reported_frames) / elapsed_s, 1),
            faults={kind.value: number for kind, number in self.faults.items()},
            unknown_identifiers=dict(self._unknown),
            feedback=[stream.health(elapsed_s, now_ns) for stream in streams],
            tick_lateness_p50_ms=_quantile_ms(late_ns, 0.50),
            tick_lateness_p99_ms=_quantile_ms(late_ns, 0.99),
            tick_lateness_max_ms=_quantile_ms(late_ns, 1),
            tick_lateness_worst_ms=round(self._worst_ns / 1e6, 3),
            cpu_percent=round((links.cpu_ns - self._reported_cpu_ns) / elapsed_s / 1e7, 1),
            realtime=links.realtime,
            certificate_ends_ns=_ns(links.certificate_ends_s),
            grant_ends_ns=_ns(links.grant_ends_s),
            notes=[*barred, *links.notes],
        )
        self._reported_ns = now_ns
        self._reported_frames = frames
        self._reported_cpu_ns = links.cpu_ns
        self._lateness_ns.clear()
        self._sequence = (self._sequence + 1) & SEQUENCE_MAX
        return health


def _quantile_ms(sorted_ns: list[int], share: float) -> float:
    index = min(len(sorted_ns) - 1, int(share * len(sorted_ns)))
    return round(sorted_ns[index] / 1e6, 3)


def _ns(time_s: int | None) -> int | None:
    return None if time_s is None else time_s * 1_000_000_000


FeedbackType = TypeVar("FeedbackType", bound=Feedback)

DECIMALS: Final = 4  # of derived values: 0.1 mm/s, well below the chassis's resolution


class LatestMessages:
    """The newest message of each class, without silent frames."""

    def __init__(self, messages: list[Feedback]) -> None:
        self._by_type: dict[type[Feedback], Feedback] = {type(message): message for message in messages}

    def of(self, kind: type[FeedbackType]) -> FeedbackType | None:
        message = self._by_type.get(kind)
        return message if isinstance(message, kind) else None


def robot_state(
    messages: LatestMessages,
    *,
    wheelbase_m: float,
    time_ns: int,
    sequence: int,
    bus_up: bool,
    variant: Variant,
    silent: list[str],
) -> RobotState:
    """Build the state. A field whose feedback is missing, silent or marked invalid is None or ``undefined``.

    So is the mode: an invalid frame is no evidence that the chassis accepts commands.
    """
    gear, steering, drive = messages.of(Gear), messages.of(Steering), messages.of(Drive)
    braking, parking, body = messages.of(Braking), messages.of(Parking), messages.of(Body)
    wheels, pulses = messages.of(WheelSpeed), messages.of(WheelPulse)
    light, speaker = messages.of(Light), messages.of(Speaker)
    speed_mps = signed_speed_mps(drive, wheels, gear)
    return RobotState(
        time_ns=time_ns,
        sequence=sequence,
        bus_up=bus_up,
        variant=variant,
        silent=silent,
        mode=body.mode if body and body.valid else Mode.UNDEFINED,
        gear_position=gear.gear_position if gear else GearPosition.UNDEFINED,
        speed_mps=speed_mps,
        angle_deg=steering.angle_deg if steering else None,
        yaw_rate_radps=(
            round(yaw_rate_radps(speed_mps, steering.angle_deg, wheelbase_m), DECIMALS) + 0.0  # + 0.0: no -0.0
            if steering and speed_mps is not None
            else None
        ),
        rear_left_speed_mps=wheels.rear_left_speed_mps if wheels and wheels.valid else None,
        rear_right_speed_mps=wheels.rear_right_speed_mps if wheels and wheels.valid else None,
        rear_left_pulses=pulses.rear_left_pulses if pulses and pulses.valid else None,
        rear_right_pulses=pulses.rear_right_pulses if pulses and pulses.valid else None,
        braking_status=braking.braking_status if braking else BrakingStatus.UNDEFINED,
        parking_status=parking.parking_status if parking else ParkingStatus.UNDEFINED,
        total_mileage_km=body.total_mileage_km if body and body.valid else None,
        front_bumper=body.front_bumper if body and body.valid else None,
        rear_bumper=body.rear_bumper if body and body.valid else None,
        headlamp=light.headlamp if light else None,
        right_indicator=light.right_indicator if light else None,
        left_indicator=light.left_indicator if light else None,
        horn=speaker.horn if speaker else None,
    )
