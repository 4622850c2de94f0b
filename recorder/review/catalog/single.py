"""The row of one log as a file of its own, which lies beside the log in an object store: JSON, packed with zstd.

A robot makes it with no more than it records with: the libraries for tables are needed where rows are searched.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec
import zstandard

from recorder.mcap.summary_reader import read_summary
from recorder.reading.logs import look_at
from recorder.reading.rows import Progress
from recorder.review.catalog.rows import FORMAT, VERSION, CatalogRow, CatalogUnreadableError, summarize

UNPACKED_MAX: Final = 64 * 1024 * 1024
"""A row that unpacks to more is none."""


class RowFile(msgspec.Struct, frozen=True):
    """The content of such a file."""

    format: str
    version: int
    row: msgspec.Raw


def write_row(path: Path, file: str, modified_ns: int) -> bytes:
    """Make the row of a log, which is read from its beginning to its end.

    Args:
        path: the file.
        file: the log's name, as the row has it.
        modified_ns: the time of its last change.

    Raises:
        CommandError: it cannot be opened.
    """
    row = msgspec.json.encode(row_of(path, file, modified_ns))
    return zstandard.compress(msgspec.json.encode(RowFile(FORMAT, VERSION, msgspec.Raw(row))))


def read_row(data: bytes, log_bytes: int) -> CatalogRow:
    """Read the row of a log of this length.

    Raises:
        CatalogUnreadableError: it is damaged, of another version, or of another log.
    """
    try:
        if not 0 <= zstandard.frame_content_size(data) <= UNPACKED_MAX:
            raise CatalogUnreadableError("unpacks to too much")
        found = msgspec.json.decode(zstandard.decompress(data), type=RowFile)
        if (found.format, found.version) != (FORMAT, VERSION):
            raise CatalogUnreadableError("is of another version")
        row = msgspec.json.decode(found.row, type=CatalogRow)
    except (zstandard.ZstdError, msgspec.MsgspecError, ValueError, MemoryError) as error:
        raise CatalogUnreadableError("is damaged") from error
    if row.bytes != log_bytes:
        raise CatalogUnreadableError("is of another log")
    return row


def row_of(path: Path, file: str, modified_ns: int, progress: Progress = lambda _: None) -> CatalogRow:
    """Make the row of a log, which is read from its beginning to its end.

    Args:
        path: the file.
        file: the log's name, as the row has it.
        modified_ns: the time of its last change.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: it cannot be opened.
    """
    return summarize(look_at(path), file, modified_ns, summary_crc_of(path), progress)


def summary_crc_of(path: Path) -> int | None:
    """The checksum of a file's summary, by its footer; None if it has none, or it is wrong."""
    try:
        with path.open("rb") as stream:
            summary = read_summary(stream)
    except OSError:
        return None
    return None if summary is None or not summary.crc else summary.crc
