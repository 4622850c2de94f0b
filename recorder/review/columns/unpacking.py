"""Chunks of a recorder's own, unpacked without the parts that only others' need."""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO, Final

import zstandard

from recorder.mcap.records import PackedChunk
from recorder.mcap.scan import RECORD_MAX
from recorder.mcap.summary import RECORD_HEADER

_ZSTD_HEAD: Final = struct.Struct("<QQQII4sQ")
"""A chunk up to its records: two times, size and checksum unpacked, the compression, the length of the records."""


class Unpacker:
    """Unpacks chunks.

    Args:
        stream: the file.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._zstd = zstandard.ZstdDecompressor()

    def unpack(self, chunk: PackedChunk) -> bytes:
        """A chunk's records; its checksum is verified.

        Raises:
            what ``recorder.mcap.scan.BROKEN`` lists: it is damaged, or packed in a way that nobody here knows.
        """
        self._stream.seek(chunk.offset + RECORD_HEADER.size)
        body = self._stream.read(chunk.length - RECORD_HEADER.size)
        if len(body) > _ZSTD_HEAD.size:
            _, _, size, crc, name_length, name, length = _ZSTD_HEAD.unpack_from(body)
            data = memoryview(body)[_ZSTD_HEAD.size :]
            if (name_length, name, length) == (4, b"zstd", len(data)) and crc and size <= RECORD_MAX:
                content = self._content(data, size)
                if len(content) == size and zlib.crc32(content) == crc:
                    return content
        # Whatever is wrong with it, or only another way to pack it, is told there.
        return chunk.unpack(self._stream)

    def _content(self, data: memoryview, size: int) -> bytes:
        if zstandard.frame_content_size(data) != size:
            return b""
        try:
            return self._zstd.decompress(data)
        except zstandard.ZstdError:
            return b""
