"""The measures of a message, from its class: which fields, under which names, in which base units.

A field's unit is that of its schema, so a field that is added to a message becomes a metric by itself:

    speed_mps: SpeedMps                 cruiser_chassis_speed_meters_per_second        gauge
    tick_lateness_max_ms: DurationMs    cruiser_gateway_tick_lateness_max_seconds      gauge
    certificate_ends_ns: TimeNs | None  cruiser_gateway_certificate_ends_timestamp_seconds
    bus_up: bool                        cruiser_gateway_bus_up                         0 or 1
    state: ArbiterState                 cruiser_safety_state{state="engaged"}          1 for the value that it has
    latched: list[Reason]               cruiser_safety_latched{reason="guard"}         1 for each that is in it
    bus_drops: Count                    cruiser_gateway_bus_drops_total                counter, see COUNTERS
    faults: dict[str, Count]            cruiser_gateway_faults_total{kind="checksum"}  counter, see COUNTED_BY

Text and bytes are left out, and so is what is null.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from math import isfinite
from typing import Any, Final

import msgspec

from schemas.decisions import SafetyState
from schemas.docstrings import attribute_texts, plain_text, summary
from schemas.messages import UNIT_KEYWORD, FrameHealth, GatewayHealth, RobotState
from schemas.printable import plain
from schemas.recording import RecorderHealth
from schemas.snake_case import snake_case

PREFIXES: Final[dict[type[msgspec.Struct], str]] = {
    GatewayHealth: "cruiser_gateway",
    FrameHealth: "cruiser_feedback",
    SafetyState: "cruiser_safety",
    RobotState: "cruiser_chassis",
    RecorderHealth: "cruiser_recorder",
}
"""The messages that become metrics, and the records within them, with the beginning of the metrics' names."""

UNITS: Final = {
    "m/s": ("_mps", "_meters_per_second", 1),
    "m/s2": ("_mps2", "_meters_per_second_squared", 1),
    "deg": ("_deg", "_degrees", 1),
    "deg/s": ("_degps", "_degrees_per_second", 1),
    "rad/s": ("_radps", "_radians_per_second", 1),
    "km": ("_km", "_meters", 1e-3),
    "m": ("_m", "_meters", 1),
    "s": ("_s", "_seconds", 1),
    "ms": ("_ms", "_seconds", 1e3),
    "ns": ("_ns", "_timestamp_seconds", 1e9),
    "B": ("_bytes", "_bytes", 1),
    "%": ("_percent", "_ratio", 100),
}
"""By a schema's unit: the end of a field's name, that of a metric's in its place, and the divisor."""

COUNTERS: Final = frozenset(
    {
        "bus_drops",
        "bus_losses",
        "checksum_faults",
        "dropped",
        "ended_bytes",
        "faults",
        "files_ended",
        "frames",
        "implausible",
        "inbox_drops",
        "incidents",
        "lost",
        "missed",
        "publish_failures",
        "received",
        "unknown_identifiers",
        "valid",
        "withheld",
        "written",
    }
)
"""Fields that count since their sender's start; any other number is one of the moment."""

COUNTED_BY: Final = {"faults": "kind", "unknown_identifiers": "identifier", "dropped": "reason"}
"""The label of the keys of a field that is a map of counts."""

OMITTED: Final = frozenset(
    {
        # Of every message.
        "time_ns",
        "sequence",
        # What commands refer to.
        "tick",
        "accepted_seq",
        # Counts that wrap, a pedal that is never pressed.
        "rear_left_pulses",
        "rear_right_pulses",
        "brake_pedal_percent",
    }
)
"""Fields that nobody wants to see over time. Rates are left out too: PromQL makes them of the counters."""

INFO: Final = {"gateway_version": "version", "recorder_version": "version", "bus": "bus"}
"""Texts that are labels of ``..._info``."""

HELD: Final = {"lease_holder": "lease_held"}
"""Names of people, who are no labels: 1 where there is one."""

LABELS_MAX: Final = 80
"""Values of one label that one message can bring; the rest is counted as OTHER."""

LABEL_LENGTH_MAX: Final = 64

OTHER: Final = "other"

Values = Iterable[tuple[str, float]]
"""Values of a measure, each with that of its label; '' where it has none."""


class Measure(msgspec.Struct, frozen=True):
    """One metric of a message.

    Attributes:
        name: as Prometheus has it, without ``_total``.
        about: its help.
        label: besides those that say of whom it is; empty if there is none.
        is_counter: it only rises, until its sender starts anew.
        field: of the message.
        values: of the field's value.
    """

    name: str
    about: str
    label: str
    is_counter: bool
    field: str
    values: Callable[[Any], Values]

    @property
    def shown_name(self) -> str:
        """The name as PromQL has it."""
        return f"{self.name}_total" if self.is_counter else self.name


def measures(kind: type[msgspec.Struct], prefix: str) -> list[Measure]:
    """Return the measures of a class of messages, or of a record within one; its ``info`` is not among them."""
    texts = attribute_texts(kind)
    made = []
    for field in _fields(kind):
        about = f"{kind.__name__}.{field.name}: {plain_text(texts.get(field.name, 'see docs/messages.md.'))}"
        measure = _measure(field.name, field.type, prefix, about)
        if measure is not None and field.name not in OMITTED:
            made.append(measure)
    return made


def info_labels(kind: type[msgspec.Struct]) -> dict[str, str]:
    """The labels of a message's ``info``, each with its field."""
    return {INFO[field.name]: field.name for field in _fields(kind) if field.name in INFO}


def info_about(kind: type[msgspec.Struct]) -> str:
    """The help of a message's ``info``."""
    return summary(kind)


def label_text(text: str) -> str:
    """Text from elsewhere as the value of a label."""
    return plain(text[:LABEL_LENGTH_MAX])


def bounded(counts: Mapping[str, int]) -> Iterator[tuple[str, float]]:
    """Counts by a label that somebody else made up: a bounded number, the rest together."""
    kept: dict[str, int] = {}
    for name, count in counts.items():
        label = label_text(name)
        if label not in kept and len(kept) >= LABELS_MAX:
            label = OTHER
        kept[label] = kept.get(label, 0) + count
    yield from kept.items()


def _fields(kind: type[msgspec.Struct]) -> tuple[msgspec.inspect.Field, ...]:
    found = msgspec.inspect.type_info(kind)
    return found.fields if isinstance(found, msgspec.inspect.StructType) else ()


def _measure(field: str, wrapped: msgspec.inspect.Type, prefix: str, about: str) -> Measure | None:
    """The measure of a field; None if it has none."""
    kind, unit = _unwrapped(wrapped)
    name, is_counter = f"{prefix}_{field}", field in COUNTERS
    match kind:
        case msgspec.inspect.StrType() if field in HELD:
            return Measure(f"{prefix}_{HELD[field]}", about, "", is_counter, field, _presence)
        case msgspec.inspect.BoolType():
            return Measure(name, about, "", is_counter, field, _number(1))
        case msgspec.inspect.IntType() | msgspec.inspect.FloatType() if not unit:
            return Measure(name, about, "", is_counter, field, _number(1))
        case msgspec.inspect.IntType() | msgspec.inspect.FloatType() if unit in UNITS:
            end, base, divisor = UNITS[unit]
            return Measure(f"{name.removesuffix(end)}{base}", about, "", is_counter, field, _number(divisor))
        case msgspec.inspect.DictType() if field in COUNTED_BY:
            return Measure(name, about, COUNTED_BY[field], is_counter, field, bounded)
        case msgspec.inspect.EnumType(cls):
            return Measure(name, about, _word_label(cls), is_counter, field, _word)
        case msgspec.inspect.ListType(item_type=msgspec.inspect.EnumType(cls)):
            return Measure(name, about, _word_label(cls), is_counter, field, _words)
        case _:
            return None


def _unwrapped(kind: msgspec.inspect.Type) -> tuple[msgspec.inspect.Type, str]:
    """The type without null and metadata, and its unit."""
    unit = ""
    while True:
        match kind:
            case msgspec.inspect.Metadata(inner, extra_json_schema):
                unit = unit or (extra_json_schema or {}).get(UNIT_KEYWORD, "")
                kind = inner
            case msgspec.inspect.UnionType(types):
                kind = next(one for one in types if not isinstance(one, msgspec.inspect.NoneType))
            case _:
                return kind, unit


def _word_label(enumeration: type[Enum]) -> str:
    """``StopPhase`` to ``phase``."""
    return snake_case(enumeration.__name__).rpartition("_")[2]


def _number(divisor: float) -> Callable[[float | None], Values]:
    def values(value: float | None) -> Values:
        return () if value is None or not isfinite(value) else (("", value / divisor),)

    return values


def _presence(text: str) -> Values:
    return (("", float(bool(text))),)


def _word(value: Enum) -> Values:
    return ((str(value.value), 1.0),)


def _words(values: Iterable[Enum]) -> Values:
    return [(str(value.value), 1.0) for value in dict.fromkeys(values)]
