"""Messages of a log as Arrow columns, topic by topic, without a loop over messages.

Unsigned numbers of 32 bits become int64, and so do those of 64 bits with bounds in their schema, so that SQL can
subtract them. Enumerations become names; for our own classes, the values of the typed messages. A topic that
cannot be decoded has one column, ``json`` or ``data``.

The Rust library ptars reads many protobuf messages at once. It gets artificial names of fields and messages,
because it would turn ``google.protobuf.Timestamp`` and others into times of less range.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from enum import Enum
from functools import cache
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np
import pyarrow as pa
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from msgspec import inspect
from numpy.typing import NDArray
from ptars import HandlerPool

from recorder.encoding.protobuf import fields, message_class, optional_part
from recorder.mcap.arrays import Blocks, Bytes, Places
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import END_OF_TIME_NS, BlockReader, Progress, Selection, place_of, table_of
from recorder.reading.topics import Topic, foreign_class
from schemas.messages import UNIT_KEYWORD

_F: Final = FieldDescriptor
_TYPES: Final[Mapping[int, pa.DataType]] = {
    _F.TYPE_DOUBLE: pa.float64(),
    _F.TYPE_FLOAT: pa.float32(),
    _F.TYPE_FIXED64: pa.uint64(),
    _F.TYPE_SFIXED64: pa.int64(),
    _F.TYPE_FIXED32: pa.int64(),
    _F.TYPE_SFIXED32: pa.int32(),
    _F.TYPE_INT32: pa.int32(),
    _F.TYPE_INT64: pa.int64(),
    _F.TYPE_UINT32: pa.int64(),
    _F.TYPE_UINT64: pa.uint64(),
    _F.TYPE_SINT32: pa.int32(),
    _F.TYPE_SINT64: pa.int64(),
    _F.TYPE_BOOL: pa.bool_(),
    _F.TYPE_STRING: pa.string(),
    _F.TYPE_BYTES: pa.binary(),
}
"""The Arrow type of a column, by the descriptor's type of field."""

NAMES_TYPE: Final = pa.dictionary(pa.int32(), pa.string())


class EnumNames:
    """The names of an enumeration's numbers, each with a place; unknown numbers are added when they occur."""

    def __init__(self, names: Mapping[int, str]) -> None:
        self._names = list(names.values())
        self._places = {number: place for place, number in enumerate(names)}
        self._first = next(iter(names))
        # If each number is its own place, as in all our classes, no lookup is needed.
        self._dense = len(names) if list(names) == list(range(len(names))) else 0

    def named(self, numbers: pa.Array, kind: pa.DataType) -> pa.Array:
        """The names of numbers, as a dictionary or text array."""
        places = self._places_of(numbers.fill_null(self._first).to_numpy())
        indices = pa.array(places, pa.int32(), mask=np.asarray(numbers.is_null()) if numbers.null_count else None)
        names = pa.array(self._names, pa.string())
        return pa.DictionaryArray.from_arrays(indices, names) if kind == NAMES_TYPE else names.take(indices)

    def _places_of(self, numbers: NDArray[np.int32]) -> NDArray[np.int32]:
        if not len(numbers) or (self._dense and numbers.min() >= 0 and numbers.max() < self._dense):
            return numbers
        unique, which = np.unique(numbers, return_inverse=True)
        return np.array([self._place(int(number)) for number in unique], np.int32)[which]

    def _place(self, number: int) -> int:
        place = self._places.get(number)
        if place is None:
            place = self._places[number] = len(self._names)
            self._names.append(str(number))
        return place


class Field(msgspec.Struct, frozen=True, eq=False):
    """A field.

    Attributes:
        wire_type: the descriptor's type that is read: for an enumeration a number, for a recursive message bytes.
        oneof: the group of fields of which a message has at most one, perhaps only this one; empty for a field
        that
            has its default when absent.
        within: the fields of a message; None for other types.
    """

    name: str
    number: int
    wire_type: int
    is_repeated: bool
    is_map: bool
    oneof: str
    names: EnumNames | None
    within: tuple[Field, ...] | None
    type: pa.DataType
    unit: str


class Known(msgspec.Struct, frozen=True):
    """Facts about our own classes beside their descriptors: values of enumerations, units by class and field."""

    values: dict[str, list[str]]
    units: dict[tuple[str, str], str]


# The class of descriptors depends on protobuf's implementation, Python or C.
def fields_of(descriptor: Any, known: Known | None = None, outer: tuple[str, ...] = ()) -> tuple[Field, ...]:  # noqa: ANN401
    """The fields of a class, in order; ``known`` if it is ours. TypeError if it has a group, which is obsolete."""
    outer = (*outer, descriptor.full_name)
    return tuple(_field(field, known, outer) for field in descriptor.fields)


def own_fields(kind: type[msgspec.Struct]) -> tuple[Field, ...]:
    """New fields of a class of ours: they collect unknown names."""
    return fields_of(message_class(kind).DESCRIPTOR, _known(kind))


def _field(field: Any, known: Known | None, outer: tuple[str, ...]) -> Field:  # noqa: ANN401
    names = within = None
    wire_type = field.type
    is_map = wire_type == _F.TYPE_MESSAGE and bool(field.message_type.GetOptions().map_entry)
    kind: pa.DataType
    if wire_type == _F.TYPE_MESSAGE and field.message_type.full_name not in outer:
        within = fields_of(field.message_type, known, outer)
        kind = (
            pa.map_(*[one.type for one in within])
            if is_map
            else pa.struct([(one.name, one.type) for one in within])
        )
    elif wire_type == _F.TYPE_MESSAGE:
        wire_type, kind = _F.TYPE_BYTES, pa.binary()
    elif wire_type == _F.TYPE_ENUM:
        wire_type, names = _F.TYPE_INT32, _enum_names(field.enum_type, known)
        # Some readers, such as DuckDB, support no dictionaries within lists.
        kind = NAMES_TYPE if len(outer) == 1 and not field.is_repeated else pa.string()
    elif wire_type not in _TYPES:
        raise TypeError(f"{field.name} is a group")
    elif known is not None and wire_type == _F.TYPE_FIXED64:
        kind = pa.int64()
    else:
        kind = _TYPES[wire_type]
    oneof = ""
    if field.containing_oneof is not None:
        oneof = field.containing_oneof.name
    elif field.has_presence and within is None:
        oneof = f"{field.name} alone"
    return Field(
        name=field.name,
        number=field.number,
        wire_type=wire_type,
        is_repeated=field.is_repeated,
        is_map=is_map,
        oneof=oneof,
        names=names,
        within=within,
        type=pa.list_(kind) if field.is_repeated and not is_map else kind,
        unit="" if known is None else known.units.get((field.containing_type.name, field.name), ""),
    )


def _enum_names(enum: Any, known: Known | None) -> EnumNames:  # noqa: ANN401
    values = known.values.get(enum.name) if known is not None else None
    if values is not None:
        return EnumNames(dict(enumerate(values)))
    return EnumNames({number: value.name for number, value in enum.values_by_number.items()})


@cache
def _known(kind: type[msgspec.Struct]) -> Known:
    values = {one.__name__: [str(member.value) for member in one] for one in _enums(kind)}
    definitions = msgspec.json.schema(kind)["$defs"]
    units = {
        (name, field): unit
        for name, part in definitions.items()
        for field, described in part.get("properties", {}).items()
        if (unit := _unit(described))
    }
    return Known(values, units)


def _enums(kind: type[msgspec.Struct]) -> Iterator[type[Enum]]:
    for _, _, declared in fields(kind):
        field = optional_part(declared) or declared
        if isinstance(field, inspect.ListType):
            field = field.item_type
        if isinstance(field, inspect.EnumType):
            yield field.cls
        elif isinstance(field, inspect.StructType):
            yield from _enums(field.cls)


def _unit(described: Mapping[str, Any]) -> str:
    """The unit in the JSON Schema of a field, within lists and nulls."""
    options = [described, described.get("items", {}), *described.get("anyOf", ())]
    return next((str(one[UNIT_KEYWORD]) for one in options if UNIT_KEYWORD in one), "")


TIME_TYPE: Final = pa.timestamp("ns", "UTC")
TIME_MAX_NS: Final = 2**63 - 1  # the last time of Arrow

LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC = "log_time", "publish_time", "sequence", "robot", "topic"

HEAD: Final = (
    pa.field(LOG_TIME, TIME_TYPE, nullable=False),
    pa.field(PUBLISH_TIME, TIME_TYPE, nullable=False),
    pa.field(SEQUENCE, pa.int64(), nullable=False),
)
"""The first columns of every table: time of receipt, the source's time, and the source's count."""

RESERVED: Final = frozenset({LOG_TIME, PUBLISH_TIME, SEQUENCE, ROBOT, TOPIC, "date"})
"""Names that no field may have: a dataset's directories are columns too."""

FIELD_PREFIX: Final = "message_"  # before a field's name that is taken
UNIT_KEY: Final = b"unit"


class Columns(msgspec.Struct, frozen=True, eq=False):
    """The columns of a topic's table.

    Attributes:
        table: its name in SQL: ``chassis_drive``, ``can_rx``.
        place: for our keys, the topic without root and robot: ``chassis/drive``, ``can/can0/rx``.
        robot: the robot's name; empty if there is none.
        schema: of the record batches, with units as metadata.
        read: bytes to a message of the protobuf package; None if it is not protobuf.
        fields: the fields that are columns.
    """

    topic: Topic
    table: str
    place: str
    robot: str
    schema: pa.Schema
    read: Callable[[bytes], Any] | None
    fields: tuple[Field, ...] | None


def columns_of(topic: Topic) -> Columns:
    place, robot = place_of(topic)
    columns = list(HEAD)
    read, fields = _protobuf(topic)
    if fields is not None:
        taken = set(RESERVED)
        columns += [_column(field, taken) for field in fields]
    elif topic.encoding == "json":
        columns.append(pa.field("json", pa.string()))
    else:
        columns.append(pa.field("data", pa.binary()))
    return Columns(topic, table_of(topic), place, robot, pa.schema(columns), read, fields)


def _column(field: Field, taken: set[str]) -> pa.Field:
    name = field.name
    # SQL ignores case.
    while name.lower() in taken:
        name = FIELD_PREFIX + name
    taken.add(name.lower())
    return pa.field(name, field.type, metadata={UNIT_KEY: field.unit.encode()} if field.unit else None)


def _protobuf(topic: Topic) -> tuple[Callable[[bytes], Any] | None, tuple[Field, ...] | None]:
    """A topic's decoder and fields; None twice if it cannot be decoded."""
    if topic.kind is not None:
        # The sequence of a message of ours is that of its record.
        fields = tuple(field for field in own_fields(topic.kind) if field.name != SEQUENCE)
        return message_class(topic.kind).FromString, fields
    found = foreign_class(topic.schema, topic.schema_data) if topic.encoding == "protobuf" else None
    if found is None:
        return None, None
    try:
        foreign = fields_of(found.DESCRIPTOR)
    except TypeError:
        return None, None
    return (found.FromString, foreign) if foreign else (None, None)


_MAP_ENTRY: Final = ("key", "value")


class Decoder:
    """Turns the messages of a topic into record batches.

    Attributes:
        left_out: numbers of the unreadable messages of the last batch.
        broken: number of unreadable messages so far.
    """

    def __init__(self, columns: Columns, wanted: Collection[str] | None = None) -> None:
        self.columns = columns
        self.left_out: list[int] = []
        self.broken = 0
        names = columns.schema.names
        places = [place for place, name in enumerate(names) if wanted is None or name in wanted]
        self.schema = pa.schema([columns.schema.field(place) for place in places])
        self._head = [place for place in places if place < len(HEAD)]
        self._behind = [place - len(HEAD) for place in places if place >= len(HEAD)]
        self._handler: Any = None if columns.fields is None else _handler(columns.fields)

    def batch(self, content: Bytes, places: Places) -> pa.RecordBatch:
        """The messages at these places; unreadable ones are left out and counted."""
        messages = _messages(content, places)
        found, self.left_out = self._read(messages), []
        if found is None:
            self.left_out = [row for row, one in enumerate(messages) if not self._reads(one)]
            self.broken += len(self.left_out)
            rows = np.delete(np.arange(len(messages)), self.left_out)
            places = places.only(rows)
            found = self._read(messages.take(pa.array(rows))) or []
        head = [
            _times(places.log_ns(content)),
            _times(places.publish_ns(content)),
            pa.array(places.sequences(content).astype(np.int64)),
        ]
        return pa.RecordBatch.from_arrays([*(head[place] for place in self._head), *found], schema=self.schema)

    def _read(self, messages: pa.Array) -> list[pa.Array] | None:
        """The wanted columns behind the head; None if a message cannot be read."""
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
            # A Rust panic, whose class pyo3 does not export.
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
    """The data of each message: every other piece of the content, cut at their starts and ends."""
    cuts = np.empty(2 * len(places.offsets), np.int32)
    cuts[0::2], cuts[1::2] = places.offsets, places.offsets + places.lengths
    pieces = pa.Array.from_buffers(
        pa.binary(), len(cuts) - 1, [None, pa.py_buffer(cuts), pa.py_buffer(content)], null_count=0
    )
    return pieces.take(pa.array(np.arange(0, len(cuts), 2)))


def _times(numbers: NDArray[np.unsignedinteger]) -> pa.Array:
    """Nanoseconds since 1970 as Arrow times, limited to TIME_MAX_NS."""
    return pa.array(np.minimum(numbers, np.uint64(TIME_MAX_NS)).astype(np.int64)).view(TIME_TYPE)


def _shown(field: Field, read: pa.Array) -> pa.Array:
    """A column in its final type; ValueError if a number is beyond its bounds."""
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
    file = FileDescriptorProto(name="columns.proto", syntax="proto3")
    _declare(file.message_type.add(name="Columns"), fields, ".Columns")
    pool = DescriptorPool()
    pool.Add(file)
    return HandlerPool([pool.FindFileByName(file.name)]).get_for_message(pool.FindMessageTypeByName("Columns"))


def _declare(message: DescriptorProto, fields: tuple[Field, ...], path: str) -> None:
    """Add the fields to a class, with nested classes for messages."""
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


BATCH_BYTES: Final = 4_000_000  # unpacked at once, to amortise the cost of a batch


class Batch(msgspec.Struct, frozen=True, eq=False):
    """Messages of one topic."""

    columns: Columns
    rows: pa.RecordBatch


def read_batches(
    log: LogFile,
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Iterator[Batch]:
    """The batches of a log, each of one topic in the order of the file."""
    try:
        with log.path.open("rb") as stream:
            yield from ColumnReader(stream, log, selection, faults).batches(progress)
    except OSError as error:
        faults.add(f"{log.path}: {error.strerror or error}")


class ColumnReader(BlockReader):
    """Reads the batches of one log."""

    def __init__(self, stream: BinaryIO, log: LogFile, selection: Selection, faults: Faults) -> None:
        super().__init__(stream, log, selection, faults)
        self._decoders: dict[int, Decoder] = {}

    def batches(self, progress: Progress) -> Iterator[Batch]:
        pending = Blocks()
        for block, index in self.blocks(progress):
            pending.add(block, index)
            if pending.size >= BATCH_BYTES:
                yield from self._read(pending)
                pending = Blocks()
        yield from self._read(pending)
        for channel_id, decoder in self._decoders.items():
            if decoder.broken:
                self.fault(f"{decoder.broken} messages of {self.topics[channel_id].name} cannot be read")

    def _read(self, pending: Blocks) -> Iterator[Batch]:
        if not pending.size:
            return
        read = pending.read(known=self.topics)
        for place in read.wrong:
            self.wrong_index(pending.blocks[place])
        for _, one in read.others:
            self.take(one)
        for channel, found in read.places.items():
            if channel in self.wanted:
                yield from self._batch(self._decoder(channel), read.content, found)
            elif channel not in self.topics:
                self.fault(f"{len(found.offsets)} messages of channel {channel}, which the file does not hold")

    def _decoder(self, channel: int) -> Decoder:
        if channel not in self._decoders:
            self._decoders[channel] = Decoder(columns_of(self.wanted[channel]))
        return self._decoders[channel]

    def _batch(self, decoder: Decoder, content: Bytes, places: Places) -> Iterator[Batch]:
        from_ns, to_ns = self.selection.from_ns, self.selection.to_ns
        if from_ns > 0 or to_ns < END_OF_TIME_NS:
            log_ns = places.log_ns(content)
            first, last = max(from_ns, 0), min(max(to_ns, 0), END_OF_TIME_NS) - 1
            is_within = (log_ns >= np.uint64(min(first, END_OF_TIME_NS - 1))) & (log_ns <= np.uint64(max(last, 0)))
            places = places.only(is_within & (last >= first))
        if len(places.offsets):
            batch = decoder.batch(content, places)
            if batch.num_rows:
                yield Batch(decoder.columns, batch)
