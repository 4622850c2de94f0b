"""A file piece by piece, and message by message, in any state."""

from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType

from recorder.mcap.framing import MAGIC, MESSAGE_HEADER
from recorder.mcap.reader import (
    End,
    Fault,
    LoggedMessage,
    PackedChunk,
    Piece,
    read_pieces,
)
from tests.support.logs import foreign_log, gears, own_log
from tests.support.walking import walk

LOG = own_log([gears(3 * number, 3, 100 * number) for number in range(1, 5)], metadata=[("m", {"a": "b"})])


class CountingStream(BytesIO):
    """A stream that counts the bytes read."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.count = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.count += len(data)
        return data


def pieces(data: bytes, **given: Any) -> list[Piece]:  # noqa: ANN401 - the reader's own arguments
    return list(read_pieces(BytesIO(data), len(data), **given))


def walked(data: bytes) -> list[Piece | LoggedMessage]:
    return list(walk(BytesIO(data), len(data)))


def chunks(data: bytes) -> list[PackedChunk]:
    return [piece for piece in pieces(data) if isinstance(piece, PackedChunk)]


def test_a_chunk_tells_what_is_in_it_before_it_is_unpacked() -> None:
    for number, chunk in enumerate(chunks(LOG), start=1):
        assert (chunk.start_ns, chunk.end_ns) == (100 * number, 100 * number + 20)
        block = chunk.unpack()
        assert chunk.index == block.read_index()[0]
        assert chunk.places == {1: chunk.offset + chunk.length}
        assert LOG[chunk.places[1]] == 7
        assert [MESSAGE_HEADER.unpack_from(block.content, start)[3] for start in chunk.index[1][1::2]] == [
            3 * number + place for place in range(3)
        ]


def test_what_is_not_unpacked_is_not_read() -> None:
    big = foreign_log([1], data=b'"' + b"x" * 1_000_000 + b'"', compression=CompressionType.NONE)
    stream = CountingStream(big)
    assert any(isinstance(piece, PackedChunk) for piece in read_pieces(stream, len(big), is_verifying=False))
    assert stream.count < 100_000


@pytest.mark.parametrize(
    ("start", "bytes_"),
    [(0, bytes(40)), (7, b"\x7f"), (60, b"\xff")],
    ids=["its head is lost", "its length leads nowhere", "its content is wrong"],
)
def test_a_damaged_chunk_costs_its_own_messages_only(start: int, bytes_: bytes) -> None:
    second = chunks(LOG)[1]
    place = second.offset + start
    damaged = LOG[:place] + bytes_ + LOG[place + len(bytes_) :]
    found = walked(damaged)
    assert [one.sequence for one in found if isinstance(one, LoggedMessage)] == [3, 4, 5, *range(9, 15)]
    faults = [one for one in found if isinstance(one, Fault)]
    assert faults[0].offset == second.offset
    assert not any(fault.cuts for fault in faults)
    for is_verifying in (True, False):
        starts = [
            one.start_ns for one in pieces(damaged, is_verifying=is_verifying) if isinstance(one, PackedChunk)
        ]
        assert [start_ns for start_ns in starts if start_ns != 200] == [100, 300, 400]
    assert isinstance(found[-1], End)


@given(st.binary(max_size=300), st.integers(0, 10_000), st.booleans())
def test_nothing_that_a_file_may_hold_raises(noise: bytes, place: int, is_verifying: bool) -> None:  # noqa: FBT001 - a parameter
    place = len(MAGIC) + place % (len(LOG) - len(MAGIC))
    for data in (LOG[:place] + noise + LOG[place + len(noise) :], MAGIC + noise):
        assert isinstance(pieces(data, is_verifying=is_verifying)[-1], End | Fault)
        assert isinstance(walked(data)[-1], End | Fault)


def test_bytes_behind_the_end_are_a_fault() -> None:
    found = walked(LOG + b"more")
    assert [type(one) for one in found[-2:]] == [Fault, End]


def test_a_wrong_channel_of_an_unfinished_log_is_a_fault() -> None:
    part = LOG[: chunks(LOG)[2].offset].replace(b"chassis/gear", b"chassis/fear")
    faults = [one for one in walked(part) if isinstance(one, Fault)]
    assert [fault.detail for fault in faults] == [
        "the check of the record before is wrong",
        "the file ends without a footer",
    ]
