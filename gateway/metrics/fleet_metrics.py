"""The newest of each robot and recorder as metrics. Of a silent one nothing is shown but that it is silent."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Final

import msgspec
from prometheus_client import Metric
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

from gateway.client.fleet import Bounds, Fleet, Source, Sources
from gateway.client.payloads import SampleRead
from gateway.metrics.measures import COUNTER, INFO, LABELS_MAX, MEASURES, Measure, label_text
from gateway.telemetry.received import Arrival, Missed, Received
from schemas.codec import PayloadFault, other_version
from schemas.decisions import SafetyState
from schemas.messages import SEQUENCE_MAX, FrameHealth, GatewayHealth, Message, RobotState
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE

BOUNDS: Final = Bounds(robots=1000, recorders=100, name_length=64, forgotten_ns=7 * 86_400 * 1_000_000_000)
"""The robots and recorders that have metrics; a silent one for a week."""

GAP_MAX: Final = 100_000
"""A step of the sequence by more is a sender that began anew, not a loss."""

DAMAGED: Final = "damaged"
UNREADABLE: Final = ("newer", "older", DAMAGED)
"""Why a sample cannot be read: its schema is of a newer or an older version than here, or it is damaged."""


class _Counts:
    """Samples of a robot or a recorder, counted.

    Attributes:
        health_wall_s: when its health came last, seconds since 1970; 0 before the first.
        received, lost: samples by subject; those that are lost by the gaps in their sequence.
        unreadable: samples by subject, and why they cannot be read.
    """

    def __init__(self) -> None:
        self.health_wall_s = 0.0
        self.received: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.unreadable: Counter[tuple[str, str]] = Counter()
        self._next: dict[str, int] = {}

    def receive(self, subject: str, message: Message) -> None:
        """Count a message, and those that are missing before it."""
        self.received[subject] += 1
        gap = (message.sequence - self._next.get(subject, message.sequence)) & SEQUENCE_MAX
        self.lost[subject] += gap if gap <= GAP_MAX else 0
        self._next[subject] = message.sequence + 1


class _Group(msgspec.Struct):
    """All robots, or all recorders.

    Attributes:
        prefix: of the metrics that say whether they are there.
        label: of their names.
        kinds: the classes of their messages; the first is the health, without which they count as silent.
    """

    prefix: str
    label: str
    sources: Sources
    kinds: tuple[type[Message], ...]
    counts: defaultdict[str, _Counts] = msgspec.field(default_factory=lambda: defaultdict(_Counts))

    def update(self, now_ns: int) -> None:
        """Forget those that have been silent for too long, with their counts."""
        names = self.sources.names(now_ns, lambda _name: True)
        self.counts = defaultdict(_Counts, {name: self.counts[name] for name in names})

    def all(self) -> list[tuple[str, Source]]:
        """Names and sources, in alphabetical order."""
        return [(name, self.sources[name]) for name in sorted(self.counts)]


class FleetMetrics:
    """The samples of a fleet as metric families.

    Attributes:
        linked: this end is connected to Zenoh.
        certificate_ends_s: when its own certificate ends, seconds since 1970; None if it has none.
    """

    def __init__(self, root: str, version: str, certificate_ends_s: int | None = None) -> None:
        self.linked = False
        self.certificate_ends_s = certificate_ends_s
        self._fleet = Fleet(root, BOUNDS)
        self._root = root
        self._version = version
        self._robots = _Group("cruiser", "robot", self._fleet.robots, (GatewayHealth, SafetyState, RobotState))
        self._recorders = _Group("cruiser_recorder", "recorder", self._fleet.recorders, (RecorderHealth,))
        self._overruns = 0

    def receive(self, heard: Arrival, since_ns: int, wall_s: float) -> None:
        """Take in a sample or a change of a token. What is nobody's is ignored; what cannot be read is counted.

        Args:
            heard: what arrived.
            since_ns: when was looked for arrivals before this time, monotonic: what waited while this process was
                held up may be as old as that.
            wall_s: now, seconds since 1970.
        """
        sample = self._fleet.receive(heard, since_ns)
        if isinstance(heard, Missed):
            self._overruns += 1
        elif isinstance(heard, Received) and sample is not None:
            self._count(heard.encoding, sample, wall_s)

    def families(self, now_ns: int) -> Iterator[Metric]:
        """All metrics as they are now."""
        self._robots.update(now_ns)
        self._recorders.update(now_ns)
        yield from self._own()
        connected = GaugeMetricFamily(
            "cruiser_gateway_connected",
            "The gateway's liveliness token is there, which is no proof of health.",
            labels=["robot"],
        )
        for robot, source in self._robots.all():
            connected.add_metric([robot], self.linked and source.connected)
        yield connected
        for group in (self._robots, self._recorders):
            yield from _presence(group, now_ns)
            for kind in group.kinds:
                found = ((name, source.fresh(kind, now_ns)) for name, source in group.all())
                messages = [(name, message) for name, message in found if message is not None]
                if kind in INFO:
                    yield _info(*INFO[kind], group.label, messages)
                yield from (_family(measure, [group.label], messages) for measure in MEASURES[kind])
                if kind is GatewayHealth:
                    yield from _frames(messages)

    def _count(self, encoding: str, sample: SampleRead, wall_s: float) -> None:
        parts, message = sample.parts, sample.message
        group = self._recorders if parts.recorder else self._robots
        counts = group.counts[parts.recorder or parts.robot]
        if isinstance(message, PayloadFault):
            reason = other_version(encoding, parts.subject.encoding) or DAMAGED
            counts.unreadable[parts.subject.name, reason] += 1
            return
        counts.receive(parts.subject.name, message)
        if isinstance(message, group.kinds[0]):
            counts.health_wall_s = wall_s

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
            f"Samples of robots beyond the first {BOUNDS.robots}, or recorders beyond {BOUNDS.recorders}.",
            self._fleet.robots.refused + self._fleet.recorders.refused,
        )
        if self.certificate_ends_s is not None:
            yield GaugeMetricFamily(
                "cruiser_exporter_certificate_ends_timestamp_seconds",
                "When the certificate ends that the exporter connects with.",
                self.certificate_ends_s,
            )


def _presence(group: _Group, now_ns: int) -> Iterator[Metric]:
    """Who is there, and what came of them; of those that are silent too."""
    prefix, label = group.prefix, [group.label]
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
    for name, source in group.all():
        up.add_metric([name], source.fresh(group.kinds[0], now_ns) is not None)
        counts = group.counts[name]
        if counts.health_wall_s:
            last.add_metric([name], counts.health_wall_s)
        subjects = [BY_TYPE[kind].name for kind in group.kinds]
        for family, found in zip(by_subject, (counts.received, counts.lost), strict=True):
            for subject in subjects:
                family.add_metric([name, subject], found[subject])
        for subject, reason in product(subjects, UNREADABLE):
            unreadable.add_metric([name, subject, reason], counts.unreadable[subject, reason])
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
