"""The table of metrics is held against the fields of the messages: names, units, counters, bounds."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from gateway.metrics import INFO, LABEL_LENGTH_MAX, LABELS_MAX, MEASURES, Measure, bounded
from schemas.configuration import attribute_texts
from schemas.messages import UNIT_KEYWORD

UNITS = {
    "": ("", "", 1),
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

NO_METRIC = {
    # Of every message, and what commands refer to.
    *("time_ns", "sequence", "tick", "accepted_seq", "challenge"),
    # Rates: PromQL makes them of the counters.
    *("frames_per_s", "received_per_s", "rate_hz"),
    # Counts that wrap, a pedal that is never pressed.
    *("rear_left_pulses", "rear_right_pulses", "brake_pedal_percent"),
    # Free text, names, and records with metrics of their own.
    *("bus_detail", "stop_detail", "stopped_by", "name", "recorder", "failures", "notes", "silent", "feedback"),
}
"""Fields of no metric."""

ROWS = [(kind, measure) for kind, measures in MEASURES.items() for measure in measures]


def unit_of(annotation: object) -> str:
    """The unit in a field's annotation; empty if it has none."""
    for part in (annotation, *getattr(annotation, "__args__", ())):
        for meta in getattr(part, "__metadata__", ()):
            if isinstance(meta, Meta) and meta.extra_json_schema and UNIT_KEYWORD in meta.extra_json_schema:
                return str(meta.extra_json_schema[UNIT_KEYWORD])
    return ""


@pytest.mark.parametrize(("kind", "measure"), ROWS, ids=lambda one: getattr(one, "name", ""))
def test_a_name_and_its_divisor_say_the_unit_of_the_field(kind: type[msgspec.Struct], measure: Measure) -> None:
    """A counter of what is counted since the sender's start, and of nothing else."""
    field = next(one for one in msgspec.structs.fields(kind) if one.name == measure.field)
    unit = unit_of(field.type)
    end, base, divisor = UNITS[unit]
    if measure.field != "lease_holder":
        assert measure.name.removesuffix("_total").endswith(measure.field.removesuffix(end) + base)
    assert measure.divisor == divisor
    since = "since the start" in attribute_texts(kind).get(measure.field, "")
    assert measure.is_counter or not since or unit not in {"", "B"}
    assert unit in {"", "B"} or not measure.is_counter


@pytest.mark.parametrize("kind", MEASURES)
def test_each_field_is_a_metric_or_left_out_on_purpose(kind: type[msgspec.Struct]) -> None:
    """A field that is added to a message is not forgotten."""
    shown = {measure.field for measure in MEASURES[kind]} | set(INFO[kind][2].values() if kind in INFO else ())
    others = {field.name for field in msgspec.structs.fields(kind)} - shown
    assert others <= NO_METRIC


def test_what_is_no_number_is_left_out() -> None:
    """Neither infinities nor what is not a number are shown."""
    measure = Measure("x", "value", "", "", 1)
    made = msgspec.defstruct("Made", [("value", float | None)])
    assert [list(measure.values(made(value))) for value in (float("nan"), float("-inf"), None)] == [[], [], []]


@given(counts=st.dictionaries(st.text(), st.integers(0, 2**63 - 1), max_size=3 * LABELS_MAX))
def test_labels_that_somebody_makes_up_are_bounded(counts: dict[str, int]) -> None:
    """In number, in length, and in what a terminal would do of them; nothing goes uncounted."""
    kept = list(bounded(counts))
    labels = [label for label, _ in kept]
    assert len(labels) == len(set(labels)) <= LABELS_MAX + 1
    assert all(label.isprintable() and len(label) <= 10 * LABEL_LENGTH_MAX for label in labels)
    assert sum(count for _, count in kept) == sum(counts.values())
