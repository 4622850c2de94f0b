"""The columns of a log, and what the protobuf package makes of the same messages."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec

from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Selection
from recorder.reading.topics import typed_decoder
from recorder.review.columns import Batch, ColumnReader
from recorder.review.export import values


def batches_of(data: bytes, faults: Faults | None = None, selection: Selection | None = None) -> list[Batch]:
    stream = BytesIO(data)
    taken = Faults() if faults is None else faults
    reader = ColumnReader(stream, LogFile(Path("log"), len(data), 0, 0), selection or Selection(), taken)
    found = list(reader.batches(lambda _: None))
    if faults is None:
        assert not taken, taken.told
    return found


def rows_of(batches: Sequence[Batch]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for batch in batches:
        batch.rows.validate(full=True)
        columns = [values(column) for column in batch.rows.columns]
        rows += [dict(zip(batch.rows.schema.names, row, strict=True)) for row in zip(*columns, strict=True)]
    return rows


def typed_row(kind: type[msgspec.Struct], data: bytes) -> dict[str, Any]:
    """The same message by the protobuf package and the typed class, as JSON; the sequence is the record's."""
    row: dict[str, Any] = msgspec.to_builtins(typed_decoder(kind)(data))
    row.pop("sequence", None)
    if kind.__name__ == "RecorderEvent":
        row["message_robot"] = row.pop("robot")
    if kind.__name__ == "GatewayInfo":
        row["message_robot"] = row.pop("robot")
    return row


def fields_of(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name not in {"log_time", "publish_time", "sequence"}}
