"""The newest samples of robots and recorders, a word for each robot, and texts for people. Pure.

A report contains no outdated state or health.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

import msgspec
from rich.text import Text

from gateway.client.refusal import is_idle, last_stop, link_line
from gateway.telemetry.samples import Arrival, Missed, Received, TokenChange
from schemas import codec, keys
from schemas.codec import PayloadFault, encoding_fault
from schemas.command_line import plain
from schemas.decisions import COMMANDING, ArbiterState, LeaseReply, Reply, SafetyState
from schemas.messages import GatewayHealth, Message, Mode, RobotState
from schemas.reasons import Reason
from schemas.recording import RecorderHealth
from schemas.settings import STANDSTILL_MPS
from schemas.subjects import COMMANDS, Command

BY_REQUEST: Final = {command.request: command for command in COMMANDS}

THIS_SIDE: Final = "this program"  # the reader, in texts about other versions
encode_request: Final = msgspec.msgpack.Encoder().encode  # a request's MessagePack bytes


CONTRADICTION: Final = "the replies contradict each other: another gateway of this name, or an impostor, is there"


def contradict(replies: list[Reply | PayloadFault]) -> bool:
    """Return True if replies to one query differ in more than their texts."""
    return len({_essence(reply) for reply in replies}) > 1


def _essence(reply: Reply | PayloadFault) -> tuple[object, ...]:
    if isinstance(reply, PayloadFault):
        return ()
    return reply.ok, reply.reason, reply.lease if isinstance(reply, LeaseReply) else 0


def read_reply(command: Command, received: Received) -> Reply | PayloadFault:
    """Return the typed reply, or what is wrong with it."""
    if received.encoding != command.reply_encoding:
        fault = encoding_fault(received.encoding, command.reply_encoding, THIS_SIDE, "the robot's gateway")
        return PayloadFault(f"the reply is {fault}")
    read = codec.understand(command.reply, received.payload)
    return (
        PayloadFault(f"the reply cannot be read: {read.detail}")
        if isinstance(read, PayloadFault)
        else read.message
    )


class SampleRead(msgspec.Struct, frozen=True, gc=False):
    """A sample of a robot or a recorder."""

    parts: keys.KeyParts
    message: Message | PayloadFault  # what it says, or why that cannot be read
    unknown: tuple[str, ...] = ()  # what in it a newer version says and this one does not know


def read_sample(received: Received) -> SampleRead | None:
    """Read a sample; None if its key belongs to no robot or recorder."""
    parts = keys.parse(received.key)
    if parts is None:
        return None
    subject = parts.subject
    if received.encoding != subject.encoding:
        sender = "the recorder" if parts.recorder else "the robot's gateway"
        fault = encoding_fault(received.encoding, subject.encoding, THIS_SIDE, sender)
        return SampleRead(parts, PayloadFault(f"{subject.name} is {fault}"))
    read = codec.understand(subject.type, received.payload)
    if isinstance(read, PayloadFault):
        return SampleRead(parts, PayloadFault(f"{subject.name}: {read.detail}"))
    return SampleRead(parts, read.message, tuple(f"{subject.name}: {one}" for one in read.unknown))


NEWER_WORDS_MAX: Final = 4  # unknown words of a sender that are shown
STATE_STALE_NS: Final = 1_000_000_000  # a state, due every 50 ms, is no longer shown after 1 s
HEALTH_STALE_NS: Final = 3_500_000_000  # health is due every second; two may be lost

STALE_NS: Final[dict[type[Message], int]] = {
    GatewayHealth: HEALTH_STALE_NS,
    SafetyState: STATE_STALE_NS,
    RobotState: STATE_STALE_NS,
    RecorderHealth: HEALTH_STALE_NS,
}
"""Messages whose newest is stored, and the age from which it is outdated."""

M = TypeVar("M", bound=Message)


class Bounds(msgspec.Struct, frozen=True):
    """Limits of what is stored. Any client can publish any number of names, and samples of any size."""

    robots: int = 10_000  # robots, recorders: limits; the first ones stay
    recorders: int = 0
    name_length: int = keys.KEY_MAX_LENGTH  # a longer name counts as one too many
    sample_bytes: int = 1 << 20  # a larger sample is ignored
    forgotten_ns: int = 60_000_000_000  # after this silence a robot without a token may go


class RobotStatus(msgspec.Struct, frozen=True):
    """A robot at one moment.

    Attributes:
        connected: its liveliness token is there, which is no proof of health.
        state, safety, health: the newest; null if outdated or never received.
        unreadable: why the newest unreadable sample could not be read; empty if none.
        newer: unknown words of a newer version; empty if none.
    """

    robot: str
    connected: bool
    state: RobotState | None
    state_age_s: float | None
    health: GatewayHealth | None
    health_age_s: float | None
    unreadable: str
    linked: bool
    safety: SafetyState | None = None
    newer: str = ""


def alarm(report: RobotStatus) -> str:
    """Return why there is no state to show; empty if there is one."""
    if report.state is not None:
        return ""
    reasons = []
    if not report.linked:
        reasons.append("this end is not connected to Zenoh")
    elif not report.connected:
        reasons.append("its gateway is not connected")
    elif report.health is None:
        reasons.append("its gateway is connected, but sends no health")
    else:
        reasons.append("its gateway is connected and sends health")
    if report.unreadable:
        reasons.append(f"unreadable: {plain(report.unreadable)}")
    what = "no state yet" if report.state_age_s is None else f"no contact for {_duration(report.state_age_s)}"
    return f"{what}; {', '.join(reasons)}"


def _duration(seconds: float) -> str:
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


class Source:
    """The newest samples of a robot or a recorder.

    Attributes:
        unreadable: why the last sample could not be read; empty if it could.
    """

    def __init__(self) -> None:
        self.connected = False
        self.heard_ns = 0
        self.unreadable = ""
        self._newer: set[str] = set()
        self._newest: dict[type[Message], tuple[Message, int]] = {}

    def receive(self, sample: SampleRead, now_ns: int) -> None:
        """Store a message; an unreadable one changes no value."""
        message = sample.message
        self._newer.update(sorted({*sample.unknown} - self._newer)[: NEWER_WORDS_MAX - len(self._newer)])
        if isinstance(message, PayloadFault):
            self.unreadable = message.detail
            return
        self.unreadable = ""
        self._newest[type(message)] = message, now_ns

    @property
    def newer(self) -> str:
        """The unknown words of a newer version, as text; empty if there are none."""
        words = ", ".join(sorted(self._newer))
        return (
            f"{THIS_SIDE} does not know words of a newer version ({words}): upgrade {THIS_SIDE}" if words else ""
        )

    def fresh(self, kind: type[M], now_ns: int) -> M | None:
        """Return the newest message of a class; None if there is none, or it is outdated."""
        message, at_ns = self._newest.get(kind, (None, 0))
        return message if isinstance(message, kind) and now_ns - at_ns < STALE_NS[kind] else None

    def age_s(self, kind: type[Message], now_ns: int) -> float | None:
        return (now_ns - self._newest[kind][1]) / 1e9 if kind in self._newest else None


class Sources:
    """All robots, or all recorders. ``refused`` counts samples of names beyond the limit."""

    def __init__(self, most: int, bounds: Bounds) -> None:
        self.refused = 0
        self._most = most
        self._bounds = bounds
        self._refused_before = 0
        self._known: dict[str, Source] = {}

    def __getitem__(self, name: str) -> Source:
        """Return the source of a name; an empty one if unknown."""
        return self._known.get(name) or Source()

    def find(self, name: str, now_ns: int) -> Source | None:
        """Return the source of a name, new or known; None beyond the limit."""
        source = self._known.get(name)
        if source is None:
            if len(self._known) >= self._most or len(name) > self._bounds.name_length:
                self.refused += 1
                return None
            source = self._known[name] = Source()
        source.heard_ns = now_ns
        return source

    def names(self, now_ns: int, forgets: Callable[[str], object] = lambda _name: False) -> list[str]:
        """Return the known names in natural order.

        ``forgets`` decides for each silent name whether it may go; all go when another name was refused.
        """
        is_full, self._refused_before = self.refused > self._refused_before, self.refused
        self._known = {
            name: source
            for name, source in self._known.items()
            if source.connected
            or now_ns - source.heard_ns < self._bounds.forgotten_ns
            or not (is_full or forgets(name))
        }
        return sorted(self._known, key=keys.in_order)


class Fleet:
    """All robots and recorders under a root.

    Attributes:
        linked: connected to Zenoh. Without a link tokens say nothing.
    """

    def __init__(self, root: str, bounds: Bounds = Bounds()) -> None:  # noqa: B008 - it is frozen
        self.linked = True
        self.robots = Sources(bounds.robots, bounds)
        self.recorders = Sources(bounds.recorders, bounds)
        self._root = root
        self._sample_bytes = bounds.sample_bytes

    def receive(self, heard: Arrival, now_ns: int) -> SampleRead | None:
        """Store a sample or a token's change; return the sample that was read."""
        if isinstance(heard, Missed):
            return None  # A newer sample comes soon.
        if isinstance(heard, TokenChange):
            if (source := self.find(heard.key, now_ns)) is not None:
                source.connected = heard.present
            return None
        sample = None if len(heard.payload) > self._sample_bytes else read_sample(heard)
        if sample is None or sample.parts.subject.type not in STALE_NS:
            return None
        if (source := self.find(heard.key, now_ns)) is None:
            return None
        source.receive(sample, now_ns)
        return sample

    def find(self, key: str, now_ns: int) -> Source | None:
        """Return the robot or recorder of a key; None if there is none, or too many."""
        parts = keys.parse(key)
        if parts is None:
            robot = keys.robot_of_liveliness(self._root, key)
            return None if robot is None else self.robots.find(robot, now_ns)
        if parts.root != self._root:
            return None
        return (
            self.recorders.find(parts.recorder, now_ns)
            if parts.recorder
            else self.robots.find(parts.robot, now_ns)
        )

    def report(self, robot: str, now_ns: int) -> RobotStatus:
        known = self.robots[robot]
        return RobotStatus(
            robot=robot,
            connected=known.connected and self.linked,
            state=known.fresh(RobotState, now_ns),
            state_age_s=known.age_s(RobotState, now_ns),
            safety=known.fresh(SafetyState, now_ns),
            health=known.fresh(GatewayHealth, now_ns),
            health_age_s=known.age_s(GatewayHealth, now_ns),
            unreadable=known.unreadable,
            linked=self.linked,
            newer=known.newer,
        )


FINE: Final = 0
LOOK: Final = 1
ALARM: Final = 2  # the levels: nothing is wrong; somebody should look; it needs a person

WORDS: Final = {
    "offline": ALARM,
    "needs_reset": ALARM,
    "bus_down": ALARM,
    "stopping": LOOK,
    "remote_control": LOOK,
    "blocked": LOOK,
    "driving": FINE,
    "in_control": FINE,
    "ready": FINE,
    "telemetry": FINE,
}
"""Words for a robot's condition, worst first, with their levels. ``telemetry``: no arbiter."""

OFFLINE: Final = "offline"

# words as shown, where they differ
LABELS: Final = {"needs_reset": "stopped - needs reset", "telemetry": "telemetry only"}

# words after a number: singular and plural
COUNTED: Final = {"needs_reset": ("needs reset", "need reset"), "telemetry": ("telemetry only", "telemetry only")}


def word_of(report: RobotStatus) -> tuple[str, list[Reason]]:
    state, safety = report.state, report.safety
    if state is None:
        return OFFLINE, []
    if not state.bus_up:
        return "bus_down", [Reason.BUS_DOWN]
    return ("telemetry", []) if safety is None else _word_of_arbiter(state, safety)


def _word_of_arbiter(state: RobotState, safety: SafetyState) -> tuple[str, list[Reason]]:
    if safety.latched:
        return "needs_reset", safety.latched
    if safety.state is ArbiterState.STOPPING:
        return "stopping", [safety.stop_reason]
    if state.mode is Mode.REMOTE:
        return "remote_control", [Reason.HAND_TRANSMITTER]
    if safety.state in COMMANDING:
        moves = state.speed_mps is not None and abs(state.speed_mps) >= STANDSTILL_MPS
        return "driving" if moves else "in_control", []
    blocked = [one for one in safety.blocked_by if not is_idle([one])]
    if blocked:
        return "blocked", blocked
    return "in_control" if safety.lease_holder else "ready", []


def label_of(word: str) -> str:
    return LABELS.get(word, word.replace("_", " "))


def summary(reports: Sequence[RobotStatus]) -> str:
    """Return the counts of all words, such as ``52 ready, 6 driving, 2 need reset, 1 offline``."""
    words = Counter(word_of(report)[0] for report in reports)
    counted = (
        f"{words[word]} {COUNTED.get(word, (label_of(word), label_of(word)))[words[word] > 1]}"
        for word in reversed(WORDS)
        if words[word]
    )
    return ", ".join(counted)


GOOD: Final = "green"
BAD: Final = "bold red"
LOUD: Final = "bold white on red"
PLAIN: Final = ""

NO_VALUE: Final = "--"  # a value that is not known: never seen, or silent


class Fact(msgspec.Struct, frozen=True):
    """A label and a value to show."""

    label: str
    text: str
    is_bad: bool = False


def state_facts(state: RobotState) -> list[Fact]:
    hit = [side for side, on in (("front", state.front_bumper), ("rear", state.rear_bumper)) if on]
    unknown = state.front_bumper is None or state.rear_bumper is None
    lamps = {
        "headlamp": state.headlamp,
        "left": state.left_indicator,
        "right": state.right_indicator,
        "horn": state.horn,
    }
    lit = ", ".join(name for name, on in lamps.items() if on) or "off"
    return [
        Fact("mode", state.mode.value),
        Fact("gear", state.gear_position.value),
        Fact("speed", _number(state.speed_mps, "+z.2f", "m/s")),
        Fact("angle", _number(state.angle_deg, "+z.1f", "deg")),
        Fact("brake", state.braking_status.value),
        Fact("parking", state.parking_status.value),
        Fact("bumpers", f"{' and '.join(hit)} HIT" if hit else NO_VALUE if unknown else "clear", bool(hit)),
        Fact("lamps", NO_VALUE if {*lamps.values()} == {None} else lit),
        Fact("mileage", _number(state.total_mileage_km, ".3f", "km")),
        Fact("variant", state.variant.value, state.variant.value == "unknown"),
        Fact("bus", "up" if state.bus_up else "DOWN", not state.bus_up),
        Fact("silent", ", ".join(map(plain, state.silent)) or "none", bool(state.silent)),
    ]


def health_facts(health: GatewayHealth) -> list[Fact]:
    lost = sum(frame.lost for frame in health.feedback)
    faults = ", ".join(f"{plain(kind)} {count}" for kind, count in sorted(health.faults.items()) if count)
    bus = f"{plain(health.bus)} {'up' if health.bus_up else 'DOWN'}"
    if health.bus_detail and not health.bus_up:
        bus += f" ({plain(health.bus_detail)})"
    return [
        Fact("bus", bus),
        Fact("frames", f"{health.frames_per_s:.0f}/s, {lost} lost"),
        Fact("variant", health.variant.value),
        Fact("faults", faults or "none"),
        Fact("version", plain(health.gateway_version)),
        Fact("up", f"{health.uptime_s:.0f} s"),
        *([] if health.realtime else [Fact("real-time", "no")]),
    ]


def safety_facts(report: RobotStatus) -> list[Fact]:
    safety = report.safety
    if report.state is None or safety is None:
        return []
    latched = ", ".join(reason.value for reason in safety.latched)
    link, stop = link_line(safety), last_stop(safety)
    blocked_by = [reason for reason in safety.blocked_by if reason not in safety.latched]
    blocked = ", ".join(reason.value for reason in blocked_by)
    return [
        Fact("arbiter", safety.state.value),
        Fact("driver", plain(safety.lease_holder) or "none"),
        *([Fact("latched", latched, is_bad=True)] if latched else []),
        *([Fact("stopped by", plain(", ".join(safety.stopped_by)), is_bad=True)] if safety.stopped_by else []),
        *([Fact("blocked by", blocked, not is_idle(blocked_by))] if blocked else []),
        *([Fact("last stop", stop)] if stop else []),
        *([Fact("limit", f"{safety.speed_limit_mps:.2f} m/s")] if safety.state in COMMANDING else []),
        *([Fact("link", link)] if link else []),
    ]


def list_view(reports: Sequence[RobotStatus]) -> list[Text]:
    """Return a line per robot, with what needs attention below it; above several robots their summary."""
    lines = [Text(summary(reports))] if len(reports) > 1 else []
    for report in reports:
        lines.append(Text(_list_line(report), style=(PLAIN, BAD, LOUD)[WORDS[word_of(report)[0]]]))
        lines += [Text(f"  needs attention: {note}", style=BAD) for note in _attention(report)]
    return lines


def _list_line(report: RobotStatus) -> str:
    words = [report.robot]
    if report.state is None:
        words.append(f"OFFLINE: {alarm(report)}")
    else:
        words += [label_of(word_of(report)[0]), _number(report.state.speed_mps, "+z.2f", "m/s")]
        words += (
            [f"driver {plain(report.safety.lease_holder)}"] if report.safety and report.safety.lease_holder else []
        )
        words += [_word(fact) for fact in (*state_facts(report.state), *safety_facts(report)) if _is_news(fact)]
        words += [] if report.connected else ["no liveliness token"]
        words += ["no health"] if report.health is None else []
    words += [_word(fact) for fact in health_facts(report.health)] if report.health is not None else []
    return "  ".join([*words, *([plain(report.newer)] if report.newer else [])])


def _is_news(fact: Fact) -> bool:
    """Return True for a bad fact that ``_attention`` does not repeat."""
    return fact.is_bad and fact.label not in {"latched", "stopped by"}


def _attention(report: RobotStatus) -> list[str]:
    """Return everything that a person must deal with."""
    safety = report.safety
    latched = [] if safety is None else [reason.value.replace("_", " ") for reason in safety.latched]
    by = f" by {plain(', '.join(safety.stopped_by))}" if safety is not None and safety.stopped_by else ""
    notes = [f"{', '.join(latched)}{by}, reset required"] if latched else []
    return notes if report.health is None else [*notes, *map(plain, report.health.notes)]


def detail_view(report: RobotStatus) -> list[Text]:
    """Return the robot's line, then its facts, bad ones first: a small window cuts off the rest."""
    facts = []
    if report.state is not None:
        age = Fact("age of its state", f"{report.state_age_s or 0:.2f} s")
        facts = [age, *safety_facts(report), *state_facts(report.state)]
        facts.sort(key=lambda fact: not fact.is_bad)
    shown = [Text(f"  {_word(fact)}", style=BAD if fact.is_bad else PLAIN) for fact in facts]
    return [*list_view([report]), *shown]


def _word(fact: Fact) -> str:
    return fact.text if fact.label in {"speed", "angle"} else f"{fact.label} {fact.text}"


def _number(value: float | None, form: str, unit: str) -> str:
    return NO_VALUE if value is None else f"{value:{form}} {unit}"
