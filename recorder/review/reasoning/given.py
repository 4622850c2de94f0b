"""The times at which the arbiter was given the frames by which it decided, by the journal.

A busy machine reads frames later than the bus had them. The arbiter judges their age by when it was given them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from recorder.reading.topics import UNREADABLE
from recorder.review.reasoning.signals import DecodedFrame
from schemas.can_word import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE
from schemas.decisions import Journal
from schemas.journal import Kind
from schemas.settings import SAFETY_STATE_PERIOD_NS, TICK_NS

REACH_NS: Final = 5_000_000_000
"""Length of the journal that is read before a moment."""

_FRAME: Final = Kind.FRAME.value
_TICK: Final = Kind.TICK.value
_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


class GivenInputs(msgspec.Struct, frozen=True):
    """The frames that the arbiter was given up to a tick.

    Times are nanoseconds since 1970, by the clock of the moment.

    Attributes:
        from_ns: from here on the journal is there without a gap.
        frames: by identifier, in their order, each at the time at which the arbiter was given it.
    """

    from_ns: int
    frames: dict[int, list[DecodedFrame]]


def given_until(at_ns: int, journals: Sequence[Journal], shift_ns: int) -> GivenInputs | None:
    """The frames that the arbiter was given before the last tick up to a moment.

    Args:
        at_ns: the moment; a tick that is so near to it that it must be meant is one of the moment.
        journals: of one run of a gateway, by their time.
        shift_ns: to be added to the robot's clock.

    Returns:
        None if the log does not hold the journal of the moment.
    """
    inputs: list[tuple[Any, ...]] = []
    next_first: int | None = None
    for journal in reversed(journals):
        if next_first not in {None, journal.first + journal.count}:
            break
        try:
            found = _DECODER.decode(journal.inputs)
        except UNREADABLE:
            break
        if not inputs:
            found = _up_to_tick(found, at_ns - shift_ns)
            if not found:
                continue  # All of it came behind the moment.
        inputs = found + inputs
        next_first = journal.first
        if _reaches_back(inputs):
            break
    match inputs:
        case [(_, int(from_ns), *_), *_, (_, int(now_ns), int(wall_ns), *_)]:
            if at_ns - shift_ns - wall_ns > SAFETY_STATE_PERIOD_NS + TICK_NS:
                return None
            offset_ns = wall_ns + shift_ns - now_ns
            return GivenInputs(from_ns + offset_ns, _frames(inputs, offset_ns, shift_ns))
        case _:
            return None


def _reaches_back(inputs: Sequence[tuple[Any, ...]]) -> bool:
    """Return True if these inputs are enough; or so damaged that they show nothing."""
    match inputs:
        case [(_, int(from_ns), *_), *_, (_, int(now_ns), *_)]:
            return now_ns - from_ns >= REACH_NS
        case _:
            return True


def _up_to_tick(inputs: list[tuple[Any, ...]], wall_ns: int) -> list[tuple[Any, ...]]:
    """The inputs up to the last tick that is not behind this time; none if there is no such tick."""
    for at in range(len(inputs) - 1, -1, -1):
        match inputs[at]:
            case (kind, int(), int(tick_ns), *_) if kind == _TICK and tick_ns <= wall_ns + TICK_NS // 2:
                return inputs[: at + 1]
    return []


def _frames(inputs: Sequence[tuple[Any, ...]], offset_ns: int, shift_ns: int) -> dict[int, list[DecodedFrame]]:
    frames: dict[int, list[DecodedFrame]] = {}
    for one in inputs:
        match one:
            case (kind, int(now_ns), [int(word), bytes(data), int(wall_ns), *_]) if kind == _FRAME:
                if word & EXTENDED and not word & (REMOTE | ERROR):
                    given_ns = now_ns + offset_ns
                    bus_ns = wall_ns + shift_ns if wall_ns else given_ns
                    identifier = word & IDENTIFIER_MASK
                    frames.setdefault(identifier, []).append(DecodedFrame(given_ns, identifier, data, bus_ns))
    return frames
