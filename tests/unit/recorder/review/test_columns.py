"""The record batches of a log, compared with the protobuf package's messages."""

import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap import records

from recorder.encoding.protobuf import LOGGED, message_class, schema_name
from recorder.mcap.writer import LogChannel
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Selection
from recorder.reading.topics import topic_of, typed_decoder
from recorder.review.columns import Batch, ColumnReader, columns_of
from recorder.review.export import values
from schemas.messages import Gear, Message, RawSample
from tests.support.logs import channel_of, encoded, numbered_log
from tests.support.messages import WALL_NS, gear
from tests.support.strategies import message_of


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
    """The message by the protobuf package and the typed class, as JSON."""
    row: dict[str, Any] = msgspec.to_builtins(typed_decoder(kind)(data))
    row.pop("sequence", None)
    if kind.__name__ == "RecorderEvent":
        row["message_robot"] = row.pop("robot")
    if kind.__name__ == "GatewayInfo":
        row["message_robot"] = row.pop("robot")
    return row


def fields_of(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name not in {"log_time", "publish_time", "sequence"}}


KINDS = pytest.mark.parametrize("kind", LOGGED, ids=schema_name)


def as_protobuf_writes(kind: type[msgspec.Struct], data: bytes) -> bytes:
    """The message in the protobuf package's own form: in order, without defaults."""
    parsed: Any = message_class(kind).FromString(data)
    return bytes(parsed.SerializeToString(deterministic=True))


@KINDS
@settings(max_examples=settings().max_examples // 2)
@given(data=st.data())
def test_columns_are_what_the_protobuf_package_reads(kind: type[msgspec.Struct], data: st.DataObject) -> None:
    drawn = data.draw(st.lists(message_of(cast("type[Message]", kind)), min_size=1, max_size=4))
    messages = [encoded(message) for message in drawn]
    messages += [as_protobuf_writes(kind, one) for one in messages]
    rows = rows_of(batches_of(numbered_log([channel_of(kind)], [[(1, one) for one in messages]])))
    assert [fields_of(row) for row in rows] == [typed_row(kind, one) for one in messages]
    assert [row["sequence"] for row in rows] == list(range(len(messages)))


def test_a_number_without_a_name_is_its_digits() -> None:
    data = encoded(gear(0))
    position = data.index(b"\x28\x04") + 1
    newer = data[:position] + b"\x63" + data[position + 1 :]
    messages = [data] * 20 + [newer] * 20 + [data]
    rows = rows_of(batches_of(numbered_log([channel_of(Gear)], [[(1, one) for one in messages]])))
    assert [row["gear_position"] for row in rows] == ["drive"] * 20 + ["99"] * 20 + ["drive"]


def test_what_is_no_such_message_is_counted_and_left_out() -> None:
    good = encoded(gear(7))
    beyond = good.replace(struct.pack("<Q", WALL_NS), b"\xff" * 8)
    assert beyond != good
    faults = Faults()
    messages = [(1, one) for one in [b"\x0f\xff", good, good, beyond]]
    rows = rows_of(batches_of(numbered_log([channel_of(Gear)], [messages]), faults))
    assert [row["alive_counter"] for row in rows] == [7, 7]
    assert faults.told == ["log: 2 messages of t cannot be read"]
    raw = encoded(RawSample(0, "kkkk", "", b"", b"", ""))
    faults = Faults()
    messages = [(1, one) for one in [raw, raw.replace(b"kkkk", b"kk\xff\xff")]]
    rows = rows_of(batches_of(numbered_log([channel_of(RawSample)], [messages]), faults))
    assert [row["key"] for row in rows] == ["kkkk"]
    assert faults.told == ["log: 1 messages of t cannot be read"]


def test_only_what_is_wanted_is_read() -> None:
    messages = [(1 + number % 2, encoded(gear(number))) for number in range(40)]
    data = numbered_log([channel_of(Gear, 1, "a"), channel_of(Gear, 2, "b")], [messages])
    selection = Selection(lambda topic: topic.name == "b", WALL_NS + 10, WALL_NS + 20)
    assert [row["sequence"] for row in rows_of(batches_of(data, None, selection))] == [11, 13, 15, 17, 19]
    assert not batches_of(data, None, Selection(from_ns=5, to_ns=5))
    assert not batches_of(data, None, Selection(from_ns=-5, to_ns=-1))


# Topics of others.

F = FieldDescriptorProto
NUMBERS = {
    "f_double": (F.TYPE_DOUBLE, st.floats(allow_nan=False)),
    "f_float": (F.TYPE_FLOAT, st.floats(width=32, allow_nan=False)),
    "f_int32": (F.TYPE_INT32, st.integers(-(2**31), 2**31 - 1)),
    "f_int64": (F.TYPE_INT64, st.integers(-(2**63), 2**63 - 1)),
    "f_uint32": (F.TYPE_UINT32, st.integers(0, 2**32 - 1)),
    "f_uint64": (F.TYPE_UINT64, st.integers(0, 2**64 - 1)),
    "f_sint32": (F.TYPE_SINT32, st.integers(-(2**31), 2**31 - 1)),
    "f_sint64": (F.TYPE_SINT64, st.integers(-(2**63), 2**63 - 1)),
    "f_fixed32": (F.TYPE_FIXED32, st.integers(0, 2**32 - 1)),
    "f_fixed64": (F.TYPE_FIXED64, st.integers(0, 2**64 - 1)),
    "f_sfixed32": (F.TYPE_SFIXED32, st.integers(-(2**31), 2**31 - 1)),
    "f_sfixed64": (F.TYPE_SFIXED64, st.integers(-(2**63), 2**63 - 1)),
    "f_bool": (F.TYPE_BOOL, st.booleans()),
    "f_enum": (F.TYPE_ENUM, st.sampled_from([0, 5, 300, 77])),
    "f_string": (F.TYPE_STRING, st.text(st.characters(exclude_categories=["Cs"]), max_size=5)),
}
NAMES = {0: "NOTHING", 5: "FIVE", 300: "MANY", 77: "77"}


def foreign_file() -> FileDescriptorProto:
    """A class with a field of every kind of number, once, optional and repeated, a message, and oneofs."""
    file = FileDescriptorProto(name="other.proto", package="other", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    enum = file.enum_type.add(name="Kind")
    for number, name in NAMES.items():
        if number != 77:
            enum.value.add(name=name, number=number)
    message = file.message_type.add(name="All")
    number = 0
    for name, (kind, _) in NUMBERS.items():
        for prefix, label in (("", F.LABEL_OPTIONAL), ("opt_", F.LABEL_OPTIONAL), ("rep_", F.LABEL_REPEATED)):
            number += 1
            field = message.field.add(name=prefix + name, number=number, type=kind, label=label)
            if kind == F.TYPE_ENUM:
                field.type_name = ".other.Kind"
            if prefix == "opt_":
                field.proto3_optional = True
                field.oneof_index = len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{field.name}")
    stamp = message.field.add(name="stamp", number=1000, type=F.TYPE_MESSAGE, label=F.LABEL_OPTIONAL)
    stamp.type_name = ".google.protobuf.Timestamp"
    return file


def made(file: FileDescriptorProto, name: str) -> tuple[Any, bytes]:
    files = [FileDescriptorProto.FromString(timestamp_pb2.DESCRIPTOR.serialized_pb), file]
    pool = DescriptorPool()
    for one in files:
        pool.Add(one)
    descriptors = FileDescriptorSet(file=files).SerializeToString()
    return GetMessageClass(pool.FindMessageTypeByName(name)), descriptors


ALL, ALL_SCHEMA = made(foreign_file(), "other.All")


def channel(schema: bytes, name: str = "other.All", encoding: str = "protobuf", kind: str = "") -> LogChannel:
    return LogChannel(1, "t", name, schema, schema_encoding=kind or encoding, message_encoding=encoding)


def expected(message: Any) -> dict[str, Any]:  # noqa: ANN401 - protobuf makes the class at run time
    row: dict[str, Any] = {}
    for field in ALL.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.enum_type is not None:
            # A number without a name is shown as itself.
            named = [NAMES.get(one, str(one)) for one in (value if field.is_repeated else [value])]
            value = named if field.is_repeated else named[0]
        elif field.name == "stamp":
            value = {"seconds": value.seconds, "nanos": value.nanos}
        elif field.is_repeated:
            value = list(value)
        row[field.name] = value if not field.has_presence or message.HasField(field.name) else None
    return row


@st.composite
def messages(draw: st.DrawFn) -> Any:  # noqa: ANN401
    message = ALL()
    for name, (_, numbers) in NUMBERS.items():
        if draw(st.booleans()):
            setattr(message, name, draw(numbers))
        if draw(st.booleans()):
            setattr(message, f"opt_{name}", draw(numbers))
        getattr(message, f"rep_{name}").extend(draw(st.lists(numbers, max_size=2)))
    if draw(st.booleans()):
        message.stamp.seconds = draw(st.integers(-5, 5_000_000_000))
    return message


def one_chunk(data: list[bytes]) -> bytes:
    return numbered_log([channel(ALL_SCHEMA)], [[(1, one) for one in data]])


def wires() -> dict[str, bytes]:
    """Legal encodings of a message that a recorder never uses."""
    one = ALL(f_fixed32=7, f_string="x").SerializeToString()
    return {
        "a field twice": one + ALL(f_fixed32=9).SerializeToString(),
        "a message twice": ALL(stamp={"seconds": 1}).SerializeToString()
        + ALL(stamp={"nanos": 2}).SerializeToString(),
        "unknown fields": one + b"\x80\xfa\x01\x05\x8a\xfa\x01\x02ab",
        "repeated, not packed": _unpacked(),
        "a varint of ten bytes": ALL(f_int32=-1).SerializeToString(),
        "a varint too long": b"\x38\x85\x80\x00",
        "a flag of two bytes": _tag("f_bool", 0) + b"\x80\x01",
        "the wrong wire type": _tag("f_double", 0) + b"\x05" + one,
        "a group": _tag("f_double", 3) + _tag("f_double", 4),
        "nothing": b"",
    }


def _tag(name: str, wire: int) -> bytes:
    number = ALL.DESCRIPTOR.fields_by_name[name].number << 3 | wire
    return bytes([number]) if number < 128 else bytes([number & 0x7F | 0x80, number >> 7])


def _unpacked() -> bytes:
    tag = _tag("rep_f_uint32", 0)
    packed: bytes = ALL(rep_f_uint32=[3, 300]).SerializeToString()
    return tag + b"\x05" + tag + b"\x85\x01" + packed


@pytest.mark.parametrize("wire", wires())
def test_every_legal_way_to_write_is_read(wire: str) -> None:
    data = wires()[wire]
    rows = rows_of(batches_of(one_chunk([data])))
    assert [fields_of(row) for row in rows] == [expected(ALL.FromString(data))]


@given(messages(), st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=3)), max_size=3))
@example(ALL(opt_f_enum=0), [(1.0, _tag("opt_f_enum", 0) + b"\x01")])
def test_whatever_the_bytes_are_what_protobuf_reads_is_read(
    message: Any,  # noqa: ANN401
    damage: list[tuple[float, bytes]],
) -> None:
    good = message.SerializeToString()
    data = good
    for place, noise in damage:
        at = round(place * len(data))
        data = data[:at] + noise + data[at + len(noise) :]
    rows = [fields_of(row) for row in rows_of(batches_of(one_chunk([good, data, good]), Faults()))]
    try:
        between = [expected(ALL.FromString(data))]
    except DecodeError:
        between = rows[1:-1]
    assert repr(rows) == repr([expected(message), *between, expected(message)])


def test_what_a_library_panics_at_cannot_be_read() -> None:
    """The library ptars 0.0.25 panics at a text of the greatest length."""
    good = ALL(f_int32=5).SerializeToString()
    faults = Faults()
    endless = _tag("f_string", 2) + b"\xff" * 9 + b"\x01"
    rows = rows_of(batches_of(one_chunk([good, endless, good]), faults))
    assert [row["f_int32"] for row in rows] == [5, 5]
    assert faults.told == ["log: 1 messages of t cannot be read"]


def test_json_is_text() -> None:
    faults = Faults()
    messages = [(1, b'{"a": 1}'), (1, b"\xff"), (1, b"no json")]
    log = numbered_log([channel(b"{}", "s", "json", "jsonschema")], [messages])
    rows = rows_of(batches_of(log, faults))
    assert [row["json"] for row in rows] == ['{"a": 1}', "no json"]
    assert [row["sequence"] for row in rows] == [0, 2]
    assert faults.told == ["log: 1 messages of t cannot be read"]


@pytest.mark.parametrize(
    "one",
    [channel(b"", "s", "cdr", "ros2msg"), channel(b"\xff", "other.All"), channel(ALL_SCHEMA, "other.Nothing")],
    ids=["ros 2", "broken descriptors", "a class that they lack"],
)
def test_what_nobody_can_read_is_bytes(one: LogChannel) -> None:
    rows = rows_of(batches_of(numbered_log([one], [[(1, b"\x00abc")]])))
    assert [fields_of(row) for row in rows] == [{"data": "AGFiYw=="}]


def test_no_two_columns_have_one_name() -> None:
    file = FileDescriptorProto(name="names.proto", package="other", syntax="proto3")
    message = file.message_type.add(name="Names")
    names = ["sequence", "Log_Time", "robot", "speed", "Speed", "message_robot"]
    for number, name in enumerate(names, start=1):
        message.field.add(name=name, number=number, type=F.TYPE_INT32, label=F.LABEL_OPTIONAL)
    schema = records.Schema(1, made(file, "other.Names")[1], "protobuf", "other.Names")
    columns = columns_of(topic_of(records.Channel(1, "t", "protobuf", {}, 1), schema))
    assert columns.schema.names[:3] == ["log_time", "publish_time", "sequence"]
    assert columns.schema.names[3:] == [
        *("message_sequence", "message_Log_Time", "message_robot", "speed", "message_Speed"),
        "message_message_robot",
    ]


def test_a_class_within_itself_is_kept_as_bytes() -> None:
    file = FileDescriptorProto(name="tree.proto", package="other", syntax="proto3")
    message = file.message_type.add(name="Tree")
    message.field.add(name="value", number=1, type=F.TYPE_INT32, label=F.LABEL_OPTIONAL)
    child = message.field.add(name="child", number=2, type=F.TYPE_MESSAGE, label=F.LABEL_OPTIONAL)
    child.type_name = ".other.Tree"
    kind, schema = made(file, "other.Tree")
    data = kind(value=1, child={"value": 2}).SerializeToString()
    rows = rows_of(batches_of(numbered_log([channel(schema, "other.Tree")], [[(1, data)]])))
    assert [fields_of(row) for row in rows] == [{"value": 1, "child": "CAI="}]
