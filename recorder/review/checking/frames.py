"""Raw frames that never came, by the alive counters in the frames of one channel.

The frames of a bus differ from each other in time, identifier and data alone: where all other bytes of their
records are those of the first one, these are read as columns, of many frames at once.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from itertools import groupby
from operator import itemgetter, xor
from typing import Any, Final

import msgspec

from recorder.encoding.transcode import compile_row_encoder
from recorder.reading.topics import UNREADABLE, typed_decoder
from recorder.review.checking.alive import COUNTER_AT, FRAME_BYTES, AliveCount, feedback_frames
from schemas.messages import CanFrame

_DECODE: Final = typed_decoder(CanFrame)
_ENCODE_ROW: Final[Callable[..., bytes]] = compile_row_encoder(CanFrame)

# Marks that no record holds by chance, to find the places of the columns.
_TIME_MARK: Final = 0x1122334455667788
_IDENTIFIER_MARK: Final = 0x0ABBCCDD
_DATA_MARK: Final = b"\xa1\xa2\xa3\xa4\xa5\xa6\xa7\xa8"


class FrameInfo(msgspec.Struct, frozen=True):
    """Raw frames of one identifier; see ``alive.AliveCount``."""

    topic: str
    identifier: str
    name: str
    frames: int
    lost: int
    repeated: int
    corrupt: int
    outages: int
    unseen: int


class _Form(msgspec.Struct, frozen=True):
    """Records that differ in time, identifier and data alone.

    Attributes:
        length: of each.
        same: place and value of each byte that all have in common.
        time_at, identifier_at, data_at: offsets of the others.
        counts: a feedback frame can be among them.
    """

    length: int
    same: list[tuple[int, int]]
    time_at: int
    identifier_at: int
    data_at: int
    counts: bool

    def fits(self, joined: bytes, count: int) -> bool:
        """Report whether so many records, one behind the other, are of this form."""
        length = self.length
        return len(joined) == length * count and all(
            joined[at::length].count(byte) == count for at, byte in self.same
        )


class FrameCount:
    """Follows the alive counters of all identifiers of one channel of raw frames."""

    def __init__(self) -> None:
        self._form: _Form | None = None
        self._counts: dict[int, AliveCount] = {}

    def take(self, datas: list[bytes]) -> list[int]:
        """Records of the channel that follow each other. Returns the places of those that are none."""
        joined = b"".join(datas)
        form = self._form_of(datas, joined)
        if form is None:
            return self._take_each(datas)
        if form.counts:
            self._take_columns(form, joined, len(datas))
        return []

    def begin_anew(self) -> None:
        """Another gateway receives the frames from here on."""
        for count in self._counts.values():
            count.begin_anew()

    @property
    def counts(self) -> Iterator[tuple[str, AliveCount]]:
        """The count of each identifier that was seen."""
        for identifier, count in sorted(self._counts.items()):
            yield f"0x{identifier:08X}", count

    def info(self, topic: str) -> list[FrameInfo]:
        """All counts; the channel's topic is theirs."""
        return [
            FrameInfo(
                topic=topic,
                identifier=identifier,
                name=count.name,
                frames=count.frames,
                lost=count.lost,
                repeated=count.repeated,
                corrupt=count.corrupt,
                outages=count.outages,
                unseen=count.unseen,
            )
            for identifier, count in self.counts
        ]

    def _form_of(self, datas: list[bytes], joined: bytes) -> _Form | None:
        """The form that all of these have; None if they differ."""
        if len(set(map(len, datas))) > 1:
            return None
        if self._form is None or not self._form.fits(joined, len(datas)):
            self._form = _form(datas[0])
            if self._form is None or not self._form.fits(joined, len(datas)):
                return None
        return self._form

    def _take_columns(self, form: _Form, joined: bytes, count: int) -> None:
        length = form.length
        bytes_of = [joined[form.data_at + byte :: length] for byte in range(FRAME_BYTES)]
        times = _numbers("Q", joined, form.time_at, length, count)
        identifiers = _numbers("I", joined, form.identifier_at, length, count)
        if reduce(xor, (int.from_bytes(column, "little") for column in bytes_of)):
            for place in range(count):
                self._take_one(identifiers[place], times[place], bytes(column[place] for column in bytes_of))
            return
        order = sorted(range(count), key=identifiers.__getitem__)
        for identifier, same in groupby(order, identifiers.__getitem__):
            alive = self._count_of(identifier)
            if alive is not None:
                places = list(same)
                pick: Callable[[Any], Sequence[int]] = itemgetter(*places) if len(places) > 1 else _only(places[0])
                alive.receive_many(pick(times), bytes(pick(bytes_of[COUNTER_AT])))

    def _take_each(self, datas: list[bytes]) -> list[int]:
        wrong = []
        for place, data in enumerate(datas):
            try:
                frame: CanFrame = _DECODE(data)
            except UNREADABLE:
                wrong.append(place)
                continue
            if _may_count(frame):
                self._take_one(frame.identifier, frame.time_ns, frame.data)
        return wrong

    def _take_one(self, identifier: int, time_ns: int, data: bytes) -> None:
        alive = self._count_of(identifier)
        if alive is not None:
            alive.receive(time_ns, data)

    def _count_of(self, identifier: int) -> AliveCount | None:
        alive = self._counts.get(identifier)
        if alive is None and identifier in feedback_frames():
            alive = self._counts[identifier] = AliveCount(feedback_frames()[identifier])
        return alive


def _only(place: int) -> Callable[[Any], Sequence[int]]:
    return lambda column: (column[place],)


def _numbers(form: str, joined: bytes, at: int, length: int, count: int) -> array[int]:
    """A column of numbers."""
    width = struct.calcsize(f"<{form}")
    data = bytearray(width * count)
    for byte in range(width):
        data[byte::width] = joined[at + byte :: length]
    column: array[int] = array(form)
    column.frombytes(data)
    if sys.byteorder == "big":
        column.byteswap()
    return column


def _form(record: bytes) -> _Form | None:
    """The form of a record; None if it is not written as ours are, or is no frame of eight bytes."""
    try:
        frame: CanFrame = _DECODE(record)
    except UNREADABLE:
        return None
    if len(frame.data) != FRAME_BYTES:
        return None
    _, bus, _, *between, _ = msgspec.structs.astuple(frame)
    marked = _ENCODE_ROW(_TIME_MARK, bus, _IDENTIFIER_MARK, *between, _DATA_MARK)
    time_at = marked.index(struct.pack("<Q", _TIME_MARK))
    identifier_at = marked.index(struct.pack("<I", _IDENTIFIER_MARK))
    # The bus's name, which may be anything, stands before it.
    data_at = marked.rindex(_DATA_MARK)
    own = {
        *range(time_at, time_at + 8),
        *range(identifier_at, identifier_at + 4),
        *range(data_at, data_at + FRAME_BYTES),
    }
    return _Form(
        length=len(marked),
        same=[(at, byte) for at, byte in enumerate(marked) if at not in own],
        time_at=time_at,
        identifier_at=identifier_at,
        data_at=data_at,
        counts=_may_count(frame),
    )


def _may_count(frame: CanFrame) -> bool:
    """Report whether it can be a feedback frame by all but its identifier."""
    return frame.is_extended and not frame.is_remote and not frame.is_error and len(frame.data) == FRAME_BYTES
