"""The records of an MCAP file one by one, whatever state the file is in.

Every checksum is verified. What is wrong with a file is a value, a Fault, and the walk goes on where it can:
past a damaged chunk, but not past a cut.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, Final

import msgspec
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream

from recorder.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap_scan import BROKEN
from recorder.mcap_summary import CHECK, CHECK_OPCODE, FOOTER_LENGTH, MAGIC, RECORD_HEADER


class Fault(msgspec.Struct, frozen=True):
    """Something wrong with the file.

    Attributes:
        offset: where in the file, in bytes.
        cuts: nothing can be read beyond it.
    """

    offset: int
    detail: str
    cuts: bool = False


class LoggedMessage(msgspec.Struct, frozen=True):
    """A message record."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class End(msgspec.Struct, frozen=True):
    """The footer and the closing magic: the file is whole, but for the faults before."""


Walked = (
    records.Schema
    | records.Channel
    | records.Attachment
    | records.Metadata
    | records.Statistics
    | LoggedMessage
    | Fault
    | End
)

_PARSED: Final = {
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
}


def walk(stream: BinaryIO, size: int) -> Iterator[Walked]:
    """What a file holds, in its order. The stream is past the opening magic.

    Args:
        stream: the file.
        size: its length in bytes.
    """
    offset = len(MAGIC)
    # Of the data section up to its end, then of the summary.
    crc = zlib.crc32(MAGIC)
    # Length and checksum of the record before, which a check repeats.
    last = (0, 0)
    while offset < size:
        header = stream.read(RECORD_HEADER.size)
        if len(header) < RECORD_HEADER.size:
            yield Fault(offset, "the file is cut off within a record", cuts=True)
            return
        opcode, length = RECORD_HEADER.unpack(header)
        if length > size - offset - len(header):
            yield Fault(offset, "the file is cut off within a record", cuts=True)
            return
        body = stream.read(length)
        if opcode == Opcode.FOOTER:
            yield from _end(offset, header, body, crc, stream.read(len(MAGIC) + 1))
            return
        if opcode == Opcode.DATA_END:
            expected = int.from_bytes(body[:4], "little")
            if expected not in {0, crc}:
                yield Fault(offset, "the data's checksum is wrong")
            crc = 0
        elif opcode == CHECK_OPCODE:
            crc = zlib.crc32(body, zlib.crc32(header, crc))
            if len(body) == 8 and header + body != CHECK.pack(CHECK_OPCODE, 8, *last):
                yield Fault(offset, "the check of the record before is wrong")
        else:
            crc = zlib.crc32(body, zlib.crc32(header, crc))
            last = len(header) + length, zlib.crc32(body, zlib.crc32(header))
            yield from _read(offset, opcode, body)
        offset += len(header) + length
    yield Fault(size, "the file ends without a footer", cuts=True)


def _read(offset: int, opcode: int, body: bytes) -> Iterator[Walked]:
    try:
        if opcode == Opcode.CHUNK:
            yield from _read_chunk(offset, body)
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(ReadDataStream(BytesIO(body)))
            if int.from_bytes(body[-4:], "little") not in {0, zlib.crc32(body[:-4])}:
                yield Fault(offset, "an attachment's checksum is wrong")
            yield attachment
        else:
            yield from _read_plain(offset, opcode, body)
    except BROKEN as error:
        yield Fault(offset, f"a record cannot be read: {error}")


def _read_plain(offset: int, opcode: int, body: bytes) -> Iterator[Walked]:
    """A record that may stand in a chunk or outside."""
    if opcode == MESSAGE_OPCODE:
        yield from _messages(offset, RECORD_HEADER.pack(opcode, len(body)) + body)
    elif opcode in _PARSED:
        yield _PARSED[Opcode(opcode)](ReadDataStream(BytesIO(body)))


def _read_chunk(offset: int, body: bytes) -> Iterator[Walked]:
    chunk = records.Chunk.read(ReadDataStream(BytesIO(body)))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    yield from _messages(offset, stream.read(length))


def _messages(offset: int, data: bytes) -> Iterator[Walked]:
    """The records of a chunk; ``offset`` is the chunk's in the file."""
    position, end = 0, len(data)
    unpack = MESSAGE_HEADER.unpack_from
    while position < end:
        opcode, length = RECORD_HEADER.unpack_from(data, position)
        start = position + RECORD_HEADER.size
        position = start + length
        if position > end or (opcode == MESSAGE_OPCODE and length < HEADER_IN_LENGTH):
            yield Fault(offset, "a chunk holds half a record")
            return
        if opcode == MESSAGE_OPCODE:
            _, _, channel_id, sequence, log_ns, publish_ns = unpack(data, start - RECORD_HEADER.size)
            content = data[start + HEADER_IN_LENGTH : position]
            yield LoggedMessage(channel_id, sequence, log_ns, publish_ns, content)
        else:
            yield from _read_plain(offset, opcode, data[start:position])


def _end(offset: int, header: bytes, body: bytes, crc: int, rest: bytes) -> Iterator[Walked]:
    if len(body) != FOOTER_LENGTH:
        yield Fault(offset, "the footer cannot be read", cuts=True)
        return
    expected = int.from_bytes(body[-4:], "little")
    if expected not in {0, zlib.crc32(body[:-4], zlib.crc32(header, crc))}:
        yield Fault(offset, "the summary's checksum is wrong")
    if rest == MAGIC:
        yield End()
    elif rest.startswith(MAGIC):
        yield Fault(offset, "there is more behind the end of the file")
        yield End()
    else:
        yield Fault(offset, "the file is cut off within its last bytes", cuts=True)
