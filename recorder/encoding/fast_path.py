"""The way of nearly every sample into a chunk: one function for each key, compiled for its subject. Pure.

It decodes the payload, checks that the sequence continues, and appends header and fields of the record in one
packing. It returns any other case (a gap, a broken payload, a message that the session itself reads, a full chunk)
untouched, and the session then takes the slow path.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, cast

import msgspec

from recorder.encoding.key_counters import KeyCounters
from recorder.encoding.transcode import Packed, packed_fields
from recorder.mcap.chunk import ChunkBuilder, head_source
from schemas.messages import Message

Adder = Callable[[bytes, int], bool]
"""Payload and log time of a sample; whether it is in the chunk now. A payload that cannot be decoded raises."""


FastPath = tuple[str, Adder]
"""The encoding that a sample must have to take it, and its function."""


class Latest:
    """The newest message of a key."""

    __slots__ = ("log_ns", "message")

    def __init__(self) -> None:
        self.log_ns = 0
        self.message: Message | None = None


Make = Callable[[KeyCounters, ChunkBuilder, int, Latest], Adder]


def compile_adder(
    kind: type[Message], counters: KeyCounters, chunk: ChunkBuilder, channel_id: int, latest: Latest
) -> Adder:
    """The function of one key.

    Args:
        kind: the class of its messages.
        counters: counts them.
        chunk: the destination of the records.
        channel_id: of the records.
        latest: holds the newest message.
    """
    return _make(kind)(counters, chunk, channel_id, latest)


@cache
def _make(kind: type[Message]) -> Make:
    """Writes the function and compiles it.

    It reads, for a class with a number and a text besides time and sequence::

        def add(payload, log_ns):
            message = decode(payload)
            sequence = message.sequence
            records = chunk.records
            offset = len(records)
            if sequence != counters.next or offset >= limit_bytes:
                return False
            time_ns = message.time_ns
            tail = part_4(message.text)
            head = pack(5, 22 + 23 + len(tail), channel_id, sequence, log_ns, time_ns, 9, time_ns, 21, ...)
            records += head
            records += tail
            index = chunk.index[channel_id]
            index.append(log_ns)
            index.append(offset)
            counters.next = sequence + 1
            ...
            return True
    """
    packed: Packed = packed_fields(kind, {"time_ns": "time_ns", "sequence": "sequence"}, "message.")
    tail = " + ".join(packed.parts)
    length = str(packed.struct("").size) + (" + len(tail)" if tail else "")
    head_format, head = head_source(length)
    pack = packed.struct(head_format)
    arguments = ", ".join(["channel_id", "sequence", "log_ns", "time_ns", *packed.arguments])
    source = f"""
def make(counters, chunk, channel_id, latest):
    limit_bytes = chunk.limit_bytes
    def add(payload, log_ns):
        message = decode(payload)
        sequence = message.sequence
        records = chunk.records
        offset = len(records)
        if sequence != counters.next or offset >= limit_bytes:
            return False
        time_ns = message.time_ns
        {f"tail = {tail}" if tail else ""}
        head = pack({head}, {arguments})
        records += head
        {"records += tail" if tail else ""}
        index = chunk.index[channel_id]
        index.append(log_ns)
        index.append(offset)
        counters.next = sequence + 1
        counters.samples += 1
        counters.messages += 1
        latest.message = message
        latest.log_ns = log_ns
        return True
    return add
"""
    names: dict[str, Any] = {**packed.names, "pack": pack.pack, "decode": msgspec.msgpack.Decoder(kind).decode}
    # As in dataclasses and namedtuple: the source holds our own field names and nothing from outside.
    exec(source, names)  # noqa: S102
    return cast("Make", names["make"])
