"""An arbiter with a chassis that follows at once; no frames, no bus."""

from typing import Any

import msgspec

from gateway.chassis.port import ChassisState
from gateway.choice import CHASSIS
from gateway.command.arbiter import Arbiter
from gateway.command.rulings import Credentials, Event, RawRequest, Ruling, TickOutcome
from schemas.cruiser import SPEED_TOP_MPS
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.requests import CHALLENGE_BYTES
from schemas.settings import AuthoritySettings, CommandSettings, GatewaySettings, Settings

MS = 1_000_000
Step = int | float | str | tuple[str, dict[str, Any]] | dict[str, Any]
"""Of a row of a table: ticks; a drive command at a speed; a verb, with fields; what the chassis shows."""

STANDING = ChassisState(
    bus_up=True,
    variant=Variant.COARSE,
    confirmed=True,
    mode=Mode.STOP,
    gear=GearPosition.PARK,
    brake=ParkingStatus.APPLIED,
    speed_mps=0.0,
    wheel_speed_mps=0.0,
    fastest_wheel_mps=0.0,
    turns=False,
    angle_deg=0.0,
    front_bumper=False,
    rear_bumper=False,
    total_mileage_km=1.0,
    guarded=True,
    realtime=True,
)


def challenge_of(tick: int) -> bytes:
    """The challenge that is published in a tick."""
    return tick.to_bytes(CHALLENGE_BYTES)


class ArbiterRig:
    """Time, requests, and what the chassis shows.

    Attributes:
        changes: fields that differ from those of a chassis that follows at once.
        credentials: what is proven of who asks; None in open mode.
    """

    def __init__(
        self,
        command: CommandSettings | None = None,
        *,
        accept_unguarded: bool = False,
        credentials: Credentials | None = None,
    ) -> None:
        self.arbiter = Arbiter(
            CHASSIS,
            Settings(
                command=command or CommandSettings(speed_limit_mps=SPEED_TOP_MPS),
                gateway=GatewaySettings(accept_unguarded=accept_unguarded),
                authority=AuthoritySettings(mode="open" if credentials is None else "signed"),
            ),
            7,
        )
        self.credentials = credentials
        self.now_ns = 0
        self.changes: dict[str, object] = {}
        self.outcome: TickOutcome | None = None
        self.events: list[Event] = []
        self.lease = 0
        self.sequence = 0
        self._way_m = 0.0
        self.tick(count=6)

    @property
    def chassis(self) -> ChassisState:
        """A chassis that obeys what it was told in the last tick."""
        told = self.arbiter.output.actuation
        seen = msgspec.structs.replace(STANDING, total_mileage_km=1 + int(self._way_m) / 1000)
        if told is not None and told.enabled:
            seen = msgspec.structs.replace(
                seen,
                mode=Mode.AUTO,
                gear=GearPosition.PARK if told.parking else told.gear,
                brake=ParkingStatus.APPLIED if told.parking else ParkingStatus.RELEASED,
                speed_mps=told.speed_mps,
                wheel_speed_mps=told.signed_speed_mps,
                fastest_wheel_mps=told.speed_mps,
                turns=told.speed_mps > 0,
                angle_deg=told.angle_deg,
            )
        return msgspec.structs.replace(seen, **self.changes)

    def tick(self, requests: list[RawRequest] | None = None, *, count: int = 1, late_ns: int = 0) -> TickOutcome:
        """Ticks; the requests come in the first."""
        for _ in range(count):
            self.now_ns += 10 * MS
            self.arbiter.link.challenges.publish(challenge_of(self.arbiter.tick_number), self.now_ns)
            self.outcome = self.arbiter.tick(self.chassis, requests or [], self.now_ns, late_ns)
            if self.outcome.actuation is not None:
                self._way_m += self.outcome.actuation.speed_mps * 0.01
                self.arbiter.output.told_ns = self.now_ns
            self.events += self.outcome.events
            requests = None
        assert self.outcome is not None
        return self.outcome

    def challenge(self, ticks_ago: int = 0) -> bytes:
        """The challenge that was published so many ticks ago."""
        return challenge_of(self.arbiter.tick_number - ticks_ago)

    def send(
        self, verb: str, payload: bytes, operator: str = "first", *, handle: int = 1, size: int | None = None
    ) -> Ruling:
        """A request by its bytes; its ruling."""
        length = len(payload) if size is None else size
        raw = RawRequest(handle, verb, operator, payload, length, credentials=self.credentials)
        return self.tick([raw]).judged[0].ruling

    def ask(self, verb: str, operator: str = "first", **fields: object) -> Ruling:
        """A query of the holder, with the bench's lease unless it names another."""
        if verb not in {"acquire", "take", "stop"}:
            fields = {"lease": self.lease} | fields
        if verb == "engage":
            fields = {"challenge": self.challenge()} | fields
        ruling = self.send(verb, msgspec.msgpack.encode(fields), operator)
        if verb in {"acquire", "take"} and ruling.lease is not None:
            self.lease, self.sequence = ruling.lease, 0
        return ruling

    def drive(self, speed_mps: float = 0.0, **fields: object) -> Ruling:
        """A drive command that echoes the newest challenge."""
        self.sequence += 1
        asked: dict[str, object] = {
            "lease": self.lease,
            "seq": self.sequence,
            "challenge": self.challenge(),
            "speed_mps": speed_mps,
            "angle_deg": 0.0,
        }
        return self.send("drive", msgspec.msgpack.encode(asked | fields), handle=0)

    def engage(self) -> None:
        self.ask("acquire")
        self.ask("engage")
        self.tick(count=2)
        self.drive()
        self.ask("unpark")

    def drive_for(self, ticks: int, speed_mps: float) -> None:
        for _ in range(ticks):
            self.drive(speed_mps)

    def play(self, *steps: Step) -> Ruling | None:
        """Take these steps; the ruling of the last one. "stop by second" is a verb of somebody else.

        A challenge that is a number is the one that was published so many ticks ago.
        """
        ruling = None
        for step in steps:
            ruling = None
            match step:
                case dict():
                    self.changes = step
                case int():
                    self.tick(count=step)
                case float():
                    ruling = self.drive(step)
                case str() | (str(), _):
                    asked, fields = (step, {}) if isinstance(step, str) else step
                    verb, _, operator = asked.partition(" by ")
                    if isinstance(ticks_ago := fields.get("challenge"), int):
                        fields = fields | {"challenge": self.challenge(ticks_ago)}
                    if verb == "drive":
                        ruling = self.drive(**fields)
                    else:
                        ruling = self.ask(verb, operator or "first", **fields)
        return ruling

    def told(self, kind: EventKind) -> list[Event]:
        return [event for event in self.events if event.kind is kind]


def engaged(**command: float) -> ArbiterRig:
    bench = ArbiterRig(CommandSettings(**{"speed_limit_mps": SPEED_TOP_MPS} | command))
    bench.engage()
    assert bench.arbiter.state is ArbiterState.ENGAGED
    return bench
