"""Our MCAP files have the frozen bytes: a file of the writer, and a recorder's log."""

from collections.abc import Callable
from hashlib import sha256
from io import BytesIO

import pytest
import zstandard
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from recorder.mcap.writer import LogChannel
from tests.support.logs import Log, mcap_log
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, batch, feedback, gear, sample_of

CHANNELS = [
    LogChannel(1, "first", "thing", b"schema of a thing"),
    LogChannel(7, "second", "thing", b"schema of a thing", metadata={"who": "else", "a": "b"}),
    LogChannel(3, "third", "", b"", schema_encoding="", message_encoding="json"),
]


def by_the_writer() -> bytes:
    packed = [
        [(1 + 2 * (n % 2), n, WALL_NS + n * MS, WALL_NS - n, b"%d" % n * (n % 5)) for n in range(first, first + 9)]
        for first in (40, 0, 20)
    ]
    return mcap_log(CHANNELS, packed, [("note", {"b": "1", "a": "2"})], [("picture", b"\0\1\2"), ("none", b"")])


def by_a_recorder() -> bytes:
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in range(50)))
    log.receive(sample_of(batch(0, [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(20)])))
    log.tick(SECOND)
    log.receive(FakeSample("fleet/elsewhere", "text/plain", b"hello"), now_ns=2 * SECOND, wall_ns=WALL_NS + SECOND)
    log.receive(sample_of(gear(60)), now_ns=2 * SECOND, wall_ns=WALL_NS + SECOND)
    return log.close(3 * SECOND)


class Stored:
    """Replaces the compressor, whose bytes depend on its version: stores unpacked."""

    def __init__(self, level: int) -> None:
        """Of any level."""

    def compress(self, data: bytes) -> bytes:
        return bytes(data)


FROZEN = {
    by_the_writer: "4879b5cf266c23fda7e5d724e29f0139aa86ae70e61acf519ff3fb3f819dfa7b",
    by_a_recorder: "1f7af2901dc80ef1faec46592f816e7cec04a1e16491b2ae92c13c7340a9958d",
}
"""SHA-256."""


def stored(maker: Callable[[], bytes]) -> bytes:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zstandard, "ZstdCompressor", Stored)
        return maker()


@pytest.mark.parametrize("maker", FROZEN)
def test_a_file_has_the_frozen_bytes(maker: Callable[[], bytes]) -> None:
    """Except the compression of its chunks."""
    assert sha256(stored(maker)).hexdigest() == FROZEN[maker]


def chunks(data: bytes, unpack: Callable[[bytes], bytes]) -> list[tuple[str, int, int, int, bytes]]:
    return [
        (one.compression, one.message_start_time, one.message_end_time, one.uncompressed_crc, unpack(one.data))
        for one in StreamReader(BytesIO(data), emit_chunks=True).records
        if isinstance(one, Chunk)
    ]


@pytest.mark.parametrize("maker", FROZEN)
def test_its_chunks_hold_the_frozen_messages_compressed(maker: Callable[[], bytes]) -> None:
    assert chunks(maker(), zstandard.decompress) == chunks(stored(maker), bytes)
