"""The messages of an MCAP file one by one, and the records around them, damaged or cut off as it may be.

Every checksum is verified.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, Final

import msgspec
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from recorder.mcap.chunk import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE
from recorder.mcap.records import End, Fault, LooseMessage, PackedChunk, SummaryStart, read_pieces
from recorder.mcap.scan import BROKEN, NO_RECORD
from recorder.mcap.summary import RECORD_HEADER


class LoggedMessage(msgspec.Struct, frozen=True, gc=False):
    """A message record. Times are nanoseconds since 1970."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


Walked = (
    records.Header
    | records.Schema
    | records.Channel
    | records.Attachment
    | records.Metadata
    | records.Statistics
    | LoggedMessage
    | Fault
    | End
)

_DECLARED: Final = {Opcode.SCHEMA: records.Schema.read, Opcode.CHANNEL: records.Channel.read}
"""What else may stand in a chunk."""


def walk(stream: BinaryIO, size: int) -> Iterator[Walked]:
    """What a file holds, in its order.

    Args:
        stream: the file, which begins as MCAP does.
        size: its length in bytes.
    """
    for piece in read_pieces(stream, size):
        match piece:
            case PackedChunk():
                try:
                    content = piece.unpack(stream)
                except BROKEN as error:
                    yield Fault(piece.offset, f"a record cannot be read: {error}")
                    continue
                yield from messages(piece.offset, content)
            case LooseMessage():
                yield from messages(piece.offset, piece.raw)
            case SummaryStart():
                pass
            case _:
                yield piece


def messages(offset: int, content: bytes) -> Iterator[LoggedMessage | records.Schema | records.Channel | Fault]:
    """The records of a chunk, one after the other; ``offset`` is the chunk's in the file."""
    position, end = 0, len(content)
    unpack = MESSAGE_HEADER.unpack_from
    try:
        while position < end:
            opcode, length = RECORD_HEADER.unpack_from(content, position)
            start = position + RECORD_HEADER.size
            position = start + length
            if position > end or (opcode == MESSAGE_OPCODE and length < HEADER_IN_LENGTH):
                yield Fault(offset, "a chunk holds half a record")
                return
            if not opcode:
                # Else every nine zeros would count as a record: a bomb of them keeps a reader busy for minutes.
                yield Fault(offset, NO_RECORD)
                return
            if opcode == MESSAGE_OPCODE:
                _, _, channel_id, sequence, log_ns, publish_ns = unpack(content, start - RECORD_HEADER.size)
                data = content[start + HEADER_IN_LENGTH : position]
                yield LoggedMessage(channel_id, sequence, log_ns, publish_ns, data)
            elif opcode in _DECLARED:
                yield _DECLARED[Opcode(opcode)](ReadDataStream(BytesIO(content[start:position])))
    except BROKEN as error:
        yield Fault(offset, f"a record cannot be read: {error}")
