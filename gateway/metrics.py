"""A fleet's health as metrics for Prometheus: their table, and the samples behind them.

Of a silent robot or recorder only its silence is shown. A row of the table, such as

    ("cpu_ratio", "cpu_percent", "Processor time over the last second; 1 is one core.", 100)

is ``cruiser_gateway_cpu_ratio``, the field ``cpu_percent`` of ``GatewayHealth`` divided by 100. A name that ends
in ``_total`` is a counter, any other a gauge. A word in the divisor's place is a label: an enumeration is 1 under
its value, a list of words 1 under each, and a map of counts has a value for each key. A text is a person's name,
and is 1 where there is one. What is null, and what is no finite number, is left out.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from itertools import product
from math import isfinite
from typing import Any, Final

import msgspec
from prometheus_client import Metric
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

from gateway.client.fleet import Bounds, Fleet, SampleRead, Source, Sources
from gateway.telemetry.samples import Arrival, Missed, Received
from schemas.codec import PayloadFault, other_version
from schemas.command_line import plain
from schemas.decisions import SafetyState
from schemas.messages import SEQUENCE_MAX, FrameHealth, GatewayHealth, Message, RobotState
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE

LABELS_MAX: Final = 80  # values of one label that one message can bring; the rest is counted as OTHER
LABEL_LENGTH_MAX: Final = 64

OTHER: Final = "other"

COUNTER: Final = "_total"


class Measure(msgspec.Struct, frozen=True):
    """One metric of a message."""

    name: str  # as PromQL has it
    field: str
    about: str
    label: str  # besides those that say of whom it is; empty if there is none
    divisor: float

    @property
    def is_counter(self) -> bool:
        """True if it only rises until its sender restarts."""
        return self.name.endswith(COUNTER)

    def values(self, message: object) -> Iterable[tuple[str, float]]:
        """Return the values in a message, each with that of its label."""
        value: Any = getattr(message, self.field)
        match value:
            case None:
                return ()
            case Mapping():
                return bounded(value)
            case list():
                return [(str(word.value), 1.0) for word in dict.fromkeys(value)]
            case Enum():
                return ((str(value.value), 1.0),)
            case str():
                return (("", float(bool(value))),)
            case _:
                return (("", value / self.divisor),) if isfinite(value) else ()


def label_text(text: str) -> str:
    return plain(text[:LABEL_LENGTH_MAX])


def bounded(counts: Mapping[str, int]) -> Iterator[tuple[str, float]]:
    """Yield counts by a foreign label: a bounded number, the rest as ``other``."""
    kept: dict[str, int] = {}
    for name, count in counts.items():
        label = label_text(name)
        if label not in kept and len(kept) >= LABELS_MAX:
            label = OTHER
        kept[label] = kept.get(label, 0) + count
    yield from kept.items()


_Row = tuple[str, str, str] | tuple[str, str, str, str | float]


def _rows(prefix: str, *rows: _Row) -> list[Measure]:
    measures = []
    for name, field, about, *more in rows:
        per = more[0] if more else 1
        label, divisor = (per, 1.0) if isinstance(per, str) else ("", per)
        measures.append(Measure(f"{prefix}_{name}", field, about, label, divisor))
    return measures


MEASURES: Final[dict[type[msgspec.Struct], list[Measure]]] = {
    GatewayHealth: _rows(
        "cruiser_gateway",
        ("uptime_seconds", "uptime_s", "Time since the gateway started."),
        ("bus_up", "bus_up", "The gateway has the CAN bus open."),
        ("bus_losses_total", "bus_losses", "Losses of the bus since the start."),
        ("bus_drops_total", "bus_drops", "Frames dropped since the start: not read in time, or unreadable."),
        ("controller", "controller", "State of the CAN controller, by the last error frame.", "state"),
        ("zenoh_peers", "zenoh_peers", "Zenoh nodes connected directly to this one."),
        ("publish_failures_total", "publish_failures", "Samples that Zenoh did not accept."),
        ("inbox_drops_total", "inbox_drops", "Requests dropped unread since the start, because too many came."),
        ("variant", "variant", "The firmware variant in force.", "variant"),
        ("frames_total", "frames", "CAN frames received since the start, of any kind."),
        ("faults_total", "faults", "Faults since the start.", "kind"),
        ("unknown_identifiers_total", "unknown_identifiers", "Frames that are not in the DBC.", "identifier"),
        ("tick_lateness_p50_seconds", "tick_lateness_p50_ms", "Delay of the last second's ticks, p50.", 1000),
        ("tick_lateness_p99_seconds", "tick_lateness_p99_ms", "Delay of the last second's ticks, p99.", 1000),
        ("tick_lateness_max_seconds", "tick_lateness_max_ms", "Delay of the last second's ticks, greatest.", 1000),
        ("tick_lateness_worst_seconds", "tick_lateness_worst_ms", "Greatest delay since the start.", 1000),
        ("cpu_ratio", "cpu_percent", "Processor time of the process over the last second; 1 is one core.", 100),
        ("realtime", "realtime", "The loop runs with real-time priority."),
        ("certificate_ends_timestamp_seconds", "certificate_ends_ns", "End of the certificate of its link.", 1e9),
        ("grant_ends_timestamp_seconds", "grant_ends_ns", "End of the robot's own grant.", 1e9),
    ),
    FrameHealth: _rows(
        "cruiser_feedback",
        ("valid_total", "valid", "Valid frames since the start."),
        ("lost_total", "lost", "Valid frames that should have come since the start, by the alive counter."),
        ("withheld_total", "withheld", "Valid frames not published, as the scale of their speeds was not known."),
        ("checksum_faults_total", "checksum_faults", "Frames with a wrong checksum since the start."),
        ("implausible_total", "implausible", "Frames with values that this chassis cannot have, since the start."),
        ("silent", "silent", "The frame is missing or overdue."),
        ("alive_faults", "alive_faults", "Fault count of the alive counter: up by a fault, down by a good frame."),
    ),
    SafetyState: _rows(
        "cruiser_safety",
        ("state", "state", "State of the arbiter.", "state"),
        ("engaged", "engaged", "Drive commands are executed."),
        ("stop_reason", "stop_reason", "Cause of the stop that is under way, or of the last one.", "reason"),
        ("stop_phase", "stop_phase", "Phase of the stop.", "phase"),
        ("lease_held", "lease_holder", "An operator holds the lease."),
        ("lease_role", "lease_role", "Role in which the lease is held; program if it is not.", "role"),
        ("lease_expires_seconds", "lease_expires_s", "Time until the lease expires; 0 if it is not held."),
        ("latched", "latched", "Causes that must be reset before the robot can be engaged.", "reason"),
        ("blocked_by", "blocked_by", "Causes for which the robot stands, or cannot be engaged, now.", "reason"),
        ("guarded", "guarded", "A second process watches the gateway."),
        ("speed_limit_meters_per_second", "speed_limit_mps", "Speed limit in force."),
        ("acceleration_limit_meters_per_second_squared", "acceleration_limit_mps2", "Limit in force."),
        ("deceleration_limit_meters_per_second_squared", "deceleration_limit_mps2", "Limit in force."),
        (
            "emergency_deceleration_meters_per_second_squared",
            "emergency_deceleration_mps2",
            "Deceleration of an emergency stop.",
        ),
        ("steering_limit_degrees", "steering_limit_deg", "Limit of the steering angle in force."),
        ("steering_rate_limit_degrees_per_second", "steering_rate_limit_degps", "Steering rate limit."),
        (
            "lateral_acceleration_limit_meters_per_second_squared",
            "lateral_acceleration_limit_mps2",
            "Lateral acceleration limit in force.",
        ),
        ("target_speed_meters_per_second", "target_speed_mps", "Speed of the last valid drive command."),
        ("target_angle_degrees", "target_angle_deg", "Steering angle of the last valid drive command."),
        ("output_speed_meters_per_second", "output_speed_mps", "Speed commanded to the chassis."),
        ("output_angle_degrees", "output_angle_deg", "Steering angle commanded to the chassis."),
        ("output_gear", "output_gear", "Gear commanded; undefined while nothing is sent.", "position"),
        ("parking", "parking", "The parking brake is commanded."),
        ("link_age_seconds", "link_age_s", "Age of the holder's drive commands by which the speed is bounded."),
        ("link_age_last_seconds", "link_age_last_s", "Age of the last accepted drive command."),
        ("link_age_p50_seconds", "link_age_p50_s", "Age of drive commands over ten seconds, p50."),
        ("link_age_p99_seconds", "link_age_p99_s", "Age of drive commands over ten seconds, p99."),
        ("travel_delay_meters", "travel_delay_m", "Distance until an engaged robot can react to its operator."),
        ("travel_speed_limit_meters_per_second", "travel_speed_limit_mps", "Limit by command.travel_delay_m."),
        ("deadman_seconds", "deadman_s", "Time without a valid drive command after which it is stopped."),
        ("rest_confirmed", "rest_confirmed", "Feedback has answered since a speed was last commanded."),
    ),
    RobotState: _rows(
        "cruiser_chassis",
        ("bus_up", "bus_up", "The gateway has the CAN bus open."),
        ("variant", "variant", "Firmware variant of the chassis.", "variant"),
        ("mode", "mode", "Mode that the chassis reports.", "mode"),
        ("gear_position", "gear_position", "Gear that the chassis reports.", "position"),
        ("speed_meters_per_second", "speed_mps", "Speed by the drive feedback; forward is positive."),
        ("angle_degrees", "angle_deg", "Steering angle."),
        ("yaw_rate_radians_per_second", "yaw_rate_radps", "Yaw rate by the bicycle model."),
        ("rear_left_speed_meters_per_second", "rear_left_speed_mps", "Speed of the rear left wheel."),
        ("rear_right_speed_meters_per_second", "rear_right_speed_mps", "Speed of the rear right wheel."),
        ("braking_status", "braking_status", "Status of the brakes.", "status"),
        ("parking_status", "parking_status", "Status of the parking brake.", "status"),
        ("total_mileage_meters", "total_mileage_km", "Total mileage.", 1e-3),
        ("front_bumper", "front_bumper", "The front bumper is hit."),
        ("rear_bumper", "rear_bumper", "The rear bumper is hit."),
        ("headlamp", "headlamp", "The headlamp is on."),
        ("right_indicator", "right_indicator", "The right indicator is on."),
        ("left_indicator", "left_indicator", "The left indicator is on."),
        ("horn", "horn", "The horn sounds."),
    ),
    RecorderHealth: _rows(
        "cruiser_recorder",
        ("uptime_seconds", "uptime_s", "Time since the recorder started."),
        ("state", "state", "State of the recorder.", "state"),
        ("state_since_seconds", "state_since_s", "Time in that state."),
        ("files", "files", "Logs that are being written now, incidents among them."),
        ("files_ended_total", "files_ended", "Logs ended since the start."),
        ("ended_bytes_total", "ended_bytes", "Bytes of the logs ended since the start."),
        ("robots", "robots", "Robots that it has received from."),
        ("keys", "keys", "Keys that it has received."),
        ("received_total", "received", "Samples that reached it since the start."),
        ("written_total", "written", "Messages given to logs since the start; a batch of raw frames is many."),
        ("missed_total", "missed", "Samples that never reached it since the start, by gaps in sequences."),
        ("dropped_total", "dropped", "Samples or messages that it could not keep since the start.", "reason"),
        ("queue_bytes", "queue_bytes", "Samples that wait to be recorded."),
        ("disk_queue_bytes", "disk_queue_bytes", "Messages that wait for the disk, before compression."),
        ("ring_bytes", "ring_bytes", "Messages held for an incident, before compression."),
        ("incidents_total", "incidents", "Incident logs that were begun since the start."),
        ("disk_free_bytes", "disk_free_bytes", "Free bytes of the directory's file system."),
        ("disk_used_bytes", "disk_used_bytes", "Bytes of this directory's logs, incidents among them."),
        ("incident_bytes", "incident_bytes", "Bytes of this directory's incidents."),
        ("cpu_ratio", "cpu_percent", "Processor time of the process over the last second; 1 is one core.", 100),
    ),
}
"""Messages that become metrics, and the records within them."""

INFO: Final[dict[type[msgspec.Struct], tuple[str, str, dict[str, str]]]] = {
    GatewayHealth: ("cruiser_gateway", "The gateway.", {"version": "gateway_version", "bus": "bus"}),
    RecorderHealth: ("cruiser_recorder", "The recorder.", {"version": "recorder_version"}),
}
"""Metrics ``..._info``: name without that ending, help, and labels with their fields."""


BOUNDS: Final = Bounds(robots=1000, recorders=100, name_length=64, forgotten_ns=7 * 86_400 * 1_000_000_000)
"""Limits of robots and recorders with metrics; silent ones stay for a week."""

GAP_MAX: Final = 100_000  # a larger step is a restarted sender, not a loss
DAMAGED: Final = "damaged"
# reasons: schema of a newer or an older version than here, or damaged
UNREADABLE: Final = ("newer", "older", DAMAGED)


class _Counts:
    """Counted samples of a robot or a recorder.

    Attributes:
        health_wall_s: time of its last health, seconds since 1970; 0 before the first.
        received, lost: samples by subject; lost ones by gaps in the sequence.
        unreadable: samples by subject and reason.
    """

    def __init__(self) -> None:
        self.health_wall_s = 0.0
        self.received: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.unreadable: Counter[tuple[str, str]] = Counter()
        self._next: dict[str, int] = {}

    def receive(self, subject: str, message: Message) -> None:
        """Count a message, and those missing before it."""
        self.received[subject] += 1
        gap = (message.sequence - self._next.get(subject, message.sequence)) & SEQUENCE_MAX
        self.lost[subject] += gap if gap <= GAP_MAX else 0
        self._next[subject] = message.sequence + 1


class _Group(msgspec.Struct):
    """All robots, or all recorders.

    Attributes:
        prefix: of the metrics on their presence.
        kinds: classes of their messages; the first is the health, without which they count as silent.
    """

    prefix: str
    label: str
    sources: Sources
    kinds: tuple[type[Message], ...]
    counts: defaultdict[str, _Counts] = msgspec.field(default_factory=lambda: defaultdict(_Counts))

    def update(self, now_ns: int) -> None:
        """Forget sources that were silent for too long, with their counts."""
        names = self.sources.names(now_ns, lambda _name: True)
        self.counts = defaultdict(_Counts, {name: self.counts[name] for name in names})

    def all(self) -> list[tuple[str, Source]]:
        return [(name, self.sources[name]) for name in sorted(self.counts)]


class FleetMetrics:
    """A fleet's samples as metric families.

    Attributes:
        certificate_ends_s: end of the exporter's certificate, seconds since 1970; None without one.
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
        """Process a sample or a token's change.

        Args:
            since_ns: the previous poll, monotonic: an arrival may be as old as that.
            wall_s: now, seconds since 1970.
        """
        sample = self._fleet.receive(heard, since_ns)
        if isinstance(heard, Missed):
            self._overruns += 1
        elif isinstance(heard, Received) and sample is not None:
            self._count(heard.encoding, sample, wall_s)

    def families(self, now_ns: int) -> Iterator[Metric]:
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
    """Yield presence and sample counts of all sources, silent ones too."""
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
    family = InfoMetricFamily(prefix, about, labels=[label])
    for name, message in messages:
        family.add_metric([name], {key: label_text(getattr(message, field)) for key, field in fields.items()})
    return family


def _frames(messages: Iterable[tuple[str, Message]]) -> Iterator[Metric]:
    """Yield the supervision of each robot's feedback frames."""
    rows = [
        (robot, frame, row)
        for robot, health in messages
        if isinstance(health, GatewayHealth)
        for frame, row in {label_text(row.name): row for row in health.feedback[:LABELS_MAX]}.items()
    ]
    for measure in MEASURES[FrameHealth]:
        yield _family(measure, ["robot", "frame"], rows)


def _family(measure: Measure, labels: list[str], rows: Iterable[tuple[object, ...]]) -> Metric:
    """Make a measure from rows that end with the measured record, after its label values."""
    make = CounterMetricFamily if measure.is_counter else GaugeMetricFamily
    name = measure.name.removesuffix(COUNTER)
    family = make(name, measure.about, labels=[*labels, measure.label] if measure.label else labels)
    for *whose, record in rows:
        for label, value in measure.values(record):
            family.add_metric([*map(str, whose), *([label] if measure.label else [])], value)
    return family
