"""Faults that appeared between two messages of ``gateway/health``, which comes once a second."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec

from recorder.review.timeline.entries import EntryKind
from schemas.decisions import Severity
from schemas.messages import ControllerState, GatewayHealth

FAILURES_IN_WORDS: Final = {
    "checksum": "checksums fail",
    "implausible": "values beyond what the chassis can have",
    "alive_counter": "alive counter fails",
    "period": "wrong period",
    "silence": "silent",
}

_COUNTS: Final[tuple[tuple[str, str], ...]] = (
    ("bus_losses", "the CAN bus was lost"),
    ("bus_drops", "frames were dropped: not read in time, or garbled"),
    ("publish_failures", "Zenoh did not take samples"),
    ("inbox_drops", "requests were dropped unread: too many came"),
)
"""Counters since the start whose rise makes an entry."""

FRAME_COUNTS: Final[tuple[tuple[str, str, str], ...]] = (
    ("checksum_faults", "checksum", "frames with a wrong checksum"),
    ("implausible", "implausible", "frames with a value that the chassis cannot have"),
    ("lost", "alive_lost", "frames that should have come, and did not; they are counted when that is known"),
)
"""Counters of each frame whose rise makes an entry, and the kind of fault that then needs none of its own."""

_HARMLESS: Final = frozenset({"unknown_identifier", "remote_frame", "error_frame", "fd_frame"})
"""Frames of others on the bus, mostly."""


def fault_words(kind: str) -> str:
    """The words for faults of this kind, of all frames together."""
    return f"faults of frames: {kind}"


class Risen(msgspec.Struct, frozen=True):
    """Something that went wrong, or is over.

    Attributes:
        what: alike ones have the same.
        count: so many since the health before.
        about: the feedback frames that it is about; empty if it is about none.
        is_end: the end of something, which is known to be over at this health. Else it began, at an unknown time,
            behind the health before.
    """

    what: str
    kind: EntryKind
    severity: Severity
    text: str
    count: int = 1
    about: tuple[str, ...] = ()
    is_end: bool = False


def risen(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """Return the faults that are new since the message before.

    Args:
        before: the one before of the same run; None if the log holds none: then the faults of now are returned.
        now: the newest.
    """
    yield from _bus(before, now)
    yield from _frames(before, now)
    if before is not None:
        yield from _counts(before, now)


def _frames(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """Of all frames together, since a cable that is pulled out silences all of them."""
    were = {} if before is None else {frame.name: frame.failures for frame in before.feedback}
    begun: dict[str, list[str]] = {}
    over: dict[str, list[str]] = {}
    for frame in now.feedback:
        was = were.get(frame.name, [])
        for failure in frame.failures:
            if failure not in was:
                begun.setdefault(failure, []).append(frame.name)
        for failure in was:
            if failure not in frame.failures:
                over.setdefault(failure, []).append(frame.name)
    for failure, names in begun.items():
        words = FAILURES_IN_WORDS.get(failure, failure)
        yield Risen(failure, EntryKind.FAULT, Severity.WARNING, words, len(names), tuple(names))
    for failure, names in over.items():
        text = f"no longer at fault ({failure})"
        what = f"{failure} over"
        yield Risen(what, EntryKind.FAULT, Severity.INFO, text, len(names), tuple(names), is_end=True)


def _counts(before: GatewayHealth, now: GatewayHealth) -> Iterator[Risen]:
    were = {frame.name: frame for frame in before.feedback}
    said = {
        failure
        for frame in now.feedback
        for failure in frame.failures
        if frame.name in were and failure not in were[frame.name].failures
    }
    for field, kind, words in FRAME_COUNTS:
        rises = {
            frame.name: getattr(frame, field) - getattr(were[frame.name], field)
            for frame in now.feedback
            if frame.name in were and getattr(frame, field) > getattr(were[frame.name], field)
        }
        if rises:
            said.add(kind)
            # A frame may only be late: the gateway knows that it is lost some seconds after its time.
            count, is_end = sum(rises.values()), field == "lost"
            yield Risen(words, EntryKind.FAULT, Severity.WARNING, words, count, tuple(rises), is_end=is_end)
    for kind, count in now.faults.items():
        rise = count - before.faults.get(kind, 0)
        if rise > 0 and kind not in said:
            severity = Severity.INFO if kind in _HARMLESS else Severity.WARNING
            yield Risen(f"fault {kind}", EntryKind.FAULT, severity, fault_words(kind), rise)
    for field, words in _COUNTS:
        rise = getattr(now, field) - getattr(before, field)
        if rise > 0:
            yield Risen(field, EntryKind.FAULT, Severity.WARNING, words, rise)


def _bus(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    if not now.bus_up and (before is None or before.bus_up):
        detail = f": {now.bus_detail}" if now.bus_detail else ""
        yield Risen("bus down", EntryKind.FAULT, Severity.ERROR, f"the CAN bus {now.bus} is not there{detail}")
    if before is not None and now.bus_up and not before.bus_up:
        yield Risen("bus up", EntryKind.FAULT, Severity.INFO, f"the CAN bus {now.bus} is back", is_end=True)
    if before is not None and now.variant is not before.variant:
        text = f"the firmware variant: {before.variant.value} before, {now.variant.value} now"
        yield Risen("variant", EntryKind.GATEWAY, Severity.INFO, text, is_end=True)
    was = ControllerState.UNKNOWN if before is None else before.controller
    if now.controller is not was and now.controller is not ControllerState.UNKNOWN:
        text = f"the CAN controller: {was.value} before, {now.controller.value} now"
        yield Risen("controller", EntryKind.FAULT, Severity.WARNING, text)
