"""A gateway's voice on Zenoh without a gateway: state, health and token, as the subject table says."""

import socket
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from zenoh import ext

from gateway.zenoh.client import close_session, open_session
from schemas import codec, keys
from schemas.decisions import ArbiterState, SafetyState, StopPhase
from schemas.messages import (
    BrakingStatus,
    ControllerState,
    FrameHealth,
    GatewayHealth,
    GearPosition,
    Message,
    Mode,
    ParkingStatus,
    RobotState,
    Variant,
)
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.settings import ZenohSettings
from schemas.subjects import BY_TYPE

ROOT = "fleet"

STATE = RobotState(
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
STANDBY = SafetyState(
    time_ns=1,
    sequence=0,
    tick=100,
    challenge=bytes(8),
    link_age_s=None,
    link_age_last_s=None,
    link_age_p50_s=None,
    link_age_p99_s=None,
    travel_delay_m=0.0,
    travel_speed_limit_mps=None,
    deadman_s=0.3,
    accepted_seq=None,
    stop_detail="",
    state=ArbiterState.STANDBY,
    engaged=False,
    stop_reason=Reason.NONE,
    stop_phase=StopPhase.IDLE,
    lease_holder="first",
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
    target_speed_mps=0.0,
    target_angle_deg=0.0,
    output_speed_mps=0.0,
    output_angle_deg=7.0,
    output_gear=GearPosition.NEUTRAL,
    brake_pedal_percent=0.0,
    parking=False,
)
HEALTH = GatewayHealth(
    time_ns=1,
    sequence=0,
    gateway_version="0.1.0",
    uptime_s=12.0,
    bus="can0",
    bus_up=True,
    bus_detail="",
    bus_losses=0,
    bus_drops=0,
    controller=ControllerState.UNKNOWN,
    zenoh_peers=1,
    publish_failures=0,
    inbox_drops=0,
    variant=Variant.COARSE,
    frames=630,
    frames_per_s=630.0,
    faults={"checksum": 0},
    unknown_identifiers={},
    feedback=[
        FrameHealth(
            name="Auto_GearFeedBack",
            rate_hz=100,
            valid=99,
            lost=0,
            withheld=0,
            checksum_faults=0,
            implausible=0,
            silent=False,
            alive_faults=0,
            failures=[],
        )
    ],
    tick_lateness_p50_ms=0.1,
    tick_lateness_p99_ms=0.2,
    tick_lateness_max_ms=0.3,
    tick_lateness_worst_ms=0.4,
    cpu_percent=5.0,
)


def free_endpoint() -> str:
    """A TCP endpoint of this machine that nobody listens on, nor on the port after it: a gateway takes both."""
    while True:
        with socket.socket() as probe, socket.socket() as after:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
            with suppress(OSError, OverflowError):
                after.bind(("127.0.0.1", port + 1))
                return f"tcp/127.0.0.1:{port}"


@dataclass
class FakeGateway:
    """A gateway that says what it is told to say."""

    robot: str
    listen: str = field(default_factory=free_endpoint)
    connect: str = ""
    token: bool = True
    caches_health: bool = False
    """Zenoh keeps its last health and gives it to whoever asks for the history, whatever became of the gateway."""

    def __enter__(self) -> Self:
        connect = [self.connect] if self.connect else []
        self._session = open_session(ZenohSettings(), connect, [self.listen])
        if self.token:
            # Zenoh takes a token back when nothing refers to it any more.
            self._token = self._session.liveliness().declare_token(keys.liveliness(ROOT, self.robot))
        if self.caches_health:
            subject = BY_TYPE[GatewayHealth]
            self._health = ext.declare_advanced_publisher(
                self._session,
                keys.build(ROOT, self.robot, subject),
                encoding=subject.encoding,
                cache=ext.CacheConfig(1),
                publisher_detection=True,
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        close_session(self._session)

    def say(self, message: Message, encoding: str = "") -> None:
        """Publish a state or a health."""
        if self.caches_health and isinstance(message, GatewayHealth):
            self._health.put(codec.encode(message))
            return
        subject = BY_TYPE[type(message)]
        key = keys.build(ROOT, self.robot, subject)
        self._session.put(key, codec.encode(message), encoding=encoding or subject.encoding)

    def say_raw(self, name: str, payload: bytes, encoding: str) -> None:
        """Publish bytes under a subject's name."""
        self._session.put(f"{ROOT}/{self.robot}/{name}", payload, encoding=encoding)

    def peers(self) -> list[Any]:
        """Who is connected."""
        return list(self._session.info.peers_zid())
