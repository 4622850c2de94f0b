"""A robot that serves commands: the real command flow on Zenoh. Its chassis does at once what it is told."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Self

import msgspec
import zenoh
from zenoh import ext

from gateway.chassis.port import ChassisState
from gateway.choice.chassis import CHASSIS
from gateway.client.robot import Lease, Robot
from gateway.command.flow import CommandFlow
from gateway.command.rulings import RawRequest
from schemas import codec, keys
from schemas.codec import Sample
from schemas.decisions import ArbiterState, Decision, SafetyEvent, SafetyState
from schemas.messages import GatewayHealth, GearPosition, Message, Mode, ParkingStatus, RobotState
from schemas.reasons import Reason
from schemas.settings import TICK_NS, CommandSettings, Settings, ZenohSettings
from schemas.subjects import BY_NAME, BY_TYPE, BY_VERB
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, ROOT, STATE
from tests.support.processes.busy import PATIENT_DEADMAN_S
from tests.support.rigs.arbiter import STANDING

PATIENT = Settings(command=CommandSettings(deadman_s=PATIENT_DEADMAN_S))

_SIGN = {GearPosition.DRIVE: 1.0, GearPosition.REVERSE: -1.0}


def message_of(sample: Sample) -> Message | codec.PayloadFault:
    return codec.decode(BY_NAME[sample.subject], sample.payload)


def settings_for(endpoint: str) -> Settings:
    return Settings(zenoh=ZenohSettings(connect=[endpoint]))


@dataclass(repr=False)
class FakeRobot:
    """A robot with failure knobs.

    Attributes:
        loose: its parking brake never reads applied once it was released.
        mode: what the chassis reads; None is what it was commanded.
        now_ns: its monotonic clock: one tick per tick of its loop.
        moves_mps: how fast its wheels turn, whatever the command; None if they follow it.
    """

    name: str = "cruiser-1"
    listen: str = field(default_factory=free_endpoint)
    connect: str = ""
    token: bool = True
    deaf: bool = False
    mute: bool = False
    front_bumper: bool = False
    loose: bool = False
    health: GatewayHealth = HEALTH
    mode: Mode | None = None
    settings: Settings = PATIENT
    moves_mps: float | None = None
    decisions: list[Decision] = field(default_factory=list)
    said: list[SafetyState] = field(default_factory=list)
    puts: list[str] = field(default_factory=list)

    def __enter__(self) -> Self:
        session = open_session(ZenohSettings(), [self.connect] if self.connect else [], [self.listen])
        self._session = session
        if self.token:
            self._token = session.liveliness().declare_token(keys.liveliness(ROOT, self.name))
        everything = keys.command(ROOT, self.name, keys.ALL, keys.ALL)
        self._queries = session.declare_queryable(everything, zenoh.handlers.RingChannel(64), complete=True)
        self._samples = session.declare_subscriber(everything, zenoh.handlers.RingChannel(256))
        event = BY_NAME["safety/event"]
        self._event_publisher = ext.declare_advanced_publisher(
            session,
            keys.build(ROOT, self.name, event),
            encoding=event.encoding,
            cache=ext.CacheConfig(100),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.2, sporadic_heartbeat=None),
            publisher_detection=True,
        )
        self._waiting: dict[int, Any] = {}
        self._handle = 0
        self._mileage_km = 1.0
        self.now_ns = time.monotonic_ns()
        self.flow = CommandFlow(CHASSIS, self.settings, run=self.now_ns)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._waiting.clear()
        close_session(self._session)

    @property
    def there(self) -> Settings:
        return settings_for(self.listen)

    def seen_by(self, operator: str = "first") -> Robot:
        return Robot.connect(self.name, operator, self.there, timeout_s=20)

    @contextmanager
    def engaged(self) -> Iterator[tuple[Robot, Lease]]:
        """The first operator has the lease of an engaged robot whose brake is released."""
        with self.seen_by() as robot, robot.lease() as lease:
            lease.engage()
            lease.unpark()
            yield robot, lease

    @property
    def latched(self) -> set[Reason]:
        return set(self.flow.arbiter.latches.details)

    @property
    def state(self) -> ArbiterState:
        return self.flow.arbiter.state

    @property
    def speed_mps(self) -> float:
        """The commanded speed; forward is positive."""
        return self._told()[0]

    @property
    def angle_deg(self) -> float:
        """The commanded angle; left is positive."""
        told = self.flow.arbiter.output.actuation
        return told.angle_deg if told is not None else 0.0

    def has_heard(self, puts: int) -> bool:
        return len(self.puts) >= puts

    def accepted(self, verb: str) -> list[Decision]:
        return [one for one in list(self.decisions) if one.request == verb and one.verdict.value == "accepted"]

    def refused(self, verb: str) -> list[Decision]:
        return [one for one in list(self.decisions) if one.request == verb and one.verdict.value == "refused"]

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._closing.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + TICK_NS / 1e9, time.monotonic())
            # A busy machine holds up its operators too: the time in which nobody could act does not pass for it.
            now_ns = self.now_ns = self.now_ns + TICK_NS
            due = self.flow.tick(self._chassis_state(), self._requests(), now_ns, time.time_ns(), 0, os.urandom(8))
            samples = [*due.samples, *self.flow.sent(len(due.frames), now_ns, time.time_ns())]
            messages = [read for one in samples if isinstance(read := message_of(one), Message)]
            # Before anybody hears of them: who has the reply may ask at once what was decided.
            self.decisions += [message for message in messages if isinstance(message, Decision)]
            for reply in due.replies:
                query, key = self._waiting.pop(reply.handle)
                command = BY_VERB.get(reply.verb, BY_VERB["stop"])
                with query:  # Else who asked would wait for others who answer.
                    query.reply(key, reply.payload, encoding=command.reply_encoding)
            for message in [*messages, self.health]:
                self._publish(message)
            if self.flow.arbiter.tick_number % 5 == 0:
                self._publish(self._chassis())

    def _requests(self) -> list[RawRequest]:
        requests: list[RawRequest] = []
        while (query := self._queries.try_recv()) is not None:
            if self.deaf:
                continue
            operator, verb = keys.parse_command(str(query.key_expr))
            payload = query.payload.to_bytes() if query.payload is not None else b""
            self._handle += 1
            self._waiting[self._handle] = query, keys.command(ROOT, self.name, operator, verb)
            requests.append(RawRequest(self._handle, verb, operator, payload, len(payload)))
        while (sample := self._samples.try_recv()) is not None:
            operator, verb = keys.parse_command(str(sample.key_expr))
            self.puts.append(verb)
            payload = sample.payload.to_bytes()
            requests.append(RawRequest(0, verb, operator, payload, len(payload)))
        return requests

    def _told(self) -> tuple[float, GearPosition]:
        told = self.flow.arbiter.output.actuation
        if told is None:
            return 0.0, GearPosition.NEUTRAL
        return told.speed_mps * _SIGN.get(told.gear, 0.0), told.gear

    def _chassis_state(self) -> ChassisState:
        told = self.flow.arbiter.output.actuation
        speed_mps, gear = self._told()
        if self.flow.arbiter.auxiliary.is_clearing:
            self._mileage_km = 0.0
        obeys = told is not None and told.enabled
        parked = told is None or (told.parking and not self.loose)
        return msgspec.structs.replace(
            STANDING,
            mode=self.mode or (Mode.AUTO if obeys else Mode.STOP),
            gear=GearPosition.PARK if parked else gear,
            brake=ParkingStatus.APPLIED if parked else ParkingStatus.RELEASED,
            speed_mps=abs(speed_mps),
            wheel_speed_mps=speed_mps,
            fastest_wheel_mps=abs(speed_mps),
            turns=bool(speed_mps),
            angle_deg=told.angle_deg if told is not None else 0.0,
            front_bumper=self.front_bumper,
            total_mileage_km=self._mileage_km,
        )

    def _chassis(self) -> RobotState:
        speed_mps = self._told()[0] if self.moves_mps is None else self.moves_mps
        return msgspec.structs.replace(
            STATE, speed_mps=speed_mps, rear_left_speed_mps=speed_mps, rear_right_speed_mps=speed_mps
        )

    def _publish(self, message: Message) -> None:
        if self.mute:
            return
        if isinstance(message, SafetyState):
            self.said.append(message)
            subject = BY_NAME["safety/state"]
            self._session.put(
                keys.build(ROOT, self.name, subject), codec.encode(message), encoding=subject.encoding
            )
        elif isinstance(message, SafetyEvent):
            self._event_publisher.put(codec.encode(message))
        elif isinstance(message, GatewayHealth | RobotState):
            subject = BY_TYPE[type(message)]
            self._session.put(
                keys.build(ROOT, self.name, subject), codec.encode(message), encoding=subject.encoding
            )
