"""The record batches of a log: the same as one message after the other by the protobuf package."""

import random
import struct
from array import array
from typing import Any, cast

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorder.encoding.protobuf import LOGGED, message_class, schema_name
from recorder.mcap.arrays import PADDING, Indexed, proven_places
from recorder.mcap.framing import MAGIC, MESSAGE_HEADER
from recorder.reading.logs import Faults
from recorder.reading.rows import Selection
from recorder.review.columns import UNIT_KEY
from schemas.messages import CanFrame, Drive, Gear, Message, RawSample
from tests.support.columns import batches_of, fields_of, rows_of, typed_row
from tests.support.logs import channel_of, encoded, numbered_log, small_log
from tests.support.messages import WALL_NS, can_frame, gear
from tests.support.strategies import message_of

KINDS = pytest.mark.parametrize("kind", LOGGED, ids=schema_name)


def as_protobuf_writes(kind: type[msgspec.Struct], data: bytes) -> bytes:
    """The same message in the protobuf package's own form: in order, without defaults."""
    parsed: Any = message_class(kind).FromString(data)
    return bytes(parsed.SerializeToString(deterministic=True))


@KINDS
@settings(max_examples=settings().max_examples // 2)
@given(data=st.data())
def test_columns_are_what_the_protobuf_package_reads(kind: type[msgspec.Struct], data: st.DataObject) -> None:
    """For every class in a log: what a recorder writes, and another writer, in one batch."""
    drawn = data.draw(st.lists(message_of(cast("type[Message]", kind)), min_size=1, max_size=4))
    messages = [encoded(message) for message in drawn]
    messages += [as_protobuf_writes(kind, one) for one in messages]
    rows = rows_of(batches_of(numbered_log([channel_of(kind)], [[(1, one) for one in messages]])))
    assert [fields_of(row) for row in rows] == [typed_row(kind, one) for one in messages]
    assert [row["sequence"] for row in rows] == list(range(len(messages)))


def test_times_and_units_are_told() -> None:
    """Log and publish time to the nanosecond; the unit stands in the column's metadata."""
    (batch,) = batches_of(
        numbered_log([channel_of(Drive)], [[(1, encoded(Drive(5, 0, 1, active=True, speed_mps=1.5)))]])
    )
    assert [str(field.type) for field in list(batch.rows.schema)[:3]] == [
        "timestamp[ns, tz=UTC]",
        "timestamp[ns, tz=UTC]",
        "int64",
    ]
    assert batch.rows.column("log_time")[0].value == WALL_NS
    assert batch.columns.schema.field("speed_mps").metadata == {UNIT_KEY: b"m/s"}
    assert batch.columns.schema.field("time_ns").metadata == {UNIT_KEY: b"ns"}


def test_a_number_without_a_name_is_its_digits() -> None:
    """A newer gateway may know more gears; before and behind the others nothing shifts."""
    data = encoded(gear(0))
    position = data.index(b"\x28\x04") + 1
    newer = data[:position] + b"\x63" + data[position + 1 :]
    messages = [data] * 20 + [newer] * 20 + [data]
    rows = rows_of(batches_of(numbered_log([channel_of(Gear)], [[(1, one) for one in messages]])))
    assert [row["gear_position"] for row in rows] == ["drive"] * 20 + ["99"] * 20 + ["drive"]


def test_an_enumeration_is_a_dictionary() -> None:
    """Of the values that the typed messages have."""
    (batch,) = batches_of(numbered_log([channel_of(Gear)], [[(1, encoded(gear(0)))] * 20]))
    assert pa.types.is_dictionary(batch.rows.column("gear_position").type)


def test_what_is_no_such_message_is_counted_and_left_out() -> None:
    """Bytes that nobody can read, a text that is no UTF-8, a number beyond its bounds."""
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


def wrong_indexes() -> dict[str, tuple[int, bytes]]:
    """What may be wrong with an index: from where on in its second entry, and what stands there."""
    return {
        "time": (0, struct.pack("<Q", 1)),
        "offset 0": (8, struct.pack("<Q", 0)),
        "in between": (8, struct.pack("<Q", 40)),
        "behind the end": (8, struct.pack("<Q", 1 << 33)),
        "absurd": (8, b"\xff" * 8),
        "nearly behind the end": (8, struct.pack("<Q", 10 * 62 - 5)),
    }


@pytest.mark.parametrize("wrong", wrong_indexes())
def test_a_wrong_index_is_a_fault_and_costs_nothing(wrong: str) -> None:
    """No message is lost, none is read wrongly."""
    messages = [(1, encoded(gear(number))) for number in range(10)]
    data = bytearray(numbered_log([channel_of(Gear)], [messages, messages]))
    entry = struct.pack("<Q", WALL_NS + 1)
    place = data.index(entry + struct.pack("<Q", len(messages[0][1]) + MESSAGE_HEADER.size))
    shift, new = wrong_indexes()[wrong]
    data[place + shift : place + shift + 8] = new
    faults = Faults()
    rows = rows_of(batches_of(bytes(data), faults))
    assert [row["sequence"] for row in rows] == list(range(20))
    assert len(faults.told) == 1
    assert "the message indexes behind a chunk are wrong" in faults.told[0]


def test_an_index_that_leaves_messages_out_is_wrong() -> None:
    """A chunk whose index knows nothing of one channel: its messages are read all the same."""
    messages = [(1 + number % 2, encoded(gear(number))) for number in range(40)]
    data = numbered_log([channel_of(Gear, 1, "a"), channel_of(Gear, 2, "b")], [messages])
    head = struct.pack("<BQHI", 7, 6 + 20 * 16, 2, 20 * 16)
    place = data.index(head)
    shorter = data[:place] + struct.pack("<BQ", 0x81, 6 + 20 * 16) + data[place + 9 :]
    faults = Faults()
    rows = rows_of(batches_of(shorter, faults))
    assert len(rows) == 40
    assert any("indexes behind a chunk are wrong" in fault for fault in faults.told)


def test_what_only_looks_like_a_message_is_none() -> None:
    """A record that an application made for itself, and an index that takes it for a message."""
    data = encoded(gear(0))
    size = len(data) + MESSAGE_HEADER.size
    content = bytearray(
        b"".join(MESSAGE_HEADER.pack(5, size - 9, 1, number, WALL_NS, WALL_NS) + data for number in range(2))
    )
    index = Indexed(0, 2 * size, {1: array("Q", [WALL_NS, 0, WALL_NS, size])})
    assert proven_places(np.frombuffer(bytes(content) + bytes(PADDING), np.uint8), 2 * size, [index]) is not None
    content[size] = 0x81
    assert proven_places(np.frombuffer(bytes(content) + bytes(PADDING), np.uint8), 2 * size, [index]) is None


def test_only_what_is_wanted_is_read() -> None:
    """Topics and times."""
    messages = [(1 + number % 2, encoded(gear(number))) for number in range(40)]
    data = numbered_log([channel_of(Gear, 1, "a"), channel_of(Gear, 2, "b")], [messages])
    selection = Selection(lambda topic: topic.name == "b", WALL_NS + 10, WALL_NS + 20)
    assert [row["sequence"] for row in rows_of(batches_of(data, None, selection))] == [11, 13, 15, 17, 19]
    assert not batches_of(data, None, Selection(from_ns=5, to_ns=5))
    assert not batches_of(data, None, Selection(from_ns=-5, to_ns=-1))


def test_frames_with_other_lengths_stand_in_their_places() -> None:
    """A batch of layouts by length comes out in the order of the file."""
    frames = [can_frame(number, number, bytes(number % 9), is_fd=number % 3 == 0) for number in range(300)]
    rows = rows_of(batches_of(numbered_log([channel_of(CanFrame)], [[(1, encoded(frame)) for frame in frames]])))
    assert [row["identifier"] for row in rows] == list(range(300))
    assert [row["is_fd"] for row in rows] == [frame.is_fd for frame in frames]


def test_damage_never_raises_and_never_invents() -> None:
    """Flipped bytes and cuts: what comes out was in the log."""
    data = small_log()
    good = {repr(row) for row in rows_of(batches_of(data))}
    dice = random.Random(7)  # noqa: S311 - reproducible, not secret
    for _ in range(300):
        damaged = bytearray(data)
        for _ in range(dice.randrange(1, 4)):
            damaged[dice.randrange(len(MAGIC), len(data))] ^= 1 << dice.randrange(8)
        end = len(damaged) if dice.random() < 0.7 else dice.randrange(len(MAGIC), len(damaged))
        found = rows_of(batches_of(bytes(damaged[:end]), Faults()))
        # A name of a channel or a schema outside of chunks has no checksum that a streaming reader verifies.
        assert len(found) <= len(good)


@given(st.binary(max_size=200), st.integers(0, 10_000))
def test_noise_never_raises(noise: bytes, place: int) -> None:
    """In place of a file's bytes, or of the file."""
    data = small_log()
    place = len(MAGIC) + place % (len(data) - len(MAGIC))
    batches_of(data[:place] + noise + data[place + len(noise) :], Faults())
    batches_of(MAGIC + noise, Faults())
