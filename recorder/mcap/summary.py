"""The end of an MCAP file: what repeats and indexes its data, so that a reader need not read it all. Pure.

Kept as bytes while the file grows, for a long log has many chunks. The writer of a log and the recovery of one
that was left unfinished end a file by the same hand.
"""

from __future__ import annotations

import zlib
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import FOOTER, INDEX_HEADER, MAGIC, RECORD_HEADER, encode

_SUMMARY_ORDER: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)


class Summary:
    """Gathers what the end of a file says of its data."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._start_ns: int | None = None
        self._end_ns = 0
        # The records that the summary will hold, by kind, and how many of each there are.
        self._encoded = {opcode: bytearray() for opcode in _SUMMARY_ORDER}
        self._records: Counter[int] = Counter()
        """Bytes of the last attachment's index."""

    @property
    def messages(self) -> int:
        """Messages in the file."""
        return self._counts.total()

    @property
    def end_ns(self) -> int:
        """The latest log time; 0 if there is no message."""
        return self._end_ns

    @property
    def chunks(self) -> int:
        """Chunks in the file."""
        return self._records[Opcode.CHUNK_INDEX]

    def add_schema(self, schema: records.Schema) -> None:
        """A schema, the first of its id."""
        self._add(Opcode.SCHEMA, encode(schema))

    def add_channels(self, encoded: Sequence[bytes]) -> None:
        """Channels, each the first of its id, as they stand in the data."""
        self._add(Opcode.CHANNEL, *encoded)

    def add_messages(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> None:
        """So many messages of each channel, of these log times."""
        self._counts.update(counts)
        self._start_ns = start_ns if self._start_ns is None else min(self._start_ns, start_ns)
        self._end_ns = max(self._end_ns, end_ns)

    def add_chunk(
        self,
        chunk: records.Chunk,
        offset: int,
        length: int,
        index: Mapping[int, array[int]],
        places: Mapping[int, int] | None = None,
        indexes_length: int = 0,
    ) -> None:
        """A chunk at this offset of the file, its message indexes right behind it.

        Args:
            chunk: its head.
            offset: of its record, and ``length`` of that.
            length: in bytes.
            index: the log time and place of each message, by channel.
            places: how far behind the offset each message index stands, and ``indexes_length`` their bytes;
                None: as ``framing.encode_indexes`` puts them.
            indexes_length: in bytes.
        """
        if places is None:
            places, end = {}, length
            for channel_id, entries in index.items():
                places[channel_id] = end
                end += INDEX_HEADER.size + entries.itemsize * len(entries)
            indexes_length = end - length
        if index:
            counts = {channel_id: len(entries) // 2 for channel_id, entries in index.items()}
            self.add_messages(counts, chunk.message_start_time, chunk.message_end_time)
        found = records.ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=indexes_length,
            message_index_offsets={channel_id: offset + place for channel_id, place in places.items()},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        self._add(Opcode.CHUNK_INDEX, encode(found))

    def add_attachment(self, attachment: records.Attachment, offset: int, length: int) -> None:
        """An attachment at this offset of the file."""
        index = records.AttachmentIndex(
            offset=offset,
            length=length,
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        encoded = encode(index)
        self._add(Opcode.ATTACHMENT_INDEX, encoded)

    def add_metadata(self, metadata: records.Metadata, offset: int, length: int) -> None:
        """A metadata record at this offset of the file."""
        index = records.MetadataIndex(offset=offset, length=length, name=metadata.name)
        self._add(Opcode.METADATA_INDEX, encode(index))

    def ending(self, data_size: int, data_crc: int) -> bytes:
        """Return the data end, summary and footer that complete a file whose data has this size and CRC."""
        data_end = encode(records.DataEnd(data_crc))
        start = data_size + len(data_end)
        self._encoded[Opcode.STATISTICS] = bytearray(encode(self._statistics()))
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._encoded.items():
            if group:
                offset = records.SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(group)
                )
                offsets += encode(offset)
                summary += group
        offset_start = start + len(summary)
        summary += offsets
        # The summary's checksum covers the footer too, up to the checksum itself.
        length = FOOTER.size - RECORD_HEADER.size
        footer = FOOTER.pack(Opcode.FOOTER, length, start, offset_start, 0)[:-4]
        crc = zlib.crc32(footer, zlib.crc32(summary))
        return data_end + bytes(summary) + footer + crc.to_bytes(4, "little") + MAGIC

    def _add(self, opcode: Opcode, *encoded: bytes) -> None:
        self._encoded[opcode] += b"".join(encoded)
        self._records[opcode] += len(encoded)

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=self._records[Opcode.ATTACHMENT_INDEX],
            channel_count=self._records[Opcode.CHANNEL],
            channel_message_counts=dict(self._counts),
            chunk_count=self.chunks,
            message_count=self.messages,
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=self._records[Opcode.METADATA_INDEX],
            schema_count=self._records[Opcode.SCHEMA],
        )
