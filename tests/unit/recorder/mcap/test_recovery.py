"""Recovery of damaged and unfinished files; the independent mcap package reads the result."""

import random
from io import BytesIO
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import Writer

from recorder.encoding.protobuf import descriptor_set
from recorder.mcap import framing
from recorder.mcap.recovery import FileSurvey, copy_good, survey
from recorder.mcap.writer import LogChannel, McapFile
from recorder.review.check import check_stream
from schemas.messages import Gear
from tests.support.logs import flipped, foreign_log, gear_message, own_log, sealed, small_log
from tests.support.nights import by_night

Row = tuple[str, str, bytes, int, int, int, bytes]
LOG = small_log()


def rows(data: bytes, reader: Any = make_reader) -> list[Row]:  # noqa: ANN401 - the package's readers share no type
    return [
        (channel.topic, schema.name, schema.data, one.sequence, one.log_time, one.publish_time, one.data)
        for schema, channel, one in reader(BytesIO(data), validate_crcs=True).iter_messages(log_time_order=False)
    ]


def others(data: bytes) -> list[object]:
    reader = make_reader(BytesIO(data), validate_crcs=True)
    metadata: list[object] = [(one.name, sorted(one.metadata.items())) for one in reader.iter_metadata()]
    return metadata + [(one.name, one.media_type, one.data) for one in reader.iter_attachments()]


def repaired(data: bytes) -> tuple[FileSurvey, bytes]:
    found = survey(BytesIO(data), len(data))
    if found.fault_count or not found.end:
        copy = BytesIO()
        copy_good(BytesIO(data), len(data), copy, "test")
        return found, copy.getvalue()
    return found, data if found.is_whole else data[: found.end] + found.ending


def chunks_of(count: int, each: int = 3) -> tuple[bytes, list[int]]:
    stream = BytesIO()
    file = McapFile(stream, "test")
    for number in (1, 2):
        file.add_channel(LogChannel(number, f"t/{number}", "cruiser.Gear", descriptor_set(Gear)))
    ends = []
    for number in range(count):
        file.write_chunk(
            sealed(
                (1 + one % 2, number * each + one, 1000 + number, 2000 + one, bytes([number, one]) * 20)
                for one in range(each)
            )
        )
        ends.append(file.size)
    file.finish()
    return stream.getvalue(), ends


ROWS = rows(LOG)
OTHERS = others(LOG)
CHUNKS, ENDS = chunks_of(4)


def test_a_chunk_of_which_nothing_is_left_is_left_out() -> None:
    """An empty chunk has the checksum 0, which would look like damage."""
    channels = [LogChannel(number, f"t/{number}", "cruiser.Gear", descriptor_set(Gear)) for number in (1, 2)]
    log = own_log([[gear_message(0, 10, 1)], [gear_message(1, 20, 2)]], channels)
    _, result = repaired(log.replace(b"t/1", b"t/0"))
    assert [one[0] for one in rows(result)] == ["t/2"]
    assert survey(BytesIO(result), len(result)).fault_count == 0


def test_a_copy_can_be_recovered_again() -> None:
    for data in (foreign_log(), LOG[:8] + b"\xff" * 600 + LOG[608:]):
        copy, again = BytesIO(), BytesIO()
        copy_good(BytesIO(data), len(data), copy, "test")
        copy_good(copy, len(copy.getvalue()), again, "test")
        assert rows(again.getvalue()) == rows(copy.getvalue()) != []
        assert survey(copy, len(copy.getvalue())).fault_count == 0


def test_a_log_cut_off_at_any_byte_is_whole_up_to_there() -> None:
    """All whole chunks are there, by index and in one pass; the rest is a torn write."""
    every_chunk = rows(CHUNKS)
    for size in range(len(CHUNKS)):
        found, result = repaired(CHUNKS[:size])
        expected = every_chunk[: 3 * sum(end <= size for end in ENDS)]
        read = rows(result)
        assert read[: len(expected)] == expected
        assert read == every_chunk[: len(read)]
        assert sorted(rows(result, NonSeekingReader)) == sorted(read)
        assert (found.fault_count, found.is_torn, found.messages) == (0, True, len(read))


@given(st.integers(0, len(LOG)))
def test_a_recovered_log_says_what_it_holds(size: int) -> None:
    _, result = repaired(LOG[:size])
    summary = make_reader(BytesIO(result), validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(rows(result))
    assert [one for one in others(result) if one not in OTHERS] == []
    assert survey(BytesIO(result), len(result)).is_whole
    assert check_stream(BytesIO(result), len(result), "x").whole


def test_a_recovery_that_was_broken_off_is_done_again() -> None:
    _, result = repaired(CHUNKS[: ENDS[2] + 40])
    for size in range(ENDS[2], len(result)):
        assert repaired(result[:size])[1] == result


@pytest.mark.parametrize("step", [41, by_night(5)])
@pytest.mark.parametrize("is_finished", [True, False])
def test_a_flipped_bit_is_never_silently_wrong_data(*, is_finished: bool, step: int) -> None:
    """Readable data is as written; the rest is reported, or the torn end."""
    data = LOG if is_finished else LOG[: LOG.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")]
    chooser = random.Random(7)  # noqa: S311 - reproducible, not secret
    for place in range(is_finished, len(data), step):
        damaged = bytearray(data)
        damaged[place] ^= 1 << chooser.randrange(8)
        found, result = repaired(bytes(damaged))
        read = rows(result)
        assert [row for row in read if row not in ROWS] == []
        assert len(read) == len(set(read))
        assert [one for one in others(result) if one not in OTHERS] == []
        if len(read) < len(ROWS):
            # The last chunk alone may go without a fault: its length says that it is longer than the file.
            assert found.fault_count or not found.is_torn or not is_finished


@pytest.mark.parametrize(
    ("data", "sequences", "fault_count", "is_torn"),
    [
        (flipped(CHUNKS, ENDS[0] + 1, 0x40), [0, 1, 2, *range(6, 12)], 1, False),
        (flipped(CHUNKS, ENDS[0] + 100, 0x40), [0, 1, 2, *range(6, 12)], 1, False),
        (CHUNKS[: ENDS[1]] + bytes(5000), list(range(6)), 0, True),
        (flipped(CHUNKS[: ENDS[1]], ENDS[0] + 100, 1), [0, 1, 2], 0, False),
    ],
    ids=["a length in the middle", "a content in the middle", "zeros of a power cut behind", "a last chunk"],
)
def test_damage_costs_its_own_chunk(data: bytes, sequences: list[int], fault_count: int, *, is_torn: bool) -> None:
    found, result = repaired(data)
    assert [row[3] for row in rows(result)] == sequences
    assert (found.fault_count, found.is_torn or bool(found.fault_count)) == (
        fault_count,
        is_torn or bool(fault_count),
    )


def test_a_lost_schema_costs_the_messages_of_its_channels() -> None:
    lost = b"cruiser.CanFrame", b"Cruiser.CanFrame"
    assert rows(repaired(LOG.replace(*lost, 1))[1]) == ROWS
    found, result = repaired(LOG.replace(*lost))
    assert rows(result) == [row for row in ROWS if row[1] != "cruiser.CanFrame"]
    assert any("5 messages" in fault for fault in found.faults)


def test_a_log_of_others_whose_data_checksum_is_wrong_is_not_called_good() -> None:
    """A message outside of chunks has no checksum of its own."""
    stream = BytesIO()
    writer = Writer(stream, use_chunking=False, enable_data_crcs=True)
    writer.start("", "other")
    channel = writer.register_channel("t", "json", writer.register_schema("s", "jsonschema", b"{}"))
    writer.add_message(channel, 1, b'{"a": 1}', 1, 1)
    writer.finish()
    damaged = stream.getvalue().replace(b'{"a": 1}', b'{"a": 9}')
    found = survey(BytesIO(damaged), len(damaged))
    assert (found.is_whole, found.fault_count) == (False, 1)


def test_a_length_that_nobody_means_costs_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    longest = max(one - two for one, two in pairwise([*ENDS[::-1], 0]))
    monkeypatch.setattr(framing, "RECORD_MAX", longest)
    stream = Watched(CHUNKS[: ENDS[0]] + b"\x06" + (3 * longest).to_bytes(8, "little") + bytes(10 * longest))
    found = survey(stream, len(stream.getvalue()))
    assert (found.messages, found.end) == (3, ENDS[0])
    assert 3 * longest not in stream.lengths


class Watched(BytesIO):
    """A stream that records what was read."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.lengths: set[int | None] = set()

    def read(self, size: int | None = -1, /) -> bytes:
        self.lengths.add(size)
        return super().read(size)
