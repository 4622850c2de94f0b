"""The messages of a chunk, channel by channel, each field of their headers in a column of its own.

The message index says where they begin, and what stands there proves it: records of messages must fill the chunk
from its beginning to its end. All fields of all of them are unpacked in a single call, which takes a fraction of
one call for each. ``arrays`` does the same with numpy, which a recorder need not have.
"""

from __future__ import annotations

import struct
from array import array
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from itertools import chain, pairwise
from operator import itemgetter, sub
from typing import Any, Final

import msgspec

from recorder.mcap.framing import HEADER_IN_LENGTH, MESSAGE_HEADER, MESSAGE_OPCODE, RECORD_HEADER

_FIELDS: Final = 7
"""Opcode, length, channel, sequence, log time, publish time, data."""

_LENGTHS_MAX: Final = 10_000
"""Forms of records that are remembered."""


class _Forms(dict[int, str]):
    """Formats that unpack a message record, by its length with opcode and length field."""

    def __missing__(self, length: int) -> str:
        form = f"{MESSAGE_HEADER.format[1:]}{length - MESSAGE_HEADER.size}s"
        if len(self) < _LENGTHS_MAX:
            self[length] = form
        return form


_FORMS: Final = _Forms()


class ChannelMessages(msgspec.Struct, frozen=True, gc=False):
    """Messages of one channel, in the order of the chunk.

    Attributes:
        channel_id: their channel.
        starts: offsets of their records in the chunk.
        sequences, log_ns, publish_ns, datas: of each.
    """

    channel_id: int
    starts: Sequence[int]
    sequences: Sequence[int]
    log_ns: Sequence[int]
    publish_ns: Sequence[int]
    datas: Sequence[bytes]


class Messages(msgspec.Struct, frozen=True):
    """All messages of a chunk.

    Attributes:
        by_channel: the messages of each channel, by its id.
        start_ns, end_ns: the first and the last log time.
        first_ns, last_ns: the log times of the first and the last message in the chunk's order.
        backwards: number of log times before the one of the message before.
    """

    by_channel: list[ChannelMessages]
    start_ns: int
    end_ns: int
    first_ns: int
    last_ns: int
    backwards: int

    def is_indexed(self, index: Mapping[int, array[int]]) -> bool:
        """Report whether message indexes, log times and offsets in turns, say what is there; in any order."""
        named = sorted(channel_id for channel_id, entries in index.items() if entries)
        if named != [one.channel_id for one in self.by_channel]:
            return False
        found, said = array("Q"), array("Q")
        for one in self.by_channel:
            entries = array("Q", bytes(16 * len(one.starts)))
            entries[::2], entries[1::2] = array("Q", one.log_ns), array("Q", one.starts)
            found += entries
            said += index[one.channel_id]
        return found == said or all(
            sorted(zip(one.starts, one.log_ns, strict=True))
            == sorted(zip(index[one.channel_id][1::2], index[one.channel_id][::2], strict=True))
            for one in self.by_channel
        )


def unpack_indexed(content: bytes, index: Mapping[int, array[int]]) -> Messages | None:
    """The messages of a chunk that holds nothing else, found by its index; None if that is not quite so.

    Args:
        content: the chunk's records.
        index: of each channel log times and offsets in turns.
    """
    starts = sorted(chain.from_iterable(entries[1::2] for entries in index.values()))
    if not starts or starts[0] != 0:
        return None
    lengths = list(map(sub, [*starts[1:], len(content)], starts))
    if min(lengths) < MESSAGE_HEADER.size:
        return None
    # As a function of the module it would keep the last hundred of these layouts, each some megabytes.
    layout = struct.Struct("<" + "".join(map(_FORMS.__getitem__, lengths)))
    fields = layout.unpack(content)
    expected = [length - RECORD_HEADER.size for length in lengths]
    if fields[::_FIELDS].count(MESSAGE_OPCODE) != len(starts) or list(fields[1::_FIELDS]) != expected:
        return None
    return _messages(starts, *(fields[place::_FIELDS] for place in range(2, _FIELDS)))


def unpack_at(content: bytes, starts: Sequence[int]) -> Messages:
    """The messages that begin there, one by one, whatever else is in the chunk.

    Args:
        content: the chunk's records.
        starts: in rising order, at least one; a whole message record is there.
    """
    head = MESSAGE_HEADER.size
    rows = []
    for start in starts:
        _, length, *fields = MESSAGE_HEADER.unpack_from(content, start)
        rows.append((*fields, content[start + head : start + head + length - HEADER_IN_LENGTH]))
    return _messages(starts, *zip(*rows, strict=True))


def _messages(starts: Sequence[int], *columns: Sequence[Any]) -> Messages:
    """Args: where the records begin; channels, sequences, log times, publish times and datas."""
    times = list(columns[2])
    in_order = sorted(times)
    return Messages(
        by_channel=_grouped(columns[0], (starts, *columns[1:])),
        start_ns=in_order[0],
        end_ns=in_order[-1],
        first_ns=times[0],
        last_ns=times[-1],
        backwards=0 if times == in_order else sum(after < before for before, after in pairwise(times)),
    )


def _grouped(channels: Sequence[int], columns: Sequence[Sequence[Any]]) -> list[ChannelMessages]:
    """The columns of each channel."""
    if channels.count(channels[0]) == len(channels):
        return [ChannelMessages(channels[0], *columns)]
    order = sorted(range(len(channels)), key=channels.__getitem__)
    pick = itemgetter(*order)
    channel_ids = pick(channels)
    picked = [pick(column) for column in columns]
    found, start = [], 0
    while start < len(order):
        channel_id = channel_ids[start]
        end = bisect_right(channel_ids, channel_id, start)
        found.append(ChannelMessages(channel_id, *(column[start:end] for column in picked)))
        start = end
    return found
