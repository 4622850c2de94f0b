"""The records of a file in any state."""

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from recorder.encoding.protobuf_schema import descriptor_set
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.framing import MAGIC
from recorder.mcap.reader import End, Fault, LoggedMessage, Walked, walk
from recorder.mcap.writer import McapFile
from schemas.messages import Gear
from tests.support.recorder_fakes import Disk, small_log


def walked(data: bytes) -> list[Walked]:
    """All that a walk over a file brings."""
    return list(walk(BytesIO(data), len(data)))


def of_three_chunks() -> tuple[bytes, list[int]]:
    """A file of three chunks of one message each, and the offsets of the chunks."""
    disk = Disk()
    file = McapFile(disk, "test")
    file.add_channel(LogChannel(1, "t", "cruiser.Gear", descriptor_set(Gear)))
    offsets = []
    for number in range(3):
        builder = ChunkBuilder()
        builder.add(1, number, number, number, bytes(20))
        chunk = builder.seal()
        assert chunk is not None
        offsets.append(file.size)
        file.write_chunk(chunk)
    file.finish()
    return disk.getvalue(), offsets


def test_a_whole_file_ends_without_fault() -> None:
    """All its messages, and the end."""
    found = walked(small_log())
    assert not [one for one in found if isinstance(one, Fault)]
    assert isinstance(found[-1], End)
    assert sum(isinstance(one, LoggedMessage) for one in found) == 12


def test_a_cut_is_a_fault_wherever_it_is() -> None:
    """At every byte: what is before the cut is read, then the fault says so, and nothing raises."""
    data, _ = of_three_chunks()
    messages = 0
    for size in range(len(MAGIC), len(data)):
        found = walked(data[:size])
        last = found[-1]
        assert isinstance(last, Fault)
        assert last.cuts
        count = sum(isinstance(one, LoggedMessage) for one in found)
        assert count >= messages, "a longer file holds no less"
        messages = count
    assert messages == 3


def test_every_flipped_byte_is_noticed() -> None:
    """No damage goes unseen: the checksums cover the whole file."""
    data, _ = of_three_chunks()
    for place in range(len(MAGIC), len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        assert any(isinstance(one, Fault) for one in walked(bytes(damaged))), place


@given(st.binary(max_size=300), st.integers(0, 10_000))
def test_nothing_that_a_file_may_hold_raises(noise: bytes, place: int) -> None:
    """Noise in place of a file's bytes, or of the file."""
    data = small_log()
    place = len(MAGIC) + place % (len(data) - len(MAGIC))
    assert walked(data[:place] + noise + data[place + len(noise) :])
    walked(MAGIC + noise)


def test_a_damaged_chunk_costs_its_own_messages_only() -> None:
    """The schema and the channel are outside of the chunks."""
    data, offsets = of_three_chunks()
    damaged = bytearray(data)
    damaged[offsets[1] + 60] ^= 0xFF
    found = walked(bytes(damaged))
    assert [one.sequence for one in found if isinstance(one, LoggedMessage)] == [0, 2]
    faults = [one for one in found if isinstance(one, Fault)]
    assert faults[0].offset == offsets[1]
    assert not faults[0].cuts
    assert isinstance(found[-1], End)


def test_bytes_behind_the_end_are_a_fault() -> None:
    """As when a file was written over a longer one."""
    found = walked(small_log() + b"more")
    assert [type(one) for one in found[-2:]] == [Fault, End]


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("chunked", [True, False])
def test_files_of_others_are_read(compression: CompressionType, chunked: bool) -> None:  # noqa: FBT001 - a parameter
    """Those of the mcap package's writer, in every compression, with and without chunks and checksums."""
    for enable_crcs in (True, False):
        stream = BytesIO()
        writer = Writer(
            stream,
            compression=compression,
            use_chunking=chunked,
            enable_crcs=enable_crcs,
            enable_data_crcs=enable_crcs,
        )
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channel = writer.register_channel("t", "json", schema)
        for number in range(3):
            writer.add_message(channel, number, b"{}", number, number)
        writer.add_attachment(1, 1, "a", "text/plain", b"abc")
        writer.finish()
        found = walked(stream.getvalue())
        assert [one.sequence for one in found if isinstance(one, LoggedMessage)] == [0, 1, 2]
        assert isinstance(found[-1], End)
        assert not [one for one in found if isinstance(one, Fault)]


def test_a_wrong_channel_of_an_unfinished_log_is_a_fault() -> None:
    """Its check tells; MCAP's own checksum of the data stands at the end that the log does not have."""
    data, offsets = of_three_chunks()
    part = data[: offsets[2]].replace(b"\x01\x00\x00\x00t\x08", b"\x01\x00\x00\x00u\x08")
    faults = [one for one in walked(part) if isinstance(one, Fault)]
    assert [fault.detail for fault in faults] == [
        "the check of the record before is wrong",
        "the file ends without a footer",
    ]
