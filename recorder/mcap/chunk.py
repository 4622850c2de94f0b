"""Messages appended to one buffer and indexed: what becomes a chunk of an MCAP file. Pure."""

from __future__ import annotations

from array import array
from typing import Final

import msgspec

from recorder.mcap.framing import HEAD_FORMAT, HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE

NO_LIMIT: Final = 2**63


INT64_MAX: Final = 2**63 - 1
"""The latest time that a log may hold: many readers take MCAP's unsigned times for signed ones."""


def log_time(time_ns: int) -> int:
    """The nearest time since 1970 that a log may hold."""
    return min(max(time_ns, 0), INT64_MAX)


def message_record(channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> bytes:
    """A message's record. The times are unsigned 64-bit, the sequence 32-bit, the channel 16-bit."""
    length = HEADER_IN_LENGTH + len(data)
    return MESSAGE_HEADER.pack(MESSAGE_OPCODE, length, channel_id, sequence, log_ns, publish_ns) + data


def head_source(length: str) -> tuple[str, str]:
    """The head of a message's record for code that packs it with the data at once.

    Args:
        length: an expression, the bytes of the data.

    Returns:
        The format, as ``struct`` has it, and the first of the values, as source; those behind are expressions of
        the channel's id, the sequence, the log time and the publish time.
    """
    return HEAD_FORMAT, f"{MESSAGE_OPCODE}, {HEADER_IN_LENGTH} + {length}"


class Chunk(msgspec.Struct, frozen=True):
    """Messages ready to be written.

    Attributes:
        records: message records, one after the other.
        index: per channel, log time and offset in ``records`` of each message, in turns.
        start_ns: the earliest log time; ``end_ns`` the latest.
    """

    records: bytearray
    index: dict[int, array[int]]
    start_ns: int
    end_ns: int

    @property
    def counts(self) -> dict[int, int]:
        """Messages of each channel."""
        return {channel_id: len(entries) // 2 for channel_id, entries in self.index.items()}


class _Index(dict[int, "array[int]"]):
    """Per channel, log time and offset of each message; a channel's begins when it is asked for."""

    def __missing__(self, channel_id: int) -> array[int]:
        index = self[channel_id] = array("Q")
        return index


class ChunkBuilder:
    """Takes messages one by one; ``seal`` hands over what has come together and begins anew.

    Args:
        limit_bytes: at this size it is to be sealed; see ``is_full``.

    Attributes:
        records: message records so far.
        index: per channel, log time and offset of each message in turns.
    """

    def __init__(self, limit_bytes: int = NO_LIMIT) -> None:
        self.limit_bytes = limit_bytes
        self.records = bytearray()
        self.index = _Index()

    def __len__(self) -> int:
        """Bytes so far, before compression."""
        return len(self.records)

    @property
    def is_full(self) -> bool:
        """It is time to seal it."""
        return len(self.records) >= self.limit_bytes

    def add(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Append a message. The times are unsigned 64-bit, the sequence 32-bit, the channel 16-bit."""
        records = self.records
        index = self.index[channel_id]
        index.append(log_ns)
        index.append(len(records))
        records += MESSAGE_HEADER.pack(
            MESSAGE_OPCODE, HEADER_IN_LENGTH + len(data), channel_id, sequence, log_ns, publish_ns
        )
        records += data

    def seal(self) -> Chunk | None:
        """The messages so far, or None if there are none."""
        if not self.records:
            return None
        times = [index[::2] for index in self.index.values()]
        chunk = Chunk(
            records=self.records,
            index=dict(self.index),
            start_ns=min(map(min, times)),
            end_ns=max(map(max, times)),
        )
        self.records = bytearray()
        self.index = _Index()
        return chunk
