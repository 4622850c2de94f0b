"""From the fields of a message to measures: names, units, counters, bounds."""

from __future__ import annotations

from typing import Annotated

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from gateway.metrics.measures import (
    COUNTERS,
    LABEL_LENGTH_MAX,
    LABELS_MAX,
    OMITTED,
    PREFIXES,
    UNITS,
    bounded,
    measures,
)
from schemas.docstrings import attribute_texts
from schemas.messages import UNIT_KEYWORD, unit_keyword

KINDS = list(PREFIXES)
FIELDS = [field for kind in KINDS for field in msgspec.structs.fields(kind)]


def unit_of(annotation: object) -> str:
    """The unit in a field's annotation; empty if it has none."""
    for part in (annotation, *getattr(annotation, "__args__", ())):
        for meta in getattr(part, "__metadata__", ()):
            if isinstance(meta, Meta) and meta.extra_json_schema and UNIT_KEYWORD in meta.extra_json_schema:
                return str(meta.extra_json_schema[UNIT_KEYWORD])
    return ""


def test_every_unit_of_the_schemas_has_a_base_unit() -> None:
    """Rates are left out."""
    units = {unit_of(field.type) for field in FIELDS}
    assert "m/s" in units
    assert units - {"", "Hz"} <= UNITS.keys()


@pytest.mark.parametrize("unit", UNITS)
def test_a_unit_takes_the_place_of_the_end_of_a_name(unit: str) -> None:
    """One that is in no name would be another metric than people look for."""
    end, base, divisor = UNITS[unit]
    field = Annotated[float, Meta(extra_json_schema=unit_keyword(unit))]
    made = measures(msgspec.defstruct("Made", [(f"value{end}", field)]), "x")[0]
    assert made.name == f"x_value{base}"
    assert list(made.values(3.0)) == [("", 3.0 / divisor)]


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_schemas_count_since_the_start_is_a_counter(kind: type[msgspec.Struct]) -> None:
    """And what has a unit of time is none: the latest tick since the start is no count."""
    made = measures(kind, "x")
    since = {name for name, text in attribute_texts(kind).items() if "since the start" in text}
    units = {field.name: unit_of(field.type) for field in msgspec.structs.fields(kind)}
    for measure in made:
        assert not (measure.field in since and units[measure.field] in {"", "B"} and not measure.is_counter), (
            measure
        )
        assert units[measure.field] in {"", "B"} or not measure.is_counter


def test_the_tables_name_fields_that_exist() -> None:
    """A field that was renamed would be a gauge without a word."""
    names = {field.name for field in FIELDS}
    assert names >= COUNTERS | OMITTED


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_number_is_left_out(kind: type[msgspec.Struct]) -> None:
    """Neither infinities nor what is not a number are shown."""
    for measure in measures(kind, "x"):
        if measure.field.endswith("_mps"):
            assert [list(measure.values(value)) for value in (float("nan"), float("-inf"), None)] == [[], [], []]


@given(counts=st.dictionaries(st.text(), st.integers(0, 2**63 - 1), max_size=3 * LABELS_MAX))
def test_labels_that_somebody_makes_up_are_bounded(counts: dict[str, int]) -> None:
    """In number, in length, and in what a terminal would do of them; nothing goes uncounted."""
    kept = list(bounded(counts))
    labels = [label for label, _ in kept]
    assert len(labels) == len(set(labels)) <= LABELS_MAX + 1
    assert all(label.isprintable() and len(label) <= 10 * LABEL_LENGTH_MAX for label in labels)
    assert sum(count for _, count in kept) == sum(counts.values())
