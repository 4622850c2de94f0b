"""Arrow columns as text and as JSON: whatever an answer of SQL may hold."""

from decimal import Decimal
from typing import Any

import pyarrow as pa
import pytest

from recorder.review.export import cells, csv_text, objects, values

CASES: list[tuple[pa.Array, list[Any], list[Any]]] = [
    (pa.array([1, None]), [1, None], [1, None]),
    (pa.array([1.5]), [1.5], [1.5]),
    (pa.array([True, None]), [True, None], [True, None]),
    (pa.array(["a", None, ""]), ["a", None, ""], ["a", None, ""]),
    (pa.array(["a", None]).dictionary_encode(), ["a", None], ["a", None]),
    (pa.array([b"\x00\xff", None, b""]), ["AP8=", None, ""], ["00ff", None, ""]),
    (pa.array([b"\x01"], pa.large_binary()), ["AQ=="], ["01"]),
    (
        pa.array([1_800_000_000_000_000_001, None], pa.timestamp("ns", "UTC")),
        ["2027-01-15T08:00:00.000000001Z", None],
        ["2027-01-15T08:00:00.000000001Z", None],
    ),
    (pa.array([0], pa.timestamp("us")), ["1970-01-01T00:00:00.000000"], ["1970-01-01T00:00:00.000000"]),
    (pa.array([5], pa.date32()), ["1970-01-06"], ["1970-01-06"]),
    (pa.array([Decimal("1.50")]), ["1.50"], ["1.50"]),
    (pa.array([None, None]), [None, None], [None, None]),
    (pa.array([[1, 2], None, []]), [[1, 2], None, []], ["[1,2]", None, "[]"]),
    (pa.array([[b"a"], [None]]), [["YQ=="], [None]], ['["YQ=="]', "[null]"]),
    (pa.array([{"a": 1, "b": [b"x"]}, None]), [{"a": 1, "b": ["eA=="]}, None], ['{"a":1,"b":["eA=="]}', None]),
    (
        pa.array([[("k", 1)], None, []], pa.map_(pa.string(), pa.int64())),
        [{"k": 1}, None, {}],
        ['{"k":1}', None, "{}"],
    ),
    (pa.array([[(7, "x")]], pa.map_(pa.int32(), pa.string())), [{"7": "x"}], ['{"7":"x"}']),
    (
        pa.array([[1_800_000_000_000_000_001]], pa.list_(pa.timestamp("ns"))),
        [["2027-01-15T08:00:00.000000001"]],
        ['["2027-01-15T08:00:00.000000001"]'],
    ),
]


@pytest.mark.parametrize(("array", "as_json", "as_cells"), CASES, ids=lambda case: str(getattr(case, "type", "")))
def test_every_type_has_its_text(array: pa.Array, as_json: list[Any], as_cells: list[Any]) -> None:
    """Also of a part of an array."""
    assert values(array) == as_json
    longer = pa.concat_arrays([array, array])
    assert values(longer[len(array) :]) == as_json
    rows = pa.RecordBatch.from_arrays([longer[len(array) :]], names=["x"])
    assert cells(rows).column("x").to_pylist() == as_cells


def test_rows_are_objects() -> None:
    """By column."""
    rows = pa.RecordBatch.from_pydict({"a": [1, 2], "b": ["x", None]})
    assert list(objects(rows)) == [{"a": 1, "b": "x"}, {"a": 2, "b": None}]


def test_an_empty_text_is_not_nothing() -> None:
    """In CSV: quotes tell."""
    rows = pa.RecordBatch.from_pydict({"a": ["", None]})
    assert csv_text(rows, with_header=True) == '"a"\n""\n\n'


def test_no_rows_have_a_head_all_the_same() -> None:
    """An answer without rows still says its columns."""
    schema = pa.schema([("a", pa.int64()), ("b", pa.string()), ("c", pa.binary()), ("d", pa.list_(pa.binary()))])
    assert csv_text(pa.RecordBatch.from_pylist([], schema=schema), with_header=True) == '"a","b","c","d"\n'
