"""Recovers damaged or unfinished MCAP files, as far as checksums prove their content. No I/O but streams.

A file whose writer was killed is good up to its last write: cut it back to ``FileSurvey.end`` and append
``FileSurvey.ending``. If earlier data is damaged, ``copy_good`` writes the good data into another file.
"""

from __future__ import annotations

import zlib
from typing import BinaryIO, Final, Protocol

import msgspec
import zstandard
from mcap import records

from recorder.mcap.framing import (
    CHECK_OPCODE,
    FIRST_RECORD,
    MAGIC,
    MESSAGE_HEADER,
    MESSAGE_OPCODE,
    checked,
    encode,
    encode_indexes,
)
from recorder.mcap.pieces import DataEnd, Index, Parsed, ProvenChunk, ProvenRecord, Scanner, index_content, split
from recorder.mcap.summary_reader import LogSummary, read_summary
from recorder.mcap.writer import COMPRESSION, COMPRESSION_LEVEL, Summary

_NO_SCHEMA: Final = records.Schema(id=0, data=b"", encoding="", name="")

FAULTS_SHOWN: Final = 20  # faults that are listed; the others are only counted


class Sink(Protocol):
    """A destination for the bytes of a copy."""

    def write(self, data: bytes, /) -> object:
        """Write all of the data."""


class FileSurvey(msgspec.Struct, frozen=True):
    """The result of a scan of a file.

    Attributes:
        is_whole: it is closed properly, without a fault.
        end: the end of the good data, if there are no faults; ``ending`` completes the file.
        faults: the first of ``fault_count`` damages with good data behind them.
        is_torn: only the beginning of one last write, or nothing, follows the good data.
    """

    is_whole: bool
    end: int
    ending: bytes
    faults: list[str]
    fault_count: int
    is_torn: bool
    messages: int
    chunks: int


def survey(stream: BinaryIO, size: int) -> FileSurvey:
    """Scan a file; nothing in it raises."""
    scanner = Scanner(stream, size)
    rebuild = _Rebuild(None, read_summary(stream), has_checks=scanner.has_checks)
    data_end: DataEnd | None = None
    end = 0
    pending: list[str] = []
    for found in scanner.scan():
        match found:
            case ProvenRecord() | ProvenChunk():
                # A fault before good data is damage; without good data behind it, it is the torn end.
                rebuild.faults += pending
                pending = []
                if isinstance(found, ProvenChunk) and (found.places is None or not found.has_true_head):
                    pending.append(f"byte {found.offset}: the indexes of a chunk are wrong")
                    end = found.chunk_end
                else:
                    end = found.end
                rebuild.take(found)
            case DataEnd():
                data_end = found
            case _:
                pending.append(f"byte {found.offset}: {found.detail}")
    if data_end is not None:
        rebuild.faults += pending
        if data_end.crc not in {0, rebuild.crc} and not (rebuild.faults or scanner.has_checks):
            rebuild.faults.append(f"byte {data_end.offset}: the data's checksum is wrong; the place is unknown")
    is_closed = data_end is not None and scanner.is_closed(data_end) and data_end.crc in {0, rebuild.crc}
    return FileSurvey(
        is_whole=is_closed and not rebuild.faults,
        end=end,
        ending=rebuild.trailing + rebuild.ending(),
        faults=rebuild.faults[:FAULTS_SHOWN],
        fault_count=len(rebuild.faults),
        is_torn=data_end is not None or scanner.is_torn(max(end, FIRST_RECORD)),
        messages=rebuild.summary.messages,
        chunks=rebuild.summary.chunks,
    )


def copy_good(stream: BinaryIO, size: int, sink: Sink, library: str) -> None:
    """Write a whole file with the good data of a damaged one."""
    scanner = Scanner(stream, size)
    rebuild = _Rebuild(sink, read_summary(stream), has_checks=scanner.has_checks)
    first = scanner.piece(FIRST_RECORD)
    parsed = first.parsed if isinstance(first, ProvenRecord) else None
    profile = parsed.profile if isinstance(parsed, records.Header) else ""
    header = encode(records.Header(profile=profile, library=library))
    # Either all records of the copy have a check, or none.
    rebuild.put(MAGIC + (checked(header) if scanner.has_checks else header))
    for found in scanner.scan():
        if isinstance(found, ProvenChunk) or (isinstance(found, ProvenRecord) and found.raw[0] != CHECK_OPCODE):
            rebuild.take(found)
    sink.write(rebuild.ending())


class _Rebuild:
    """Collects the good pieces of a file, and copies them to a sink, if there is one."""

    def __init__(self, sink: Sink | None, repeated: LogSummary | None, *, has_checks: bool) -> None:
        self.summary = Summary()
        self.faults: list[str] = []
        self.trailing = b""  # message indexes missing behind the last chunk
        self.crc = 0 if sink is not None else zlib.crc32(MAGIC)
        self._size = 0 if sink is not None else len(MAGIC)
        self._sink = sink
        self._has_checks = has_checks
        self._repeated = repeated  # the file's summary, which repeats schemas and channels
        self._schemas: dict[int, records.Schema] = {0: _NO_SCHEMA}
        self._channels: set[int] = set()

    def put(self, data: bytes) -> None:
        """Add bytes to the result."""
        self.crc = zlib.crc32(data, self.crc)
        self._size += len(data)
        if self._sink is not None:
            self._sink.write(data)

    def ending(self) -> bytes:
        """The end of the result."""
        return self.summary.ending(self._size, self.crc)

    def take(self, piece: ProvenChunk | ProvenRecord) -> None:
        """Add a piece to the result, as far as its channels are known."""
        self.trailing = b""
        if isinstance(piece, ProvenChunk):
            self._take_chunk(piece)
        elif isinstance(piece.parsed, records.Header):
            if self._sink is None:
                self.put(piece.raw)
        elif piece.parsed is not None:
            self._take_record(piece, piece.parsed)
        elif piece.raw[0] == MESSAGE_OPCODE:
            self._take_message(piece)
        else:
            self.put(piece.raw)

    def _take_record(self, piece: ProvenRecord, parsed: Parsed) -> None:
        offset = self._size
        if isinstance(parsed, records.Channel) and parsed.schema_id not in self._schemas:
            self.faults.append(f"byte {piece.offset}: the schema of {parsed.topic} is lost")
            return
        self.put(piece.raw)
        if isinstance(parsed, records.Attachment):
            self.summary.add_attachment(parsed, offset, piece.length)
        elif isinstance(parsed, records.Metadata):
            self.summary.add_metadata(parsed, offset, piece.length)
        else:
            self._declare(parsed)

    def _declare(self, parsed: Parsed) -> None:
        if isinstance(parsed, records.Schema) and parsed.id not in self._schemas:
            self._schemas[parsed.id] = parsed
            self.summary.add_schema(parsed)
        elif isinstance(parsed, records.Channel) and parsed.id not in self._channels:
            self._channels.add(parsed.id)
            self.summary.add_channels([encode(parsed)])

    def _take_message(self, piece: ProvenRecord) -> None:
        _, _, channel_id, _, log_ns, _ = MESSAGE_HEADER.unpack_from(piece.raw)
        if not self._knows(channel_id):
            self.faults.append(f"byte {piece.offset}: the channel of a message is lost")
            return
        self.put(piece.raw)
        self.summary.add_messages({channel_id: 1}, log_ns, log_ns)

    def _knows(self, channel_id: int) -> bool:
        """Return True if the data or the summary holds the channel; from the summary, a copy takes it over."""
        if channel_id not in self._channels and self._repeated and channel_id in self._repeated.channels:
            channel = self._repeated.channels[channel_id]
            schema = self._repeated.schemas.get(channel.schema_id)
            for record in (channel,) if schema is None else (schema, channel):
                encoded = encode(record)
                self.put(checked(encoded) if self._has_checks else encoded)
                self._declare(record)
            self.faults.append(f"the channel of {channel.topic} is only in the summary")
        return channel_id in self._channels

    def _take_chunk(self, piece: ProvenChunk) -> None:
        for parsed in piece.declared:
            self._declare(parsed)
        content, index = piece.content, piece.index
        lost = sum(len(entries) // 2 for channel_id, entries in index.items() if not self._knows(channel_id))
        chunk = piece.record
        if lost:
            self.faults.append(f"byte {piece.offset}: the channels of {lost} messages are lost")
            content = self._known(content)
            if not content:
                # The checksum of no bytes is 0, which means "no checksum" in MCAP.
                return
            index, _ = index_content(content)
            chunk = _chunk_of(content, index)
        offset, places = self._size, piece.places
        data = encode(chunk)
        if not lost and piece.has_true_head:
            data = piece.raw[: piece.chunk_end - piece.offset]
        elif not lost:
            self.faults.append(f"byte {piece.offset}: the times of a chunk were wrong")
        if not lost and piece.has_true_head and places is not None:
            self.put(piece.raw)
            self.summary.add_chunk(chunk, offset, len(data), index, places, len(piece.raw) - len(data))
        else:
            self.trailing = encode_indexes(index)
            self.put(data + self.trailing)
            self.summary.add_chunk(chunk, offset, len(data), index)

    def _known(self, content: bytes) -> bytes:
        """The records of a chunk without messages of unknown channels."""
        kept = bytearray()
        for opcode, start, end in split(content):
            if opcode != MESSAGE_OPCODE or MESSAGE_HEADER.unpack_from(content, start)[2] in self._channels:
                kept += content[start:end]
        return bytes(kept)


def _chunk_of(content: bytes, index: Index) -> records.Chunk:
    times = [time for entries in index.values() for time in entries[::2]]
    return records.Chunk(
        compression=COMPRESSION,
        data=zstandard.compress(content, level=COMPRESSION_LEVEL),
        message_start_time=min(times, default=0),
        message_end_time=max(times, default=0),
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )
