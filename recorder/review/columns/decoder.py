"""The messages of one channel to the record batch of its table.

ptars, which is Rust, reads many protobuf messages at once. It knows the fields under names of their own: of
``google.protobuf.Timestamp`` and others that it knows by name it would make times, which hold less.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final

import numpy as np
import pyarrow as pa
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from ptars import HandlerPool

from recorder.mcap.arrays import Bytes, Places
from recorder.review.columns.shape import Field
from recorder.review.columns.tables import HEAD, TIME_MAX_NS, TIME_TYPE, Columns

_MAP_ENTRY: Final = ("key", "value")


class Decoder:
    """Turns the messages of a topic into record batches.

    Args:
        columns: the topic's columns.
        wanted: names of the columns that are to be made; None is all.

    Attributes:
        schema: of the batches.
        broken: messages so far that could not be read.
    """

    def __init__(self, columns: Columns, wanted: Collection[str] | None = None) -> None:
        self.columns = columns
        self.broken = 0
        names = columns.schema.names
        places = [place for place, name in enumerate(names) if wanted is None or name in wanted]
        self.schema = pa.schema([columns.schema.field(place) for place in places])
        self._head = [place for place in places if place < len(HEAD)]
        self._behind = [place - len(HEAD) for place in places if place >= len(HEAD)]
        self._handler: Any = None if columns.fields is None else _handler(columns.fields)

    def batch(self, content: Bytes, places: Places) -> pa.RecordBatch:
        """The messages at these places. Those that cannot be read are left out and counted.

        Args:
            content: records of messages, and padding behind.
            places: proven, in the order of the file; one at least.
        """
        messages = _messages(content, places)
        found = self._read(messages)
        if found is None:
            rows = [row for row, one in enumerate(messages) if self._reads(one)]
            self.broken += len(messages) - len(rows)
            places = places.only(np.array(rows, np.int64))
            found = self._read(messages.take(pa.array(rows, pa.int64()))) or []
        head = [
            _times(places.log_ns(content)),
            _times(places.publish_ns(content)),
            pa.array(places.sequences(content).astype(np.int64)),
        ]
        return pa.RecordBatch.from_arrays([*(head[place] for place in self._head), *found], schema=self.schema)

    def _read(self, messages: pa.Array) -> list[pa.Array] | None:
        """The wanted columns behind the head; None if one of the messages cannot be read."""
        fields = self.columns.fields
        try:
            if fields is None:
                texts = messages.cast(self.columns.schema.field(len(HEAD)).type)
                return [texts for _ in self._behind]
            batch = self._handler.array_to_record_batch(messages)
            return [_shown(fields[place], batch.column(place)) for place in self._behind]
        except ValueError:
            return None
        except BaseException as error:
            # What Rust calls a panic, which pyo3 does not let anybody import.
            if type(error).__name__ != "PanicException":
                raise
            return None

    def _reads(self, message: pa.Scalar) -> bool:
        """Report whether one message can be read."""
        try:
            if self.columns.read is not None:
                self.columns.read(message.as_py())
        except (DecodeError, RecursionError):
            return False
        return self._read(pa.array([message.as_py()], pa.binary())) is not None


def _messages(content: Bytes, places: Places) -> pa.Array:
    """The data of each message: every other piece of the content, cut where one begins and where it ends."""
    cuts = np.empty(2 * len(places.offsets), np.int32)
    cuts[0::2], cuts[1::2] = places.offsets, places.offsets + places.lengths
    pieces = pa.Array.from_buffers(
        pa.binary(), len(cuts) - 1, [None, pa.py_buffer(cuts), pa.py_buffer(content)], null_count=0
    )
    return pieces.take(pa.array(np.arange(0, len(cuts), 2)))


def _times(numbers: NDArray[np.unsignedinteger]) -> pa.Array:
    """Nanoseconds since 1970 as Arrow has them: those beyond what it can hold are the last that it can."""
    return pa.array(np.minimum(numbers, np.uint64(TIME_MAX_NS)).astype(np.int64)).view(TIME_TYPE)


def _shown(field: Field, read: pa.Array) -> pa.Array:
    """A column as it was read in the type that it is shown in.

    Raises:
        ValueError: a number is beyond its bounds.
    """
    if field.is_map:
        key, value = field.within or ()
        return pa.MapArray.from_arrays(read.offsets, _shown(key, read.keys), _shown(value, read.items))
    if field.is_repeated:
        values = _values(field, read.values, field.type.value_type)
        return pa.ListArray.from_arrays(read.offsets, values, type=field.type)
    return _values(field, read, field.type)


def _values(field: Field, read: pa.Array, kind: pa.DataType) -> pa.Array:
    if field.names is not None:
        return field.names.named(read, kind)
    if field.within is None:
        return read.cast(kind)
    children = [_shown(one, read.field(place)) for place, one in enumerate(field.within)]
    absent = read.is_null() if read.null_count else None
    return pa.StructArray.from_arrays(children, fields=list(kind), mask=absent)


def _handler(fields: tuple[Field, ...]) -> Any:  # noqa: ANN401 - of a class without a name
    """Return a decoder of messages with these fields."""
    file = FileDescriptorProto(name="columns.proto", syntax="proto3")
    _declare(file.message_type.add(name="Columns"), fields, ".Columns")
    pool = DescriptorPool()
    pool.Add(file)
    return HandlerPool([pool.FindFileByName(file.name)]).get_for_message(pool.FindMessageTypeByName("Columns"))


def _declare(message: DescriptorProto, fields: tuple[Field, ...], path: str) -> None:
    """Give a class its fields, each message within it a class of its own."""
    groups: dict[str, int] = {}
    for place, field in enumerate(fields):
        one = message.field.add(
            name=_MAP_ENTRY[place] if message.options.map_entry else f"f{place}",
            number=field.number,
            type=field.wire_type,
            label=FieldDescriptorProto.LABEL_REPEATED
            if field.is_repeated
            else FieldDescriptorProto.LABEL_OPTIONAL,
        )
        if field.within is not None:
            nested = message.nested_type.add(name=f"F{place}Entry")
            nested.options.map_entry = field.is_map
            one.type_name = f"{path}.{nested.name}"
            _declare(nested, field.within, one.type_name)
        if field.oneof:
            if field.oneof not in groups:
                groups[field.oneof] = len(groups)
                message.oneof_decl.add(name=f"o{groups[field.oneof]}")
            one.oneof_index = groups[field.oneof]
