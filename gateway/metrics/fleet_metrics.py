"""The newest of each robot and recorder as metrics. Of a silent one nothing is shown but that it is silent."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Final

from prometheus_client import Metric
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

from gateway.client.fleet import HEALTH_STALE_NS, STATE_STALE_NS
from gateway.client.payloads import read_sample
from gateway.metrics.measures import COUNTER, INFO, LABELS_MAX, MEASURES, Measure, label_text
from gateway.telemetry.received import Arrival, Missed, Received
from schemas import keys
from schemas.codec import PayloadFault
from schemas.decisions import SafetyState
from schemas.messages import SEQUENCE_MAX, FrameHealth, GatewayHealth, Message, RobotState
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE
from schemas.versions import other_version

STALE_NS: Final[dict[type[Message], int]] = {
    GatewayHealth: HEALTH_STALE_NS,
    SafetyState: STATE_STALE_NS,
    RobotState: STATE_STALE_NS,
    RecorderHealth: HEALTH_STALE_NS,
}
"""The messages that become metrics. The values of one that is older than this are not shown."""

ROBOTS_MAX: Final = 1000

RECORDERS_MAX: Final = 100

NAME_MAX: Final = 64
"""Length of a robot's or a recorder's name; one with a longer name is refused like one too many."""

FORGOTTEN_NS: Final = 7 * 86_400 * 1_000_000_000
"""A robot or recorder that is silent for a week is forgotten."""

GAP_MAX: Final = 100_000
"""A step of the sequence by more is a sender that began anew, not a loss."""

DAMAGED: Final = "damaged"
UNREADABLE: Final = ("newer", "older", DAMAGED)
"""Why a sample cannot be read: its schema is of a newer or an older version than here, or it is damaged."""


class _Source:
    """A robot or a recorder, as far as it is known.

    Attributes:
        connected: its liveliness token is there.
        heard_ns: when anything of it came last.
        health_wall_s: when its health came last, seconds since 1970; 0 before the first.
        newest: of each class of messages, the newest, with the time before which it did not arrive.
        received, lost: samples by subject; those that are lost by the gaps in their sequence.
        unreadable: samples by subject, and why they cannot be read.
    """

    def __init__(self) -> None:
        self.connected = False
        self.heard_ns = 0
        self.health_wall_s = 0.0
        self.newest: dict[type[Message], tuple[Message, int]] = {}
        self.received: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.unreadable: Counter[tuple[str, str]] = Counter()
        self._next: dict[str, int] = {}

    def receive(self, subject: str, message: Message, since_ns: int) -> None:
        """Take in a message that did not arrive before this time."""
        self.newest[type(message)] = message, since_ns
        self.received[subject] += 1
        gap = (message.sequence - self._next.get(subject, message.sequence)) & SEQUENCE_MAX
        self.lost[subject] += gap if gap <= GAP_MAX else 0
        self._next[subject] = message.sequence + 1

    def fresh(self, kind: type[Message], now_ns: int) -> Message | None:
        """The newest message of a class; None if it is too old, or there was none."""
        message, since_ns = self.newest.get(kind, (None, 0))
        return message if now_ns - since_ns < STALE_NS[kind] else None


class _Sources:
    """All robots, or all recorders.

    Attributes:
        prefix: of the metrics that say whether they are there.
        label: of their names.
        kinds: the classes of their messages; the first is the health, without which they count as silent.
    """

    def __init__(self, prefix: str, label: str, most: int, *kinds: type[Message]) -> None:
        self.prefix = prefix
        self.label = label
        self.kinds = kinds
        self._most = most
        self._known: dict[str, _Source] = {}

    def find(self, name: str, now_ns: int) -> _Source | None:
        """The one of this name, known from now on; None if there are too many."""
        source = self._known.get(name)
        if source is None and (len(self._known) >= self._most or len(name) > NAME_MAX):
            return None
        source = self._known.setdefault(name, _Source())
        source.heard_ns = now_ns
        return source

    def forget(self, now_ns: int) -> None:
        """Leave out those that have been silent for too long."""
        self._known = {
            name: source
            for name, source in self._known.items()
            if source.connected or now_ns - source.heard_ns < FORGOTTEN_NS
        }

    def all(self) -> list[tuple[str, _Source]]:
        """Names and sources, in alphabetical order."""
        return sorted(self._known.items())


class FleetMetrics:
    """The samples of a fleet as metric families.

    Attributes:
        linked: this end is connected to Zenoh.
        certificate_ends_s: when its own certificate ends, seconds since 1970; None if it has none.
    """

    def __init__(self, root: str, version: str, certificate_ends_s: int | None = None) -> None:
        self.linked = False
        self.certificate_ends_s = certificate_ends_s
        self._root = root
        self._version = version
        self._robots = _Sources("cruiser", "robot", ROBOTS_MAX, GatewayHealth, SafetyState, RobotState)
        self._recorders = _Sources("cruiser_recorder", "recorder", RECORDERS_MAX, RecorderHealth)
        self._overruns = self._refused = 0

    def receive(self, heard: Arrival, since_ns: int, wall_s: float) -> None:
        """Take in a sample or a change of a token. What is nobody's is ignored; what cannot be read is counted.

        Args:
            heard: what arrived.
            since_ns: when was looked for arrivals before this time, monotonic: what waited while this process was
                held up may be as old as that.
            wall_s: now, seconds since 1970.
        """
        if isinstance(heard, Received):
            self._receive_sample(heard, since_ns, wall_s)
        elif isinstance(heard, Missed):
            self._overruns += 1
        elif (robot := keys.robot_of_liveliness(self._root, heard.key)) is not None:
            source = self._find(self._robots, robot, since_ns)
            if source is not None:
                source.connected = heard.present

    def families(self, now_ns: int) -> Iterator[Metric]:
        """All metrics as they are now."""
        self._robots.forget(now_ns)
        self._recorders.forget(now_ns)
        yield from self._own()
        connected = GaugeMetricFamily(
            "cruiser_gateway_connected",
            "The gateway's liveliness token is there, which is no proof of health.",
            labels=["robot"],
        )
        for robot, source in self._robots.all():
            connected.add_metric([robot], self.linked and source.connected)
        yield connected
        for sources in (self._robots, self._recorders):
            yield from _presence(sources, now_ns)
            for kind in sources.kinds:
                found = ((name, source.fresh(kind, now_ns)) for name, source in sources.all())
                messages = [(name, message) for name, message in found if message is not None]
                if kind in INFO:
                    yield _info(*INFO[kind], sources.label, messages)
                yield from (_family(measure, [sources.label], messages) for measure in MEASURES[kind])
                if kind is GatewayHealth:
                    yield from _frames(messages)

    def _receive_sample(self, received: Received, since_ns: int, wall_s: float) -> None:
        sample = read_sample(received)
        if sample is None or sample.parts.root != self._root or sample.parts.subject.type not in STALE_NS:
            return
        parts, message = sample.parts, sample.message
        sources = self._recorders if parts.recorder else self._robots
        source = self._find(sources, parts.recorder or parts.robot, since_ns)
        if source is None:
            return
        if isinstance(message, PayloadFault):
            reason = other_version(received.encoding, parts.subject.encoding) or DAMAGED
            source.unreadable[parts.subject.name, reason] += 1
            return
        source.receive(parts.subject.name, message, since_ns)
        if isinstance(message, sources.kinds[0]):
            source.health_wall_s = wall_s

    def _find(self, sources: _Sources, name: str, now_ns: int) -> _Source | None:
        source = sources.find(name, now_ns)
        self._refused += source is None
        return source

    def _own(self) -> Iterator[Metric]:
        yield InfoMetricFamily("cruiser_exporter", "The exporter.", {"version": self._version, "root": self._root})
        yield GaugeMetricFamily(
            "cruiser_exporter_connected", "The exporter is connected to a Zenoh node.", self.linked
        )
        yield CounterMetricFamily(
            "cruiser_exporter_overruns",
            "How often samples may have been lost because the exporter did not read them in time.",
            self._overruns,
        )
        yield CounterMetricFamily(
            "cruiser_exporter_refused",
            f"Samples of robots beyond the first {ROBOTS_MAX}, or recorders beyond {RECORDERS_MAX}.",
            self._refused,
        )
        if self.certificate_ends_s is not None:
            yield GaugeMetricFamily(
                "cruiser_exporter_certificate_ends_timestamp_seconds",
                "When the certificate ends that the exporter connects with.",
                self.certificate_ends_s,
            )


def _presence(sources: _Sources, now_ns: int) -> Iterator[Metric]:
    """Who is there, and what came of them; of those that are silent too."""
    prefix, label = sources.prefix, [sources.label]
    up = GaugeMetricFamily(f"{prefix}_up", "1 while its health comes; 0 once it has fallen silent.", labels=label)
    last = GaugeMetricFamily(
        f"{prefix}_last_health_timestamp_seconds",
        "When its last health came, by the exporter's clock.",
        labels=label,
    )
    by_subject = [
        CounterMetricFamily(f"{prefix}_samples_{what}", about, labels=[*label, "subject"])
        for what, about in (
            ("received", "Samples that reached the exporter."),
            ("lost", "Samples that did not reach the exporter, by the gaps in their sequence."),
        )
    ]
    unreadable = CounterMetricFamily(
        f"{prefix}_samples_unreadable",
        "Samples that the exporter could not read: of a newer or an older version of their schema, or damaged.",
        labels=[*label, "subject", "reason"],
    )
    for name, source in sources.all():
        up.add_metric([name], source.fresh(sources.kinds[0], now_ns) is not None)
        if source.health_wall_s:
            last.add_metric([name], source.health_wall_s)
        subjects = [BY_TYPE[kind].name for kind in sources.kinds]
        for family, counts in zip(by_subject, (source.received, source.lost), strict=True):
            for subject in subjects:
                family.add_metric([name, subject], counts[subject])
        for subject, reason in product(subjects, UNREADABLE):
            unreadable.add_metric([name, subject, reason], source.unreadable[subject, reason])
    yield from (up, last, *by_subject, unreadable)


def _info(
    prefix: str, about: str, fields: dict[str, str], label: str, messages: Iterable[tuple[str, Message]]
) -> Metric:
    """The texts of messages, as labels."""
    family = InfoMetricFamily(prefix, about, labels=[label])
    for name, message in messages:
        family.add_metric([name], {key: label_text(getattr(message, field)) for key, field in fields.items()})
    return family


def _frames(messages: Iterable[tuple[str, Message]]) -> Iterator[Metric]:
    """The supervision of each robot's feedback frames."""
    rows = [
        (robot, frame, row)
        for robot, health in messages
        if isinstance(health, GatewayHealth)
        for frame, row in {label_text(row.name): row for row in health.feedback[:LABELS_MAX]}.items()
    ]
    for measure in MEASURES[FrameHealth]:
        yield _family(measure, ["robot", "frame"], rows)


def _family(measure: Measure, labels: list[str], rows: Iterable[tuple[object, ...]]) -> Metric:
    """One measure of many: rows of the values of the labels, and last what is measured."""
    make = CounterMetricFamily if measure.is_counter else GaugeMetricFamily
    name = measure.name.removesuffix(COUNTER)
    family = make(name, measure.about, labels=[*labels, measure.label] if measure.label else labels)
    for *whose, record in rows:
        for label, value in measure.values(record):
            family.add_metric([*map(str, whose), *([label] if measure.label else [])], value)
    return family
