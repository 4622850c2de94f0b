"""An arbiter with a chassis that follows at once; no frames, no bus.

A row begins with "ready", "engaged" or "driving SPEED [TICKS]", and settings of the command flow as "name:value".
Then "see NAME:VALUE ...": what the chassis shows from there on; "tick N"; "drive SPEED [TICKS]"; a verb, with "by
NAME" for another operator, and fields. A challenge that is a number was published so many ticks ago.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, Final

import msgspec

from gateway.chassis.port import Actuation, ChassisState
from gateway.choice.chassis import CHASSIS
from gateway.command.arbiter import Arbiter
from gateway.command.rulings import Credentials, Event, RawRequest, Ruling, TickOutcome, VerbAnswer
from schemas.cruiser import SPEED_TOP_MPS
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.requests import CHALLENGE_BYTES, Role
from schemas.settings import AuthoritySettings, CommandSettings, GatewaySettings, Settings
from schemas.subjects import BY_VERB
from tests.support.rigs.steps import Acted, Doing, fields_of, near, seen

MS = 1_000_000
LAMPS: Final = {(False, False): "dark", (True, True): "lit", None: "none"}

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
    return tick.to_bytes(CHALLENGE_BYTES)


class ArbiterRig(Acted):
    """Time, requests, and what the chassis shows.

    Attributes:
        changes: fields that differ from those of a chassis that follows at once.
        credentials: proven credentials of each request; None in open mode.
        told, shown_lamps, answers: output and indicators of each tick, and the replies, since "mark".
        before: what the last request leaves unchanged if it is refused.
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
        self.ruling = Ruling()
        self.before: object = None
        self._way_m = 0.0
        self.mark()
        self.tick(count=6)

    def mark(self) -> None:
        self.told = list[Actuation | None]()
        self.shown_lamps = list[str]()
        self.answers = list[VerbAnswer]()

    @property
    def chassis(self) -> ChassisState:
        """A chassis that follows the last tick's command."""
        told = self.arbiter.output.actuation
        chassis = msgspec.structs.replace(STANDING, total_mileage_km=1 + int(self._way_m) / 1000)
        if told is not None and told.enabled:
            chassis = msgspec.structs.replace(
                chassis,
                mode=Mode.AUTO,
                gear=GearPosition.PARK if told.parking else told.gear,
                brake=ParkingStatus.APPLIED if told.parking else ParkingStatus.RELEASED,
                speed_mps=told.speed_mps,
                wheel_speed_mps=told.signed_speed_mps,
                fastest_wheel_mps=told.speed_mps,
                turns=told.speed_mps > 0,
                angle_deg=told.angle_deg,
            )
        return msgspec.structs.replace(chassis, **self.changes)

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
            self.told.append(self.outcome.actuation)
            self.answers += self.outcome.answers
            lamps = [frame.values for frame in self.outcome.auxiliary if frame.name == "Auto_LightCmd"]
            of = (bool(lamps[0]["LeftIndicator"]), bool(lamps[0]["RightIndicator"])) if lamps else None
            self.shown_lamps.append(LAMPS.get(of, "one"))
            requests = None
        assert self.outcome is not None
        return self.outcome

    def state(self) -> object:
        """The state that a refused request leaves unchanged."""
        arbiter = self.arbiter
        held = arbiter.leases.held
        return arbiter.state, arbiter.setpoint.target, dict(arbiter.latches.details), held and held.id

    def challenge(self, ticks_ago: int = 0) -> bytes:
        return challenge_of(self.arbiter.tick_number - ticks_ago)

    def send(
        self, verb: str, payload: bytes, operator: str = "first", *, handle: int = 1, size: int | None = None
    ) -> Ruling:
        length = len(payload) if size is None else size
        raw = RawRequest(handle, verb, operator, payload, length, credentials=self.credentials)
        self.before = self.state()
        self.ruling = self.tick([raw]).judged[0].ruling
        return self.ruling

    def fields(self, verb: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Add the rig's lease and the newest challenge, unless the request names others."""
        if isinstance(ticks_ago := fields.get("challenge"), int):
            fields = fields | {"challenge": self.challenge(ticks_ago)}
        if verb not in {"acquire", "take", "stop"}:
            fields = {"lease": self.lease} | fields
        return {"challenge": self.challenge()} | fields if verb == "engage" else fields

    def ask(self, verb: str, operator: str = "first", **fields: Any) -> Ruling:  # noqa: ANN401 - any field
        """A query; a lease that it grants is the rig's from there on."""
        ruling = self.send(verb, msgspec.msgpack.encode(self.fields(verb, fields)), operator)
        if verb in {"acquire", "take"} and ruling.lease is not None:
            self.lease, self.sequence = ruling.lease, 0
        return ruling

    def drive(self, speed_mps: float = 0.0, **fields: Any) -> Ruling:  # noqa: ANN401 - any field
        self.sequence += 1
        own = {"seq": self.sequence, "challenge": 0, "speed_mps": speed_mps, "angle_deg": 0.0}
        return self.send("drive", msgspec.msgpack.encode(self.fields("drive", own | fields)), handle=0)

    def engage(self) -> None:
        self.play("acquire; engage; tick 2; drive; unpark")

    def drive_for(self, ticks: int, speed_mps: float, **fields: Any) -> None:  # noqa: ANN401 - any field
        for _ in range(ticks):
            self.drive(speed_mps, **fields)

    def events_of(self, kind: EventKind | str) -> list[Event]:
        return [event for event in self.events if event.kind is EventKind(kind)]

    # Rows.

    def _see(self, *words: str) -> None:
        before = self.chassis if words else ChassisState()
        after = seen(before, words)
        fields = {word.partition(":")[0] for word in words}
        fields |= {"speed_mps", "wheel_speed_mps", "fastest_wheel_mps"} if "all" in fields else set()
        self.changes = {name: getattr(after, name) for name in fields - {"all"}}

    def _verb(self, verb: str, *words: str) -> None:
        operator = words[1] if words[:1] == ("by",) else "first"
        self.ask(verb, "" if operator == "nobody" else operator, **fields_of(words))

    def _drive(self, *words: str) -> None:
        plain = [word for word in words if ":" not in word]
        fields = {"speed_mps": float(plain[0]) if plain else 0.0} | fields_of(words)
        self.drive_for(int(plain[1]) if plain[1:] else 1, **fields)

    def _late(self, late_ms: str, *, is_told: str = "") -> None:
        """The loop was paused for this long; with ``is_told`` its burst was sent."""
        self.now_ns += int(late_ms) * MS
        if is_told:
            self.arbiter.output.told_ns = self.now_ns
        self.tick(late_ns=0 if is_told else int(late_ms) * MS)

    def _until(self, *claim: str) -> None:
        while not self.holds(*claim):
            self.tick()

    def _together(self, *words: str) -> None:
        raws = []
        for handle, one in enumerate(" ".join(words).split(" + ")):
            verb, *more = one.split()
            payload = msgspec.msgpack.encode(self.fields(verb, fields_of(tuple(more))))
            raws.append(RawRequest(handle + 1, verb, more[1] if more[:1] == ["by"] else "first", payload, 40))
        reasons = [judged.ruling.reason.value for judged in self.tick(raws).judged]
        self.ruling = Ruling(detail=" ".join(reasons))

    def _grant(self, *words: str) -> None:
        fields = fields_of(words)
        reason, role = Reason(fields.pop("reason", "none")), Role(fields.pop("role", "operator"))
        self.credentials = Credentials(reason, role=role, **fields)

    def _bar(self, *words: str) -> None:
        self.arbiter.engagement.bars = {Reason(words[0]): " ".join(words[1:])} if words else {}

    def _detail(self, *words: str) -> None:
        assert self.ruling.detail.replace(";", "|") == " ".join(words), self.ruling

    def _text(self, kind: str, *words: str) -> None:
        texts = [event.text.replace(";", "|") for event in self.events_of(kind)]
        assert texts[-1].endswith(" ".join(words)), texts

    def _say(self, reason: str, *words: str) -> None:
        latches = {one.value: detail for one, detail in self.arbiter.latches.details.items()}
        assert latches[reason].replace(";", "|") == " ".join(words), latches

    def steps(self) -> Doing:
        arbiter = self.arbiter
        verbs: dict[str, Callable[..., object]] = {
            verb: (lambda *words, verb=verb: self._verb(verb, *words)) for verb in BY_VERB
        }
        own: dict[str, Callable[..., object]] = {
            "see": self._see,
            "tick": lambda count="1": self.tick(count=int(count)),
            "drive": self._drive,
            "late": self._late,
            "told": lambda late_ms: self._late(late_ms, is_told="yes"),
            "until": self._until,
            "together": self._together,
            "grant": self._grant,
            "bar": self._bar,
            "mark": self.mark,
            "hold": lambda ticks: self.play("; ".join(["renew; tick 99"] * (int(ticks) // 100))),
            "fails": lambda count: setattr(arbiter.monitor, "send_failures", int(count)),
            "undo": arbiter.output.undo_step,
            "refuse": lambda: arbiter.engagement.refuse_output("why", self.now_ns),
            "shutdown": lambda: arbiter.engagement.shut_down(self.now_ns),
            "lose": lambda reason: arbiter.end_lease(Reason(reason), "by list 1", self.now_ns),
            "detail": self._detail,
            "text": self._text,
            "latch": self._say,
        }
        return verbs | own

    def claims(self) -> Doing:
        arbiter, ruling = self.arbiter, self.ruling
        engagement, output, setpoint = arbiter.engagement, arbiter.output, arbiter.setpoint
        told, held = output.actuation, arbiter.leases.held
        spoken = [one for one in self.told if one is not None]
        speeds = [one.speed_mps for one in spoken]

        def event(kind: str, reason: str, *severity: str) -> bool:
            last = self.events_of(kind)[-1:]
            return [(one.reason.value, one.severity.value)[: 1 + len(severity)] for one in last] == [
                (reason, *severity)
            ]

        return {
            **{state.value: lambda state=state: arbiter.state is state for state in ArbiterState},
            "for": lambda reason: engagement.stop_reason.value == reason,
            "has": lambda reason: reason in [one.value for one in arbiter.latches.details],
            "latched": lambda *reasons: [one.value for one in arbiter.latches.details] == [*reasons],
            "phase": lambda phase: output.stop_phase.value == phase,
            "limit": lambda speed_mps: near(setpoint.limits.speed_mps, speed_mps),
            "target": lambda speed_mps, angle_deg="0": (
                near(setpoint.target.speed_mps, speed_mps) and near(setpoint.target.angle_deg, angle_deg)
            ),
            "bound": lambda bound: bound in [one.value for one in output.motion.bounds],
            "fresh": lambda: arbiter.link.fresh_ns == self.now_ns,
            "fails": lambda count: arbiter.monitor.send_failures == int(count),
            # The output, now and since "mark".
            "silent": lambda: told is None,
            "cut_off": lambda: arbiter.handover.is_cut_off,
            "told": lambda speed_mps: told is not None and near(told.speed_mps, speed_mps, 1e-3),
            "below": lambda speed_mps: told is not None and told.speed_mps < float(speed_mps),
            "gear": lambda gear: told is not None and told.gear.value == gear,
            "angle": lambda angle_deg: told is not None and near(told.angle_deg, angle_deg),
            "enabled": lambda: told is not None and told.enabled,
            "parking": lambda: told is not None and told.parking,
            "quiet": lambda: not spoken,
            "spoken": lambda: len(spoken) == len(self.told),
            "speechless": lambda: not any(speeds),
            "braked": lambda: all(one.parking for one in spoken),
            "falling": lambda most_mps="9": all(
                -1e-9 <= before - after <= float(most_mps) + 1e-9 for before, after in pairwise(speeds)
            ),
            "lamps": lambda *which: {*self.shown_lamps} == {*which},
            "lit": lambda: "lit" in self.shown_lamps,
            "dark": lambda: next(one for one in self.shown_lamps if one != "none") == "dark",
            "beside": lambda *names: (
                self.outcome is not None
                and [frame.name for frame in self.outcome.auxiliary] == [f"Auto_{name}Cmd" for name in names]
            ),
            # Messages.
            "ruled": lambda reason: ruling.reason.value == reason,
            "refused": lambda reason: ruling.reason.value == reason and self.state() == self.before,
            "pending": lambda: ruling.is_pending,
            "age": lambda age_ms: ruling.age_ns == (None if age_ms == "none" else int(age_ms) * MS),
            "lasts": lambda seconds: ruling.expires_ns == float(seconds) * 1e9,
            "own": lambda: ruling.lease == self.lease,
            "held": lambda operator, role="operator": (
                held is not None and (held.operator, held.role.value) == (operator, role)
            ),
            "free": lambda: held is None,
            "answered": lambda *words: (
                [word for one in self.answers for word in (one.verb, one.ruling.reason.value)] == [*words]
            ),
            "event": event,
            "events": lambda kind, *reasons: [one.reason.value for one in self.events_of(kind)] == [*reasons],
            "by": lambda kind, operator: self.events_of(kind)[-1].operator == operator,
        }

    def shown(self) -> object:
        return self.ruling, self.arbiter.output.actuation, self.arbiter.latches.details, self.events[-3:]


def begun(begin: str) -> ArbiterRig:
    how, *words = begin.split()
    settings = {"speed_limit_mps": SPEED_TOP_MPS} | fields_of(tuple(words))
    unguarded = settings.pop("unguarded", False)
    credentials = Credentials(Reason.NONE, role=Role.OPERATOR) if settings.pop("signed", False) else None
    rig = ArbiterRig(CommandSettings(**settings), accept_unguarded=unguarded, credentials=credentials)
    if unguarded:
        rig.changes = {"guarded": False}
    if how != "ready":
        rig.engage()
        assert rig.arbiter.state is ArbiterState.ENGAGED
    if how == "driving":
        plain = [word for word in words if ":" not in word]
        rig.drive_for(int(plain[1]) if plain[1:] else 150, float(plain[0]))
    return rig


def play(row: str) -> None:
    begin, _, steps = row.partition(";")
    rig = begun(begin)
    rig.mark()
    rig.play(steps)
